//! What a contender does from frame to frame: time, change, popping, and what a sudden turn brings.

use super::{
    Instrument, TradeError,
    contender::{Contender, Made, Maker},
    greatest, mean, median, meshes, quantile,
    world::{World, turned, view},
};
use crate::{
    evaluate::flight::Viewpoint,
    lod::{LodView, Target, changed, measure::heights_at_posts},
    roam::RequiredLine,
};

/// A point of the surface has jumped when it moved by more than this many pixels: less is rounding.
const JUMP_PX: f64 = 1e-3;
/// Frames that a view stands still after it has turned, before what it shows counts as settled.
const SETTLING_FRAMES: usize = 10;
/// Bytes of an index, as in [`crate::lod::strips`].
const TRIANGLE_BYTES: f64 = 3.0 * crate::lod::strips::INDEX_BYTES as f64;

/// What a flight at one setting was like.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Flown {
    /// Seconds before the first frame; for the first; the median of those after it; for the first after a turn.
    pub(super) preparation_s: f64,
    pub(super) first_s: f64,
    pub(super) frame_s: f64,
    pub(super) turn_s: f64,
    pub(super) memory_bytes: usize,
    /// Triangles of each frame.
    pub(super) triangles: Vec<f64>,
    /// Triangles that a frame has and the one before had not, on average.
    pub(super) changed: f64,
    /// The share of a mesh that changed, of each frame after the first.
    pub(super) changed_shares: Vec<f64>,
    /// By how many triangles the budget was exceeded on the way, at most.
    pub(super) overrun: u64,
    /// Mean bytes that a client is sent for a frame after the first; index bytes of GEOmancy's tiles.
    pub(super) sent_bytes: Option<f64>,
    /// Jumps of surface points in the picture, and with gradual vertices where there are some.
    pub(super) pops: Pops,
    pub(super) morphed: Option<Pops>,
    /// Greatest distortion of the first frame after half a turn, and after it has stood still.
    pub(super) turned_px: f64,
    pub(super) settled_px: f64,
}

/// How far points of the surface jump from one frame to the next, from level of detail alone, in pixels.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub(super) struct Pops {
    pub(super) largest_px: f64,
    /// The 95th percentile of those that move at all; 0 when none does.
    pub(super) p95_px: f64,
}

impl Flown {
    /// Bytes a frame of indices of triangles that came.
    pub(super) fn changed_bytes(&self) -> f64 {
        self.changed * TRIANGLE_BYTES
    }
}

/// Flies with a target; the lines count for [`Contender::Kept`].
pub(super) fn fly(
    contender: Contender,
    world: &World,
    lines: &[RequiredLine],
    flight: &[Viewpoint],
    target: Target,
    repeats: usize,
    instrument: &Instrument<'_>,
) -> Result<Flown, TradeError> {
    let fresh = || -> Result<_, TradeError> {
        Ok(Path::new(Maker::new(contender, world, lines, instrument)?, world, target, instrument))
    };
    let mut path = fresh()?;
    let mut preparation_s = path.maker.preparation_s;
    for _ in 1..repeats {
        preparation_s = preparation_s.min(Maker::new(contender, world, &[], instrument)?.preparation_s);
    }
    for viewpoint in flight {
        path.frame(viewpoint)?;
    }
    let (seconds, changes) = (path.seconds.clone(), path.changed.clone());
    let frames = path.triangles.clone();
    let sent_bytes = (!path.sent_bytes.is_empty()).then(|| mean(&path.sent_bytes));
    let pops = path.pops();
    let (turn_s, [turned_px, settled_px]) = path.turn(flight)?;
    let morphed = if contender.morphs() {
        let mut path = fresh()?;
        path.maker.set_morph(true);
        flight.iter().try_for_each(|viewpoint| path.frame(viewpoint))?;
        Some(path.pops())
    } else {
        None
    };
    let shares = changes.iter().zip(&frames[1.min(frames.len())..]).map(|(c, n)| c / n.max(1.0)).collect();
    Ok(Flown {
        preparation_s,
        first_s: seconds.first().copied().unwrap_or(0.0),
        frame_s: median(seconds.get(1..).unwrap_or_default()),
        turn_s,
        memory_bytes: path.maker.memory_bytes(world),
        triangles: frames,
        changed: mean(&changes),
        changed_shares: shares,
        overrun: path.overrun,
        sent_bytes,
        pops,
        morphed,
        turned_px,
        settled_px,
    })
}

