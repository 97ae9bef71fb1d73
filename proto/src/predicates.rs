//! Exact signs of the determinants that decide visibility, for every finite f64.
//!
//! Each predicate is a ladder, after the model of S2 geometry (triage, then exact). The *filter* computes in f64, with
//! an error bound that is derived beside it. Where that cannot tell, *whole numbers* of 128 bits do when all
//! coordinates are short multiples of one power of two, as posts and ties mostly are; *dyadics* of any length do else.
//!
//! **Algebra.** Every sign is what real arithmetic gives, so all that is true of determinants is true of it:
//! - exchanging two points of an orientation reverses its sign; so three points may be rotated ([`orient2d`]), and any
//!   even permutation of four ([`orient3d`]); [`compare`] reverses with its arguments;
//! - reversing one coordinate of all points reverses the sign, exchanging two coordinates too; scaling a coordinate by a
//!   positive power of two changes nothing, nor does moving all points by the same amount, as far as no rounding or
//!   overflow moves them differently;
//! - a tie is [`Sign::Zero`], and nothing else is: there is no perturbation. Points that coincide, or -0.0 for 0.0, are
//!   ties like any other.
//!
//! **The same on every machine.** Arguments are finite; NaN and infinities are the caller's to refuse. Only sums,
//! differences, products and comparisons of f64 are used, in the order written: rustc never fuses a product into a sum,
//! whatever the target's features, so rounded values and bounds are the same bits everywhere (a test holds them to
//! golden ones).
//!
//! **Flush to zero.** A host may have the processor replace subnormal results by zero, and read subnormal operands as
//! zero. The bounds of all filters allow for both ([`FLUSHED`]); what is exact works on the bits of its arguments, and
//! so does [`compare`]. No sign depends on the mode.
//!
//! Which rungs there are is a type parameter, [`Kernel`]: [`Exact`] has all; [`FilterOnly`] takes the filter's rounded
//! value at its word and is wrong near ties; [`ExactOnly`] does without the filter, slowly; a test may bring its own to
//! count.

use std::{
    cell::Cell,
    cmp::Ordering,
    ops::Neg,
    sync::atomic::{self, AtomicU64},
};

use crate::number::{Dyadic, Interval, Number, whole};

/// The sign of a real number.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Sign {
    /// Below zero.
    Negative,
    /// Exactly zero.
    Zero,
    /// Above zero.
    Positive,
}

impl Sign {
    /// The sign of `v`; zero for NaN.
    #[inline]
    pub fn of(v: f64) -> Self {
        if v > 0.0 {
            Self::Positive
        } else if v < 0.0 {
            Self::Negative
        } else {
            Self::Zero
        }
    }

    fn of_whole(v: i128) -> Self {
        v.cmp(&0).into()
    }

    /// The sign of the product.
    #[inline]
    pub fn times(self, other: Self) -> Self {
        match other {
            Self::Negative => -self,
            Self::Zero => Self::Zero,
            Self::Positive => self,
        }
    }

    /// The sign of x - y, given that x has this sign, y has sign `other`, and they are not both positive or both
    /// negative.
    #[inline]
    pub fn minus_opposite(self, other: Self) -> Self {
        debug_assert!(self == Self::Zero || self != other);
        if self == Self::Zero { -other } else { self }
    }
}

impl From<Ordering> for Sign {
    /// The sign of the first less the second.
    #[inline]
    fn from(order: Ordering) -> Self {
        match order {
            Ordering::Less => Self::Negative,
            Ordering::Equal => Self::Zero,
            Ordering::Greater => Self::Positive,
        }
    }
}

impl Neg for Sign {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        match self {
            Self::Negative => Self::Positive,
            Self::Zero => Self::Zero,
            Self::Positive => Self::Negative,
        }
    }
}

/// Which rungs a predicate has beyond its filter.
pub trait Kernel {
    /// Whether filters are asked at all.
    const FILTERS: bool = true;

