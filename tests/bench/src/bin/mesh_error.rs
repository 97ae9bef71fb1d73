//! The greatest vertical error of a mesh of n triangles: ours, the best bintree mesh, MARTINI's (RTIN) and Delatin's.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin mesh_error -- [DATABASE...]`: of each database the
//! south-western 2^k + 1 posts squared that fit, up to 1025; a synthetic terrain by default. The best bintree mesh is
//! found for the south-western 257 posts squared. Each error is measured on the mesh itself, at every post.
//!
//! - **MARTINI** (after Evans, Kirkpatrick and Townsend, "Right-triangulated irregular networks", 2001): a diamond's
//!   error is the greatest of its own, |post - middle of its base|, and its children's; the greatest are split first.
//! - **Delatin** (Garland and Heckbert, "Fast polygonal approximation of terrains and height fields", 1995): a Delaunay
//!   triangulation into which the worst post of the worst triangle is inserted, over and over.
//! - **Best bintree**: any mesh whose triangles are all within e contains the least such mesh, which splits what is not
//!   within e and nothing else; the least e whose least mesh has at most n triangles is found by bisection.

use std::{
    collections::{BTreeSet, BinaryHeap, HashMap},
    error::Error,
    path::Path,
    sync::Arc,
};

use sightline::{
    database::{Database, OpenOptions},
    roam::{Target, ViewMesh},
    terrain::{HeightField, MemoryField, Posts, SceneScale, synthetic},
    view::Camera,
    wedgie::MemoryTerrain,
};
use sightline_bench::cut;
use sightline_proto::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
};
use spade::{
    DelaunayTriangulation, HasPosition, Point2, Triangulation,
    handles::{FaceHandle, InnerTag},
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const GREATEST_SIDE: u32 = 1025;
const BEST_SIDE: u32 = 257;
const COUNTS: [u32; 5] = [1_000, 3_000, 10_000, 30_000, 100_000];

fn main() -> Result<()> {
    let databases: Vec<_> = std::env::args().skip(1).collect();
    let mut terrains = Vec::new();
    for path in &databases {
        let database = Database::open(Path::new(path), OpenOptions::default())?;
        terrains.push((path.clone(), cut(&database, [0, 0], GREATEST_SIDE, |post| Some(post.z))?));
    }
    if terrains.is_empty() {
        terrains.push(("synthetic".into(), synthetic::fractal(GREATEST_SIDE, GREATEST_SIDE, 1, 1000)?));
    }
    println!("greatest vertical error in height units; ratios of ours to the others");
    for (name, field) in terrains {
        let grid = field.grid();
        let fits = (grid.nx().min(grid.ny()) - 1).ilog2();
        let heights = Heights::of(&field, (1 << fits) + 1)?;
        println!("\n{name}: {0} x {0} posts", heights.side);
        compare(&heights)?;
        let small = Heights::of(&field, heights.side.min(BEST_SIDE))?;
        println!("{name}: {0} x {0} posts", small.side);
        compare_with_best(&small)?;
    }
    Ok(())
}

fn compare(heights: &Heights) -> Result<()> {
    println!(
        "{:>10} {:>9} {:>9} {:>9} {:>12} {:>12}",
        "triangles", "ours", "martini", "delatin", "of martini", "of delatin"
    );
    let mut ours = Ours::new(heights)?;
    let rtin = rtin_order(heights);
    let mut tin = Delatin::new(heights)?;
    for count in COUNTS.into_iter().filter(|&count| count <= heights.posts() / 4) {
        let mine = heights.error_of(&ours.triangles(count)?);
        let martini = heights.error_of(&prefix(heights.root(), &rtin, count));
        let delatin = tin.refine(count)?;
        println!("{count:10} {mine:9.2} {martini:9.2} {delatin:9.2} {:12.3} {:12.3}", mine / martini, mine / delatin);
    }
    Ok(())
}

fn compare_with_best(heights: &Heights) -> Result<()> {
    println!("{:>10} {:>9} {:>9} {:>12}", "triangles", "ours", "best", "of best");
    let mut ours = Ours::new(heights)?;
    let best = Best::new(heights);
    for count in COUNTS.into_iter().filter(|&count| count <= heights.posts() / 4) {
        let mine = heights.error_of(&ours.triangles(count)?);
        let least = best.error(count);
        println!("{count:10} {mine:9.2} {least:9.2} {:12.4}", mine / least);
    }
    Ok(())
}

/// The heights of a square of 2^k + 1 posts a side.
struct Heights {
    side: u32,
    z: Vec<f64>,
}

impl Heights {
    fn of(field: &MemoryField, side: u32) -> Result<Self> {
        let mut posts = Posts::new(field);
        let mut z = Vec::new();
        for j in 0..side {
            for i in 0..side {
                z.push(posts.at(Post::new(i, j))?.z);
            }
        }
        Ok(Self { side, z })
    }

    fn posts(&self) -> u32 {
        self.side * self.side
    }

    fn root(&self) -> RootSquare {
        RootSquare::covering(self.side, self.side).expect("at least 2 posts a side")
    }

    fn at(&self, p: Post) -> f64 {
        self.z[(p.j * self.side + p.i) as usize]
    }

    fn field(&self) -> Result<MemoryField> {
        Ok(MemoryField::from_fn(self.side, self.side, |i, j| Some(self.at(Post::new(i, j))))?)
    }

    /// The greatest error of the posts of a triangle, and where.
    fn worst(&self, corners: [Post; 3]) -> (f64, Post) {
        let [a, b, c] = corners.map(|p| [f64::from(p.i), f64::from(p.j), self.at(p)]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let of = |f: fn(&Post) -> u32| {
            let values = corners.each_ref().map(f);
            (values.into_iter().min().unwrap_or(0), values.into_iter().max().unwrap_or(0))
        };
        let (columns, rows) = (of(|p| p.i), of(|p| p.j));
        let mut worst = (0.0, corners[0]);
        for j in rows.0..=rows.1 {
            for i in columns.0..=columns.1 {
                let (x, y) = (f64::from(i) - a[0], f64::from(j) - a[1]);
                let v = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / area;
                let w = ((b[0] - a[0]) * y - (b[1] - a[1]) * x) / area;
                if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
                    let plane = a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]);
                    let error = (self.at(Post::new(i, j)) - plane).abs();
                    if error > worst.0 {
                        worst = (error, Post::new(i, j));
                    }
                }
            }
        }
        worst
    }

    fn error_of(&self, triangles: &[Triangle]) -> f64 {
        triangles.iter().fold(0.0, |most, t| most.max(self.worst(t.corners()).0))
    }
}

