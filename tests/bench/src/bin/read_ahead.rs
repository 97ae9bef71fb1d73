//! What reading ahead of a moving view gains and costs: frames of a flight over a database that was just opened, its file out
//! of the system's cache, with a page cache that holds little more than one view; without reading ahead, and with the
//! thread that a server has for it. Frames are due 60 times a second; the meshes of both ways must be equal. Then, without
//! clocks and threads, how many pages frames have to read themselves when there is a look ahead after every eighth.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin read_ahead -- DATABASE [FRAMES] [TRIANGLES] [MIB]`. The
//! system's pages of the file are dropped by `dd` with `iflag=nocache`.

use std::{
    error::Error,
    path::Path,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions},
    roam::{Preview, Target, ViewMesh},
    service::{Lookout, ReadAhead},
    session::{Course, Pose},
    terrain::{HeightField, Posts},
    view::{Camera, Projection},
};
use sightline_bench::forget;
use sightline_proto::diamond::Post;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const RATE_HZ: f64 = 60.0;
/// How far ahead is read: a server's default.
const AHEAD: Duration = Duration::from_millis(250);
/// Frames between two looks ahead: half of that time.
const FRAMES_A_LOOK: usize = 8;

/// Speed in metres a second and turn in degrees a second.
const FLIGHTS: [(&str, f64, f64); 4] = [
    ("straight, 250 m/s", 250.0, 0.0),
    ("straight, 2500 m/s", 2500.0, 0.0),
    ("on the spot, 60 degrees a second", 0.0, 60.0),
    ("250 m/s and 20 degrees a second", 250.0, 20.0),
];

fn camera(pose: &Pose) -> Result<Camera> {
    let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
    Ok(Camera::new(pose.eye_m, pose.rotation, projection, [1280, 720])?)
}

/// What is flown, and how.
struct Flight<'a> {
    path: &'a Path,
    options: OpenOptions,
    poses: Vec<Pose>,
    target: Target,
}

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let path = Path::new(arguments.first().ok_or("name a database")?);
    let number = |n: usize, default: u32| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (frames, triangles, mib) = (number(1, 900)?, number(2, 10_000)?, number(3, 2)?);
    let options = OpenOptions { cache_bytes: (mib as usize) << 20 };
    println!("{frames} frames of {triangles} triangles at {RATE_HZ} Hz, a cache of {mib} MiB; the first frame apart");
    for (name, speed_m_s, turn) in FLIGHTS {
        let poses = poses(&Database::open(path, options)?, speed_m_s, turn.to_radians(), frames)?;
        let flight = Flight { path, options, poses, target: Target::TriangleBudget(triangles) };
        let (without, hashes) = flight.fly(false)?;
        let (with, others) = flight.fly(true)?;
        if hashes != others {
            return Err("meshes differ".into());
        }
        println!("{name}\n  as needed: {without}\n  ahead:     {with}");
        let [(frames, pages), (left, of_them)] = [flight.read_by_frames(false)?, flight.read_by_frames(true)?];
        println!("  frames that read: {frames}, {pages} pages; with looks ahead {left}, {of_them} pages");
    }
    Ok(())
}

/// A level flight 600 m above the ground where it begins.
fn poses(database: &Database, speed_m_s: f64, turn_rad_s: f64, frames: u32) -> Result<Vec<Pose>> {
    let (grid, scale) = (HeightField::grid(database), database.scale());
    let start = [grid.nx(), grid.ny()].map(|posts| f64::from(posts) * 0.31);
    let ground = Posts::new(database).at(Post::new(start[0] as u32, start[1] as u32))?.z;
    let mut eye_m = scale.scene_from_grid(DVec3::new(start[0], start[1], ground)) + DVec3::Z * 600.0;
    let mut heading = 0.3_f64;
    let mut poses = Vec::new();
    for _ in 0..frames {
        let rotation = DQuat::from_rotation_z(-heading) * DQuat::from_rotation_x(80_f64.to_radians());
        poses.push(Pose { eye_m, rotation: rotation.normalize() });
        heading += turn_rad_s / RATE_HZ;
        eye_m += DVec3::new(heading.sin(), heading.cos(), 0.0) * (speed_m_s / RATE_HZ);
    }
    Ok(poses)
}