    /// Called for each sign that a filter settled. Costs nothing unless a test counts.
    #[inline]
    fn settled() {}

    /// A sign that no filter could settle: `estimate` is that of the rounded value, `exact` computes the true one.
    fn unsettled(estimate: Sign, exact: impl FnOnce() -> Sign) -> Sign;
}

/// The filter, then exact arithmetic: always right.
#[derive(Clone, Copy, Debug)]
pub struct Exact;

impl Kernel for Exact {
    #[inline]
    fn unsettled(_estimate: Sign, exact: impl FnOnce() -> Sign) -> Sign {
        EXACT_SIGNS.fetch_add(1, atomic::Ordering::Relaxed);
        EXACT_SIGNS_HERE.set(EXACT_SIGNS_HERE.get() + 1);
        exact()
    }
}

/// Signs that [`Exact`] had to compute exactly, in this process.
static EXACT_SIGNS: AtomicU64 = AtomicU64::new(0);

/// How many signs no filter could settle since the process started: what the exact rung costs is seen here.
pub fn exact_signs() -> u64 {
    EXACT_SIGNS.load(atomic::Ordering::Relaxed)
}

thread_local! {
    static EXACT_SIGNS_HERE: Cell<u64> = const { Cell::new(0) };
}

/// The same of the calling thread alone: whether it grows tells whether what was asked in between took exact arithmetic.
pub fn exact_signs_here() -> u64 {
    EXACT_SIGNS_HERE.get()
}

/// The filter's rounded value decides, even where it is not certain: wrong near ties, for comparison only.
#[derive(Clone, Copy, Debug)]
pub struct FilterOnly;

impl Kernel for FilterOnly {
    #[inline]
    fn unsettled(estimate: Sign, _exact: impl FnOnce() -> Sign) -> Sign {
        estimate
    }
}

/// Exact arithmetic at once, without a filter: as right as [`Exact`], to hold it against.
#[derive(Clone, Copy, Debug)]
pub struct ExactOnly;

impl Kernel for ExactOnly {
    const FILTERS: bool = false;

    #[inline]
    fn unsettled(_estimate: Sign, exact: impl FnOnce() -> Sign) -> Sign {
        exact()
    }
}

/// The sign of a - b for finite numbers, of which the two zeros are one. By their bits: where subnormal numbers are read
/// as zero, `<` takes them for equal.
#[inline]
pub fn compare(a: f64, b: f64) -> Sign {
    // Sign and magnitude as a number in two's complement. Not with `abs`: that the compiler knows for a question about
    // a float, and turns the answer back into `<`.
    let ordered = |v: f64| {
        let bits = v.to_bits() as i64;
        let sign = bits >> 63;
        (bits ^ (sign as u64 >> 1) as i64) - sign
    };
    ordered(a).cmp(&ordered(b)).into()
}

/// Whether the numbers of one list are those of the other, each by [`compare`].
#[inline]
pub fn are_equal<const N: usize>(a: [f64; N], b: [f64; N]) -> bool {
    a.into_iter().zip(b).all(|(a, b)| compare(a, b) == Sign::Zero)
}

/// The unit roundoff of f64, 2^-53.
const ROUNDOFF: f64 = f64::EPSILON / 2.0;
/// What gradual underflow, or flushing to zero, may add to an error, per unit of what multiplies it: 2^-1016.
///
/// With gradual underflow only products lose, at most 2^-1075. Where subnormal results are replaced by zero, any result
/// may lose up to 2^-1022, and where subnormal operands are read as zero, any operand as much. So a difference of two
/// inputs that is then multiplied is off by at most four times 2^-1022, a product that is then added by two.
pub const FLUSHED: f64 = 64.0 * f64::MIN_POSITIVE;
/// See [`orient2d`].
const ORIENT2D_BOUND: f64 = 5.0 * ROUNDOFF;
/// See [`orient3d`].
const ORIENT3D_BOUND: f64 = 10.0 * ROUNDOFF;

