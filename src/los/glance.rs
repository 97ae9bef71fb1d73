//! A glance at a short line: all its crossings and both ends in one pass over a window of at most 2 x 2 pages, by
//! rounded clearances and bounds of their errors. What it says is certain; where it cannot say, the ladder does.
//!
//! Coordinates are taken relative to the window, which is exact: a multiple of [`PAGE_SIDE`] not above x, subtracted
//! from x, leaves a multiple of x's last bit that is not above x. So the functions g of the four families
//! ([`super::sweep`]) are below 256 in magnitude, e = 2^-45 bounds the error of each, and the errors derived there are
//!
//! error(q) = |Q| (2^-43 / |D| + 10 u) + 2 u max(|qA|, |qB|) + 2^-1016 (1 + |D|).
//!
//! The lines of a family strictly between the ends follow from the floors of the rounded g: rounding keeps order, so a
//! whole number is on the same side of g and of its rounded value unless it equals that; then g must be exact. All
//! faces that the line meets have their posts in the window, and there is room of [`MARGIN`] around it, so a rounded
//! coordinate that is off by less leads to a post of the window too.
//!
//! The same pass is the F64 and the FAST rung: without bounds, the second in f32 throughout.

use sightline_proto::predicates::FLUSHED;

use super::{
    real::{Real, floor},
    sweep::{ROUNDOFF, TRUSTED_MAGNITUDE},
};
use crate::terrain::{
    Block, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, Posts, ReadError, Samples, Stored,
};

/// What a glance tells.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Glance {
    /// The line is strictly above known ground from end to end.
    Clear,
    /// Some of it is strictly below known ground.
    Blocked,
    /// Something is in doubt, void, or too far apart.
    Unsure,
}

/// Room around a line, in cells, for the errors of rounded coordinates; those of f32 are less than 2^-12.
const MARGIN: f64 = 1.0 / 64.0;
/// The least |g(B) - g(A)| of a family that is crossed: the error of v is then below 2^-15.
const LEAST_REACH: f64 = 1.0 / (1 << 20) as f64;
/// 4 e, as above.
const G_ERROR: f64 = 1.0 / (1_u64 << 43) as f64;
/// Greater than any coordinate in a window.
const WINDOW: f64 = 2.0 * PAGE_SIDE as f64;

/// A sample as a number.
trait Sample: Copy {
    fn real<R: Real>(self) -> R;
}

impl Sample for i16 {
    #[inline]
    fn real<R: Real>(self) -> R {
        R::of_whole(self.into())
    }
}

impl Sample for i32 {
    #[inline]
    fn real<R: Real>(self) -> R {
        R::of_whole(self)
    }
}

impl Sample for f64 {
    #[inline]
    fn real<R: Real>(self) -> R {
        R::of(self)
    }
}

/// Heights of a window, by j times [`Heights::STRIDE`] plus i.
trait Heights {
    const STRIDE: i32;
    fn at<R: Real>(&self, n: i32) -> R;
}

/// A page.
struct One<'p, S>(&'p [S; PAGE_POSTS]);

impl<S: Sample> Heights for One<'_, S> {
    const STRIDE: i32 = PAGE_SIDE as i32;

    #[inline]
    fn at<R: Real>(&self, n: i32) -> R {
        self.0[n as usize % PAGE_POSTS].real()
    }
}

/// Pages south-west, south-east, north-west and north-east; the same one again where the window has fewer.
struct Four<'p, S>([&'p [S; PAGE_POSTS]; 4]);

impl<S: Sample> Heights for Four<'_, S> {
    const STRIDE: i32 = 2 * PAGE_SIDE as i32;

    #[inline]
    fn at<R: Real>(&self, n: i32) -> R {
        let n = n as usize;
        let side = PAGE_SIDE as usize;
        let (i, j) = (n % (2 * side), n / (2 * side));
        self.0[j / side % 2 * 2 + i / side][j % side * side + i % side].real()
    }
}

