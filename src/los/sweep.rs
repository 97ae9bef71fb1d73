//! The crossings of a line with one of the four families of parallel edge lines, in rounded numbers with known errors.
//!
//! ```text
//!   column  x = c          row  y = c          rising  x - y = c, c even     falling  x + y = c, c even
//!   posts (c, v)           posts (v, c)        posts (v, v - c)              posts (v, c - v)
//! ```
//!
//! Every edge of the finest triangulation is a unit step of v on one line of one family, and every such step is an
//! edge. So instead of walking from cell to cell, AB is intersected with each family by itself: lines of a family
//! follow each other at equal distances, and nothing is carried from one crossing to the next.
//!
//! **Errors.** Let g be the family's function (x, y, x - y or x + y), q the coordinate v or the height z. Exactly,
//! q(c) = qA + (c - gA) (qB - qA) / (gB - gA), where t = (c - gA) / (gB - gA) is in [0, 1]. Let u = 2^-53, and let e
//! bound the error of the rounded gA and gB (0 for columns and rows; u |g| for the diagonals). With N = c - gA,
//! D = gB - gA, Q = qB - qA, the rounded c - gA is (N + e1)(1 + d1) with |e1| <= e, the rounded D is
//! (D + e2)(1 + d2) with |e2| <= 2 e, and (N + e1)/(D + e2) differs from N/D by at most (e + 2 e t)/|D + e2|
//! <= 3 e / |D + e2|. Six roundings lie on the way to the product (N, D, Q, the reciprocal of D, Q times that, and N
//! times that), so where 3 e <= |D|/8 it is off by at most |Q| (4 e/|D| + 8 u), and the last sum adds at most
//! 1.01 u (max(|qA|, |qB|) + that). Therefore
//!
//! error(q) = |Q| (4 e/|D| + 10 u) + 2 u max(|qA|, |qB|) + 2^-1016 (1 + |D|),
//!
//! the last term for all underflow, subnormal numbers that a host has flushed to zero included (e then has another
//! 2^-1016): the slope may lose 2^-1022, which is multiplied by at most 2 |D|, and each operand as much; where the
//! reciprocal itself would be subnormal, |D| is beyond [`TRUSTED_MAGNITUDE`]. All terms
//! are at least a tenth larger than needed, which pays for the rounding of the bound itself. Where numbers are so large
//! that something might overflow, or the errors are no longer small beside a cell, the family is not [`Sweep::trusted`]
//! and each crossing is decided exactly.

use num_rational::BigRational;
use num_traits::Zero;
use sightline_proto::{
    diamond::Post,
    predicates::{FLUSHED, Sign, compare},
};

use super::surface::{rational, two_sum};
use crate::terrain::Grid;

/// The unit roundoff of f64.
pub(super) const ROUNDOFF: f64 = f64::EPSILON / 2.0;
/// Numbers below it, but for zero, have differences, or errors of sums, that may be subnormal.
pub(super) const TINY: f64 = 1e-270;
/// Beyond this magnitude rounded crossings are not trusted: products of two such numbers would overflow.
pub(super) const TRUSTED_MAGNITUDE: f64 = 1e150;

/// The least |g(B) - g(A)| with which [`Sweep::over_grid`] does: 24 times the greatest error of g on any grid.
const SHORTEST_REACH: f64 = 24.0 / (1_u64 << 22) as f64;

/// The error of v or z of a crossing, as derived above; `per` is 1 / `reach`.
#[inline]
fn error(from: f64, to: f64, g_error: f64, reach: f64, per: f64) -> f64 {
    (to - from).abs() * (4.0 * g_error * per.abs() + 10.0 * ROUNDOFF)
        + 2.0 * ROUNDOFF * from.abs().max(to.abs())
        + FLUSHED * (1.0 + reach.abs())
}

/// The greatest multiple of 1 or 2 that is not above `g`, which is less than 2^52 in magnitude.
#[inline]
fn multiple_below(g: f64, spacing: i64) -> i64 {
    let whole = g as i64;
    (whole - i64::from(whole as f64 > g)) & !(spacing - 1)
}

/// A family of parallel lines that carry edges.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Family {
    Column,
    Row,
    Rising,
    Falling,
}

