//! Exact signs of the determinants that decide visibility, for every finite f64.
//!
//! Each predicate is a ladder, after the model of S2 geometry (triage, then exact): a filter in f64 whose error bound
//! is derived beside it, and, where that cannot tell, exact arithmetic. Under- and overflow are part of the bound: the
//! filter then declines. Every sign is what real arithmetic gives, so the usual algebra holds: exchanging two points
//! of an orientation reverses its sign, and a tie is [`Sign::Zero`] and nothing else.
//!
//! Which rungs there are is a type parameter, [`Kernel`]: [`Exact`] has both; [`FilterOnly`] takes the filter's rounded
//! value at its word and is wrong near ties; a test may bring its own to count.

use std::ops::Neg;

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
        match v.signum() {
            -1 => Self::Negative,
            0 => Self::Zero,
            _ => Self::Positive,
        }
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
        exact()
    }
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

/// The unit roundoff of f64, 2^-53.
const ROUNDOFF: f64 = f64::EPSILON / 2.0;
/// See [`orient2d`].
const ORIENT2D_BOUND: f64 = 5.0 * ROUNDOFF;
/// See [`orient3d`].
const ORIENT3D_BOUND: f64 = 10.0 * ROUNDOFF;

/// The turn a, b, c: positive when it is counter-clockwise, zero when the points lie on one line. Exact.
///
/// The sign of det = (ax - cx)(by - cy) - (ay - cy)(bx - cx). Each difference has one rounding, each product one, the
/// last difference one: with u = 2^-53 the rounded det is off by at most ((1 + u)^4 - 1) S for the exact
/// S = |(ax - cx)(by - cy)| + |(ay - cy)(bx - cx)|, plus at most 2^-1074 where the two products underflow (sums and
/// differences never lose to underflow). The computed S is at least (1 - u)^4 S less as much, so 5 u S computed, plus
/// 2^-1022 for all underflow, bounds the error. Overflow makes the bound infinite or NaN, and nothing is settled.
#[inline]
pub fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    orient2d_with::<Exact>(a, b, c)
}

/// [`orient2d`] with the rungs of `K`.
#[inline]
pub fn orient2d_with<K: Kernel>(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    let left = (a[0] - c[0]) * (b[1] - c[1]);
    let right = (a[1] - c[1]) * (b[0] - c[0]);
    let det = left - right;
    let bound = ORIENT2D_BOUND * (left.abs() + right.abs()) + f64::MIN_POSITIVE;
    settle::<K>(det, bound, || exact_orient2d(a, b, c))
}

/// On which side of the plane through a, b, c the point d lies: positive above, when a, b, c turn counter-clockwise
/// seen from above; zero in the plane. Exact.
///
/// The sign of -det[a - d, b - d, c - d], expanded along z: the sum over the three cyclic orders of
/// (az - dz) ((bx - dx)(cy - dy) - (cx - dx)(by - dy)). On the way to the result each term meets at most 8 roundings
/// (three differences, two products, one inner difference, two outer sums), so the rounded value is off by at most
/// ((1 + u)^8 - 1) S, S being the same sum with absolute values and pluses. The computed S is at least (1 - u)^8 S, so
/// 10 u S computed is enough. Underflow adds at most 2^-1074 to each inner difference, which is multiplied by a height
/// difference, and 2^-1075 to each outer product: together less than 2^-1022 (1 + |az-dz| + |bz-dz| + |cz-dz|).
/// Overflow makes the bound infinite or NaN, and nothing is settled.
#[inline]
pub fn orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    orient3d_with::<Exact>(a, b, c, d)
}