/// Looks at AB. Takes rounded clearances at their word unless `SURE`.
#[inline]
pub(super) fn glance<R, H, const SURE: bool>(
    posts: &mut Posts<'_, H>,
    a: [f64; 3],
    b: [f64; 3],
) -> Result<Glance, ReadError>
where
    R: Real,
    H: HeightField + ?Sized,
{
    let grid = posts.grid();
    let last = [grid.nx(), grid.ny()].map(|posts| f64::from(posts - 1) - MARGIN);
    // Not so for NaN.
    let has_room = |end: [f64; 3]| {
        let [x, y] = [0, 1].map(|k: usize| end[k] >= MARGIN && end[k] < last[k]);
        x && y && end[2].abs() <= TRUSTED_MAGNITUDE
    };
    if !(has_room(a) && has_room(b)) {
        return Ok(Glance::Unsure);
    }
    let [west, south] = [0, 1].map(|k: usize| a[k].min(b[k]) - MARGIN);
    let [east, north] = [0, 1].map(|k: usize| a[k].max(b[k]) + MARGIN);
    let first = PageId { pi: west as u32 / PAGE_SIDE, pj: south as u32 / PAGE_SIDE };
    let last = PageId { pi: (east as u32 + 1) / PAGE_SIDE, pj: (north as u32 + 1) / PAGE_SIDE };
    let (wide, high) = (last.pi - first.pi, last.pj - first.pj);
    if (wide | high) > 1 {
        return Ok(Glance::Unsure);
    }
    let corner = [f64::from(first.pi * PAGE_SIDE), f64::from(first.pj * PAGE_SIDE), 0.0];
    let [a, b] = [a, b].map(|end| [end[0] - corner[0], end[1] - corner[1], end[2]]);
    if wide | high == 0 {
        let page = posts.page(first)?;
        return Ok(if page.has_voids() { Glance::Unsure } else { over_page::<R, SURE>(page, a, b) });
    }
    let pages = posts.window(first, last)?;
    if pages.iter().any(|page| page.has_voids()) {
        return Ok(Glance::Unsure);
    }
    Ok(over_pages::<R, SURE>(pages, a, b))
}

#[inline]
fn over_page<R: Real, const SURE: bool>(page: &HeightPage, a: [f64; 3], b: [f64; 3]) -> Glance {
    match page.samples() {
        Samples::I16(s) => decide::<R, _, SURE>(&One(s), a, b, I16_MAGNITUDE),
        Samples::I32(s) => decide::<R, _, SURE>(&One(s), a, b, I32_MAGNITUDE),
        Samples::F64(s) => match page.maxima().magnitude() {
            magnitude @ ..=MOST_MAGNITUDE => decide::<R, _, SURE>(&One(s), a, b, magnitude),
            _ => Glance::Unsure,
        },
    }
}

/// The greatest magnitudes of samples.
const I16_MAGNITUDE: f64 = 32_768.0;
const I32_MAGNITUDE: f64 = 2_147_483_648.0;
/// Beyond it differences of heights might overflow, in f32.
const MOST_MAGNITUDE: f64 = 1e30;

fn over_pages<R: Real, const SURE: bool>(pages: [&HeightPage; 4], a: [f64; 3], b: [f64; 3]) -> Glance {
    fn four<'p, S: Stored>(blocks: [&'p Block<S>; 4]) -> Four<'p, S> {
        Four(blocks.map(|block| &**block))
    }
    match pages.map(HeightPage::samples) {
        [Samples::I16(sw), Samples::I16(se), Samples::I16(nw), Samples::I16(ne)] => {
            decide::<R, _, SURE>(&four([sw, se, nw, ne]), a, b, I16_MAGNITUDE)
        }
        [Samples::I32(sw), Samples::I32(se), Samples::I32(nw), Samples::I32(ne)] => {
            decide::<R, _, SURE>(&four([sw, se, nw, ne]), a, b, I32_MAGNITUDE)
        }
        [Samples::F64(sw), Samples::F64(se), Samples::F64(nw), Samples::F64(ne)] => {
            match pages.iter().fold(0.0_f64, |m, page| m.max(page.maxima().magnitude())) {
                magnitude @ ..=MOST_MAGNITUDE => decide::<R, _, SURE>(&four([sw, se, nw, ne]), a, b, magnitude),
                _ => Glance::Unsure,
            }
        }
        _ => Glance::Unsure,
    }
}