impl Family {
    pub(super) const ALL: [Self; 4] = [Self::Column, Self::Row, Self::Rising, Self::Falling];
    /// The same for lines that cross more rows than columns.
    pub(super) const ROWS_FIRST: [Self; 4] = [Self::Row, Self::Column, Self::Rising, Self::Falling];

    /// The function that is constant on each line, as a rounded value and its exact error.
    pub(super) fn function(self, [x, y]: [f64; 2]) -> (f64, f64) {
        match self {
            Self::Column => (x, 0.0),
            Self::Row => (y, 0.0),
            Self::Rising => two_sum(x, -y),
            Self::Falling => two_sum(x, y),
        }
    }

    /// On which side of line `c` a point lies: the sign of its function less c. Exact: rounding keeps order, so the
    /// rounded value decides unless it equals c, and then its error does.
    fn side(self, c: i64, p: [f64; 2]) -> Sign {
        let (value, error) = self.function(p);
        let c = c as f64;
        match compare(value, c) {
            Sign::Zero if is_tiny(p) => compare_exactly(&self.exact_function(p), &rational(c)),
            Sign::Zero => Sign::of(error),
            sign => sign,
        }
    }

    /// The function without rounding.
    fn exact_function(self, p: [f64; 2]) -> BigRational {
        let [x, y] = p.map(rational);
        match self {
            Self::Column => x,
            Self::Row => y,
            Self::Rising => x - y,
            Self::Falling => x + y,
        }
    }

    /// The coordinate that grows by 1 from post to post along a line: y on columns, x elsewhere.
    fn along(self, [x, y]: [f64; 2]) -> f64 {
        if self == Self::Column { y } else { x }
    }

    /// The sign by which growth of v turns to the left of a line on which the function grows.
    pub(super) fn turn(self) -> Sign {
        match self {
            Self::Column | Self::Rising => Sign::Positive,
            Self::Row | Self::Falling => Sign::Negative,
        }
    }

    /// Distance between lines.
    fn spacing(self) -> i64 {
        match self {
            Self::Column | Self::Row => 1,
            Self::Rising | Self::Falling => 2,
        }
    }

    /// The least and greatest function value over the grid.
    fn lines(self, grid: Grid) -> (i64, i64) {
        let (east, north) = (i64::from(grid.nx()) - 1, i64::from(grid.ny()) - 1);
        match self {
            Self::Column => (0, east),
            Self::Row => (0, north),
            Self::Rising => (-north, east),
            Self::Falling => (0, east + north),
        }
    }

    /// The first and last v of posts of the grid on line `c`.
    #[inline]
    pub(super) fn posts(self, c: i64, grid: Grid) -> (i64, i64) {
        let (east, north) = (i64::from(grid.nx()) - 1, i64::from(grid.ny()) - 1);
        match self {
            Self::Column => (0, north),
            Self::Row => (0, east),
            Self::Rising => (c.max(0), east.min(north + c)),
            Self::Falling => ((c - north).max(0), east.min(c)),
        }
    }

    /// Post `v` on line `c`, which must be in the grid.
    #[inline]
    pub(super) fn post(self, c: i64, v: i64) -> Post {
        let (i, j) = match self {
            Self::Column => (c, v),
            Self::Row => (v, c),
            Self::Rising => (v, v - c),
            Self::Falling => (v, c - v),
        };
        Post::new(i as u32, j as u32)
    }

    /// What a step of c, and one of v, add to column and row of a post.
    #[inline]
    pub(super) fn layout(self) -> ([i64; 2], [i64; 2]) {
        match self {
            Self::Column => ([1, 0], [0, 1]),
            Self::Row => ([0, 1], [1, 0]),
            Self::Rising => ([0, -1], [1, 1]),
            Self::Falling => ([0, 1], [1, -1]),
        }
    }

    /// Point `v` on line `c`, in the grid or not.
    pub(super) fn point(self, c: i64, v: i64) -> [f64; 2] {
        self.point_at(c, v as f64)
    }

    /// The same between posts. Exact for whole `v`.
    pub(super) fn point_at(self, c: i64, v: f64) -> [f64; 2] {
        let c = c as f64;
        match self {
            Self::Column => [c, v],
            Self::Row => [v, c],
            Self::Rising => [v, v - c],
            Self::Falling => [v, c - v],
        }
    }
}

