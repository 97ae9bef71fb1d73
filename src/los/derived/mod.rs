//! What follows from a line of sight besides its verdict: where it is obstructed, how deep, how near.
//!
//! These values are f64. What is exact is whether they exist (exactly when the verdict says so), and between which two
//! crossings they stand; positions and clearances are within the errors that [`event`] documents, except that a point
//! where the line goes under is off by more where it goes under at a small angle: by at most the error of the clearance
//! divided by the slope at which line and ground part.
//!
//! All go along the events of AB in exact order and look at the chord between each two, except where the greatest
//! heights of blocks show that nothing there matters ([`ahead`]).

mod ahead;
pub(super) mod crest;
pub(super) mod event;
mod rise;
pub(super) mod stretches;
mod target;
mod trail;
pub(super) mod witness;

pub use stretches::{GroundState, LineState, Stretch, ground_stretches, line_stretches};
pub use target::least_target_height;
pub use witness::{MAX_WITNESSES, Witness, witnesses};

use sightline_proto::{
    diamond::Post,
    predicates::{Sign, are_equal, plan},
};

use self::event::{Chord, Event, Events};
use super::{
    Answer, LosError, Options, Verdict, check_finite,
    earth::{At, Dip, Earth, Line},
    skip,
    surface::known_triangle,
    walk::Walk,
};
use crate::terrain::{HeightField, ReadError};

/// A place on a line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Place {
    /// On AB, in the grid frame. On a curved Earth the line passes lower, by its bulge at `t`.
    pub point: [f64; 3],
    /// As a part of AB: 0 at A, 1 at B.
    pub t: f64,
    /// Height of the line (lowered by its bulge on a curved Earth) less that of the ground, in height units.
    pub clearance: f64,
}

/// The infimum of the points of a line that obstruct it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Obstruction {
    /// Where. The clearance is 0 unless the line comes from unknown ground or begins below.
    pub place: Place,
    /// The triangle under which the line goes there, counter-clockwise; of several (the line runs under an edge, or is
    /// vertical) the known one whose centroid has the lowest (j, i). `None` when it is below a known edge or post
    /// between unknown triangles.
    pub triangle: Option<[Post; 3]>,
}

/// What can be derived from a line over known ground.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub struct Derived {
    /// Of a blocked line: the infimum, from A, of its points strictly below known ground; when contact blocks, of
    /// those in contact strictly between the ends, too.
    pub first_from_a: Option<Obstruction>,
    /// The same, from B.
    pub first_from_b: Option<Obstruction>,
    /// Of a blocked line: where it is deepest below known ground; the first from A on ties.
    pub deepest: Option<Place>,
    /// Of a line that is not blocked: where it is least above known ground, if it is over any; the first on ties.
    pub least_clearance: Option<Place>,
}

/// The derived values of AB; see [`Derived`]. Of the options, `strict` and `earth` count.
pub fn derive<H>(field: &H, a: [f64; 3], b: [f64; 3], options: Options) -> Result<Derived, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite(b, ["bx", "by", "bz"])?;
    Ok(derive_on(&mut Walk::new(field, a, b), a, b, options)?)
}

/// The first obstruction of AB from A, where AB goes under a known triangle there and passes no unknown point before. Flat
/// Earth.
pub fn known_obstruction<H>(field: &H, a: [f64; 3], b: [f64; 3]) -> Result<Option<Obstruction>, LosError>
where
    H: HeightField + ?Sized,
{
    let first = derive(field, a, b, Options::default())?.first_from_a;
    let Some(first) = first.filter(|first| first.triangle.is_some()) else { return Ok(None) };
    let stretches = line_stretches(field, a, b, Earth::Flat)?;
    let before = stretches.iter().take_while(|stretch| stretch.state != LineState::Below);
    let passes_unknown = before.into_iter().any(|stretch| stretch.state == LineState::Unknown);
    Ok(Some(first).filter(|_| !passes_unknown))
}

/// [`derive()`] for finite ends.
pub(super) fn derive_on<H>(
    walk: &mut Walk<'_, H>,
    a: [f64; 3],
    b: [f64; 3],
    options: Options,
) -> Result<Derived, ReadError>
where
    H: HeightField + ?Sized,
{
    let forth = survey(walk, Line::new(a, b, options.earth), options.strict, Until::Beyond)?;
    let blocked = forth.first.is_some();
    let least = forth.least.map(|least| least.place);
    let mut derived = Derived {
        first_from_a: forth.first,
        first_from_b: None,
        deepest: least.filter(|_| blocked),
        least_clearance: least.filter(|_| !blocked),
    };
    if blocked {
        let back = survey(walk, Line::new(b, a, options.earth), options.strict, Until::Obstructed)?;
        let after = derived.deepest.map_or(0.0, |deepest| deepest.t);
        derived.first_from_b = back.first.map(|mut first| {
            // Rounded from the other end: what comes last must not seem to come first.
            first.place.t = (1.0 - first.place.t).max(after);
            first
        });
    }
    Ok(derived)
}

