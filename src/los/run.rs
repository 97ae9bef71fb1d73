//! The inner loop: crossings in a row whose edges lie in one page, each settled by its rounded clearance and a bound.
//!
//! What it decides is certain, in the errors of [`super::sweep`]; at the first crossing that it cannot decide it stops
//! and says so. Everything that holds for the whole page (type of sample, voids, the errors' parts that depend on
//! heights) is found out before the loop.

use std::ops::Range;

use super::sweep::{ROUNDOFF, Sweep, TRUSTED_MAGNITUDE};
use crate::terrain::{HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, Samples};

/// How a run of crossings ended.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Stop {
    /// The line is strictly above the ground at all of them, as far as that is known.
    Through,
    /// At this crossing the line is strictly below known ground.
    Blocked,
    /// This crossing is undecided: in doubt, close to a post, or not over an edge within the page.
    At(i64),
}

/// 1.5 2^52: added to a number of less than 2^31 in magnitude it leaves a whole number in the low bits.
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// How lines of a family lie in a page.
struct Layout {
    /// Column and row, in the page, of the post v = 0 of the first line, and what the next line adds.
    origin: [i64; 2],
    per_line: [i64; 2],
    /// What the next post along a line adds: -1, 0 or 1.
    per_post: [i64; 2],
}

impl Layout {
    fn new(sweep: &Sweep, page: PageId, first: i64) -> Self {
        let (c, step) = (sweep.line(first), sweep.step());
        let (post, along) = sweep.family.layout();
        let corner = [i64::from(page.pi * PAGE_SIDE), i64::from(page.pj * PAGE_SIDE)];
        Self {
            origin: [0, 1].map(|k| post[k] * c - corner[k]),
            per_line: post.map(|of_c| of_c * step),
            per_post: along,
        }
    }
}

/// Decides crossings `range` of a sweep that is [`Sweep::inside`], on the edges of `page`; `unknown` is set when one is
/// over an edge with a void post.
#[inline]
pub(super) fn run(sweep: &Sweep, page: &HeightPage, id: PageId, range: Range<i64>, unknown: &mut bool) -> Stop {
    match page.samples() {
        Samples::I16(samples) => run_on(sweep, samples, page, id, range, unknown),
        Samples::I32(samples) => run_on(sweep, samples, page, id, range, unknown),
        Samples::F64(samples) => run_on(sweep, samples, page, id, range, unknown),
    }
}

/// The interpolated height is off by |q - p| times the error of the fraction, and by at most 6 u max(|p|, |q|) for its
/// three roundings; with m the greatest magnitude on the page, by less than 2 m error(v) + 16 u m in all. Where the
/// fraction is within its error of 0 or 1 the crossing may lie on another edge, and is left alone. Where q - p
/// overflows, m does when doubled, and nothing is decided.
#[inline]
fn run_on<S>(
    sweep: &Sweep,
    samples: &[S; PAGE_POSTS],
    page: &HeightPage,
    id: PageId,
    range: Range<i64>,
    unknown: &mut bool,
) -> Stop
where
    S: Copy + Into<f64>,
{
    let layout = Layout::new(sweep, id, range.start);
    let voids = page.voids();
    let magnitude = page.maxima().magnitude();
    if magnitude > TRUSTED_MAGNITUDE {
        return Stop::At(range.start);
    }
    let bound = sweep.z_error + (2.0 * sweep.v_error + 16.0 * ROUNDOFF) * magnitude;
    let inner = 0.5 - sweep.v_error - 2.0 * ROUNDOFF;
    let [mut i_zero, mut j_zero] = layout.origin;
    for n in range {
        let crossing = sweep.crossing(n);
        // v rounded down, except that a whole v may become the number below: then the fraction is 1.
        let shifted = (crossing.v - 0.5) + WHOLE;
        let v = i64::from(shifted.to_bits() as i32);
        let fraction = crossing.v - (shifted - WHOLE);
        let (i, j) = (i_zero + layout.per_post[0].wrapping_mul(v), j_zero + layout.per_post[1].wrapping_mul(v));
        i_zero += layout.per_line[0];
        j_zero += layout.per_line[1];
        let (i_next, j_next) = (i + layout.per_post[0], j + layout.per_post[1]);
        // A negative number has bits above those of a page's columns too.
        if (i | j | i_next | j_next) & !i64::from(PAGE_SIDE - 1) != 0 {
            return Stop::At(n);
        }
        let at = |i: i64, j: i64| (j * i64::from(PAGE_SIDE) + i) as usize % PAGE_POSTS;
        let (at_p, at_q) = (at(i, j), at(i_next, j_next));
        let (p, q): (f64, f64) = (samples[at_p].into(), samples[at_q].into());
        let clearance = crossing.z - (p + fraction * (q - p));
        if clearance > bound && (fraction - 0.5).abs() < inner && voids.is_none() {
            continue;
        }
        if (fraction - 0.5).abs() >= inner || clearance.is_nan() {
            return Stop::At(n);
        }
        if let Some(voids) = voids
            && [at_p, at_q].iter().any(|&at| voids[at / 64] >> (at % 64) & 1 == 1)
        {
            *unknown = true;
        } else if clearance < -bound {
            return Stop::Blocked;
        } else if clearance <= bound || bound.is_nan() {
            return Stop::At(n);
        }
    }
    Stop::Through
}