/// The turn a, b, c: positive when it is counter-clockwise, zero when the points lie on one line. Exact.
///
/// The sign of det = (ax - cx)(by - cy) - (ay - cy)(bx - cx). Each difference has one rounding, each product one, the
/// last difference one: with u = 2^-53 the rounded det is off by at most ((1 + u)^4 - 1) S for the exact
/// S = |(ax - cx)(by - cy)| + |(ay - cy)(bx - cx)|, and the computed S is at least (1 - u)^4 S, so 5 u S computed bounds
/// the error but for underflow. Let D be the sum of the four absolute differences. Flushing takes at most 2^-1020 of
/// each, which the other factor multiplies: 2^-1020 (D + 2^-1018) in all; then 2^-1021 of each product and of their
/// difference. [`FLUSHED`] (1 + D) is eight times as much. Overflow makes the bound infinite or NaN, and nothing is
/// settled.
#[inline]
pub fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    orient2d_with::<Exact>(a, b, c)
}

/// [`orient2d`] with the rungs of `K`.
#[inline]
pub fn orient2d_with<K: Kernel>(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    settle::<K>(rounded_orient2d(a, b, c), || exact_orient2d(a, b, c))
}

/// On which side of the plane through a, b, c the point d lies: positive above, when a, b, c turn counter-clockwise
/// seen from above; zero in the plane. Exact.
///
/// The sign of -det[a - d, b - d, c - d], expanded along z: the sum over the three cyclic orders of
/// (az - dz) ((bx - dx)(cy - dy) - (cx - dx)(by - dy)). On the way to the result each term meets at most 8 roundings
/// (three differences, two products, one inner difference, two outer sums), so the rounded value is off by at most
/// ((1 + u)^8 - 1) S, S being the same sum with absolute values and pluses. The computed S is at least (1 - u)^8 S, so
/// 10 u S computed bounds the error but for underflow. Let X, Y, Z be the sums of the three absolute differences along
/// each axis. Flushing takes at most 2^-1020 of each difference, which costs the sum of products at most 2^-1020 times
/// (1 + X)(1 + Y)(1 + Z); 2^-1021 of each inner product and difference, which Z multiplies: 2^-1019 Z; and 2^-1021 of
/// each outer product and sum: 2^-1018. [`FLUSHED`] (1 + X)(1 + Y)(1 + Z) is eight times as much. Overflow makes the
/// bound infinite or NaN, and nothing is settled.
#[inline]
pub fn orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    orient3d_with::<Exact>(a, b, c, d)
}

/// [`orient3d`] with the rungs of `K`.
#[inline]
pub fn orient3d_with<K: Kernel>(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    settle::<K>(rounded_orient3d(a, b, c, d), || exact_orient3d(a, b, c, d))
}

/// The side of line uv in plan on which AB crosses line pq: the sign of the turn u, v, X. Exact.
///
/// A and B must lie on different sides of pq, one of them at most on it. X divides AB as |g(A)| : |g(B)|, where g is
/// the turn p, q, .; so the turn u, v, X is (g(A) h(B) - g(B) h(A)) / (g(A) - g(B)) with h the turn u, v, . .
pub fn side_of_crossing<K: Kernel>(ab: [[f64; 2]; 2], pq: [[f64; 2]; 2], uv: [[f64; 2]; 2]) -> Sign {
    fn numerator<N: Number>(ab: [[f64; 2]; 2], pq: [[f64; 2]; 2], uv: [[f64; 2]; 2]) -> N {
        let [a, b] = ab;
        at_crossing(&turn(pq[0], pq[1], a), &turn(pq[0], pq[1], b), &turn(uv[0], uv[1], a), &turn(uv[0], uv[1], b))
    }
    let value = ladder::<K>(&numerator::<Interval>(ab, pq, uv), || exact_sign(&numerator::<Dyadic>(ab, pq, uv)));
    value.times(crossing_direction::<K>(ab, pq))
}

