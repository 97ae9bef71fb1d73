//! Heights of the surface in whole numbers of 128 bits.
//!
//! Posts, positions and heights are f64s: whole numbers times powers of two. A triangle's legs are single steps, so the
//! height over it is made of sums and products only, and is such a number, too. Where one of 128 bits holds it, it is
//! exact and takes some dozen instructions; where none does, which takes positions or heights far from those of any
//! terrain, there is no answer here, and the caller asks fractions. No f64 is computed with before the last step, so a
//! host that has subnormal numbers flushed changes nothing.

use sightline_proto::diamond::Post;

use super::surface::Face;

/// Bits that a number may have here, its sign aside: two of them add up to one that an i128 holds.
const MAX_BITS: u32 = 125;
/// Results between 2 to the power of minus this and of this are normal numbers.
const MAX_EXPONENT: i32 = 900;

/// `mantissa` times 2 to the power of `exponent`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dyadic {
    mantissa: i128,
    exponent: i32,
}

impl Dyadic {
    /// A finite f64, its mantissa odd or 0.
    pub(super) fn new(v: f64) -> Self {
        let bits = v.to_bits();
        let (field, fraction) = ((bits >> 52 & 0x7ff) as i32, bits & ((1 << 52) - 1));
        let (whole, exponent) = if field == 0 { (fraction, -1074) } else { (fraction | 1 << 52, field - 1075) };
        if whole == 0 {
            return Self { mantissa: 0, exponent: 0 };
        }
        let zeros = whole.trailing_zeros();
        let mantissa = i128::from(whole >> zeros);
        Self { mantissa: if v.is_sign_negative() { -mantissa } else { mantissa }, exponent: exponent + zeros as i32 }
    }

    /// The mantissa at a smaller or equal exponent.
    fn at(self, exponent: i32) -> Option<i128> {
        if self.mantissa == 0 {
            return Some(0);
        }
        let shift = u32::try_from(self.exponent - exponent).ok()?;
        (bits(self.mantissa) + shift <= MAX_BITS).then(|| self.mantissa << shift)
    }

    pub(super) fn plus(self, other: Self) -> Option<Self> {
        let exponent = self.exponent.min(other.exponent);
        Some(Self { mantissa: self.at(exponent)? + other.at(exponent)?, exponent })
    }

    fn times(self, other: Self) -> Option<Self> {
        let fits = bits(self.mantissa) + bits(other.mantissa) <= MAX_BITS;
        let exponent = self.exponent + other.exponent;
        fits.then(|| Self { mantissa: self.mantissa * other.mantissa, exponent })
    }

    fn minus(self, other: Self) -> Option<Self> {
        self.plus(Self { mantissa: -other.mantissa, ..other })
    }

    /// The least f64 not below it.
    pub(super) fn least_not_below(self) -> Option<f64> {
        let magnitude = self.mantissa.unsigned_abs();
        let dropped = bits(self.mantissa).saturating_sub(f64::MANTISSA_DIGITS);
        let kept = magnitude >> dropped;
        let up = u128::from(self.mantissa > 0 && kept << dropped != magnitude);
        self.scaled(kept + up, dropped)
    }

    /// The nearest f64; of two as near, the even one.
    pub(super) fn nearest(self) -> Option<f64> {
        let magnitude = self.mantissa.unsigned_abs();
        let dropped = bits(self.mantissa).saturating_sub(f64::MANTISSA_DIGITS);
        let kept = magnitude >> dropped;
        let (rest, one) = (magnitude - (kept << dropped), 1 << dropped);
        let up = u128::from(2 * rest > one || (2 * rest == one && kept & 1 == 1));
        self.scaled(kept + up, dropped)
    }

    /// A magnitude of at most 2^53, that many bits up, with the sign of this. Every step is exact.
    fn scaled(self, magnitude: u128, up: u32) -> Option<f64> {
        let exponent = self.exponent + up as i32;
        if magnitude == 0 {
            return Some(0.0);
        }
        let power = (exponent.abs() <= MAX_EXPONENT).then(|| f64::from_bits(((1023 + exponent) as u64) << 52))?;
        let value = magnitude as f64 * power;
        Some(if self.mantissa < 0 { -value } else { value })
    }
}

fn bits(v: i128) -> u32 {
    u128::BITS - v.unsigned_abs().leading_zeros()
}

