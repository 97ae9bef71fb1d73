//! The stretches of a line above and below ground, and of the ground under it that an observer sees or does not.
//!
//! **Of the line.** Each point of AB is above known ground (or on it: contact does not block), strictly below it, or over
//! unknown ground. A stretch is a greatest interval of one kind; a boundary belongs to the stretch that is above, else
//! to the one over known ground. A stretch may be a single point: contact between two dips, a known edge between two
//! unknown triangles.
//!
//! **Of the ground.** The ground at t is in the state that the verdict on the line from A to it has: seen, hidden, or
//! unknown when there is no known ground at t or when the view passes unknown ground before and nothing known hides it.
//! With s(t) the slope from A to the ground at t, that is seen exactly when s(t) is not below s anywhere before.
//! Along a chord s only rises, only falls or stays, so the crossings decide, and their slopes are compared exactly
//! when rounded ones are too close. Where the ground comes into view inside a chord, at the line over the last crest,
//! t is rounded.

use sightline_proto::{
    number::{Dyadic, Interval, Number},
    predicates::Sign,
};

use super::{
    ahead,
    event::{Chord, Event, Events},
};
use crate::{
    los::{
        LosError, check_finite,
        earth::{At, Dip, Earth, Fraction, Line, Plane, Quadratic},
        sweep::ROUNDOFF,
        walk::Walk,
    },
    terrain::{HeightField, ReadError},
};

/// A greatest interval of t in one state.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Stretch<S> {
    /// Where it begins, as a part of AB.
    pub from: f64,
    /// Where it ends; not before it begins.
    pub to: f64,
    /// What it is.
    pub state: S,
}

/// How a line stands to the ground.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum LineState {
    /// Above known ground, or on it.
    Above,
    /// Strictly below known ground.
    Below,
    /// Over unknown ground.
    Unknown,
}

impl LineState {
    /// ABOVE, BELOW or UNKNOWN.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Above => "ABOVE",
            Self::Below => "BELOW",
            Self::Unknown => "UNKNOWN",
        }
    }
}

/// Whether ground is seen.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum GroundState {
    /// The line from A to it is VISIBLE.
    Seen,
    /// The line from A to it is BLOCKED.
    Hidden,
    /// There is no known ground, or the line from A to it is UNKNOWN.
    Unknown,
}

impl GroundState {
    /// SEEN, HIDDEN or UNKNOWN.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Seen => "SEEN",
            Self::Hidden => "HIDDEN",
            Self::Unknown => "UNKNOWN",
        }
    }
}

/// Stretches in the making.
struct Stretches<S>(Vec<Stretch<S>>);

impl<S: Copy + PartialEq> Stretches<S> {
    fn add(&mut self, state: S, from: f64, to: f64) {
        match self.0.last_mut() {
            Some(last) if last.state == state => last.to = last.to.max(to),
            _ => self.0.push(Stretch { from, to, state }),
        }
    }
}

/// The stretches of AB above and below ground, from A to B; they cover it. There is one below exactly when AB is
/// BLOCKED, and otherwise one over unknown ground exactly when it is UNKNOWN.
pub fn line_stretches<H>(field: &H, a: [f64; 3], b: [f64; 3], earth: Earth) -> Result<Vec<Stretch<LineState>>, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite(b, ["bx", "by", "bz"])?;
    Ok(line_stretches_on(&mut Walk::new(field, a, b), Line::new(a, b, earth))?)
}

/// [`line_stretches`] for finite ends.
pub(in crate::los) fn line_stretches_on<H>(
    walk: &mut Walk<'_, H>,
    line: Line,
) -> Result<Vec<Stretch<LineState>>, ReadError>
where
    H: HeightField + ?Sized,
{
    let mut events = Events::new(walk, line);
    let mut stretches = Stretches(Vec::new());
    let mut last: Option<Event> = None;
    let state = |event: &Event| match event.sign {
        None => LineState::Unknown,
        Some(Sign::Negative) => LineState::Below,
        Some(_) => LineState::Above,
    };
    loop {
        if let Some(before) = last.filter(|last| last.is_known() && !last.is_below())
            && let Some(passed) = events.pass(|stretch| stretch.line > stretch.ground)?
        {
            stretches.add(LineState::Above, before.place.t, passed.place.t);
            last = Some(passed);
        }
        let Some(event) = events.step()? else { break };
        let t = event.place.t;
        match last.map(|last| Chord::new(&line, last, event)) {
            Some(Some(chord)) => add_chord(&mut stretches, &chord),
            Some(None) => stretches.add(LineState::Unknown, last.map_or(0.0, |last| last.place.t), t),
            None if event.at != At::A => stretches.add(LineState::Unknown, 0.0, t),
            None => {}
        }
        stretches.add(state(&event), t, t);
        last = Some(event);
    }
    if last.is_none_or(|last| last.at != At::B) {
        stretches.add(LineState::Unknown, last.map_or(0.0, |last| last.place.t), 1.0);
    }
    Ok(stretches.0)
}

