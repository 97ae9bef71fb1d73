//! What a terrain is like: its heights, and how far it strays from the triangles of each level of the hierarchy.
//!
//! Everything is counted over the posts of the grid. Heights are those of known posts, and their sums are whole numbers,
//! so nothing depends on threads. Deviations are the *tight* thicknesses of the diamonds at those posts, voids as they
//! are drawn; quantiles of them come from counts by the first five bits behind the leading one, rounded up, so that
//! they are never too small and at most a 32nd too large.

use rayon::prelude::*;
use sightline_proto::diamond::Post;

use super::Database;
use crate::{
    terrain::{Grid, HeightField, PAGE_SIDE, PageId, ReadError},
    wedgie::ErrorBounds,
};

/// Bands of a histogram of heights.
pub const HEIGHT_BANDS: usize = 16;
/// Shares of the known posts below quantiles of heights, in percent.
pub const HEIGHT_PERCENTS: [u32; 7] = [1, 5, 25, 50, 75, 95, 99];
/// Shares of the diamonds below quantiles of deviations, in percent.
pub const DEVIATION_PERCENTS: [u32; 3] = [50, 95, 99];

/// Heights are counted apart as long as there are no more of them: with 16 bits, each.
const HEIGHT_COUNTS: usize = 1 << 16;
/// Bits of a deviation, behind the leading one, by which it is counted.
const FRACTION_BITS: u32 = 5;
/// Deviations are f32 that are not negative: 8 bits of exponent.
const DEVIATION_COUNTS: usize = 1 << (8 + FRACTION_BITS);
/// Rows of pages that are looked at side by side.
const ROWS_AT_ONCE: u32 = 16;

/// What a terrain is like.
#[derive(Clone, PartialEq, Debug)]
pub struct Statistics {
    /// Its heights.
    pub heights: HeightStatistics,
    /// The levels of the hierarchy, coarsest first. Those of an even number have square diamonds.
    pub levels: Vec<LevelStatistics>,
}

/// The heights of the posts that are not void, in height units.
#[derive(Clone, PartialEq, Debug)]
pub struct HeightStatistics {
    /// Posts that are not void.
    pub known_posts: u64,
    /// Pages, of 64 by 64 posts.
    pub pages: u64,
    /// Pages with some void posts.
    pub pages_with_voids: u64,
    /// Pages with nothing but void posts.
    pub void_pages: u64,
    /// The mean.
    pub mean: f64,
    /// The root mean square distance from the mean.
    pub standard_deviation: f64,
    /// For each of [`HEIGHT_PERCENTS`] the least height that so many posts do not exceed; where the heights have more than
    /// 2^16 values up to a 2^16th of their range more.
    pub quantiles: [i64; HEIGHT_PERCENTS.len()],
    /// Posts in each of [`HEIGHT_BANDS`] bands of equal width from the least height to the greatest.
    pub bands: [u64; HEIGHT_BANDS],
}

/// How far the finest surface strays from the triangles of one level.
#[derive(Clone, PartialEq, Debug)]
pub struct LevelStatistics {
    /// The number of the level, from 0 with the centre of the root square.
    pub level: u32,
    /// From the middle of a diamond to its sides (square diamonds) or corners (tilted ones), in posts.
    pub half_length: u32,
    /// Diamonds at posts of the grid.
    pub diamonds: u64,
    /// Those of them from which the surface does not stray.
    pub flat: u64,
    /// The mean deviation, in height units.
    pub mean: f64,
    /// For each of [`DEVIATION_PERCENTS`] a deviation that so many diamonds do not exceed, in height units.
    pub quantiles: [f32; DEVIATION_PERCENTS.len()],
    /// The greatest deviation, in height units.
    pub greatest: f32,
}

/// Looks at every post and every bound of a database, on the threads of the current pool. `progress` is told, from any
/// thread, how many posts more were looked at.
pub fn statistics(database: &Database, progress: &(dyn Fn(u64) + Sync)) -> Result<Statistics, ReadError> {
    let grid = database.grid();
    let rows = grid.pages().1;
    let mut all = Counts::new(database);
    for first in (0..rows).step_by(ROWS_AT_ONCE as usize) {
        let rows = (first..rows.min(first + ROWS_AT_ONCE)).into_par_iter();
        let made: Vec<_> = rows.map(|pj| Counts::of_row(database, pj, progress)).collect::<Result<_, ReadError>>()?;
        // In the order of rows, since sums of deviations are rounded.
        made.iter().for_each(|row| all.add(row));
    }
    Ok(all.statistics(grid))
}

