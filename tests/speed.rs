//! Not guards but measurements: `cargo test --release --test speed -- --ignored --nocapture`.

use std::{ops::ControlFlow, sync::Arc, time::Instant};

use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions},
    los::{self, Earth, Lines, Options, Region, Verdict, View, viewshed},
    roam::{Fidelity, MeshReport, RequiredLine, Target, ViewMesh},
    terrain::{HeightField, PAGE_SIDE, SceneScale, synthetic},
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
    let (mut required, mut named) = (0_u64, 0);
    let start = Instant::now();
    mesh.update(&camera(terrain, 0), Target::TriangleBudget(triangles), lines).unwrap();
    let first = start.elapsed();
    for frame in 1..=100 {
        let start = Instant::now();
        last = mesh.update(&camera(terrain, frame), Target::TriangleBudget(triangles), lines).unwrap();
        times.push(start.elapsed());
        required += u64::from(last.required);
        named += last.unsatisfied.len();
    }
    times.sort();
    println!(
        "{triangles} triangles, {} lines: first {first:?}, median {:?}, p95 {:?}; required {} a frame, named {named}, \
         last: {} triangles, bound {:.2} px, {:?}",
        lines.len(),
        times[50],
        times[95],
        required / 100,
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

/// A viewshed of a million posts around `at` on one core, beside a query of its own for each cell; all are compared.
fn look_around(field: &impl HeightField, at: [f64; 2], above: f64, target_height: f64) {
    let Some(z) = los::on_ground(field, at[0], at[1], above).unwrap() else { return };
    let around = |v: f64| [(v as u32).saturating_sub(500), v as u32 + 499];
    let region = Region::Rectangle { i: around(at[0]), j: around(at[1]) };
    let view = View { observer: [at[0], at[1], z], target_height, region, strict: false, earth: Earth::Flat };
    let mut tiles = Vec::new();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let start = Instant::now();
    let summary = pool.install(|| {
        viewshed(field, &view, |tile, _| {
            tiles.push(tile);
            ControlFlow::Continue(())
        })
    });
    let (summary, swept) = (summary.unwrap(), start.elapsed());
    let mut lines = Lines::new(field);
    let mut wrong = 0;
    let start = Instant::now();
    for tile in &tiles {
        for (n, verdict) in (0..).zip(&tile.cells) {
            let Some(verdict) = verdict else { continue };
            let [x, y] =
                [tile.page.pi * PAGE_SIDE + n % PAGE_SIDE, tile.page.pj * PAGE_SIDE + n / PAGE_SIDE].map(f64::from);
            let own = match los::on_ground(field, x, y, target_height).unwrap() {
                Some(z) => lines.ask(view.observer, [x, y, z], Options::default()).unwrap().verdict,
                None => Verdict::Unknown,
            };
            wrong += u32::from(own != *verdict);
        }
    }
    let cells = (summary.visible + summary.blocked + summary.unknown) as f64;
    println!(
        "{cells} cells from {at:?}: {:.1} ns a cell, {:.2} % asked, {:.1} % visible; queries of their own {:.0} ns; {wrong} wrong",
        swept.as_nanos() as f64 / cells,
        100.0 * summary.asked as f64 / cells,
        100.0 * summary.visible as f64 / cells,
        start.elapsed().as_nanos() as f64 / cells,
    );
    assert_eq!(wrong, 0);
}

#[test]
#[ignore = "needs half a minute, or a database named by SIGHTLINE_DATABASE; prints times of viewsheds"]
fn viewsheds_of_a_million_posts() {
    let heights = [(2.0, 2.0), (2.0, 0.0), (300.0, 0.0)];
    if let Some(path) = std::env::var_os("SIGHTLINE_DATABASE") {
        let terrain = Database::open(path.as_ref(), OpenOptions::default()).unwrap();
        let grid = HeightField::grid(&terrain);
        for (n, (above, target)) in (0..).zip(heights.repeat(2)) {
            let at = |posts: u32, k: u64| 500.0 + f64::from(posts - 1000) * unit(2 * n + k);
            look_around(&terrain, [at(grid.nx(), 0), at(grid.ny(), 1)], above, target);
        }
    } else {
        let terrain = synthetic::fractal(1001, 1001, 1, 1000).unwrap();
        for (above, target) in heights {
            look_around(&terrain, [500.3, 500.7], above, target);
        }
    }
}
