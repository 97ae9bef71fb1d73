//! The traversal that skips: over stretches of AB that lie above the greatest heights around them, and first of all to
//! a few places where it is likely to be blocked.
//!
//! **Why no answer changes.** AB is cut into stretches of its parameter t, and each crossing of each sweep belongs to
//! one stretch, by its number. The crossings of a stretch lie within [`PLACE_ERROR`] of what its ends span
//! ([`Course::new`] declines lines for which that does not hold; they are walked in full). So the posts of the faces on
//! which they lie are among those from the floor of the least coordinate less that error to the ceiling of the greatest
//! and that error, as far as those are in the grid. Where none of these is void and the greatest height among them is
//! less than a lower bound of AB's height over the stretch, AB is strictly above each: nothing blocked, unknown or
//! touching is left out. Where some are void, what is left out can only be unknown; so they are passed over in the same
//! way once AB is known to be over unknown ground. The whole of AB at once needs no errors: its crossings lie between
//! its ends, exactly.
//!
//! **Places.** A line is blocked wherever that is proved, so the first places to be looked at lie at fractions 1/2, 1/4,
//! 3/4, 1/8 and so on of AB; there, least heights of blocks come before the ground itself. Nothing but a certain "below"
//! is taken from them.
//!
//! **With a tolerance** h a stretch is passed over when it is above the ground once raised by h. Where the terrain
//! lowered by h blocks, some crossing has ground more than h above the line; its stretch is not passed over, so the
//! answer is BLOCKED. Where the terrain raised by h does not block, nothing is found below the ground. Voids are never
//! passed over before one is found. So the answer is the exact one where both have the same verdict.

use std::ops::Range;

use sightline_proto::predicates::{FLUSHED, Kernel};

use super::{
    earth::Line,
    run::{self, Stop},
    sweep::{ROUNDOFF, Span, Sweep},
    walk::{Met, Walk},
};
use crate::terrain::{HeightField, PageId, ReadError, extremes::BLOCK_SIDE};

/// The most that a computed place on AB may be off, in cells.
const PLACE_ERROR: f64 = 1.0 / 256.0;
/// Stretches of this many posts less one, along x and y, are not cut further.
const LEAF: u32 = 8;
/// Stretches that wait to be looked at. Each cut leaves one waiting, and halves the rest: enough for any grid, and when
/// it is not, a stretch is walked whole.
const WAITING: usize = 48;
/// The most places looked at first.
const MOST_PLACES: usize = 24;