impl Flight<'_> {
    /// Flies, and sums up what frames took; and what their meshes are, for comparison.
    fn fly(&self, is_read_ahead: bool) -> Result<(String, Vec<u64>)> {
        forget(self.path)?;
        let database = Arc::new(Database::open(self.path, self.options)?);
        let mut mesh = ViewMesh::new(Arc::clone(&database), database.scale())?;
        let ahead = is_read_ahead.then(|| ReadAhead::start(Arc::clone(&database), AHEAD, || false)).transpose()?;
        let lookout: Option<Lookout<Database>> = ahead.as_ref().map(ReadAhead::lookout);
        let mut course = Course::new(0.0, self.poses[0]);
        let (mut ms, mut hashes) = (Vec::new(), Vec::new());
        let began = Instant::now();
        for (n, pose) in self.poses.iter().enumerate() {
            let due = Duration::from_secs_f64(n as f64 / RATE_HZ);
            thread::sleep(due.saturating_sub(began.elapsed()));
            course.steer(1e3 * due.as_secs_f64(), *pose);
            let (camera, started) = (camera(pose)?, Instant::now());
            let report = mesh.update(&camera, self.target, &[])?;
            if let Some(lookout) = &lookout {
                lookout.tell(|| preview(&mesh, &course));
            }
            ms.push(started.elapsed().as_secs_f64() * 1e3);
            let sum =
                |posts: &[Post]| posts.iter().fold(0_u64, |all, p| all.wrapping_add(p.key().wrapping_mul(0x9e37)));
            hashes.push(sum(&report.added).wrapping_sub(sum(&report.removed)));
        }
        let cost = match ahead.map(|ahead| ahead.done()) {
            Some(done) => {
                let each = done.took.as_secs_f64() * 1e3 / done.looks.max(1) as f64;
                let share = done.took.as_secs_f64() / began.elapsed().as_secs_f64();
                let (looks, dropped) = (done.looks, done.dropped);
                format!("; {looks} looks ({dropped} dropped) of {each:.2} ms, {:.1} % of a core", 100.0 * share)
            }
            None => String::new(),
        };
        let first_ms = ms.remove(0);
        let own = ms.iter().sum::<f64>() / ms.len() as f64;
        ms.sort_by(f64::total_cmp);
        let at = |share: f64| ms[((ms.len() - 1) as f64 * share) as usize];
        let summary = format!(
            "mean {own:.3}, p50 {:.3}, p95 {:.3}, p99 {:.3}, max {:.3} ms; first {first_ms:.1} ms; {} pages{cost}",
            at(0.5),
            at(0.95),
            at(0.99),
            at(1.0),
            database.reads().pages
        );
        Ok((summary, hashes))
    }

    /// How many frames after the first one read pages, and how many.
    fn read_by_frames(&self, is_read_ahead: bool) -> Result<(u64, u64)> {
        let database = Arc::new(Database::open(self.path, self.options)?);
        let mut mesh = ViewMesh::new(Arc::clone(&database), database.scale())?;
        let mut course = Course::new(0.0, self.poses[0]);
        let (mut frames, mut pages) = (0, 0);
        for (n, pose) in self.poses.iter().enumerate() {
            course.steer(1e3 * n as f64 / RATE_HZ, *pose);
            let before = database.reads().pages;
            mesh.update(&camera(pose)?, self.target, &[])?;
            let read = database.reads().pages - before;
            if n > 0 {
                (frames, pages) = (frames + u64::from(read > 0), pages + read);
            }
            if is_read_ahead
                && n % FRAMES_A_LOOK == 0
                && let Some(mut preview) = preview(&mesh, &course)
            {
                preview.step(usize::MAX)?;
            }
        }
        Ok((frames, pages))
    }
}

/// A look at what the view will need.
fn preview(mesh: &ViewMesh<Database>, course: &Course) -> Option<Preview<Database>> {
    let pose = course.ahead(1e3 * AHEAD.as_secs_f64())?;
    Some(mesh.preview(camera(&pose).ok()?))
}
