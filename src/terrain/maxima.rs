//! Greatest heights over square blocks of posts, so that whoever asks for something high need not read what is low.
//!
//! ```text
//!   page of heights            64 x 64 posts; within it blocks of 8, 16, 32 and 64 posts a side  (BlockMaxima)
//!   page of maxima, level 1    64 x 64 values, each for a page of heights; blocks of 2, 4, ... 64 values a side
//!   page of maxima, level 2    64 x 64 values, each for a page of level 1; and so on up to a single value
//! ```
//!
//! Blocks within a page follow from it and live as long as it does; pages of maxima come from the field
//! ([`HeightField::maxima`]) like those of heights, and have their form. So nothing is ever read for bounds but a few
//! bytes for each page near a line. It follows the maximum mipmaps of Tevs, Ihrke and Seidel, "Maximum mipmaps for
//! fast, accurate, and scalable dynamic height field rendering" (2008), cut into pages. A maximum holds for all posts
//! of its block as drawn, void ones included, and (what harms nobody) for a height of 0 where a page reaches beyond the
//! grid.

use std::{ops::RangeInclusive, sync::Arc};

use super::field::{Grid, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, Posts, ReadError, Samples};

/// Binary logarithm of [`PAGE_SIDE`].
const PAGE_SHIFT: u32 = PAGE_SIDE.trailing_zeros();
/// Binary logarithm of the side of the smallest blocks within a page of heights, in posts.
const FINEST_OF_HEIGHTS: u32 = 3;
/// The same within a page of maxima, in values.
const FINEST_OF_MAXIMA: u32 = 1;
/// Where the blocks of 2^n posts a side begin among all blocks of a page: behind all larger ones.
const FIRST_BLOCK: [usize; PAGE_SHIFT as usize + 1] = [1365, 341, 85, 21, 5, 1, 0];

/// The greatest height over blocks of posts.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Greatest {
    /// No post of the blocks is drawn higher.
    pub z: f32,
    /// Whether some post of the blocks may be void.
    pub void: bool,
}

impl Greatest {
    const NOTHING: Self = Self { z: f32::NEG_INFINITY, void: false };

    fn join(self, other: Self) -> Self {
        Self { z: self.z.max(other.z), void: self.void | other.void }
    }
}

/// The maxima of the blocks of one page.
#[derive(Clone, Debug)]
pub struct BlockMaxima {
    /// From the largest blocks to the smallest, each size row by row from the south.
    z: Box<[f32]>,
    /// The same for whether there are voids; empty where the page has none.
    void: Box<[bool]>,
    /// The greatest sample, and the greatest magnitude of one.
    greatest: f64,
    magnitude: f64,
}

impl BlockMaxima {
    pub(super) fn of_heights(samples: &Samples, voids: Option<&[u64; PAGE_POSTS / 64]>) -> Self {
        Self::new(samples, voids, FINEST_OF_HEIGHTS)
    }

    pub(super) fn of_maxima(samples: &Samples, voids: Option<&[u64; PAGE_POSTS / 64]>) -> Self {
        Self::new(samples, voids, FINEST_OF_MAXIMA)
    }

    fn new(samples: &Samples, voids: Option<&[u64; PAGE_POSTS / 64]>, finest: u32) -> Self {
        let mut z = vec![f32::NEG_INFINITY; FIRST_BLOCK[finest as usize - 1]];
        let smallest = &mut z[FIRST_BLOCK[finest as usize]..];
        let (least, greatest) = match samples {
            Samples::I16(s) => fill(s, finest, smallest),
            Samples::I32(s) => fill(s, finest, smallest),
            Samples::F64(s) => fill(s, finest, smallest),
        };
        let mut void = vec![false; if voids.is_some() { z.len() } else { 0 }];
        for n in voids.into_iter().flat_map(|v| (0..PAGE_POSTS).filter(|n| v[n / 64] >> (n % 64) & 1 == 1)) {
            let (i, j) = ((n % 64) >> finest, (n / 64) >> finest);
            void[FIRST_BLOCK[finest as usize] + (j << (PAGE_SHIFT - finest)) + i] = true;
        }
        for shift in finest + 1..=PAGE_SHIFT {
            let side = 1_usize << (PAGE_SHIFT - shift);
            for n in 0..side * side {
                let (i, j) = (2 * (n % side), 2 * (n / side));
                for (di, dj) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let from = FIRST_BLOCK[shift as usize - 1] + (j + dj) * 2 * side + i + di;
                    let to = FIRST_BLOCK[shift as usize] + n;
                    z[to] = z[to].max(z[from]);
                    if let Some(v) = void.get(from).copied() {
                        void[to] |= v;
                    }
                }
            }
        }
        let magnitude = least.abs().max(greatest.abs());
        Self { z: z.into(), void: void.into(), greatest, magnitude }
    }

    /// The greatest sample, exactly.
    pub fn greatest(&self) -> f64 {
        self.greatest
    }

    /// The greatest magnitude of a sample.
    pub fn magnitude(&self) -> f64 {
        self.magnitude
    }

    /// The block of 2^`shift` posts a side in column `i` and row `j`.
    #[inline]
    fn block(&self, shift: u32, i: u32, j: u32) -> Greatest {
        let n = FIRST_BLOCK[shift as usize] + (j << (PAGE_SHIFT - shift)) as usize + i as usize;
        Greatest { z: self.z[n], void: self.void.get(n).copied().unwrap_or(false) }
    }
}

