//! How many pages a database reads for what is asked of it cold, beside what the bytes that are needed would fill, and
//! beside pages of the same size over rows from west to east.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin pages -- DATABASE [TRIANGLES] [VIEWS] [anywhere]`. Each
//! view and each line has a database of its own that was just opened, with a cache of 64 MiB, and for a view the file is out
//! of the system's cache. What a view needs: the bounds of every diamond that it asked for (9 bytes each where they are
//! stored), the heights of these posts, and those that the finest ones' bounds follow from (2 bytes). What a line needs: the
//! four heights around each cell edge that it crosses in plan. Eyes are where the ground is not level, or anywhere.
//!
//! What is read is compared with what is needed in three ways: pages by number (and what is read of all coarsest lattices at
//! once, in pages of 8 KiB); bytes in pages of 8 KiB; and reads, directories included. Then, from the posts that were asked
//! for, how pages of other shapes would do below the lattices that are read at once.

use std::{
    collections::{BTreeMap, HashSet},
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
use sightline_bench::forget;
use sightline_proto::diamond::Post;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const CACHE: OpenOptions = OpenOptions { cache_bytes: 64 << 20 };
const PAGE_POSTS: u64 = 4096;
const PAGE_QUADS: u64 = 256;
const PAGE_BYTES: f64 = 8192.0;
/// Bytes of a quad: bounds and heights of three posts.
const QUAD_BYTES: u64 = 33;
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
    let anywhere = arguments.get(3).is_some_and(|word| word == "anywhere");
    println!(
        "\nviews of {triangles} triangles: pages, directory blocks, reads at once, KiB; pages that what is needed would fill, \
         pages of rows; ms"
    );
    let mut seen = Vec::new();
    for n in 0..views {
        let view = view(Path::new(path), triangles, n, if anywhere { 1 } else { ATTEMPTS })?;
        println!("{}", view.line());
        seen.push(view);
    }
    summary(&seen);
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

    fn corner_heights(&self) -> std::result::Result<Option<[f64; 4]>, ReadError> {
        self.database.corner_heights()
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

/// What one view read, and what it needed.
struct View {
    /// Posts east and north of the south-western one.
    eye: [f64; 2],
    reads: Reads,
    /// By the name of a section.
    by_section: Vec<(String, Reads)>,
    crown_bytes: u64,
    /// Diamonds that it asked for.
    asked: HashSet<Post>,
    /// Those of them whose bounds are stored and whose balls are in the picture.
    in_picture: HashSet<Post>,
    /// Posts whose heights the bounds of the finest diamonds follow from.
    finest: HashSet<Post>,
    /// Pages of 8 KiB that what is needed would fill, and pages of rows that have it.
    needed: u64,
    rows: usize,
    triangles: u32,
    ms: f64,
}

impl View {
    /// Read of needed: pages by number, bytes without and with directories, reads.
    fn ratios(&self) -> [f64; 4] {
        let Reads { pages, directory_blocks, directory_bytes, crowns, bytes } = self.reads;
        let crown_pages = (self.crown_bytes as f64 / PAGE_BYTES).ceil();
        let read = [
            pages as f64 + crown_pages,
            (bytes - directory_bytes) as f64 / PAGE_BYTES,
            bytes as f64 / PAGE_BYTES,
            (pages + directory_blocks + crowns) as f64,
        ];
        read.map(|read| read / self.needed as f64)
    }

    fn line(&self) -> String {
        let Reads { pages, directory_blocks, crowns, bytes, .. } = self.reads;
        let [count, page_bytes, all_bytes, reads] = self.ratios();
        format!(
            "{pages}, {directory_blocks}, {crowns}, {}; {}, {}; {:.1} ({} triangles, {} diamonds asked for, from {:.0}, {:.0}); \
             {count:.2} {page_bytes:.2} {all_bytes:.2} {reads:.2}",
            bytes >> 10,
            self.needed,
            self.rows,
            self.ms,
            self.triangles,
            self.asked.len(),
            self.eye[0],
            self.eye[1]
        )
    }
}

/// One view from somewhere.
fn view(path: &Path, triangles: u32, n: u32, attempts: u64) -> Result<View> {
    let scale = Database::open(path, CACHE)?.scale();
    let camera = camera(&Database::open(path, CACHE)?, scale, u64::from(n), attempts)?;
    forget(path)?;
    let watched = Arc::new(Watched { database: Database::open(path, CACHE)?, asked: Mutex::default() });
    let started = Instant::now();
    let mut mesh = ViewMesh::new(Arc::clone(&watched), scale)?;
    let report = mesh.update(&camera, Target::TriangleBudget(triangles), &[])?;
    let ms = started.elapsed().as_secs_f64() * 1e3;
    let reads = watched.database.reads();
    let by_section: Vec<_> =
        watched.database.sections().into_iter().map(|s| s.name).zip(watched.database.reads_by_section()).collect();
    let crown_bytes = reads.bytes - by_section.iter().map(|(_, of)| of.bytes).sum::<u64>();
    let grid = HeightField::grid(&*watched);
    let mut asked = watched.asked.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let root = grid.root();
    // The finest ones follow from heights, so nobody asks for theirs: those in the mesh, and those that could be split next.
    let active: HashSet<Post> = mesh.active_posts().into_iter().map(|(p, _)| p).collect();
    let is_in = |p: Post| root.is_corner(p) || active.contains(&p);
    let next = active.iter().flat_map(|&p| root.children(p)).filter(|&c| root.parents(c).all(is_in));
    asked.extend(next.chain(active.iter().copied()).filter(|p| (p.i | p.j) % 2 == 1));
    let mut heights = HashSet::new();
    let mut rows = HashSet::new();
    let finest: HashSet<Post> = asked.iter().filter(|p| !is_stored(**p)).flat_map(|p| heights_of(grid, *p)).collect();
    heights.extend(&finest);
    for &p in &asked {
        heights.extend(heights_of(grid, p));
        let k = (p.i | p.j).trailing_zeros();
        if k > 0 && k < 32 {
            let columns = u64::from(grid.nx() >> k) + 1;
            let post = u64::from(p.j >> k) * columns + u64::from(p.i >> k);
            // As if posts of coarser lattices took no room: three of four are stored.
            rows.insert((1 + k, post * 3 / 4 / (3 * PAGE_QUADS)));
        }
    }
    rows.extend(heights.iter().map(|p| (0, row_page(grid, *p))));
    let stored = asked.iter().filter(|p| is_stored(**p)).count() as u64;
    let mut in_picture = HashSet::new();
    for &p in asked.iter().filter(|p| is_stored(**p)) {
        let (bounds, z) = watched.database.bounds_and_height(p)?;
        let centre = scale.scene_from_grid(DVec3::new(p.i.into(), p.j.into(), z.unwrap_or_default()));
        if camera.priority(1.0, centre, bounds.radius_m.into()) > 0.0 {
            in_picture.insert(p);
        }
    }
    let needed = (heights.len() as u64).div_ceil(PAGE_POSTS) + stored.div_ceil(3 * PAGE_QUADS);
    let (rows, triangles) = (rows.len(), report.triangles);
    let eye = camera.eye().map_or([0.0; 2], |eye| [eye.x / scale.east_m, eye.y / scale.north_m]);
    Ok(View { eye, reads, by_section, crown_bytes, asked, in_picture, finest, needed, rows, triangles, ms })
}

/// Whether bounds of the diamond at `p` are stored.
fn is_stored(p: Post) -> bool {
    (p.i | p.j) % 2 == 0
}

/// The posts of the grid whose heights are needed for the diamond at `p`.
fn heights_of(grid: Grid, p: Post) -> impl Iterator<Item = Post> {
    let reach: i64 = if is_stored(p) { 0 } else { 2 };
    let around = (-reach..=reach).flat_map(move |dj| (-reach..=reach).map(move |di| (di, dj)));
    around
        .filter(move |(di, dj)| di.abs() + dj.abs() <= reach)
        .filter_map(move |(di, dj)| p.offset(di, dj, grid.root().side()))
        .map(move |q| grid.clamp(q))
}

/// The middle one of an odd number, and the greatest.
fn median_and_most(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[values.len() / 2], values[values.len() - 1])
}

/// What all views did, what they read of each section, and how pages of other shapes would do.
fn summary(views: &[View]) {
    let names = ["pages", "bytes without directories", "bytes", "reads"];
    for (n, name) in names.into_iter().enumerate() {
        let (median, most) = median_and_most(views.iter().map(|view| view.ratios()[n]).collect());
        println!("read of needed, {name}: {median:.2} in the median, {most:.2} at most");
    }
    let (median, most) = median_and_most(views.iter().map(|view| view.ms).collect());
    println!("ms: {median:.1} in the median, {most:.1} at most");
    println!("\nmeans by section: pages, directory blocks, KiB; diamonds asked for, in the picture, pages of these");
    let mean = |sum: u64| sum as f64 / views.len() as f64;
    let by_level = |posts: fn(&View) -> &HashSet<Post>| {
        let mut all = BTreeMap::new();
        for p in views.iter().flat_map(posts) {
            *all.entry((p.i | p.j).trailing_zeros()).or_insert(0_u64) += 1;
        }
        all
    };
    let (asked, in_picture) = (by_level(|view| &view.asked), by_level(|view| &view.in_picture));
    let mut pages_in_picture = BTreeMap::new();
    for view in views {
        let page = |p: &Post| {
            let k = (p.i | p.j).trailing_zeros();
            (k, p.i >> (k + 5), p.j >> (k + 5))
        };
        for (k, ..) in view.in_picture.iter().map(page).collect::<HashSet<_>>() {
            *pages_in_picture.entry(k).or_insert(0_u64) += 1;
        }
    }
    for (n, (name, _)) in views[0].by_section.iter().enumerate() {
        let of = |what: fn(&Reads) -> u64| mean(views.iter().map(|view| what(&view.by_section[n].1)).sum());
        let level = name.strip_prefix("bounds of step ").and_then(|step| step.parse::<u64>().ok());
        let level = level.map_or(0, u64::trailing_zeros);
        let of_level = |all: &BTreeMap<u32, u64>| match level {
            0 if name != "heights" => 0.0,
            level => mean(all.get(&level).copied().unwrap_or(0)),
        };
        let [asked, in_picture, of_these] = [&asked, &in_picture, &pages_in_picture].map(of_level);
        let [pages, blocks, kib] = [of(|r| r.pages), of(|r| r.directory_blocks), of(|r| r.bytes) / 1024.0];
        if pages + blocks + asked > 0.0 {
            println!("{name:24} {pages:6.1} {blocks:6.1} {kib:8.1} {asked:8.1} {in_picture:8.1} {of_these:6.1}");
        }
    }
    shapes(views);
}

/// How pages of other shapes would do below the lattices that are read at once: so many quads a side of the finest of so many
/// lattices that share a page.
fn shapes(views: &[View]) {
    println!(
        "\npages of bounds of other shapes, without those read at once (quads a side, lattices): reads, KiB, a view"
    );
    let is_read_at_once = |view: &View, k: u32| {
        let of = |(name, reads): &(String, Reads)| *name == format!("bounds of step {}", 1_u64 << k) && reads.pages > 0;
        !view.by_section.iter().any(of)
    };
    for (side, lattices) in
        [(4, 1), (8, 1), (16, 1), (32, 1), (8, 2), (16, 2), (32, 2), (4, 3), (8, 3), (16, 3), (8, 4), (16, 4)]
    {
        let bytes: u64 = (0..lattices).map(|n| QUAD_BYTES * ((side >> n) * (side >> n)).max(1)).sum();
        let mut all = 0;
        for view in views {
            let mut pages = HashSet::new();
            for p in view.asked.iter().filter(|p| is_stored(**p)) {
                let k = (p.i | p.j).trailing_zeros();
                if is_read_at_once(view, k) {
                    continue;
                }
                let group = (k - 1) / lattices;
                let shift = side.trailing_zeros() + 1 + group * lattices + 1;
                pages.insert((group, p.i >> shift, p.j >> shift));
            }
            all += pages.len() as u64;
        }
        let reads = all as f64 / views.len() as f64;
        println!("{side:3} x {lattices} {reads:8.1} {:8.1}", reads * bytes as f64 / 1024.0);
    }
    println!("pages of heights (posts a side): reads, KiB, a view");
    for side in [16, 32, 64, 128_u32] {
        let of =
            |view: &View| view.finest.iter().map(|p| (p.i / side, p.j / side)).collect::<HashSet<_>>().len() as u64;
        let reads = views.iter().map(of).sum::<u64>() as f64 / views.len() as f64;
        println!("{side:3}     {reads:8.1} {:8.1}", reads * f64::from(2 * side * side) / 1024.0);
    }
}

/// The page of a file of rows that holds a post.
fn row_page(grid: Grid, p: Post) -> u64 {
    (u64::from(p.j) * u64::from(grid.nx()) + u64::from(p.i)) / PAGE_POSTS
}

/// Some hundred metres above the ground, looking a little down; where the ground is not level, if such a place is found.
fn camera(database: &Database, scale: SceneScale, n: u64, attempts: u64) -> Result<Camera> {
    let grid = HeightField::grid(database);
    let at = [grid.nx(), grid.ny()].map(f64::from);
    let mut posts = Posts::new(database);
    let mut place = ([0.0; 2], 0.0);
    for attempt in 0..attempts {
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
