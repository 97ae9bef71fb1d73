//! How many pages a database reads for what is asked of it cold, beside what the bytes that are needed would fill, and
//! beside pages of the same size over rows from west to east.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin pages -- DATABASE [TRIANGLES] [VIEWS]`. Each view and
//! each line has a database of its own that was just opened, with a cache of 64 MiB. What a view needs: the bounds of every
//! diamond that it asked for (9 bytes each where they are stored), the heights of these posts, and those that the finest
//! ones' bounds follow from (2 bytes). What a line needs: the four heights around each cell edge that it crosses in plan.

use std::{
    collections::HashSet,
    error::Error,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
    time::Instant,
};

use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions, Reads},
    los,
    roam::{Target, ViewMesh},
    terrain::{Grid, HeightField, HeightPage, PageId, Posts, ReadError, SceneScale, extremes::ExtremesPage, synthetic},
    view::{Camera, Projection},
    wedgie::{DiamondBounds, ErrorBounds},
};
use sightline_proto::diamond::Post;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const CACHE: OpenOptions = OpenOptions { cache_bytes: 64 << 20 };
const PAGE_POSTS: u64 = 4096;
const PAGE_QUADS: u64 = 256;
const LINES: u64 = 32;
/// Places that are tried for one that is not level.
const ATTEMPTS: u64 = 1000;

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let path = arguments.first().ok_or("name a database")?;
    let number = |n: usize, default: u32| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (triangles, views) = (number(1, 10_000)?, number(2, 8)?);
    let mut opened_ms: Vec<_> = (0..21).map(|_| open_ms(Path::new(path))).collect::<Result<_>>()?;
    opened_ms.sort_by(f64::total_cmp);
    println!("opened in {:.3} ms (median of 21, {:.3} at most)", opened_ms[10], opened_ms[20]);
    println!(
        "\nviews of {triangles} triangles: pages read, pages that what is needed would fill, pages of rows; bytes; ms"
    );
    let mut ratios = Vec::new();
    for n in 0..views {
        ratios.push(view(Path::new(path), triangles, n)?);
    }
    ratios.sort_by(f64::total_cmp);
    println!("read of needed: {:.2} in the median, {:.2} at most", ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
    println!(
        "\nlines across, {LINES} each: pages read a line, directory blocks, pages of rows of its posts; ms a line"
    );
    for reach in [1.0, 0.1, 0.01] {
        lines(Path::new(path), reach)?;
    }
    Ok(())
}

fn open_ms(path: &Path) -> Result<f64> {
    let started = Instant::now();
    let database = Database::open(path, CACHE)?;
    let ms = started.elapsed().as_secs_f64() * 1e3;
    drop(database);
    Ok(ms)
}

/// A database that keeps in mind which diamonds were asked for.
struct Watched {
    database: Database,
    asked: Mutex<HashSet<Post>>,
}

impl HeightField for Watched {
    fn grid(&self) -> Grid {
        HeightField::grid(&self.database)
    }

    fn page(&self, id: PageId) -> std::result::Result<Arc<HeightPage>, ReadError> {
        self.database.page(id)
    }

    fn resident(&self, id: PageId) -> Option<&HeightPage> {
        self.database.resident(id)
    }

    fn extremes(&self, level: u32, id: PageId) -> std::result::Result<Option<Arc<ExtremesPage>>, ReadError> {
        self.database.extremes(level, id)
    }
}

impl ErrorBounds for Watched {
    fn bounds(&self, p: Post) -> std::result::Result<DiamondBounds, ReadError> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).insert(p);
        self.database.bounds(p)
    }

    fn bounds_and_height(&self, p: Post) -> std::result::Result<(DiamondBounds, Option<f64>), ReadError> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).insert(p);
        self.database.bounds_and_height(p)
    }
}

/// A number from 0 to 1 that depends on `n` only.
fn unit(n: u64) -> f64 {
    (synthetic::mix(n) >> 11) as f64 / (1_u64 << 53) as f64
}

/// One view from somewhere; how many pages it reads for each that it needs.
fn view(path: &Path, triangles: u32, n: u32) -> Result<f64> {
    let database = Database::open(path, CACHE)?;
    let scale = database.scale();
    let camera = camera(&Database::open(path, CACHE)?, scale, u64::from(n))?;
    let watched = Arc::new(Watched { database, asked: Mutex::default() });
    let started = Instant::now();
    let mut mesh = ViewMesh::new(Arc::clone(&watched), scale)?;
    let report = mesh.update(&camera, Target::TriangleBudget(triangles), &[])?;
    let ms = started.elapsed().as_secs_f64() * 1e3;
    let Reads { pages, directory_blocks, bytes } = watched.database.reads();
    let grid = HeightField::grid(&*watched);
    let mut asked = watched.asked.lock().unwrap_or_else(PoisonError::into_inner);
    let root = grid.root();
    // The finest ones follow from heights, so nobody asks for theirs: those in the mesh, and those that could be split next.
    let active: HashSet<Post> = mesh.active_posts().into_iter().map(|(p, _)| p).collect();
    let is_in = |p: Post| root.is_corner(p) || active.contains(&p);
    let next = active.iter().flat_map(|&p| root.children(p)).filter(|&c| root.parents(c).all(is_in));
    asked.extend(next.chain(active.iter().copied()).filter(|p| (p.i | p.j) % 2 == 1));
    let mut heights = HashSet::new();
    let mut rows = HashSet::new();
    for &p in asked.iter() {
        let reach: i64 = if (p.i | p.j) % 2 == 0 { 0 } else { 2 };
        for (di, dj) in (-reach..=reach).flat_map(|dj| (-reach..=reach).map(move |di| (di, dj))) {
            if di.abs() + dj.abs() <= reach
                && let Some(q) = p.offset(di, dj, grid.root().side())
            {
                heights.insert(grid.clamp(q));
            }
        }
        let k = (p.i | p.j).trailing_zeros();
        if k > 0 && k < 32 {
            let columns = u64::from(grid.nx() >> k) + 1;
            let post = u64::from(p.j >> k) * columns + u64::from(p.i >> k);
            // As if posts of coarser lattices took no room: three of four are stored.
            rows.insert((1 + k, post * 3 / 4 / (3 * PAGE_QUADS)));
        }
    }
    rows.extend(heights.iter().map(|p| (0, row_page(grid, *p))));
    let stored = asked.iter().filter(|p| (p.i | p.j) % 2 == 0).count() as u64;
    let needed = (heights.len() as u64).div_ceil(PAGE_POSTS) + stored.div_ceil(3 * PAGE_QUADS);
    println!(
        "{pages} (and {directory_blocks} blocks), {needed}, {}; {bytes}; {ms:.1} ({} triangles, {} diamonds asked for)",
        rows.len(),
        report.triangles,
        asked.len()
    );
    Ok(pages as f64 / needed as f64)
}

