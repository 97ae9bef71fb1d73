//! Following the path of one target back towards A, crossing by crossing, until the bounds of the sector before are
//! below it: near the target the ground's own slope across the sector is what leaves the doubt.
//!
//! From a column to the next a path of slope |m| <= 1 crosses exactly one diagonal, and a row when it changes cells. Let
//! f be its place in the cell it starts in, and m its step:
//!
//! ```text
//!   stays:  rising f + m t = t       falling  f + m t = 1 - t
//!   up:     lower falling  f + m t = 1 - t          else upper falling  f - 1 + m t = 1 - t
//!   down:   upper rising   f + m t = t              else lower rising   f + 1 + m t = t
//! ```
//!
//! **Errors.** Places are off by 2^-51 of the reach, less than 2^-34 posts, which a division by 1 - |m| or by |m|
//! magnifies: where those are below 2^-8 the walk gives up. So heights are off by less than [`super::push::margin`].
//! Which cell a path is in may be wrong within the error of a post; the ground is continuous, and so is the result.

use super::{
    column::{Column, Shot},
    fan::{BACK, Fan},
    push::floor,
};
use crate::{los::Verdict, terrain::HeightField};

/// Steps across that are smaller, and slopes nearer to 1, are left to the query.
const STEEP: f64 = 1.0 / 256.0;

impl<H: HeightField + ?Sized> Fan<'_, H> {
    /// Whether the target at the projected height `target` and slope y / x of the column at hand is visible or blocked,
    /// when its path has no gap and is clear after the column before; `None` in doubt.
    pub(super) fn back(&self, y: f64, shot: Shot, target: f64, margin: f64) -> Option<Verdict> {
        let m = y * self.column(self.n).per_x;
        let whole = self.frame.across.floor();
        let fraction = self.frame.across - whole;
        // Indices across relative to A's, where places have small errors.
        let place = |column: &Column| m * column.x + fraction;
        let whole = whole as i64;
        let last = self.n.saturating_sub(BACK);
        let mut crossings = [0.0; 2];
        for n in (last..self.n).rev() {
            let column = self.column(n);
            let at = place(column);
            let cell = floor(at);
            let (s, t) = (column.at(whole + cell), column.at(whole + cell + 1));
            let mut error = margin + super::push::margin(&self.frame, column, column);
            if !clears(target, error, s + (at - cell as f64) * (t - s))? {
                return Some(Verdict::Blocked);
            }
            if n > 0 {
                let before = self.column(n - 1);
                error += super::push::margin(&self.frame, before, before);
                let count = strip(before, column, whole, [place(before), at], &mut crossings)?;
                for &crossing in &crossings[..count] {
                    if !clears(target, error, crossing)? {
                        return Some(Verdict::Blocked);
                    }
                }
            }
            if target - margin > self.bounds(self.upper(n), shot).upper {
                return Some(Verdict::Visible);
            }
        }
        None
    }
}

/// Whether the target is above a crossing; `None` in doubt, and when that is NaN.
#[inline]
fn clears(target: f64, error: f64, crossing: f64) -> Option<bool> {
    if target - error > crossing {
        Some(true)
    } else if target + error < crossing {
        Some(false)
    } else {
        None
    }
}

/// The projected heights of the crossings between two columns, at most two, and how many they are.
fn strip(before: &Column, column: &Column, whole: i64, [from, to]: [f64; 2], out: &mut [f64; 2]) -> Option<usize> {
    let (cell, next) = (floor(from), floor(to));
    let (f, m) = (from - cell as f64, to - from);
    if 1.0 - m.abs() < STEEP {
        return None;
    }
    let even = |cell: i64| (before.a + whole + cell) & 1 == 0;
    // The cell whose diagonal is crossed, and where in it the path would start.
    let (rising, crossed, f) = match next - cell {
        0 => (even(cell), cell, f),
        1 if !even(cell) => (false, cell, f),
        1 => (false, cell + 1, f - 1.0),
        -1 if even(cell) => (true, cell, f),
        -1 => (true, cell - 1, f + 1.0),
        _ => return None,
    };
    let b = whole + crossed;
    let (t, first, second) = if rising { (f / (1.0 - m), b, b + 1) } else { ((1.0 - f) / (1.0 + m), b + 1, b) };
    out[0] = between(before, column, [before.at(first), column.at(second)], t);
    if next == cell {
        return Some(1);
    }
    if m.abs() < STEEP {
        return None;
    }
    let row = cell.max(next);
    let t = (row as f64 - from) / m;
    let b = whole + row;
    out[1] = between(before, column, [before.at(b), column.at(b)], t);
    Some(2)
}

/// The projected height at a share of the edge from one column to the other.
fn between(before: &Column, column: &Column, [s, t]: [f64; 2], share: f64) -> f64 {
    let share = share.clamp(0.0, 1.0);
    let (near, far) = ((1.0 - share) * before.x, share * column.x);
    (near * s + far * t) / (near + far)
}
