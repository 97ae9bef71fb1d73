//! The tight thickness of diamonds that lie in the grid with all their posts, by visiting these, four diamonds abreast.
//!
//! All diamonds of one kind in a row of a lattice have the same shape, so what is done at a post of one is done at the same
//! post of three others. Along a row of posts the planes of the two triangles are two straight lines, which meet where the
//! row crosses the base:
//!
//! ```text
//!   square  nw ─── ne        tilted    n
//!           │    / │                 / │ \
//!           │  /   │               w ──┼── e     base w e, or s n
//!           │/     │                 \ │ /
//!           sw ─── se                  s         base sw ne, or nw se
//! ```
//!
//! Only for heights on which arithmetic is exact (`deviation::arithmetic_is_exact`): then all ways to a deviation give the
//! same, and this is what [`super::deviation::scan`] finds.

use std::array::from_fn;

use super::{band::Band, pyramid::Parity, round_up};

/// Diamonds that are scanned together.
const ABREAST: usize = 4;
/// A number of each of them.
type Four = [f64; ABREAST];

/// The tight thicknesses of `count` diamonds of half-length `h`, rounded up. They are centred in row `j` of the grid, the
/// westernmost in column `first`, each next one 2 `h` further east.
pub(super) fn tight(band: &Band, kind: Parity, h: u32, j: u32, first: u32, count: usize) -> Vec<f32> {
    // The bases of neighbouring squares run across each other.
    let apart = if kind == Parity::Square { 2 } else { 1 };
    let mut tight = vec![0.0; count];
    for from in 0..apart.min(count) {
        let alike = (count - from).div_ceil(apart);
        for start in (0..alike).step_by(ABREAST) {
            // The last four may be some of those before again; of fewer than four, the last stands for all that lack.
            let start = start.min(alike.saturating_sub(ABREAST));
            let members: [usize; ABREAST] = from_fn(|n| from + apart * (start + n).min(alike - 1));
            let mut scan =
                Scan { band, h, j, columns: members.map(|n| first + 2 * h * n as u32), greatest: [0.0; ABREAST] };
            match kind {
                Parity::Square => scan.squares(),
                Parity::Tilted => scan.tilted(),
            }
            for (n, greatest) in members.into_iter().zip(scan.greatest) {
                tight[n] = round_up(greatest);
            }
        }
    }
    tight
}

/// Four diamonds whose bases run the same way.
struct Scan<'a> {
    band: &'a Band,
    h: u32,
    /// The row of their centres, and the columns.
    j: u32,
    columns: [u32; ABREAST],
    /// The greatest deviations so far.
    greatest: Four,
}

impl Scan<'_> {
    /// Two triangles that are a square, split along a diagonal.
    fn squares(&mut self) {
        let Self { h, j, columns: [i, ..], .. } = *self;
        let rises = (i / (2 * h) + j / (2 * h)).is_multiple_of(2);
        let [south, north] = [j - h, j + h];
        let [sw, se] = self.at(south, h);
        let [nw, ne] = self.at(north, h);
        let [bottom, top, left] = [(sw, se), (nw, ne), (sw, nw)].map(|(from, to)| slope(from, to, 2 * h));
        let steps = if rises { [top, bottom] } else { [bottom, top] };
        for n in 0..=2 * h {
            let bend = if rises { n } else { 2 * h - n };
            self.visit(south + n, h, along(sw, left, n), steps, bend);
        }
    }

    /// Two triangles that are a square on its corner, split along its row or along its column.
    fn tilted(&mut self) {
        let Self { h, j, columns: [i, ..], .. } = *self;
        let [w, e] = self.at(j, h);
        let [[s, _], [n, _]] = [j - h, j + h].map(|j| self.at(j, 0));
        let base_runs_east = i / h % 2 == 1;
        let steps = if base_runs_east {
            [slope(w, e, 2 * h); 2]
        } else {
            let middle = from_fn(|lane| 0.5 * s[lane] + 0.5 * n[lane]);
            [slope(w, middle, h), slope(middle, e, h)]
        };
        let edges = [slope(w, s, h), slope(w, n, h)];
        for d in 0..h {
            self.visit(j + d, h - d, along(w, edges[1], d), steps, h - d);
            if d > 0 {
                self.visit(j - d, h - d, along(w, edges[0], d), steps, h - d);
            }
        }
    }

    /// The heights `reach` columns west and east of the centres, in row `j`.
    fn at(&self, j: u32, reach: u32) -> [Four; 2] {
        let row = self.band.row(j);
        [self.columns.map(|i| row[(i - reach) as usize]), self.columns.map(|i| row[(i + reach) as usize])]
    }

    /// Takes in the posts of row `j` up to `reach` columns from the centres, over planes that are at `plane` in the west
    /// and go by the first of `steps` up to post `bend`, by the second from there.
    #[inline]
    fn visit(&mut self, j: u32, reach: u32, mut plane: Four, steps: [Four; 2], bend: u32) {
        let (row, posts, bend) = (self.band.row(j), 2 * reach as usize + 1, bend as usize);
        let heights = |i: u32| &row[(i - reach) as usize..][..posts];
        let [a, b, c, d] = self.columns;
        let [a, b, c, d] = [heights(a), heights(b), heights(c), heights(d)];
        let mut greatest = self.greatest;
        for (range, step) in [(0..bend, steps[0]), (bend..posts, steps[1])] {
            for post in range {
                let heights = [a[post], b[post], c[post], d[post]];
                for n in 0..ABREAST {
                    let stray = (heights[n] - plane[n]).abs();
                    greatest[n] = if stray > greatest[n] { stray } else { greatest[n] };
                    plane[n] += step[n];
                }
            }
        }
        self.greatest = greatest;
    }
}

/// What is added a post on the way from heights `from` to heights `to`, `posts` away: a power of two.
fn slope(from: Four, to: Four, posts: u32) -> Four {
    let share = 1.0 / f64::from(posts);
    from_fn(|n| (to[n] - from[n]) * share)
}

/// Heights `posts` steps of `slope` away from `start`.
fn along(start: Four, slope: Four, posts: u32) -> Four {
    from_fn(|n| start[n] + slope[n] * f64::from(posts))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{terrain::synthetic, wedgie::deviation::scan};
    use sightline_proto::diamond::Post;

    /// Rows of all lengths, those of fewer than four diamonds among them, and bases in all four directions.
    #[test]
    fn four_at_once_stray_as_far_as_each_alone() {
        for (nx, ny) in [(9, 9), (38, 21), (70, 70), (531, 131)] {
            let field = synthetic::fractal(nx, ny, 4, 700).unwrap();
            let band = Band::load(&field, 0, ny - 1).unwrap();
            for (k, j) in (1..6_u32).flat_map(|k| (0..ny).step_by(1 << k).map(move |j| (k, j))) {
                let h = 1 << k;
                if j < h || j + h >= ny {
                    continue;
                }
                let is_odd = j / h % 2 == 1;
                let kinds =
                    if is_odd { [(Parity::Square, h), (Parity::Tilted, 2 * h)] } else { [(Parity::Tilted, h); 2] };
                for (kind, first) in kinds {
                    let centres: Vec<_> = (first..nx.saturating_sub(h)).step_by(2 * h as usize).collect();
                    let alone: Vec<_> = centres.iter().map(|&i| scan(&band, true, Post::new(i, j))).collect();
                    assert_eq!(tight(&band, kind, h, j, first, centres.len()), alone, "{nx} x {ny}: {h} {j} {kind:?}");
                }
            }
        }
    }
}
