//! The finest surface at a point: which face holds it, how a point stands to that face, and heights above ground.
//!
//! The surface is linear on each triangle of the finest triangulation, whose edges lie on x in Z, y in Z, x - y in 2Z
//! and x + y in 2Z. Faces are found without rounding: the fractional part of an f64 is an f64, and whether two of them
//! add up to 1 is decided with the error of the sum at hand.

use num_bigint::{BigInt, BigUint};
use num_rational::BigRational;
use num_traits::{Signed, ToPrimitive, Zero};
use sightline_proto::{
    diamond::{Post, diagonal_rises},
    predicates::{Kernel, Sign, compare, orient2d_with, orient3d_with},
};

use super::{
    LosError, check_finite,
    dyadic::{self, Dyadic},
};
use crate::terrain::{Grid, HeightField, Posts, ReadError};

/// Binary logarithm of the least subnormal f64.
const LEAST_EXPONENT: i64 = -1074;
/// Steps of the last bit's weight from there to beyond the greatest f64.
const MAX_STEPS: u64 = 2_046;

/// A face of the finest triangulation.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Face {
    /// A post.
    Post([Post; 1]),
    /// An open edge, in order of growing x, or y where x stays.
    Edge([Post; 2]),
    /// An open triangle, counter-clockwise.
    Triangle([Post; 3]),
}

impl Face {
    /// Its corners.
    pub fn posts(&self) -> &[Post] {
        match self {
            Self::Post(posts) => posts,
            Self::Edge(posts) => posts,
            Self::Triangle(posts) => posts,
        }
    }

    /// The smallest face that contains the plan point (x, y); `None` outside the grid.
    pub(super) fn at(grid: Grid, [x, y]: [f64; 2]) -> Option<Self> {
        // By the bits, since a host may have subnormal numbers read as zero.
        let inside = |v: f64, posts: u32| compare(v, 0.0) != Sign::Negative && v <= f64::from(posts - 1);
        if !inside(x, grid.nx()) || !inside(y, grid.ny()) {
            return None;
        }
        let [fx, fy] = [x, y].map(|v| if v < 1.0 { v } else { v - v.floor() });
        let west_south = Post::new(x as u32, y as u32);
        let at = |i, j| Post::new(west_south.i + i, west_south.j + j);
        let is_whole = |fraction| compare(fraction, 0.0) == Sign::Zero;
        Some(match (is_whole(fx), is_whole(fy)) {
            (true, true) => Self::Post([west_south]),
            (true, false) => Self::Edge([west_south, at(0, 1)]),
            (false, true) => Self::Edge([west_south, at(1, 0)]),
            (false, false) if diagonal_rises(west_south) => match compare(fx, fy) {
                Sign::Positive => Self::Triangle([west_south, at(1, 0), at(1, 1)]),
                Sign::Zero => Self::Edge([west_south, at(1, 1)]),
                Sign::Negative => Self::Triangle([west_south, at(1, 1), at(0, 1)]),
            },
            (false, false) => match sum_against_one(fx, fy) {
                Sign::Positive => Self::Triangle([at(1, 0), at(1, 1), at(0, 1)]),
                Sign::Zero => Self::Edge([at(0, 1), at(1, 0)]),
                Sign::Negative => Self::Triangle([west_south, at(1, 0), at(0, 1)]),
            },
        })
    }

    /// The smallest face that has all posts of both among its corners, when there is one.
    pub(super) fn joined(&self, other: &Self) -> Option<Vec<Post>> {
        let mut posts = self.posts().to_vec();
        posts.extend(other.posts().iter().filter(|p| !self.posts().contains(p)));
        let adjacent = |p: Post, q: Post| {
            let (di, dj) = (p.i.abs_diff(q.i), p.j.abs_diff(q.j));
            di <= 1 && dj <= 1 && (di + dj < 2 || (diagonal_rises(p) && diagonal_rises(q)))
        };
        let one_face = posts.len() <= 3 && posts.iter().all(|&p| posts.iter().all(|&q| adjacent(p, q)));
        one_face.then_some(posts)
    }

