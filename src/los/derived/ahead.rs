//! Stretches of AB with the greatest ground around them, so that derived values need not look at what cannot matter.
//!
//! A stretch is a range of t; the crossings in it are those that [`Sweep::until`] counts, and lie within
//! [`PLACE_ERROR`] of what its ends span, or there is no skipping. So the posts of their faces are among those from the
//! floor of the least coordinate less that error to the ceiling of the greatest and that error. A stretch that is not
//! wholly in the grid by that reckoning, or with a void post there, is never passed over.

use sightline_proto::predicates::FLUSHED;

use crate::{
    los::{
        earth::Line,
        sweep::{ROUNDOFF, Sweep},
        walk::Walk,
    },
    terrain::{HeightField, ReadError},
};

/// The most that a computed place on AB may be off, in cells.
const PLACE_ERROR: f64 = 1.0 / 256.0;
/// The shortest stretch that is tried, in cells along the longer axis. A guess.
const LEAF_CELLS: f64 = 8.0;
/// Lines shorter than this are not worth it.
const LEAST_CELLS: f64 = 32.0;

/// AB as far as stretches need it.
pub(in crate::los) struct Ahead {
    line: Line,
    last: [f64; 2],
    /// Bound of the error of the lowered line's height at the crossings of a stretch.
    error: f64,
    /// The length of the shortest stretch in t.
    pub(in crate::los) leaf: f64,
}

/// A stretch over known ground.
#[derive(Clone, Copy, Debug)]
pub(in crate::los) struct Stretch {
    /// In t.
    pub(in crate::los) ends: [f64; 2],
    /// A height that the lowered line is nowhere below.
    pub(in crate::los) line: f64,
    /// A height that the ground is nowhere above.
    pub(in crate::los) ground: f64,
    /// More than a line lowered by its bulge can be below both its ends.
    pub(in crate::los) sag: f64,
}

impl Ahead {
    /// `None` where numbers are too rough for skipping, or the line is short.
    pub(in crate::los) fn new<H>(walk: &Walk<'_, H>, line: &Line, sweeps: &[Sweep; 4]) -> Option<Self>
    where
        H: HeightField + ?Sized,
    {
        let grid = walk.posts.grid();
        let used = || sweeps.iter().filter(|sweep| sweep.count > 0);
        if walk.manner.plain || !used().all(|sweep| sweep.trusted) || !line.bend.is_finite() {
            return None;
        }
        let (a, b) = (line.a, line.b);
        let t_error = used().fold(0.0_f64, |e, sweep| e.max(sweep.t_error)) + 32.0 * ROUNDOFF;
        let cells = (b[0] - a[0]).abs().max((b[1] - a[1]).abs());
        let size = [a[0], a[1], b[0], b[1]].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let error = t_error * cells + 16.0 * ROUNDOFF * size;
        if error.is_nan() || error > PLACE_ERROR || cells < LEAST_CELLS {
            return None;
        }
        let rise = (b[2] - a[2]).abs();
        let error = t_error * (rise + line.bend) + 16.0 * ROUNDOFF * (a[2].abs().max(b[2].abs()) + line.bend) + FLUSHED;
        let last = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
        Some(Self { line: *line, last, error, leaf: LEAF_CELLS / cells })
    }

    /// The stretch from `t` to `end`; `None` when it is not over known ground for certain.
    pub(in crate::los) fn stretch<H>(
        &self,
        walk: &mut Walk<'_, H>,
        t: f64,
        end: f64,
    ) -> Result<Option<Stretch>, ReadError>
    where
        H: HeightField + ?Sized,
    {
        let (Some([west, east]), Some([south, north])) = (self.posts(0, t, end), self.posts(1, t, end)) else {
            return Ok(None);
        };
        let Some(greatest) = walk.posts.greatest(west..=east, south..=north)?.filter(|g| !g.void) else {
            return Ok(None);
        };
        let sag = 0.26 * self.line.bend * (end - t) * (end - t);
        let [from, to] = [t, end].map(|t| self.line.a[2] + t * (self.line.b[2] - self.line.a[2]) - self.line.bulge(t));
        let line = from.min(to) - sag - self.error;
        Ok(Some(Stretch { ends: [t, end], line, ground: greatest.z.into(), sag }))
    }

    /// The columns (axis 0) or rows (axis 1) of posts that a stretch needs; `None` when it may leave the grid.
    fn posts(&self, axis: usize, t: f64, end: f64) -> Option<[u32; 2]> {
        let (from, by) = (self.line.a[axis], self.line.b[axis] - self.line.a[axis]);
        let ends = [from + t * by, from + end * by];
        let (low, high) = (ends[0].min(ends[1]) - PLACE_ERROR, ends[0].max(ends[1]) + PLACE_ERROR);
        // Casts round down what is not negative.
        (low >= 0.0 && high <= self.last[axis]).then(|| [low as u32, (high + 1.0).min(self.last[axis]) as u32])
    }
}
