//! All bounds that cannot be had from a few heights, in lattices of growing step.
//!
//! Lattice k holds the posts whose coordinates are multiples of 2^k and not both of 2^(k+1): the square and tilted
//! diamonds of half-length 2^k. They are made one after the other, finest diamonds first: the tight thickness of each by
//! a search that those of finer ones cut short, the nested one and the ball from its children.
//!
//! A lattice is made some rows at a time, from the south, and each of these goes to a [`BoundsStore`] at once. What is at
//! hand meanwhile are those rows, the rows of the lattice below that their children are in, and the heights of some bands
//! of posts: memory follows from the width of the grid, not from its posts.
//!
//! ```text
//!   tilted diamonds of row b: from the rows 2b - 1 and 2b + 1 of the lattice below
//!   square diamonds of row b (odd): from the tilted ones of rows b - 1, b and b + 1; so one row of tilted ones is made
//!   ahead, and kept for the rows that come next
//! ```

use std::{borrow::Cow, ops::Range};

use rayon::prelude::*;
use sightline_proto::diamond::Post;

use super::{
    BALL_MARGIN, DiamondBounds,
    band::{Band, Heights},
    deviation,
    finest::{distance_m, far},
    finest_rows::FinestRows,
    inner::{Children, InnerRow},
    round_up,
    store::{BoundsStore, Effort, LatticeSize, Rows, TightReader},
};
use crate::terrain::{Grid, HeightField, Posts, ReadError, SceneScale};

/// The bounds of the diamonds of one half-length, 2^k.
#[derive(Clone, PartialEq, Debug)]
pub struct Lattice {
    k: u8,
    columns: u32,
    rows: u32,
    bounds: Vec<DiamondBounds>,
}

impl Lattice {
    /// Columns and rows of lattice `k` over `grid`: those beyond them have bounds of zero.
    ///
    /// The children's children of a square diamond reach ever further out, up to three times its half-length.
    pub fn size(grid: Grid, k: u8) -> (u32, u32) {
        let all = (grid.root().side() >> k) + 1;
        let needed = |posts: u32| (posts - 1).div_ceil(1 << k).saturating_add(3).min(all);
        (needed(grid.nx()), needed(grid.ny()))
    }

    /// Posts from west to east.
    pub fn columns(&self) -> u32 {
        self.columns
    }

    /// Posts from south to north.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    /// Row by row from the south; zero for posts of a coarser lattice.
    pub fn bounds(&self) -> &[DiamondBounds] {
        &self.bounds
    }

    /// The bounds at a post of the lattice; zero beyond it.
    pub fn get(&self, p: Post) -> DiamondBounds {
        let (a, b) = (p.i >> self.k, p.j >> self.k);
        if a >= self.columns || b >= self.rows {
            return DiamondBounds::default();
        }
        self.bounds[b as usize * self.columns as usize + a as usize]
    }
}

/// The bounds of all diamonds but the finest two levels: lattices k = 1 to m - 1. Twelve bytes a stored post, so four
/// bytes a post of the grid.
#[derive(Clone, PartialEq, Debug)]
pub struct BoundsPyramid {
    lattices: Vec<Lattice>,
}

impl BoundsPyramid {
    /// Computes all bounds of a field, on the threads of the current pool. The result does not depend on them.
    pub fn compute<H: HeightField + ?Sized>(field: &H, scale: SceneScale) -> Result<Self, ReadError> {
        let exact = deviation::arithmetic_is_exact(field)?;
        let mut all = Self { lattices: Vec::new() };
        compute_into(field, scale, exact, Effort::FULL, &mut all, &|_| ())?;
        Ok(all)
    }

    /// Lattices k = 1, 2, ... m - 1.
    pub fn lattices(&self) -> &[Lattice] {
        &self.lattices
    }

    /// The bounds of the diamond at `p`, no corner; `None` when `p` has an odd coordinate:
    /// then [`super::finest_bounds`] gives them.
    pub fn get(&self, p: Post) -> Option<DiamondBounds> {
        let k = (p.i | p.j).trailing_zeros() as usize;
        self.lattices.get(k.checked_sub(1)?).map(|lattice| lattice.get(p))
    }
}

