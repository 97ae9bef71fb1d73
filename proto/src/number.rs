//! Two kinds of number for one formula: an interval that settles most signs, an exact dyadic that settles all.
//!
//! A compound predicate is written once over [`Number`] and evaluated first with [`Interval`], then, when the sign is
//! not certain, with [`Dyadic`]. The bound of the interval rung needs no derivation of its own: each operation rounds
//! to nearest, one step outward covers that, and [`FLUSHED`] what underflow or flushing to zero may take.

use num_bigint::BigInt;
use num_traits::Zero;

use crate::predicates::{FLUSHED, Sign};

/// A number with the ring operations, whose sign may be uncertain.
pub trait Number: Sized {
    /// The number `v`, which must be finite.
    fn of(v: f64) -> Self;
    /// The sum.
    fn add(&self, other: &Self) -> Self;
    /// The difference.
    fn sub(&self, other: &Self) -> Self;
    /// The product.
    fn mul(&self, other: &Self) -> Self;
    /// The sign; `None` when it is not certain.
    fn sign(&self) -> Option<Sign>;
}

/// Every value between two f64, which may be infinite.
#[derive(Clone, Copy, Debug)]
pub struct Interval {
    low: f64,
    high: f64,
}

impl Interval {
    const WHOLE: Self = Self { low: f64::NEG_INFINITY, high: f64::INFINITY };

    /// The interval around two rounded bounds. A NaN (from infinity minus infinity, or zero times infinity) means
    /// that nothing is known.
    fn outward(low: f64, high: f64) -> Self {
        if low.is_nan() || high.is_nan() {
            return Self::WHOLE;
        }
        // What is flushed matters only where it is more than half a unit in the last place; there, the sums are wider
        // than needed by several times their own rounding and flushing. Elsewhere they change nothing.
        Self { low: low.next_down() - FLUSHED, high: high.next_up() + FLUSHED }
    }

    /// Whether it holds nothing but 0. By the bits: see [`crate::predicates::compare`].
    fn is_zero(&self) -> bool {
        is_zero(self.low) && is_zero(self.high)
    }

    /// Whether both hold the same one number and no other.
    fn is_same_point(&self, other: &Self) -> bool {
        let bits = self.low.to_bits();
        [self.high, other.low, other.high].iter().all(|v| v.to_bits() == bits)
    }
}

impl Number for Interval {
    fn of(v: f64) -> Self {
        if is_zero(v) {
            return Self { low: 0.0, high: 0.0 };
        }
        // A subnormal number may be read as zero, and whatever multiplies it would multiply the error.
        match (v.is_subnormal(), v.is_sign_negative()) {
            (false, _) => Self { low: v, high: v },
            (true, false) => Self { low: 0.0, high: f64::MIN_POSITIVE },
            (true, true) => Self { low: -f64::MIN_POSITIVE, high: 0.0 },
        }
    }

    fn add(&self, other: &Self) -> Self {
        Self::outward(self.low + other.low, self.high + other.high)
    }

    fn sub(&self, other: &Self) -> Self {
        // Exact, and common on a grid.
        if self.is_same_point(other) {
            return Self { low: 0.0, high: 0.0 };
        }
        Self::outward(self.low - other.high, self.high - other.low)
    }

    fn mul(&self, other: &Self) -> Self {
        let products = [self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high];
        if products.iter().any(|p| p.is_nan()) {
            return Self::WHOLE;
        }
        if self.is_zero() || other.is_zero() {
            return Self { low: 0.0, high: 0.0 };
        }
        let low = products.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        let high = products.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        Self::outward(low, high)
    }

    fn sign(&self) -> Option<Sign> {
        if self.low > 0.0 {
            Some(Sign::Positive)
        } else if self.high < 0.0 {
            Some(Sign::Negative)
        } else if self.is_zero() {
            Some(Sign::Zero)
        } else {
            None
        }
    }
}

impl Interval {
    /// The sign of the middle, for a kernel that has no exact rung. Not to be decided by.
    pub(crate) fn estimate(&self) -> Sign {
        Sign::of(0.5 * self.low + 0.5 * self.high)
    }
}

/// An exact number `mantissa * 2^exponent`. Every finite f64 is one, and so are sums and products of them.
#[derive(Clone, Debug)]
pub struct Dyadic {
    mantissa: BigInt,
    exponent: i64,
}

const FRACTION_BITS: u32 = 52;
/// Exponent of the last bit of a subnormal f64.
const LEAST_EXPONENT: i64 = -1074;

impl Number for Dyadic {
    fn of(v: f64) -> Self {
        let (mantissa, exponent) = odd_part(v);
        Self { mantissa: BigInt::from(mantissa), exponent }
    }

    fn add(&self, other: &Self) -> Self {
        let (a, b, exponent) = self.aligned(other);
        Self { mantissa: a + b, exponent }
    }