/// What is counted of some rows of pages.
struct Counts {
    lowest: i64,
    /// Heights that are counted together, and heights of a band.
    step: u64,
    span: u64,
    heights: Vec<u64>,
    bands: [u64; HEIGHT_BANDS],
    known_posts: u64,
    sum: i128,
    squares: u128,
    pages: u64,
    pages_with_voids: u64,
    void_pages: u64,
    levels: Vec<LevelCounts>,
}

#[derive(Clone)]
struct LevelCounts {
    diamonds: u64,
    flat: u64,
    sum: f64,
    greatest: f32,
    /// By the first bits; allocated when there is something to count.
    counts: Vec<u64>,
}

impl Counts {
    fn new(database: &Database) -> Self {
        let (lowest, highest) = database.height_range();
        let span = (i64::from(highest) - i64::from(lowest)) as u64 + 1;
        let step = span.div_ceil(HEIGHT_COUNTS as u64);
        let nothing = LevelCounts { diamonds: 0, flat: 0, sum: 0.0, greatest: 0.0, counts: Vec::new() };
        let levels = 2 * usize::from(HeightField::grid(database).root().exponent());
        Self {
            lowest: lowest.into(),
            step,
            span,
            heights: vec![0; span.div_ceil(step) as usize],
            bands: [0; HEIGHT_BANDS],
            known_posts: 0,
            sum: 0,
            squares: 0,
            pages: 0,
            pages_with_voids: 0,
            void_pages: 0,
            levels: vec![nothing; levels],
        }
    }

    fn of_row(database: &Database, pj: u32, progress: &(dyn Fn(u64) + Sync)) -> Result<Self, ReadError> {
        let mut row = Self::new(database);
        for id in (0..database.grid().pages().0).map(|pi| PageId { pi, pj }) {
            row.count_heights(database, id)?;
            row.count_deviations(database, id)?;
            let (w, h) = database.grid().page_size(id);
            progress(u64::from(w) * u64::from(h));
        }
        Ok(row)
    }

    fn count_heights(&mut self, database: &Database, id: PageId) -> Result<(), ReadError> {
        let (page, (w, h)) = (database.page(id)?, database.grid().page_size(id));
        let before = self.known_posts;
        for (j, i) in (0..h).flat_map(|j| (0..w).map(move |i| (j, i))) {
            let post = page.at(i, j);
            // Heights beyond the range that the manifest states are damage, which `verify` tells; nothing is counted for them.
            let z = post.z as i64;
            let above = u64::try_from(z - self.lowest).ok().filter(|&above| above < self.span && !post.void);
            let Some(above) = above else { continue };
            self.heights[(above / self.step) as usize] += 1;
            self.bands[(u128::from(above) * HEIGHT_BANDS as u128 / u128::from(self.span)) as usize] += 1;
            self.known_posts += 1;
            self.sum += i128::from(z);
            self.squares += u128::from(z.unsigned_abs()) * u128::from(z.unsigned_abs());
        }
        self.pages += 1;
        self.pages_with_voids += u64::from(page.has_voids());
        self.void_pages += u64::from(self.known_posts == before);
        Ok(())
    }

    fn count_deviations(&mut self, database: &Database, id: PageId) -> Result<(), ReadError> {
        let (grid, (w, h)) = (database.grid(), database.grid().page_size(id));
        let (west, south) = (id.pi * PAGE_SIDE, id.pj * PAGE_SIDE);
        for p in (south..south + h).flat_map(|j| (west..west + w).map(move |i| Post::new(i, j))) {
            if let Some(level) = grid.root().level(p) {
                self.levels[usize::from(level)].count(database.bounds(p)?.tight);
            }
        }
        Ok(())
    }

    fn add(&mut self, more: &Self) {
        add_all(&mut self.heights, &more.heights);
        add_all(&mut self.bands, &more.bands);
        self.known_posts += more.known_posts;
        self.sum += more.sum;
        self.squares += more.squares;
        self.pages += more.pages;
        self.pages_with_voids += more.pages_with_voids;
        self.void_pages += more.void_pages;
        self.levels.iter_mut().zip(&more.levels).for_each(|(level, more)| level.add(more));
    }

    fn statistics(&self, grid: Grid) -> Statistics {
        let posts = self.known_posts.max(1) as f64;
        let mean = self.sum as f64 / posts;
        let quantiles = HEIGHT_PERCENTS.map(|percent| {
            let n = nearest_rank(&self.heights, self.known_posts, percent) as u64;
            self.lowest + ((n + 1) * self.step - 1).min(self.span - 1) as i64
        });
        let heights = HeightStatistics {
            known_posts: self.known_posts,
            pages: self.pages,
            pages_with_voids: self.pages_with_voids,
            void_pages: self.void_pages,
            mean,
            standard_deviation: self.variance().sqrt(),
            quantiles,
            bands: self.bands,
        };
        let levels = (0..).zip(&self.levels).map(|(level, counts)| counts.statistics(grid, level)).collect();
        Statistics { heights, levels }
    }

