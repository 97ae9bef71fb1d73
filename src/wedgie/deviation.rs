//! The tight thickness of every stored diamond: one pass over the grid, block by block.
//!
//! A block is 64 by 64 cells with its border. For each half-length b = 2^k the square cells of side 2b that meet the
//! block are visited. Each has the two triangles of the square diamond at its centre and one triangle of each of the
//! four tilted diamonds on its sides:
//!
//! ```text
//!   ┌───────┐   ┌───────┐
//!   │ \     │   │ \   / │    A triangle's closed area is cut out of the block by bounds on i, j, i - j and i + j,
//!   │   \   │   │  >c<  │    because its edges run along these directions only.
//!   │     \ │   │ /   \ │
//!   └───────┘   └───────┘
//! ```
//!
//! Each block adds what it sees of a triangle to its diamond by an atomic maximum; a maximum does not depend on order,
//! so neither does the result. Every level reads every post once: O(N log N) in all.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;
use sightline_proto::diamond::{Post, Triangle};

use super::round_up;
use crate::terrain::{Grid, HeightField, PAGE_SIDE, PageId, Posts, ReadError, Samples};

/// Cells along the side of a block, at most.
const BLOCK_CELLS: u32 = 64;
/// Posts along the side of a block, borders included.
const BLOCK_POSTS: usize = BLOCK_CELLS as usize + 1;

/// f32 maxima of all posts of one lattice (step 2^k), as bits: for floats that are not negative, bits order as values.
pub(super) struct Maxima {
    columns: u32,
    rows: u32,
    bits: Vec<AtomicU32>,
}

impl Maxima {
    pub(super) fn new(columns: u32, rows: u32) -> Self {
        let posts = columns as usize * rows as usize;
        Self { columns, rows, bits: (0..posts).map(|_| AtomicU32::new(0)).collect() }
    }

    /// Raises the value at column `a` and row `b` of the lattice, if it is stored, to `value`.
    pub(super) fn raise(&self, a: u32, b: u32, value: f32) {
        if a < self.columns && b < self.rows && value > 0.0 {
            let cell = &self.bits[b as usize * self.columns as usize + a as usize];
            if cell.load(Ordering::Relaxed) < value.to_bits() {
                cell.fetch_max(value.to_bits(), Ordering::Relaxed);
            }
        }
    }

    pub(super) fn get(&self, a: u32, b: u32) -> f32 {
        f32::from_bits(self.bits[b as usize * self.columns as usize + a as usize].load(Ordering::Relaxed))
    }
}

/// Raises `tight[k - 1]`, for each stored lattice of step 2^k, to the deviations of its diamonds.
///
/// `progress` is told, from any thread, how many posts more are done.
pub(super) fn measure<H: HeightField + ?Sized>(
    field: &H,
    tight: &[Maxima],
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(), ReadError> {
    let grid = field.grid();
    let cells = BLOCK_CELLS.min(grid.root().side());
    let exact = arithmetic_is_exact(field)?;
    // A block that begins on the last column of the grid touches it, and so may its diamonds.
    let blocks = |posts: u32| ((posts - 1) / cells + 1).min(grid.root().side() / cells);
    let (columns, rows) = (blocks(grid.nx()), blocks(grid.ny()));
    (0..u64::from(columns) * u64::from(rows)).into_par_iter().try_for_each_init(
        || (Posts::new(field), vec![0.0; BLOCK_POSTS * BLOCK_POSTS]),
        |(posts, z), n| {
            let (x0, y0) = ((n % u64::from(columns)) as u32 * cells, (n / u64::from(columns)) as u32 * cells);
            Block::load(posts, z, x0, y0, cells, exact)?.measure(posts, tight)?;
            let within = |start: u32, posts: u32| u64::from(posts.saturating_sub(start).min(cells));
            progress(within(x0, grid.nx()) * within(y0, grid.ny()));
            Ok(())
        },
    )
}

/// Whether f64 arithmetic makes no rounding error in [`Block::deviation`] on this field's heights.
///
/// Let all heights be multiples of 2^l and below 2^(h+1) in magnitude, and the root exponent m. Slopes are differences
/// divided by powers of two up to 2^m (the apex against the base's midpoint: one more), offsets are integers: so every
/// intermediate value is a multiple of 2^(l-m-1). None exceeds seven times the greatest height. With h + 4 - (l - m -
/// 1) at most 53, each is an f64.
fn arithmetic_is_exact<H: HeightField + ?Sized>(field: &H) -> Result<bool, ReadError> {
    let (columns, rows) = field.grid().pages();
    let page = |n: u64| PageId { pi: (n % u64::from(columns)) as u32, pj: (n / u64::from(columns)) as u32 };
    let spans = (0..u64::from(columns) * u64::from(rows))
        .into_par_iter()
        .map(|n| Ok(exponents(field.page(page(n))?.samples())))
        .try_reduce(|| (i32::MAX, i32::MIN), |a, b| Ok((a.0.min(b.0), a.1.max(b.1))))?;
    let (low, high) = spans;
    let exponent = i32::from(field.grid().root().exponent());
    // Far from the ends of the range of f64, so that nothing under- or overflows.
    Ok(low > high || (high - low + exponent + 5 <= 53 && low > -900 && high < 900))
}

/// Exponents of the lowest and of the highest bit that any sample has; (MAX, MIN) when all are zero.
fn exponents(samples: &Samples) -> (i32, i32) {
    match samples {
        Samples::I16(_) => (0, 15),
        Samples::I32(_) => (0, 31),
        Samples::F64(heights) => heights.iter().filter(|&&z| z != 0.0).fold((i32::MAX, i32::MIN), |(low, high), z| {
            let biased = (z.to_bits() >> 52 & 0x7ff) as i32;
            let mantissa = z.to_bits() & ((1 << 52) - 1);
            let (lowest, highest) = match (biased, mantissa) {
                (0, m) => (-1074 + m.trailing_zeros() as i32, -1023),
                (e, 0) => (e - 1023, e - 1023),
                (e, m) => (e - 1075 + m.trailing_zeros() as i32, e - 1023),
            };
            (low.min(lowest), high.max(highest))
        }),
    }
}

/// A square piece of the grid with clamped heights, and how much of it is grid.
struct Block<'a> {
    grid: Grid,
    x0: u32,
    y0: u32,
    cells: u32,
    /// Last column and row of the block that belong to the grid, as posts.
    last: Post,
    exact: bool,
    z: &'a [f64],
}

