//! Fills void posts for drawing: pull-push (Gortler et al., "The Lumigraph", 1996, section 3.4), in integers.
//!
//! *Pull*: each level above halves the grid; a coarse cell is the mean of those of its four fine cells that are known.
//! *Push*: from the top down, an unknown cell takes the bilinear mix of the coarse cells around it, 9/16 of its own,
//! 3/16 of the two beside it, 1/16 of the one across the corner. So small holes are bridged smoothly, large ones flatten
//! out towards the mean of what surrounds them, filled heights never leave the range of the known ones, and the result
//! depends on nothing but the heights. Unlike the paper's, cells are known or not: there are no weights between.
//! Known posts keep their height, and filled ones stay void: unknown to lines of sight.

use std::sync::Arc;

use super::paged::PagedField;
use crate::terrain::{HeightField, HeightPage, PAGE_SIDE, PageId, Samples};

/// How voids were filled, for the manifest.
pub(super) const METHOD: &str = "pull-push over powers of two, integer means";

/// Stands for an unknown cell; quantised heights are above it.
const UNKNOWN: i32 = i32::MIN;

/// One level of the pyramid: cells of 2^n posts a side.
struct Level {
    columns: usize,
    rows: usize,
    cells: Vec<i32>,
}

impl Level {
    fn at(&self, c: usize, r: usize) -> i32 {
        self.cells[r * self.columns + c]
    }

    fn is_complete(&self) -> bool {
        !self.cells.contains(&UNKNOWN)
    }

    /// The level above: means of the known cells.
    fn pulled(&self) -> Self {
        let (columns, rows) = (self.columns.div_ceil(2), self.rows.div_ceil(2));
        let mut cells = Vec::with_capacity(columns * rows);
        for (r, c) in (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))) {
            let mut mean = Mean::default();
            for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(y, x)| (2 * r + y, 2 * c + x)) {
                if y < self.rows && x < self.columns {
                    mean.add(self.at(x, y));
                }
            }
            cells.push(mean.get());
        }
        Self { columns, rows, cells }
    }

    /// Fills the unknown cells from the complete level above.
    fn push(&mut self, above: &Self) {
        for (r, c) in (0..self.rows).flat_map(|r| (0..self.columns).map(move |c| (r, c))) {
            if self.cells[r * self.columns + c] == UNKNOWN {
                self.cells[r * self.columns + c] = above.mixed(c, r);
            }
        }
    }

    /// The bilinear mix of this complete level at the fine cell in column `c` and row `r` of the level below.
    fn mixed(&self, c: usize, r: usize) -> i32 {
        let beside = |n: usize, cells: usize| {
            let half = n / 2;
            (half, if n % 2 == 1 { (half + 1).min(cells - 1) } else { half.saturating_sub(1) })
        };
        let ((c0, c1), (r0, r1)) = (beside(c, self.columns), beside(r, self.rows));
        let z = |c, r| i64::from(self.at(c, r));
        let sum = 9 * z(c0, r0) + 3 * z(c1, r0) + 3 * z(c0, r1) + z(c1, r1);
        // A mix of heights lies between them, so it fits.
        (sum + 8).div_euclid(16) as i32
    }
}

#[derive(Default)]
struct Mean {
    sum: i64,
    count: i64,
}

impl Mean {
    fn add(&mut self, z: i32) {
        if z != UNKNOWN {
            self.sum += i64::from(z);
            self.count += 1;
        }
    }

    /// Rounded to the nearest integer, ties upward.
    fn get(&self) -> i32 {
        if self.count == 0 { UNKNOWN } else { (2 * self.sum + self.count).div_euclid(2 * self.count) as i32 }
    }
}

/// Gives the void posts of `field`, of which not all are void, their drawn heights.
pub(super) fn fill_voids(field: &mut PagedField) {
    let mut levels = vec![first_level(field)];
    while let Some(last) = levels.last()
        && !last.is_complete()
    {
        let above = last.pulled();
        if (above.columns, above.rows) == (last.columns, last.rows) {
            // A single unknown cell: everything is void, which the writer refuses.
            return;
        }
        levels.push(above);
    }
    let Some(mut complete) = levels.pop() else { return };
    while let Some(mut finer) = levels.pop() {
        finer.push(&complete);
        complete = finer;
    }
    for page in 0..field.pages.len() {
        if field.pages[page].has_voids() {
            let id = field.id(page);
            field.pages[page] = Arc::new(filled_page(&field.pages[page], id, &complete));
        }
    }
}

