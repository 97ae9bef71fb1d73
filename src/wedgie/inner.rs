//! The nested thickness and the ball of diamonds that lie in the grid with all their corners: nearly all. What the
//! general way looks up and checks post by post is at hand row by row here, and the numbers are the same.

use sightline_proto::diamond::Post;

use super::{
    BALL_MARGIN, DiamondBounds,
    band::Band,
    finest::{Steps, far},
    round_up,
};
use crate::terrain::SceneScale;

/// What the inner diamonds of one kind, in one row of a lattice, follow from.
pub(super) struct InnerRow<'a> {
    k: u8,
    /// Columns of the grid whose diamonds have all corners in it.
    columns: std::ops::Range<u32>,
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
    /// Row `j` of the grid, which is a half-length 2^k or more away from its first and its last.
    pub(super) fn new(band: &'a Band, scale: SceneScale, k: u8, j: u32, children: Children<'a>) -> Self {
        let h = 1 << k;
        let heights = [band.row(j - h), band.row(j), band.row(j + h)];
        Self { k, columns: h..band.grid().nx().saturating_sub(h), heights, steps: Steps::new(scale, h), children }
    }

    #[inline]
    pub(super) fn has(&self, p: Post) -> bool {
        self.columns.contains(&p.i)
    }

    /// The bounds of an inner diamond of the row from its tight thickness.
    #[inline]
    pub(super) fn nest(&self, p: Post, tight: f32) -> DiamondBounds {
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
