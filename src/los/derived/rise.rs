//! How high the ground stands in the view from A, compared exactly.
//!
//! The *rise* of a point of the ground at t is the height of B, less that of A, at which the line lowered by its bulge
//! passes through it: -C / t, with C the clearance there of a level line. The line from A to the ground at t is BLOCKED
//! exactly when the rise is greater somewhere before: W t (t - s) is the bulge at s of the line that ends at t, and W
//! (1 - t) is what the rises at t and s have less and more.
//!
//! Over a face C is W t^2 + l t + c, so the rise is -(W t + l + c / t). On a flat Earth it only grows or falls along a
//! chord. On a curved one it grows as far as t^2 = c / W, where it is -(l + 2 sqrt(c W)), and then falls: ground bends
//! away. Signs of sums with such roots follow from squares, so no comparison rounds.

use sightline_proto::{
    number::{Dyadic, Interval, Number},
    predicates::{FLUSHED, Sign},
};

use super::event::Event;
use crate::los::{
    earth::{At, Fraction, Line, Plane, Quadratic},
    sweep::ROUNDOFF,
};

/// A place where the ground stands highest so far.
#[derive(Clone, Copy, Debug)]
pub(super) enum Crest {
    /// An event beyond A.
    Event(Event),
    /// On a curved Earth, the place on a face beyond which the ground bends away.
    Tangent(Tangent),
}

/// See [`Crest::Tangent`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Tangent {
    pub(super) plane: Plane,
    /// Where, rounded.
    pub(super) t: f64,
    /// Its rise, rounded, and a bound of the error of that.
    pub(super) rise: f64,
    pub(super) error: f64,
}

impl Crest {
    /// The rise, rounded, and a bound of its error.
    pub(super) fn rise(&self) -> (f64, f64) {
        match self {
            Self::Event(event) => {
                let (t, rise) = (event.place.t, -event.place.clearance / event.place.t);
                // Off by the errors of clearance and t over t, and by roundings; doubled.
                (rise, 2.0 * (event.error + rise.abs() * event.t_error) / t + 16.0 * ROUNDOFF * rise.abs())
            }
            Self::Tangent(tangent) => (tangent.rise, tangent.error),
        }
    }
}

/// The sign of the rise at one place less that at another. Exact.
pub(super) fn order(line: &Line, one: &Crest, other: &Crest) -> Sign {
    if let (Crest::Event(one), Crest::Event(other)) = (one, other)
        && let Some(sign) = rounded_order(one, other)
    {
        return sign;
    }
    exact_order::<Interval>(line, one, other).or_else(|| exact_order::<Dyadic>(line, one, other)).unwrap_or(Sign::Zero)
}

/// The order of the rises is that of c' t and c t', for the clearances c. The rounded products are each off by at most
/// |c| t_error + error t + error t_error and two roundings.
fn rounded_order(event: &Event, other: &Event) -> Option<Sign> {
    let product = |c: &Event, t: &Event| {
        let (clearance, t_at) = (c.place.clearance, t.place.t);
        let value = clearance * t_at;
        let bound = clearance.abs() * t.t_error + c.error * (t_at + t.t_error) + 4.0 * ROUNDOFF * value.abs();
        (value, 1.01 * bound + FLUSHED)
    };
    let ((left, left_error), (right, right_error)) = (product(other, event), product(event, other));
    let (difference, bound) = (left - right, left_error + right_error);
    match difference {
        d if d > bound => Some(Sign::Positive),
        d if d < -bound => Some(Sign::Negative),
        _ => None,
    }
}

