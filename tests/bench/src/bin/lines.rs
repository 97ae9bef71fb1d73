//! What sight lines cost a mesh: triangles stolen by visible and by blocked lines, time of a frame while everything moves
//! and while nothing does, what plain meshes get wrong. Every answer is checked exactly on the mesh that was delivered.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin lines -- [DATABASE|-] [SIDE] [FRAMES] [SECONDS [TICKS]]`: the
//! north-eastern SIDE x SIDE posts (4097) of a database, or a synthetic terrain; third-party lines up to 10 km between
//! entities 2 m above ground that drive in circles at 20 m/s, seen from a camera that flies at 250 m/s, 30 ticks a second.
//! With SECONDS, one more run of so long a simulated time, one frame in so many TICKS, shows whether requirements grow.

use std::{error::Error, ops::ControlFlow, path::Path, sync::Arc};

use cpu_time::ThreadTime;
use glam::{DQuat, DVec3};
use sightline::{
    database::{Database, OpenOptions},
    los,
    roam::{Fidelity, RequiredLine, Target, ViewMesh},
    terrain::{HeightField, Posts, SceneScale, synthetic},
    view::{Camera, Projection},
    wedgie::MemoryTerrain,
};
use sightline_proto::{
    diamond::Post,
    mesh::Mesh,
    verdict::{MeshVerdict, for_each_triangle_met, passes_below, verdict_on_mesh},
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const HZ: f64 = 30.0;
const VIEWER_M_S: f64 = 250.0;
const ENTITY_M_S: f64 = 20.0;
const LONGEST_M: f64 = 10_000.0;
const ABOVE_M: f64 = 2.0;
/// Frames between two that are compared with the plain mesh and with meshes of one kind of lines.
const SAMPLE_EVERY: u32 = 25;

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let number = |n: usize, default: u32| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (side, frames, seconds, ticks) = (number(1, 4097)?, number(2, 100)?, number(3, 0)?, number(4, 1)?.max(1));
    let terrain = match arguments.first().filter(|path| *path != "-") {
        Some(path) => cut(Path::new(path), side)?,
        None => {
            let scale = SceneScale { east_m: 90.0, north_m: 90.0, up_m: 1.0 };
            MemoryTerrain::new(synthetic::fractal(side, side, 1, 2500)?, scale)?
        }
    };
    let world = World { terrain: Arc::new(terrain) };
    if let Some(count) = std::env::var("LINES").ok().and_then(|n| n.parse().ok()) {
        let budget = std::env::var("BUDGET").ok().and_then(|n| n.parse().ok()).unwrap_or(30_000);
        return world.only(count, budget, frames);
    }
    println!("{frames} frames at {HZ} Hz, one core; ms of processor time of a frame: median / 95 % / greatest");
    println!(
        " lines budget | visible covered | plain wrong, third party / viewer | stolen a line: all, visible, blocked | \
         held      | all move               camera moves           nothing moves"
    );
    let (mut checked, mut named) = (0, 0);
    for count in [100, 1000] {
        for budget in [3_000, 10_000, 30_000] {
            let row = world.row(count, budget, frames)?;
            (checked, named) = (checked + row.checked, named + row.named);
        }
    }
    println!("{checked} line-frames checked, 0 silent, {named} named");
    if seconds > 0 {
        world.growth(100, 3_000, seconds, ticks)?;
    }
    Ok(())
}

/// The north-east of a database, with its bounds.
fn cut(path: &Path, side: u32) -> Result<MemoryTerrain> {
    let database = Database::open(path, OpenOptions::default())?;
    Ok(MemoryTerrain::new(sightline_bench::north_east(&database, side)?, database.scale())?)
}

struct World {
    terrain: Arc<MemoryTerrain>,
}

/// A number in [0, 1) that depends on `n` only.
fn unit(n: u64) -> f64 {
    (synthetic::mix(n) >> 11) as f64 / (1_u64 << 53) as f64
}

fn is_visible(line: &RequiredLine) -> bool {
    line.verdict == Some(MeshVerdict::Visible)
}

