//! Single measurements that claims of the papers ask for, and no table of all systems gives.

use std::sync::Arc;

use super::{
    Instrument, Plan, Step, TradeError, mean, vertex_bound,
    world::{World, view, view_of},
};
use crate::{
    evaluate::flight::Preset,
    lod::{
        Algorithm, Ground, LevelOfDetail, LodError, LodView, Metric, Published, TStrip, Target, conformity,
        measure::heights_at_posts, strips,
    },
    terrain::{MemoryField, SceneScale, synthetic},
};
use sightline_proto::diamond::Post;

/// What the probes found.
#[derive(Clone, PartialEq, Debug, Default)]
pub(super) struct Probes {
    /// Posts of the terrain on which GeoMipMap's coarsest mesh was counted, and that mesh's triangles.
    pub(super) coarsest: [usize; 2],
    pub(super) decisions: Vec<Decision>,
    pub(super) steps: Steps,
    pub(super) topology: Vec<Topology>,
    pub(super) strips: Vec<Strips>,
    /// Triangles in a strip on a mesh of one level.
    pub(super) uniform_strip: f64,
    pub(super) bounds: Vec<vertex_bound::Bounds>,
    /// Greatest overrun of a small budget, as a share of it, and that budget.
    pub(super) cascade: [f64; 2],
    pub(super) spheres: Vec<Spheres>,
    pub(super) thresholds: Vec<Threshold>,
}

/// GeoMipMap and its improvement with the same error in pixels, over a flight.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Decision {
    pub(super) world: usize,
    pub(super) tau_px: f64,
    /// Mean number of triangles, and its relative variation, of the original and of the improved decision.
    pub(super) triangles: [f64; 2],
    pub(super) variation: [f64; 2],
    /// Greatest distortion in a picture.
    pub(super) distortion_px: [f64; 2],
}

/// What full resolution takes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Steps {
    /// Blocks that T-Strip tests, and triangles that a bintree splits, on 32 x 32 cells.
    pub(super) t_strip: u64,
    pub(super) bintree: u64,
    /// Cells along the side of a larger map, and the blocks that T-Strip tests there.
    pub(super) large_side: u64,
    pub(super) large: u64,
}

/// T-Strip by distance and by topology: strips, transition blocks, cracks.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Topology {
    pub(super) strips: [u64; 2],
    pub(super) transitions: [u64; 2],
    pub(super) cracks: [usize; 2],
}

/// Strips of ROAM as published over a flight.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Strips {
    pub(super) world: usize,
    pub(super) triangles: usize,
    /// Triangles in a strip: grown greedily, kept from frame to frame.
    pub(super) greedy: f64,
    pub(super) kept: f64,
    /// Triangles split and merged in a frame, and vertices written to keep the strips.
    pub(super) operations: f64,
    pub(super) written: f64,
    /// Time of a frame with strips over that without.
    pub(super) slower: f64,
    /// Bytes of a list, greedy strips, kept strips, fans.
    pub(super) bytes: [usize; 4],
}

/// Triangles at 3 pixels on 640 x 480: nested spheres, split-only ROAM; and their greatest distortion.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Spheres {
    pub(super) triangles: [usize; 2],
    pub(super) distortion_px: [f64; 2],
}

/// GEOmancy at one of its thresholds, over a flight.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Threshold {
    pub(super) world: usize,
    pub(super) px: f64,
    pub(super) triangles: f64,
    pub(super) dirty_tiles: f64,
    pub(super) index_bytes: f64,
}

/// Thresholds that White tries.
const THRESHOLDS_PX: [f64; 4] = [1.0, 3.0, 5.0, 7.0];
/// What Ye and Wang's GeoMipMap had at the error that they set, which they do not tell.
const THEIR_TRIANGLES: u32 = 30_000;
/// Frames in a second of the flight over which both decisions vary: it covers ground.
const DECISION_HZ: f64 = 1.0;
const SPHERES_PX: f64 = 3.0;
const SPHERES_VIEWPORT_PX: [u32; 2] = [640, 480];
/// Side of the map for T-Strip's count of steps.
const STEPS_CELLS: u32 = 32;
const SMALL_BUDGETS: std::ops::RangeInclusive<u32> = 4..=64;

/// Runs all probes.
pub(super) fn measure(worlds: &[World], plan: &Plan, instrument: &Instrument<'_>) -> Result<Probes, TradeError> {
    let total = worlds.len() + 1;
    (instrument.tell)(Step { name: "claims of the papers", done: 0, total });
    let large = rough(plan.probe_cells)?;
    let mut probes = Probes {
        coarsest: coarsest(&large)?,
        steps: steps(&large)?,
        uniform_strip: uniform_strip(&rough(STEPS_CELLS)?)?,
        ..Probes::default()
    };
    for (number, world) in worlds.iter().enumerate() {
        (instrument.tell)(Step { name: "claims of the papers", done: number + 1, total });
        probes.decisions.push(decision(number, world, plan)?);
        probes.topology.push(topology(world)?);
        probes.strips.push(kept_strips(number, world, plan, instrument)?);
        probes.bounds.push(vertex_bound::measure(world)?);
        probes.spheres.push(spheres(world)?);
        probes.thresholds.extend(thresholds(number, world, plan)?);
        let cascade = cascade(world)?;
        if cascade[0] > probes.cascade[0] {
            probes.cascade = cascade;
        }
    }
    Ok(probes)
}

