//! All bounds that cannot be had from a few heights, in lattices of growing step.
//!
//! Lattice k holds the posts whose coordinates are multiples of 2^k and not both of 2^(k+1): the square and tilted
//! diamonds of half-length 2^k. After the tight thicknesses are measured, the nested ones and the balls follow from
//! the children, finest diamonds first.

use rayon::prelude::*;
use sightline_proto::diamond::Post;

use super::{
    BALL_MARGIN, DiamondBounds,
    deviation::{self, Maxima},
    finest::{distance_m, far, finest_bounds, reach_of_corners},
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

/// What the computation of bounds is doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum BoundsPhase {
    /// Measuring deviations.
    Measuring,
    /// Deriving nested thicknesses and balls.
    Nesting,
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
        Self::compute_with(field, scale, &|_, _| ())
    }

    /// [`BoundsPyramid::compute`] that tells `progress`, from any thread, how many posts more are through a phase.
    pub fn compute_with<H: HeightField + ?Sized>(
        field: &H,
        scale: SceneScale,
        progress: &(dyn Fn(BoundsPhase, u64) + Sync),
    ) -> Result<Self, ReadError> {
        let grid = field.grid();
        let sizes: Vec<_> = (1..grid.root().exponent()).map(|k| Lattice::size(grid, k)).collect();
        let tight: Vec<_> = sizes.iter().map(|&(columns, rows)| Maxima::new(columns, rows)).collect();
        deviation::measure(field, &tight, &|more| progress(BoundsPhase::Measuring, more))?;
        let nested = |more| progress(BoundsPhase::Nesting, more);
        let mut lattices: Vec<Lattice> = Vec::with_capacity(sizes.len());
        for (k, maxima) in (1_u8..).zip(tight) {
            let (columns, rows) = Lattice::size(grid, k);
            let bounds = vec![DiamondBounds::default(); columns as usize * rows as usize];
            let mut lattice = Lattice { k, columns, rows, bounds };
            let below = Below { field, scale, lattice: lattices.last(), progress: &nested };
            lattice.fill_tilted(&below, &maxima)?;
            lattice.fill_square(&below, &maxima)?;
            lattices.push(lattice);
        }
        Ok(Self { lattices })
    }

    /// Lattices k = 1, 2, ... m - 1.
    pub fn lattices(&self) -> &[Lattice] {
        &self.lattices
    }

    /// The bounds of the diamond at `p`, no corner; `None` when `p` has an odd coordinate:
    /// then [`finest_bounds`] gives them.
    pub fn get(&self, p: Post) -> Option<DiamondBounds> {
        let k = (p.i | p.j).trailing_zeros() as usize;
        self.lattices.get(k.checked_sub(1)?).map(|lattice| lattice.get(p))
    }
}

/// What the bounds of a lattice are made from.
struct Below<'a, H: ?Sized> {
    field: &'a H,
    scale: SceneScale,
    /// The next finer lattice; `None` for the finest two levels, which come from heights.
    lattice: Option<&'a Lattice>,
    /// Is told how many posts of the grid more are nested.
    progress: &'a (dyn Fn(u64) + Sync),
}

impl Lattice {
    /// Tilted diamonds of half-length 2^k: their children are square ones of half that.
    fn fill_tilted<H: HeightField + ?Sized>(&mut self, below: &Below<'_, H>, tight: &Maxima) -> Result<(), ReadError> {
        self.fill(below, tight, 1, |posts, child| match below.lattice {
            Some(lattice) => Ok(lattice.get(child)),
            None => finest_bounds(posts, below.scale, child),
        })
    }

    /// Square diamonds of half-length 2^k: their children are tilted ones on the same lattice.
    fn fill_square<H: HeightField + ?Sized>(&mut self, below: &Below<'_, H>, tight: &Maxima) -> Result<(), ReadError> {
        let tilted = Self { bounds: std::mem::take(&mut self.bounds), ..*self };
        self.bounds = tilted.bounds.clone();
        self.fill(below, tight, 0, |_, child| Ok(tilted.get(child)))
    }

    /// Fills the posts (a, b) of the lattice for which a + b is `parity` and not both are even.
    fn fill<H: HeightField + ?Sized>(
        &mut self,
        below: &Below<'_, H>,
        tight: &Maxima,
        parity: u32,
        bounds_of: impl Fn(&mut Posts<'_, H>, Post) -> Result<DiamondBounds, ReadError> + Sync,
    ) -> Result<(), ReadError> {
        let (k, root) = (self.k, below.field.grid().root());
        let rows = self.bounds.par_chunks_mut(self.columns as usize).enumerate();
        rows.try_for_each_init(
            || Posts::new(below.field),
            |posts, (b, row)| {
                for (a, slot) in row.iter_mut().enumerate() {
                    let (a, b) = (a as u32, b as u32);
                    let p = Post::new(a << k, b << k);
                    if (a + b) % 2 != parity || (a % 2 == 0 && b % 2 == 0) || root.is_corner(p) {
                        continue;
                    }
                    let z = posts.at(p)?.z;
                    let mut reach = reach_of_corners(root, below.scale, p, z, &mut |q| Ok(posts.at(q)?.z))?;
                    let mut nested = tight.get(a, b);
                    for child in root.children(p) {
                        let inner = bounds_of(posts, child)?;
                        let distance = distance_m(below.scale, p, z, child, posts.at(child)?.z);
                        nested = nested.max(inner.nested);
                        reach = far(reach, distance + f64::from(inner.radius_m));
                    }
                    let radius_m = round_up(reach * BALL_MARGIN);
                    *slot = DiamondBounds { tight: tight.get(a, b), nested, radius_m };
                }
                // The finest lattice is nearly all of the work: its rows, passed over twice, stand for those of posts.
                if k == 1 && b < below.field.grid().ny().div_ceil(2) as usize {
                    (below.progress)(u64::from(below.field.grid().nx()));
                }
                Ok(())
            },
        )
    }
}
