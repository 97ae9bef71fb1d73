//! Drawn heights of posts, padding included: from a band of rows at hand, or from wherever a page is.

use sightline_proto::diamond::Post;

use crate::terrain::{Grid, HeightField, PAGE_SIDE, PageId, Posts, ReadError, Samples};

/// A source of drawn heights.
pub(super) trait Heights {
    /// The drawn height at `p`, which may be padding.
    fn z(&mut self, p: Post) -> Result<f64, ReadError>;
}

impl<H: HeightField + ?Sized> Heights for Posts<'_, H> {
    fn z(&mut self, p: Post) -> Result<f64, ReadError> {
        Ok(self.at(p)?.z)
    }
}

/// Whole rows of the grid.
pub(super) struct Band {
    grid: Grid,
    first: u32,
    last: u32,
    z: Vec<f64>,
    is_level: bool,
}

impl Band {
    /// Rows `first` to `last` as far as they are in the grid.
    pub(super) fn load<H: HeightField + ?Sized>(field: &H, first: u32, last: u32) -> Result<Self, ReadError> {
        let grid = field.grid();
        let (first, last) = (first.min(grid.ny() - 1), last.min(grid.ny() - 1));
        let mut z = Vec::with_capacity(grid.nx() as usize * (last - first + 1) as usize);
        for pj in first / PAGE_SIDE..=last / PAGE_SIDE {
            let pages: Result<Vec<_>, _> = (0..grid.pages().0).map(|pi| field.page(PageId { pi, pj })).collect();
            let pages = pages?;
            for j in first.max(pj * PAGE_SIDE)..=last.min(pj * PAGE_SIDE + PAGE_SIDE - 1) {
                for (pi, page) in (0..).zip(&pages) {
                    let run = PAGE_SIDE.min(grid.nx() - pi * PAGE_SIDE) as usize;
                    let start = (j % PAGE_SIDE * PAGE_SIDE) as usize;
                    match page.samples() {
                        Samples::I16(samples) => z.extend(samples[start..start + run].iter().map(|&z| f64::from(z))),
                        Samples::I32(samples) => z.extend(samples[start..start + run].iter().map(|&z| f64::from(z))),
                        Samples::F64(samples) => z.extend(&samples[start..start + run]),
                    }
                }
            }
        }
        let is_level = z.iter().all(|&height| height == z[0]);
        Ok(Self { grid, first, last, z, is_level })
    }

    /// Whether all heights at hand are the same.
    pub(super) fn is_level(&self) -> bool {
        self.is_level
    }

    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    /// The rows at hand, from the south.
    pub(super) fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.z.chunks(self.grid.nx() as usize)
    }

    /// Which row the first at hand is.
    pub(super) fn first(&self) -> u32 {
        self.first
    }

    /// Row `j`, from the west; of padding, the nearest row.
    #[inline]
    pub(super) fn row(&self, j: u32) -> &[f64] {
        let j = j.min(self.grid.ny() - 1);
        debug_assert!(self.first <= j && j <= self.last, "row {j} of a band from {} to {}", self.first, self.last);
        let width = self.grid.nx() as usize;
        &self.z[(j - self.first) as usize * width..][..width]
    }

    /// The drawn height at `p`, which may be padding.
    #[inline]
    pub(super) fn height(&self, p: Post) -> f64 {
        self.row(p.j)[p.i.min(self.grid.nx() - 1) as usize]
    }
}

impl Heights for &Band {
    #[inline]
    fn z(&mut self, p: Post) -> Result<f64, ReadError> {
        Ok(self.height(p))
    }
}