    /// The mean square distance from the mean: (n sum z^2 - (sum z)^2) / n^2, whose upper part is a whole number.
    fn variance(&self) -> f64 {
        let n = u128::from(self.known_posts.max(1));
        let sum = self.sum.unsigned_abs();
        // n < 2^61 and |z| < 2^31, so products may take more than 128 bits; then rounding is all that is lost.
        match (n.checked_mul(self.squares), sum.checked_mul(sum)) {
            (Some(squares), Some(square)) => (squares - square) as f64 / (n as f64 * n as f64),
            _ => (self.squares as f64 / n as f64 - (sum as f64 / n as f64) * (sum as f64 / n as f64)).max(0.0),
        }
    }
}

impl LevelCounts {
    fn count(&mut self, deviation: f32) {
        self.diamonds += 1;
        if deviation == 0.0 {
            self.flat += 1;
            return;
        }
        self.sum += f64::from(deviation);
        self.greatest = self.greatest.max(deviation);
        if self.counts.is_empty() {
            self.counts = vec![0; DEVIATION_COUNTS];
        }
        self.counts[(deviation.to_bits() >> (23 - FRACTION_BITS)) as usize % DEVIATION_COUNTS] += 1;
    }

    fn add(&mut self, more: &Self) {
        self.diamonds += more.diamonds;
        self.flat += more.flat;
        self.sum += more.sum;
        self.greatest = self.greatest.max(more.greatest);
        if self.counts.is_empty() {
            self.counts.clone_from(&more.counts);
        } else {
            add_all(&mut self.counts, &more.counts);
        }
    }

    fn statistics(&self, grid: Grid, level: u32) -> LevelStatistics {
        let strays = self.diamonds - self.flat;
        let quantiles = DEVIATION_PERCENTS.map(|percent| {
            let rank = rank_of(self.diamonds, percent);
            if rank <= self.flat {
                return 0.0;
            }
            let n = place_of(&self.counts, rank - self.flat);
            // The greatest number that is counted there.
            let most = f32::from_bits((((n as u32) + 1) << (23 - FRACTION_BITS)) - 1);
            most.min(self.greatest)
        });
        LevelStatistics {
            level,
            half_length: grid.root().side() >> (level / 2 + 1),
            diamonds: self.diamonds,
            flat: self.flat,
            mean: if strays == 0 { 0.0 } else { self.sum / self.diamonds as f64 },
            quantiles,
            greatest: self.greatest,
        }
    }
}

fn add_all(counts: &mut [u64], more: &[u64]) {
    counts.iter_mut().zip(more).for_each(|(count, more)| *count += more);
}

/// How many of `all` are `percent` of them, rounded up; at least one.
fn rank_of(all: u64, percent: u32) -> u64 {
    ((u128::from(all) * u128::from(percent)).div_ceil(100) as u64).max(1)
}

/// Where the counts from the first on reach `rank`.
fn place_of(counts: &[u64], rank: u64) -> usize {
    let mut sum = 0;
    let reached = counts.iter().position(|count| {
        sum += count;
        sum >= rank
    });
    reached.unwrap_or(counts.len().saturating_sub(1))
}

