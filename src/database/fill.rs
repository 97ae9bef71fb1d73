//! Fills void posts for drawing: pull-push (Gortler et al., "The Lumigraph", 1996, section 3.4), in integers.
//!
//! *Pull*: each level above halves the grid; a coarse cell is the mean of those of its four fine cells that are known.
//! *Push*: from the top down, an unknown cell takes the bilinear mix of the coarse cells around it, 9/16 of its own,
//! 3/16 of the two beside it, 1/16 of the one across the corner. So small holes are bridged smoothly, large ones flatten
//! out towards the mean of what surrounds them, filled heights never leave the range of the known ones, and the result
//! depends on nothing but the heights. Unlike the paper's, cells are known or not: there are no weights between.
//! Levels lie in pages of a scratch file like the heights, so only some pages are at hand at any time.
//! Known posts keep their height, and filled ones stay void: unknown to lines of sight.

use std::sync::Arc;

use rayon::prelude::*;

use super::{
    directory::{Entry, HAS_VOIDS},
    draft::{Heights, LEVELS, narrowest},
    error::WriteError,
    layout::Paging,
    scratch::{Scratch, Shelf},
};
use crate::terrain::{HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, ReadError, Samples};

/// How voids were filled, for the manifest.
pub(super) const METHOD: &str = "pull-push over powers of two, integer means";

/// Gives the void posts of `heights`, of which not all are void, their drawn heights. `progress` is told what share of the
/// posts that amounts to.
pub(super) fn fill_voids(
    scratch: &Scratch,
    heights: &mut Heights<'_>,
    progress: &mut dyn FnMut(u64),
) -> Result<(), WriteError> {
    let (nx, ny) = (heights.grid().nx(), heights.grid().ny());
    let mut levels: Vec<Level> = Vec::new();
    let (posts, pages) = (heights.grid().posts(), pages_above(nx, ny));
    let mut told = Told { posts, is_pushing: false, pages, done: 0, progress };
    while has_voids(levels.last().map_or(&heights.shelf, |level| &level.shelf)) {
        let (number, below) = (LEVELS + levels.len() as u8, levels.last());
        let (columns, rows) = below.map_or((nx, ny), |level| (level.columns, level.rows));
        if (columns, rows) == (1, 1) {
            // A single unknown cell: everything is void.
            return Err(WriteError::AllVoid { posts: heights.grid().posts() });
        }
        let below = below.map_or(&heights.shelf, |level| &level.shelf);
        levels.push(Level::above(scratch, number, below, columns, rows, &mut told)?);
    }
    let Some(mut complete) = levels.pop() else { return Ok(()) };
    told.pushes(levels.iter().map(|level| &level.shelf).chain([&heights.shelf]).map(|s| s.paging.pages()).sum());
    while let Some(mut finer) = levels.pop() {
        complete.push(&mut finer.shelf, &mut told)?;
        complete = finer;
    }
    complete.push(&mut heights.shelf, &mut told)
}

/// Pages of all levels above a grid.
fn pages_above(mut columns: u32, mut rows: u32) -> u64 {
    let mut pages = 0;
    while (columns, rows) != (1, 1) {
        (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
        pages += Paging::of_heights(columns, rows).pages();
    }
    pages
}

/// Tells how far filling has come: pulling is one half of it, pushing the other.
struct Told<'a> {
    posts: u64,
    is_pushing: bool,
    /// Pages of this half, and how many of them are done.
    pages: u64,
    done: u64,
    progress: &'a mut dyn FnMut(u64),
}

impl Told<'_> {
    fn pushes(&mut self, pages: u64) {
        (self.is_pushing, self.pages, self.done) = (true, pages, 0);
    }

    fn add(&mut self, pages: u32) {
        self.done += u64::from(pages);
        let halves = f64::from(u8::from(self.is_pushing)) + (self.done as f64 / self.pages as f64).min(1.0);
        (self.progress)((self.posts as f64 * halves * 0.5) as u64);
    }
}

/// The places of all pages of a shelf.
fn ids(paging: Paging) -> impl Iterator<Item = PageId> {
    let (columns, rows) = paging.columns_rows();
    (0..rows).flat_map(move |pj| (0..columns).map(move |pi| PageId { pi, pj }))
}

fn has_voids(shelf: &Shelf<'_>) -> bool {
    ids(shelf.paging).any(|id| shelf.entry(id).flags & HAS_VOIDS != 0)
}

/// One level of the pyramid: cells of 2^n posts a side, unknown ones void.
struct Level<'a> {
    columns: u32,
    rows: u32,
    shelf: Shelf<'a>,
}