/// The means of 2 by 2 posts.
fn first_level(field: &PagedField) -> Level {
    let grid = field.grid();
    let (columns, rows) = (grid.nx().div_ceil(2) as usize, grid.ny().div_ceil(2) as usize);
    let mut cells = vec![UNKNOWN; columns * rows];
    for (n, page) in field.pages.iter().enumerate() {
        let id = field.id(n);
        let (west, south) = (id.pi * PAGE_SIDE, id.pj * PAGE_SIDE);
        for (j, i) in (0..PAGE_SIDE).step_by(2).flat_map(|j| (0..PAGE_SIDE).step_by(2).map(move |i| (j, i))) {
            if west + i >= grid.nx() || south + j >= grid.ny() {
                continue;
            }
            let mut mean = Mean::default();
            for (v, u) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(v, u)| (j + v, i + u)) {
                if west + u < grid.nx() && south + v < grid.ny() && !page.at(u, v).void {
                    mean.add(page.at(u, v).z as i32);
                }
            }
            cells[((south + j) / 2) as usize * columns + ((west + i) / 2) as usize] = mean.get();
        }
    }
    Level { columns, rows, cells }
}

fn filled_page(page: &HeightPage, id: PageId, above: &Level) -> HeightPage {
    let mut samples = Vec::new();
    let mut voids = Box::new([0_u64; PAGE_SIDE as usize]);
    for (j, i) in (0..PAGE_SIDE).flat_map(|j| (0..PAGE_SIDE).map(move |i| (j, i))) {
        let post = page.at(i, j);
        voids[j as usize] |= u64::from(post.void) << i;
        samples.push(if post.void {
            above.mixed((id.pi * PAGE_SIDE + i) as usize, (id.pj * PAGE_SIDE + j) as usize)
        } else {
            post.z as i32
        });
    }
    HeightPage::new(Samples::I32(samples.into()), Some(voids))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{Grid, Posts, synthetic};
    use sightline_proto::diamond::Post;

    fn field(nx: u32, ny: u32, height: impl Fn(u32, u32) -> Option<i32>) -> PagedField {
        let mut field = PagedField::new(Grid::new(nx, ny).unwrap());
        for j0 in (0..ny).step_by(PAGE_SIDE as usize) {
            let rows = j0..(j0 + PAGE_SIDE).min(ny);
            let band: Vec<_> = rows.flat_map(|j| (0..nx).map(move |i| (i, j))).map(|(i, j)| height(i, j)).collect();
            field.push_band(&band);
        }
        field
    }

    #[test]
    fn known_posts_stay_and_filled_ones_lie_between_and_stay_void() {
        for (nx, ny) in [(2, 2), (67, 130), (129, 3), (200, 70)] {
            let height = |i: u32, j: u32| {
                let hole = synthetic::mix(u64::from(i / 17 + 100 * (j / 17))).is_multiple_of(3) && (i, j) != (1, 1);
                (!hole).then(|| synthetic::fractal_height(i, j, 4, 700))
            };
            let mut filled = field(nx, ny, height);
            fill_voids(&mut filled);
            let all = (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j)));
            let known: Vec<_> = all.clone().filter_map(|(i, j)| height(i, j)).collect();
            let (lowest, highest) = (known.iter().min().unwrap(), known.iter().max().unwrap());
            let mut posts = Posts::new(&filled);
            for (i, j) in all {
                let post = posts.at(Post::new(i, j)).unwrap();
                assert_eq!(post.void, height(i, j).is_none());
                match height(i, j) {
                    Some(z) => assert_eq!(post.z, f64::from(z)),
                    None => {
                        assert!((f64::from(*lowest)..=f64::from(*highest)).contains(&post.z), "({i}, {j}) {}", post.z)
                    }
                }
            }
        }
    }

    /// A hole in a level plain is filled level, and one in a slope is bridged within the slope's own steps.
    #[test]
    fn holes_in_plains_and_slopes_are_bridged() {
        let hole = |i: u32, j: u32| (40..70).contains(&i) && (50..60).contains(&j);
        let mut plain = field(130, 100, |i, j| (!hole(i, j)).then_some(-77));
        fill_voids(&mut plain);
        let mut posts = Posts::new(&plain);
        assert_eq!(posts.at(Post::new(55, 55)).unwrap().z, -77.0);
        let mut slope = field(130, 100, |i, j| (!hole(i, j)).then_some(10 * j as i32));
        fill_voids(&mut slope);
        let mut posts = Posts::new(&slope);
        for (i, j) in (50..60).flat_map(|j| (40..70).map(move |i| (i, j))) {
            let z = posts.at(Post::new(i, j)).unwrap().z;
            assert!((z - 10.0 * f64::from(j)).abs() <= 80.0, "({i}, {j}) at {z}");
        }
    }
}
