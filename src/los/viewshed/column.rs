//! A quadrant's frame, and the posts of one of its columns as seen from A.
//!
//! A quadrant looks along an axis: x is the distance from A along it, in posts, y the distance across. East and west
//! have the columns of the grid as their columns, north and south its rows; the diagonals of cells join posts of even
//! sum whichever way one looks. A post at (x, y, z) relative to A is projected on the plane x = 1: there it stands at
//! the slope m = y / x and the height s = z / x, and a straight edge stays straight.

use std::{collections::BTreeMap, sync::Arc};

use super::push::{Sectors, greater};
use crate::terrain::{HeightField, HeightPage, PAGE_SIDE, PageId, ReadError, Samples};

/// Heights beyond this are left to exact queries.
pub(super) const TAME: f64 = 1e100;

/// Which way a quadrant looks, and from where.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    /// 0 for east and west, 1 for north and south.
    pub(super) axis: usize,
    /// Whether x grows with the index.
    pub(super) forward: bool,
    /// A along the axis, across it, and its height.
    pub(super) along: f64,
    pub(super) across: f64,
    pub(super) z: f64,
    /// The curvature of the Earth along and across, in height units per post squared.
    pub(super) bend: [f64; 2],
}

impl Frame {
    /// Four times as much as a lowered edge can rise above its chord, in height units.
    pub(super) fn bulge(&self) -> f64 {
        self.bend[0] + self.bend[1]
    }

    /// By how much a post is lowered.
    pub(super) fn drop(&self, x: f64, y: f64) -> f64 {
        self.bend[0] * (x * x) + self.bend[1] * (y * y)
    }

    /// The distance of a column from A: one rounding.
    pub(super) fn x(&self, index: i64) -> f64 {
        let ahead = index as f64 - self.along;
        if self.forward { ahead } else { -ahead }
    }

    /// The distance of a post across the axis: one rounding.
    #[inline]
    pub(super) fn y(&self, b: i64) -> f64 {
        b as f64 - self.across
    }

    /// The index of the next column away from A.
    pub(super) fn next(&self, index: i64) -> i64 {
        if self.forward { index + 1 } else { index - 1 }
    }

    pub(super) fn before(&self, index: i64) -> i64 {
        if self.forward { index - 1 } else { index + 1 }
    }

    /// The post at an index along the axis and one across.
    pub(super) fn post(&self, a: i64, b: i64) -> [u32; 2] {
        if self.axis == 0 { [a as u32, b as u32] } else { [b as u32, a as u32] }
    }
}

/// A projected post.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shot {
    /// Height above A, lowered where the Earth is curved, by distance; NaN for a void post.
    pub(super) s: f64,
    /// The slope, counted in sectors.
    pub(super) q: f64,
    /// The sector held that q is in, numbered from the base; -1 before the first, their number after the last.
    pub(super) k: i32,
    /// Whether q is so near to a ray that the post counts on both sides of it.
    pub(super) is_near_ray: bool,
}

/// The posts of a column, projected.
#[derive(Clone, Default, Debug)]
pub(super) struct Column {
    /// Its index along the axis.
    pub(super) a: i64,
    /// The first post across.
    pub(super) b: i64,
    pub(super) x: f64,
    /// 1 / x.
    pub(super) per_x: f64,
    pub(super) posts: Vec<Shot>,
    /// The greatest |s|, and more where terms of it were greater.
    pub(super) most: f64,
    /// Whether some post is void.
    pub(super) voids: bool,
}

impl Column {
    /// The index after the last post across.
    pub(super) fn end(&self) -> i64 {
        self.b + self.posts.len() as i64
    }

    /// Post `b`, if it is in the column.
    #[inline]
    pub(super) fn post(&self, b: i64) -> Option<Shot> {
        usize::try_from(b - self.b).ok().and_then(|n| self.posts.get(n)).copied()
    }

    /// The projected height of post `b`; NaN where void or not in the column.
    #[inline]
    pub(super) fn at(&self, b: i64) -> f64 {
        self.post(b).map_or(f64::NAN, |post| post.s)
    }
}

/// Reads columns, holding the pages of the last.
pub(super) struct Reader<'a, H: HeightField + ?Sized> {
    field: &'a H,
    frame: Frame,
    /// Index of the pages held, along the axis; the pages across.
    line: i64,
    pages: BTreeMap<u32, Arc<HeightPage>>,
    heights: Vec<f64>,
    /// Whether a height was beyond what bounds are for.
    pub(super) wild: bool,
}