/// Whether AB, where it crosses line pq in plan, is above (positive), on or below the plane through `corners`, which
/// turn counter-clockwise. Exact. A and B must lie on different sides of pq, one of them at most on it.
///
/// As [`side_of_crossing`], with h the orientation of the corners and the point.
pub fn height_of_crossing<K: Kernel>(ab: [[f64; 3]; 2], pq: [[f64; 2]; 2], corners: [[f64; 3]; 3]) -> Sign {
    fn numerator<N: Number>(ab: [[f64; 3]; 2], pq: [[f64; 2]; 2], corners: [[f64; 3]; 3]) -> N {
        let [a, b] = ab;
        at_crossing(
            &turn(pq[0], pq[1], plan(a)),
            &turn(pq[0], pq[1], plan(b)),
            &volume(corners[0], corners[1], corners[2], a),
            &volume(corners[0], corners[1], corners[2], b),
        )
    }
    let value =
        ladder::<K>(&numerator::<Interval>(ab, pq, corners), || exact_sign(&numerator::<Dyadic>(ab, pq, corners)));
    value.times(crossing_direction::<K>(ab.map(plan), pq))
}

/// The plan position of a point.
#[inline]
pub const fn plan(p: [f64; 3]) -> [f64; 2] {
    [p[0], p[1]]
}

/// The sign of g(A) - g(B) for the turn g = (p, q, .).
fn crossing_direction<K: Kernel>(ab: [[f64; 2]; 2], pq: [[f64; 2]; 2]) -> Sign {
    let [ga, gb] = ab.map(|x| orient2d_with::<K>(pq[0], pq[1], x));
    // Only a kernel without an exact rung can see both ends on one side.
    if ga == gb { ga } else { ga.minus_opposite(gb) }
}

fn at_crossing<N: Number>(ga: &N, gb: &N, ha: &N, hb: &N) -> N {
    ga.mul(hb).sub(&gb.mul(ha))
}

/// The formula of [`orient2d`].
fn turn<N: Number>(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> N {
    let [cx, cy] = c.map(N::of);
    let [[ax, ay], [bx, by]] = [a, b].map(|[x, y]| [N::of(x).sub(&cx), N::of(y).sub(&cy)]);
    ax.mul(&by).sub(&ay.mul(&bx))
}

/// The formula of [`orient3d`].
fn volume<N: Number>(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> N {
    let [dx, dy, dz] = d.map(N::of);
    let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] =
        [a, b, c].map(|[x, y, z]| [N::of(x).sub(&dx), N::of(y).sub(&dy), N::of(z).sub(&dz)]);
    let minor = |px: &N, py: &N, qx: &N, qy: &N| px.mul(qy).sub(&qx.mul(py));
    let sum = az
        .mul(&minor(&bx, &by, &cx, &cy))
        .add(&bz.mul(&minor(&cx, &cy, &ax, &ay)))
        .add(&cz.mul(&minor(&ax, &ay, &bx, &by)));
    N::of(0.0).sub(&sum)
}

fn exact_sign(value: &Dyadic) -> Sign {
    value.sign().unwrap_or(Sign::Zero)
}

#[cold]
#[inline(never)]
fn exact_orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    whole_orient2d(a, b, c).unwrap_or_else(|| dyadic_orient2d(a, b, c))
}

/// [`orient2d`] in numbers of any length.
pub(crate) fn dyadic_orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    exact_sign(&turn(a, b, c))
}

/// [`orient2d`] in whole numbers, if they are short enough.
pub(crate) fn whole_orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Option<Sign> {
    // Differences below 2^62, products below 2^124.
    let [ax, ay, bx, by, cx, cy] = whole([a[0], a[1], b[0], b[1], c[0], c[1]], 61)?;
    Some(Sign::of_whole((ax - cx) * (by - cy) - (ay - cy) * (bx - cx)))
}

#[cold]
#[inline(never)]
fn exact_orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    whole_orient3d(a, b, c, d).unwrap_or_else(|| dyadic_orient3d(a, b, c, d))
}