/// AB's crossings with one family.
struct Crossings<R> {
    /// The family's function at A and B, and the two numbers of which each is the sum (for diagonals).
    ends: [R; 2],
    sums: [[R; 2]; 2],
    /// Coordinate along a line at A, and how much it grows to B.
    v: R,
    dv: R,
    /// Distance between lines, a power of two.
    spacing: i32,
    /// What a line, and a step along one, add to the number of a post.
    per_line: i32,
    per_post: i32,
}

/// The height of AB at A, its growth to B, and the greatest magnitude of a height on AB.
#[derive(Clone, Copy)]
struct Rise<R> {
    z: R,
    dz: R,
    size: f64,
}

#[inline]
fn decide<R: Real, T: Heights, const SURE: bool>(heights: &T, a: [f64; 3], b: [f64; 3], magnitude: f64) -> Glance {
    let ([ax, ay, az], [bx, by, bz]) = (a.map(R::of), b.map(R::of));
    let (dx, dy) = (bx - ax, by - ay);
    let rise = Rise { z: az, dz: bz - az, size: a[2].abs().max(b[2].abs()) };
    let (stride, none) = (T::STRIDE, [[ax; 2]; 2]);
    let column = Crossings { ends: [ax, bx], sums: none, v: ay, dv: dy, spacing: 1, per_line: 1, per_post: stride };
    let row = Crossings { ends: [ay, by], sums: none, v: ax, dv: dx, spacing: 1, per_line: stride, per_post: 1 };
    let rising = Crossings {
        ends: [ax - ay, bx - by],
        sums: [[ax, R::ZERO - ay], [bx, R::ZERO - by]],
        spacing: 2,
        per_line: -stride,
        per_post: stride + 1,
        ..row
    };
    let falling =
        Crossings { ends: [ax + ay, bx + by], sums: [[ax, ay], [bx, by]], spacing: 2, per_post: 1 - stride, ..row };
    let meet = |crossings| cross::<R, T, SURE>(heights, crossings, rise, magnitude);
    // Those with most lines first.
    let met =
        if dx.abs() > dy.abs() { meet(&column).or_else(|| meet(&row)) } else { meet(&row).or_else(|| meet(&column)) };
    if let Some(found) = met.or_else(|| meet(&rising)).or_else(|| meet(&falling)) {
        return found;
    }
    let above = |x, y, z| is_above::<R, T, SURE>(heights, [x, y, z], magnitude);
    if above(ax, ay, az) && above(bx, by, bz) { Glance::Clear } else { Glance::Unsure }
}

/// `None` when AB is strictly above the ground at all crossings.
#[inline]
fn cross<R: Real, T: Heights, const SURE: bool>(
    heights: &T,
    crossings: &Crossings<R>,
    rise: Rise<R>,
    magnitude: f64,
) -> Option<Glance> {
    let ([from, to], spacing) = (crossings.ends, crossings.spacing);
    let forward = to > from;
    let ((low, low_whole), (high, high_whole)) =
        if forward { (floor(from), floor(to)) } else { (floor(to), floor(from)) };
    if SURE && spacing > 1 && (low_whole || high_whole) && !crossings.sums.iter().all(is_exact_sum) {
        return Some(Glance::Unsure);
    }
    let first = (low & -spacing) + spacing;
    let last = (high - i32::from(high_whole)) & -spacing;
    if first > last {
        return None;
    }
    let reach = to - from;
    let per = R::ONE / reach;
    let (v_slope, z_slope) = (crossings.dv * per, rise.dz * per);
    let Bounds { clearance: bound, inner } = if SURE {
        match Bounds::new(crossings, rise, [reach, per], magnitude) {
            Some(bounds) => bounds,
            None => return Some(Glance::Unsure),
        }
    } else {
        Bounds { clearance: R::ZERO, inner: R::ONE }
    };
    let (mut c, end, step) = if forward { (first, last, spacing) } else { (last, first, -spacing) };
    loop {
        let along = R::of_whole(c) - from;
        let (v, z) = (crossings.v + along * v_slope, rise.z + along * z_slope);
        // v rounded down, except that a whole v may become the number below: then the fraction is 1.
        let shifted = (v - R::HALF) + R::WHOLE;
        let fraction = v - (shifted - R::WHOLE);
        let n = c * crossings.per_line + shifted.low_bits() * crossings.per_post;
        let (p, q): (R, R) = (heights.at(n), heights.at(n + crossings.per_post));
        let clearance = z - (p + fraction * (q - p));
        let is_inside = !SURE || (fraction - R::HALF).abs() < inner;
        if !(clearance > bound && is_inside) {
            let below = is_inside && clearance < R::ZERO - bound;
            return Some(if below { Glance::Blocked } else { Glance::Unsure });
        }
        if c == end {
            return None;
        }
        c += step;
    }
}

