//! All bounds that cannot be had from a few heights, in lattices of growing step.
//!
//! Lattice k holds the posts whose coordinates are multiples of 2^k and not both of 2^(k+1): the square and tilted
//! diamonds of half-length 2^k. They are made one after the other, finest diamonds first: the tight thickness of each by
//! a search that those of finer ones cut short, the nested one and the ball from its children.

use std::ops::Range;

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

    /// Lattice `k` over `grid` from its bounds, row by row from the south; `None` when their number is not that of
    /// [`Lattice::size`].
    pub fn new(grid: Grid, k: u8, bounds: Vec<DiamondBounds>) -> Option<Self> {
        let (columns, rows) = Self::size(grid, k);
        (bounds.len() as u64 == u64::from(columns) * u64::from(rows)).then_some(Self { k, columns, rows, bounds })
    }

    /// The exponent of the step between posts.
    pub fn k(&self) -> u8 {
        self.k
    }

    /// Posts from west to east.
    pub fn columns(&self) -> u32 {
        self.columns
    }

    /// Posts from south to north.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    /// The bounds of row `b`, one of its rows.
    pub(super) fn row(&self, b: u32) -> &[DiamondBounds] {
        let columns = self.columns as usize;
        &self.bounds[b as usize * columns..][..columns]
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
        Self::compute_with(field, scale, &|_| ())
    }

    /// [`BoundsPyramid::compute`] that tells `progress`, from any thread, how many posts more are done.
    pub fn compute_with<H: HeightField + ?Sized>(
        field: &H,
        scale: SceneScale,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Self, ReadError> {
        let exact = deviation::arithmetic_is_exact(field)?;
        let mut lattices: Vec<Lattice> = Vec::new();
        for k in 1..field.grid().root().exponent() {
            let source = Source { field, scale, exact, finer: &lattices, progress };
            let lattice = source.lattice(k)?;
            lattices.push(lattice);
        }
        Ok(Self { lattices })
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

/// Rows of posts that are read together for a band of a lattice.
const BAND_ROWS: u32 = 32;
/// The greatest k of a lattice whose diamonds are scanned; on rough terrain, that of 32 posts costs as much either way.
const SCAN_K: u8 = 3;

/// What the bounds of a lattice are made from.
struct Source<'a, H: ?Sized> {
    field: &'a H,
    scale: SceneScale,
    /// Whether deviations have no rounding errors.
    exact: bool,
    /// The lattices of smaller steps.
    finer: &'a [Lattice],
    /// Is told how many posts of the grid more are done.
    progress: &'a (dyn Fn(u64) + Sync),
}

impl<H: HeightField + ?Sized> Source<'_, H> {
    fn lattice(&self, k: u8) -> Result<Lattice, ReadError> {
        let (columns, rows) = Lattice::size(self.field.grid(), k);
        let bounds = vec![DiamondBounds::default(); columns as usize * rows as usize];
        let mut lattice = Lattice { k, columns, rows, bounds };
        // Children of tilted diamonds are square ones of half the length; those of square ones are tilted ones here.
        let tilted = self.rows(&lattice, Parity::Tilted)?;
        lattice.place(Parity::Tilted, &tilted);
        let square = self.rows(&lattice, Parity::Square)?;
        lattice.place(Parity::Square, &square);
        Ok(lattice)
    }

    /// The bounds of all diamonds of one kind, row by row.
    fn rows(&self, lattice: &Lattice, parity: Parity) -> Result<Vec<Vec<DiamondBounds>>, ReadError> {
        let band = (BAND_ROWS >> lattice.k.min(SCAN_K)).max(1);
        let bands: Result<Vec<_>, _> = (0..lattice.rows.div_ceil(band))
            .into_par_iter()
            .map(|n| self.band(lattice, parity, n * band..((n + 1) * band).min(lattice.rows)))
            .collect();
        Ok(bands?.concat())
    }

    fn band(&self, lattice: &Lattice, parity: Parity, rows: Range<u32>) -> Result<Vec<Vec<DiamondBounds>>, ReadError> {
        let (k, grid) = (lattice.k, self.field.grid());
        let at = |b| RowAt { lattice, parity, b };
        let stored = |p| self.get(lattice, p);
        let mut posts = Posts::new(self.field);
        if k > SCAN_K {
            let finer = |p| self.get(lattice, p).tight;
            let tight = |posts: &mut Posts<'_, H>, p| deviation::search(grid, posts, &finer, self.exact, p);
            return rows.map(|b| self.row(at(b), &mut posts, None, tight, stored)).collect();
        }
        let tight = |band: &mut &Band, p| Ok(deviation::scan(band, self.exact, p));
        // A diamond reaches as far as its half-length; balls of the finest level look two posts further.
        let margin = (1 << k) + 3;
        let heights = &Band::load(&mut posts, (rows.start << k).saturating_sub(margin), (rows.end << k) + margin)?;
        if k > 1 || parity == Parity::Square {
            let row = |b| {
                let inner = self.inner(at(b), heights, None);
                self.row(at(b), &mut &*heights, inner.as_ref(), tight, stored)
            };
            return rows.map(row).collect();
        }
        let count = lattice.columns.min(grid.root().side() / 2);
        let mut finest = FinestRows::new(heights, self.scale, self.exact, count);
        let mut done = Vec::with_capacity(rows.len());
        for b in rows {
            finest.around(2 * b)?;
            let inner = self.inner(at(b), heights, Some(&finest));
            let child = |child| finest.get(child);
            done.push(self.row(at(b), &mut &*heights, inner.as_ref(), tight, child)?);
            (self.progress)(u64::from(grid.nx()) * u64::from(grid.ny().saturating_sub(2 * b).min(2)));
        }
        Ok(done)
    }

    /// The bounds of a diamond of a finer lattice or of `lattice`.
    fn get(&self, lattice: &Lattice, p: Post) -> DiamondBounds {
        let k = (p.i | p.j).trailing_zeros() as usize;
        self.finer.get(k - 1).unwrap_or(lattice).get(p)
    }

    /// The bounds of the diamonds of one kind in row `b` of the lattice, from the west.
    fn row<Z: Heights>(
        &self,
        RowAt { lattice, parity, b }: RowAt<'_>,
        heights: &mut Z,
        inner: Option<&InnerRow<'_>>,
        tight: impl Fn(&mut Z, Post) -> Result<f32, ReadError>,
        child: impl Fn(Post) -> DiamondBounds,
    ) -> Result<Vec<DiamondBounds>, ReadError> {
        let (k, root) = (lattice.k, self.field.grid().root());
        let mut row = Vec::with_capacity(lattice.columns as usize / 2 + 1);
        for a in parity.columns(b, lattice.columns) {
            let p = Post::new(a << k, b << k);
            row.push(match inner {
                Some(inner) if inner.has(p) => inner.nest(p, tight(heights, p)?),
                _ if root.is_corner(p) => DiamondBounds::default(),
                _ => {
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
        RowAt { lattice, parity, b }: RowAt<'b>,
        heights: &'b Band,
        finest: Option<&'b FinestRows>,
    ) -> Option<InnerRow<'b>> {
        let (k, h, j) = (lattice.k, 1 << lattice.k, b << lattice.k);
        if j < h || j + h >= heights.grid().ny() {
            return None;
        }
        let children = match (parity, finest) {
            (Parity::Square, _) => Children::Straight([b - 1, b, b + 1].map(|b| lattice.row(b))),
            (Parity::Tilted, Some(finest)) => {
                Children::aslant(heights, self.scale, j, 1, [j - 1, j + 1].map(|j| finest.row(j)), 1)
            }
            (Parity::Tilted, None) => {
                let finer = self.finer.get(usize::from(k).checked_sub(2)?)?;
                Children::aslant(heights, self.scale, j, h / 2, [2 * b - 1, 2 * b + 1].map(|b| finer.row(b)), k - 1)
            }
        };
        Some(InnerRow::new(heights, self.scale, k, j, children))
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
    lattice: &'a Lattice,
    parity: Parity,
    b: u32,
}

/// The two kinds of diamonds of a lattice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Parity {
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

impl Lattice {
    fn place(&mut self, parity: Parity, rows: &[Vec<DiamondBounds>]) {
        for (b, (row, slots)) in (0..).zip(rows.iter().zip(self.bounds.chunks_mut(self.columns as usize))) {
            for (a, bounds) in parity.columns(b, self.columns).zip(row) {
                slots[a as usize] = *bounds;
            }
        }
    }
}
