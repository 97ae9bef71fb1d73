//! Whether it pays to read ahead of a moving view: frames of a flight over a database that was just opened, its file out of
//! the system's cache, with a page cache that holds little more than one view; as it is, and with a thread beside it that
//! refines another mesh for where the view will be, from its last two poses, so that its pages are there when they are
//! needed. Frames are due 60 times a second; the meshes of both ways must be equal.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin read_ahead -- DATABASE [FRAMES] [TRIANGLES]`. The
//! system's pages of the file are dropped by `dd` with `iflag=nocache`.

use std::{
    error::Error,
    path::Path,
    process::Command,
    sync::{
        Arc,
        mpsc::{Receiver, TryRecvError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions},
    roam::{Target, ViewMesh},
    terrain::{HeightField, Posts},
    view::{Camera, Projection},
};
use sightline_proto::diamond::Post;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const RATE_HZ: f64 = 60.0;
/// How far ahead the other mesh is made.
const AHEAD_S: f64 = 0.25;
const CACHE: OpenOptions = OpenOptions { cache_bytes: 2 << 20 };

/// Speed in metres a second and turn in degrees a second.
const FLIGHTS: [(&str, f64, f64); 4] = [
    ("straight, 250 m/s", 250.0, 0.0),
    ("straight, 2500 m/s", 2500.0, 0.0),
    ("on the spot, 60 degrees a second", 0.0, 60.0),
    ("250 m/s and 20 degrees a second", 250.0, 20.0),
];

/// Where a view is and which way it looks.
#[derive(Clone, Copy)]
struct Pose {
    eye_m: DVec3,
    heading: f64,
}

impl Pose {
    fn camera(&self) -> Result<Camera> {
        let rotation = DQuat::from_rotation_z(-self.heading) * DQuat::from_rotation_x(80_f64.to_radians());
        let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
        Ok(Camera::new(self.eye_m, rotation.normalize(), projection, [1280, 720])?)
    }

    /// Where it is so many seconds after two poses a frame apart, if it goes on so.
    fn ahead(before: &Self, now: &Self, seconds: f64) -> Self {
        let steps = seconds * RATE_HZ;
        Self {
            eye_m: now.eye_m + (now.eye_m - before.eye_m) * steps,
            heading: now.heading + (now.heading - before.heading) * steps,
        }
    }
}

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let path = Path::new(arguments.first().ok_or("name a database")?);
    let number = |n: usize, default: u32| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (frames, triangles) = (number(1, 900)?, number(2, 10_000)?);
    println!(
        "{frames} frames of {triangles} triangles at {RATE_HZ} Hz, a cache of {} MiB; the first frame apart",
        CACHE.cache_bytes >> 20
    );
    for (name, speed_m_s, turn) in FLIGHTS {
        let poses = flight(path, speed_m_s, turn.to_radians(), frames)?;
        let (without, hashes) = fly(path, &poses, triangles, false)?;
        let (with, others) = fly(path, &poses, triangles, true)?;
        if hashes != others {
            return Err("meshes differ".into());
        }
        println!("{name}\n  as it is:   {without}\n  read ahead: {with}");
    }
    Ok(())
}

/// A level flight 600 m above the ground where it begins.
fn flight(path: &Path, speed_m_s: f64, turn_rad_s: f64, frames: u32) -> Result<Vec<Pose>> {
    let database = Database::open(path, CACHE)?;
    let (grid, scale) = (HeightField::grid(&database), database.scale());
    let start = [grid.nx(), grid.ny()].map(|posts| f64::from(posts) * 0.31);
    let ground = Posts::new(&database).at(Post::new(start[0] as u32, start[1] as u32))?.z;
    let mut pose = Pose { eye_m: scale.scene_from_grid(DVec3::new(start[0], start[1], ground)), heading: 0.3 };
    pose.eye_m.z += 600.0;
    let mut poses = Vec::new();
    for _ in 0..frames {
        poses.push(pose);
        pose.heading += turn_rad_s / RATE_HZ;
        pose.eye_m += DVec3::new(pose.heading.sin(), pose.heading.cos(), 0.0) * (speed_m_s / RATE_HZ);
    }
    Ok(poses)
}