/// [`orient3d`] in numbers of any length.
pub(crate) fn dyadic_orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    exact_sign(&volume(a, b, c, d))
}

/// [`orient3d`] in whole numbers, if they are short enough. Heights may have another unit than places.
pub(crate) fn whole_orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Option<Sign> {
    // Differences below 2^41, products of three below 2^123, each twice, three of those.
    let [ax, ay, bx, by, cx, cy, dx, dy] = whole([a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1]], 40)?;
    let [az, bz, cz, dz] = whole([a[2], b[2], c[2], d[2]], 40)?;
    let minor = |px: i128, py: i128, qx: i128, qy: i128| (px - dx) * (qy - dy) - (qx - dx) * (py - dy);
    let terms = [(az, minor(bx, by, cx, cy)), (bz, minor(cx, cy, ax, ay)), (cz, minor(ax, ay, bx, by))];
    Some(-Sign::of_whole(terms.iter().map(|&(z, minor)| (z - dz) * minor).sum()))
}

/// A value, and a bound of its error.
pub(crate) type Rounded = (f64, f64);

#[inline]
pub(crate) fn rounded_orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Rounded {
    let [ax, ay] = [a[0] - c[0], a[1] - c[1]];
    let [bx, by] = [b[0] - c[0], b[1] - c[1]];
    let (left, right) = (ax * by, ay * bx);
    let differences = (ax.abs() + by.abs()) + (ay.abs() + bx.abs());
    (left - right, ORIENT2D_BOUND * (left.abs() + right.abs()) + FLUSHED * (1.0 + differences))
}

#[inline]
pub(crate) fn rounded_orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Rounded {
    let [ax, ay, az] = [a[0] - d[0], a[1] - d[1], a[2] - d[2]];
    let [bx, by, bz] = [b[0] - d[0], b[1] - d[1], b[2] - d[2]];
    let [cx, cy, cz] = [c[0] - d[0], c[1] - d[1], c[2] - d[2]];
    let (bc, cb) = (bx * cy, cx * by);
    let (ca, ac) = (cx * ay, ax * cy);
    let (ab, ba) = (ax * by, bx * ay);
    let det = az * (bc - cb) + bz * (ca - ac) + cz * (ab - ba);
    let x = ax.abs() + bx.abs() + cx.abs();
    let y = ay.abs() + by.abs() + cy.abs();
    let [az, bz, cz] = [az.abs(), bz.abs(), cz.abs()];
    let size = az * (bc.abs() + cb.abs()) + bz * (ca.abs() + ac.abs()) + cz * (ab.abs() + ba.abs());
    (-det, ORIENT3D_BOUND * size + FLUSHED * (1.0 + x) * (1.0 + y) * (1.0 + az + bz + cz))
}

/// The sign of a value known to within a bound, or the next rung.
#[inline]
fn settle<K: Kernel>((value, bound): Rounded, exact: impl FnOnce() -> Sign) -> Sign {
    if !K::FILTERS {
        return K::unsettled(Sign::Zero, exact);
    }
    // Both comparisons are false for NaN and for an infinite bound.
    let certain = if value > bound {
        Sign::Positive
    } else if value < -bound {
        Sign::Negative
    } else {
        return K::unsettled(Sign::of(value), exact);
    };
    K::settled();
    // Debug builds re-check one settled sign in 64, chosen by its last bits: all of them would cost minutes.
    if cfg!(debug_assertions) && value.to_bits() & 63 == 0 {
        assert_eq!(certain, exact(), "the filter settled {value:e} within {bound:e}");
    }
    certain
}

fn ladder<K: Kernel>(value: &Interval, exact: impl FnOnce() -> Sign) -> Sign {
    match value.sign().filter(|_| K::FILTERS) {
        Some(sign) => {
            K::settled();
            sign
        }
        None => K::unsettled(value.estimate(), exact),
    }
}