/// What a family's rounded crossings are certain to.
struct Bounds<R> {
    /// Of the error of a clearance.
    clearance: R,
    /// A fraction that is less than this away from 1/2 is strictly between 0 and 1.
    inner: R,
}

impl<R: Real> Bounds<R> {
    /// `None` where AB is so short across the family's lines that errors are no longer small. The interpolated height
    /// costs 2 m error(v) + 16 u m, m being the greatest magnitude of a sample, as in [`super::run`].
    #[inline]
    fn new(crossings: &Crossings<R>, rise: Rise<R>, [reach, per]: [R; 2], magnitude: f64) -> Option<Self> {
        if reach.abs() < R::of(LEAST_REACH) {
            return None;
        }
        let relative = R::of(G_ERROR) * per.abs() + R::of(10.0 * ROUNDOFF);
        let v_error = crossings.dv.abs() * relative + R::of(2.0 * ROUNDOFF * WINDOW + UNDERFLOW);
        let z_error = rise.dz.abs() * relative + R::of(2.0 * ROUNDOFF * rise.size + UNDERFLOW);
        let ground = (v_error + v_error + R::of(16.0 * ROUNDOFF)) * R::of(magnitude);
        Some(Self { clearance: z_error + ground, inner: R::HALF - v_error - R::of(2.0 * ROUNDOFF) })
    }
}

/// 2^-1016 (1 + |D|) for any |D| in a window, and more.
const UNDERFLOW: f64 = FLUSHED * 8.0 * WINDOW;

/// Whether the sum of two numbers is not rounded (Knuth's two-sum).
#[inline]
fn is_exact_sum<R: Real>(&[x, y]: &[R; 2]) -> bool {
    let sum = x + y;
    let of_y = sum - x;
    (x - (sum - of_y)) + (y - of_y) == R::ZERO
}

/// Whether an end is strictly above the ground.
///
/// Cells whose diagonal falls are mirrored east for west, so that it rises. Rounding the mirrored fraction may put a
/// point on the other side of the diagonal, where the ground is off by less than 4 u m for that, and by 16 u m for five
/// roundings of numbers up to 4 m; the mirrored fraction's own error u adds 2 u m.
#[inline]
fn is_above<R: Real, T: Heights, const SURE: bool>(heights: &T, [x, y, z]: [R; 3], magnitude: f64) -> bool {
    let ((i, _), (j, _)) = (floor(x), floor(y));
    let (u, v) = (x - R::of_whole(i), y - R::of_whole(j));
    let n = j * T::STRIDE + i;
    let (u, n, step) = if (i + j) & 1 == 0 { (u, n, 1) } else { (R::ONE - u, n + 1, -1) };
    let (most, least, middle) = if u > v { (u, v, n + step) } else { (v, u, n + T::STRIDE) };
    let (from, middle, to): (R, R, R) = (heights.at(n), heights.at(middle), heights.at(n + step + T::STRIDE));
    let ground = from + most * (middle - from) + least * (to - middle);
    let bound = if SURE {
        R::of(32.0 * ROUNDOFF * magnitude) + R::of(4.0 * ROUNDOFF) * z.abs() + R::of(UNDERFLOW)
    } else {
        R::ZERO
    };
    // Not so for NaN.
    z - ground > bound
}
