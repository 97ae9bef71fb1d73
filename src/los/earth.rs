//! The shape of the Earth under a line of sight, and the clearance of a line over one face as a quadratic.
//!
//! On a curved Earth the line AB is lowered by the bulge t (1 - t) L^2 / (2 k R): L is its plan length, R the radius
//! and k the factor by which refraction seems to enlarge it (4/3 is usual for radio; 1 is none; surveyors' coefficient
//! of refraction 0.13 is k = 1 / (1 - 0.13)). The definitions of the verdict stay the same, with the lowered line. The
//! bulge is symmetric in A and B, so verdicts are too.
//!
//! In the grid frame L^2 / (2 k R) is W = (bx - ax)^2 east + (by - ay)^2 north height units: two coefficients, taken at
//! their exact values like every other number. Over a face the ground is linear along AB, so the clearance is the
//! quadratic W t^2 + l t + c, whose coefficients are sums and products of f64: [`Number`] holds them exactly. It is
//! convex. Where it is not below zero at the ends of a chord, it is below inside exactly when it falls at the first
//! end, rises at the last and has two roots; equal roots touch.
//!
//! Inside a chord it is below the straight line between its ends by at most W d^2 / 4, d being the chord's length in
//! t. A chord lies in one cell, so that is at most (east + north) / 4: a tenth of a millimetre for posts 30 m apart.
//! Only chords with an end nearer than that to the ground need looking into.

use num_rational::BigRational;
use sightline_proto::{
    diamond::Post,
    number::{Dyadic, Interval, Number},
    predicates::{FLUSHED, Sign, are_equal, compare},
};

use super::{
    LosError,
    surface::{Face, rational},
    sweep::{Family, ROUNDOFF},
};
use crate::terrain::SceneScale;

/// The square root of the least number above 0.
const ROOT_OF_LEAST: f64 = f64::from_bits((1023 - 537) << 52);

/// The shape of the Earth under a line of sight.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub enum Earth {
    /// Lines are straight in the grid frame. What meshes are consistent with.
    #[default]
    Flat,
    /// Lines are lowered by the bulge of a sphere.
    Sphere(Curvature),
}

/// A bulge t (1 - t) ((bx - ax)^2 east + (by - ay)^2 north), in height units; see [`Earth::sphere`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Curvature {
    east: f64,
    north: f64,
}

impl Earth {
    /// A sphere of `radius_m` metres, seemingly enlarged by refraction `k`, under a grid of that scale. The two
    /// coefficients are rounded here, once; verdicts are exact for the rounded ones.
    pub fn sphere(radius_m: f64, k: f64, scale: SceneScale) -> Result<Self, LosError> {
        for (what, value) in [("the radius of the Earth", radius_m), ("the factor of refraction", k)] {
            if value.is_nan() || value <= 0.0 {
                return Err(LosError::OutOfBounds { what, value, must: "above 0" });
            }
        }
        let per_unit = 2.0 * k * radius_m * scale.up_m;
        Self::curved(scale.east_m * scale.east_m / per_unit, scale.north_m * scale.north_m / per_unit)
    }

    /// The coefficients of the bulge, in height units per post squared: finite, not below 0. Both 0 is flat.
    pub fn curved(east: f64, north: f64) -> Result<Self, LosError> {
        for (what, value) in [("curvature eastward", east), ("curvature northward", north)] {
            if !value.is_finite() || compare(value, 0.0) == Sign::Negative {
                return Err(LosError::OutOfBounds { what, value, must: "a finite number not below 0" });
            }
        }
        Ok(Self::Sphere(Curvature { east, north }))
    }

    /// The coefficients of the bulge east and north.
    pub fn coefficients(self) -> [f64; 2] {
        match self {
            Self::Flat => [0.0; 2],
            Self::Sphere(Curvature { east, north }) => [east, north],
        }
    }

    /// By how much a line between these ends in plan is lowered at `t`, as a part of it, in height units: within some
    /// ten roundings.
    pub fn bulge(self, a: [f64; 2], b: [f64; 2], t: f64) -> f64 {
        Line::new([a[0], a[1], 0.0], [b[0], b[1], 0.0], self).bulge(t)
    }

    /// Whether lines are straight.
    pub fn is_flat(self) -> bool {
        are_equal(self.coefficients(), [0.0; 2])
    }
}

