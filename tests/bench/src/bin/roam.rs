//! Refinement from frame to frame beside building from scratch and beside a dual queue that computes everything in each
//! frame: the same flights in one run, one core; meshes and bounds checked to be equal.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin roam -- [DATABASE] [SIDE] [FRAMES] [HZ]`: a synthetic
//! terrain by default, or the north-eastern SIDE x SIDE posts (4097) of a database, held in memory; and of a whole database,
//! how long a first mesh takes that is made from it.

use std::{error::Error, path::Path, sync::Arc, time::Instant};

use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions},
    roam::{MeshReport, Options, Target, ViewMesh},
    terrain::{HeightField, Posts, SceneScale, synthetic},
    view::{Camera, Projection},
    wedgie::MemoryTerrain,
};
use sightline_proto::{
    diamond::{Post, Triangle},
    mesh::Mesh,
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const SPEED_M_S: f64 = 250.0;
const ABOVE_M: f64 = 300.0;
const YAW_RAD_S: f64 = std::f64::consts::PI / 3.0;
const VIEWPORT_PX: [u32; 2] = [1280, 720];
/// Sampled plan points for the tightness of the bound.
const SAMPLES: u32 = 400_000;

/// Ways to get the mesh of a frame; the first is ours, the others leave something out.
fn ways() -> [(&'static str, Options); 4] {
    [
        ("ours", Options::default()),
        ("without inherited culling", Options { inherited_culling: false, ..Options::default() }),
        ("without deferral (naive dual)", Options { deferral: false, ..Options::default() }),
        ("from scratch", Options { incremental: false, ..Options::default() }),
    ]
}

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let number = |n: usize, default: u32| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (side, frames, rate_hz) = (number(1, 4097)?, number(2, 400)?, number(3, 60)?);
    let terrain = match arguments.first() {
        Some(path) => cut(Path::new(path), side)?,
        None => {
            let scale = SceneScale { east_m: 30.0, north_m: 30.0, up_m: 1.0 };
            MemoryTerrain::new(synthetic::fractal(side, side, 1, 1000)?, scale)?
        }
    };
    let terrain = Arc::new(terrain);
    println!("{frames} frames at {rate_hz} Hz; 1 core; ms are p50 / p95 / max, the rest medians of a frame");
    for triangles in [3_000, 10_000, 100_000] {
        for flight in [Flight::Straight, Flight::Yaw, Flight::Teleport] {
            if triangles == 10_000 || flight == Flight::Straight {
                let frames = if triangles > 10_000 || flight == Flight::Teleport { frames.min(150) } else { frames };
                compare(&terrain, flight, triangles, frames, f64::from(rate_hz))?;
            }
        }
    }
    if let Some(path) = arguments.first() {
        first_mesh(Path::new(path))?;
    }
    tightness(&terrain)
}

/// How long a first mesh of 10,000 triangles takes from a database that was just opened, its file in the system's cache,
/// and that of another view after it, with the pages read.
fn first_mesh(path: &Path) -> Result<()> {
    let (mut opened, mut warm) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let database = Arc::new(Database::open(path, OpenOptions::default())?);
        let scale = database.scale();
        let camera = camera(&*database, scale, Flight::Straight, 0, 60.0)?;
        let mut meshes = Vec::new();
        for ms in [&mut opened, &mut warm] {
            let started = Instant::now();
            let mut mesh = ViewMesh::new(Arc::clone(&database), scale)?;
            let report = mesh.update(&camera, Target::TriangleBudget(10_000), &[])?;
            ms.push(started.elapsed().as_secs_f64() * 1e3);
            meshes.push((report, mesh.active_posts()));
        }
        if meshes[0] != meshes[1] || meshes[0].0.triangles < 9_999 {
            return Err("two first meshes differ".into());
        }
    }
    println!(
        "\nfirst mesh, 10000 triangles, from a database: opened {:.1} ms, warm {:.1} ms",
        middle(opened),
        middle(warm)
    );
    Ok(())
}