/// Flies, and sums up what frames took; and what their meshes are, for comparison.
fn fly(path: &Path, poses: &[Pose], triangles: u32, ahead: bool) -> Result<(String, Vec<u64>)> {
    forget(path)?;
    let database = Arc::new(Database::open(path, CACHE)?);
    let (scale, target) = (database.scale(), Target::TriangleBudget(triangles));
    let mut mesh = ViewMesh::new(Arc::clone(&database), scale)?;
    let (teller, told) = channel();
    let scout = ahead.then(|| {
        let database = Arc::clone(&database);
        thread::spawn(move || scout(database, target, &told).map_err(|e| e.to_string()))
    });
    let (mut ms, mut hashes, mut reading) = (Vec::new(), Vec::new(), 0);
    let mut first_ms = 0.0;
    let began = Instant::now();
    for (n, pose) in poses.iter().enumerate() {
        let due = Duration::from_secs_f64(n as f64 / RATE_HZ);
        thread::sleep(due.saturating_sub(began.elapsed()));
        let camera = pose.camera()?;
        let (reads, started) = (database.reads().pages, Instant::now());
        let report = mesh.update(&camera, target, &[])?;
        let took_ms = started.elapsed().as_secs_f64() * 1e3;
        if n == 0 {
            first_ms = took_ms;
        } else {
            ms.push(took_ms);
            reading += u32::from(database.reads().pages > reads);
            if ahead {
                teller.send(Pose::ahead(&poses[n - 1], pose, AHEAD_S))?;
            }
        }
        let sum = |posts: &[Post]| posts.iter().fold(0_u64, |all, p| all.wrapping_add(p.key().wrapping_mul(0x9e37)));
        hashes.push(sum(&report.added).wrapping_sub(sum(&report.removed)));
    }
    drop(teller);
    let cost = match scout {
        Some(scout) => format!("; beside it {:.2} ms a frame", scout.join().map_err(|_| "the thread panicked")??),
        None => format!("; {reading} frames read"),
    };
    ms.sort_by(f64::total_cmp);
    let at = |share: f64| ms[((ms.len() - 1) as f64 * share) as usize];
    let summary = format!(
        "p50 {:.3}, p95 {:.3}, p99 {:.3}, max {:.3} ms; first {first_ms:.1} ms; {} pages{cost}",
        at(0.5),
        at(0.95),
        at(0.99),
        at(1.0),
        database.reads().pages
    );
    Ok((summary, hashes))
}

/// Makes meshes for the newest pose that it is told; the milliseconds that it takes for each pose told.
fn scout(database: Arc<Database>, target: Target, told: &Receiver<Pose>) -> Result<f64> {
    let scale = database.scale();
    let mut mesh = ViewMesh::new(database, scale)?;
    let (mut poses, mut took) = (0_u32, Duration::ZERO);
    while let Ok(mut pose) = told.recv() {
        poses += 1;
        loop {
            match told.try_recv() {
                Ok(newer) => (pose, poses) = (newer, poses + 1),
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => break,
            }
        }
        let (camera, started) = (pose.camera()?, Instant::now());
        mesh.update(&camera, target, &[])?;
        took += started.elapsed();
    }
    Ok(took.as_secs_f64() * 1e3 / f64::from(poses.max(1)))
}

/// Has the system drop what it keeps of a file.
fn forget(path: &Path) -> Result<()> {
    let mut file = std::ffi::OsString::from("if=");
    file.push(path);
    let done = Command::new("dd").arg(file).args(["iflag=nocache", "count=0", "status=none"]).status()?;
    if done.success() { Ok(()) } else { Err(format!("dd ended with {done}").into()) }
}
