//! Greatest and least heights over square blocks of posts: whoever asks for something high need not read what is low,
//! and who goes far below the ground need not read it at all.
//!
//! ```text
//!   page of heights      64 x 64 posts; within it blocks of 8, 16, 32 and 64 posts a side      (BlockMaxima)
//!   level 1              64 x 64 values a page, each for 16 x 16 posts; blocks of 1 to 32 values a side
//!   level 2              64 x 64 values a page, each for a page of level 1, 1024 x 1024 posts; and so on
//! ```
//!
//! Blocks within a page follow from it and live as long as it does; pages of the levels above come from the field
//! ([`HeightField::extremes`]) like those of heights. So nothing is ever read for bounds but a few bytes for each page
//! near a line. It follows the maximum mipmaps of Tevs, Ihrke and Seidel, "Maximum mipmaps for fast, accurate, and
//! scalable dynamic height field rendering" (2008), cut into pages, with minima added. Values are over the posts of
//! the grid as drawn, void ones included; within a page of heights (what harms nobody) also over a height of 0 where it
//! reaches beyond the grid.

use std::{
    ops::{Range, RangeInclusive},
    sync::Arc,
};

use super::field::{Grid, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, Posts, ReadError, Samples};

/// Binary logarithm of [`PAGE_SIDE`].
const PAGE_SHIFT: u32 = PAGE_SIDE.trailing_zeros();
/// Binary logarithm of the side of the smallest blocks within a page of heights, in posts.
const FINEST_OF_HEIGHTS: u32 = 3;
/// Binary logarithm of [`BLOCK_SIDE`].
const BLOCK_SHIFT: u32 = 4;
/// Posts along the side of the blocks of level 1.
pub const BLOCK_SIDE: u32 = 1 << BLOCK_SHIFT;
/// Where the blocks of 2^n posts (or values) a side begin among all blocks of a page: behind all larger ones.
const FIRST_BLOCK: [usize; PAGE_SHIFT as usize + 1] = [1365, 341, 85, 21, 5, 1, 0];

/// Binary logarithm of the posts along the side of a value's block: 4, 10, 16, ... from level 1 on.
const fn shift_of(level: u32) -> u32 {
    if level == 0 { 0 } else { BLOCK_SHIFT + PAGE_SHIFT * (level - 1) }
}

/// The least and the greatest height of the posts of a block.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Extremes {
    /// The least drawn height.
    pub least: f64,
    /// The greatest.
    pub greatest: f64,
    /// Whether some post is void.
    pub void: bool,
}

impl Extremes {
    /// Of no posts.
    pub const NOTHING: Self = Self { least: f64::INFINITY, greatest: f64::NEG_INFINITY, void: false };

    /// Of the posts of both.
    #[must_use]
    pub fn join(self, other: Self) -> Self {
        Self {
            least: self.least.min(other.least),
            greatest: self.greatest.max(other.greatest),
            void: self.void | other.void,
        }
    }

    /// Of the blocks of [`BLOCK_SIDE`] posts a side in a page that has `size` posts of the grid: row by row from the
    /// south, as many as it takes to cover them.
    pub fn of_blocks(page: &HeightPage, (columns, rows): (u32, u32)) -> impl Iterator<Item = Self> {
        let blocks = move |posts: u32| (0..posts).step_by(BLOCK_SIDE as usize);
        blocks(rows).flat_map(move |south| blocks(columns).map(move |west| (west, south))).map(move |(west, south)| {
            let (east, north) = ((west + BLOCK_SIDE).min(columns), (south + BLOCK_SIDE).min(rows));
            let (least, greatest) = match page.samples() {
                Samples::I16(samples) => range(&samples[..], west..east, south..north),
                Samples::I32(samples) => range(&samples[..], west..east, south..north),
                Samples::F64(samples) => range(&samples[..], west..east, south..north),
            };
            let is_void = |i: u32, j: u32| page.voids().is_some_and(|rows| rows[j as usize] >> i & 1 == 1);
            let void = page.has_voids() && (south..north).any(|j| (west..east).any(|i| is_void(i, j)));
            Self { least, greatest, void }
        })
    }
}