impl BoundsStore for BoundsPyramid {
    type Error = ReadError;
    type Reader<'a> = &'a Self;

    fn append(&mut self, size: LatticeSize, rows: &[DiamondBounds]) -> Result<(), ReadError> {
        let LatticeSize { k, columns, rows: all } = size;
        if self.lattices.last().is_none_or(|lattice| lattice.k != k) {
            let bounds = Vec::with_capacity(columns as usize * all as usize);
            self.lattices.push(Lattice { k, columns, rows: all, bounds });
        }
        if let Some(lattice) = self.lattices.last_mut() {
            lattice.bounds.extend_from_slice(rows);
        }
        Ok(())
    }

    fn rows(&self, size: LatticeSize, rows: Range<u32>) -> Result<Cow<'_, [DiamondBounds]>, ReadError> {
        let columns = size.columns as usize;
        Ok(Cow::Borrowed(
            &self.lattices[size.k as usize - 1].bounds[rows.start as usize * columns..rows.end as usize * columns],
        ))
    }

    fn reader(&self) -> &Self {
        self
    }
}

impl TightReader for &BoundsPyramid {
    #[inline]
    fn tight(&mut self, p: Post) -> Result<f32, ReadError> {
        Ok(self.get(p).map_or(0.0, |bounds| bounds.tight))
    }
}

/// Rows of posts that are read together for a band of a lattice.
const BAND_ROWS: u32 = 32;
/// The greatest k of a lattice whose diamonds are scanned: a band of the next one would not fit [`BAND_BYTES`].
const SCAN_K: u8 = 5;
/// Rows of heights that a band holds at most, about, those around it included.
const MOST_BAND_ROWS: usize = 2 * BAND_ROWS as usize;

/// How long the first lattices take beside one another, and each further one, by instructions over rough terrain.
const SHARES: [f64; 6] = [41.0, 16.0, 11.0, 9.0, 9.0, 5.0];
const REST: f64 = 1.0;

/// Bytes that a band takes while it is worked on, about, for each post of a row of the grid: its heights twice (of the
/// finest lattice once more, apart by parity of their columns), and rows of results.
pub const BAND_BYTES: usize = 2 * 8 * MOST_BAND_ROWS;
/// Bytes that a row of [`Effort::rows`] takes for each post of a row of the grid, about: half of the posts are in a row
/// of the finest lattice, and for one of the next two rows of that are at hand; each twice, before they are in order.
pub const ROW_BYTES: usize = 32;

