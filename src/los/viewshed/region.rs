//! Which posts a region has, along rows and along columns.
//!
//! Whether a post is within a radius is one rounded comparison, the same whichever way it is asked; the squares that it
//! adds grow with the distance along either axis, rounded too, so the posts of a row or a column are an interval.

use std::ops::RangeInclusive;

use super::{Region, ViewshedError};
use crate::terrain::{Grid, PAGE_SIDE, PageId};

/// From here on, in posts, bounds are not used: sectors would be thinner than their errors.
pub(super) const REACH_LIMIT: f64 = 100_000.0;
/// Beyond this, in posts, a radius is refused: distances to neighbouring posts would not differ.
const FAR: f64 = (1_u64 << 40) as f64;

/// A region on a grid, seen from an observer.
#[derive(Clone, Debug)]
pub(super) struct Cells {
    region: Region,
    plan: [f64; 2],
    /// Least and greatest column and row that can hold a cell.
    low: [i64; 2],
    high: [i64; 2],
    total: u64,
}

impl Cells {
    pub(super) fn new(grid: Grid, plan: [f64; 2], region: Region) -> Result<Self, ViewshedError> {
        let last = [i64::from(grid.nx()) - 1, i64::from(grid.ny()) - 1];
        let (mut low, mut high) = ([0; 2], last);
        match region {
            Region::Radius { metres, scale } => {
                if !(metres > 0.0 && metres.is_finite()) {
                    return Err(ViewshedError::BadRadius(metres));
                }
                if plan.iter().any(|v| v.abs() > FAR) {
                    return Err(ViewshedError::FarObserver(plan[0], plan[1]));
                }
                for (axis, step) in [(0, scale.east_m), (1, scale.north_m)] {
                    let reach = metres / step;
                    low[axis] = ((plan[axis] - reach) as i64 - 2).max(0);
                    high[axis] = ((plan[axis] + reach) as i64 + 2).min(last[axis]);
                }
            }
            Region::Rectangle { i, j } => {
                for (axis, ends) in [(0, i), (1, j)] {
                    low[axis] = i64::from(ends[0].min(ends[1]));
                    high[axis] = i64::from(ends[0].max(ends[1])).min(last[axis]);
                }
            }
        }
        let mut cells = Self { region, plan, low, high, total: 0 };
        let rows = || low[1]..=high[1];
        cells.total = rows().filter_map(|j| cells.along(1, j)).map(|r| (r.end() - r.start() + 1) as u64).sum();
        if cells.total == 0 {
            return Err(ViewshedError::EmptyRegion);
        }
        Ok(cells)
    }

    pub(super) fn total(&self) -> u64 {
        self.total
    }

    /// Least and greatest index along an axis.
    pub(super) fn extent(&self, axis: usize) -> [i64; 2] {
        [self.low[axis], self.high[axis]]
    }

    /// The farthest that a cell is from the observer along an axis, in posts.
    pub(super) fn reach(&self) -> f64 {
        let along = |axis: usize| {
            let [low, high] = self.extent(axis).map(|v| (v as f64 - self.plan[axis]).abs());
            low.max(high)
        };
        along(0).max(along(1))
    }

    fn contains(&self, i: i64, j: i64) -> bool {
        match self.region {
            Region::Radius { metres, scale } => {
                let east = (i as f64 - self.plan[0]) * scale.east_m;
                let north = (j as f64 - self.plan[1]) * scale.north_m;
                east * east + north * north <= metres * metres
            }
            Region::Rectangle { .. } => true,
        }
    }

    /// The cells of column `at` (axis 0) or row `at` (axis 1), as indices along the other axis.
    pub(super) fn along(&self, axis: usize, at: i64) -> Option<RangeInclusive<i64>> {
        let other = 1 - axis;
        if at < self.low[axis] || at > self.high[axis] {
            return None;
        }
        let (mut first, mut last) = (self.low[other], self.high[other]);
        if let Region::Radius { .. } = self.region {
            let inside = |v: i64| if axis == 0 { self.contains(at, v) } else { self.contains(v, at) };
            let half = self.half_chord(axis, at as f64 - self.plan[axis]);
            // Off by a rounding: looked at from two posts further out.
            first = first.max((self.plan[other] - half) as i64 - 2);
            last = last.min((self.plan[other] + half) as i64 + 2);
            while first <= last && !inside(first) {
                first += 1;
            }
            while first <= last && !inside(last) {
                last -= 1;
            }
        }
        (first <= last).then_some(first..=last)
    }

    /// Posts beside the plane point of A along the other axis that a line to a cell can be near, when it is `distance`
    /// posts away from A along `axis`: a little too wide.
    pub(super) fn corridor(&self, axis: usize, distance: f64) -> [f64; 2] {
        let other = 1 - axis;
        let at = self.plan[other];
        match self.region {
            Region::Radius { .. } => {
                let half = self.half_chord(axis, distance);
                [at - half, at + half]
            }
            Region::Rectangle { .. } => [at.min(self.low[other] as f64), at.max(self.high[other] as f64)],
        }
    }

    /// Half the chord of the circle across an axis, in posts.
    fn half_chord(&self, axis: usize, distance: f64) -> f64 {
        let Region::Radius { metres, scale } = self.region else { return f64::INFINITY };
        let steps = [scale.east_m, scale.north_m];
        let away = distance * steps[axis];
        (metres * metres - away * away).max(0.0).sqrt() / steps[1 - axis]
    }

    /// Rows of cells that are less than a post away from A in both directions.
    pub(super) fn nearest(&self) -> Vec<(u32, RangeInclusive<u32>)> {
        let near = |axis: usize, v: i64| (v as f64 - self.plan[axis]).abs() < 1.0;
        let around = |axis: usize| {
            let at = self.plan[axis].floor() as i64;
            (at.saturating_sub(1)..=at.saturating_add(2)).filter(move |&v| near(axis, v))
        };
        let mut rows = Vec::new();
        for j in around(1) {
            let Some(cells) = self.along(1, j) else { continue };
            for i in around(0).filter(|i| cells.contains(i)) {
                rows.push((j as u32, i as u32..=i as u32));
            }
        }
        rows
    }

    /// The pages that may hold cells, in order.
    pub(super) fn pages(&self) -> impl Iterator<Item = PageId> {
        let side = i64::from(PAGE_SIDE);
        let along = |axis: usize| (self.low[axis] / side) as u32..=(self.high[axis] / side) as u32;
        let columns = along(0);
        along(1).flat_map(move |pj| columns.clone().map(move |pi| PageId { pi, pj })).filter(|&p| self.count_in(p) > 0)
    }

    /// The cells of a page by row.
    pub(super) fn rows_of(&self, page: PageId) -> Vec<(u32, RangeInclusive<u32>)> {
        let (west, south) = (page.pi * PAGE_SIDE, page.pj * PAGE_SIDE);
        let row = |j: u32| {
            let cells = self.along(1, i64::from(j))?;
            let first = (*cells.start()).max(i64::from(west));
            let last = (*cells.end()).min(i64::from(west + PAGE_SIDE - 1));
            (first <= last).then_some((j, first as u32..=last as u32))
        };
        (south..south + PAGE_SIDE).filter_map(row).collect()
    }

    /// How many cells a page has.
    pub(super) fn count_in(&self, page: PageId) -> usize {
        self.rows_of(page).into_iter().map(|(_, i)| i.count()).sum()
    }
}