#[derive(Default)]
struct Row {
    moving: Vec<f64>,
    turning: Vec<f64>,
    still: Vec<f64>,
    lines: u64,
    visible: u64,
    covered: u64,
    plain: [u64; 2],
    plain_wrong: [u64; 2],
    stolen: [u64; 3],
    asked: [u64; 3],
    checked: u64,
    named: u64,
}

impl World {
    fn camera(&self, tick: f64) -> Result<Camera> {
        let (grid, scale) = (self.terrain.grid(), self.terrain.scale());
        let posts = [0.5 * f64::from(grid.nx()), 0.3 * f64::from(grid.ny())];
        let ground = Posts::new(&*self.terrain).at(Post::new(posts[0] as u32, posts[1] as u32))?.z;
        // Back and forth over 100 km, so that an hour does not leave the map.
        let way = (VIEWER_M_S * tick / HZ) % 200_000.0;
        let way = if way < 100_000.0 { way } else { 200_000.0 - way };
        let eye = scale.scene_from_grid(DVec3::new(posts[0], posts[1], ground)) + DVec3::new(0.0, way, 1500.0);
        let projection = Projection::Perspective { tan_half_fov: 0.577, near_m: 1.0 };
        Ok(Camera::new(eye, DQuat::from_rotation_x(80_f64.to_radians()).normalize(), projection, [1280, 720])?)
    }

    /// An end, driving around in a circle.
    fn end(&self, plan_m: [f64; 2], n: u64, tick: f64) -> Result<Option<[f64; 3]>> {
        let (grid, scale) = (self.terrain.grid(), self.terrain.scale());
        let radius_m = 300.0 + 2000.0 * unit(n + 3);
        let angle = std::f64::consts::TAU * unit(n + 4) + ENTITY_M_S / radius_m * tick / HZ;
        let (x, y) =
            ((plan_m[0] + radius_m * angle.cos()) / scale.east_m, (plan_m[1] + radius_m * angle.sin()) / scale.north_m);
        let (x, y) = (x.clamp(0.0, f64::from(grid.nx() - 1)), y.clamp(0.0, f64::from(grid.ny() - 1)));
        Ok(los::on_ground(&*self.terrain, x, y, ABOVE_M / scale.up_m)?.map(|z| [x, y, z]))
    }

    /// The lines of a tick; `from` is where they all begin, or `None` for lines between entities.
    fn lines(&self, count: u64, tick: f64, from: Option<[f64; 3]>) -> Result<Vec<RequiredLine>> {
        let (grid, scale) = (self.terrain.grid(), self.terrain.scale());
        let size_m = [f64::from(grid.nx() - 1) * scale.east_m, f64::from(grid.ny() - 1) * scale.north_m];
        let mut lines = Vec::new();
        for id in 0..count {
            let n = id * 1000;
            let start = match from {
                Some([x, y, _]) => [x * scale.east_m, y * scale.north_m],
                None => [unit(n) * size_m[0], unit(n + 1) * size_m[1]],
            };
            let (length_m, heading) = (LONGEST_M * unit(n + 10).sqrt(), std::f64::consts::TAU * unit(n + 11));
            let other = [start[0] + length_m * heading.cos(), start[1] + length_m * heading.sin()];
            let a = if from.is_some() { from } else { self.end(start, n + 100, tick)? };
            let (Some(a), Some(b)) = (a, self.end(other, n + 200, tick)?) else { continue };
            let verdict = los::line_of_sight(&*self.terrain, a, b, los::Options::default())?.verdict.on_mesh();
            lines.push(RequiredLine { id, a, b, verdict, fidelity: Fidelity::Verdict, priority: 0 });
        }
        Ok(lines)
    }