/// Computes all bounds of a field of integers, of 16 bits or, where it is `wide`, of 32, into an empty store, on the
/// threads of the current pool. The result depends neither on them nor on `effort`. `progress` is told how many posts more
/// the work amounts to that is done.
pub fn compute_bounds<H: HeightField + ?Sized, S: BoundsStore>(
    field: &H,
    scale: SceneScale,
    wide: bool,
    effort: Effort,
    store: &mut S,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(), S::Error> {
    let exact = deviation::integers_are_exact(field.grid(), wide);
    compute_into(field, scale, exact, effort, store, progress)
}

fn compute_into<H: HeightField + ?Sized, S: BoundsStore>(
    field: &H,
    scale: SceneScale,
    exact: bool,
    effort: Effort,
    store: &mut S,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(), S::Error> {
    let grid = field.grid();
    let mut told = 0;
    for k in 1..grid.root().exponent() {
        let size = LatticeSize::of(grid, k);
        let [before, whole] = [k - 1, k].map(|k| share_done(k, grid.root().exponent() - 1));
        // The row of tilted diamonds that was made for the square ones south of it.
        let mut ahead: Vec<DiamondBounds> = Vec::new();
        for first in (0..size.rows).step_by(effort.rows as usize) {
            let last = (first + effort.rows).min(size.rows);
            let end = (last + 1).min(size.rows);
            let source = Source { field, scale, exact, bands: effort.bands, store: &*store };
            let mut rows = source.rows(size, first..last, end, &ahead)?;
            let made = (last - first) as usize * size.columns as usize;
            ahead.clear();
            ahead.extend_from_slice(&rows[made..]);
            rows.truncate(made);
            store.append(size, &rows)?;
            let share = before + (whole - before) * f64::from(last) / f64::from(size.rows);
            let done = (grid.posts() as f64 * share) as u64;
            progress(done.saturating_sub(told));
            told = done.max(told);
        }
    }
    Ok(())
}

/// What share of the time for `all` lattices those up to lattice k take.
fn share_done(k: u8, all: u8) -> f64 {
    let first =
        |k: u8| SHARES.iter().take(k.into()).sum::<f64>() + REST * f64::from(k.saturating_sub(SHARES.len() as u8));
    first(k) / first(all)
}

/// What the bounds of a lattice are made from.
struct Source<'a, H: ?Sized, S> {
    field: &'a H,
    scale: SceneScale,
    /// Whether deviations have no rounding errors.
    exact: bool,
    /// Bands that are worked on at the same time.
    bands: usize,
    /// The lattices of smaller steps.
    store: &'a S,
}

/// What the diamonds of one lattice have their children in.
#[derive(Clone, Copy)]
struct Near<'a> {
    /// The lattice itself: the rows being made, with their tilted diamonds when square ones are.
    own: &'a Rows<'a>,
    /// Of the lattice below the rows around these; nothing for the finest.
    below: Option<&'a Rows<'a>>,
}

impl Near<'_> {
    /// The bounds of a diamond of the lattice or of the one below.
    fn get(&self, p: Post) -> DiamondBounds {
        let k = (p.i | p.j).trailing_zeros();
        match self.below {
            Some(below) if k < u32::from(self.own.size.k) => below.get(p),
            _ => self.own.get(p),
        }
    }
}

