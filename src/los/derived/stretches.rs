//! The stretches of a line above and below ground, and of the ground under it that an observer sees or does not.
//!
//! **Of the line.** Each point of AB is above known ground (or on it: contact does not block), strictly below it, or over
//! unknown ground. A stretch is a greatest interval of one kind; a boundary belongs to the stretch that is above, else
//! to the one over known ground. A stretch may be a single point: contact between two dips, a known edge between two
//! unknown triangles.
//!
//! **Of the ground.** The ground at t is in the state that the verdict on the line from A to it has: seen, hidden, or
//! unknown when there is no known ground at t or when the view passes unknown ground before and nothing known hides it.
//! With s(t) the slope from A to the ground at t, or the rise ([`super::rise`]) on a curved Earth, that is seen exactly
//! when s(t) is not below s anywhere before. Along a chord s only rises, only falls or stays, or rises and then falls
//! as the ground bends away; so the crossings and those tops decide, and they are compared exactly when rounded ones
//! are too close. Where the ground comes into view inside a chord, at the line over the last crest, or bends away, t is
//! rounded.

use sightline_proto::predicates::{FLUSHED, Sign};

use super::{
    ahead,
    event::{Chord, Event, Events},
    rise::{self, Crest, Tangent},
};
use crate::{
    los::{
        LosError, check_finite,
        earth::{At, Dip, Earth, Line, Plane},
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
pub fn ground_stretches<H>(
    field: &H,
    a: [f64; 3],
    b: [f64; 2],
    earth: Earth,
) -> Result<Vec<Stretch<GroundState>>, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite([b[0], b[1], 0.0], ["bx", "by", "bz"])?;
    // A level line: its clearance is how far the ground lies below A.
    let line = Line::new(a, [b[0], b[1], a[2]], earth);
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
    /// The first place of greatest rise.
    crest: Option<Crest>,
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
                Some(chord) if !self.line.is_straight() => self.curved_chord(&chord),
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
            self.crest = Some(Crest::Event(*event));
        }
    }

    /// Whether all ground of a stretch, which is known, lies below the line over the crest.
    fn hides(&self, stretch: &ahead::Stretch) -> bool {
        let Some(crest) = &self.crest else { return false };
        let (rise, error) = crest.rise();
        let z = self.line.a[2];
        let bulge = self.line.bulge_error(0.0);
        let error = error + bulge + stretch.sag + 16.0 * ROUNDOFF * (rise.abs() + z.abs()) + FLUSHED;
        // False when something is not a number.
        let over = |t: &f64| z + rise * t - self.line.bulge(*t) - error;
        stretch.ends.iter().all(|t| over(t) > stretch.ground)
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

    /// The sign of the rise at an event less that at the crest; positive where there is none yet.
    fn against_crest(&self, event: &Event) -> Sign {
        if event.at == At::A { Sign::Positive } else { self.over_crest(&Crest::Event(*event)) }
    }

    fn over_crest(&self, place: &Crest) -> Sign {
        self.crest.as_ref().map_or(Sign::Positive, |crest| rise::order(&self.line, place, crest))
    }

    /// The inside of a chord over known ground.
    fn chord(&mut self, last: &Event, event: &Event) {
        let (from, to) = (last.place.t, event.place.t);
        // From A itself the slope rises, or stays when A is on the ground.
        let order = || rise::order(&self.line, &Crest::Event(*event), &Crest::Event(*last));
        let rises = last.at == At::A || order() != Sign::Negative;
        let stays = last.at != At::A && order() == Sign::Zero;
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
        let fall = -crest.rise().0;
        let [under, over] = [last, event].map(|e| e.place.clearance - fall * e.place.t);
        let s = under / (under - over);
        let s = if s.is_nan() { 0.0 } else { s.clamp(0.0, 1.0) };
        last.place.t + s * (event.place.t - last.place.t)
    }

    /// The inside of a chord over known ground of a curved Earth: the rise grows to a top and falls from there.
    fn curved_chord(&mut self, chord: &Chord) {
        let (last, event) = (&chord.from, &chord.to);
        let (from, to) = (last.place.t, event.place.t);
        let [seen, hidden] = [false, true].map(|hidden| self.state(true, hidden));
        let plane = Plane::new(chord.face, chord.heights);
        let grows = [last, event].map(|end| rise::growth(&self.line, &plane, end.at));
        let curve = Curve::new(&self.line, &plane);
        if grows[0] != Sign::Positive {
            if last.at == At::A && grows[0] == Sign::Zero {
                // A is on the ground, which bends away from there.
                self.crest = Some(Crest::Tangent(curve.tangent(plane, 0.0)));
            }
            self.stretches.add(hidden, from, to);
            return;
        }
        // Whatever is not a number is put at the beginning.
        let within = |t: f64, end: f64| if t >= from { t.min(end) } else { from };
        let begins_hidden = last.at != At::A && self.against_crest(last) == Sign::Negative;
        let bends = grows[1] == Sign::Negative;
        let top =
            if bends { Crest::Tangent(curve.tangent(plane, within(curve.top(), to))) } else { Crest::Event(*event) };
        let t_top = if let Crest::Tangent(tangent) = &top { tangent.t } else { to };
        let over = if begins_hidden { self.over_crest(&top) } else { Sign::Positive };
        match over {
            _ if !begins_hidden => self.stretches.add(seen, from, t_top),
            Sign::Negative => self.stretches.add(hidden, from, t_top),
            _ => {
                let rise = self.crest.map_or(0.0, |crest| crest.rise().0);
                let t = if over == Sign::Zero { t_top } else { within(curve.reaches(rise), t_top) };
                self.stretches.add(hidden, from, t);
                self.stretches.add(seen, t, t_top);
            }
        }
        if bends {
            self.stretches.add(hidden, t_top, to);
            if over == Sign::Positive {
                self.crest = Some(top);
            }
        }
    }
}

