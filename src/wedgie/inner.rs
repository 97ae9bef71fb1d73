//! The nested thickness and the ball of diamonds that lie in the grid with all their corners: nearly all. What the
//! general way looks up and checks post by post is at hand row by row here, and the numbers are the same.

use sightline_proto::diamond::Post;

use super::{
    BALL_MARGIN, DiamondBounds, abreast,
    band::Band,
    deviation::scan,
    finest::{Steps, far},
    pyramid::Parity,
    round_up,
};
use crate::terrain::SceneScale;

/// What the inner diamonds of one kind, in one row of a lattice, follow from.
pub(super) struct InnerRow<'a> {
    k: u8,
    /// The column of the first of them.
    first: u32,
    /// Their tight thicknesses.
    tight: Vec<f32>,
    /// The rows of heights a half-length south of the diamonds, through them, and a half-length north.
    heights: [&'a [f64]; 3],
    /// Of a half-length.
    steps: Steps,
    children: Children<'a>,
}

/// The bounds of the children of a row of diamonds.
pub(super) enum Children<'a> {
    /// Of tilted diamonds: half a half-length away along both axes.
    Aslant {
        /// The rows of heights south and north.
        heights: [&'a [f64]; 2],
        /// The rows of bounds south and north, of the posts with an odd multiple of 2^k in both coordinates.
        bounds: [&'a [DiamondBounds]; 2],
        /// The square of the metres to them in plan.
        step2: f64,
        /// What an index of a column of the grid is shifted by for one of the bounds.
        shift: u8,
    },
    /// Of square diamonds: a half-length away along either axis; the rows of bounds south, through them, and north.
    Straight([&'a [DiamondBounds]; 3]),
}

impl<'a> Children<'a> {
    /// Of tilted diamonds in row `j` of the grid, children at `step` from them.
    pub(super) fn aslant(
        band: &'a Band,
        scale: SceneScale,
        j: u32,
        step: u32,
        bounds: [&'a [DiamondBounds]; 2],
        shift: u8,
    ) -> Self {
        let steps = Steps::new(scale, step);
        let heights = [band.row(j - step), band.row(j + step)];
        Self::Aslant { heights, bounds, step2: steps.east2 + steps.north2, shift }
    }
}

impl<'a> InnerRow<'a> {
    /// Row `j` of the grid, which is a half-length 2^k or more away from its first and its last. `exact` is what
    /// [`super::deviation::arithmetic_is_exact`] says of the field.
    pub(super) fn new(
        band: &'a Band,
        scale: SceneScale,
        exact: bool,
        kind: Parity,
        k: u8,
        j: u32,
        children: Children<'a>,
    ) -> Self {
        let h = 1 << k;
        // Tilted diamonds of odd rows of the lattice are in its even columns, of which the first has a corner beyond the grid.
        let first = if kind == Parity::Tilted && (j >> k) % 2 == 1 { 2 * h } else { h };
        let count = band.grid().nx().saturating_sub(first).saturating_sub(h).div_ceil(2 * h) as usize;
        let tight = if !exact {
            (first..).step_by(2 * h as usize).take(count).map(|i| scan(band, exact, Post::new(i, j))).collect()
        } else if band.is_level() {
            // Water and plains are left out: nothing deviates.
            vec![0.0; count]
        } else {
            abreast::tight(band, kind, h, j, first, count)
        };
        let heights = [band.row(j - h), band.row(j), band.row(j + h)];
        Self { k, first, tight, heights, steps: Steps::new(scale, h), children }
    }

    /// The bounds of the diamond at `p`, if it is one of these.
    #[inline]
    pub(super) fn get(&self, p: Post) -> Option<DiamondBounds> {
        let n = p.i.checked_sub(self.first)? >> (self.k + 1);
        self.tight.get(n as usize).map(|&tight| self.nest(p, tight))
    }

    #[inline]
    fn nest(&self, p: Post, tight: f32) -> DiamondBounds {
        let (i, h) = (p.i as usize, 1_usize << self.k);
        let [south, row, north] = self.heights;
        let z = row[i];
        let to = |height: f64| self.steps.rise2(z, height);
        let Steps { east2, north2, .. } = self.steps;
        let mut nested = tight;
        let mut take = |reach: f64, distance2: f64, child: DiamondBounds| {
            nested = if child.nested > nested { child.nested } else { nested };
            far(reach, distance2.sqrt() + f64::from(child.radius_m))
        };
        let reach = match &self.children {
            Children::Straight([below, beside, above]) => {
                let a = i >> self.k;
                // Squares order as what they are squares of, and so do rounded roots.
                let corners = [south[i - h], south[i + h], north[i - h], north[i + h]];
                let corners = corners.into_iter().fold(0.0, |most, corner| far(most, east2 + north2 + to(corner)));
                let reach = take(corners.sqrt(), east2 + to(row[i - h]), beside[a - 1]);
                let reach = take(reach, east2 + to(row[i + h]), beside[a + 1]);
                let reach = take(reach, north2 + to(south[i]), below[a]);
                take(reach, north2 + to(north[i]), above[a])
            }
            Children::Aslant { heights: [south_west, north_west], bounds: [below, above], step2, shift } => {
                let half = h / 2;
                let corners = [(east2, row[i - h]), (east2, row[i + h]), (north2, south[i]), (north2, north[i])];
                let corners = corners.into_iter().fold(0.0, |most, (step2, corner)| far(most, step2 + to(corner)));
                let index = |i: usize| i >> shift;
                let [west, east] = [i - half, i + half];
                let reach = take(corners.sqrt(), step2 + to(south_west[west]), below[index(west)]);
                let reach = take(reach, step2 + to(south_west[east]), below[index(east)]);
                let reach = take(reach, step2 + to(north_west[west]), above[index(west)]);
                take(reach, step2 + to(north_west[east]), above[index(east)])
            }
        };
        DiamondBounds { tight, nested, radius_m: round_up(reach * BALL_MARGIN) }
    }
}