impl<'a> Block<'a> {
    fn load<H: HeightField + ?Sized>(
        posts: &mut Posts<'_, H>,
        z: &'a mut [f64],
        x0: u32,
        y0: u32,
        cells: u32,
        exact: bool,
    ) -> Result<Self, ReadError> {
        let grid = posts.grid();
        for j in 0..=cells {
            let row = &mut z[j as usize * BLOCK_POSTS..][..=cells as usize];
            let mut i = 0;
            while i <= cells {
                // A run of posts of the row that lie on one page, or one padding post.
                let p = grid.clamp(Post::new(x0 + i, y0 + j));
                let run = (PAGE_SIDE - p.i % PAGE_SIDE).min(grid.nx() - p.i).min(cells + 1 - i);
                let page = posts.page(PageId::of(p))?;
                for n in 0..run {
                    row[(i + n) as usize] = page.at(p.i % PAGE_SIDE + n, p.j % PAGE_SIDE).z;
                }
                i += run;
            }
        }
        let last = grid.clamp(Post::new(x0 + cells, y0 + cells));
        Ok(Self { grid, x0, y0, cells, last, exact, z })
    }

    fn measure<H: HeightField + ?Sized>(&self, posts: &mut Posts<'_, H>, tight: &[Maxima]) -> Result<(), ReadError> {
        for (k, maxima) in (1_u32..).zip(tight) {
            let side = 2 << k;
            if side <= self.cells {
                for y in (self.y0..self.y0 + self.cells).step_by(side as usize).take_while(|&y| y <= self.last.j) {
                    for x in (self.x0..self.x0 + self.cells).step_by(side as usize).take_while(|&x| x <= self.last.i) {
                        self.cell(k, x, y, |p| Ok(self.at(p)), maxima)?;
                    }
                }
            } else {
                self.cell(k, self.x0 / side * side, self.y0 / side * side, |p| Ok(posts.at(p)?.z), maxima)?;
            }
        }
        Ok(())
    }

    fn at(&self, p: Post) -> f64 {
        self.z[(p.j - self.y0) as usize * BLOCK_POSTS + (p.i - self.x0) as usize]
    }

    /// Adds what the block sees of the six triangles of the cell of side 2^(k+1) whose south-west corner is (x, y).
    fn cell(
        &self,
        k: u32,
        x: u32,
        y: u32,
        mut height: impl FnMut(Post) -> Result<f64, ReadError>,
        maxima: &Maxima,
    ) -> Result<(), ReadError> {
        let b = 1 << k;
        let centre = Post::new(x + b, y + b);
        let root = self.grid.root();
        let inside =
            |t: &Triangle| t.corners().iter().all(|p| p.i.abs_diff(centre.i) <= b && p.j.abs_diff(centre.j) <= b);
        for p in std::iter::once(centre).chain(root.children(centre)) {
            for triangle in root.triangles(p).filter(inside) {
                let mut z = [0.0; 3];
                for (slot, corner) in z.iter_mut().zip([triangle.apex, triangle.e0, triangle.e1]) {
                    *slot = height(corner)?;
                }
                maxima.raise(p.i >> k, p.j >> k, round_up(self.deviation(&triangle, z)));
            }
        }
        Ok(())
    }