/// AB over an Earth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) a: [f64; 3],
    pub(super) b: [f64; 3],
    earth: [f64; 2],
    /// The rounded W, off by less than 8 roundings.
    pub(super) bend: f64,
}

impl Line {
    pub(super) fn new(a: [f64; 3], b: [f64; 3], earth: Earth) -> Self {
        let earth = earth.coefficients();
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let part = |d: f64, by: f64| {
            if by >= f64::MIN_POSITIVE {
                return d * d * by;
            }
            // A subnormal coefficient, which may be read as zero, is a whole multiple of the least number.
            let (d, times) = (d * ROOT_OF_LEAST, (by.to_bits() << 1 >> 1) as f64);
            if times == 0.0 { 0.0 } else { times * d * d }
        };
        Self { a, b, earth, bend: part(dx, earth[0]) + part(dy, earth[1]) }
    }

    /// The Earth does not bend it: it is flat, or the line moves along no axis that is curved (not at all, if it is
    /// plumb).
    pub(super) fn is_straight(&self) -> bool {
        let is_same = |a: f64, b: f64| compare(a, b) == Sign::Zero;
        [0, 1].iter().all(|&axis| is_same(self.earth[axis], 0.0) || is_same(self.a[axis], self.b[axis]))
    }

    /// By how much the line is lowered at t.
    pub(super) fn bulge(&self, t: f64) -> f64 {
        if self.bend == 0.0 { 0.0 } else { self.bend * (t * (1.0 - t)) }
    }

    /// The error of [`Line::bulge`] where t is off by at most `t_error`: W is off by 8 u W, t (1 - t) by t_error and
    /// two roundings, and the product by another; twice that, and all underflow.
    pub(super) fn bulge_error(&self, t_error: f64) -> f64 {
        if self.is_straight() { 0.0 } else { self.bend * (t_error + 16.0 * ROUNDOFF) + FLUSHED }
    }

    pub(super) fn exact_bulge(&self, t: &BigRational) -> BigRational {
        if self.is_straight() {
            return BigRational::default();
        }
        let part = |axis: usize| {
            let d = rational(self.b[axis]) - rational(self.a[axis]);
            &d * &d * rational(self.earth[axis])
        };
        (part(0) + part(1)) * t * (BigRational::from_integer(1.into()) - t)
    }

    /// More than the clearance inside any chord is below the straight line between its ends.
    pub(super) fn sag(&self) -> f64 {
        0.26 * (self.earth[0] + self.earth[1])
    }
}

/// A parameter of AB, exactly.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum At {
    A,
    B,
    /// Where AB crosses line c of a family, on which the family's function grows or falls from A to B.
    Line {
        family: Family,
        c: i64,
        grows: bool,
    },
}

/// A fraction n / d with d above 0.
pub(super) struct Fraction<N> {
    pub(super) n: N,
    pub(super) d: N,
}

impl<N: Number> Fraction<N> {
    pub(super) fn new(line: &Line, at: At) -> Self {
        match at {
            At::A => Self { n: N::of(0.0), d: N::of(1.0) },
            At::B => Self { n: N::of(1.0), d: N::of(1.0) },
            At::Line { family, c, grows } => {
                let function = |[x, y, _]: [f64; 3]| match family {
                    Family::Column => N::of(x),
                    Family::Row => N::of(y),
                    Family::Rising => N::of(x).sub(&N::of(y)),
                    Family::Falling => N::of(x).add(&N::of(y)),
                };
                let (from, to, c) = (function(line.a), function(line.b), N::of(c as f64));
                match grows {
                    true => Self { n: c.sub(&from), d: to.sub(&from) },
                    false => Self { n: from.sub(&c), d: from.sub(&to) },
                }
            }
        }
    }
}

/// The ground of a face, extended to the whole plane: z + (x - i) east + (y - j) north, each slope a difference.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) post: Post,
    pub(super) z: f64,
    pub(super) east: [f64; 2],
    pub(super) north: [f64; 2],
}