/// Fills in the maxima of the smallest blocks; the least and greatest sample.
fn fill<S: Copy + PartialOrd + Into<f64>>(samples: &[S], finest: u32, out: &mut [f32]) -> (f64, f64) {
    let greater = |a: S, b: S| if b > a { b } else { a };
    let (side, page) = (1 << finest, PAGE_SIDE as usize);
    let (mut least, mut greatest) = (samples[0], samples[0]);
    for (band, out) in samples.chunks_exact(side * page).zip(out.chunks_exact_mut(page / side)) {
        // Row upon row first: that is a loop which compilers make wide.
        let mut columns = [samples[0]; PAGE_SIDE as usize];
        columns.copy_from_slice(&band[..page]);
        for row in band.chunks_exact(page) {
            for (column, &z) in columns.iter_mut().zip(row) {
                *column = greater(*column, z);
                least = if z < least { z } else { least };
            }
        }
        for (block, out) in columns.chunks_exact(side).zip(out) {
            let z = block[1..].iter().fold(block[0], |a, &b| greater(a, b));
            greatest = greater(greatest, z);
            *out = not_below(z.into());
        }
    }
    (least.into(), greatest.into())
}

/// The least normal f32 that is not below a number; no less than a small one where subnormal numbers, which a host may
/// have read as zero, could be meant.
fn not_below(z: f64) -> f32 {
    if z.abs() < f64::from(f32::MIN_POSITIVE) {
        return f32::MIN_POSITIVE;
    }
    let nearest = z as f32;
    if f64::from(nearest) < z { nearest.next_up() } else { nearest }
}

/// Columns and rows of the values of a level of maxima; level 0 are the posts themselves.
pub fn extent(grid: Grid, level: u32) -> (u32, u32) {
    let values = |posts: u32| (((u64::from(posts) - 1) >> (PAGE_SHIFT * level)) + 1) as u32;
    (values(grid.nx()), values(grid.ny()))
}

/// The pages of a level of maxima from west to east and from south to north; `None` for level 0 and for levels above
/// the one that has a single page.
pub fn pages(grid: Grid, level: u32) -> Option<(u32, u32)> {
    let (columns, rows) = extent(grid, level);
    let below = level.checked_sub(1).map(|below| extent(grid, below))?;
    let needed = below.0 > PAGE_SIDE || below.1 > PAGE_SIDE;
    needed.then(|| (columns.div_ceil(PAGE_SIDE), rows.div_ceil(PAGE_SIDE)))
}

/// All pages of maxima of a grid, by level from 1, each row by row from the south, from its pages of heights.
pub fn maxima_of<P>(
    grid: Grid,
    mut heights: impl FnMut(PageId) -> Result<P, ReadError>,
) -> Result<Vec<Vec<Arc<HeightPage>>>, ReadError>
where
    P: AsRef<HeightPage>,
{
    let mut levels: Vec<Vec<Arc<HeightPage>>> = Vec::new();
    for level in 1.. {
        let Some((columns, rows)) = pages(grid, level) else { break };
        let values = extent(grid, level);
        let mut made = Vec::with_capacity(columns as usize * rows as usize);
        for id in (0..rows).flat_map(|pj| (0..columns).map(move |pi| PageId { pi, pj })) {
            let mut below = |i: u32, j: u32| match levels.last() {
                Some(pages) => Ok(summary(&pages[j as usize * values.0 as usize + i as usize])),
                None => heights(PageId { pi: i, pj: j }).map(|page| summary(page.as_ref())),
            };
            made.push(Arc::new(page_of_maxima(id, values, &mut below)?));
        }
        levels.push(made);
    }
    Ok(levels)
}

