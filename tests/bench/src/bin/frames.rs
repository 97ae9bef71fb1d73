//! Instructions of each frame of the preset flights, beside those of building the same mesh from scratch: the worst frame
//! of any flight, jump cuts included, must not cost much more. Instructions, since a busy machine does not change them.
//!
//! `cargo build --release --manifest-path tests/bench/Cargo.toml --bin frames`, then `frames DATABASE [TRIANGLES] [FRAMES]
//! [FLIGHT...]`. It runs itself under `valgrind --tool=callgrind` once for each flight and way, and reads what was counted
//! in each update: refinement, and the posts that came and went. Pages have been read by a flight before.

use std::{error::Error, path::Path, process::Command, sync::Arc};

use glam::DQuat;
use sightline::{
    database::{Database, OpenOptions},
    evaluate::flight::{PRESETS, Plan, Preset, Viewpoint},
    los,
    roam::{MeshError, MeshReport, Options, Target, ViewMesh},
    view::{Camera, Projection},
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const RATE_HZ: f64 = 60.0;
const VIEWPORT_PX: [u32; 2] = [1280, 720];
/// What a run under callgrind is told before its arguments.
const COUNTED: &str = "--counted";

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|first| first == COUNTED) {
        return fly(&arguments[1..]);
    }
    let database = arguments.first().ok_or("the path of a database, please")?;
    let or = |n: usize, default: &str| arguments.get(n).cloned().unwrap_or_else(|| default.into());
    let (triangles, frames) = (or(1, "3000"), or(2, "40"));
    let mut flights: Vec<String> = arguments.iter().skip(3).cloned().collect();
    if flights.is_empty() {
        flights = PRESETS.iter().map(|preset| preset.name().to_owned()).collect();
    }
    println!("{triangles} triangles, {frames} frames; instructions of a frame in millions, without the first");
    for flight in flights {
        let count = |way: &str| counted(&[database, &flight, &triangles, &frames, way]);
        let (ours, scratch) = (count("ours")?, count("scratch")?);
        // A view that stands still costs nothing either way.
        let moved = ours.iter().zip(&scratch).filter(|&(_, &b)| b > 0.0);
        let ratios: Vec<_> = moved.map(|(&a, &b)| a / b).collect();
        println!(
            "  {flight:18} ours {:7.3} median {:7.3} greatest; scratch {:7.3} median {:7.3} greatest; ratio {:.3} \
             median {:.3} greatest",
            share(&ours, 0.5),
            share(&ours, 1.0),
            share(&scratch, 0.5),
            share(&scratch, 1.0),
            share(&ratios, 0.5),
            share(&ratios, 1.0),
        );
    }
    Ok(())
}

fn share(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(((sorted.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN)
}

/// Millions of instructions of each update but the first of a run under callgrind.
fn counted(arguments: &[&str]) -> Result<Vec<f64>> {
    let folder = std::env::temp_dir().join(format!("frames-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let status = Command::new("valgrind")
        .args(["--tool=callgrind", "--quiet", "--toggle-collect=frames::counted_update*"])
        .arg("--dump-before=frames::next_frame*")
        .arg(format!("--callgrind-out-file={}", folder.join("out").display()))
        .arg(std::env::current_exe()?)
        .arg(COUNTED)
        .args(arguments)
        .status()?;
    if !status.success() {
        return Err(format!("valgrind ended with {status}").into());
    }
    // The first file is of what came before the first frame, and that of the last frame has no number.
    let numbered = (1..).map(|n| folder.join(format!("out.{n}"))).take_while(|path| path.exists());
    let mut counts = Vec::new();
    for path in numbered.chain([folder.join("out")]) {
        let dump = std::fs::read_to_string(path)?;
        let total = dump.lines().find_map(|line| line.strip_prefix("totals: ")).ok_or("a dump without totals")?;
        counts.push(total.trim().parse::<f64>()? / 1e6);
    }
    std::fs::remove_dir_all(&folder)?;
    if counts.len() < 3 { Err("callgrind counted no update".into()) } else { Ok(counts.split_off(2)) }
}

fn fly(arguments: &[String]) -> Result<()> {
    let [database, flight, triangles, frames, way] = arguments else { return Err("five arguments".into()) };
    let database = Arc::new(Database::open(Path::new(database), OpenOptions::default())?);
    let cameras = cameras(&database, flight.parse()?, frames.parse()?)?;
    let target = Target::TriangleBudget(triangles.parse()?);
    let mut before = ViewMesh::new(Arc::clone(&database), database.scale())?;
    for camera in &cameras {
        before.update(camera, target, &[])?;
    }
    let mut mesh = ViewMesh::new(Arc::clone(&database), database.scale())?;
    mesh.set_options(Options { incremental: way != "scratch", ..Options::default() });
    for (frame, camera) in cameras.iter().enumerate() {
        next_frame(frame);
        std::hint::black_box(counted_update(&mut mesh, camera, target)?);
    }
    Ok(())
}

/// Tells callgrind to put what it counted into a file of its own.
#[inline(never)]
fn next_frame(frame: usize) {
    std::hint::black_box(frame);
}

/// What is counted.
#[inline(never)]
fn counted_update(
    mesh: &mut ViewMesh<Database>,
    camera: &Camera,
    target: Target,
) -> std::result::Result<MeshReport, MeshError> {
    mesh.update(camera, target, &[])
}

fn cameras(database: &Database, flight: Preset, frames: usize) -> Result<Vec<Camera>> {
    let (grid, scale) = (database.grid(), database.scale());
    let last = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
    let area_m = [[0.0; 2], [last[0] * scale.east_m, last[1] * scale.north_m]];
    let plan = Plan::preset(flight, area_m, frames, RATE_HZ, 1)?;
    let mut ground_m = Vec::new();
    for [x, y] in plan.ground_points() {
        let (x, y) = ((x / scale.east_m).clamp(0.0, last[0]), (y / scale.north_m).clamp(0.0, last[1]));
        ground_m.push(los::surface_height(database, x, y)?.unwrap_or(0.0) * scale.up_m);
    }
    plan.fly(&ground_m)?.iter().map(camera).collect()
}

fn camera(viewpoint: &Viewpoint) -> Result<Camera> {
    let [x, y, z, w] = viewpoint.rotation;
    let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
    Ok(Camera::new(viewpoint.eye, DQuat::from_xyzw(x, y, z, w), projection, VIEWPORT_PX)?)
}
