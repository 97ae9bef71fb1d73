//! Heights of coarse lattices, while a database is made: they go beside the bounds of their posts.
//!
//! The lattice of step 2^k has the posts (c 2^k, r 2^k), up to the first column and row at or beyond the border of the grid,
//! where it has the height of the nearest post, as padding has. Each lattice is cut down from the one below, so the pages
//! of heights are read once for all of them.

use std::{ops::Range, sync::Arc};

use rayon::prelude::*;

use super::{
    draft::{COARSE, Heights, narrowest},
    error::WriteError,
    layout::{Paging, QUAD_DIAMONDS, QUAD_SIDE, quad_post},
    scratch::{Scratch, Shelf},
};
use crate::{
    terrain::{Grid, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, ReadError, Samples},
    wedgie::LatticeSize,
};

/// Exponent of the step of the finest lattice that is cut down; a page of bounds of a finer one has few pages of heights.
const FINEST: u32 = 2;

/// Exponents of the steps of all lattices: up to the one that fits a page; none where the heights fit one.
fn levels(grid: Grid) -> Range<u32> {
    let cells = grid.nx().max(grid.ny()) - 1;
    let least = cells.div_ceil(PAGE_SIDE - 1).next_power_of_two().trailing_zeros();
    FINEST..if cells < PAGE_SIDE { FINEST } else { least.max(FINEST) + 1 }
}

/// Columns and rows of the lattice of step 2^k.
fn extent(grid: Grid, k: u32) -> (u32, u32) {
    let posts = |n: u32| ((n - 1 + ((1 << k) - 1)) >> k) + 1;
    (posts(grid.nx()), posts(grid.ny()))
}

/// Heights, and those of all coarse lattices.
pub(super) struct CoarseHeights<'a> {
    heights: &'a Heights<'a>,
    /// From the finest on.
    lattices: Vec<Shelf<'a>>,
}

impl<'a> CoarseHeights<'a> {
    /// All lattices of `heights`, whose pages are complete and filled.
    pub(super) fn of(scratch: &'a Scratch, heights: &'a Heights<'a>) -> Result<Self, WriteError> {
        let mut all = Self { heights, lattices: Vec::new() };
        for k in levels(heights.grid()) {
            let (columns, rows) = extent(heights.grid(), k);
            let mut shelf = Shelf::new(scratch, COARSE + k as u8, Paging::of_heights(columns, rows));
            for pj in 0..shelf.paging.columns_rows().1 {
                let row = (0..shelf.paging.columns_rows().0).into_par_iter().map(|pi| PageId { pi, pj });
                let made = row.map(|id| {
                    let page = all.cut_down(k, id, shelf.paging.size(id))?;
                    Ok((id, shelf.put_heights(id, page)?))
                });
                for (id, entry) in made.collect::<Result<Vec<_>, WriteError>>()? {
                    shelf.set(id, entry);
                }
            }
            all.lattices.push(shelf);
        }
        Ok(all)
    }

