//! The points where AB meets edges and posts, in exact order, with the clearance of each.
//!
//! What is exact: which faces AB meets, in which order, and whether it is above, on or below the ground there. What is
//! rounded: parameter and clearance, within the errors of [`crate::los::sweep`] where those are small (some 1e-15 of
//! the line's extent and of the heights), and to nearest where they would not be: there the crossing is computed in
//! fractions.

use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::ToPrimitive;
use sightline_proto::{
    diamond::Post,
    predicates::{Exact, FLUSHED, Sign, plan},
    verdict::LinePoint,
};

use super::{
    Place,
    ahead::{Ahead, Stretch},
    trail::{Step, Trail},
};
use crate::{
    los::{
        earth::{At, Dip, Line, Plane, clearance_sign, dip},
        surface::{Face, exact_height_over, rational, surface_over},
        sweep::{Crossing, Family, ROUNDOFF, Span, Sweep},
        walk::{Found, Walk},
    },
    terrain::{HeightField, ReadError},
};

/// A point where AB meets a face of lower dimension, or an end of AB.
#[derive(Clone, Copy, Debug)]
pub(in crate::los) struct Event {
    pub(in crate::los) point: LinePoint,
    pub(in crate::los) at: At,
    pub(in crate::los) face: Face,
    /// Of the face's posts.
    pub(in crate::los) heights: [f64; 3],
    pub(in crate::los) place: Place,
    /// The exact sign of the clearance; `None` over unknown ground.
    pub(in crate::los) sign: Option<Sign>,
    /// Bound of the error of the clearance.
    pub(in crate::los) error: f64,
    /// Bound of the error of t.
    pub(in crate::los) t_error: f64,
}

impl Event {
    pub(in crate::los) fn is_below(&self) -> bool {
        self.sign == Some(Sign::Negative)
    }

    pub(in crate::los) fn is_known(&self) -> bool {
        self.sign.is_some()
    }

    /// Whether the event lies strictly between the ends.
    pub(in crate::los) fn is_inside(&self) -> bool {
        matches!(self.at, At::Line { .. })
    }

    /// Depth below known ground, or 0.
    pub(in crate::los) fn depth(&self) -> f64 {
        if self.is_below() { -self.place.clearance } else { 0.0 }
    }

    /// Makes the rounded clearance agree with the exact sign, by a number that no processor's mode takes for zero.
    fn settled(mut self) -> Self {
        let clearance = self.place.clearance;
        self.place.clearance = match self.sign {
            Some(Sign::Positive) => clearance.max(f64::MIN_POSITIVE),
            Some(Sign::Negative) => clearance.min(-f64::MIN_POSITIVE),
            _ => 0.0,
        };
        self
    }
}

/// The stretch of AB between two events that follow each other over known ground of one face.
#[derive(Clone, Copy, Debug)]
pub(in crate::los) struct Chord {
    pub(in crate::los) from: Event,
    pub(in crate::los) to: Event,
    /// The least known face that holds it.
    pub(in crate::los) face: Face,
    /// Of the face's posts.
    pub(in crate::los) heights: [f64; 3],
    /// What the line does inside, where it is not below ground at the ends.
    pub(in crate::los) dip: Dip,
    /// W times the square of the chord's length in t.
    pub(in crate::los) bend: f64,
}

impl Chord {
    /// `None` when some of it is not known.
    pub(in crate::los) fn new(line: &Line, from: Event, to: Event) -> Option<Self> {
        if !(from.is_known() && to.is_known()) {
            return None;
        }
        let (face, heights) = joined(&from, &to)?;
        let length = to.place.t - from.place.t;
        let mut chord = Self { from, to, face, heights, dip: Dip::None, bend: line.bend * length * length };
        let near = |e: &Event| e.place.clearance - e.error <= line.sag();
        // Written so that what is not a number is looked into.
        if !line.is_straight() && !from.is_below() && !to.is_below() && (near(&from) || near(&to)) {
            chord.dip = dip(line, &Plane::new(face, heights), [from.at, to.at]);
        }
        Some(chord)
    }

    /// The point of the chord at share `s`, with the clearance given.
    pub(in crate::los) fn place(&self, s: f64, clearance: f64) -> Place {
        let (from, to) = (&self.from.place, &self.to.place);
        let s = if s.is_nan() { 0.0 } else { s.clamp(0.0, 1.0) };
        let between = |from: f64, to: f64| if s == 1.0 { to } else { from + s * (to - from) };
        Place { point: [0, 1, 2].map(|k| between(from.point[k], to.point[k])), t: between(from.t, to.t), clearance }
    }

