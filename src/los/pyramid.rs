//! Least and greatest heights of square blocks of the grid, so that a line need not touch what lies clear of it.
//!
//! Level k has blocks of `BASE_CELLS` 2^k cells a side. A block's bounds hold for its posts and for one ring of posts
//! around it, as far as the grid reaches: whoever knows the place of a point to within less than a cell may still use
//! the block that it seems to be in. Bounds are f32, rounded outward. A block with a void post among these has infinite
//! bounds: it is never skipped, and never stops a line.
//!
//! It follows the maximum mipmaps of Tevs, Ihrke and Seidel, "Maximum mipmaps for fast, accurate, and scalable dynamic
//! height field rendering" (2008), with the minimum beside the maximum.

use sightline_proto::predicates::{Sign, compare};

use crate::terrain::{Grid, HeightField, PAGE_SIDE, PageId, ReadError};

/// Binary logarithm of the cells along the side of a block of the finest level.
pub(super) const BASE_SHIFT: u32 = 3;

/// Bounds of the surface over a block, in height units.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Bounds {
    pub(super) low: f32,
    pub(super) high: f32,
}

impl Bounds {
    /// Contains no height.
    const NOTHING: Self = Self { low: f32::INFINITY, high: f32::NEG_INFINITY };
    /// Contains all heights, and the lack of one.
    const ANYTHING: Self = Self { low: f32::NEG_INFINITY, high: f32::INFINITY };

    fn of(z: f64) -> Self {
        // Subnormal bounds might be read as zero.
        if z.abs() < f64::from(f32::MIN_POSITIVE) {
            let sign = compare(z, 0.0);
            let bound = |beyond: Sign, limit: f32| if sign == beyond { limit } else { 0.0 };
            return Self {
                low: bound(Sign::Negative, -f32::MIN_POSITIVE),
                high: bound(Sign::Positive, f32::MIN_POSITIVE),
            };
        }
        let nearest = z as f32;
        let value = f64::from(nearest);
        Self {
            low: if value > z { nearest.next_down() } else { nearest },
            high: if value < z { nearest.next_up() } else { nearest },
        }
    }

    fn join(&mut self, other: Self) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
    }
}

#[derive(Clone, Debug)]
struct Level {
    columns: u32,
    rows: u32,
    blocks: Vec<Bounds>,
}

impl Level {
    fn new(grid: Grid, shift: u32) -> Self {
        let along = |posts: u32| ((posts - 1) >> shift) + u32::from((posts - 1) & ((1 << shift) - 1) != 0);
        let (columns, rows) = (along(grid.nx()), along(grid.ny()));
        Self { columns, rows, blocks: vec![Bounds::NOTHING; columns as usize * rows as usize] }
    }
}

/// Bounds of blocks at all scales; belongs to the field that it was built from. Takes about a twelfth of the memory of
/// 16-bit heights, and to build it one reading of all posts.
#[derive(Clone, Debug)]
pub struct Pyramid {
    base_shift: u32,
    levels: Vec<Level>,
}

impl Pyramid {
    /// Reads all posts of `field`.
    pub fn build<H: HeightField + ?Sized>(field: &H) -> Result<Self, ReadError> {
        Self::with_base(field, BASE_SHIFT)
    }

    /// The same with blocks of 2^`base_shift` cells a side on the finest level.
    pub(super) fn with_base<H: HeightField + ?Sized>(field: &H, base_shift: u32) -> Result<Self, ReadError> {
        let grid = field.grid();
        let mut levels = vec![base(field, base_shift)?];
        while levels[levels.len() - 1].blocks.len() > 1 {
            let finer = &levels[levels.len() - 1];
            let mut level = Level::new(grid, base_shift + levels.len() as u32);
            for (n, &bounds) in finer.blocks.iter().enumerate() {
                let (i, j) = (n % finer.columns as usize / 2, n / finer.columns as usize / 2);
                level.blocks[j * level.columns as usize + i].join(bounds);
            }
            levels.push(level);
        }
        Ok(Self { base_shift, levels })
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|level| level.blocks.len() * size_of::<Bounds>()).sum()
    }

    /// Number of the coarsest level, which is one block.
    pub(super) fn top(&self) -> u32 {
        self.levels.len() as u32 - 1
    }

    /// Binary logarithm of the cells along the side of a block of a level.
    pub(super) fn shift(&self, level: u32) -> u32 {
        self.base_shift + level
    }

    /// The bounds of the block in column `i` and row `j` of a level; the nearest block for one beyond the grid.
    #[inline]
    pub(super) fn at(&self, level: u32, i: i64, j: i64) -> Bounds {
        let level = &self.levels[level as usize];
        let column = i.clamp(0, i64::from(level.columns) - 1) as usize;
        let row = j.clamp(0, i64::from(level.rows) - 1) as usize;
        level.blocks[row * level.columns as usize + column]
    }
}

/// The finest level.
fn base<H: HeightField + ?Sized>(field: &H, shift: u32) -> Result<Level, ReadError> {
    let grid = field.grid();
    let mut level = Level::new(grid, shift);
    let (page_columns, page_rows) = grid.pages();
    let columns = level.columns as usize;
    for pj in 0..page_rows {
        let pages: Result<Vec<_>, _> = (0..page_columns).map(|pi| field.page(PageId { pi, pj })).collect();
        let pages = pages?;
        for j in pj * PAGE_SIDE..((pj + 1) * PAGE_SIDE).min(grid.ny()) {
            let mut row = vec![Bounds::NOTHING; columns];
            for (page, west) in pages.iter().zip((0..).step_by(PAGE_SIDE as usize)) {
                for i in west..(west + PAGE_SIDE).min(grid.nx()) {
                    let post = page.at(i - west, j % PAGE_SIDE);
                    let bounds = if post.void { Bounds::ANYTHING } else { Bounds::of(post.z) };
                    for n in blocks_of(i, shift, level.columns) {
                        row[n].join(bounds);
                    }
                }
            }
            for n in blocks_of(j, shift, level.rows) {
                for (block, bounds) in level.blocks[n * columns..(n + 1) * columns].iter_mut().zip(&row) {
                    block.join(*bounds);
                }
            }
        }
    }
    Ok(level)
}

/// The blocks along one axis that have post `i` in them or in the ring around them: those of posts i - 2 to i + 1 as
/// far as they exist, since block n has posts 2^shift n - 1 to 2^shift (n + 1) + 1.
fn blocks_of(i: u32, shift: u32, count: u32) -> std::ops::RangeInclusive<usize> {
    let first = i.saturating_sub(2) >> shift;
    let last = ((i + 1) >> shift).min(count - 1);
    first.min(last) as usize..=last as usize
}