struct Ours {
    mesh: ViewMesh<MemoryTerrain>,
}

impl Ours {
    fn new(heights: &Heights) -> Result<Self> {
        let scale = SceneScale { east_m: 1.0, north_m: 1.0, up_m: 1.0 };
        let terrain = MemoryTerrain::new(heights.field()?, scale)?;
        Ok(Self { mesh: ViewMesh::new(Arc::new(terrain), scale)? })
    }

    fn triangles(&mut self, count: u32) -> Result<Vec<Triangle>> {
        self.mesh.update(&Camera::everywhere(), Target::TriangleBudget(count), &[])?;
        let mut triangles = Vec::new();
        self.mesh.for_each_triangle(|t| triangles.push(t));
        if triangles.len() > count as usize { Err("more triangles than were asked for".into()) } else { Ok(triangles) }
    }
}

/// A mesh as a set of posts.
struct Posted {
    root: RootSquare,
    posts: BTreeSet<Post>,
}

impl Posted {
    fn new(root: RootSquare) -> Self {
        Self { root, posts: root.corners().into() }
    }

    /// Adds a post and what it needs; how many triangles more.
    fn add(&mut self, p: Post) -> u32 {
        if !self.posts.insert(p) {
            return 0;
        }
        let parents: Vec<_> = self.root.parents(p).collect();
        parents.len() as u32 + parents.into_iter().map(|parent| self.add(parent)).sum::<u32>()
    }

    fn triangles(&self) -> Vec<Triangle> {
        let mut triangles = Vec::new();
        self.for_each_triangle(|t| triangles.push(t));
        triangles
    }
}

impl Mesh for Posted {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.root.side() + 1, self.root.side() + 1)
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.posts.contains(&p).then_some(0.0)
    }
}

/// Every diamond with its error after MARTINI, worst first, parents before children.
fn rtin_order(heights: &Heights) -> Vec<Post> {
    let root = heights.root();
    let mut diamonds: Vec<_> = (0..heights.posts())
        .map(|n| Post::new(n % heights.side, n / heights.side))
        .filter_map(|p| Some((root.level(p)?, p)))
        .collect();
    diamonds.sort_unstable_by_key(|&(level, p)| (std::cmp::Reverse(level), p));
    let mut errors: HashMap<Post, f64> = HashMap::new();
    for &(_, p) in &diamonds {
        let own =
            root.base_ends(p).map_or(0.0, |[e0, e1]| (heights.at(p) - (heights.at(e0) + heights.at(e1)) / 2.0).abs());
        let error = root.children(p).fold(own, |most, child| most.max(errors[&child]));
        errors.insert(p, error);
    }
    diamonds.sort_unstable_by(|a, b| errors[&b.1].total_cmp(&errors[&a.1]).then(a.cmp(b)));
    diamonds.into_iter().map(|(_, p)| p).collect()
}