    fn row(&self, count: u64, budget: u32, frames: u32) -> Result<Row> {
        let target = Target::TriangleBudget(budget);
        let mut row = Row::default();
        let mut mesh = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
        for frame in 0..frames {
            let tick = f64::from(frame);
            let (camera, lines) = (self.camera(tick)?, self.lines(count, tick, None)?);
            row.moving.push(timed(|| mesh.update(&camera, target, &lines).map(drop))?);
            let named = mesh.update(&camera, target, &lines)?.unsatisfied;
            row.check(&mesh, &lines, &named)?;
            if frame % SAMPLE_EVERY == SAMPLE_EVERY / 2 {
                let eye = self.terrain.scale().grid_from_scene(camera.eye().unwrap_or_default()).to_array();
                let viewer = self.lines(count.min(200), tick, Some(eye))?;
                self.sample(&mut row, &mesh, &camera, target, &lines, &viewer)?;
            }
        }
        let lines = self.lines(count, f64::from(frames), None)?;
        for frame in 0..frames {
            let camera = self.camera(f64::from(frame))?;
            row.turning.push(timed(|| mesh.update(&camera, target, &lines).map(drop))?);
            let named = mesh.update(&camera, target, &lines)?.unsatisfied;
            row.check(&mesh, &lines, &named)?;
        }
        let camera = self.camera(0.0)?;
        mesh.update(&camera, target, &lines)?;
        for _ in 0..frames {
            let mut report = None;
            row.still.push(timed(|| mesh.update(&camera, target, &lines).map(|found| report = Some(found)))?);
            if report.is_none_or(|r| !r.added.is_empty() || !r.removed.is_empty()) {
                return Err("a frame in which nothing moved changed the mesh".into());
            }
        }
        row.print(count, budget);
        Ok(row)
    }

    /// What plain meshes get wrong, and what lines of each kind steal by themselves.
    fn sample(
        &self,
        row: &mut Row,
        mesh: &ViewMesh<MemoryTerrain>,
        camera: &Camera,
        target: Target,
        lines: &[RequiredLine],
        viewer: &[RequiredLine],
    ) -> Result<()> {
        let mut plain = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
        plain.update(camera, target, &[])?;
        for (kind, lines) in [lines, viewer].into_iter().enumerate() {
            for line in lines.iter().filter(|line| line.verdict.is_some()) {
                row.plain[kind] += 1;
                row.plain_wrong[kind] += u64::from(Some(verdict_on_mesh(&plain, line.a, line.b)) != line.verdict);
            }
        }
        row.stolen[0] += stolen(mesh, &plain);
        row.asked[0] += lines.iter().filter(|line| line.verdict.is_some()).count() as u64;
        for (kind, visible) in [(1, true), (2, false)] {
            let some: Vec<_> =
                lines.iter().filter(|l| l.verdict.is_some() && is_visible(l) == visible).copied().collect();
            let mut alone = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
            alone.update(camera, target, &some)?;
            row.stolen[kind] += stolen(&alone, &plain);
            row.asked[kind] += some.len() as u64;
        }
        row.covered += lines.iter().filter(|l| !is_visible(l) && blocked_at_an_end_only(mesh, l)).count() as u64;
        row.lines += lines.len() as u64;
        row.visible += lines.iter().filter(|l| is_visible(l)).count() as u64;
        Ok(())
    }

    /// One configuration, moving, for instruction counts: `perf stat -e instructions:u`, with LINES and BUDGET set.
    fn only(&self, count: u64, budget: u32, frames: u32) -> Result<()> {
        let mut mesh = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
        let mut ms = Vec::new();
        let mut inputs = Vec::new();
        for frame in 0..frames {
            inputs.push((self.camera(f64::from(frame))?, self.lines(count, f64::from(frame), None)?));
        }
        // The updates alone are left out of counts when UPDATES is 0: the difference is theirs.
        let repeat = std::env::var("UPDATES").ok().and_then(|n| n.parse().ok()).unwrap_or(1);
        for _ in 0..repeat {
            for (camera, lines) in &inputs {
                ms.push(timed(|| mesh.update(camera, Target::TriangleBudget(budget), lines).map(drop))?);
            }
        }
        println!("{}", spread(&ms));
        Ok(())
    }