/// The greatest height of a page, and whether it has voids.
fn summary(page: &HeightPage) -> (f64, bool) {
    (page.maxima().greatest(), page.has_voids())
}

fn page_of_maxima(
    id: PageId,
    (columns, rows): (u32, u32),
    below: &mut impl FnMut(u32, u32) -> Result<(f64, bool), ReadError>,
) -> Result<HeightPage, ReadError> {
    let mut samples = vec![0.0; PAGE_POSTS];
    let mut voids = Box::new([0; PAGE_POSTS / 64]);
    let (west, south) = (id.pi * PAGE_SIDE, id.pj * PAGE_SIDE);
    for j in south..(south + PAGE_SIDE).min(rows) {
        for i in west..(west + PAGE_SIDE).min(columns) {
            let n = ((j - south) * PAGE_SIDE + i - west) as usize;
            let (z, void) = below(i, j)?;
            samples[n] = z;
            voids[n / 64] |= u64::from(void) << (n % 64);
        }
    }
    let any = voids.iter().any(|&w| w != 0);
    Ok(HeightPage::of_maxima(Samples::narrowest(samples), any.then_some(voids)))
}

impl<H: HeightField + ?Sized> Posts<'_, H> {
    /// The greatest height over blocks that cover the posts of these columns and rows, all in the grid, and perhaps
    /// some around; `None` where the field does not know it.
    #[inline]
    pub fn greatest(&mut self, i: RangeInclusive<u32>, j: RangeInclusive<u32>) -> Result<Option<Greatest>, ReadError> {
        let ((west, east), (south, north)) = (i.into_inner(), j.into_inner());
        let (level, shift) = scale((east - west).max(north - south));
        let [west, east, south, north] = [west, east, south, north].map(|v| v >> (PAGE_SHIFT * level));
        if (west ^ east | south ^ north) >> PAGE_SHIFT == 0 {
            let id = PageId { pi: west >> PAGE_SHIFT, pj: south >> PAGE_SHIFT };
            let Some(page) = self.page_of_level(level, id)? else { return Ok(None) };
            let blocks = [west, east, south, north].map(|v| (v % PAGE_SIDE) >> shift);
            return Ok(Some(over(page, shift, blocks)));
        }
        let mut all = Greatest::NOTHING;
        for pj in south >> PAGE_SHIFT..=north >> PAGE_SHIFT {
            for pi in west >> PAGE_SHIFT..=east >> PAGE_SHIFT {
                let Some(page) = self.page_of_level(level, PageId { pi, pj })? else { return Ok(None) };
                let (w, s) = (pi * PAGE_SIDE, pj * PAGE_SIDE);
                let last = PAGE_SIDE - 1;
                let blocks = [west.max(w) - w, east.min(w + last) - w, south.max(s) - s, north.min(s + last) - s];
                all = all.join(over(page, shift, blocks.map(|v| v >> shift)));
            }
        }
        Ok(Some(all))
    }
}

/// The greatest of the blocks of a page in columns and rows `[west, east, south, north]`.
#[inline]
fn over(page: &HeightPage, shift: u32, [west, east, south, north]: [u32; 4]) -> Greatest {
    let mut all = Greatest::NOTHING;
    let maxima = page.maxima();
    for j in south..north + 1 {
        for i in west..east + 1 {
            all = all.join(if shift == 0 {
                let post = page.at(i, j);
                Greatest { z: not_below(post.z), void: post.void }
            } else {
                maxima.block(shift, i, j)
            });
        }
    }
    all
}

/// The level of pages and the shift of blocks in them with which a stretch of posts is covered by two or three blocks.
#[inline]
fn scale(posts_less_one: u32) -> (u32, u32) {
    // A stretch of 2^n + 1 to 2^(n + 1) posts less one takes two or three blocks of 2^n.
    let fit = (u32::BITS - posts_less_one.leading_zeros()).saturating_sub(1).max(FINEST_OF_HEIGHTS);
    (fit / PAGE_SHIFT, fit % PAGE_SHIFT)
}
