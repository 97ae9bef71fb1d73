//! The tight thickness of a diamond: the greatest deviation of a post of the grid from its triangles.
//!
//! **Small diamonds** ([`scan`], and [`super::abreast`] inside the grid): all posts, row by row. A triangle's closed area is
//! cut out of the grid by bounds on i, j, i - j and i + j, because its edges run along these directions only.
//!
//! **Large diamonds** ([`search`]): few posts. Below a triangle T lie the triangles T' that descend from it. Over T' the
//! finest surface strays from the plane of T by at most what it strays from the plane of T', which is no more than the
//! tight thickness of the diamond of T', plus the distance of the two planes, which is linear over T' and so greatest
//! at one of its corners. The corners are posts that the search has met. So it descends from T, keeps the greatest
//! deviation of a post so far, and leaves out T' where that bound is no greater. What it finds is the true maximum,
//! since all that is left out is no greater. Scanning would visit every post once for each level; the search visits some
//! dozens of posts a diamond, whatever its size.

use rayon::prelude::*;
use sightline_proto::diamond::{Post, Triangle};

use super::{
    band::{Band, Heights},
    round_up,
};
use crate::terrain::{Grid, HeightField, PageId, ReadError, Samples};

/// Whether f64 arithmetic makes no rounding error in deviations on this field's heights.
///
/// Let all heights be multiples of 2^l and below 2^(h+1) in magnitude, and the root exponent m. The slopes of a plane
/// are differences over a power of two up to 2^m (or half of one more, against the base's midpoint), so its height over
/// any post is a multiple of 2^(l-m-1), and so are the sums before they are halved. None exceeds four times the
/// greatest height. With h + 4 - (l - m - 1) at most 53, each is an f64.
pub(super) fn arithmetic_is_exact<H: HeightField + ?Sized>(field: &H) -> Result<bool, ReadError> {
    let (columns, rows) = field.grid().pages();
    let page = |n: u64| PageId { pi: (n % u64::from(columns)) as u32, pj: (n / u64::from(columns)) as u32 };
    let spans = (0..u64::from(columns) * u64::from(rows))
        .into_par_iter()
        .map(|n| Ok(exponents(field.page(page(n))?.samples())))
        .try_reduce(|| (i32::MAX, i32::MIN), |a, b| Ok((a.0.min(b.0), a.1.max(b.1))))?;
    Ok(spans_are_exact(field.grid(), spans))
}

/// The same of heights that are integers of 16 bits (`wide` says: of 32).
pub(super) fn integers_are_exact(grid: Grid, wide: bool) -> bool {
    spans_are_exact(grid, if wide { I32_EXPONENTS } else { I16_EXPONENTS })
}

fn spans_are_exact(grid: Grid, (low, high): (i32, i32)) -> bool {
    let exponent = i32::from(grid.root().exponent());
    // Far from the ends of the range of f64, so that nothing under- or overflows.
    low > high || (high - low + exponent + 5 <= 53 && low > -900 && high < 900)
}

/// Exponents of the lowest and of the highest bit that integers may have.
const I16_EXPONENTS: (i32, i32) = (0, 15);
const I32_EXPONENTS: (i32, i32) = (0, 31);

