//! A height field held in memory: for tests, conformance grids and synthetic terrain. Heights are any finite f64.

use std::sync::Arc;

use super::{
    extremes::{self, ExtremesPage, all_pages, extremes_of},
    field::{Grid, GridError, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, ReadError, Samples},
};

/// A height field held in memory.
#[derive(Clone, Debug)]
pub struct MemoryField {
    grid: Grid,
    pages: Vec<Arc<HeightPage>>,
    /// By level from 1.
    extremes: Vec<Vec<Arc<ExtremesPage>>>,
}

impl MemoryField {
    /// A field of `nx` by `ny` posts whose height is `height(i, j)`; `None` is a void post, drawn at height 0.
    ///
    /// # Panics
    /// When a height is not finite.
    pub fn from_fn(nx: u32, ny: u32, mut height: impl FnMut(u32, u32) -> Option<f64>) -> Result<Self, GridError> {
        let grid = Grid::new(nx, ny)?;
        let (columns, rows) = grid.pages();
        let mut pages = Vec::with_capacity(columns as usize * rows as usize);
        for pj in 0..rows {
            for pi in 0..columns {
                pages.push(page(grid, PageId { pi, pj }, &mut height));
            }
        }
        // Moved together, apart from their heights: whoever looks for one finds it near the others.
        let pages: Vec<_> = pages.into_iter().map(Arc::new).collect();
        let levels = extremes_of(grid, |id| Ok(Arc::clone(&pages[(id.pj * columns + id.pi) as usize])));
        let extremes = all_pages(grid, &levels.unwrap_or_default());
        Ok(Self { grid, pages, extremes })
    }
}

fn page(grid: Grid, id: PageId, height: &mut impl FnMut(u32, u32) -> Option<f64>) -> HeightPage {
    let mut samples = vec![0.0; PAGE_POSTS];
    let mut voids = Box::new([0; PAGE_POSTS / 64]);
    let (west, south) = (id.pi * PAGE_SIDE, id.pj * PAGE_SIDE);
    for j in south..(south + PAGE_SIDE).min(grid.ny()) {
        for i in west..(west + PAGE_SIDE).min(grid.nx()) {
            let n = ((j - south) * PAGE_SIDE + i - west) as usize;
            match height(i, j) {
                Some(z) => {
                    assert!(z.is_finite(), "height {z} of post ({i}, {j})");
                    samples[n] = z;
                }
                None => voids[n / 64] |= 1 << (n % 64),
            }
        }
    }
    let any = voids.iter().any(|&w| w != 0);
    HeightPage::new(Samples::narrowest(samples), any.then_some(voids))
}

impl HeightField for MemoryField {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        let (columns, _) = self.grid.pages();
        Ok(Arc::clone(&self.pages[id.pj as usize * columns as usize + id.pi as usize]))
    }

    #[inline]
    fn resident(&self, id: PageId) -> Option<&HeightPage> {
        let (columns, _) = self.grid.pages();
        self.pages.get(id.pj as usize * columns as usize + id.pi as usize).map(|page| &**page)
    }

    fn extremes(&self, level: u32, id: PageId) -> Result<Option<Arc<ExtremesPage>>, ReadError> {
        let found = extremes::pages(self.grid, level)
            .and_then(|(columns, _)| self.extremes.get(level as usize - 1)?.get((id.pj * columns + id.pi) as usize));
        Ok(found.map(Arc::clone))
    }
}
