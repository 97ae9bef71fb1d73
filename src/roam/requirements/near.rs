//! Which lines may meet the area of a diamond in plan: squares of the grid with the lines that may cross them.

use sightline_proto::diamond::Post;

use super::RequiredLine;
use crate::terrain::Grid;

/// Squares along the longer side of the grid, at most.
const SQUARES: u32 = 64;
/// Coordinates beyond which a line is taken to be everywhere. Within, the arithmetic below is off by less than 2^-16.
const FAR: f64 = 4_294_967_296.0;
/// By how much the part of a line in a row of squares is widened, in posts: above that rounding.
const MARGIN: f64 = 1.0 / 1024.0;

/// Lines by square.
#[derive(Debug)]
pub(super) struct Near {
    shift: u32,
    side: u32,
    squares: Vec<Vec<u32>>,
}

impl Near {
    pub(super) fn new(grid: Grid) -> Self {
        let cells = grid.nx().max(grid.ny()) - 1;
        let shift = (u32::BITS - cells.leading_zeros()).saturating_sub(SQUARES.ilog2());
        let side = (cells >> shift) + 1;
        Self { shift, side, squares: vec![Vec::new(); (side * side) as usize] }
    }

    /// Forgets all lines and takes these, numbered as they come.
    pub(super) fn fill<'a>(&mut self, lines: impl Iterator<Item = &'a RequiredLine>) {
        self.squares.iter_mut().for_each(Vec::clear);
        for (n, line) in (0..).zip(lines) {
            self.insert(n, line);
        }
    }

    fn insert(&mut self, n: u32, line: &RequiredLine) {
        let ([ax, ay, _], [bx, by, _]) = (line.a, line.b);
        let is_everywhere = [ax, ay, bx, by].iter().any(|v| v.is_nan() || v.abs() > FAR);
        if is_everywhere {
            self.squares.iter_mut().for_each(|square| square.push(n));
            return;
        }
        let (south, north) = (self.square(ay.min(by) - MARGIN), self.square(ay.max(by) + MARGIN));
        let size = f64::from(1_u32 << self.shift);
        for row in south..=north {
            let (mut low, mut high) = (ax.min(bx), ax.max(bx));
            if ay != by {
                // Where the line is between the row's borders; the outermost rows reach as far as the line does.
                let at = |y: f64| ax + ((y - ay) / (by - ay)).clamp(0.0, 1.0) * (bx - ax);
                let from = if row == 0 { ay.min(by) } else { f64::from(row) * size - MARGIN };
                let to = if row == self.side - 1 { ay.max(by) } else { f64::from(row + 1) * size + MARGIN };
                let (p, q) = (at(from), at(to));
                (low, high) = (p.min(q), p.max(q));
            }
            for column in self.square(low - MARGIN)..=self.square(high + MARGIN) {
                self.squares[(row * self.side + column) as usize].push(n);
            }
        }
    }

    /// Calls `visit` with the numbers of lines that may meet the closed area of the diamond at `p`; with some more than
    /// once.
    pub(super) fn for_each(&self, p: Post, mut visit: impl FnMut(u32)) {
        let reach = 1_u32 << (p.i | p.j).trailing_zeros().min(31);
        let range = |v: u32| {
            let last = self.side - 1;
            (v.saturating_sub(reach) >> self.shift).min(last)..=(v.saturating_add(reach) >> self.shift).min(last)
        };
        for row in range(p.j) {
            for column in range(p.i) {
                self.squares[(row * self.side + column) as usize].iter().for_each(|&n| visit(n));
            }
        }
    }

    fn square(&self, v: f64) -> u32 {
        // Casts of what is beyond the grid end up at its border.
        (v as u32 >> self.shift).min(self.side - 1)
    }
}

/// Whether the line may meet the closed area of the diamond at `p` in plan; `true` when in doubt.
///
/// The area lies within b posts of p in each direction, b being the lowest bit of its coordinates. So the line through A
/// and B misses it when the vector product of B - A and p - A exceeds b (|dx| + |dy|) in magnitude. Its two products and
/// six differences round by less than 2^-50 of the magnitudes summed in `slack`. What is not a number misses nothing.
pub(super) fn may_touch(line: &RequiredLine, p: Post) -> bool {
    let reach = f64::from(1_u32 << (p.i | p.j).trailing_zeros().min(31));
    let (x, y) = (f64::from(p.i), f64::from(p.j));
    let ([ax, ay, _], [bx, by, _]) = (line.a, line.b);
    if ax.min(bx) > x + reach || ax.max(bx) < x - reach || ay.min(by) > y + reach || ay.max(by) < y - reach {
        return false;
    }
    let (dx, dy) = (bx - ax, by - ay);
    let product = dx * (y - ay) - dy * (x - ax);
    let spread = reach * (dx.abs() + dy.abs());
    let magnitude = (ax.abs() + bx.abs()) * (y + ay.abs()) + (ay.abs() + by.abs()) * (x + ax.abs()) + spread;
    let slack = magnitude * 1e-14;
    let misses = product.abs() > spread + slack;
    !misses
}