/// Whether AB, both of whose ends are over the grid, is above all ground around it.
#[inline]
pub(super) fn is_clear<H>(walk: &mut Walk<'_, H>, met: &mut Met) -> Result<bool, ReadError>
where
    H: HeightField + ?Sized,
{
    let (a, b) = (walk.a, walk.b);
    let range = |from: f64, to: f64| {
        let last = from.max(to);
        // Casts round down here; the ceiling is one more unless the number is whole.
        let floor = last as u32;
        from.min(to) as u32..=floor + u32::from(f64::from(floor) < last)
    };
    let greatest = walk.posts.greatest(range(a[0], b[0]), range(a[1], b[1]))?;
    let Some(greatest) = greatest.filter(|greatest| !greatest.void) else { return Ok(false) };
    let most = f64::from(greatest.z) - a[2].min(b[2]);
    let clear = most < walk.manner.tolerance;
    met.tolerated |= clear && most >= 0.0;
    Ok(clear || most < 0.0)
}

/// Whether AB, both of whose ends are over the grid, is blocked at one of a few places on it: first by the least height
/// of the block around, for which no page of heights is read, then, where the block rises above it, at a crossing.
#[inline]
pub(super) fn is_blocked_at_places<H>(walk: &mut Walk<'_, H>, sweep: &Sweep) -> Result<bool, ReadError>
where
    H: HeightField + ?Sized,
{
    let count = sweep.count as u64;
    let mut rising = Rising::default();
    if is_below_blocks(walk, count / 3, |z, _| z, 0.0, &mut rising)? {
        return Ok(true);
    }
    for &part in &rising.parts[..if sweep.inside { rising.count } else { 0 }] {
        let n = ((u64::from(part) * count) >> 32) as i64;
        let id = PageId::of(walk.posts.grid().clamp(sweep.near(n)));
        let page = walk.posts.page(id)?;
        if run::run(sweep, page, id, n..n + 1, &mut false) == Stop::Blocked {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Whether AB, both of whose ends are over the grid and which is lowered by its bulge, is below all ground of a block at
/// one of a few places on it.
pub(super) fn is_curved_below_blocks<H>(walk: &mut Walk<'_, H>, line: &Line) -> Result<bool, ReadError>
where
    H: HeightField + ?Sized,
{
    let [wide, high] = [0, 1].map(|k: usize| (line.b[k] - line.a[k]).abs());
    let lowered = |z: f64, t: f64| z - line.bulge(t);
    let error = line.bulge_error(0.0) + 2.0 * ROUNDOFF * line.bend;
    is_below_blocks(walk, wide.max(high) as u64 / 3, lowered, error, &mut Rising::default())
}

/// Places, as parts of AB in units of 2^-32, where the block around rises above AB.
#[derive(Default)]
struct Rising {
    parts: [u32; MOST_PLACES],
    count: usize,
}

/// Whether AB is below a block at one of at most so many places.
///
/// The point at t, a number without rounding, lies within [`PLACE_ERROR`] of the rounded one, so it is over a cell all of
/// whose posts are in the block. Its height is off by three roundings of numbers up to twice those of the ends, and by
/// `error` once lowered.
#[inline]
fn is_below_blocks<H>(
    walk: &mut Walk<'_, H>,
    places: u64,
    lowered: impl Fn(f64, f64) -> f64,
    error: f64,
    rising: &mut Rising,
) -> Result<bool, ReadError>
where
    H: HeightField + ?Sized,
{
    let (a, b, grid) = (walk.a, walk.b, walk.posts.grid());
    let by = [0, 1, 2].map(|k: usize| b[k] - a[k]);
    let z_error = 8.0 * ROUNDOFF * a[2].abs().max(b[2].abs()) + FLUSHED + error;
    for k in 1..=places.min(MOST_PLACES as u64) as u32 {
        // k in binary, reversed: 1/2, 1/4, 3/4, 1/8, 5/8, ...
        let part = k.reverse_bits();
        let t = f64::from(part) * (1.0 / (1_u64 << 32) as f64);
        let [x, y, z] = [0, 1, 2].map(|n: usize| a[n] + t * by[n]);
        let z = lowered(z, t);
        let (i, j) = ((x as u32).min(grid.nx() - 1), (y as u32).min(grid.ny() - 1));
        let Some((least, greatest)) = walk.posts.block_around(i, j)? else {
            rising.parts[rising.count] = part;
            rising.count += 1;
            continue;
        };
        if z + z_error < f64::from(least) && is_within_block(x, i) && is_within_block(y, j) {
            return Ok(true);
        }
        rising.parts[rising.count] = part;
        rising.count += usize::from(z < f64::from(greatest));
    }
    Ok(false)
}

/// Whether a coordinate, whose floor is `i`, lies between posts of one block, by more than it may be off.
#[inline]
fn is_within_block(v: f64, i: u32) -> bool {
    let from = v - f64::from(i & !(BLOCK_SIDE - 1));
    from > PLACE_ERROR && from < f64::from(BLOCK_SIDE - 1) - PLACE_ERROR
}

/// AB as the traversal needs it: places and heights with bounded errors.
struct Course {
    from: [f64; 2],
    by: [f64; 2],
    /// The last column and row of the grid.
    last: [f64; 2],
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
    fn new<H>(walk: &Walk<'_, H>, span: Span, sweeps: &[Sweep; 4]) -> Option<Self>
    where
        H: HeightField + ?Sized,
    {
        let (a, b, grid) = (walk.a, walk.b, walk.posts.grid());
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
        let last = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
        Some(Self { from: [a[0], a[1]], by, last, z: a[2], rise, z_error, span })
    }

    /// The columns (axis 0) or rows (axis 1) of posts that a stretch needs.
    #[inline]
    fn posts(&self, axis: usize, [t, end]: [f64; 2]) -> [u32; 2] {
        let (from, by, last) = (self.from[axis], self.by[axis], self.last[axis]);
        let ends = [from + t * by, from + end * by];
        let low = ends[0].min(ends[1]) - PLACE_ERROR;
        let high = ends[0].max(ends[1]) + PLACE_ERROR;
        // Casts round down what is not negative, and negative numbers to 0.
        [low.min(last) as u32, (high.max(0.0) + 1.0).min(last) as u32]
    }

    /// A height that AB is nowhere below over a stretch.
    #[inline]
    fn least_z(&self, [t, end]: [f64; 2]) -> f64 {
        (self.z + t * self.rise).min(self.z + end * self.rise) - self.z_error
    }
}

/// Walks the crossings of AB that blocks do not settle. Returns whether it did; when not, nothing has been walked.
pub(super) fn walk<K, H>(
    walk: &mut Walk<'_, H>,
    sweeps: &[Sweep; 4],
    span: Span,
    strict: bool,
    met: &mut Met,
) -> Result<bool, ReadError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    let Some(course) = Course::new(walk, span, sweeps) else { return Ok(false) };
    let tolerance = walk.manner.tolerance;
    let mut waiting = [[0.0; 2]; WAITING];
    waiting[0] = [span.low, span.high];
    let mut count = 1;
    while count > 0 {
        count -= 1;
        let stretch = waiting[count];
        let ([west, east], [south, north]) = (course.posts(0, stretch), course.posts(1, stretch));
        let small = (east - west).max(north - south) <= LEAF;
        if let Some(greatest) = walk.posts.greatest(west..=east, south..=north)?
            && (!greatest.void || met.unknown)
        {
            // How far the ground may rise above the line. Rounding keeps order, so it is less than a number if its
            // rounded value is.
            let most = f64::from(greatest.z) - course.least_z(stretch);
            if most < 0.0 || most < tolerance {
                met.tolerated |= most >= 0.0;
                continue;
            }
        }
        let middle = (stretch[0] + stretch[1]) / 2.0;
        if !small && count + 2 <= WAITING && stretch[0] < middle && middle < stretch[1] {
            waiting[count] = [middle, stretch[1]];
            waiting[count + 1] = [stretch[0], middle];
            count += 2;
        } else if !walk_stretch::<K, H>(walk, sweeps, &course.span, stretch, strict, met)? {
            break;
        }
    }
    Ok(true)
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