/// The least and the greatest of a page's samples in some columns and rows.
fn range<S: Copy + PartialOrd + Into<f64>>(samples: &[S], columns: Range<u32>, rows: Range<u32>) -> (f64, f64) {
    let at = |i: u32, j: u32| (j * PAGE_SIDE + i) as usize;
    let first = samples[at(columns.start, rows.start)];
    let (mut least, mut greatest) = (first, first);
    for j in rows {
        for &z in &samples[at(columns.start, j)..at(columns.end, j)] {
            least = if z < least { z } else { least };
            greatest = if z > greatest { z } else { greatest };
        }
    }
    (least.into(), greatest.into())
}

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

/// Greatest heights of the blocks of one page, of heights or of a level above.
#[derive(Clone, Debug)]
struct Pyramid {
    /// From the largest blocks to the smallest, each size row by row from the south.
    z: Box<[f32]>,
    /// The same for whether there are voids; empty where the page has none.
    void: Box<[bool]>,
}

impl Pyramid {
    /// From the blocks of 2^`finest` a side, which are the last of `z` and `void`.
    fn complete(mut z: Vec<f32>, mut void: Vec<bool>, finest: u32) -> Self {
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
        Self { z: z.into(), void: void.into() }
    }

    /// The block of 2^`shift` a side in column `i` and row `j`.
    #[inline]
    fn block(&self, shift: u32, i: u32, j: u32) -> Greatest {
        let n = FIRST_BLOCK[shift as usize] + (j << (PAGE_SHIFT - shift)) as usize + i as usize;
        Greatest { z: self.z[n], void: self.void.get(n).copied().unwrap_or(false) }
    }

    /// The greatest of the blocks in columns and rows `[west, east, south, north]`.
    #[inline]
    fn over(&self, shift: u32, [west, east, south, north]: [u32; 4]) -> Greatest {
        let mut all = Greatest::NOTHING;
        for j in south..north + 1 {
            for i in west..east + 1 {
                all = all.join(self.block(shift, i, j));
            }
        }
        all
    }
}

/// The maxima of the blocks of a page of heights.
#[derive(Clone, Debug)]
pub struct BlockMaxima {
    blocks: Pyramid,
    /// The greatest magnitude of a sample.
    magnitude: f64,
}

impl BlockMaxima {
    pub(super) fn of_heights(samples: &Samples, voids: Option<&[u64; PAGE_POSTS / 64]>) -> Self {
        const FINEST: u32 = FINEST_OF_HEIGHTS;
        let first = FIRST_BLOCK[FINEST as usize];
        let mut z = vec![f32::NEG_INFINITY; FIRST_BLOCK[FINEST as usize - 1]];
        let (least, greatest) = match samples {
            Samples::I16(s) => fill(&**s, FINEST, &mut z[first..]),
            Samples::I32(s) => fill(&**s, FINEST, &mut z[first..]),
            Samples::F64(s) => fill(&**s, FINEST, &mut z[first..]),
        };
        let mut void = vec![false; if voids.is_some() { z.len() } else { 0 }];
        for n in voids.into_iter().flat_map(|v| (0..PAGE_POSTS).filter(|n| v[n / 64] >> (n % 64) & 1 == 1)) {
            let (i, j) = ((n % 64) >> FINEST, (n / 64) >> FINEST);
            void[first + (j << (PAGE_SHIFT - FINEST)) + i] = true;
        }
        Self { blocks: Pyramid::complete(z, void, FINEST), magnitude: least.abs().max(greatest.abs()) }
    }