/// The answer on a curved Earth: always exact, whatever the precision.
pub(super) fn curved_answer<H>(
    walk: &mut Walk<'_, H>,
    a: [f64; 3],
    b: [f64; 3],
    options: Options,
) -> Result<Answer, LosError>
where
    H: HeightField + ?Sized,
{
    let line = Line::new(a, b, options.earth);
    (walk.a, walk.b) = (a, b);
    if !walk.manner.plain && walk.is_inside() && skip::is_curved_below_blocks(walk, &line)? {
        return Ok(Answer { verdict: Verdict::Blocked, grazes: false, certain: true });
    }
    let met = survey(walk, line, options.strict, Until::Obstructed)?;
    let verdict = match (met.first.is_some(), met.unknown) {
        (true, _) => Verdict::Blocked,
        (_, true) => Verdict::Unknown,
        _ => Verdict::Visible,
    };
    Ok(Answer { verdict, grazes: verdict == Verdict::Visible && met.contact, certain: true })
}

/// How far to go.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Until {
    /// To the first obstruction, and to the triangle that it lies in.
    Obstructed,
    /// To the end.
    Beyond,
}

/// What there is along a line.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Survey {
    pub(super) first: Option<Obstruction>,
    pub(super) least: Option<Least>,
    /// Whether some of it, up to the first obstruction, is over unknown ground.
    pub(super) unknown: bool,
    /// Known ground is touched strictly between the ends.
    pub(super) contact: bool,
    /// A is strictly below known ground.
    pub(super) starts_below: bool,
}

/// The place of least clearance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Least {
    pub(super) place: Place,
}

/// Goes along a line with finite ends.
pub(super) fn survey<H>(walk: &mut Walk<'_, H>, line: Line, strict: bool, until: Until) -> Result<Survey, ReadError>
where
    H: HeightField + ?Sized,
{
    let still = are_equal(plan(line.a), plan(line.b));
    let moves = !are_equal(line.a, line.b);
    let mut events = Events::new(walk, line);
    let mut found = Survey::default();
    let mut last: Option<Event> = None;
    // The first obstruction is known, and the triangle it lies in is not.
    let mut open = false;
    loop {
        if last.is_some() && !open {
            // Nothing obstructs there, nor is it as near as what is known.
            let least = match until {
                Until::Obstructed => 0.0,
                Until::Beyond => found.least.map_or(f64::INFINITY, |least| least.place.clearance),
            };
            last = events.pass(|stretch| stretch.line - stretch.ground > least)?.or(last);
        }
        let Some(event) = events.step()? else { break };
        let chord = last.and_then(|last| Chord::new(&line, last, event));
        found.unknown |= found.first.is_none() && (!event.is_known() || last.is_some() && chord.is_none());
        found.unknown |= last.is_none() && !matches!(event.at, At::A);
        if let Some(chord) = chord {
            if open || found.first.is_none() {
                let entered = if open { None } else { entry(&chord, strict, moves) };
                if let Some(place) = entered {
                    found.first = Some(Obstruction { place, triangle: None });
                }
                if let Some(first) = found.first.as_mut().filter(|_| open || entered.is_some()) {
                    first.triangle = known_triangle(&mut events.walk().posts, chord.face)?;
                    open = false;
                }
            }
            found.contact |= moves && touches(&chord);
            found.lower(chord.lowest().filter(|_| !line.is_straight()));
        }
        found.starts_below |= event.at == At::A && event.is_below();
        if event.is_known() {
            found.lower(Some(event.place));
            found.contact |= event.sign == Some(Sign::Zero) && event.is_inside();
        }
        let obstructs = event.is_below() || strict && event.sign == Some(Sign::Zero) && event.is_inside();
        if obstructs && found.first.is_none() {
            found.first = Some(Obstruction { place: event.place, triangle: None });
            open = !still;
            if still {
                let triangle = known_triangle(&mut events.walk().posts, event.face)?;
                found.first = Some(Obstruction { place: event.place, triangle });
            }
        } else if open && chord.is_none() && last.is_some() {
            open = false;
        }
        if until == Until::Obstructed && found.first.is_some() && !open {
            return Ok(found);
        }
        last = Some(event);
    }
    found.unknown |= found.first.is_none() && last.is_none_or(|last| last.at != At::B);
    Ok(found)
}

impl Survey {
    fn lower(&mut self, place: Option<Place>) {
        if let Some(place) = place
            && self.least.is_none_or(|least| place.clearance < least.place.clearance)
        {
            self.least = Some(Least { place });
        }
    }
}

/// Where a line that is not obstructed at the first end of a chord is so on it, or at its last end.
fn entry(chord: &Chord, strict: bool, moves: bool) -> Option<Place> {
    let (from, to) = (&chord.from, &chord.to);
    if strict && moves && from.sign == Some(Sign::Zero) && to.sign == Some(Sign::Zero) && chord.dip == Dip::None {
        // From end to end in the ground of one face: in contact from the first point on.
        return Some(from.place);
    }
    if to.is_below() || chord.dip == Dip::Below {
        return Some(chord.place(chord.enters(), 0.0));
    }
    (strict && chord.dip == Dip::Touches).then(|| chord.lowest()).flatten()
}

/// Whether the line touches the ground strictly inside a chord: as a tangent, or all along.
fn touches(chord: &Chord) -> bool {
    let zero = |e: &Event| e.sign == Some(Sign::Zero);
    chord.dip == Dip::Touches || chord.dip == Dip::None && zero(&chord.from) && zero(&chord.to)
}