/// A rough square of so many cells a side, nowhere linear.
fn rough(cells: u32) -> Result<Arc<Ground>, TradeError> {
    let height = |i: u32, j: u32| (synthetic::mix(Post::new(i, j).key()) >> 44) as f64 / 1024.0;
    let field = MemoryField::from_fn(cells + 1, cells + 1, |i, j| Some(height(i, j)))?;
    Ok(Ground::read(&field, SceneScale::UNIT)?)
}

/// A view from low over the middle.
fn above_middle(ground: &Ground) -> Result<LodView, TradeError> {
    let middle = ground.side() / 2;
    let eye = ground.scene(middle, middle) + glam::DVec3::Z;
    Ok(LodView::new(eye, glam::DQuat::IDENTITY, 0.5, 1.0, [1024, 768])?)
}

fn coarsest(ground: &Arc<Ground>) -> Result<[usize; 2], TradeError> {
    let coarse = Algorithm::GeoMipMap.range().coarse;
    let frame = Algorithm::GeoMipMap.prepare(ground).update(&above_middle(ground)?, Target::Setting(coarse))?;
    Ok([ground.side() as usize + 1, frame.mesh.len()])
}

fn steps(large: &Arc<Ground>) -> Result<Steps, TradeError> {
    let finest = |algorithm: Algorithm, ground: &Arc<Ground>| -> Result<_, TradeError> {
        // From within the ground, so that distance keeps nothing from being split.
        let mut eye = ground.scene(ground.side() / 2, ground.side() / 2);
        eye.z -= 1e4;
        let view = LodView::new(eye, glam::DQuat::IDENTITY, 0.5, 1.0, [1024, 768])?;
        Ok(algorithm.prepare(ground).update(&view, Target::Setting(algorithm.range().fine))?.statistics)
    };
    let small = rough(STEPS_CELLS)?;
    Ok(Steps {
        t_strip: finest(Algorithm::TStrip, &small)?.decisions,
        bintree: finest(Algorithm::SplitOnly, &small)?.splits,
        large_side: u64::from(large.side()),
        large: finest(Algorithm::TStrip, large)?.decisions,
    })
}

fn uniform_strip(ground: &Arc<Ground>) -> Result<f64, TradeError> {
    let frame = Algorithm::Full.prepare(ground).update(&above_middle(ground)?, Target::Setting(1.0))?;
    Ok(strips::greedy(&frame.mesh).average())
}

fn decision(number: usize, world: &World, plan: &Plan) -> Result<Decision, TradeError> {
    let flight = world.flight_at(DECISION_HZ, Preset::Turn, plan.frames, 2)?;
    let first = view(&flight[0])?;
    // As many as theirs, but no more than a quarter of the finest.
    let goal = THEIR_TRIANGLES.min((world.ground.grid().posts() / 2) as u32);
    let tau_px =
        Algorithm::GeoMipMap.prepare(&world.ground).update(&first, Target::Triangles(goal))?.statistics.setting;
    let (triangles, variation, distortion_px) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    let mut decision = Decision { world: number, tau_px, triangles, variation, distortion_px };
    for (n, algorithm) in [Algorithm::GeoMipMap, Algorithm::ImprovedGeoMipMap].into_iter().enumerate() {
        let mut system = algorithm.prepare(&world.ground);
        let mut counts = Vec::new();
        for viewpoint in &flight {
            let view = view(viewpoint)?;
            let mesh = system.update(&view, Target::Setting(tau_px))?.mesh;
            counts.push(mesh.len() as f64);
            let shown = super::meshes::distortion(world, &view, &heights_at_posts(&mesh, &world.ground));
            decision.distortion_px[n] = decision.distortion_px[n].max(shown[0]);
        }
        let average = mean(&counts);
        let square = mean(&counts.iter().map(|c| (c - average) * (c - average)).collect::<Vec<_>>());
        decision.triangles[n] = average;
        decision.variation[n] = square.sqrt() / average;
    }
    Ok(decision)
}