/// [`orient3d`] with the rungs of `K`.
#[inline]
pub fn orient3d_with<K: Kernel>(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    let [ax, ay, az] = [a[0] - d[0], a[1] - d[1], a[2] - d[2]];
    let [bx, by, bz] = [b[0] - d[0], b[1] - d[1], b[2] - d[2]];
    let [cx, cy, cz] = [c[0] - d[0], c[1] - d[1], c[2] - d[2]];
    let (bc, cb) = (bx * cy, cx * by);
    let (ca, ac) = (cx * ay, ax * cy);
    let (ab, ba) = (ax * by, bx * ay);
    let det = az * (bc - cb) + bz * (ca - ac) + cz * (ab - ba);
    let [az, bz, cz] = [az.abs(), bz.abs(), cz.abs()];
    let size = az * (bc.abs() + cb.abs()) + bz * (ca.abs() + ac.abs()) + cz * (ab.abs() + ba.abs());
    let bound = ORIENT3D_BOUND * size + f64::MIN_POSITIVE * (1.0 + az + bz + cz);
    settle::<K>(-det, bound, || exact_orient3d(a, b, c, d))
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
    // Differences below 2^62, products below 2^124.
    if let Some([ax, ay, bx, by, cx, cy]) = whole([a[0], a[1], b[0], b[1], c[0], c[1]], 61) {
        return Sign::of_whole((ax - cx) * (by - cy) - (ay - cy) * (bx - cx));
    }
    exact_sign(&turn(a, b, c))
}

#[cold]
#[inline(never)]
fn exact_orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> Sign {
    // Differences below 2^41, products of three below 2^123, each twice, three of those.
    if let Some([ax, ay, bx, by, cx, cy, dx, dy]) = whole([a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1]], 40)
        && let Some([az, bz, cz, dz]) = whole([a[2], b[2], c[2], d[2]], 40)
    {
        let minor = |px: i128, py: i128, qx: i128, qy: i128| (px - dx) * (qy - dy) - (qx - dx) * (py - dy);
        let terms = [(az, minor(bx, by, cx, cy)), (bz, minor(cx, cy, ax, ay)), (cz, minor(ax, ay, bx, by))];
        return -Sign::of_whole(terms.iter().map(|&(z, minor)| (z - dz) * minor).sum());
    }
    exact_sign(&volume(a, b, c, d))
}