/// The inside of a chord over known ground.
fn add_chord(stretches: &mut Stretches<LineState>, chord: &Chord) {
    let (from, to) = (chord.from.place.t, chord.to.place.t);
    match (chord.from.is_below(), chord.to.is_below()) {
        (true, true) => stretches.add(LineState::Below, from, to),
        (true, false) => {
            let t = chord.place(chord.leaves(), 0.0).t;
            stretches.add(LineState::Below, from, t);
            stretches.add(LineState::Above, t, to);
        }
        (false, true) => {
            let t = chord.place(chord.enters(), 0.0).t;
            stretches.add(LineState::Above, from, t);
            stretches.add(LineState::Below, t, to);
        }
        (false, false) if chord.dip == Dip::Below => {
            let enters = chord.place(chord.enters(), 0.0).t;
            let leaves = chord.place(chord.leaves(), 0.0).t.max(enters);
            stretches.add(LineState::Above, from, enters);
            stretches.add(LineState::Below, enters, leaves);
            stretches.add(LineState::Above, leaves, to);
        }
        (false, false) => stretches.add(LineState::Above, from, to),
    }
}

/// The stretches of the ground under the plan line from `a` to `b` that A sees or does not, from A on; they cover it.
/// On a flat Earth.
pub fn ground_stretches<H>(field: &H, a: [f64; 3], b: [f64; 2]) -> Result<Vec<Stretch<GroundState>>, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite([b[0], b[1], 0.0], ["bx", "by", "bz"])?;
    // A level line: its clearance is how far the ground lies below A.
    let line = Line::new(a, [b[0], b[1], a[2]], Earth::Flat);
    Ok(ground_stretches_on(&mut Walk::new(field, line.a, line.b), line)?)
}

/// [`ground_stretches`] under a level line with finite ends.
pub(in crate::los) fn ground_stretches_on<H>(
    walk: &mut Walk<'_, H>,
    line: Line,
) -> Result<Vec<Stretch<GroundState>>, ReadError>
where
    H: HeightField + ?Sized,
{
    let mut events = Events::new(walk, line);
    let mut view = View { line, crest: None, below: false, unknown: false, stretches: Stretches(Vec::new()) };
    let mut last: Option<Event> = None;
    loop {
        if let Some(before) = last.filter(Event::is_known)
            && let Some(passed) = events.pass(|stretch| view.hides(stretch))?
        {
            view.stretches.add(view.state(true, true), before.place.t, passed.place.t);
            last = Some(passed);
        }
        let Some(event) = events.step()? else { break };
        view.pass(last.as_ref(), &event);
        last = Some(event);
    }
    if last.is_none_or(|last| last.at != At::B) {
        view.stretches.add(GroundState::Unknown, last.map_or(0.0, |last| last.place.t), 1.0);
    }
    Ok(view.stretches.0)
}

/// What A has seen so far.
struct View {
    line: Line,
    /// The first event of greatest slope.
    crest: Option<Event>,
    /// A is below ground.
    below: bool,
    /// Something unknown was passed.
    unknown: bool,
    stretches: Stretches<GroundState>,
}

impl View {
    fn pass(&mut self, last: Option<&Event>, event: &Event) {
        let t = event.place.t;
        match last {
            None => {
                self.unknown |= event.at != At::A;
                if self.unknown {
                    self.stretches.add(GroundState::Unknown, 0.0, t);
                }
            }
            Some(last) => match Chord::new(&self.line, *last, *event) {
                Some(_) => self.chord(last, event),
                None => {
                    self.unknown = true;
                    self.stretches.add(GroundState::Unknown, last.place.t, t);
                }
            },
        }
        self.unknown |= !event.is_known();
        if event.at == At::A {
            self.below = event.is_below();
        }
        let hidden = self.against_crest(event) == Sign::Negative;
        self.stretches.add(self.state(event.is_known(), hidden), t, t);
        if event.is_known() && event.at != At::A && self.against_crest(event) == Sign::Positive {
            self.crest = Some(*event);
        }
    }

