//! The meshes of the conformance vectors: closure, triangle count, conformity, and refinement of the same grids.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::Arc,
};

use glam::{DQuat, DVec3};
use sightline::{
    roam::{Target, ViewMesh},
    terrain::{MemoryField, SceneScale, synthetic},
    view::{Camera, Projection},
    wedgie::MemoryTerrain,
};
use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::{Mesh, closure, triangle_count},
};

fn read(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn grid(name: &str) -> MemoryField {
    let rows: Vec<Vec<f64>> = read(&format!("{name}.csv"))
        .lines()
        .map(|line| line.split(',').map(|number| number.parse().unwrap()).collect())
        .collect();
    MemoryField::from_fn(rows[0].len() as u32, rows.len() as u32, |i, j| Some(rows[j as usize][i as usize])).unwrap()
}

struct Vector {
    mesh: String,
    grid: String,
    seeds: Vec<Post>,
    closed: BTreeSet<Post>,
    triangles: u64,
}

fn vectors() -> Vec<Vector> {
    let posts = |text: &str| -> Vec<Post> {
        let post = |pair: &str| {
            let (i, j) = pair.split_once(',').unwrap();
            Post::new(i.parse().unwrap(), j.parse().unwrap())
        };
        text.split_whitespace().map(post).collect()
    };
    let text = read("mesh.csv");
    let mut vectors = Vec::new();
    for line in text.lines().skip(1) {
        // mesh,grid,"seeds","closed",triangles; the seeds may be empty and without quotes.
        let mut fields = Vec::new();
        let (mut field, mut quoted) = (String::new(), false);
        for c in line.chars() {
            match c {
                '"' => quoted = !quoted,
                ',' if !quoted => fields.push(std::mem::take(&mut field)),
                c => field.push(c),
            }
        }
        let [mesh, grid, seeds, closed] = <[String; 4]>::try_from(fields).unwrap();
        let (seeds, closed) = (posts(&seeds), posts(&closed).into_iter().collect());
        vectors.push(Vector { mesh, grid, seeds, closed, triangles: field.parse().unwrap() });
    }
    vectors
}

/// A closed set of posts as a mesh of height 0.
struct FlatMesh(RootSquare, BTreeSet<Post>);

impl Mesh for FlatMesh {
    fn root(&self) -> RootSquare {
        self.0
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.0.side() + 1, self.0.side() + 1)
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.1.contains(&p).then_some(0.0)
    }
}

#[test]
fn conformance_closures_and_triangle_counts() {
    let vectors = vectors();
    assert!(vectors.len() >= 20, "only {} vectors", vectors.len());
    let root = RootSquare::new(6).unwrap();
    for v in &vectors {
        let closed = closure(root, v.seeds.iter().copied());
        assert_eq!(closed, v.closed, "mesh {}", v.mesh);
        assert_eq!(triangle_count(root, &closed), v.triangles, "mesh {}", v.mesh);
    }
}

#[test]
fn conformance_meshes_cover_the_square_without_gaps() {
    let root = RootSquare::new(6).unwrap();
    for v in vectors() {
        let mesh = FlatMesh(root, v.closed);
        let (mut count, mut doubled_area) = (0, 0);
        // Every side of a triangle is a side of one other, or on the border: no crack, no T-junction.
        let mut sides: BTreeMap<(Post, Post), u32> = BTreeMap::new();
        mesh.for_each_triangle(|t| {
            count += 1;
            let [p, q, r] = t.corners().map(|p| (i64::from(p.i), i64::from(p.j)));
            doubled_area += (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
            for (p, q) in [(t.apex, t.e0), (t.e0, t.e1), (t.e1, t.apex)] {
                *sides.entry((p.min(q), p.max(q))).or_default() += 1;
            }
        });
        assert_eq!(count, v.triangles, "mesh {}", v.mesh);
        assert_eq!(doubled_area, 2 * 64 * 64);
        for ((p, q), times) in sides {
            let border = (p.i == q.i && p.i % 64 == 0) || (p.j == q.j && p.j % 64 == 0);
            assert_eq!(times, if border { 1 } else { 2 }, "mesh {}: side {p:?} {q:?}", v.mesh);
        }
    }
}

#[test]
fn conformance_grids_are_refined_within_every_budget() {
    let names: BTreeSet<String> = vectors().into_iter().map(|v| v.grid).collect();
    for name in names {
        let scale = SceneScale { east_m: 30.0, north_m: 30.0, up_m: 1.0 };
        let terrain = Arc::new(MemoryTerrain::new(grid(&name), scale).unwrap());
        let mut mesh = ViewMesh::new(terrain, scale).unwrap();
        let mut bound = f64::INFINITY;
        for n in (2..3000).step_by(97) {
            let report = mesh.update(&Camera::everywhere(), Target::TriangleBudget(n), &[]).unwrap();
            let active: BTreeSet<Post> = mesh.active_posts().into_iter().map(|(p, _)| p).collect();
            let closed = closure(mesh.root(), active.iter().copied());
            assert_eq!(closed.len(), active.len() + 4);
            assert_eq!(triangle_count(mesh.root(), &active), u64::from(report.triangles));
            assert!(report.triangles <= n && (report.triangles + 1 >= n || report.bound_px == 0.0));
            assert!(report.bound_px <= bound, "more triangles never raise the bound");
            bound = report.bound_px;
        }
    }
}

/// The same in debug and release builds, with wider vector instructions, and on every machine: run by both builds.
#[test]
fn conformance_of_a_flight_to_a_golden_hash() {
    let scale = SceneScale { east_m: 30.0, north_m: 30.0, up_m: 1.0 };
    let terrain = Arc::new(MemoryTerrain::new(synthetic::fractal(129, 129, 12, 400).unwrap(), scale).unwrap());
    let mut mesh = ViewMesh::new(terrain, scale).unwrap();
    let mut hash = 0_u64;
    for step in 0..60_u32 {
        let t = f64::from(step);
        let eye = DVec3::new(300.0 + 50.0 * t, 3500.0 - 45.0 * t, 900.0 - 6.0 * t);
        let rotation = DQuat::from_xyzw(0.6 + 0.004 * t, 0.01 * t, 0.02 * t, 0.8).normalize();
        let projection = match step % 20 {
            19 => Projection::Orthographic { half_height_m: 800.0, near_m: 1.0 },
            _ => Projection::Perspective { tan_half_fov: 0.6, near_m: 1.0 },
        };
        let camera = Camera::new(eye, rotation, projection, [640, 480]).unwrap();
        let target = match step % 7 {
            6 => Target::ScreenError { px: 2.5, max: 5000 },
            _ => Target::TriangleBudget(300 + 40 * step),
        };
        let report = mesh.update(&camera, target, &[]).unwrap();
        let posts = mesh.active_posts().into_iter().map(|(p, z)| p.key() ^ z.to_bits());
        for value in posts.chain([report.bound_px.to_bits(), report.triangles.into()]) {
            hash = synthetic::mix(hash ^ value);
        }
    }
    assert_eq!(hash, 0xac3b_0004_1309_c05b, "{hash:#018x}: meshes or bounds changed, or differ on this machine");
}