impl Plane {
    /// Of one, two or three posts of one face with their heights. That of an edge is level across it.
    pub(super) fn new(face: Face, heights: [f64; 3]) -> Self {
        let posts = face.posts();
        let level = Self { post: posts[0], z: heights[0], east: [0.0; 2], north: [0.0; 2] };
        let rise = |same: fn(Post, Post) -> bool, along: fn(Post) -> u32| {
            let pairs = [(0, 1), (1, 2), (0, 2)].into_iter().filter(|&(_, q)| q < posts.len());
            let found = pairs.filter(|&(p, q)| same(posts[p], posts[q])).map(|(p, q)| [p, q]).next();
            found.map(|[p, q]| match along(posts[p]) < along(posts[q]) {
                true => [heights[p], heights[q]],
                false => [heights[q], heights[p]],
            })
        };
        let east = rise(|p, q| p.j == q.j, |p| p.i);
        let north = rise(|p, q| p.i == q.i, |p| p.j);
        // A diagonal rises with x alone.
        let diagonal = (posts.len() == 2 && east.is_none() && north.is_none())
            .then(|| if posts[0].i < posts[1].i { [heights[0], heights[1]] } else { [heights[1], heights[0]] });
        Self { east: east.or(diagonal).unwrap_or([0.0; 2]), north: north.unwrap_or([0.0; 2]), ..level }
    }
}

/// The clearance W t^2 + l t + c of a line over a plane.
pub(super) struct Quadratic<N> {
    pub(super) w: N,
    pub(super) l: N,
    pub(super) c: N,
}

impl<N: Number> Quadratic<N> {
    pub(super) fn new(line: &Line, plane: &Plane) -> Self {
        let from = line.a.map(N::of);
        let by = [0, 1, 2].map(|k| N::of(line.b[k]).sub(&from[k]));
        let [east, north] = line.earth.map(N::of);
        let slope = |[low, high]: [f64; 2]| N::of(high).sub(&N::of(low));
        let (gx, gy) = (slope(plane.east), slope(plane.north));
        let w = by[0].mul(&by[0]).mul(&east).add(&by[1].mul(&by[1]).mul(&north));
        let l = by[2].sub(&w).sub(&gx.mul(&by[0])).sub(&gy.mul(&by[1]));
        let away = [from[0].sub(&N::of(f64::from(plane.post.i))), from[1].sub(&N::of(f64::from(plane.post.j)))];
        let c = from[2].sub(&N::of(plane.z)).sub(&gx.mul(&away[0])).sub(&gy.mul(&away[1]));
        Self { w, l, c }
    }

    /// The clearance at n / d, times d^2.
    pub(super) fn at(&self, Fraction { n, d }: &Fraction<N>) -> N {
        self.w.mul(n).add(&self.l.mul(d)).mul(n).add(&self.c.mul(&d.mul(d)))
    }

    /// The derivative at n / d, times d.
    fn slope_at(&self, Fraction { n, d }: &Fraction<N>) -> N {
        let wn = self.w.mul(n);
        wn.add(&wn).add(&self.l.mul(d))
    }

    fn discriminant(&self) -> N {
        let wc = self.w.mul(&self.c);
        let twice = wc.add(&wc);
        self.l.mul(&self.l).sub(&twice.add(&twice))
    }
}

/// What a line does inside a chord at whose ends it is not below ground.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Dip {
    /// It stays above, or follows the ground.
    None,
    Touches,
    Below,
}

/// The exact sign of the clearance over a plane at a parameter.
#[cold]
pub(super) fn clearance_sign(line: &Line, plane: &Plane, at: At) -> Sign {
    fn value<N: Number>(line: &Line, plane: &Plane, at: At) -> Option<Sign> {
        Quadratic::<N>::new(line, plane).at(&Fraction::new(line, at)).sign()
    }
    value::<Interval>(line, plane, at).or_else(|| value::<Dyadic>(line, plane, at)).unwrap_or(Sign::Zero)
}

/// What the line does between two parameters at which it is not below the plane. Exact.
#[cold]
pub(super) fn dip(line: &Line, plane: &Plane, ends: [At; 2]) -> Dip {
    fn found<N: Number>(line: &Line, plane: &Plane, [from, to]: [At; 2]) -> Option<Dip> {
        let quadratic = Quadratic::<N>::new(line, plane);
        let falls = quadratic.slope_at(&Fraction::new(line, from)).sign()? == Sign::Negative;
        let rises = quadratic.slope_at(&Fraction::new(line, to)).sign()? == Sign::Positive;
        if !(falls && rises) {
            return Some(Dip::None);
        }
        Some(match quadratic.discriminant().sign()? {
            Sign::Negative => Dip::None,
            Sign::Zero => Dip::Touches,
            Sign::Positive => Dip::Below,
        })
    }
    found::<Interval>(line, plane, ends).or_else(|| found::<Dyadic>(line, plane, ends)).unwrap_or(Dip::None)
}
