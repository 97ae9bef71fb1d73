//! How memory is shared out while a database is made, so that it stays below what was allowed whatever the terrain's size.
//!
//! Some of it follows from the number of pages (24 bytes each, to know where they are), some from the width of the grid
//! (whole rows are read, and bounds are made in bands of them); the rest holds pages, which go to the disk beyond it.

use crate::{
    terrain::{Grid, PAGE_SIDE},
    wedgie::{BAND_BYTES, Effort, ROW_BYTES},
};

/// What an ingest may take unless it is told otherwise.
pub const DEFAULT_MEMORY_BYTES: usize = 512 << 20;

/// The program itself, its threads' stacks, and what its allocator keeps.
const PROGRAM_BYTES: usize = 40 << 20;
/// Entries of all pages for each page of heights: one of bounds of the finest lattice, a third for all above, a twelfth for
/// heights of coarse lattices, less for extremes, some more for levels of filled voids. Of 24 bytes each.
const ENTRY_BYTES: usize = 64;
/// For each post of a row: a row of pages as it is read, in f64, and the one that is made into pages meanwhile.
const READ_BYTES: usize = 2 * 8 * PAGE_SIDE as usize;
/// The least that makes sense for pages at hand.
const LEAST_CACHE_BYTES: usize = 8 << 20;

/// Shares of memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Budget {
    /// For decoded pages.
    pub(super) cache_bytes: usize,
    /// Rows and bands of bounds at once.
    pub(super) effort: Effort,
}

impl Budget {
    /// Shares `memory_bytes` out for `grid` and a number of threads; the bytes that are needed, if these are too few.
    pub(super) fn new(memory_bytes: usize, grid: Grid, threads: usize) -> Result<Self, usize> {
        let nx = grid.nx() as usize;
        let (columns, rows) = grid.pages();
        let fixed = PROGRAM_BYTES.saturating_add(ENTRY_BYTES.saturating_mul(columns as usize * rows as usize));
        let (band, row) = (BAND_BYTES.saturating_mul(nx), ROW_BYTES.saturating_mul(nx));
        let least_rows = row.saturating_mul(Effort::ROWS_STEP as usize);
        let least = band.saturating_add(least_rows).max(READ_BYTES.saturating_mul(nx));
        let needed = fixed.saturating_add(least).saturating_add(LEAST_CACHE_BYTES);
        let Some(free) = memory_bytes.checked_sub(needed) else { return Err(needed) };
        // What is left over goes by halves to work at once and to pages at hand.
        let bands = (1 + free / 4 / band).min(threads.max(1));
        let steps = (1 + free / 4 / least_rows).min((Effort::FULL.rows / Effort::ROWS_STEP) as usize);
        let taken = (bands - 1) * band + (steps - 1) * least_rows;
        let effort = Effort { rows: steps as u32 * Effort::ROWS_STEP, bands };
        Ok(Self { cache_bytes: LEAST_CACHE_BYTES + (free - taken) / 4 * 3, effort })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shared_out_is_never_more_than_there_is() {
        for (side, memory_mib) in [(2, 64), (4097, 128), (4097, 512), (65_537, 512), (65_537, 1 << 14), (200_000, 2048)]
        {
            let grid = Grid::new(side, side).unwrap();
            let (nx, memory) = (grid.nx() as usize, memory_mib << 20);
            for threads in [1, 2, 64] {
                let budget = Budget::new(memory, grid, threads).unwrap();
                assert!(
                    (1..=threads).contains(&budget.effort.bands)
                        && budget.effort.rows.is_multiple_of(Effort::ROWS_STEP)
                );
                let work = (budget.effort.bands * BAND_BYTES + budget.effort.rows as usize * ROW_BYTES) * nx;
                let pages = grid.pages().0 as usize * grid.pages().1 as usize;
                assert!(
                    PROGRAM_BYTES + pages * ENTRY_BYTES + work + budget.cache_bytes <= memory,
                    "{side} {memory_mib}"
                );
            }
        }
        let wide = Grid::new(1 << 30, 70).unwrap();
        assert!(Budget::new(512 << 20, wide, 1).is_err_and(|needed| needed > 1 << 40));
    }
}