    /// Whether all ground of a stretch, which is known, lies below the line over the crest.
    fn hides(&self, stretch: &ahead::Stretch) -> bool {
        let Some(crest) = &self.crest else { return false };
        let (t, z) = (crest.place.t, self.line.a[2]);
        let slope = -crest.place.clearance / t;
        // The slope is off by the errors of clearance and t over t, and by roundings; doubled.
        let error = 2.0 * (crest.error + slope.abs() * crest.t_error) / t + 16.0 * ROUNDOFF * (slope.abs() + z.abs());
        // False when something is not a number.
        stretch.ends.iter().all(|at| z + slope * at - error - f64::MIN_POSITIVE > stretch.ground)
    }

    /// The state of ground that the last crest hides, or does not.
    fn state(&self, known: bool, hidden: bool) -> GroundState {
        if !known {
            GroundState::Unknown
        } else if self.below || hidden {
            GroundState::Hidden
        } else if self.unknown {
            GroundState::Unknown
        } else {
            GroundState::Seen
        }
    }

    /// The sign of the slope to an event less that to the crest; positive where there is none yet.
    fn against_crest(&self, event: &Event) -> Sign {
        match &self.crest {
            Some(crest) if event.at != At::A => slope_order(&self.line, event, crest),
            _ => Sign::Positive,
        }
    }

    /// The inside of a chord over known ground.
    fn chord(&mut self, last: &Event, event: &Event) {
        let (from, to) = (last.place.t, event.place.t);
        // From A itself the slope rises, or stays when A is on the ground.
        let rises = last.at == At::A || slope_order(&self.line, event, last) != Sign::Negative;
        let stays = last.at != At::A && slope_order(&self.line, event, last) == Sign::Zero;
        let begins_hidden = last.at != At::A && self.against_crest(last) == Sign::Negative;
        let ends_above = self.against_crest(event) == Sign::Positive;
        let [seen, hidden] = [false, true].map(|hidden| self.state(true, hidden));
        if !rises || stays && begins_hidden || begins_hidden && !ends_above {
            self.stretches.add(hidden, from, to);
        } else if !begins_hidden {
            self.stretches.add(seen, from, to);
        } else {
            let t = self.appears(last, event);
            self.stretches.add(hidden, from, t);
            self.stretches.add(seen, t, to);
        }
    }

    /// Where the ground comes up to the line over the crest.
    fn appears(&self, last: &Event, event: &Event) -> f64 {
        let Some(crest) = &self.crest else { return last.place.t };
        let fall = crest.place.clearance / crest.place.t;
        let [under, over] = [last, event].map(|e| e.place.clearance - fall * e.place.t);
        let s = under / (under - over);
        let s = if s.is_nan() { 0.0 } else { s.clamp(0.0, 1.0) };
        last.place.t + s * (event.place.t - last.place.t)
    }
}

/// The sign of the slope from A to the ground at `event` less that at `other`, both beyond A. Exact.
///
/// The slopes are -c / t for the clearances c of a level line, so their order is that of c' t and c t'. The rounded
/// products are each off by at most |c| t_error + error t + error t_error and two roundings.
fn slope_order(line: &Line, event: &Event, other: &Event) -> Sign {
    let product = |c: &Event, t: &Event| {
        let (clearance, t_at) = (c.place.clearance, t.place.t);
        let value = clearance * t_at;
        let bound = clearance.abs() * t.t_error + c.error * (t_at + t.t_error) + 4.0 * ROUNDOFF * value.abs();
        (value, 1.01 * bound + f64::MIN_POSITIVE)
    };
    let ((left, left_error), (right, right_error)) = (product(other, event), product(event, other));
    let (difference, bound) = (left - right, left_error + right_error);
    if difference > bound {
        return Sign::Positive;
    }
    if difference < -bound {
        return Sign::Negative;
    }
    fn exact<N: Number>(line: &Line, event: &Event, other: &Event) -> Option<Sign> {
        let at = |e: &Event| {
            let t = Fraction::<N>::new(line, e.at);
            let clearance = Quadratic::new(line, &Plane::new(e.face, e.heights)).straight_at(&t);
            (clearance, t.n)
        };
        // Over the denominators of both, which are above 0 and cancel.
        let ((clearance, t), (other_clearance, other_t)) = (at(event), at(other));
        other_clearance.mul(&t).sub(&clearance.mul(&other_t)).sign()
    }
    exact::<Interval>(line, event, other).or_else(|| exact::<Dyadic>(line, event, other)).unwrap_or(Sign::Zero)
}