    /// Where the line goes below ground on the chord, as a share of it. It must do so.
    pub(in crate::los) fn enters(&self) -> f64 {
        falls_to_zero(self.from.place.clearance, self.to.place.clearance, self.bend)
    }

    /// Where it comes up.
    pub(in crate::los) fn leaves(&self) -> f64 {
        1.0 - falls_to_zero(self.to.place.clearance, self.from.place.clearance, self.bend)
    }

    /// The lowest place inside the chord, where it is lower than at both ends. Of a straight line there is none.
    pub(in crate::los) fn lowest(&self) -> Option<Place> {
        let (from, to) = (self.from.place.clearance, self.to.place.clearance);
        // from + s (to - from) - bend s (1 - s) has its vertex at:
        let s = 0.5 - 0.5 * ((to - from) / self.bend);
        if !(s > 0.0 && s < 1.0) && self.dip == Dip::None {
            return None;
        }
        let s = s.clamp(0.0, 1.0);
        let clearance = from + s * (to - from) - self.bend * s * (1.0 - s);
        let least = f64::MIN_POSITIVE;
        let clearance = match self.dip {
            Dip::Below => clearance.min(-least),
            Dip::Touches => 0.0,
            Dip::None if self.from.is_below() || self.to.is_below() => clearance,
            Dip::None => clearance.max(least),
        };
        Some(self.place(s, clearance))
    }
}

/// The first share s with from + s (to - from) - bend s (1 - s) = 0, where from is not below 0 and something is.
fn falls_to_zero(from: f64, to: f64, bend: f64) -> f64 {
    let b = to - from - bend;
    if bend == 0.0 {
        return from / (from - to);
    }
    // Of the two forms of a root the one without cancelling, since b is negative here.
    2.0 * from / (-b + (b * b - 4.0 * bend * from).max(0.0).sqrt())
}

/// The posts of both faces, when they belong to one.
fn joined(from: &Event, to: &Event) -> Option<(Face, [f64; 3])> {
    let (mut posts, mut heights, mut count) = ([Post::new(0, 0); 3], [0.0; 3], 0);
    for event in [from, to] {
        for (&post, &height) in event.face.posts().iter().zip(&event.heights) {
            if posts[..count].contains(&post) {
                continue;
            }
            if count == 3 {
                return None;
            }
            (posts[count], heights[count]) = (post, height);
            count += 1;
        }
    }
    let face = match count {
        1 => Face::Post([posts[0]]),
        2 => Face::Edge([posts[0], posts[1]]),
        _ => Face::Triangle(posts),
    };
    Some((face, heights))
}

/// Goes along AB from event to event.
pub(in crate::los) struct Events<'w, 'a, H: HeightField + ?Sized> {
    walk: &'w mut Walk<'a, H>,
    pub(in crate::los) line: Line,
    trail: Option<Trail>,
    /// 0 before A, 1 between, 2 after B.
    stage: u8,
    ahead: Option<Ahead>,
    /// The length in t of the next stretch to be tried, and from where on to try again.
    stride: f64,
    try_from: f64,
    /// The greatest t so far: rounded ones of close crossings may be out of order by their errors, true ones are not.
    reached: f64,
}

impl<'w, 'a, H: HeightField + ?Sized> Events<'w, 'a, H> {
    /// The ends must be finite.
    pub(in crate::los) fn new(walk: &'w mut Walk<'a, H>, line: Line) -> Self {
        let (a, b) = (line.a, line.b);
        (walk.a, walk.b) = (a, b);
        let grid = walk.posts.grid();
        let trail = Span::new(grid, a, b)
            .map(|span| Trail::new(Family::ALL.map(|family| Sweep::new(family, grid, span, a, b)), plan(a), plan(b)));
        let ahead = trail.as_ref().and_then(|trail| Ahead::new(walk, &line, &trail.sweeps));
        let stride = ahead.as_ref().map_or(1.0, |ahead| ahead.leaf);
        Self { walk, line, trail, stage: 0, ahead, stride, try_from: 0.0, reached: 0.0 }
    }

