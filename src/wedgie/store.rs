//! Where lattices of bounds are kept while coarser ones are made from them: in memory, or in pages on a disk.

use std::{borrow::Cow, ops::Range};

use sightline_proto::diamond::Post;

use super::{DiamondBounds, pyramid::Lattice};
use crate::terrain::{Grid, ReadError};

/// The extent of lattice `k` over a grid.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LatticeSize {
    /// The exponent of the step between posts.
    pub k: u8,
    /// Posts from west to east.
    pub columns: u32,
    /// Posts from south to north.
    pub rows: u32,
}

impl LatticeSize {
    /// That of lattice `k` over `grid`: bounds beyond it are zero.
    pub fn of(grid: Grid, k: u8) -> Self {
        let (columns, rows) = Lattice::size(grid, k);
        Self { k, columns, rows }
    }
}

/// Keeps lattices of bounds, finest first.
pub trait BoundsStore: Send + Sync {
    /// Why bounds could not be kept or read.
    type Error: From<ReadError> + Send;
    /// Reads single bounds.
    type Reader<'a>: TightReader
    where
        Self: 'a;

    /// Keeps the next rows of a lattice, from the south: as many posts as `size` has columns in each. Lattices come one
    /// after the other, k = 1 first; of each as many rows at once as [`Effort`] says, but for the last ones.
    fn append(&mut self, size: LatticeSize, rows: &[DiamondBounds]) -> Result<(), Self::Error>;

    /// Rows of a lattice that is complete, from the south; zero for posts of a coarser lattice.
    fn rows(&self, size: LatticeSize, rows: Range<u32>) -> Result<Cow<'_, [DiamondBounds]>, ReadError>;

    /// A reader of the lattices that are complete.
    fn reader(&self) -> Self::Reader<'_>;
}

/// Reads tight thicknesses here and there.
pub trait TightReader {
    /// That of the diamond at `p`, of a complete lattice; 0 beyond it.
    fn tight(&mut self, p: Post) -> Result<f32, ReadError>;
}

/// How much of a lattice is made at once. The bounds do not depend on it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Effort {
    /// Rows of a lattice between two calls of [`BoundsStore::append`]: a multiple of [`Effort::ROWS_STEP`].
    pub rows: u32,
    /// Bands of rows that are worked on at the same time, each with its heights.
    pub bands: usize,
}

impl Effort {
    /// Rows come in multiples of this: as many as lie in a page of a database.
    pub const ROWS_STEP: u32 = 32;
    /// Without a thought for memory.
    pub const FULL: Self = Self { rows: 16 * Self::ROWS_STEP, bands: usize::MAX };
}

/// Some rows of a lattice at hand.
pub(super) struct Rows<'a> {
    pub(super) size: LatticeSize,
    /// The first row at hand.
    pub(super) first: u32,
    pub(super) bounds: Cow<'a, [DiamondBounds]>,
}

impl Rows<'_> {
    /// The bounds of row `b`, one of those at hand.
    pub(super) fn row(&self, b: u32) -> &[DiamondBounds] {
        let columns = self.size.columns as usize;
        &self.bounds[(b - self.first) as usize * columns..][..columns]
    }

    /// The bounds at a post of a row at hand; zero beyond the lattice.
    pub(super) fn get(&self, p: Post) -> DiamondBounds {
        let (a, b) = (p.i >> self.size.k, p.j >> self.size.k);
        if a >= self.size.columns || b >= self.size.rows { DiamondBounds::default() } else { self.row(b)[a as usize] }
    }
}