impl<H: HeightField + ?Sized, S: BoundsStore> Source<'_, H, S> {
    /// The bounds of rows `rows` of a lattice, and of the tilted diamonds of the next one, if `end` is behind it. The tilted
    /// diamonds of the first row are `ahead` when there were rows before.
    fn rows(
        &self,
        size: LatticeSize,
        rows: Range<u32>,
        end: u32,
        ahead: &[DiamondBounds],
    ) -> Result<Vec<DiamondBounds>, ReadError> {
        let mut bounds = vec![DiamondBounds::default(); (end - rows.start) as usize * size.columns as usize];
        bounds[..ahead.len()].copy_from_slice(ahead);
        let mut own = Rows { size, first: rows.start, bounds: Cow::Owned(bounds) };
        let finer = size.k.checked_sub(1).filter(|&k| k > 0).map(|k| LatticeSize::of(self.field.grid(), k));
        let below = match finer {
            None => None,
            Some(size) => {
                let end = (2 * end).min(size.rows);
                let first = (2 * rows.start).saturating_sub(1).min(end);
                let bounds = self.store.rows(size, first..end)?;
                Some(Rows { size, first, bounds })
            }
        };
        // Children of tilted diamonds are square ones of half the length; those of square ones are tilted ones here.
        let first = if ahead.is_empty() { rows.start } else { rows.start + 1 };
        for (parity, rows) in [(Parity::Tilted, first..end), (Parity::Square, rows)] {
            let made = self.bands(Near { own: &own, below: below.as_ref() }, parity, rows.clone())?;
            own.place(parity, rows.start, &made);
        }
        Ok(own.bounds.into_owned())
    }

    /// The bounds of the diamonds of one kind in some rows.
    fn bands(&self, near: Near<'_>, parity: Parity, rows: Range<u32>) -> Result<Vec<Vec<DiamondBounds>>, ReadError> {
        let height = (BAND_ROWS >> near.own.size.k.min(SCAN_K)).max(1);
        let starts: Vec<_> = rows.clone().step_by(height as usize).collect();
        let mut done = Vec::with_capacity(rows.len());
        // No more are under work than there are threads: then none need wait for those before it.
        let at_once = if self.bands < rayon::current_num_threads() { self.bands } else { starts.len() };
        for starts in starts.chunks(at_once.max(1)) {
            let band = |&start: &u32| self.band(near, parity, start..(start + height).min(rows.end));
            let made: Result<Vec<_>, _> = starts.par_iter().map(band).collect();
            done.extend(made?.into_iter().flatten());
        }
        Ok(done)
    }

    fn band(&self, near: Near<'_>, parity: Parity, rows: Range<u32>) -> Result<Vec<Vec<DiamondBounds>>, ReadError> {
        let (size, grid) = (near.own.size, self.field.grid());
        let k = size.k;
        let at = |b| RowAt { near, parity, b };
        let stored = |p| near.get(p);
        let has_some = |&b: &u32| parity.columns(b, size.columns).next().is_some();
        let (Some(first), Some(last)) = (rows.clone().find(has_some), rows.clone().rfind(has_some)) else {
            return Ok(vec![Vec::new(); rows.len()]);
        };
        if k > SCAN_K {
            let mut posts = Posts::new(self.field);
            let mut reader = self.store.reader();
            let mut finer = |p: Post| {
                let is_own = (p.i | p.j).trailing_zeros() == u32::from(k);
                if is_own { Ok(near.own.get(p).tight) } else { reader.tight(p) }
            };
            let mut tight = |posts: &mut Posts<'_, H>, p| deviation::search(grid, posts, &mut finer, self.exact, p);
            return rows.map(|b| self.row(at(b), &mut posts, None, &mut tight, stored)).collect();
        }
        let mut tight = |band: &mut &Band, p| Ok(deviation::scan(band, self.exact, p));
        // A diamond reaches as far as its half-length; balls of the finest level look two posts further.
        let margin = if k == 1 { 3 } else { 1 << k };
        let heights = &Band::load(self.field, (first << k).saturating_sub(margin), (last << k) + margin)?;
        if k > 1 || parity == Parity::Square {
            let row = |b| {
                let inner = self.inner(at(b), heights, None);
                self.row(at(b), &mut &*heights, inner.as_ref(), &mut tight, stored)
            };
            return rows.map(row).collect();
        }
        let count = size.columns.min(grid.root().side() / 2);
        let mut finest = FinestRows::new(heights, self.scale, self.exact, count);
        let mut done = Vec::with_capacity(rows.len());
        for b in rows {
            finest.around(2 * b)?;
            let inner = self.inner(at(b), heights, Some(&finest));
            let child = |child| finest.get(child);
            done.push(self.row(at(b), &mut &*heights, inner.as_ref(), &mut tight, child)?);
        }
        Ok(done)
    }

    /// The bounds of the diamonds of one kind in row `b` of the lattice, from the west.
    fn row<Z: Heights>(
        &self,
        RowAt { near, parity, b }: RowAt<'_>,
        heights: &mut Z,
        inner: Option<&InnerRow<'_>>,
        tight: &mut impl FnMut(&mut Z, Post) -> Result<f32, ReadError>,
        child: impl Fn(Post) -> DiamondBounds,
    ) -> Result<Vec<DiamondBounds>, ReadError> {
        let (LatticeSize { k, columns, .. }, root) = (near.own.size, self.field.grid().root());
        let mut row = Vec::with_capacity(columns as usize / 2 + 1);
        for a in parity.columns(b, columns) {
            let p = Post::new(a << k, b << k);
            row.push(match inner.and_then(|inner| inner.get(p)) {
                Some(bounds) => bounds,
                None if root.is_corner(p) => DiamondBounds::default(),
                None => {
                    let tight = tight(heights, p)?;
                    self.nest(heights, parity, 1 << k, p, tight, &child)?
                }
            });
        }
        Ok(row)
    }

    /// What the inner diamonds of row `b` of the lattice follow from, where a band holds all their heights.
    fn inner<'b>(
        &'b self,
        RowAt { near, parity, b }: RowAt<'b>,
        heights: &'b Band,
        finest: Option<&'b FinestRows>,
    ) -> Option<InnerRow<'b>> {
        let k = near.own.size.k;
        let (h, j) = (1 << k, b << k);
        // Even rows have no square diamonds, and what is around them may not be at hand.
        let is_empty = parity == Parity::Square && b.is_multiple_of(2);
        if is_empty || j < h || j + h >= heights.grid().ny() {
            return None;
        }
        let children = match (parity, finest) {
            (Parity::Square, _) => Children::Straight([b - 1, b, b + 1].map(|b| near.own.row(b))),
            (Parity::Tilted, Some(finest)) => {
                Children::aslant(heights, self.scale, j, 1, [j - 1, j + 1].map(|j| finest.row(j)), 1)
            }
            (Parity::Tilted, None) => {
                let below = near.below?;
                Children::aslant(heights, self.scale, j, h / 2, [2 * b - 1, 2 * b + 1].map(|b| below.row(b)), k - 1)
            }
        };
        Some(InnerRow::new(heights, self.scale, self.exact, parity, k, j, children))
    }

    /// The bounds of the diamond of half-length `h` at `p` from its tight thickness and its children.
    fn nest(
        &self,
        heights: &mut impl Heights,
        parity: Parity,
        h: i64,
        p: Post,
        tight: f32,
        bounds_of: &impl Fn(Post) -> DiamondBounds,
    ) -> Result<DiamondBounds, ReadError> {
        let side = self.field.grid().root().side();
        let straight = |h: i64| [(-h, 0), (h, 0), (0, -h), (0, h)];
        let aslant = |h: i64| [(-h, -h), (h, -h), (-h, h), (h, h)];
        let (corners, children) = match parity {
            Parity::Tilted => (straight(h), aslant(h / 2)),
            Parity::Square => (aslant(h), straight(h)),
        };
        let z = heights.z(p)?;
        let (mut nested, mut reach) = (tight, 0.0);
        for corner in corners.into_iter().filter_map(|(di, dj)| p.offset(di, dj, side)) {
            reach = far(reach, distance_m(self.scale, p, z, corner, heights.z(corner)?));
        }
        for child in children.into_iter().filter_map(|(di, dj)| p.offset(di, dj, side)) {
            let inner = bounds_of(child);
            let distance = distance_m(self.scale, p, z, child, heights.z(child)?);
            nested = nested.max(inner.nested);
            reach = far(reach, distance + f64::from(inner.radius_m));
        }
        Ok(DiamondBounds { tight, nested, radius_m: round_up(reach * BALL_MARGIN) })
    }
}