/// The part of AB over the grid, as a range of its parameter that may be a little too wide.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Span {
    /// All of a line whose ends are over the grid.
    pub(super) const ALL: Self = Self { low: 0.0, high: 1.0 };

    /// `None` when AB is nowhere over the grid.
    pub(super) fn new(grid: Grid, a: [f64; 3], b: [f64; 3]) -> Option<Self> {
        let (mut low, mut high) = (0.0_f64, 1.0_f64);
        for (axis, posts) in [(0, grid.nx()), (1, grid.ny())] {
            let limit = f64::from(posts - 1);
            let (from, to) = (a[axis], b[axis]);
            if from.min(to) > limit || from.max(to) < 0.0 {
                return None;
            }
            // A quotient of two rounded differences is off by at most 3.1 u where it lies in [0, 1]. One that
            // overflowed to NaN changes nothing, since min and max pass over it; to infinity or 0, widens.
            let reach = to - from;
            if reach.is_finite() && reach.abs() > TINY {
                let ends = [-from / reach, (limit - from) / reach];
                low = low.max(ends[0].min(ends[1]) - 8.0 * ROUNDOFF);
                high = high.min(ends[0].max(ends[1]) + 8.0 * ROUNDOFF);
            }
        }
        (low <= high).then_some(Self { low, high })
    }
}

/// AB's crossings with one family, numbered from A to B.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sweep {
    pub(super) family: Family,
    /// The first line crossed, and the step to the next.
    first: i64,
    step: i64,
    /// How many lines are crossed strictly between the ends, within the grid's range of lines.
    pub(super) count: i64,
    /// The sign of side(v + 1) - side(v) seen along AB: normalises orientations against edges of the family.
    pub(super) turn: Sign,
    /// Whether the rounded crossings are within the errors below, and those are small beside a cell.
    pub(super) trusted: bool,
    /// Whether it is trusted and both ends are over the grid.
    pub(super) inside: bool,
    g_a: f64,
    v_a: f64,
    z_a: f64,
    v_slope: f64,
    z_slope: f64,
    /// Bound of the error of [`Crossing::v`].
    pub(super) v_error: f64,
    /// Bound of the error of [`Crossing::z`].
    pub(super) z_error: f64,
    reach: f64,
    /// The parameter of the first crossing, and how many more there are in 1.
    t_first: f64,
    lines_per_t: f64,
    /// Bound of the error of [`Sweep::parameter`].
    pub(super) t_error: f64,
}

/// Where AB crosses line `c` of a family, in rounded numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub(super) c: i64,
    /// Coordinate along the line.
    pub(super) v: f64,
    /// Height of AB.
    pub(super) z: f64,
}

impl Sweep {
    pub(super) fn new(family: Family, grid: Grid, span: Span, a: [f64; 3], b: [f64; 3]) -> Self {
        let [plan_a, plan_b] = [[a[0], a[1]], [b[0], b[1]]];
        let ((g_a, _), (g_b, _)) = (family.function(plan_a), family.function(plan_b));
        let (v_a, v_b, z_a, z_b) = (family.along(plan_a), family.along(plan_b), a[2], b[2]);
        let reach = g_b - g_a;
        let g_error = match family {
            Family::Column | Family::Row => FLUSHED,
            Family::Rising | Family::Falling => ROUNDOFF * g_a.abs().max(g_b.abs()) + FLUSHED,
        };
        let growing = family.side_of_b(plan_a, plan_b);
        let (first, last) = line_range(family, grid, span, plan_a, plan_b);
        let forward = growing == Sign::Positive;
        let spacing = family.spacing();
        let per = 1.0 / reach;
        let (v_error, z_error) = (error(v_a, v_b, g_error, reach, per), error(z_a, z_b, g_error, reach, per));
        let (v_slope, z_slope) = ((v_b - v_a) * per, (z_b - z_a) * per);
        let magnitude = [v_a, v_b, z_a, z_b, g_a, g_b, v_slope, z_slope].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        // Written so that NaN is not trusted.
        let trusted = magnitude <= TRUSTED_MAGNITUDE
            && v_slope.is_finite()
            && z_slope.is_finite()
            && 24.0 * g_error <= reach.abs()
            && per.is_normal()
            && v_error < 0.125;
        let (first, last, step) = if forward { (first, last, spacing) } else { (last, first, -spacing) };
        Self {
            family,
            first,
            step,
            count: if growing == Sign::Zero { 0 } else { ((last - first) / step + 1).max(0) },
            turn: family.turn().times(growing),
            trusted,
            inside: false,
            g_a,
            v_a,
            z_a,
            v_slope,
            z_slope,
            v_error,
            z_error,
            reach,
            t_first: (first as f64 - g_a) / reach,
            lines_per_t: reach / step as f64,
            t_error: if trusted { 4.0 * g_error / reach.abs() + 10.0 * ROUNDOFF } else { f64::INFINITY },
        }
    }

