//! Where a blocked line is first obstructed, exactly: what [`super::Fidelity::Obstruction`] compares.
//!
//! The infimum of the points of AB strictly below a triangle is an end of the chord over it, or where the line goes
//! through its plane: a quotient of polynomials of the input, compared as fractions.

use num_rational::BigRational;
use num_traits::{One, Signed, Zero};
use sightline_proto::diamond::Triangle;

use super::{RequiredLine, ground::Ground, stable::path};
use crate::{
    los::{self, LosError},
    roam::Terrain,
    terrain::{ReadError, SceneScale},
};

/// The true first obstruction of a line, and how far off a mesh's may be.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Aim {
    /// As a part of AB.
    at: BigRational,
    /// The square of the distance allowed, as a part of AB; `None` for a line without length.
    reach_squared: Option<BigRational>,
    /// The finest triangle that the line goes under there.
    pub(super) face: Triangle,
}

impl Aim {
    /// The aim of a blocked line; `None` where it passes an unknown point first.
    pub(super) fn of<T: Terrain>(
        ground: &Ground<'_, T>,
        scale: SceneScale,
        line: &RequiredLine,
        distance_m: f64,
    ) -> Result<Option<Self>, ReadError> {
        let (a, b) = (line.a, line.b);
        let first = match los::known_obstruction(ground.terrain(), a, b) {
            Ok(first) => first,
            Err(LosError::Read(error)) => return Err(error),
            Err(_) => None,
        };
        let Some([p, q, r]) = first.and_then(|first| first.triangle) else { return Ok(None) };
        // Only its corners count for the way to it.
        let corners = Triangle { apex: p, e0: r, e1: q };
        let Some(face) = path(ground.grid().root().roots(), &corners).last() else { return Ok(None) };
        let grid = (ground.grid().nx(), ground.grid().ny());
        let Some(at) = first_below(a, b, ground.in_space(&face)?, grid) else { return Ok(None) };
        let step = |k: usize, metres: f64| (exact(b[k]) - exact(a[k])) * exact(metres);
        let parts = [step(0, scale.east_m), step(1, scale.north_m), step(2, scale.up_m)];
        let length_squared = parts.into_iter().fold(BigRational::zero(), |sum, part| sum + &part * &part);
        let distance = exact(distance_m);
        let reach_squared = (!length_squared.is_zero()).then(|| &distance * &distance / length_squared);
        Ok(Some(Self { at, reach_squared, face }))
    }

    /// Whether an obstruction at `t` is near enough to the true one.
    pub(super) fn is_near(&self, t: &BigRational) -> bool {
        let off = t - &self.at;
        self.reach_squared.as_ref().is_none_or(|reach| &off * &off <= *reach)
    }

    /// Whether an obstruction at `t` comes too early.
    pub(super) fn is_early(&self, t: &BigRational) -> bool {
        *t < self.at && !self.is_near(t)
    }
}

/// The infimum, as a part of AB, of the points of AB over a closed triangle and the grid rectangle (`grid` posts east and
/// north) that lie strictly below its plane; `None` when none do. Corners turn counter-clockwise. Exact.
pub(super) fn first_below(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], grid: (u32, u32)) -> Option<BigRational> {
    let [a, b] = [a, b].map(|p| p.map(exact));
    let [p, q, r] = corners.map(|p| p.map(exact));
    let mut chord = [BigRational::zero(), BigRational::one()];
    let side = |u: &[BigRational; 3], v: &[BigRational; 3], x: &[BigRational; 3]| {
        (&v[0] - &u[0]) * (&x[1] - &u[1]) - (&v[1] - &u[1]) * (&x[0] - &u[0])
    };
    for (u, v) in [(&p, &q), (&q, &r), (&r, &p)] {
        cut(&mut chord, side(u, v, &a), side(u, v, &b));
    }
    for (k, posts) in [(0, grid.0), (1, grid.1)] {
        let last = exact(f64::from(posts - 1));
        cut(&mut chord, a[k].clone(), b[k].clone());
        cut(&mut chord, &last - &a[k], last - &b[k]);
    }
    let [from, to] = chord;
    if from > to {
        return None;
    }
    let area = side(&p, &q, &r);
    // Height over the plane times the area, which is positive.
    let over = |x: &[BigRational; 3]| {
        &area * &x[2] - side(&q, &r, x) * &p[2] - side(&r, &p, x) * &q[2] - side(&p, &q, x) * &r[2]
    };
    let (at_a, at_b) = (over(&a), over(&b));
    let at = |t: &BigRational| &at_a + t * (&at_b - &at_a);
    let (first, last) = (at(&from), at(&to));
    match (first.is_negative(), last.is_negative()) {
        (true, _) => Some(from),
        (false, true) => Some(&from + (&to - &from) * &first / (&first - &last)),
        (false, false) => None,
    }
}

/// Keeps of a chord where a linear function with these values at A and B is not negative.
fn cut(chord: &mut [BigRational; 2], at_a: BigRational, at_b: BigRational) {
    let zero = |p: &BigRational, q: &BigRational| p / (p - q);
    match (at_a.is_negative(), at_b.is_negative()) {
        (true, true) => chord[1] = -BigRational::one(),
        (true, false) => {
            let t = zero(&at_a, &at_b);
            if t > chord[0] {
                chord[0] = t;
            }
        }
        (false, true) => {
            let t = zero(&at_a, &at_b);
            if t < chord[1] {
                chord[1] = t;
            }
        }
        (false, false) => {}
    }
}

/// A finite number as a fraction; what is none counts as zero, and its line never gets here.
fn exact(v: f64) -> BigRational {
    BigRational::from_float(v).unwrap_or_else(BigRational::zero)
}