/// The diamonds of one kind in one row of a lattice.
#[derive(Clone, Copy)]
struct RowAt<'a> {
    near: Near<'a>,
    parity: Parity,
    b: u32,
}

/// The two kinds of diamonds of a lattice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Parity {
    /// a + b is odd.
    Tilted,
    /// a and b are odd.
    Square,
}

impl Parity {
    /// The columns below `columns` of the kind's diamonds in row `b`.
    fn columns(self, b: u32, columns: u32) -> impl Iterator<Item = u32> {
        let first = match (self, b % 2) {
            (Self::Tilted, odd) => 1 - odd,
            (Self::Square, 1) => 1,
            (Self::Square, _) => columns,
        };
        (first..columns).step_by(2)
    }
}

impl Rows<'_> {
    /// Puts diamonds of one kind in their places, row by row from row `first` on.
    fn place(&mut self, parity: Parity, first: u32, rows: &[Vec<DiamondBounds>]) {
        let columns = self.size.columns;
        let from = (first - self.first) as usize * columns as usize;
        let slots = self.bounds.to_mut()[from..].par_chunks_mut(columns as usize);
        slots.zip(rows).zip(first..first + rows.len() as u32).for_each(|((slots, row), b)| {
            for (a, bounds) in parity.columns(b, columns).zip(row) {
                slots[a as usize] = *bounds;
            }
        });
    }
}