impl<'a> Level<'a> {
    /// The level above that on `below`, which has so many columns and rows: means of the known cells.
    fn above(
        scratch: &'a Scratch,
        number: u8,
        below: &Shelf<'_>,
        columns: u32,
        rows: u32,
        told: &mut Told<'_>,
    ) -> Result<Self, WriteError> {
        let (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
        let mut shelf = Shelf::new(scratch, number, Paging::of_heights(columns, rows));
        let page_rows = shelf.paging.columns_rows().1;
        for pj in 0..page_rows {
            let row = (0..shelf.paging.columns_rows().0).into_par_iter().map(|pi| PageId { pi, pj });
            let made = row.map(|id| Ok((id, shelf.put_heights(id, pulled_page(below, id)?)?)));
            let made = made.collect::<Result<_, WriteError>>()?;
            set_all(&mut shelf, made);
            told.add(shelf.paging.columns_rows().0);
        }
        Ok(Self { columns, rows, shelf })
    }

    /// Fills the unknown cells of the level below from this one, which is complete; they stay void.
    fn push(&self, below: &mut Shelf<'_>, told: &mut Told<'_>) -> Result<(), WriteError> {
        for pj in 0..below.paging.columns_rows().1 {
            let row = (0..below.paging.columns_rows().0).into_par_iter().map(|pi| PageId { pi, pj });
            let row = row.filter(|&id| below.entry(id).flags & HAS_VOIDS != 0);
            let made = row.map(|id| Ok((id, below.put_heights(id, self.filled_page(&*below.heights(id)?, id)?)?)));
            let made = made.collect::<Result<_, WriteError>>()?;
            set_all(below, made);
            told.add(below.paging.columns_rows().0);
        }
        Ok(())
    }

    fn filled_page(&self, page: &HeightPage, id: PageId) -> Result<HeightPage, ReadError> {
        let mut at_hand = AtHand { level: self, pages: [const { None }; 4] };
        let mut heights = vec![0; PAGE_POSTS];
        let voids = page.voids().copied().unwrap_or([0; PAGE_POSTS / 64]);
        for (j, i) in (0..PAGE_SIDE).flat_map(|j| (0..PAGE_SIDE).map(move |i| (j, i))) {
            let post = page.at(i, j);
            heights[(j * PAGE_SIDE + i) as usize] =
                if post.void { at_hand.mixed(id.pi * PAGE_SIDE + i, id.pj * PAGE_SIDE + j)? } else { post.z as i32 };
        }
        Ok(HeightPage::new(narrowest(&heights), Some(Box::new(voids))))
    }
}

fn set_all(shelf: &mut Shelf<'_>, made: Vec<(PageId, Entry)>) {
    made.into_iter().for_each(|(id, entry)| shelf.set(id, entry));
}

/// A page of the level above that on `below`. The four cells of each of its own lie in one page.
fn pulled_page(below: &Shelf<'_>, id: PageId) -> Result<HeightPage, ReadError> {
    let mut heights = vec![0; PAGE_POSTS];
    let mut voids = Box::new([0_u64; PAGE_POSTS / 64]);
    let (columns, rows) = below.paging.columns_rows();
    let half = PAGE_SIDE / 2;
    for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let from = PageId { pi: 2 * id.pi + x, pj: 2 * id.pj + y };
        if from.pi >= columns || from.pj >= rows {
            continue;
        }
        let (page, (w, h)) = (below.heights(from)?, below.paging.size(from));
        for (j, i) in (0..h).step_by(2).flat_map(|j| (0..w).step_by(2).map(move |i| (j, i))) {
            let mut mean = Mean::default();
            for (v, u) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(v, u)| (j + v, i + u)) {
                let inside = u < w && v < h;
                if let Some(post) = inside.then(|| page.at(u, v)).filter(|post| !post.void) {
                    mean.add(post.z as i32);
                }
            }
            let (i, j) = (half * x + i / 2, half * y + j / 2);
            match mean.get() {
                Some(z) => heights[(j * PAGE_SIDE + i) as usize] = z,
                None => voids[j as usize] |= 1 << i,
            }
        }
    }
    let any = voids.iter().any(|&row| row != 0);
    Ok(HeightPage::new(narrowest(&heights), any.then_some(voids)))
}

/// Pages of a complete level around a place.
struct AtHand<'a> {
    level: &'a Level<'a>,
    /// By the parity of their column and row.
    pages: [Option<(PageId, Arc<HeightPage>)>; 4],
}

impl AtHand<'_> {
    /// The bilinear mix of the level at the cell in column `c` and row `r` of the level below.
    fn mixed(&mut self, c: u32, r: u32) -> Result<i32, ReadError> {
        let beside = |n: u32, cells: u32| {
            let half = n / 2;
            (half, if n % 2 == 1 { (half + 1).min(cells - 1) } else { half.saturating_sub(1) })
        };
        let ((c0, c1), (r0, r1)) = (beside(c, self.level.columns), beside(r, self.level.rows));
        let sum = 9 * self.at(c0, r0)? + 3 * self.at(c1, r0)? + 3 * self.at(c0, r1)? + self.at(c1, r1)?;
        // A mix of heights lies between them, so it fits.
        Ok((sum + 8).div_euclid(16) as i32)
    }

    fn at(&mut self, c: u32, r: u32) -> Result<i64, ReadError> {
        let id = PageId { pi: c / PAGE_SIDE, pj: r / PAGE_SIDE };
        let n = (r % PAGE_SIDE * PAGE_SIDE + c % PAGE_SIDE) as usize;
        let value = |page: &HeightPage| match page.samples() {
            Samples::I16(z) => z[n].into(),
            Samples::I32(z) => z[n].into(),
            Samples::F64(z) => z[n] as i64,
        };
        let slot = &mut self.pages[(id.pi % 2 + id.pj % 2 * 2) as usize];
        Ok(match slot {
            Some((at, page)) if *at == id => value(page),
            _ => {
                let page = self.level.shelf.heights(id)?;
                let z = value(&page);
                *slot = Some((id, page));
                z
            }
        })
    }
}