    /// Passes over stretches that are over known ground and of which `clear` says that nothing in them matters. Returns
    /// the last event passed, if any was: all between the event before and this one is known and clear.
    pub(in crate::los) fn pass(&mut self, clear: impl Fn(&Stretch) -> bool) -> Result<Option<Event>, ReadError> {
        let (Some(ahead), Some(trail)) = (&self.ahead, &mut self.trail) else { return Ok(None) };
        let begin = self.reached;
        if self.stage != 1 || begin < self.try_from {
            return Ok(None);
        }
        let mut t = begin;
        while t < 1.0 {
            let end = (t + self.stride).min(1.0);
            if ahead.stretch(self.walk, t, end)?.is_some_and(|stretch| clear(&stretch)) {
                t = end;
                self.stride *= 2.0;
            } else if self.stride > ahead.leaf {
                self.stride /= 2.0;
            } else {
                self.try_from = end;
                break;
            }
        }
        if t == begin || !trail.pass(t) {
            return Ok(None);
        }
        let Some(step) = trail.before() else { return Ok(None) };
        let event = self.crossing(step)?;
        Ok(event.map(|event| self.in_order(event)))
    }

    /// The event with a t that is not less than that of the one before.
    fn in_order(&mut self, mut event: Event) -> Event {
        self.reached = event.place.t.clamp(self.reached, 1.0);
        event.place.t = self.reached;
        event
    }

    /// The next event in the grid.
    pub(in crate::los) fn step(&mut self) -> Result<Option<Event>, ReadError> {
        if self.stage == 0 {
            self.stage = 1;
            if let Some(event) = self.end(At::A)? {
                return Ok(Some(event));
            }
        }
        while let Some(step) = self.trail.as_mut().and_then(Trail::step) {
            if let Some(event) = self.crossing(step)? {
                return Ok(Some(self.in_order(event)));
            }
        }
        if self.stage == 1 {
            self.stage = 2;
            return self.end(At::B);
        }
        Ok(None)
    }