fn topology(world: &World) -> Result<Topology, TradeError> {
    let view = view(&world.flight(Preset::Straight, 1, 1)?[0])?;
    let mut found = Topology { strips: [0; 2], transitions: [0; 2], cracks: [0; 2] };
    for (n, metric) in [Metric::Distance, Metric::Topology].into_iter().enumerate() {
        let mut system = TStrip::new(Arc::clone(&world.ground), metric);
        let frame = system.update(&view, Target::Triangles(10_000))?;
        (found.strips[n], found.transitions[n]) = (frame.statistics.strips, frame.statistics.fans);
        found.cracks[n] = conformity::check(&frame.mesh).map_or(usize::MAX, |found| found.t_junctions);
    }
    Ok(found)
}

fn kept_strips(number: usize, world: &World, plan: &Plan, instrument: &Instrument<'_>) -> Result<Strips, TradeError> {
    let flight = world.flight(Preset::Straight, plan.frames, 1)?;
    let target = Target::Triangles(10_000);
    let fly = |system: &mut Published| -> Result<_, LodError> {
        let (mut seconds, mut operations, mut last) = (0.0, 0, None);
        for (n, viewpoint) in flight.iter().enumerate() {
            let Ok(view) = view(viewpoint) else { continue };
            let (frame, took) = instrument.timed(|| system.update(&view, target));
            if n == 0 {
                // What is written to build the first strips is not what it takes to keep them.
                if let Some(strips) = system.strips() {
                    strips.take_written();
                }
            }
            let frame = frame?;
            if n > 0 {
                seconds += took;
                operations += frame.statistics.splits + frame.statistics.merges;
            }
            last = Some(frame.mesh);
        }
        Ok((seconds, operations, last))
    };
    let (without_s, ..) = fly(&mut Published::new(Arc::clone(&world.ground)))?;
    let mut system = Published::new(Arc::clone(&world.ground));
    system.keep_strips();
    let (with_s, operations, mesh) = fly(&mut system)?;
    let later = flight.len().saturating_sub(1).max(1) as f64;
    let mesh = mesh.unwrap_or_default();
    let (greedy, fans, list) = (strips::greedy(&mesh), strips::fans(&mesh), strips::list(&mesh));
    let written = system.strips().map_or(0, |strips| strips.take_written());
    let kept = system.strips().map(|strips| strips.output()).unwrap_or_default();
    Ok(Strips {
        world: number,
        triangles: mesh.len(),
        greedy: greedy.average(),
        kept: kept.average(),
        operations: operations as f64 / later,
        written: written as f64 / later,
        slower: with_s / without_s,
        bytes: [list.bytes, greedy.bytes, kept.bytes, fans.bytes],
    })
}

/// The greatest share of a small budget by which a cascade overran it, and that budget.
fn cascade(world: &World) -> Result<[f64; 2], TradeError> {
    let view = view(&world.flight(Preset::Straight, 1, 1)?[0])?;
    let mut worst = [0.0_f64; 2];
    let mut system = Published::new(Arc::clone(&world.ground));
    for budget in SMALL_BUDGETS {
        let overrun = system.update(&view, Target::Triangles(budget))?.statistics.overrun;
        let share = overrun as f64 / f64::from(budget);
        if share > worst[0] {
            worst = [share, f64::from(budget)];
        }
    }
    Ok(worst)
}

fn spheres(world: &World) -> Result<Spheres, TradeError> {
    let view = view_of(&world.flight(Preset::Straight, 1, 1)?[0], SPHERES_VIEWPORT_PX)?;
    let mut found = Spheres { triangles: [0; 2], distortion_px: [0.0; 2] };
    for (n, algorithm) in [Algorithm::NestedSpheres, Algorithm::SplitOnly].into_iter().enumerate() {
        let mesh = algorithm.prepare(&world.ground).update(&view, Target::Setting(SPHERES_PX))?.mesh;
        found.triangles[n] = mesh.len();
        found.distortion_px[n] = super::meshes::distortion(world, &view, &heights_at_posts(&mesh, &world.ground))[0];
    }
    Ok(found)
}

fn thresholds(number: usize, world: &World, plan: &Plan) -> Result<Vec<Threshold>, TradeError> {
    let flight = world.flight(Preset::Straight, plan.frames, 1)?;
    let mut found = Vec::new();
    for px in THRESHOLDS_PX {
        let mut system = Algorithm::Geomancy.prepare(&world.ground);
        let (mut triangles, mut dirty, mut bytes) = (Vec::new(), Vec::new(), Vec::new());
        for viewpoint in &flight {
            let frame = system.update(&view(viewpoint)?, Target::Setting(px))?;
            triangles.push(frame.mesh.len() as f64);
            dirty.push(frame.statistics.dirty_tiles as f64);
            bytes.push(frame.statistics.index_bytes as f64);
        }
        // The first frame sends everything.
        let later = |values: &[f64]| mean(values.get(1..).unwrap_or_default());
        let (dirty_tiles, index_bytes) = (later(&dirty), later(&bytes));
        found.push(Threshold { world: number, px, triangles: mean(&triangles), dirty_tiles, index_bytes });
    }
    Ok(found)
}
