//! When a priority must be computed again: a clock for each queue that runs with what happens to the view.
//!
//! Each queue has a *guard*. Posts that are put off are known to be beyond it: ready ones have priorities below the split
//! queue's (or of zero), active ones above the merge queue's. A post is put off for as many *ticks* as this stays true
//! while, in each tick, the camera moves by no more than [`Rate::motion`] and the guard comes nearer by no more than
//! [`Rate::guard`]. The clock runs on with every motion and every step of the guard in proportion, so what a post was promised
//! holds whatever speed the view really has; the rates only decide how long promises can be.

use super::nodes::{List, Side};
use crate::view::{Appraisal, Motion};

/// Longest promise, in ticks. One bucket less than the lists have, so that what is due is never mistaken for what was
/// just put off.
const MOST_TICKS: u32 = List::BUCKETS as u32 - 2;
/// Share of the priority at the cut by which a guard keeps its distance from it. Wider, more posts are computed in each
/// frame; narrower, the guards must be moved more often. Measured.
pub(super) const GAP: f64 = 1.0 / 1024.0;
/// Share of the priority at the cut that a guard may move in a tick.
const GUARD_RATE: f64 = 1.0 / 4096.0;
/// Rates are chosen anew when what is wanted differs by more than this factor.
const TOLERANCE: f64 = 2.5;
/// Turn in a tick from which nothing is put off: so much enters and leaves the picture that promises would be short, and
/// making them costs more than computing priorities. At 60 degrees a second and 60 frames a second two thirds of the
/// priorities were due in each frame, and a frame took a third longer than without promises.
const MOST_TURN: f64 = 1.0 / 128.0;
/// Least motion in a tick: below it, everything can be put off for the longest time anyway.
const LEAST_SHIFT_M: f64 = 1e-3;
/// Metres at which a turn that is not meant at all may count as much as the shift: keeps noise from being a rate.
const FAR_M: f64 = 262_144.0;

/// What may happen in a tick.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Rate {
    pub(super) motion: Motion,
    /// How far a guard may move.
    pub(super) guard: f64,
}

/// The clock and guard of one queue.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Guard {
    pub(super) side: Side,
    pub(super) value: f64,
    clock: f64,
}

impl Guard {
    /// A guard that nothing is beyond.
    pub(super) fn new(side: Side) -> Self {
        let value = if side == Side::Split { 0.0 } else { f64::INFINITY };
        Self { side, value, clock: 0.0 }
    }

    /// Lets the clock run; what is due then.
    pub(super) fn advance(&mut self, ticks: f64) -> impl Iterator<Item = List> + use<> {
        let (before, side) = (self.clock as u64, self.side);
        // Beyond a full turn of the lists everything is due.
        self.clock += ticks.min(f64::from(List::BUCKETS));
        let due = (self.clock as u64 - before).min(List::BUCKETS.into());
        (1..=due).map(move |n| List::due(side, before + n))
    }

    /// Moves the guard nearer to what it guards; what is due then.
    pub(super) fn approach(&mut self, value: f64, rate: Rate) -> impl Iterator<Item = List> + use<> {
        let way = (value - self.value).abs();
        self.value = value;
        self.advance(if way.is_finite() { way / rate.guard } else { f64::INFINITY })
    }

    /// The list of a post: the one of its due time when it is beyond the guard for at least a tick, else the hot one.
    pub(super) fn list_for(&self, appraisal: &Appraisal, weight: f64, rate: Rate) -> List {
        let holds = |ticks: u32| {
            let ticks = f64::from(ticks);
            let motion = Motion { shift_m: rate.motion.shift_m * ticks, turn: rate.motion.turn * ticks };
            match self.side {
                Side::Split => appraisal.stays_below((self.value - rate.guard * ticks) / weight, motion),
                Side::Merge => appraisal.stays_above((self.value + rate.guard * ticks) / weight, motion),
            }
        };
        let mut ticks = 0;
        // The greatest power of two that holds, then what holds of its half and its quarter beside it.
        while ticks < MOST_TICKS {
            let more = if ticks == 0 { 1 } else { (2 * ticks).min(MOST_TICKS) };
            if !holds(more) {
                break;
            }
            ticks = more;
        }
        if ticks == 0 {
            return List::hot(self.side);
        }
        let (half, quarter) = (ticks / 2, ticks / 4);
        for more in [half, quarter] {
            if ticks + more <= MOST_TICKS && holds(ticks + more) {
                ticks += more;
            }
        }
        List::due(self.side, (self.clock + f64::from(ticks)) as u64)
    }
}

/// Chooses rates from what happened lately.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Pace {
    pub(super) rate: Rate,
    /// The last three motions, newest first.
    lately: [Motion; 3],
}

impl Pace {
    pub(super) fn new() -> Self {
        let motion = Motion { shift_m: LEAST_SHIFT_M, turn: LEAST_SHIFT_M / FAR_M };
        Self { rate: Rate { motion, guard: 1.0 }, lately: [motion; 3] }
    }

    /// How many ticks a motion takes; infinite when everything must be computed, which is also when new rates are
    /// chosen. `cut` is the priority at which the mesh ends.
    pub(super) fn ticks(&mut self, motion: Option<Motion>, cut: f64) -> f64 {
        let Some(motion) = motion else { return f64::INFINITY };
        self.lately = [motion, self.lately[0], self.lately[1]];
        if self.adapt(cut) {
            return f64::INFINITY;
        }
        (motion.shift_m / self.rate.motion.shift_m).max(motion.turn / self.rate.motion.turn)
    }

    /// Whether putting off is not worth while.
    pub(super) fn turns_fast(&self) -> bool {
        self.rate.motion.turn > MOST_TURN
    }

    /// Whether new rates were chosen.
    fn adapt(&mut self, cut: f64) -> bool {
        // The middle one of three: a single jump is no speed.
        let shift_m = middle(self.lately.map(|m| m.shift_m)).max(LEAST_SHIFT_M);
        let turn = middle(self.lately.map(|m| m.turn)).max(shift_m / FAR_M);
        let guard = if cut > 0.0 && cut.is_finite() { cut * GUARD_RATE } else { self.rate.guard };
        let Rate { motion, guard: old } = self.rate;
        let far = |wanted: f64, is: f64| wanted > is * TOLERANCE || wanted * TOLERANCE < is;
        let stale = far(shift_m, motion.shift_m) || far(turn, motion.turn) || far(guard, old);
        if stale {
            self.rate = Rate { motion: Motion { shift_m, turn }, guard };
        }
        stale
    }
}

fn middle([a, b, c]: [f64; 3]) -> f64 {
    a.max(b).min(a.min(b).max(c))
}