    /// The same sweep as [`Sweep::new`], for less, when both ends are over the grid and no height is beyond
    /// [`TRUSTED_MAGNITUDE`]; `None` where it takes more care.
    ///
    /// The lines strictly between the ends follow from the floors of the rounded g: rounding keeps order, so a multiple
    /// of the spacing is on the same side of g and of its rounded value unless they are equal, and then the error of
    /// the sum tells.
    #[inline]
    pub(super) fn over_grid(family: Family, a: [f64; 3], b: [f64; 3]) -> Option<Self> {
        let [plan_a, plan_b] = [[a[0], a[1]], [b[0], b[1]]];
        let ((g_a, e_a), (g_b, e_b)) = (family.function(plan_a), family.function(plan_b));
        let (v_a, v_b, z_a, z_b) = (family.along(plan_a), family.along(plan_b), a[2], b[2]);
        let reach = g_b - g_a;
        let forward = reach > 0.0;
        let (low, high) = if forward { ((g_a, e_a), (g_b, e_b)) } else { ((g_b, e_b), (g_a, e_a)) };
        let spacing = family.spacing();
        let (below, above) = (multiple_below(low.0, spacing), multiple_below(high.0, spacing));
        let first = below + if below as f64 == low.0 && low.1 < 0.0 { 0 } else { spacing };
        let last = above - if above as f64 == high.0 && high.1 <= 0.0 { spacing } else { 0 };
        let g_error = match family {
            Family::Column | Family::Row => 0.0,
            Family::Rising | Family::Falling => ROUNDOFF * g_a.abs().max(g_b.abs()),
        };
        let per = 1.0 / reach;
        let (v_error, z_error) = (error(v_a, v_b, g_error, reach, per), error(z_a, z_b, g_error, reach, per));
        // Not so for NaN. Then numbers are below 2^32, their quotients by reach below 2^52, heights and slopes as
        // small as trusted ones must be.
        let ordinary = reach.abs() >= SHORTEST_REACH && v_error < 0.125;
        if !ordinary {
            return None;
        }
        let (growing, direction) = if forward { (Sign::Positive, 1.0) } else { (Sign::Negative, -1.0) };
        let (first, last, step) = if forward { (first, last, spacing) } else { (last, first, -spacing) };
        let steps = (last - first) * if forward { 1 } else { -1 };
        Some(Self {
            family,
            first,
            step,
            count: if steps < 0 { 0 } else { steps / spacing + 1 },
            turn: family.turn().times(growing),
            trusted: true,
            inside: true,
            g_a,
            v_a,
            z_a,
            v_slope: (v_b - v_a) * per,
            z_slope: (z_b - z_a) * per,
            v_error,
            z_error,
            reach,
            t_first: (first as f64 - g_a) * per,
            lines_per_t: reach * if spacing == 1 { direction } else { 0.5 * direction },
            t_error: 4.0 * g_error * per.abs() + 10.0 * ROUNDOFF,
        })
    }

    /// The parameter t of AB at line `c`, within [`Sweep::t_error`].
    pub(super) fn parameter(&self, c: i64) -> f64 {
        (c as f64 - self.g_a) / self.reach
    }

    /// How many crossings have a parameter of at most `t`, or one that is greater or less by so little as
    /// [`Sweep::t_error`] and eight roundings of 1. Grows with `t`.
    #[inline]
    pub(super) fn until(&self, t: f64) -> i64 {
        // Casts of NaN give 0, of what is too large saturate.
        let lines = (t - self.t_first) * self.lines_per_t;
        if lines < 0.0 { 0 } else { (lines as i64).saturating_add(1).min(self.count) }
    }