    /// How much is required, minute by minute.
    fn growth(&self, count: u64, budget: u32, seconds: u32, ticks: u32) -> Result<()> {
        let step_s = f64::from(ticks) / HZ;
        println!(
            "\n{count} moving lines, {budget} triangles, {seconds} s by {step_s:.3} s: stolen, and by a mesh made anew"
        );
        let target = Target::TriangleBudget(budget);
        let mut mesh = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
        let mut row = Row::default();
        let (last, mut next) = (seconds * HZ as u32, 0);
        for frame in (0..=last).step_by(ticks as usize) {
            let (camera, lines) = (self.camera(frame.into())?, self.lines(count, frame.into(), None)?);
            let named = mesh.update(&camera, target, &lines)?.unsatisfied;
            row.check(&mesh, &lines, &named)?;
            if frame >= next {
                next += last / 12;
                let mut plain = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
                plain.update(&camera, target, &[])?;
                let mut anew = ViewMesh::new(Arc::clone(&self.terrain), self.terrain.scale())?;
                anew.update(&camera, target, &lines)?;
                println!("  {:5.0} s {:6} {:6}", f64::from(frame) / HZ, stolen(&mesh, &plain), stolen(&anew, &plain));
            }
        }
        println!("  {} line-frames, 0 silent, {} named", row.checked, row.named);
        Ok(())
    }
}

impl Row {
    /// Every line has its verdict on the mesh or is named, and never both.
    fn check(&mut self, mesh: &ViewMesh<MemoryTerrain>, lines: &[RequiredLine], named: &[u64]) -> Result<()> {
        for line in lines.iter().filter(|line| line.verdict.is_some()) {
            let right = Some(verdict_on_mesh(mesh, line.a, line.b)) == line.verdict;
            if right == named.binary_search(&line.id).is_ok() {
                return Err(format!("{line:?}: right {right}, but named {}", !right).into());
            }
            self.checked += 1;
        }
        self.named += named.len() as u64;
        Ok(())
    }

    fn print(&self, count: u64, budget: u32) {
        let share = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        let each = |kind: usize| self.stolen[kind] as f64 / self.asked[kind].max(1) as f64;
        println!(
            "{count:6} {budget:6} | {:5.1} % {:5.1} % | {:5.1} % {:22.1} %        | {:12.2} {:8.2} {:8.2}       | \
             {:6.2} % | {} {} {}",
            share(self.visible, self.lines),
            share(self.covered, self.lines - self.visible),
            share(self.plain_wrong[0], self.plain[0]),
            share(self.plain_wrong[1], self.plain[1]),
            each(0),
            each(1),
            each(2),
            100.0 - share(self.named, self.checked),
            spread(&self.moving[1..]),
            spread(&self.turning),
            spread(&self.still),
        );
    }
}

/// Milliseconds of this thread's processor time that `work` takes: other jobs count by what they do to caches only.
fn timed<E: Error + 'static>(work: impl FnOnce() -> std::result::Result<(), E>) -> Result<f64> {
    let started = ThreadTime::now();
    work()?;
    Ok(started.elapsed().as_secs_f64() * 1e3)
}

fn spread(ms: &[f64]) -> String {
    let mut sorted = ms.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get(((sorted.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(0.0);
    format!("{:6.3} / {:6.3} / {:6.3}", at(0.5), at(0.95), at(1.0))
}

/// Triangles of the posts that a mesh has and the plain one of the same view and budget lacks.
fn stolen(mesh: &ViewMesh<MemoryTerrain>, plain: &ViewMesh<MemoryTerrain>) -> u64 {
    let posts = mesh.active_posts().into_iter().map(|(p, _)| p).filter(|&p| plain.height(p).is_none());
    posts.map(|p| mesh.root().triangles(p).count() as u64).sum()
}

/// Whether a line is blocked on the mesh by nothing but the triangles over and under its ends.
fn blocked_at_an_end_only(mesh: &ViewMesh<MemoryTerrain>, line: &RequiredLine) -> bool {
    let mut elsewhere = false;
    let _ = for_each_triangle_met(mesh, line.a, line.b, |t| {
        let at_end = [line.a, line.b].iter().any(|&end| {
            for_each_triangle_met(mesh, end, end, |s| {
                if s == t { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
            .is_break()
        });
        let corners = t.corners().map(|p| [f64::from(p.i), f64::from(p.j), mesh.height(p).unwrap_or(0.0)]);
        elsewhere |= !at_end && passes_below(line.a, line.b, corners, mesh.grid_size());
        ControlFlow::Continue(())
    });
    !elsewhere
}
