//! Meshes: how good each contender's are at the same numbers of triangles, and what they cost.
//!
//! In views that stand still each contender is asked for a number of triangles: errors, distortion, shape, bytes and
//! sight lines are those of these meshes. Then it flies with the setting that gave the number in the first view, as the
//! papers do: time, change and popping are those of that flight.

use super::{
    Instrument, Plan, Step, TradeError,
    contender::{Contender, Made, Maker},
    flown::{self, Flown},
    greatest, lines,
    lines::Line,
    mean,
    world::{World, view},
};
use crate::{
    evaluate::flight::{Preset, Viewpoint},
    lod::{
        IndexedMesh, LodView, Target,
        measure::{VerticalError, heights_at_posts, vertical_error},
        strips,
    },
    roam::Fidelity,
};

/// Sine of the smallest angle, in plan and in posts, below which a triangle is thin: 15 degrees. Triangles of a bintree
/// have no angle below 45.
const THIN_SINE: f64 = 0.258_819_045_102_520_76;

/// A contender on a terrain at a number of triangles.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Row {
    pub(super) world: usize,
    pub(super) contender: Contender,
    /// The number that was asked for.
    pub(super) wanted: u32,
    pub(super) still: Still,
    pub(super) flown: Flown,
}

/// What its meshes were in views that stood still.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Still {
    /// The setting that gave the number in the first view.
    pub(super) setting: f64,
    /// Mean number of triangles.
    pub(super) triangles: f64,
    /// Greatest vertical error of any view, and means over the views, in metres.
    pub(super) max_m: f64,
    pub(super) rms_m: f64,
    pub(super) mean_m: f64,
    /// Greatest distortion of a post in a picture, and the root of the mean square, in pixels.
    pub(super) distortion_px: f64,
    pub(super) distortion_rms_px: f64,
    /// The greatest bound that was promised; and whether each was kept.
    pub(super) bound_px: Option<f64>,
    pub(super) bound_kept: bool,
    /// Share of thin triangles.
    pub(super) thin: f64,
    /// Bytes of indices as a list, as strips, as fans, in the first view.
    pub(super) bytes: [usize; 3],
    /// Triangles in a strip.
    pub(super) strip_length: f64,
    pub(super) viewer: Asked,
    pub(super) others: Asked,
}

/// How many lines were asked, and how many came out wrong: in silence, and named as such.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub(super) struct Asked {
    pub(super) lines: usize,
    pub(super) silent: usize,
    pub(super) named: usize,
}

impl Asked {
    /// The share that is wrong in silence, in percent.
    pub(super) fn silent_percent(&self) -> f64 {
        100.0 * self.silent as f64 / self.lines as f64
    }
}

/// A view that stands still, and the lines that are asked in it: those of the viewer first.
struct Scene {
    view: LodView,
    lines: Vec<Line>,
    of_viewer: usize,
}

/// Measures all contenders on one terrain.
pub(super) fn measure(
    number: usize,
    world: &World,
    plan: &Plan,
    instrument: &Instrument<'_>,
) -> Result<Vec<Row>, TradeError> {
    let scenes: Vec<_> = (0..plan.views).map(|n| scene(world, plan, n as u64)).collect::<Result<_, _>>()?;
    let flight = world.flight(Preset::Straight, plan.frames, 1)?;
    // While the eye moves, only the lines between others stay.
    let staying = scenes.first().map_or(&[][..], |scene| &scene.lines[scene.of_viewer..]);
    let staying = lines::required(staying, Fidelity::Verdict);
    let contenders: Vec<_> = Contender::all().collect();
    let total = contenders.len() * plan.counts.len();
    let mut rows = Vec::new();
    for (n, &contender) in contenders.iter().enumerate() {
        for (m, &wanted) in plan.counts.iter().enumerate() {
            let name = format!("meshes of {}", world.name);
            (instrument.tell)(Step { name: &name, done: n * plan.counts.len() + m, total });
            let still = still(contender, world, &scenes, wanted, instrument)?;
            let target = contender.target(wanted, still.setting);
            let flown = flown::fly(contender, world, &staying, &flight, target, plan.repeats, instrument)?;
            rows.push(Row { world: number, contender, wanted, still, flown });
        }
    }
    Ok(rows)
}

fn scene(world: &World, plan: &Plan, n: u64) -> Result<Scene, TradeError> {
    let viewpoint: Viewpoint = world.flight(Preset::Straight, 1, 1 + n)?[0];
    let view = view(&viewpoint)?;
    let mut lines = lines::from_eye(world, &view, plan.mesh_lines, 100 + n)?;
    let of_viewer = lines.len();
    lines.extend(lines::third_party(world, plan.mesh_lines, 200 + n)?);
    Ok(Scene { view, lines, of_viewer })
}