/// The height of a known face at a plan point over it; `None` where 128 bits do not hold it.
pub(super) fn height_over(face: Face, heights: [f64; 3], [x, y]: [f64; 2]) -> Option<Dyadic> {
    let [p, q, r] = heights.map(Dyadic::new);
    let whole = |v: i64| Dyadic { mantissa: v.into(), exponent: 0 };
    let offset = |v: f64, of: u32| Dyadic::new(v).minus(whole(of.into()));
    match face {
        Face::Post(_) => Some(p),
        Face::Edge([from, to]) => {
            let along = if from.i == to.i { offset(y, from.j) } else { offset(x, from.i) };
            p.plus(along?.times(q.minus(p)?)?)
        }
        Face::Triangle([a, b, c]) => {
            // The triangle's doubled area is 1, so barycentric weights are whole sums.
            let (dx, dy) = (offset(x, a.i)?, offset(y, a.j)?);
            let leg = |to: Post| [(to.i, a.i), (to.j, a.j)].map(|(v, w)| whole(i64::from(v) - i64::from(w)));
            let ([ux, uy], [vx, vy]) = (leg(b), leg(c));
            let weight_b = vy.times(dx)?.minus(vx.times(dy)?)?;
            let weight_c = ux.times(dy)?.minus(uy.times(dx)?)?;
            p.plus(weight_b.times(q.minus(p)?)?)?.plus(weight_c.times(r.minus(p)?)?)
        }
    }
}

#[cfg(test)]
mod tests {
    use num_rational::BigRational;
    use num_traits::ToPrimitive;
    use proptest::prelude::*;

    use super::{
        super::surface::{exact_height_over, least_not_below, rational},
        *,
    };
    use crate::terrain::Grid;

    /// Numbers of all sizes, most of them such as terrains have.
    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![
            (-9_000..9_000_i32).prop_map(f64::from),
            -9e3..9e3_f64,
            (-9e3..9e3_f32).prop_map(f64::from),
            any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |v| v.is_finite()),
            Just(0.0),
            Just(-0.0),
        ]
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![
            0.0..40.0_f64,
            (0..=40_u32).prop_map(f64::from),
            (0..=160_u32).prop_map(|v| f64::from(v) / 4.0),
            0.0..1e-300_f64
        ]
    }

    proptest! {
        #[test]
        fn heights_are_those_of_fractions(at in [coordinate(), coordinate()], heights in [number(), number(), number()], above in number()) {
            let face = Face::at(Grid::new(41, 41).unwrap(), at).unwrap();
            let exact = exact_height_over(face, heights, at.map(rational));
            if let Some(height) = height_over(face, heights, at) {
                if let Some(nearest) = height.nearest() {
                    prop_assert_eq!(Some(nearest), exact.to_f64());
                }
                if let Some(least) = height.plus(Dyadic::new(above)).and_then(Dyadic::least_not_below) {
                    prop_assert_eq!(Some(least), least_not_below(&(exact + rational(above))));
                }
            }
        }
    }

    #[test]
    fn real_terrain_never_asks_fractions() {
        let grid = Grid::new(1 << 16, 1 << 16).unwrap();
        for n in 1..2_000_u32 {
            let at = [f64::from(n) * 31.000_1, f64::from(n).sqrt() * 7.3];
            let heights = [n, n + 11, 3 * n].map(|h| f64::from(h) * 0.25 - 430.7_f32 as f64);
            let height = height_over(Face::at(grid, at).unwrap(), heights, at);
            assert!(height.unwrap().plus(Dyadic::new(1.7)).and_then(Dyadic::least_not_below).is_some());
        }
    }

    #[test]
    fn halves_go_to_even_and_least_goes_up() {
        let at = |mantissa| Dyadic { mantissa, exponent: -1 };
        let odd = (1_i128 << 54) + 1;
        assert_eq!(at(odd).nearest(), Some(2_f64.powi(53)));
        assert_eq!(at(odd + 2).nearest(), Some(2_f64.powi(53) + 2.0));
        assert_eq!(at(odd).least_not_below(), Some(2_f64.powi(53) + 2.0));
        assert_eq!(at(-odd).least_not_below(), Some(-2_f64.powi(53)));
        assert_eq!(Dyadic { mantissa: 1, exponent: -1_000 }.nearest(), None);
        let all_ones = BigRational::from_integer(((1_i128 << 60) - 1).into());
        assert_eq!(Dyadic { mantissa: (1 << 60) - 1, exponent: 0 }.least_not_below(), least_not_below(&all_ones));
    }
}