/// The clearance W t^2 + l t + c of a level line over a face, rounded.
struct Curve {
    w: f64,
    l: f64,
    c: f64,
    /// A bound of the error of each.
    error: f64,
}

impl Curve {
    /// Over a plane, of a level line. Each term is off by a few roundings of itself; eight of the sum of their
    /// magnitudes are more than that.
    fn new(line: &Line, plane: &Plane) -> Self {
        let [gx, gy] = [plane.east, plane.north].map(|[low, high]| high - low);
        let across = [(line.b[0] - line.a[0]) * gx, (line.b[1] - line.a[1]) * gy];
        let away = [(line.a[0] - f64::from(plane.post.i)) * gx, (line.a[1] - f64::from(plane.post.j)) * gy];
        let (w, z) = (line.bend, line.a[2]);
        let size = w + z.abs() + plane.z.abs() + across.iter().chain(&away).map(|v| v.abs()).sum::<f64>();
        Self {
            w,
            l: -w - across[0] - across[1],
            c: (z - plane.z - away[0] - away[1]).max(0.0),
            error: 8.0 * ROUNDOFF * size,
        }
    }

    /// Where the rise is greatest.
    fn top(&self) -> f64 {
        (self.c / self.w).sqrt()
    }

    fn tangent(&self, plane: Plane, t: f64) -> Tangent {
        let root = (self.c * self.w).sqrt();
        let rise = -(self.l + 2.0 * root);
        // The root of something off by at most so much is off by at most its root.
        let error = self.error + 2.0 * (self.error * self.w).sqrt() + 16.0 * ROUNDOFF * (rise.abs() + root);
        Tangent { plane, t, rise, error: 2.0 * error }
    }

    /// Where the rise first is so much.
    fn reaches(&self, rise: f64) -> f64 {
        let b = self.l + rise;
        // Of the two forms of the lesser root the one without cancelling, since b is negative here.
        2.0 * self.c / (-b + (b * b - 4.0 * self.w * self.c).max(0.0).sqrt())
    }
}