    pub(in crate::los) fn walk(&mut self) -> &mut Walk<'a, H> {
        self.walk
    }

    /// The event at an end; `None` outside the grid.
    fn end(&mut self, end: At) -> Result<Option<Event>, ReadError> {
        let (at, t, point) = match end {
            At::A => (self.line.a, 0.0, LinePoint::A),
            _ => (self.line.b, 1.0, LinePoint::B),
        };
        let Some(face) = Face::at(self.walk.posts.grid(), plan(at)) else { return Ok(None) };
        let heights = face.heights(&mut self.walk.posts)?;
        let clearance = heights.map_or(0.0, |heights| at[2] - surface_over(face, heights, plan(at)));
        let sign = heights.map(|heights| face.height_sign::<Exact>(heights, at));
        let error = 2.0 * ROUNDOFF * (at[2].abs() + clearance.abs());
        let place = Place { point: at, t, clearance };
        let heights = heights.unwrap_or_default();
        Ok(Some(Event { point, at: end, face, heights, place, sign, error, t_error: 0.0 }.settled()))
    }

    /// A crossing as an event; `None` outside the grid.
    fn crossing(&mut self, Step { sweep, n }: Step) -> Result<Option<Event>, ReadError> {
        let Some(sweep) = self.trail.as_ref().map(|trail| trail.sweeps[sweep]) else { return Ok(None) };
        let (family, crossing) = (sweep.family, sweep.crossing(n));
        let Some((v, on_post)) = self.stand(&sweep, crossing) else { return Ok(None) };
        let p = family.post(crossing.c, v);
        let (point, face) = if on_post {
            // Any line through the post that AB is not parallel to; its second post need not be in the grid.
            let across =
                if self.line.a[1] == self.line.b[1] { Post::new(p.i, p.j + 1) } else { Post::new(p.i + 1, p.j) };
            (LinePoint::Crossing(p, across), Face::Post([p]))
        } else {
            let q = family.post(crossing.c, v + 1);
            (LinePoint::Crossing(p, q), Face::Edge([p, q]))
        };
        let at = At::Line { family, c: crossing.c, grows: sweep.turn == family.turn() };
        let heights = face.heights(&mut self.walk.posts)?;
        let rounded = sweep.trusted && self.line.bend.is_finite();
        let (place, error) = match rounded {
            true => self.rounded(&sweep, crossing, v, on_post, heights),
            false => self.nearest(family, crossing.c, face, heights),
        };
        let sign = match heights {
            None => None,
            Some(_) if place.clearance > error => Some(Sign::Positive),
            Some(_) if place.clearance < -error => Some(Sign::Negative),
            Some(heights) if !self.line.is_straight() => {
                Some(clearance_sign(&self.line, &Plane::new(face, heights), at))
            }
            Some(_) => match self.walk.cross::<Exact>(&sweep, n)? {
                Found::Known(sign) => Some(sign),
                Found::Unknown | Found::Outside => None,
            },
        };
        let (heights, t_error) = (heights.unwrap_or_default(), if rounded { sweep.t_error } else { ROUNDOFF });
        Ok(Some(Event { point, at, face, heights, place, sign, error, t_error }.settled()))
    }

    /// The post at or before a crossing, and whether the crossing is on it; `None` outside the grid.
    fn stand(&self, sweep: &Sweep, crossing: Crossing) -> Option<(i64, bool)> {
        let (first, last) = sweep.family.posts(crossing.c, self.walk.posts.grid());
        let error = sweep.v_error;
        if sweep.trusted && crossing.v > first as f64 + error && crossing.v < last as f64 - error {
            let v = crossing.v as i64;
            let fraction = crossing.v - v as f64;
            if fraction > error && 1.0 - fraction > error {
                return Some((v, false));
            }
        }
        self.walk.place::<Exact>(sweep, crossing)
    }

    /// The place of a crossing between posts `v` and `v + 1`, or on the first, within the errors of the sweep; and the
    /// bound of the clearance's error.
    fn rounded(
        &self,
        sweep: &Sweep,
        crossing: Crossing,
        v: i64,
        on_post: bool,
        heights: Option<[f64; 3]>,
    ) -> (Place, f64) {
        let fraction = if on_post { 0.0 } else { (crossing.v - v as f64).clamp(0.0, 1.0) };
        let [x, y] = sweep.family.point_at(crossing.c, v as f64 + fraction);
        let t = sweep.parameter(crossing.c);
        let (mut clearance, mut error) = (0.0, 0.0);
        if let Some([p, q, _]) = heights {
            let rise = if on_post { 0.0 } else { q - p };
            let ground = p + fraction * rise;
            let bulge = self.line.bulge(t);
            // As in `Walk::cross`; the bulge costs its own error and a rounding of the difference.
            clearance = crossing.z - bulge - ground;
            error = sweep.z_error
                + sweep.v_error * rise.abs()
                + 8.0 * ROUNDOFF * (p.abs() + (p + rise).abs() + bulge.abs() + crossing.z.abs())
                + self.line.bulge_error(sweep.t_error);
        }
        (Place { point: [x, y, crossing.z], t, clearance }, error)
    }

    /// The place of a crossing, to nearest.
    fn nearest(&self, family: Family, c: i64, face: Face, heights: Option<[f64; 3]>) -> (Place, f64) {
        let t = exact_parameter(family, c, self.line.a, self.line.b);
        let between = |from: f64, to: f64| {
            let from = rational(from);
            &from + &t * (rational(to) - &from)
        };
        let [x, y, z] = [0, 1, 2].map(|k| between(self.line.a[k], self.line.b[k]));
        let nearest = |v: &BigRational| v.to_f64().unwrap_or(0.0).clamp(-f64::MAX, f64::MAX);
        let point = [nearest(&x), nearest(&y), nearest(&z)];
        let clearance = heights.map_or(0.0, |heights| {
            let bulge = self.line.exact_bulge(&t);
            nearest(&(z - bulge - exact_height_over(face, heights, [x, y])))
        });
        (Place { point, t: nearest(&t), clearance }, 2.0 * ROUNDOFF * clearance.abs() + FLUSHED)
    }
}

/// The parameter of AB on line `c` of a family, which A and B lie on different sides of.
fn exact_parameter(family: Family, c: i64, a: [f64; 3], b: [f64; 3]) -> BigRational {
    let function = |p: [f64; 3]| match family {
        Family::Column => rational(p[0]),
        Family::Row => rational(p[1]),
        Family::Rising => rational(p[0]) - rational(p[1]),
        Family::Falling => rational(p[0]) + rational(p[1]),
    };
    let (from, to) = (function(a), function(b));
    (BigRational::from(BigInt::from(c)) - &from) / (to - from)
}