    fn sub(&self, other: &Self) -> Self {
        let (a, b, exponent) = self.aligned(other);
        Self { mantissa: a - b, exponent }
    }

    fn mul(&self, other: &Self) -> Self {
        Self { mantissa: &self.mantissa * &other.mantissa, exponent: self.exponent + other.exponent }
    }

    fn sign(&self) -> Option<Sign> {
        Some(match self.mantissa.sign() {
            num_bigint::Sign::Minus => Sign::Negative,
            num_bigint::Sign::NoSign => Sign::Zero,
            num_bigint::Sign::Plus => Sign::Positive,
        })
    }
}

impl Dyadic {
    /// Both mantissas for the lesser of the two exponents.
    fn aligned(&self, other: &Self) -> (BigInt, BigInt, i64) {
        // A zero takes any exponent; without this it could drag a huge number down to its own.
        if self.mantissa.is_zero() {
            return (BigInt::zero(), other.mantissa.clone(), other.exponent);
        }
        if other.mantissa.is_zero() {
            return (self.mantissa.clone(), BigInt::zero(), self.exponent);
        }
        let exponent = self.exponent.min(other.exponent);
        let shifted = |v: &Self| &v.mantissa << (v.exponent - exponent);
        (shifted(self), shifted(other), exponent)
    }
}

/// Whether a number is 0 or -0, and not a subnormal number that is read as zero.
fn is_zero(v: f64) -> bool {
    v.to_bits() << 1 == 0
}

/// A finite number as mantissa * 2^exponent with an odd mantissa; zero as 0 * 2^0.
fn odd_part(v: f64) -> (i64, i64) {
    debug_assert!(v.is_finite());
    let bits = v.to_bits();
    let fraction = bits & ((1 << FRACTION_BITS) - 1);
    let biased = (bits >> FRACTION_BITS & 0x7ff) as i64;
    let (mantissa, exponent) = match biased {
        0 => (fraction, LEAST_EXPONENT),
        _ => (fraction | 1 << FRACTION_BITS, LEAST_EXPONENT + biased - 1),
    };
    if mantissa == 0 {
        return (0, 0);
    }
    let zeros = mantissa.trailing_zeros();
    let mantissa = (mantissa >> zeros) as i64;
    (if v.is_sign_negative() { -mantissa } else { mantissa }, exponent + i64::from(zeros))
}

/// The numbers as whole multiples of one power of two, if each takes at most `bits` bits (below 127).
///
/// Ties are common on a grid because posts, heights and many ends are short numbers: exact arithmetic in 128 bits then
/// is cheap beside [`Dyadic`], which allocates.
pub(crate) fn whole<const N: usize>(values: [f64; N], bits: u32) -> Option<[i128; N]> {
    let parts = values.map(odd_part);
    let least = parts.iter().filter(|(m, _)| *m != 0).map(|&(_, e)| e).min().unwrap_or(0);
    let mut whole = [0; N];
    for (whole, (mantissa, exponent)) in whole.iter_mut().zip(parts).filter(|(_, (m, _))| *m != 0) {
        let shift = exponent - least;
        if shift + i64::from(64 - mantissa.unsigned_abs().leading_zeros()) > i64::from(bits) {
            return None;
        }
        *whole = i128::from(mantissa) << shift;
    }
    Some(whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_rational::BigRational;
    use proptest::prelude::*;

    fn finite() -> impl Strategy<Value = f64> {
        prop_oneof![
            any::<u64>().prop_map(f64::from_bits),
            (-9..9_i32).prop_map(f64::from),
            Just(5e-324),
            Just(-1e300),
            Just(f64::MAX),
            Just(-f64::MAX),
            Just(f64::MIN_POSITIVE),
        ]
        .prop_filter("finite", |v| v.is_finite())
    }

    fn rational_sign(v: &BigRational) -> Sign {
        use num_traits::Signed;
        match (v.is_positive(), v.is_negative()) {
            (true, _) => Sign::Positive,
            (_, true) => Sign::Negative,
            _ => Sign::Zero,
        }
    }

    proptest! {
        #[test]
        fn both_kinds_agree_with_rationals(a in finite(), b in finite(), c in finite(), d in finite()) {
            fn formula<N: Number>([a, b, c, d]: [f64; 4]) -> Option<Sign> {
                let [a, b, c, d] = [a, b, c, d].map(N::of);
                a.sub(&b).mul(&c).add(&d).sign()
            }
            let [ra, rb, rc, rd] = [a, b, c, d].map(|v| BigRational::from_float(v).unwrap());
            let truth = rational_sign(&((ra - rb) * rc + rd));
            prop_assert_eq!(formula::<Dyadic>([a, b, c, d]), Some(truth));
            let interval = formula::<Interval>([a, b, c, d]);
            prop_assert!(interval.is_none() || interval == Some(truth), "{:?} {:?}", interval, truth);
        }
    }
}
