//! The traversal that skips: along AB from block to block of a [`Pyramid`], coarser after each block that lies below
//! the line, finer at each that does not, and through the crossings of what remains.
//!
//! **Why no answer changes.** AB is cut into stretches of its parameter t, and each crossing of each sweep belongs to
//! one stretch, by its number. Of a stretch in a block all crossings lie within a cell of the block: the block was found
//! with a place that is off by at most [`PLACE_ERROR`] and pushed on by [`NUDGE`], and the number of a crossing is off
//! by no more ([`Course::new`] declines lines for which that does not hold; they are walked in full). So every crossing
//! that lies in the grid has the posts of its face in the block or the ring around it. Where the block's bounds are
//! finite these are all known, and where the greatest is less than a lower bound of AB's height over the stretch, AB is
//! strictly above each: nothing blocked, unknown or touching is left out. A block wholly above the line is walked at
//! once, and its first crossing in the grid ends the walk, so that too is decided by a crossing.
//!
//! **With a tolerance** h a block is passed over when it is below the line once lowered by h, and blocks when it would
//! stand above it once raised by h and AB crosses known ground there. Where the terrain lowered by h blocks, some
//! crossing has ground more than h above the line; its block is not passed over, so the answer is BLOCKED, by that or
//! another. Where the terrain raised by h does not block, no block can. Voids are never passed over. So the answer is
//! the exact one where both have the same verdict.

use std::ops::Range;

use sightline_proto::predicates::{Exact, FLUSHED, Kernel};

use super::{
    pyramid::Pyramid,
    sweep::{ROUNDOFF, Span, Sweep},
    walk::{Found, Met, Walk},
};
use crate::terrain::{HeightField, ReadError};

/// The most that a computed place on AB may be off, in cells.
const PLACE_ERROR: f64 = 1.0 / 256.0;
/// How far ahead the next block is looked for, in cells: more than the error, so that each block leads to another.
const NUDGE: f64 = 1.0 / 64.0;
/// AB is taken as constant in x, or y, when it moves less than this, in cells.
const STILL: f64 = 1.0 / 64.0;

/// AB as the traversal needs it: places and heights with bounded errors.
struct Course {
    from: [f64; 2],
    by: [f64; 2],
    /// Reciprocals of `by`; 0 where AB is still.
    per: [f64; 2],
    z: f64,
    rise: f64,
    z_error: f64,
    span: Span,
}

impl Course {
    /// `None` where numbers are too rough for skipping.
    ///
    /// A place from + t by has three roundings of numbers below |from| + |by|; t itself, and the number of a crossing,
    /// are off by t_error and a few roundings of numbers up to 1, which `by` multiplies.
    fn new(a: [f64; 3], b: [f64; 3], span: Span, sweeps: &[Sweep; 4]) -> Option<Self> {
        let used = || sweeps.iter().filter(|sweep| sweep.count > 0);
        if !used().all(|sweep| sweep.trusted) || span.low >= span.high {
            return None;
        }
        let t_error = used().fold(0.0_f64, |e, sweep| e.max(sweep.t_error)) + 32.0 * ROUNDOFF;
        let by = [b[0] - a[0], b[1] - a[1]];
        let size = [a[0], a[1], b[0], b[1]].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let error = t_error * by[0].abs().max(by[1].abs()) + 16.0 * ROUNDOFF * size;
        if error.is_nan() || error > PLACE_ERROR {
            return None;
        }
        let rise = b[2] - a[2];
        let z_error = t_error * rise.abs() + 16.0 * ROUNDOFF * a[2].abs().max(b[2].abs()) + FLUSHED;
        let by = by.map(|d| if d.abs() < STILL { 0.0 } else { d });
        let per = by.map(|d| if d == 0.0 { 0.0 } else { 1.0 / d });
        Some(Self { from: [a[0], a[1]], by, per, z: a[2], rise, z_error, span })
    }