/// The north-east of a database, with its bounds.
fn cut(path: &Path, side: u32) -> Result<MemoryTerrain> {
    let database = Database::open(path, OpenOptions::default())?;
    Ok(MemoryTerrain::new(sightline_bench::north_east(&database, side)?, database.scale())?)
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Flight {
    /// 250 m/s north, level, looking a little down.
    Straight,
    /// On the spot, 60 degrees a second.
    Yaw,
    /// Another place in every frame.
    Teleport,
}

/// The camera of a frame.
fn camera<H: HeightField>(field: &H, scale: SceneScale, flight: Flight, frame: u32, rate_hz: f64) -> Result<Camera> {
    let grid = field.grid();
    let t_s = f64::from(frame) / rate_hz;
    let [x, y] = match flight {
        Flight::Teleport => [7, 13].map(|k| 0.15 + 0.7 * (synthetic::mix(u64::from(frame) * k) % 1000) as f64 / 1000.0),
        _ => [0.5, 0.3],
    };
    let posts = [x * f64::from(grid.nx()), y * f64::from(grid.ny())];
    let start = Posts::new(field).at(Post::new(posts[0] as u32, posts[1] as u32))?.z;
    let mut eye = scale.scene_from_grid(DVec3::new(posts[0], posts[1], start)) + DVec3::Z * (ABOVE_M + 600.0);
    if flight == Flight::Straight {
        eye += DVec3::Y * (SPEED_M_S * t_s);
    }
    let heading = match flight {
        Flight::Straight => 0.0,
        Flight::Yaw => YAW_RAD_S * t_s,
        Flight::Teleport => f64::from(frame),
    };
    // Up from looking down by 80 degrees, then around the vertical.
    let rotation = DQuat::from_rotation_z(-heading) * DQuat::from_rotation_x(80_f64.to_radians());
    let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
    Ok(Camera::new(eye, rotation.normalize(), projection, VIEWPORT_PX)?)
}

/// What one way did over a flight.
#[derive(Default)]
struct Series {
    ms: Vec<f64>,
    priorities: Vec<u64>,
    toggles: Vec<u64>,
    changed: Vec<usize>,
    bounds: Vec<u64>,
    meshes: Vec<Vec<(Post, f64)>>,
    bytes: usize,
    /// Frames in which more priorities were computed than 64 and 20 for each toggle.
    beyond: usize,
}

fn compare(terrain: &Arc<MemoryTerrain>, flight: Flight, triangles: u32, frames: u32, rate_hz: f64) -> Result<()> {
    let mut all: Vec<(&str, Series)> = Vec::new();
    for (name, options) in ways() {
        let mut series = Series::default();
        let mut mesh = ViewMesh::new(Arc::clone(terrain), terrain.scale())?;
        mesh.set_options(options);
        for frame in 0..frames {
            let camera = camera(&**terrain, terrain.scale(), flight, frame, rate_hz)?;
            let started = Instant::now();
            let report = mesh.update(&camera, Target::TriangleBudget(triangles), &[])?;
            series.add(started.elapsed().as_secs_f64() * 1e3, &report);
            series.bytes = mesh.memory_bytes();
            if frame % 25 == 0 {
                series.meshes.push(mesh.active_posts());
            }
        }
        if let Some((_, first)) = all.first()
            && (first.bounds != series.bounds || first.meshes != series.meshes)
        {
            return Err(format!("{name}: other meshes").into());
        }
        all.push((name, series));
    }
    let changed = all[0].1.changed.iter().map(|&posts| 200.0 * posts as f64 / f64::from(triangles)).collect();
    println!("\n{flight:?}, {triangles} triangles; {:.2} % of triangles change in a frame", middle(changed));
    let p95 = |series: &Series| percentile(&series.ms[1..], 0.95);
    let scratch = p95(&all[3].1);
    for (name, series) in &all {
        println!(
            "  {name:30} {:8.3} / {:7.3} / {:7.3}  1/{:5.1}; {:7} priorities, {:5} toggles, {:.2} us each; first {:5.1}; {:4} \
             B a triangle; {} frames over 64 + 20 a toggle",
            percentile(&series.ms[1..], 0.5),
            p95(series),
            percentile(&series.ms[1..], 1.0),
            scratch / p95(series),
            percentile(&series.priorities, 0.5),
            percentile(&series.toggles, 0.5),
            1e3 * series.ms[1..].iter().sum::<f64>() / series.toggles[1..].iter().sum::<u64>().max(1) as f64,
            series.ms[0],
            series.bytes / triangles as usize,
            series.beyond,
        );
    }
    Ok(())
}

impl Series {
    fn add(&mut self, ms: f64, report: &MeshReport) {
        let toggles = report.work.splits + report.work.merges;
        self.ms.push(ms);
        self.priorities.push(report.work.priorities);
        self.toggles.push(toggles);
        self.changed.push(report.added.len() + report.removed.len());
        self.bounds.push(report.bound_px.to_bits());
        self.beyond += usize::from(report.work.priorities > 64 + 20 * toggles);
    }
}

fn percentile<V: Copy + PartialOrd + Default>(values: &[V], share: f64) -> V {
    let mut sorted = values.to_vec();
    sorted.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    sorted.get(((sorted.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or_default()
}

fn middle(values: Vec<f64>) -> f64 {
    percentile(&values, 0.5)
}

/// How much greater the reported bound is than the greatest sampled distortion.
fn tightness(terrain: &Arc<MemoryTerrain>) -> Result<()> {
    let (grid, scale) = (terrain.grid(), terrain.scale());
    let mut posts = Posts::new(&**terrain);
    println!("\nreported bound / greatest distortion of {SAMPLES} posts, frames with a finite bound");
    for triangles in [3_000, 10_000, 100_000] {
        let mut mesh = ViewMesh::new(Arc::clone(terrain), scale)?;
        let mut factors = Vec::new();
        for frame in 0..12 {
            let camera = camera(&**terrain, scale, Flight::Teleport, frame, 60.0)?;
            let report = mesh.update(&camera, Target::TriangleBudget(triangles), &[])?;
            let mut greatest = 0.0_f64;
            for n in 0..SAMPLES {
                let at = |k: u64, size: u32| (synthetic::mix(u64::from(n) * 2 + k) % u64::from(size)) as u32;
                let p = Post::new(at(0, grid.nx()), at(1, grid.ny()));
                let finest = DVec3::new(f64::from(p.i), f64::from(p.j), posts.at(p)?.z);
                let drawn = DVec3::new(finest.x, finest.y, height_on(&mesh, p));
                let [finest, drawn] = [finest, drawn].map(|p| scale.scene_from_grid(p));
                greatest = greatest.max(camera.distortion(finest, drawn).unwrap_or(0.0));
            }
            if greatest > report.bound_px {
                return Err(format!("a distortion of {greatest} px above the bound {} px", report.bound_px).into());
            }
            if report.bound_px.is_finite() {
                factors.push(report.bound_px / greatest);
            }
        }
        let (count, greatest) = (factors.len(), percentile(&factors, 1.0));
        println!("  {triangles} triangles: median {:.2}, greatest {greatest:.2} of {count} frames", middle(factors));
    }
    Ok(())
}

/// Height of the mesh at a post of the grid.
fn height_on(mesh: &impl Mesh, p: Post) -> f64 {
    let at = |p: Post| (f64::from(p.i), f64::from(p.j));
    let area = |(ax, ay): (f64, f64), (bx, by): (f64, f64), (cx, cy): (f64, f64)| {
        (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    };
    let weights = |t: &Triangle| {
        let [a, b, c] = t.corners().map(at);
        [area(b, c, at(p)), area(c, a, at(p)), area(a, b, at(p))]
    };
    let holds = |t: &Triangle| weights(t).iter().all(|&w| w >= 0.0);
    let mut triangle = mesh.root().roots().into_iter().find(holds).expect("the roots cover the grid");
    while let Some(middle) = triangle.base_midpoint().filter(|&m| mesh.height(m).is_some()) {
        triangle = triangle.children(middle).into_iter().find(holds).expect("children cover their parent");
    }
    let weights = weights(&triangle);
    let heights = triangle.corners().map(|c| mesh.height(c).expect("corners are active"));
    let sum: f64 = weights.iter().zip(heights).map(|(w, z)| w * z).sum();
    sum / weights.iter().sum::<f64>()
}