    /// The greatest magnitude of a sample.
    pub fn magnitude(&self) -> f64 {
        self.magnitude
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

/// A page of a level: least and greatest heights of 64 x 64 blocks of posts.
#[derive(Clone, Debug)]
pub struct ExtremesPage {
    /// No post of the block is drawn lower, and all are known: negative infinity where one is void or there is none.
    least: Box<[f32]>,
    greatest: Pyramid,
    all: Extremes,
}

impl ExtremesPage {
    /// A page of these values, row by row from the south; [`Extremes::NOTHING`] beyond the grid.
    pub fn new(values: &[Extremes; PAGE_POSTS]) -> Self {
        let mut z = vec![f32::NEG_INFINITY; FIRST_BLOCK[0] + PAGE_POSTS];
        let any_void = values.iter().any(|v| v.void);
        let mut void = vec![false; if any_void { z.len() } else { 0 }];
        let mut least = vec![f32::NEG_INFINITY; PAGE_POSTS];
        for (n, value) in values.iter().enumerate() {
            z[FIRST_BLOCK[0] + n] =
                if value.greatest == f64::NEG_INFINITY { f32::NEG_INFINITY } else { not_below(value.greatest) };
            if any_void {
                void[FIRST_BLOCK[0] + n] = value.void;
            }
            if !value.void && value.least < f64::INFINITY {
                least[n] = -not_below(-value.least);
            }
        }
        let all = values.iter().fold(Extremes::NOTHING, |all, &value| all.join(value));
        Self { least: least.into(), greatest: Pyramid::complete(z, void, 0), all }
    }

    /// Of all its blocks together: the value of the level above.
    pub fn all(&self) -> Extremes {
        self.all
    }

    /// Bytes that it keeps in memory, about.
    pub fn weight(&self) -> usize {
        size_of_val(&*self.least) + size_of_val(&*self.greatest.z) + self.greatest.void.len() + 128
    }
}

/// Columns and rows of the values of a level; level 0 are the posts themselves.
pub fn extent(grid: Grid, level: u32) -> (u32, u32) {
    let values = |posts: u32| (((u64::from(posts) - 1) >> shift_of(level)) + 1) as u32;
    (values(grid.nx()), values(grid.ny()))
}

/// Whether there is a level: when the level below has more than one page.
fn is_needed(grid: Grid, level: u32) -> bool {
    let below = level.checked_sub(1).map(|below| extent(grid, below));
    below.is_some_and(|(columns, rows)| columns > PAGE_SIDE || rows > PAGE_SIDE)
}

/// The number of levels above the posts.
pub fn levels(grid: Grid) -> u32 {
    (1..).take_while(|&level| is_needed(grid, level)).count() as u32
}

/// The pages of a level from west to east and from south to north; `None` for level 0 and for levels that there are
/// not.
pub fn pages(grid: Grid, level: u32) -> Option<(u32, u32)> {
    let (columns, rows) = extent(grid, level);
    is_needed(grid, level).then(|| (columns.div_ceil(PAGE_SIDE), rows.div_ceil(PAGE_SIDE)))
}

/// The values of a level, row by row from the south.
pub type Values = Vec<Extremes>;

/// The values of all levels from 1, from the grid's pages of heights.
pub fn extremes_of<P: AsRef<HeightPage>>(
    grid: Grid,
    mut heights: impl FnMut(PageId) -> Result<P, ReadError>,
) -> Result<Vec<Values>, ReadError> {
    let mut all: Vec<Values> = Vec::new();
    for level in 1..levels(grid) + 1 {
        let (columns, rows) = extent(grid, level);
        let mut values = vec![Extremes::NOTHING; columns as usize * rows as usize];
        let at = |i: u32, j: u32| j as usize * columns as usize + i as usize;
        if let Some(below) = all.last() {
            let (below_columns, _) = extent(grid, level - 1);
            for (n, &value) in below.iter().enumerate() {
                let (i, j) = (n as u32 % below_columns, n as u32 / below_columns);
                let of = &mut values[at(i / PAGE_SIDE, j / PAGE_SIDE)];
                *of = of.join(value);
            }
        } else {
            let (page_columns, page_rows) = grid.pages();
            for id in (0..page_rows).flat_map(|pj| (0..page_columns).map(move |pi| PageId { pi, pj })) {
                let size = grid.page_size(id);
                let blocks = PAGE_SIDE / BLOCK_SIDE;
                for (n, value) in (0..).zip(Extremes::of_blocks(heights(id)?.as_ref(), size)) {
                    let across = size.0.div_ceil(BLOCK_SIDE);
                    values[at(id.pi * blocks + n % across, id.pj * blocks + n / across)] = value;
                }
            }
        }
        all.push(values);
    }
    Ok(all)
}

/// The rows of page `id` of a level with these values in `columns`.
fn rows_of_page(values: &[Extremes], columns: u32, id: PageId) -> impl Iterator<Item = &[Extremes]> {
    let west = (id.pi * PAGE_SIDE) as usize;
    let rows = values.chunks_exact(columns as usize).skip((id.pj * PAGE_SIDE) as usize).take(PAGE_SIDE as usize);
    rows.map(move |row| &row[west..(west + PAGE_SIDE as usize).min(row.len())])
}

/// The values in page `id` of a level with these values in `columns`, row by row from the south.
pub fn of_page(values: &[Extremes], columns: u32, id: PageId) -> impl Iterator<Item = &Extremes> {
    rows_of_page(values, columns, id).flatten()
}

impl<H: HeightField + ?Sized> Posts<'_, H> {
    /// The greatest height over blocks that cover the posts of these columns and rows, all in the grid, and perhaps
    /// some around; `None` where the field does not know it.
    #[inline]
    pub fn greatest(&mut self, i: RangeInclusive<u32>, j: RangeInclusive<u32>) -> Result<Option<Greatest>, ReadError> {
        let posts = [*i.start(), *i.end(), *j.start(), *j.end()];
        // A stretch of 2^n + 1 to 2^(n + 1) posts less one takes two or three blocks of 2^n.
        let less_one = (posts[1] - posts[0]).max(posts[3] - posts[2]);
        let fit = (u32::BITS - less_one.leading_zeros()).saturating_sub(1).max(FINEST_OF_HEIGHTS);
        let level = if fit < BLOCK_SHIFT { 0 } else { (fit - BLOCK_SHIFT) / PAGE_SHIFT + 1 };
        let found = self.over_blocks(posts, level, fit - shift_of(level))?;
        // Fields that keep no levels have pages.
        if found.is_none() && fit <= PAGE_SHIFT { self.over_blocks(posts, 0, fit) } else { Ok(found) }
    }

    fn over_blocks(&mut self, posts: [u32; 4], level: u32, shift: u32) -> Result<Option<Greatest>, ReadError> {
        let [west, east, south, north] = posts.map(|v| v >> shift_of(level));
        if (west ^ east | south ^ north) >> PAGE_SHIFT == 0 {
            let id = PageId { pi: west >> PAGE_SHIFT, pj: south >> PAGE_SHIFT };
            let blocks = [west, east, south, north].map(|v| (v % PAGE_SIDE) >> shift);
            return Ok(self.pyramid(level, id)?.map(|pyramid| pyramid.over(shift, blocks)));
        }
        let mut all = Greatest::NOTHING;
        for pj in south >> PAGE_SHIFT..=north >> PAGE_SHIFT {
            for pi in west >> PAGE_SHIFT..=east >> PAGE_SHIFT {
                let Some(pyramid) = self.pyramid(level, PageId { pi, pj })? else { return Ok(None) };
                let (w, s) = (pi * PAGE_SIDE, pj * PAGE_SIDE);
                let last = PAGE_SIDE - 1;
                let blocks = [west.max(w) - w, east.min(w + last) - w, south.max(s) - s, north.min(s + last) - s];
                all = all.join(pyramid.over(shift, blocks.map(|v| v >> shift)));
            }
        }
        Ok(Some(all))
    }

    #[inline]
    fn pyramid(&mut self, level: u32, id: PageId) -> Result<Option<&Pyramid>, ReadError> {
        if level == 0 {
            return Ok(Some(&self.page(id)?.maxima().blocks));
        }
        Ok(self.extremes(level, id)?.map(|page| &page.greatest))
    }

    /// Of the block of level 1 that holds a post of the grid: a height that all its posts are known not to be below, and
    /// one that none is above; `None` where the field keeps none.
    #[inline]
    pub fn block_around(&mut self, i: u32, j: u32) -> Result<Option<(f32, f32)>, ReadError> {
        let (i, j) = (i >> BLOCK_SHIFT, j >> BLOCK_SHIFT);
        let page = self.extremes(1, PageId { pi: i >> PAGE_SHIFT, pj: j >> PAGE_SHIFT })?;
        let n = (j % PAGE_SIDE * PAGE_SIDE + i % PAGE_SIDE) as usize;
        Ok(page.map(|page| (page.least[n], page.greatest.z[FIRST_BLOCK[0] + n])))
    }
}

/// All pages of all levels from 1, each level row by row from the south.
pub(super) fn all_pages(grid: Grid, levels: &[Values]) -> Vec<Vec<Arc<ExtremesPage>>> {
    let page = |values: &Values, columns: u32, id: PageId| {
        let mut of_page = [Extremes::NOTHING; PAGE_POSTS];
        for (to, from) in of_page.chunks_exact_mut(PAGE_SIDE as usize).zip(rows_of_page(values, columns, id)) {
            to[..from.len()].copy_from_slice(from);
        }
        Arc::new(ExtremesPage::new(&of_page))
    };
    let of_level = |(level, values): (u32, &Values)| {
        let (columns, rows) = pages(grid, level).unwrap_or_default();
        let ids = (0..rows).flat_map(|pj| (0..columns).map(move |pi| PageId { pi, pj }));
        ids.map(|id| page(values, extent(grid, level).0, id)).collect()
    };
    (1..).zip(levels).map(of_level).collect()
}

#[cfg(test)]
mod tests {
    use sightline_proto::diamond::Post;