    /// Column (axis 0) or row (axis 1) of the block at `t`, and the t at which AB leaves it along this axis.
    #[inline]
    fn block(&self, axis: usize, t: f64, shift: u32) -> (i64, f64) {
        let (from, by) = (self.from[axis], self.by[axis]);
        if by == 0.0 {
            return ((from as i64) >> shift, f64::INFINITY);
        }
        let ahead = from + t * by + if by > 0.0 { NUDGE } else { -NUDGE };
        // Less than a cell below 0, where a cast would round up. Blocks beyond the grid are as good as the nearest.
        let block = ((ahead + 1.0) as i64 - 1) >> shift;
        let border = (block + i64::from(by > 0.0)) << shift;
        (block, (border as f64 - from) * self.per[axis])
    }
}

/// Walks the crossings of AB that blocks do not settle. Returns whether it did; when not, nothing has been walked.
pub(super) fn walk<K, H>(
    walk: &mut Walk<'_, H>,
    pyramid: &Pyramid,
    sweeps: &[Sweep; 4],
    span: Span,
    strict: bool,
    met: &mut Met,
) -> Result<bool, ReadError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    let Some(course) = Course::new(walk.a, walk.b, span, sweeps) else { return Ok(false) };
    let tolerance = walk.manner.tolerance;
    let (mut t, mut level) = (span.low, 0);
    while t < span.high {
        let shift = pyramid.shift(level);
        let ((column, t_x), (row, t_y)) = (course.block(0, t, shift), course.block(1, t, shift));
        let end = t_x.min(t_y).min(span.high);
        debug_assert!(end > t, "a block that leads nowhere at {t} of {:?} to {:?}", walk.a, walk.b);
        let bounds = pyramid.at(level, column, row);
        let heights = [course.z + t * course.rise, course.z + end * course.rise];
        // How far the ground may rise above the line, and how far it does at least. Rounding keeps order, so each is
        // less, or greater, than a number if its rounded value is.
        let most = f64::from(bounds.high) - (heights[0].min(heights[1]) - course.z_error);
        let least = f64::from(bounds.low) - (heights[0].max(heights[1]) + course.z_error);
        if most < tolerance {
            met.tolerated |= most >= 0.0;
            level = (level + 1).min(pyramid.top());
        } else if least <= 0.0 && least > -tolerance && has_ground(walk, sweeps, &course.span, [t, end])? {
            (met.blocked, met.tolerated) = (true, true);
            return Ok(true);
        } else if level > 0 && least <= 0.0 {
            level -= 1;
            continue;
        } else if !walk_stretch::<K, H>(walk, sweeps, &course.span, [t, end], strict, met)? {
            return Ok(true);
        }
        t = end;
    }
    Ok(true)
}

/// Whether AB crosses something in the grid on a stretch over a block without voids.
fn has_ground<H>(walk: &mut Walk<'_, H>, sweeps: &[Sweep; 4], span: &Span, stretch: [f64; 2]) -> Result<bool, ReadError>
where
    H: HeightField + ?Sized,
{
    for sweep in sweeps {
        for n in numbers(sweep, span, stretch) {
            if matches!(walk.cross::<Exact>(sweep, n)?, Found::Known(_)) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// The crossings of a stretch.
fn numbers(sweep: &Sweep, span: &Span, [t, end]: [f64; 2]) -> Range<i64> {
    // What comes before the span is outside, except for errors.
    let first = if t > span.low { sweep.until(t) } else { 0 };
    let last = if end < span.high { sweep.until(end) } else { sweep.count };
    first..last
}

/// Walks the crossings of a stretch; whether it is worth going on.
fn walk_stretch<K, H>(
    walk: &mut Walk<'_, H>,
    sweeps: &[Sweep; 4],
    span: &Span,
    stretch: [f64; 2],
    strict: bool,
    met: &mut Met,
) -> Result<bool, ReadError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    for sweep in sweeps {
        if !walk.take::<K>(sweep, numbers(sweep, span, stretch), strict, met)? {
            return Ok(false);
        }
    }
    Ok(true)
}
