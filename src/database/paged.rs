//! A terrain in memory as pages of integers, on its way from a raster into a database.

use std::sync::Arc;

use crate::terrain::{Grid, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, ReadError, Samples};

/// Integer heights in memory, in pages; filled from the south, a row of pages at a time.
pub(super) struct PagedField {
    grid: Grid,
    /// Row by row from the south.
    pub(super) pages: Vec<Arc<HeightPage>>,
}

impl PagedField {
    /// A field without pages as yet.
    pub(super) fn new(grid: Grid) -> Self {
        Self { grid, pages: Vec::new() }
    }

    /// Adds the next row of pages from the rows of posts that it covers, south first; `None` is void.
    pub(super) fn push_band(&mut self, band: &[Option<i32>]) {
        let nx = self.grid.nx() as usize;
        for west in (0..nx).step_by(PAGE_SIDE as usize) {
            let rows = band.chunks_exact(nx).map(|row| &row[west..(west + PAGE_SIDE as usize).min(nx)]);
            self.pages.push(Arc::new(page(rows)));
        }
    }

    /// The place of page number `n`.
    pub(super) fn id(&self, n: usize) -> PageId {
        let columns = self.grid.pages().0 as usize;
        PageId { pi: (n % columns) as u32, pj: (n / columns) as u32 }
    }
}

fn page<'a>(rows: impl Iterator<Item = &'a [Option<i32>]>) -> HeightPage {
    let mut heights = vec![0; PAGE_POSTS];
    let mut voids = Box::new([0_u64; PAGE_POSTS / 64]);
    for (j, row) in rows.enumerate() {
        for (i, z) in row.iter().enumerate() {
            heights[j * PAGE_SIDE as usize + i] = z.unwrap_or(0);
            voids[j] |= u64::from(z.is_none()) << i;
        }
    }
    let small: Option<Vec<i16>> = heights.iter().map(|&z| i16::try_from(z).ok()).collect();
    let samples = match small {
        Some(small) => Samples::I16(small.into()),
        None => Samples::I32(heights.into()),
    };
    let any = voids.iter().any(|&w| w != 0);
    HeightPage::new(samples, any.then_some(voids))
}

impl HeightField for PagedField {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        let columns = self.grid.pages().0 as usize;
        Ok(Arc::clone(&self.pages[id.pj as usize * columns + id.pi as usize]))
    }
}