    use super::*;
    use crate::terrain::{MemoryField, synthetic};

    /// With and without levels, bounds of any stretch hold, and void posts are never overlooked.
    #[test]
    fn bounds_of_stretches_and_blocks_hold_for_every_post() {
        struct WithoutLevels<'a>(&'a MemoryField);
        impl HeightField for WithoutLevels<'_> {
            fn grid(&self) -> Grid {
                self.0.grid()
            }
            fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
                self.0.page(id)
            }
        }
        let (nx, ny) = (1100, 90);
        let field = MemoryField::from_fn(nx, ny, |i, j| {
            let void = synthetic::mix(u64::from(i / 9) << 32 | u64::from(j / 4)).is_multiple_of(300);
            (!void).then(|| f64::from(synthetic::fractal_height(i, j, 5, 900)) * 0.1 - 40.0)
        })
        .unwrap();
        let bare = WithoutLevels(&field);
        let (mut posts, mut kept, mut bare) = (Posts::new(&field), Posts::new(&field), Posts::new(&bare));
        let mut unknown = 0;
        for n in 0..400_u64 {
            let random = |k: u64, below: u32| (synthetic::mix(n * 4 + k) % u64::from(below)) as u32;
            let size = [3, 20, 60, 1100][n as usize % 4];
            let (west, south) = (random(0, nx), random(1, ny));
            let (east, north) = ((west + random(2, size)).min(nx - 1), (south + random(3, size)).min(ny - 1));
            let mut all = Extremes::NOTHING;
            for (i, j) in (south..=north).flat_map(|j| (west..=east).map(move |i| (i, j))) {
                let post = posts.at(Post::new(i, j)).unwrap();
                all = all.join(Extremes { least: post.z, greatest: post.z, void: post.void });
            }
            let from_levels = kept.greatest(west..=east, south..=north).unwrap().unwrap();
            for found in [Some(from_levels), bare.greatest(west..=east, south..=north).unwrap()].into_iter().flatten() {
                assert!(f64::from(found.z) >= all.greatest && found.void >= all.void, "{west} {east} {south} {north}");
            }
            let (least, greatest) = kept.block_around(west, south).unwrap().unwrap();
            let post = posts.at(Post::new(west, south)).unwrap();
            assert!(f64::from(greatest) >= post.z);
            assert!(if post.void { least == f32::NEG_INFINITY } else { f64::from(least) <= post.z });
            unknown += usize::from(post.void);
        }
        assert!(unknown > 0);
        assert_eq!((levels(field.grid()), levels(Grid::new(64, 64).unwrap())), (2, 0));
        assert_eq!(bare.block_around(5, 5).unwrap(), None);
    }
}
