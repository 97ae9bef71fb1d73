//! Not guards but measurements: `cargo test --release --test speed -- --ignored --nocapture`.

use std::{sync::Arc, time::Instant};

use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions},
    los::{self, Verdict},
    roam::{Fidelity, MeshReport, RequiredLine, Target, ViewMesh},
    terrain::{HeightField, SceneScale, synthetic},
    view::{Camera, Projection},
    wedgie::BoundsPyramid,
};
use sightline_proto::verdict::MeshVerdict;

const SCALE: SceneScale = SceneScale { east_m: 74.0, north_m: 92.5, up_m: 1.0 };

#[test]
#[ignore = "needs half a minute; prints how long all bounds of SIGHTLINE_SIDE (4097) posts squared take"]
fn bounds_of_a_large_terrain() {
    let side = std::env::var("SIGHTLINE_SIDE").map_or(4097, |s| s.parse().expect("SIGHTLINE_SIDE is a whole number"));
    let field = synthetic::fractal(side, side, 1, 4000).unwrap();
    let start = Instant::now();
    let pyramid = BoundsPyramid::compute(&field, SCALE).unwrap();
    println!("{:?} for {} lattices of {side} x {side} posts", start.elapsed(), pyramid.lattices().len());
}

/// A number in [0, 1) that depends on `n` only.
fn unit(n: u64) -> f64 {
    (synthetic::mix(n) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Lines between points 2 m above ground, up to `reach` posts apart in each direction, around the middle of the grid.
fn ground_lines(terrain: &Database, count: u64, reach: f64) -> Vec<RequiredLine> {
    let grid = HeightField::grid(terrain);
    let middle = [f64::from(grid.nx()) / 2.0, f64::from(grid.ny()) / 2.0];
    let mut lines = Vec::new();
    for n in 0.. {
        if lines.len() as u64 == count {
            break;
        }
        let x = middle[0] + 400.0 * (unit(10 * n) - 0.5);
        let y = middle[1] + 400.0 * (unit(10 * n + 1) - 0.5);
        let (dx, dy) = (2.0 * reach * (unit(10 * n + 2) - 0.5), 2.0 * reach * (unit(10 * n + 3) - 0.5));
        let ends = [(x, y), (x + dx, y + dy)].map(|(x, y)| {
            let z = los::on_ground(terrain, x, y, 2.0).unwrap()?;
            Some([x, y, z])
        });
        let [Some(a), Some(b)] = ends else { continue };
        let verdict = match los::line_of_sight(terrain, a, b, los::Options::default()).unwrap().verdict {
            Verdict::Visible => MeshVerdict::Visible,
            Verdict::Blocked => MeshVerdict::Blocked,
            Verdict::Unknown => continue,
        };
        // As a scenario has it: a quarter visible at least.
        let visible = lines.iter().filter(|l: &&RequiredLine| l.verdict == Some(MeshVerdict::Visible)).count();
        if verdict == MeshVerdict::Blocked && 4 * visible < lines.len() {
            continue;
        }
        lines.push(RequiredLine { id: n, a, b, verdict: Some(verdict), fidelity: Fidelity::Verdict, priority: 0 });
    }
    lines
}

fn camera(terrain: &Database, frame: u32) -> Camera {
    let grid = HeightField::grid(terrain);
    let scale = terrain.scale();
    let ground = los::on_ground(terrain, f64::from(grid.nx() / 2), f64::from(grid.ny() / 2), 0.0).unwrap().unwrap();
    let at = DVec3::new(f64::from(grid.nx() / 2), f64::from(grid.ny() / 2), ground + 600.0 / scale.up_m);
    let eye = scale.scene_from_grid(at) + DVec3::Y * (250.0 / 30.0 * f64::from(frame) - 5000.0);
    // Looking north and a little down: the camera's y axis is turned up by 80 degrees about x.
    let (sin, cos) = (0.642_787_609_686_539_4, 0.766_044_443_118_978);
    let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
    Camera::new(eye, DQuat::from_xyzw(sin, 0.0, 0.0, cos), projection, [1280, 720]).unwrap()
}

fn fly(terrain: &Arc<Database>, triangles: u32, lines: &[RequiredLine]) {
    let mut mesh = ViewMesh::new(Arc::clone(terrain), terrain.scale()).unwrap();
    let mut times = Vec::new();
    let mut last = MeshReport::default();
    let (mut stolen, mut named) = (0_u64, 0);
    let start = Instant::now();
    mesh.update(&camera(terrain, 0), Target::TriangleBudget(triangles), lines).unwrap();
    let first = start.elapsed();
    for frame in 1..=100 {
        let start = Instant::now();
        last = mesh.update(&camera(terrain, frame), Target::TriangleBudget(triangles), lines).unwrap();
        times.push(start.elapsed());
        stolen += u64::from(last.stolen);
        named += last.unsatisfied.len();
    }
    times.sort();
    println!(
        "{triangles} triangles, {} lines: first {first:?}, median {:?}, p95 {:?}; stolen {} a frame, named {named}, \
         last: {} triangles, bound {:.2} px, {:?}",
        lines.len(),
        times[50],
        times[95],
        stolen / 100,
        last.triangles,
        last.bound_px,
        last.work,
    );
}

#[test]
#[ignore = "needs a database, named by SIGHTLINE_DATABASE; prints times of frames"]
fn frames_over_a_database() {
    let path = std::env::var_os("SIGHTLINE_DATABASE").expect("SIGHTLINE_DATABASE names a database");
    let terrain = Arc::new(Database::open(path.as_ref(), OpenOptions::default()).unwrap());
    for (count, reach) in [(0, 0.0), (100, 100.0), (200, 100.0)] {
        let lines = ground_lines(&terrain, count, reach);
        for triangles in [1000, 3000, 10_000, 30_000] {
            fly(&terrain, triangles, &lines);
        }
    }
}