#[derive(Default)]
struct Mean {
    sum: i64,
    count: i64,
}

impl Mean {
    fn add(&mut self, z: i32) {
        self.sum += i64::from(z);
        self.count += 1;
    }

    /// Rounded to the nearest integer, ties upward; `None` of nothing.
    fn get(&self) -> Option<i32> {
        (self.count > 0).then(|| (2 * self.sum + self.count).div_euclid(2 * self.count) as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        database::draft::Measured,
        terrain::{Grid, Posts, synthetic},
    };
    use sightline_proto::diamond::Post;

    /// Gives `look` the filled heights of a terrain of which `height` says some.
    fn filled(nx: u32, ny: u32, height: impl Fn(u32, u32) -> Option<i32> + Sync, look: impl FnOnce(&Heights<'_>)) {
        let folder = tempfile::tempdir().unwrap();
        // No page stays at hand, so each is read back from the disk.
        let scratch = Scratch::beside(&folder.path().join("it"), 0).unwrap();
        let mut heights = Heights::new(&scratch, Grid::new(nx, ny).unwrap());
        for pj in 0..ny.div_ceil(PAGE_SIDE) {
            let page = |id: PageId| -> Result<Measured, WriteError> {
                let (mut z, mut voids) = (vec![0; PAGE_POSTS], [0; PAGE_POSTS / 64]);
                let (w, h) = heights_size(nx, ny, id);
                for (j, i) in (0..h).flat_map(|j| (0..w).map(move |i| (j, i))) {
                    match height(id.pi * PAGE_SIDE + i, id.pj * PAGE_SIDE + j) {
                        Some(height) => z[(j * PAGE_SIDE + i) as usize] = height,
                        None => voids[j as usize] |= 1 << i,
                    }
                }
                Ok(Measured::new(&z, &voids, None))
            };
            heights.push_row(pj, page).unwrap();
        }
        let mut told = vec![0];
        fill_voids(&scratch, &mut heights, &mut |done| told.push(done)).unwrap();
        assert!(told.is_sorted() && (told.len() == 1 || told.ends_with(&[u64::from(nx) * u64::from(ny)])));
        look(&heights);
    }

    fn heights_size(nx: u32, ny: u32, id: PageId) -> (u32, u32) {
        Paging::of_heights(nx, ny).size(id)
    }

    #[test]
    fn known_posts_stay_and_filled_ones_lie_between_and_stay_void() {
        for (nx, ny) in [(2, 2), (67, 130), (129, 3), (200, 70)] {
            let height = |i: u32, j: u32| {
                let hole = synthetic::mix(u64::from(i / 17 + 100 * (j / 17))).is_multiple_of(3) && (i, j) != (1, 1);
                (!hole).then(|| synthetic::fractal_height(i, j, 4, 700))
            };
            let all = (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j)));
            let known: Vec<_> = all.clone().filter_map(|(i, j)| height(i, j)).collect();
            let (lowest, highest) = (known.iter().min().unwrap(), known.iter().max().unwrap());
            filled(nx, ny, height, |heights| {
                let mut posts = Posts::new(heights);
                for (i, j) in all {
                    let post = posts.at(Post::new(i, j)).unwrap();
                    assert_eq!(post.void, height(i, j).is_none());
                    match height(i, j) {
                        Some(z) => assert_eq!(post.z, f64::from(z)),
                        None => {
                            let range = f64::from(*lowest)..=f64::from(*highest);
                            assert!(range.contains(&post.z), "({i}, {j}) {}", post.z);
                        }
                    }
                }
            });
        }
    }

    /// A hole in a level plain is filled level, and one in a slope is bridged within the slope's own steps.
    #[test]
    fn holes_in_plains_and_slopes_are_bridged() {
        let hole = |i: u32, j: u32| (40..70).contains(&i) && (50..60).contains(&j);
        filled(
            130,
            100,
            |i, j| (!hole(i, j)).then_some(-77),
            |plain| {
                assert_eq!(Posts::new(plain).at(Post::new(55, 55)).unwrap().z, -77.0);
            },
        );
        filled(
            130,
            100,
            |i, j| (!hole(i, j)).then_some(10 * j as i32),
            |slope| {
                let mut posts = Posts::new(slope);
                for (i, j) in (50..60).flat_map(|j| (40..70).map(move |i| (i, j))) {
                    let z = posts.at(Post::new(i, j)).unwrap().z;
                    assert!((z - 10.0 * f64::from(j)).abs() <= 80.0, "({i}, {j}) at {z}");
                }
            },
        );
    }
}