fn nearest_rank(counts: &[u64], all: u64, percent: u32) -> usize {
    place_of(counts, rank_of(all, percent))
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            OpenOptions,
            tests::{SCALE, terrain, write_to},
        },
        *,
    };
    use crate::{
        terrain::{MemoryField, Posts},
        wedgie::MemoryTerrain,
    };

    fn of(field: &MemoryField, cache_bytes: usize) -> (Database, Statistics) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("it.sldb");
        write_to(&path, field);
        let database = Database::open(&path, OpenOptions { cache_bytes }).unwrap();
        let found = statistics(&database, &|_| ()).unwrap();
        (database, found)
    }

    /// Every figure, from sorted lists of all heights and all bounds.
    #[test]
    fn figures_are_those_of_sorted_lists() {
        for (nx, ny, factor, voids) in [(2, 2, 1, false), (130, 70, 1, true), (65, 200, -70_000, true)] {
            let field = terrain(nx, ny, 3, factor, voids);
            let (database, found) = of(&field, 1 << 20);
            let (grid, mut posts) = (field.grid(), Posts::new(&field));
            let all: Vec<_> = (0..ny).flat_map(|j| (0..nx).map(move |i| Post::new(i, j))).collect();
            let known = all.iter().map(|&p| posts.at(p).unwrap()).filter(|post| !post.void);
            let mut heights: Vec<_> = known.map(|post| post.z as i64).collect();
            heights.sort_unstable();
            let h = &found.heights;
            assert_eq!(h.known_posts, heights.len() as u64);
            assert_eq!(h.known_posts + database.void_posts(), grid.posts());
            let n = heights.len() as f64;
            let mean = heights.iter().sum::<i64>() as f64 / n;
            assert_eq!(h.mean, mean);
            let variance = heights.iter().map(|&z| (z as f64 - mean) * (z as f64 - mean)).sum::<f64>() / n;
            assert!((h.standard_deviation - variance.sqrt()).abs() <= 1e-9 * variance.sqrt());
            let (lowest, highest) = (heights[0], heights[heights.len() - 1]);
            for (percent, found) in HEIGHT_PERCENTS.iter().zip(h.quantiles) {
                let true_one = heights[(heights.len() * *percent as usize).div_ceil(100) - 1];
                let most = true_one + (highest - lowest) / 65_536;
                assert!((true_one..=most).contains(&found), "{percent} %: {found}, {true_one}");
            }
            for (n, found) in h.bands.iter().enumerate() {
                let band = |z: i64| (z - lowest) as usize * HEIGHT_BANDS / (highest - lowest + 1) as usize;
                assert_eq!(*found, heights.iter().filter(|&&z| band(z) == n).count() as u64);
            }
            let bounds = MemoryTerrain::new(field, SCALE).unwrap();
            assert_eq!(found.levels.len(), 2 * usize::from(grid.root().exponent()));
            let mut diamonds = 0;
            for level in &found.levels {
                let of_level = |p: &&Post| grid.root().level(**p).map(u32::from) == Some(level.level);
                let mut deviations: Vec<_> =
                    all.iter().filter(of_level).map(|&p| bounds.bounds(p).unwrap().tight).collect();
                deviations.sort_unstable_by(f32::total_cmp);
                check_level(level, &deviations);
                diamonds += level.diamonds;
            }
            assert_eq!(diamonds, all.iter().filter(|&&p| !grid.root().is_corner(p)).count() as u64);
        }
    }

    fn check_level(level: &LevelStatistics, deviations: &[f32]) {
        assert_eq!(level.diamonds, deviations.len() as u64);
        assert_eq!(level.flat, deviations.iter().filter(|&&d| d == 0.0).count() as u64);
        assert_eq!(level.greatest, deviations.last().copied().unwrap_or_default());
        let sum = deviations.iter().map(|&d| f64::from(d)).sum::<f64>();
        assert!((level.mean * level.diamonds as f64 - sum).abs() <= 1e-12 * sum, "{level:?}");
        for (percent, found) in DEVIATION_PERCENTS.iter().zip(level.quantiles) {
            let rank = (deviations.len() * *percent as usize).div_ceil(100);
            let Some(&true_one) = deviations.get(rank.max(1) - 1) else { continue };
            assert!((true_one..=true_one * (1.0 + 1.0 / 32.0)).contains(&found), "{percent} %: {found}, {true_one}");
        }
    }

    /// Half-lengths halve from the root on, and each diamond is of the level below its parents'.
    #[test]
    fn levels_follow_the_hierarchy() {
        let grid = Grid::new(70, 129).unwrap();
        let root = grid.root();
        for p in (0..=128).flat_map(|j| (0..=128).map(move |i| Post::new(i, j))).filter(|&p| !root.is_corner(p)) {
            for parent in root.parents(p).filter(|&parent| !root.is_corner(parent)) {
                assert_eq!(root.level(p), root.level(parent).map(|level| level + 1), "{p:?}");
            }
        }
        let (_, found) = of(&terrain(70, 129, 1, 1, false), 1 << 20);
        let lengths: Vec<_> = found.levels.iter().map(|level| level.half_length).collect();
        assert_eq!(lengths, [64, 64, 32, 32, 16, 16, 8, 8, 4, 4, 2, 2, 1, 1]);
    }

    /// Neither the cache nor the threads show.
    #[test]
    fn figures_do_not_depend_on_what_is_at_hand() {
        let field = terrain(150, 1100, 5, 1, true);
        let (_, found) = of(&field, 64 << 20);
        assert_eq!(of(&field, 0).1, found);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| of(&field, 1 << 20).1), found);
        assert!(found.heights.pages_with_voids > 0 && found.heights.pages == 3 * 18);
    }
}