    /// A reader of lattice `k`, from the coarsest shelf that has its posts.
    fn cells(&self, k: u32) -> Cells<'_> {
        match self.lattices.len().min((k + 1).saturating_sub(FINEST) as usize) {
            0 => Cells { shelf: &self.heights.shelf, shift: k, held: Vec::new() },
            n => Cells { shelf: &self.lattices[n - 1], shift: k - (FINEST + n as u32 - 1), held: Vec::new() },
        }
    }

    /// Page `id` of lattice `k`, which has `size` posts; all lattices below are there.
    fn cut_down(&self, k: u32, id: PageId, size: (u32, u32)) -> Result<HeightPage, ReadError> {
        let (mut cells, mut heights) = (self.cells(k), vec![0; PAGE_POSTS]);
        for (j, i) in (0..size.1).flat_map(|j| (0..size.0).map(move |i| (j, i))) {
            heights[(j * PAGE_SIDE + i) as usize] = cells.at(id.pi * PAGE_SIDE + i, id.pj * PAGE_SIDE + j)?;
        }
        Ok(HeightPage::new(narrowest(&heights), None))
    }

    /// The heights of the posts of page `id` of a lattice of bounds, which has so many quads: three of each, 0 beyond it.
    pub(super) fn of_bounds(&self, size: LatticeSize, id: PageId, quads: (u32, u32)) -> Result<Vec<i32>, ReadError> {
        let mut cells = self.cells(size.k.into());
        let mut heights = Vec::with_capacity((quads.0 * quads.1) as usize * QUAD_DIAMONDS);
        for (v, u) in (0..quads.1).flat_map(|v| (0..quads.0).map(move |u| (v, u))) {
            for n in 0..QUAD_DIAMONDS {
                let (a, b) = quad_post(id.pi * QUAD_SIDE + u, id.pj * QUAD_SIDE + v, n);
                heights.push(if a < size.columns && b < size.rows { cells.at(a, b)? } else { 0 });
            }
        }
        Ok(heights)
    }
}

/// A reader of a lattice.
struct Cells<'s> {
    shelf: &'s Shelf<'s>,
    /// Exponent of the lattice's step in posts of the shelf.
    shift: u32,
    /// The last pages met, the latest at the end.
    held: Vec<(PageId, Arc<HeightPage>)>,
}

/// Pages that a reader of a lattice keeps at hand: those of one row of a page that is cut down, and of the next one.
const HELD: usize = 8;

impl Cells<'_> {
    /// The drawn height in column `c` and row `r`, or that of the nearest post of the shelf.
    fn at(&mut self, c: u32, r: u32) -> Result<i32, ReadError> {
        let (columns, rows) = self.shelf.paging.cells();
        let along = |n: u32, cells: u32| (u64::from(n) << self.shift).min(u64::from(cells) - 1) as u32;
        let (c, r) = (along(c, columns), along(r, rows));
        let id = PageId { pi: c / PAGE_SIDE, pj: r / PAGE_SIDE };
        if self.held.last().is_none_or(|(last, _)| *last != id) {
            self.hold(id)?;
        }
        let n = (r % PAGE_SIDE * PAGE_SIDE + c % PAGE_SIDE) as usize;
        Ok(match self.held.last().map(|(_, page)| page.samples()) {
            Some(Samples::I16(z)) => z[n].into(),
            Some(Samples::I32(z)) => z[n],
            Some(Samples::F64(z)) => z[n] as i32,
            None => unreachable!("a page was brought above"),
        })
    }

    /// Has page `id` as the last of those at hand.
    fn hold(&mut self, id: PageId) -> Result<(), ReadError> {
        let page = match self.held.iter().position(|(held, _)| *held == id) {
            Some(n) => self.held.remove(n),
            None => (id, self.shelf.heights(id)?),
        };
        if self.held.len() == HELD {
            self.held.remove(0);
        }
        self.held.push(page);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lattices_end_with_the_one_that_fits_a_page() {
        for (nx, ny) in [(65, 2), (65, 65), (200, 131), (256, 257), (300, 1100), (4801, 4801), (65_537, 9)] {
            let grid = Grid::new(nx, ny).unwrap();
            let levels = levels(grid);
            for k in levels.clone() {
                let (columns, rows) = extent(grid, k);
                assert_eq!(columns <= PAGE_SIDE && rows <= PAGE_SIDE, k + 1 == levels.end, "{nx} x {ny}, {k}");
                assert!(nx - 1 <= (columns - 1) << k && (columns - 1) << k < nx - 1 + (1 << k));
            }
        }
        assert!(levels(Grid::new(64, 64).unwrap()).is_empty());
        let largest = Grid::new((1 << 30) + 1, 2).unwrap();
        assert_eq!((levels(largest), extent(largest, 25)), (2..26, (33, 2)));
    }
}