/// A flight under way.
struct Path<'a> {
    world: &'a World,
    maker: Maker,
    target: Target,
    instrument: &'a Instrument<'a>,
    last: Option<(Vec<[u64; 3]>, Vec<f64>)>,
    seconds: Vec<f64>,
    triangles: Vec<f64>,
    changed: Vec<f64>,
    overrun: u64,
    sent_bytes: Vec<f64>,
    jumps_px: Vec<f64>,
}

impl<'a> Path<'a> {
    fn new(maker: Maker, world: &'a World, target: Target, instrument: &'a Instrument<'a>) -> Self {
        Self {
            world,
            maker,
            target,
            instrument,
            last: None,
            seconds: Vec::new(),
            triangles: Vec::new(),
            changed: Vec::new(),
            overrun: 0,
            sent_bytes: Vec::new(),
            jumps_px: Vec::new(),
        }
    }

    fn update(&mut self, viewpoint: &Viewpoint) -> Result<(LodView, Made), TradeError> {
        let view = view(viewpoint)?;
        Ok((view, self.maker.update(&view, self.target, self.instrument)?))
    }

    fn frame(&mut self, viewpoint: &Viewpoint) -> Result<(), TradeError> {
        let (view, made) = self.update(viewpoint)?;
        self.seconds.push(made.seconds);
        self.triangles.push(made.mesh.len() as f64);
        self.overrun = self.overrun.max(made.statistics.overrun);
        let plan = made.mesh.plan();
        let heights = heights_at_posts(&made.mesh, &self.world.ground);
        if let Some((last_plan, last_heights)) = &self.last {
            self.changed.push(changed(last_plan, &plan) as f64);
            self.sent_bytes.extend(made.payload_bytes.map(|bytes| bytes as f64));
            jumps(self.world, &view, last_heights, &heights, &mut self.jumps_px);
        }
        self.last = Some((plan, heights));
        Ok(())
    }

    /// The jumps since this was last asked.
    fn pops(&mut self) -> Pops {
        let jumps = std::mem::take(&mut self.jumps_px);
        if jumps.is_empty() {
            return Pops::default();
        }
        Pops { largest_px: greatest(&jumps), p95_px: quantile(&jumps, 0.95) }
    }

    /// Turns the view round at the end of the flight. Returns the time of the first frame then, and the greatest
    /// distortion in it and after some more of the same.
    fn turn(&mut self, flight: &[Viewpoint]) -> Result<(f64, [f64; 2]), TradeError> {
        let Some(last) = flight.last() else { return Ok((0.0, [0.0; 2])) };
        let around = turned(last);
        let (view, first) = self.update(&around)?;
        let mut made = self.update(&around)?.1;
        for _ in 1..SETTLING_FRAMES {
            made = self.update(&around)?.1;
        }
        let worst =
            |made: &Made| meshes::distortion(self.world, &view, &heights_at_posts(&made.mesh, &self.world.ground))[0];
        Ok((first.seconds, [worst(&first), worst(&made)]))
    }
}

/// Adds how far posts in the picture jump when the mesh changes under a view that does not.
fn jumps(world: &World, view: &LodView, before: &[f64], after: &[f64], out: &mut Vec<f64>) {
    let up_m = world.scale().up_m;
    let columns = world.ground.grid().nx() as usize;
    for (n, (&z0, &z1)) in before.iter().zip(after).enumerate() {
        if z0 == z1 {
            continue;
        }
        let post = world.ground.scene((n % columns) as u32, (n / columns) as u32);
        let at = |z: f64| glam::DVec3 { z: z * up_m, ..post };
        out.extend(view.camera().distortion(at(z1), at(z0)).filter(|&px| px > JUMP_PX));
    }
}