    /// Reads the heights of the corners; `None` when one is void.
    pub(super) fn heights<H>(&self, posts: &mut Posts<'_, H>) -> Result<Option<[f64; 3]>, ReadError>
    where
        H: HeightField + ?Sized,
    {
        let mut heights = [0.0; 3];
        for (height, &p) in heights.iter_mut().zip(self.posts()) {
            let post = posts.at(p)?;
            if post.void {
                return Ok(None);
            }
            *height = post.z;
        }
        Ok(Some(heights))
    }

    /// Whether a point over the face is above (positive), on or below it, given the heights of its corners.
    pub(super) fn height_sign<K: Kernel>(&self, heights: [f64; 3], [x, y, z]: [f64; 3]) -> Sign {
        let corner = |n: usize, p: Post| [f64::from(p.i), f64::from(p.j), heights[n]];
        match *self {
            Self::Post(_) => compare(z, heights[0]),
            Self::Edge([p, q]) => {
                // In the upright plane of the edge, along its growing coordinate, left is up.
                let (from, to, at) = if p.i == q.i { (p.j, q.j, y) } else { (p.i, q.i, x) };
                orient2d_with::<K>([f64::from(from), heights[0]], [f64::from(to), heights[1]], [at, z])
            }
            Self::Triangle([p, q, r]) => orient3d_with::<K>(corner(0, p), corner(1, q), corner(2, r), [x, y, z]),
        }
    }
}

/// The sign of a + b - 1 for a and b between 0 and 1. Exact: rounding keeps order, so a rounded sum on either side of 1
/// tells; where it is 1, the error of the sum (Knuth's two-sum) does.
fn sum_against_one(a: f64, b: f64) -> Sign {
    let (sum, error) = two_sum(a, b);
    if sum == 1.0 { Sign::of(error) } else { compare(sum, 1.0) }
}

/// The known triangle, of those that have all posts of the face among their corners, whose centroid has the lowest
/// (j, i): counter-clockwise.
pub(super) fn known_triangle<H>(posts: &mut Posts<'_, H>, face: Face) -> Result<Option<[Post; 3]>, ReadError>
where
    H: HeightField + ?Sized,
{
    let first = face.posts()[0];
    let mut found: Option<([u64; 2], [Post; 3])> = None;
    for cell in [(1, 1), (0, 1), (1, 0), (0, 0)] {
        let (Some(i), Some(j)) = (first.i.checked_sub(cell.0), first.j.checked_sub(cell.1)) else { continue };
        for triangle in triangles_of_cell(Post::new(i, j)) {
            if !face.posts().iter().all(|p| triangle.contains(p)) {
                continue;
            }
            let sum = |of: fn(&Post) -> u32| triangle.iter().map(|p| u64::from(of(p))).sum::<u64>();
            let centroid = [sum(|p| p.j), sum(|p| p.i)];
            // Posts beyond the grid are void.
            if found.is_none_or(|(least, _)| centroid < least) && Face::Triangle(triangle).heights(posts)?.is_some() {
                found = Some((centroid, triangle));
            }
        }
    }
    Ok(found.map(|(_, triangle)| triangle))
}

/// The two triangles of the cell with that south-west corner, counter-clockwise.
fn triangles_of_cell(p: Post) -> [[Post; 3]; 2] {
    let [sw, se, nw, ne] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| Post::new(p.i + i, p.j + j));
    match diagonal_rises(p) {
        true => [[sw, se, ne], [sw, ne, nw]],
        false => [[sw, se, nw], [se, ne, nw]],
    }
}

/// The rounded sum of two numbers and its exact error (Knuth). The error is NaN when the sum overflows.
pub(super) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let of_b = sum - a;
    let of_a = sum - of_b;
    (sum, (a - of_a) + (b - of_b))
}

/// The height of the surface at a plan point, rounded to nearest; `None` over unknown ground.
pub fn surface_height<H: HeightField + ?Sized>(field: &H, x: f64, y: f64) -> Result<Option<f64>, LosError> {
    Ok(known_face(field, x, y)?.map(|(face, heights)| surface_over(face, heights, [x, y])))
}

/// The least f64 that is not below the exact surface plus `height` at a plan point; `None` over unknown ground.
///
/// This is how a height above ground becomes the end of a line of sight.
pub fn on_ground<H: HeightField + ?Sized>(field: &H, x: f64, y: f64, height: f64) -> Result<Option<f64>, LosError> {
    check_finite([x, y, height], ["x", "y", "height above ground"])?;
    let Some((face, heights)) = known_face(field, x, y)? else { return Ok(None) };
    let sum = dyadic::height_over(face, heights, [x, y]).and_then(|ground| ground.plus(Dyadic::new(height)));
    let least = sum.and_then(Dyadic::least_not_below).or_else(|| {
        let ground = exact_height_over(face, heights, [x, y].map(rational));
        least_not_below(&(ground + rational(height)))
    });
    least.map(Some).ok_or(LosError::OutOfRange { x, y, height })
}

/// The face at a plan point and the heights of its corners; `None` over unknown ground.
fn known_face<H: HeightField + ?Sized>(field: &H, x: f64, y: f64) -> Result<Option<(Face, [f64; 3])>, LosError> {
    check_finite([x, y, 0.0], ["x", "y", "z"])?;
    let Some(face) = Face::at(field.grid(), [x, y]) else { return Ok(None) };
    let heights = face.heights(&mut Posts::new(field))?;
    Ok(heights.map(|heights| (face, heights)))
}