    /// What the line number grows by from crossing to crossing.
    #[inline]
    pub(super) fn step(&self) -> i64 {
        self.step
    }

    /// The post at or before crossing `n`, give or take one; so it may be beyond the grid.
    #[inline]
    pub(super) fn near(&self, n: i64) -> Post {
        let crossing = self.crossing(n);
        self.family.post(crossing.c, crossing.v as i64)
    }

    /// Line number of crossing `n`, below [`Sweep::count`].
    #[inline]
    pub(super) fn line(&self, n: i64) -> i64 {
        self.first + n * self.step
    }

    /// Crossing `n`. Only a hint unless [`Sweep::trusted`].
    #[inline]
    pub(super) fn crossing(&self, n: i64) -> Crossing {
        let c = self.line(n);
        let along = c as f64 - self.g_a;
        Crossing { c, v: self.v_a + along * self.v_slope, z: self.z_a + along * self.z_slope }
    }
}

impl Sweep {
    /// Crossing `n` in f32, with no bound of its error.
    #[inline]
    pub(super) fn crossing_fast(&self, n: i64) -> Crossing {
        let c = self.line(n);
        let along = (c as f64 - self.g_a) as f32;
        let at = |from: f64, slope: f64| f64::from(from as f32 + along * slope as f32);
        Crossing { c, v: at(self.v_a, self.v_slope), z: at(self.z_a, self.z_slope) }
    }
}

impl Family {
    /// The sign of g(B) - g(A), exactly.
    fn side_of_b(self, a: [f64; 2], b: [f64; 2]) -> Sign {
        if is_tiny(a) || is_tiny(b) {
            return compare_exactly(&self.exact_function(b), &self.exact_function(a));
        }
        let ((value_a, error_a), (value_b, error_b)) = (self.function(a), self.function(b));
        // Rounded values in different order are so exactly; equal ones differ by their errors.
        match compare(value_b, value_a) {
            Sign::Zero => Sign::of(error_b - error_a),
            sign => sign,
        }
    }
}

/// Whether a number is so small, but not zero, that sums of such may be lost where subnormals are flushed.
pub(super) fn is_tiny(p: [f64; 2]) -> bool {
    p.iter().any(|v| v.abs() < TINY && compare(*v, 0.0) != Sign::Zero)
}

fn compare_exactly(a: &BigRational, b: &BigRational) -> Sign {
    (a - b).cmp(&BigRational::zero()).into()
}

/// The first and last line, in growing order, that the part of AB over the grid may cross and that A and B lie strictly
/// on different sides of. Empty ranges have last < first.
fn line_range(family: Family, grid: Grid, span: Span, a: [f64; 2], b: [f64; 2]) -> (i64, i64) {
    let spacing = family.spacing();
    let (least, greatest) = family.lines(grid);
    let (g_a, g_b) = (family.function(a).0, family.function(b).0);
    let reach = g_b - g_a;
    // Each is off by at most a few u of the sizes involved, and by the error of the span.
    let [at_low, at_high] = [span.low, span.high].map(|t| g_a + t * reach);
    let margin = 1.0 + 32.0 * ROUNDOFF * (g_a.abs() + g_b.abs());
    let (mut low, mut high) = (at_low.min(at_high) - margin, at_low.max(at_high) + margin);
    if !(low <= high && reach.is_finite()) {
        (low, high) = (least as f64, greatest as f64);
    }
    // Casts saturate, so the clamp comes first.
    let clamp = |v: f64| v.clamp(least as f64 - 2.0, greatest as f64 + 2.0);
    let multiple = |v: i64| v.div_euclid(spacing) * spacing;
    let mut first = multiple(clamp(low).floor() as i64).max(multiple(least + spacing - 1));
    let mut last = multiple(clamp(high).ceil() as i64).min(multiple(greatest));
    let between = |c: i64| {
        let (s, t) = (family.side(c, a), family.side(c, b));
        s != Sign::Zero && s == -t
    };
    // The range may be too wide by a few lines at each end; lines strictly between A and B are consecutive.
    while first <= last && !between(first) {
        first += spacing;
    }
    while first <= last && !between(last) {
        last -= spacing;
    }
    (first, last)
}