    /// The greatest deviation, or a bound on it, of the block's grid posts from the plane over the closed triangle
    /// with heights `z` of apex, e0 and e1.
    ///
    /// With e = 2^-53 and Z the greatest height in magnitude: the slopes are off by at most 2eZ and 4eZ over the
    /// triangle, their products with offsets (at most 2Z each) by 2eZ more, and the four sums (at most 7Z) by 7eZ
    /// each: less than 64eZ together. The final subtraction and this correction round by 4e of the result.
    fn deviation(&self, t: &Triangle, z: [f64; 3]) -> f64 {
        let plane = Plane::through(t, z);
        let greatest = self.scan(&Span::of(t), &plane);
        let magnitude = z[0].abs().max(z[1].abs()).max(z[2].abs());
        if self.exact || greatest < 0.0 {
            greatest.max(0.0)
        } else if magnitude < 1e300 {
            (greatest + magnitude * (64.0 * EPSILON)) * (1.0 + 8.0 * EPSILON) + 64.0 * f64::from_bits(1)
        } else {
            f64::INFINITY
        }
    }

    /// The greatest distance from the plane over the part of the block in `span`, or -1 when there is none.
    fn scan(&self, span: &Span, plane: &Plane) -> f64 {
        let mut greatest = -1.0;
        let rows = i64::from(self.y0).max(span.j.0)..=i64::from(self.last.j).min(span.j.1);
        for j in rows {
            let low = span.i.0.max(span.d.0 + j).max(span.s.0 - j).max(i64::from(self.x0));
            let high = span.i.1.min(span.d.1 + j).min(span.s.1 - j).min(i64::from(self.last.i));
            if low > high {
                continue;
            }
            let row = (j - i64::from(self.y0)) as usize * BLOCK_POSTS;
            let heights =
                &self.z[row + (low - i64::from(self.x0)) as usize..=row + (high - i64::from(self.x0)) as usize];
            let start = plane.z + plane.north * (j - plane.j) as f64 + plane.east * (low - plane.i) as f64;
            greatest = run_deviation(heights, start, plane.east, greatest);
        }
        greatest
    }
}

/// Half a unit in the last place of 1.
const EPSILON: f64 = 0.5 * f64::EPSILON;

/// The greatest of `greatest` and |heights[n] - (start + n * step)|, in four lanes that the compiler can keep abreast.
fn run_deviation(heights: &[f64], start: f64, step: f64, greatest: f64) -> f64 {
    let mut lanes = [greatest; 4];
    let mut offset = [0.0, 1.0, 2.0, 3.0];
    let chunks = heights.chunks_exact(4);
    let rest = chunks.remainder();
    for chunk in chunks {
        for lane in 0..4 {
            let d = (chunk[lane] - (start + step * offset[lane])).abs();
            lanes[lane] = if d > lanes[lane] { d } else { lanes[lane] };
            offset[lane] += 4.0;
        }
    }
    for (lane, z) in rest.iter().enumerate() {
        let d = (z - (start + step * offset[lane])).abs();
        lanes[lane] = if d > lanes[lane] { d } else { lanes[lane] };
    }
    lanes.into_iter().fold(greatest, f64::max)
}

/// Closed ranges of i, j, i - j and i + j: a bintree triangle is where all four hold.
struct Span {
    i: (i64, i64),
    j: (i64, i64),
    d: (i64, i64),
    s: (i64, i64),
}

impl Span {
    fn of(t: &Triangle) -> Self {
        let corners = t.corners().map(|p| (i64::from(p.i), i64::from(p.j)));
        let range = |f: fn((i64, i64)) -> i64| {
            let [a, b, c] = corners.map(f);
            (a.min(b).min(c), a.max(b).max(c))
        };
        Self { i: range(|p| p.0), j: range(|p| p.1), d: range(|p| p.0 - p.1), s: range(|p| p.0 + p.1) }
    }
}

/// A plane by its height at a post and its slopes per post.
struct Plane {
    i: i64,
    j: i64,
    z: f64,
    east: f64,
    north: f64,
}

impl Plane {
    /// Through the corners of `t` with heights `z` of apex, e0 and e1. All divisors are powers of two.
    fn through(t: &Triangle, z: [f64; 3]) -> Self {
        let [a, e0, e1] = [t.apex, t.e0, t.e1].map(|p| (i64::from(p.i), i64::from(p.j)));
        let slope = |rise: f64, run: i64| rise / run as f64;
        let middle = 0.5 * z[1] + 0.5 * z[2];
        let (east, north) = if e0.1 == e1.1 {
            (slope(z[2] - z[1], e1.0 - e0.0), slope(z[0] - middle, a.1 - e0.1))
        } else if e0.0 == e1.0 {
            (slope(z[0] - middle, a.0 - e0.0), slope(z[2] - z[1], e1.1 - e0.1))
        } else if e0.1 == a.1 {
            (slope(z[1] - z[0], e0.0 - a.0), slope(z[2] - z[0], e1.1 - a.1))
        } else {
            (slope(z[2] - z[0], e1.0 - a.0), slope(z[1] - z[0], e0.1 - a.1))
        };
        Self { i: a.0, j: a.1, z: z[0], east, north }
    }
}