/// The mesh of as many of the first diamonds as fit.
fn prefix(root: RootSquare, order: &[Post], count: u32) -> Vec<Triangle> {
    let mut mesh = Posted::new(root);
    let mut triangles = 2;
    for &p in order {
        let more = root.parents(p).count() as u32;
        if triangles + more > count {
            break;
        }
        triangles += mesh.add(p);
    }
    mesh.triangles()
}

/// The true error of every bintree triangle.
struct Best {
    root: RootSquare,
    errors: HashMap<(Post, Post, Post), f64>,
}

impl Best {
    fn new(heights: &Heights) -> Self {
        fn descend(heights: &Heights, t: Triangle, errors: &mut HashMap<(Post, Post, Post), f64>) {
            errors.insert((t.apex, t.e0, t.e1), heights.worst(t.corners()).0);
            if let Some(m) = t.base_midpoint() {
                for child in t.children(m) {
                    descend(heights, child, errors);
                }
            }
        }
        let (root, mut errors) = (heights.root(), HashMap::new());
        for t in root.roots() {
            descend(heights, t, &mut errors);
        }
        Self { root, errors }
    }

    /// The least error of a mesh of at most `count` triangles.
    fn error(&self, count: u32) -> f64 {
        let mut candidates: Vec<f64> = self.errors.values().copied().collect();
        candidates.sort_unstable_by(f64::total_cmp);
        candidates.dedup();
        let needed = candidates.partition_point(|&error| !self.fits(error, count));
        candidates[needed.min(candidates.len() - 1)]
    }

    /// Whether the least mesh whose triangles are all within `error` has at most `count` of them.
    fn fits(&self, error: f64, count: u32) -> bool {
        let mut mesh = Posted::new(self.root);
        let mut triangles = 2;
        loop {
            let posts: Vec<_> = mesh
                .triangles()
                .iter()
                .filter(|t| self.errors[&(t.apex, t.e0, t.e1)] > error)
                .filter_map(Triangle::base_midpoint)
                .collect();
            if posts.is_empty() {
                return true;
            }
            for p in posts {
                triangles += mesh.add(p);
            }
            if triangles > count {
                return false;
            }
        }
    }
}

/// A vertex of a triangulation that knows its post.
struct Vertex(Post);

impl HasPosition for Vertex {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        Point2::new(f64::from(self.0.i), f64::from(self.0.j))
    }
}

/// The number and the corners of a face.
fn numbered(face: FaceHandle<'_, InnerTag, Vertex, (), (), ()>) -> (usize, [Post; 3]) {
    (face.index(), face.vertices().map(|vertex| vertex.data().0))
}

/// A triangle that may be out of date, by the bits of its error.
type Candidate = (u64, Post, usize, u64);

struct Delatin<'a> {
    heights: &'a Heights,
    mesh: DelaunayTriangulation<Vertex>,
    heap: BinaryHeap<Candidate>,
    /// How often each face has changed.
    versions: Vec<u64>,
}

impl<'a> Delatin<'a> {
    fn new(heights: &'a Heights) -> Result<Self> {
        let mut mesh = DelaunayTriangulation::new();
        for corner in heights.root().corners() {
            mesh.insert(Vertex(corner))?;
        }
        let mut tin = Self { heights, mesh, heap: BinaryHeap::new(), versions: Vec::new() };
        let faces: Vec<_> = tin.mesh.inner_faces().map(numbered).collect();
        for face in faces {
            tin.weigh(face);
        }
        Ok(tin)
    }

    fn weigh(&mut self, (index, corners): (usize, [Post; 3])) {
        self.versions.resize(self.versions.len().max(index + 1), 0);
        self.versions[index] += 1;
        let (error, post) = self.heights.worst(corners);
        self.heap.push((error.to_bits(), post, index, self.versions[index]));
    }

    /// Inserts posts until there are `count` triangles; the greatest error then.
    fn refine(&mut self, count: u32) -> Result<f64> {
        loop {
            let Some(&(error, post, face, version)) = self.heap.peek() else { return Ok(0.0) };
            if self.versions[face] != version {
                self.heap.pop();
                continue;
            }
            if self.mesh.num_inner_faces() + 2 > count as usize || error == 0 {
                return Ok(f64::from_bits(error));
            }
            self.heap.pop();
            let vertex = self.mesh.insert(Vertex(post))?;
            // An insertion changes the faces around the new vertex and no others.
            let around: Vec<_> =
                self.mesh.vertex(vertex).out_edges().filter_map(|edge| edge.face().as_inner()).map(numbered).collect();
            for face in around {
                self.weigh(face);
            }
        }
    }
}