fn exact_order<N: Number>(line: &Line, one: &Crest, other: &Crest) -> Option<Sign> {
    match (one, other) {
        (Crest::Event(one), Crest::Event(other)) => {
            // Over the denominators of both, which are above 0 and cancel.
            let ((clearance, t), (other_clearance, other_t)) = (at::<N>(line, one), at::<N>(line, other));
            other_clearance.mul(&t).sub(&clearance.mul(&other_t)).sign()
        }
        (Crest::Event(event), Crest::Tangent(tangent)) => against_tangent::<N>(line, event, tangent),
        (Crest::Tangent(tangent), Crest::Event(event)) => against_tangent::<N>(line, event, tangent).map(|sign| -sign),
        (Crest::Tangent(one), Crest::Tangent(other)) => {
            let [one, other] = [one, other].map(|tangent| Quadratic::<N>::new(line, &tangent.plane));
            // l' - l + 2 sqrt(c' W) - 2 sqrt(c W).
            let [x, y] = [&other, &one].map(|q| four(&q.c.mul(&q.w)));
            sign_with_roots(&other.l.sub(&one.l), &x, &y)
        }
    }
}

/// The clearance at an event times d^2, and t times d^2, for the denominator d of t.
fn at<N: Number>(line: &Line, event: &Event) -> (N, N) {
    let t = Fraction::<N>::new(line, event.at);
    let clearance = Quadratic::new(line, &Plane::new(event.face, event.heights)).at(&t);
    (clearance, t.n.mul(&t.d))
}

/// The sign of -C / t + l + 2 sqrt(c W).
fn against_tangent<N: Number>(line: &Line, event: &Event, tangent: &Tangent) -> Option<Sign> {
    let (clearance, t) = at::<N>(line, event);
    let Quadratic { w, l, c } = Quadratic::<N>::new(line, &tangent.plane);
    sign_with_root(&l.mul(&t).sub(&clearance), &four(&c.mul(&w)).mul(&t.mul(&t)))
}

fn four<N: Number>(v: &N) -> N {
    let twice = v.add(v);
    twice.add(&twice)
}

/// The sign of u + sqrt(v), for v not below 0.
fn sign_with_root<N: Number>(u: &N, v: &N) -> Option<Sign> {
    match u.sign()? {
        Sign::Positive => Some(Sign::Positive),
        Sign::Zero => v.sign(),
        Sign::Negative => v.sub(&u.mul(u)).sign(),
    }
}

/// The sign of u + sqrt(x) - sqrt(y), for x and y not below 0.
fn sign_with_roots<N: Number>(u: &N, x: &N, y: &N) -> Option<Sign> {
    match sign_with_root(u, x)? {
        Sign::Negative => Some(Sign::Negative),
        Sign::Zero => Some(-y.sign()?),
        Sign::Positive => {
            // The sign of (u + sqrt(x))^2 - y = p + 2 u sqrt(x).
            let square = u.mul(u);
            let (p, root) = (square.add(x).sub(y), four(&square.mul(x)));
            match u.sign()? {
                Sign::Negative => sign_with_root(&N::of(0.0).sub(&p), &root).map(|sign| -sign),
                _ => sign_with_root(&p, &root),
            }
        }
    }
}

/// Whether the rise over a plane grows (positive) at a parameter: the sign of c - W t^2. Exact.
pub(super) fn growth(line: &Line, plane: &Plane, at: At) -> Sign {
    fn exact<N: Number>(line: &Line, plane: &Plane, at: At) -> Option<Sign> {
        let Fraction { n, d } = Fraction::<N>::new(line, at);
        let Quadratic { w, c, .. } = Quadratic::<N>::new(line, plane);
        c.mul(&d.mul(&d)).sub(&w.mul(&n.mul(&n))).sign()
    }
    exact::<Interval>(line, plane, at).or_else(|| exact::<Dyadic>(line, plane, at)).unwrap_or(Sign::Zero)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_with_roots_are_those_of_real_numbers() {
        for (u, x, y) in (-9..=9).flat_map(|u| (0..=30).flat_map(move |x| (0..=30).map(move |y| (u, x, y)))) {
            let [a, b, c] = [u, x, y].map(|v: i32| f64::from(v));
            let value = a + b.sqrt() - c.sqrt();
            // Such sums are zero or not near it, and f64 tells which.
            let expected = if value.abs() < 1e-12 { Sign::Zero } else { Sign::of(value) };
            let [u, x, y] = [a, b, c].map(Dyadic::of);
            assert_eq!(sign_with_roots(&u, &x, &y), Some(expected), "{a} {b} {c}");
        }
    }
}