/// The page of a file of rows that holds a post.
fn row_page(grid: Grid, p: Post) -> u64 {
    (u64::from(p.j) * u64::from(grid.nx()) + u64::from(p.i)) / PAGE_POSTS
}

/// Some hundred metres above the ground, looking a little down; where the ground is not level, if such a place is found.
fn camera(database: &Database, scale: SceneScale, n: u64) -> Result<Camera> {
    let grid = HeightField::grid(database);
    let at = [grid.nx(), grid.ny()].map(f64::from);
    let mut posts = Posts::new(database);
    let mut place = ([0.0; 2], 0.0);
    for attempt in 0..ATTEMPTS {
        let (x, y) = (
            (0.1 + 0.8 * unit(3 * n + (attempt << 32))) * at[0],
            (0.1 + 0.8 * unit(3 * n + 1 + (attempt << 32))) * at[1],
        );
        let mut z = |i: f64, j: f64| Ok::<_, ReadError>(posts.at(grid.clamp(Post::new(i as u32, j as u32)))?.z);
        place = ([x, y], z(x, y)?);
        if z(x + 50.0, y)? != place.1 || z(x, y + 50.0)? != place.1 {
            break;
        }
    }
    let ([x, y], z) = place;
    let eye = scale.scene_from_grid(DVec3::new(x, y, z)) + DVec3::Z * 600.0;
    let heading = std::f64::consts::TAU * unit(3 * n + 2);
    let rotation = DQuat::from_rotation_z(heading) * DQuat::from_rotation_x(80_f64.to_radians());
    let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
    Ok(Camera::new(eye, rotation.normalize(), projection, [1280, 720])?)
}

/// Lines between points 2 m above ground, as long as `reach` of the map.
fn lines(path: &Path, reach: f64) -> Result<()> {
    let (mut pages, mut blocks, mut rows, mut ms) = (0, 0, 0, 0.0);
    for n in 0..LINES {
        let looked = Database::open(path, CACHE)?;
        let grid = HeightField::grid(&looked);
        let side = [grid.nx() - 1, grid.ny() - 1].map(f64::from);
        let angle = std::f64::consts::TAU * unit(5 * n);
        let half = [0.45 * reach * angle.cos() * side[0], 0.45 * reach * angle.sin() * side[1]];
        let middle: [f64; 2] = [0, 1].map(|k| {
            let room = half[k].abs();
            room + unit(5 * n + 1 + k as u64) * (side[k] - 2.0 * room)
        });
        let ends = [-1.0, 1.0].map(|s| [middle[0] + s * half[0], middle[1] + s * half[1]]);
        let ground = ends.map(|[x, y]| los::on_ground(&looked, x, y, 2.0));
        let [Some(a), Some(b)] = [ground[0].clone()?, ground[1].clone()?] else { continue };
        let [a, b] = [[ends[0][0], ends[0][1], a], [ends[1][0], ends[1][1], b]];
        let database = Database::open(path, CACHE)?;
        let started = Instant::now();
        los::line_of_sight(&database, a, b, los::Options::default())?;
        ms += started.elapsed().as_secs_f64() * 1e3;
        let reads = database.reads();
        (pages, blocks) = (pages + reads.pages, blocks + reads.directory_blocks);
        let steps = ((b[0] - a[0]).abs().max((b[1] - a[1]).abs()) * 2.0).ceil() as u64;
        let mut met = HashSet::new();
        for step in 0..=steps {
            let t = step as f64 / steps.max(1) as f64;
            let [x, y] = [0, 1].map(|k| (a[k] + t * (b[k] - a[k])) as u32);
            for (di, dj) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                met.insert(row_page(grid, grid.clamp(Post::new(x + di, y + dj))));
            }
        }
        rows += met.len();
    }
    let of = |sum: f64| sum / LINES as f64;
    println!(
        "{:>5} of the map: {:.1}, {:.1}, {:.1}; {:.2}",
        reach,
        of(pages as f64),
        of(blocks as f64),
        of(rows as f64),
        of(ms)
    );
    Ok(())
}