/// The sign of a value known to within `bound`, or the next rung.
#[inline]
fn settle<K: Kernel>(value: f64, bound: f64, exact: impl FnOnce() -> Sign) -> Sign {
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
    match value.sign() {
        Some(sign) => {
            K::settled();
            sign
        }
        None => K::unsettled(value.estimate(), exact),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_rational::BigRational;
    use num_traits::Signed;
    use proptest::prelude::*;

    /// Numbers that meet: small integers, their neighbours, and the ends of the range.
    fn awkward() -> impl Strategy<Value = f64> {
        prop_oneof![
            4 => (-4..5_i32).prop_map(f64::from),
            2 => (-4..5_i32).prop_map(|v| f64::from(v).next_up()),
            1 => (-4..5_i32).prop_map(|v| f64::from(v) * 5e-324),
            1 => (-4..5_i32).prop_map(|v| f64::from(v) * 1e300),
            1 => (-4..5_i32).prop_map(|v| f64::from(v) * 0.1),
            1 => any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |v| v.is_finite()),
        ]
    }

    fn rational(v: f64) -> BigRational {
        BigRational::from_float(v).unwrap()
    }

    fn sign(v: &BigRational) -> Sign {
        match (v.is_positive(), v.is_negative()) {
            (true, _) => Sign::Positive,
            (_, true) => Sign::Negative,
            _ => Sign::Zero,
        }
    }

    /// The determinant of three rows, by the rule of Sarrus.
    fn determinant([a, b, c]: [[BigRational; 3]; 3]) -> BigRational {
        let term = |i: usize, j: usize, k: usize| &a[i] * &b[j] * &c[k];
        term(0, 1, 2) + term(1, 2, 0) + term(2, 0, 1) - term(2, 1, 0) - term(0, 2, 1) - term(1, 0, 2)
    }

    fn from_to(p: [f64; 3], q: [f64; 3]) -> [BigRational; 3] {
        [0, 1, 2].map(|k| rational(q[k]) - rational(p[k]))
    }

    fn point() -> impl Strategy<Value = [f64; 3]> {
        [awkward(), awkward(), awkward()]
    }

    proptest! {
        #[test]
        fn orientations_are_those_of_rational_arithmetic(a in point(), b in point(), c in point(), d in point()) {
            let turn = |p: [f64; 3], q: [f64; 3], r: [f64; 3]| {
                let (u, v) = (from_to(p, q), from_to(p, r));
                sign(&(&u[0] * &v[1] - &u[1] * &v[0]))
            };
            prop_assert_eq!(orient2d(plan(a), plan(b), plan(c)), turn(a, b, c));
            let volume = sign(&determinant([from_to(a, b), from_to(a, c), from_to(a, d)]));
            prop_assert_eq!(orient3d(a, b, c, d), volume);
            prop_assert_eq!(orient3d(b, a, c, d), -volume);
        }

        #[test]
        fn crossings_are_those_of_rational_arithmetic(
            a in point(), b in point(), p in point(), q in point(), t in [point(), point(), point()],
        ) {
            let (ga, gb) = (orient2d(plan(p), plan(q), plan(a)), orient2d(plan(p), plan(q), plan(b)));
            prop_assume!(ga != gb);
            let side = |u: [f64; 3], v: [f64; 3], x: &[BigRational; 3]| {
                let e = from_to(u, v);
                &e[0] * (&x[1] - rational(u[1])) - &e[1] * (&x[0] - rational(u[0]))
            };
            let (ra, rb) = (a.map(rational), b.map(rational));
            let (sa, sb) = (side(p, q, &ra), side(p, q, &rb));
            let weight = &sa / (&sa - &sb);
            let x = [0, 1, 2].map(|k| &ra[k] + &weight * (&rb[k] - &ra[k]));
            prop_assert_eq!(
                side_of_crossing::<Exact>([plan(a), plan(b)], [plan(p), plan(q)], [plan(t[0]), plan(t[1])]),
                sign(&side(t[0], t[1], &x))
            );
            let up = [0, 1, 2].map(|k| &x[k] - rational(t[0][k]));
            prop_assert_eq!(
                height_of_crossing::<Exact>([a, b], [plan(p), plan(q)], t),
                sign(&determinant([from_to(t[0], t[1]), from_to(t[0], t[2]), up]))
            );
        }
    }

    proptest! {
        /// Points rounded onto a line or plane: rounded determinants of these are often of the wrong sign.
        #[test]
        fn almost_ties_are_decided_as_rational_arithmetic_does(
            a in [-9.0..9.0_f64, -9.0..9.0, -9.0..9.0],
            b in [-9.0..9.0_f64, -9.0..9.0, -9.0..9.0],
            c in [-9.0..9.0_f64, -9.0..9.0, -9.0..9.0],
            (s, t) in (-1.0..2.0_f64, -1.0..2.0_f64),
        ) {
            let on_line = [0, 1, 2].map(|k| a[k] + s * (b[k] - a[k]));
            let in_plane = [0, 1, 2].map(|k| on_line[k] + t * (c[k] - a[k]));
            let (u, v) = (from_to(a, b), from_to(a, on_line));
            prop_assert_eq!(orient2d(plan(a), plan(b), plan(on_line)), sign(&(&u[0] * &v[1] - &u[1] * &v[0])));
            let volume = sign(&determinant([from_to(a, b), from_to(a, c), from_to(a, in_plane)]));
            prop_assert_eq!(orient3d(a, b, c, in_plane), volume);
        }
    }

    #[test]
    fn neighbours_of_a_tie_are_told_apart() {
        let (a, b) = ([0.1, 0.1], [0.3, 0.3]);
        assert_eq!(orient2d(a, b, [0.2, 0.2]), Sign::Zero);
        assert_eq!(orient2d(a, b, [0.2, 0.2_f64.next_up()]), Sign::Positive);
        assert_eq!(orient2d(a, b, [0.2, 0.2_f64.next_down()]), Sign::Negative);
        assert_eq!(orient2d_with::<FilterOnly>([0.0, 0.0], [1e-200, 1e-200], [1e-200, 2e-200]), Sign::Zero);
        assert_eq!(orient2d([0.0, 0.0], [1e-200, 1e-200], [1e-200, 2e-200]), Sign::Positive);
    }
}