/// The height of a known face's plane or line at a plan point over it.
pub(super) fn exact_height_over(face: Face, heights: [f64; 3], [x, y]: [BigRational; 2]) -> BigRational {
    let [p, q, r] = heights.map(rational);
    let offset = |of: Post| [&x - BigRational::from(BigInt::from(of.i)), &y - BigRational::from(BigInt::from(of.j))];
    match face {
        Face::Post(_) => p,
        Face::Edge([from, to]) => {
            let [dx, dy] = offset(from);
            let t = if from.i == to.i { dy } else { dx };
            &p + t * (&q - &p)
        }
        Face::Triangle([a, b, c]) => {
            // Legs are single steps and the triangle's doubled area is 1, so barycentric weights are whole sums.
            let [dx, dy] = offset(a);
            let leg = |to: Post| {
                [to.i, to.j].iter().zip([a.i, a.j]).map(|(&v, w)| i64::from(v) - i64::from(w)).collect::<Vec<_>>()
            };
            let (u, v) = (leg(b), leg(c));
            let times = |n: i64, w: &BigRational| BigRational::from(BigInt::from(n)) * w;
            let weight_b = times(v[1], &dx) - times(v[0], &dy);
            let weight_c = times(u[0], &dy) - times(u[1], &dx);
            &p + weight_b * (&q - &p) + weight_c * (&r - &p)
        }
    }
}

/// The height of a known face at a plan point over it, to nearest.
pub(super) fn surface_over(face: Face, heights: [f64; 3], at: [f64; 2]) -> f64 {
    let height = dyadic::height_over(face, heights, at).and_then(Dyadic::nearest);
    height.unwrap_or_else(|| exact_height_over(face, heights, at.map(rational)).to_f64().unwrap_or(0.0))
}

/// A finite f64 as a fraction.
pub(super) fn rational(v: f64) -> BigRational {
    // Only NaN and infinities have none, and those were refused.
    BigRational::from_float(v).unwrap_or_default()
}

/// The least f64 not below `value`; `None` when `value` is beyond the range. In whole numbers: a rounded quotient is far
/// off where a host has subnormal numbers flushed to zero.
pub(super) fn least_not_below(value: &BigRational) -> Option<f64> {
    if value.is_zero() {
        return Some(0.0);
    }
    let (numerator, denominator) = (value.numer().magnitude(), value.denom().magnitude());
    let bits = |v: &BigUint| v.bits() as i64;
    // The weight of the last of 53 or 54 bits.
    let mut exponent = (bits(numerator) - bits(denominator) - i64::from(f64::MANTISSA_DIGITS)).max(LEAST_EXPONENT);
    let mantissa = loop {
        let (left, right) = ((-exponent).max(0) as u64, exponent.max(0) as u64);
        let (numerator, denominator) = (numerator << left, denominator << right);
        let up = u64::from(value.is_positive() && !(&numerator % &denominator).is_zero());
        let mantissa = (numerator / denominator).to_u64()? + up;
        if mantissa <= 1 << f64::MANTISSA_DIGITS {
            break mantissa;
        }
        exponent += 1;
    };
    // The leading bit of a normal number carries into the exponent, as does a mantissa that was rounded up to 2^53.
    let steps = u64::try_from(exponent - LEAST_EXPONENT).ok().filter(|&steps| steps < MAX_STEPS)?;
    let magnitude = f64::from_bits((steps << (f64::MANTISSA_DIGITS - 1)) + mantissa);
    let is_negative = value.is_negative() && mantissa > 0;
    magnitude.is_finite().then_some(if is_negative { -magnitude } else { magnitude })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_least_number_not_below_is_that(v in any::<u64>().prop_map(f64::from_bits), n in -3..4_i64, d in 1..50_i64) {
            prop_assume!(v.is_finite());
            let value = rational(v) + BigRational::new(n.into(), d.into()) * rational(v);
            match least_not_below(&value) {
                Some(least) => {
                    prop_assert!(rational(least) >= value, "{least:e} for {v:e} and {n}/{d}");
                    prop_assert!(!least.next_down().is_finite() || rational(least.next_down()) < value);
                }
                None => prop_assert!(value.abs() > rational(f64::MAX)),
            }
        }
    }

    #[test]
    fn numbers_are_the_least_not_below_themselves() {
        for beyond in [2, 3, 4, 1_000] {
            assert_eq!(least_not_below(&(rational(f64::MAX) * rational(f64::from(beyond)))), None);
        }
        for v in [0.0, 1.0, -1.0, 5e-324, -5e-324, f64::MIN_POSITIVE, f64::MAX, -f64::MAX, 0.1, -1e-310] {
            assert_eq!(least_not_below(&rational(v)), Some(v));
        }
        assert_eq!(least_not_below(&(rational(f64::MAX) + rational(1.0))), None);
        assert_eq!(least_not_below(&(rational(-5e-324) / rational(2.0))), Some(0.0));
        assert_eq!(least_not_below(&(rational(5e-324) / rational(2.0))), Some(5e-324));
    }
}