fn still(
    contender: Contender,
    world: &World,
    scenes: &[Scene],
    wanted: u32,
    instrument: &Instrument<'_>,
) -> Result<Still, TradeError> {
    let mut errors = Vec::new();
    let mut distortions = Vec::new();
    let (mut triangles, mut thins, mut bounds) = (Vec::new(), Vec::new(), Vec::new());
    let (mut viewer, mut others) = (Asked::default(), Asked::default());
    let mut bound_kept = true;
    let mut first: Option<(f64, [strips::Output; 3])> = None;
    for scene in scenes {
        let required = lines::required(&scene.lines, Fidelity::Verdict);
        let mut maker = Maker::new(contender, world, &required, instrument)?;
        let made = maker.update(&scene.view, Target::Triangles(wanted), instrument)?;
        let distortion = distortion(world, &scene.view, &heights_at_posts(&made.mesh, &world.ground));
        bound_kept &= made.bound_px.is_none_or(|bound| distortion[0] <= bound);
        bounds.extend(made.bound_px);
        distortions.push(distortion);
        errors.push(vertical_error(&made.mesh, &world.ground));
        triangles.push(made.mesh.len() as f64);
        thins.push(thin(&made.mesh));
        count_wrong(world, scene, &made, [&mut viewer, &mut others]);
        first.get_or_insert_with(|| {
            let mesh = &made.mesh;
            (made.statistics.setting, [strips::list(mesh), strips::greedy(mesh), strips::fans(mesh)])
        });
    }
    let (setting, outputs) = first.unwrap_or_default();
    let up_m = world.scale().up_m;
    let of = |value: fn(&VerticalError) -> f64| errors.iter().map(|e| value(e) * up_m).collect::<Vec<_>>();
    Ok(Still {
        setting,
        triangles: mean(&triangles),
        max_m: greatest(&of(|e| e.max)),
        rms_m: mean(&of(|e| e.rms)),
        mean_m: mean(&of(|e| e.mean)),
        distortion_px: greatest(&distortions.iter().map(|d| d[0]).collect::<Vec<_>>()),
        distortion_rms_px: mean(&distortions.iter().map(|d| d[1]).collect::<Vec<_>>()),
        bound_px: (!bounds.is_empty()).then(|| greatest(&bounds)),
        bound_kept,
        thin: mean(&thins),
        bytes: outputs.map(|output| output.bytes),
        strip_length: outputs[1].average(),
        viewer,
        others,
    })
}

/// The greatest distortion of a post in the picture, and the root of the mean square, for the mesh's heights at posts.
pub(super) fn distortion(world: &World, view: &LodView, heights: &[f64]) -> [f64; 2] {
    let (mut worst, mut squares, mut posts) = (0.0_f64, 0.0, 0.0);
    for_each_drawn(world, heights, |finest, drawn| {
        if let Some(px) = view.camera().distortion(finest, drawn) {
            worst = worst.max(px);
            squares += px * px;
            posts += 1.0;
        }
    });
    [worst, (squares / f64::max(posts, 1.0)).sqrt()]
}

/// Calls `visit` with each post in the scene frame, where it is and where it is drawn.
fn for_each_drawn(world: &World, heights: &[f64], mut visit: impl FnMut(glam::DVec3, glam::DVec3)) {
    let up_m = world.scale().up_m;
    let columns = world.ground.grid().nx();
    for (row, drawn) in heights.chunks_exact(columns as usize).enumerate() {
        for (i, z) in drawn.iter().enumerate() {
            let finest = world.ground.scene(i as u32, row as u32);
            visit(finest, glam::DVec3 { z: z * up_m, ..finest });
        }
    }
}

/// The share of triangles that are thin.
fn thin(mesh: &IndexedMesh) -> f64 {
    let is_thin = |t: &[crate::lod::Vertex; 3]| {
        let [a, b, c] = t.map(|v| [f64::from(v.post.i), f64::from(v.post.j)]);
        let side = |p: [f64; 2], q: [f64; 2]| [q[0] - p[0], q[1] - p[1]];
        let (ab, ac) = (side(a, b), side(a, c));
        let area = (ab[0] * ac[1] - ab[1] * ac[0]).abs();
        let mut squares = [ab, ac, side(b, c)].map(|v| v[0] * v[0] + v[1] * v[1]);
        squares.sort_by(f64::total_cmp);
        // The smallest angle lies between the two longest sides.
        area < THIN_SINE * (squares[1] * squares[2]).sqrt()
    };
    mesh.iter().filter(is_thin).count() as f64 / mesh.len().max(1) as f64
}

/// Counts the lines that a mesh gets wrong: those of the viewer, and those between others.
fn count_wrong(world: &World, scene: &Scene, made: &Made, asked: [&mut Asked; 2]) {
    let [viewer, others] = asked;
    viewer.lines += scene.of_viewer;
    others.lines += scene.lines.len() - scene.of_viewer;
    for n in lines::wrong(world, &made.mesh, &scene.lines) {
        let asked = if n < scene.of_viewer { &mut *viewer } else { &mut *others };
        if made.named.contains(&(n as u64)) { asked.named += 1 } else { asked.silent += 1 }
    }
}