/// Exponents of the lowest and of the highest bit that any sample has; (MAX, MIN) when all are zero.
fn exponents(samples: &Samples) -> (i32, i32) {
    match samples {
        Samples::I16(_) => I16_EXPONENTS,
        Samples::I32(_) => I32_EXPONENTS,
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

/// Half a unit in the last place of 1.
const EPSILON: f64 = 0.5 * f64::EPSILON;

/// The tight thickness of the diamond at `p`, no corner, by visiting all its posts; rounded up.
///
/// `exact` is what [`arithmetic_is_exact`] says of the field.
pub(super) fn scan(band: &Band, exact: bool, p: Post) -> f32 {
    let mut found = Found::default();
    for triangle in band.grid().root().triangles(p) {
        let z = [triangle.apex, triangle.e0, triangle.e1].map(|corner| band.height(corner));
        found.meet(z);
        found.greatest = scan_rows(band, &Span::of(&triangle), &Plane::through(&triangle, z), found.greatest);
    }
    found.bound(exact)
}

/// The tight thickness of the diamond at `p`, no corner, by leaving out what cannot matter; rounded up.
///
/// `finer` tells that of a diamond below it that is not of the finest two levels.
pub(super) fn search(
    grid: Grid,
    heights: &mut impl Heights,
    finer: &mut impl FnMut(Post) -> Result<f32, ReadError>,
    exact: bool,
    p: Post,
) -> Result<f32, ReadError> {
    let mut search = Search { grid, heights, finer, found: Found::default() };
    for triangle in grid.root().triangles(p) {
        let mut z = [0.0; 3];
        for (z, corner) in z.iter_mut().zip([triangle.apex, triangle.e0, triangle.e1]) {
            *z = search.heights.z(corner)?;
        }
        search.found.meet(z);
        search.descend(&triangle, z, [0.0; 3])?;
    }
    Ok(search.found.bound(exact))
}

/// What was found of a diamond.
struct Found {
    /// The greatest deviation of a post of the grid; -1 before the first.
    greatest: f64,
    /// The greatest height of a corner in magnitude.
    magnitude: f64,
}

impl Default for Found {
    fn default() -> Self {
        Self { greatest: -1.0, magnitude: 0.0 }
    }
}

impl Found {
    fn meet<const N: usize>(&mut self, corners: [f64; N]) {
        self.magnitude = corners.into_iter().fold(self.magnitude, |most, z| most.max(z.abs()));
    }

    /// What is sure of the greatest deviation.
    ///
    /// With e = 2^-53 and Z the greatest height of a corner in magnitude. A scanned plane: its slopes are off by at
    /// most 2eZ and 4eZ over the triangle, their products with offsets (at most 2Z each) by 2eZ more, and the four sums
    /// (at most 7Z) by 7eZ each: less than 64eZ together. A searched one: each halved sum is off by eZ more than what it
    /// is made from, over at most 62 levels. A deviation rounds by e of itself, and so does a bound that leaves a
    /// triangle out, and this correction.
    fn bound(&self, exact: bool) -> f32 {
        let Self { greatest, magnitude } = *self;
        round_up(if exact || greatest < 0.0 {
            greatest.max(0.0)
        } else if magnitude < 1e300 {
            (greatest + magnitude * (96.0 * EPSILON)) * (1.0 + 8.0 * EPSILON) + 64.0 * f64::from_bits(1)
        } else {
            f64::INFINITY
        })
    }
}

struct Search<'a, Z, F> {
    grid: Grid,
    heights: &'a mut Z,
    finer: &'a mut F,
    found: Found,
}

impl<Z: Heights, F: FnMut(Post) -> Result<f32, ReadError>> Search<'_, Z, F> {
    /// Searches what lies below `t`. Of its apex, e0 and e1: the height of the plane there, and how far the surface
    /// strays from it.
    fn descend(&mut self, t: &Triangle, plane: [f64; 3], strays: [f64; 3]) -> Result<(), ReadError> {
        let Some(m) = t.base_midpoint() else { return Ok(()) };
        let middle = 0.5 * plane[1] + 0.5 * plane[2];
        let stray = (self.heights.z(m)? - middle).abs();
        if stray > self.found.greatest && self.grid.contains(m) {
            self.found.greatest = stray;
        }
        if (m.i ^ m.j) & 1 == 1 {
            return Ok(());
        }
        let [near, far] = t.children(m);
        let sides = [
            (near, [middle, plane[0], plane[1]], [stray, strays[0], strays[1]]),
            (far, [middle, plane[2], plane[0]], [stray, strays[2], strays[0]]),
        ];
        let bounds = [self.bound(&near, sides[0].2)?, self.bound(&far, sides[1].2)?];
        let order = if bounds[1] > bounds[0] { [1, 0] } else { [0, 1] };
        for n in order {
            if bounds[n] > self.found.greatest {
                let (child, plane, strays) = &sides[n];
                self.descend(child, *plane, *strays)?;
            }
        }
        Ok(())
    }

    /// No post of the grid below `t` strays further, except its corners; -1 where there is none.
    fn bound(&mut self, t: &Triangle, strays: [f64; 3]) -> Result<f64, ReadError> {
        let corners = [t.apex, t.e0, t.e1];
        let Some(m) = t.base_midpoint() else { return Ok(-1.0) };
        if corners.iter().all(|p| p.i >= self.grid.nx()) || corners.iter().all(|p| p.j >= self.grid.ny()) {
            return Ok(-1.0);
        }
        if (m.i | m.j) % 2 == 1 {
            return Ok(f64::INFINITY);
        }
        Ok(strays[0].max(strays[1]).max(strays[2]) + f64::from((self.finer)(m)?))
    }
}

/// The greatest of `greatest` and the distances of the grid's posts in `span` from the plane.
fn scan_rows(band: &Band, span: &Span, plane: &Plane, mut greatest: f64) -> f64 {
    let last = band.grid().clamp(Post::new(u32::MAX, u32::MAX));
    for j in span.j.0..=span.j.1.min(i64::from(last.j)) {
        let low = span.i.0.max(span.d.0 + j).max(span.s.0 - j);
        let high = span.i.1.min(span.d.1 + j).min(span.s.1 - j).min(i64::from(last.i));
        if low <= high {
            let heights = &band.row(j as u32)[low as usize..=high as usize];
            let start = plane.z + plane.north * (j - plane.j) as f64 + plane.east * (low - plane.i) as f64;
            for (n, z) in heights.iter().enumerate() {
                let stray = (z - (start + plane.east * n as f64)).abs();
                greatest = if stray > greatest { stray } else { greatest };
            }
        }
    }
    greatest
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