impl<'a, H: HeightField + ?Sized> Reader<'a, H> {
    pub(super) fn new(field: &'a H, frame: Frame) -> Self {
        Self { field, frame, line: -1, pages: BTreeMap::new(), heights: Vec::new(), wild: false }
    }

    /// Fills `column` with posts `first..=last` across of column `a`, all in the grid; none when last is before first.
    pub(super) fn read(
        &mut self,
        sectors: &Sectors,
        a: i64,
        first: i64,
        last: i64,
        column: &mut Column,
    ) -> Result<(), ReadError> {
        let x = self.frame.x(a);
        (column.a, column.b, column.x, column.per_x) = (a, first, x, 1.0 / x);
        let mut heights = std::mem::take(&mut self.heights);
        heights.clear();
        self.heights(a, first, last, &mut heights)?;
        let (z, per_x) = (self.frame.z, column.per_x);
        let per_y = per_x * sectors.scale;
        let (curved, mut most, mut voids) = (self.frame.bulge() > 0.0, 0.0_f64, false);
        column.posts.clear();
        column.posts.extend((first..).zip(&heights).map(|(b, &height)| {
            let y = self.frame.y(b);
            let mut s = (height - z) * per_x;
            most = greater(s.abs(), most);
            voids |= s.is_nan();
            if curved {
                let drop = self.frame.drop(x, y) * per_x;
                s -= drop;
                most = greater(s.abs() + 2.0 * drop, most);
            }
            let q = y * per_y + sectors.offset;
            sectors.shot(s, q)
        }));
        self.heights = heights;
        self.wild |= most * x > TAME;
        (column.most, column.voids) = (most, voids);
        Ok(())
    }

    /// The height of one post; NaN where void, `None` outside the grid.
    pub(super) fn height(&mut self, a: i64, b: i64) -> Result<Option<f64>, ReadError> {
        let grid = self.field.grid();
        let [along, across] =
            if self.frame.axis == 0 { [grid.nx(), grid.ny()] } else { [grid.ny(), grid.nx()] }.map(i64::from);
        if a < 0 || a >= along || b < 0 || b >= across {
            return Ok(None);
        }
        let mut height = Vec::with_capacity(1);
        self.heights(a, b, b, &mut height)?;
        self.wild |= height.iter().any(|z| z.abs() > TAME);
        Ok(height.pop())
    }

    /// Appends the heights of posts `first..=last` of column `a`, NaN for void ones.
    fn heights(&mut self, a: i64, first: i64, last: i64, out: &mut Vec<f64>) -> Result<(), ReadError> {
        let side = i64::from(PAGE_SIDE);
        if a / side != self.line {
            self.pages.clear();
            self.line = a / side;
        }
        let mut b = first;
        while b <= last {
            let until = (b / side * side + side - 1).min(last);
            let (along, across) = ((a / side) as u32, (b / side) as u32);
            let id =
                if self.frame.axis == 0 { PageId { pi: along, pj: across } } else { PageId { pi: across, pj: along } };
            let page = match self.pages.entry(across) {
                std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
                std::collections::btree_map::Entry::Vacant(entry) => entry.insert(self.field.page(id)?),
            };
            copy(page, self.frame.axis, (a % side) as usize, (b % side) as usize, (until % side) as usize, out);
            b = until + 1;
        }
        Ok(())
    }
}

/// Appends posts `first..=last` of column (axis 0) or row (axis 1) `at` of a page.
fn copy(page: &HeightPage, axis: usize, at: usize, first: usize, last: usize, out: &mut Vec<f64>) {
    let side = PAGE_SIDE as usize;
    let (start, step) = if axis == 0 { (first * side + at, side) } else { (at * side + first, 1) };
    let count = last - first + 1;
    if page.has_voids() {
        out.extend((first..=last).map(|b| {
            let (i, j) = if axis == 0 { (at, b) } else { (b, at) };
            let post = page.at(i as u32, j as u32);
            if post.void { f64::NAN } else { post.z }
        }));
        return;
    }
    match page.samples() {
        Samples::I16(s) => out.extend(s[start..].iter().step_by(step).take(count).map(|&z| f64::from(z))),
        Samples::I32(s) => out.extend(s[start..].iter().step_by(step).take(count).map(|&z| f64::from(z))),
        Samples::F64(s) => out.extend(s[start..].iter().step_by(step).take(count)),
    }
}
