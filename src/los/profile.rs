//! The clearance of a line over the ground, in order from A to B, and the values derived from it.
//!
//! Unlike the verdict, these values are f64. What is exact: which faces the line meets, in which order, and whether it
//! is above, on or below the ground at each crossing; so a value exists exactly when the verdict says so, and stands at
//! the right crossing or between the right two. What is rounded: parameter and clearance of a crossing, within the
//! errors of [`super::sweep`] where those are small (some 1e-15 of the line's extent and of the heights), and to
//! nearest where they would not be: there the crossing is computed in fractions.

use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::ToPrimitive;
use sightline_proto::{
    diamond::Post,
    predicates::{Exact, Sign, plan},
    verdict::LinePoint,
};

use super::{
    LosError, check_finite,
    surface::{Face, exact_height_over, rational, surface_over},
    sweep::{Crossing, Family, Span, Sweep},
    walk::{Found, Walk},
};
use crate::terrain::{HeightField, ReadError};

/// A place on a line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Place {
    /// In the grid frame.
    pub point: [f64; 3],
    /// As a part of AB: 0 at A, 1 at B.
    pub t: f64,
    /// Height of the line less that of the ground, in height units.
    pub clearance: f64,
}

/// What can be derived from a line over known ground.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub struct Derived {
    /// Of a blocked line: the infimum, from A, of its points strictly below known ground. Clearance there is 0 unless
    /// the line comes from unknown ground or begins below.
    pub first_from_a: Option<Place>,
    /// The same, from B.
    pub first_from_b: Option<Place>,
    /// Of a blocked line: where it is deepest below known ground; the first from A on ties.
    pub deepest: Option<Place>,
    /// Of a line that is not blocked: where it is least above known ground, if it is over any; the first on ties.
    pub least_clearance: Option<Place>,
}

/// A point of a blocked line that lies strictly below known ground.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Witness {
    /// Where, exactly.
    pub point: LinePoint,
    /// How far below the ground, in height units; above 0.
    pub depth: f64,
}

/// The greatest number of witnesses that [`witnesses`] returns.
pub const MAX_WITNESSES: usize = 32;

/// Obstructed points of AB: the deepest of each dip below known ground, deepest dip first (from A on ties), at most
/// [`MAX_WITNESSES`]. Empty exactly when AB is not blocked.
pub fn witnesses<H: HeightField + ?Sized>(field: &H, a: [f64; 3], b: [f64; 3]) -> Result<Vec<Witness>, LosError> {
    let events = events(field, a, b)?;
    let depth = |n: Option<usize>| n.and_then(|n| events.get(n)).map_or(0.0, Event::depth);
    let mut dips: Vec<_> = (0..events.len())
        .filter(|&n| events[n].sign == Some(Sign::Negative))
        .filter(|&n| depth(Some(n)) > depth(n.checked_sub(1)) && depth(Some(n)) >= depth(Some(n + 1)))
        .map(|n| Witness { point: events[n].point, depth: events[n].depth() })
        .collect();
    dips.sort_by(|v, w| w.depth.total_cmp(&v.depth));
    dips.truncate(MAX_WITNESSES);
    Ok(dips)
}

/// The derived values of AB; see [`Derived`].
pub fn derive<H: HeightField + ?Sized>(field: &H, a: [f64; 3], b: [f64; 3]) -> Result<Derived, LosError> {
    let events = events(field, a, b)?;
    let chords = chords(field, &events)?;
    let least = |below: bool| {
        let known = events.iter().filter(|e| e.sign.is_some_and(|s| !below || s == Sign::Negative));
        known.min_by(|e, f| e.place.clearance.total_cmp(&f.place.clearance)).map(|e| e.place)
    };
    let deepest = least(true);
    Ok(Derived {
        first_from_a: first_below(&events, &chords, |n| n),
        first_from_b: first_below(&events, &chords, |n| events.len() - 1 - n),
        deepest,
        least_clearance: if deepest.is_none() { least(false) } else { None },
    })
}

/// A point where AB meets a face of lower dimension, or an end of AB.
#[derive(Clone, Copy, Debug)]
struct Event {
    point: LinePoint,
    face: Face,
    place: Place,
    /// The exact sign of the clearance; `None` over unknown ground.
    sign: Option<Sign>,
}

impl Event {
    /// An event, whose rounded clearance is made not to contradict the exact sign.
    fn new(point: LinePoint, face: Face, mut place: Place, sign: Option<Sign>) -> Self {
        place.clearance = match sign {
            Some(Sign::Positive) => place.clearance.max(f64::from_bits(1)),
            Some(Sign::Negative) => place.clearance.min(-f64::from_bits(1)),
            _ => 0.0,
        };
        Self { point, face, place, sign }
    }

    /// Depth below known ground, or 0.
    fn depth(&self) -> f64 {
        if self.sign == Some(Sign::Negative) { -self.place.clearance } else { 0.0 }
    }
}

/// The first point strictly below known ground, or the infimum of such points, with events numbered by `at`.
fn first_below(events: &[Event], chords: &[bool], at: impl Fn(usize) -> usize) -> Option<Place> {
    let n = (0..events.len()).find(|&n| events[at(n)].sign == Some(Sign::Negative))?;
    let below = events[at(n)].place;
    // Where the chord before is over known ground, the line went under on it.
    let before = n.checked_sub(1).map(&at).filter(|&m| chords[m.min(at(n))]);
    Some(before.map_or(below, |m| {
        let above = events[m].place;
        let share = above.clearance / (above.clearance - below.clearance);
        let between = |from: f64, to: f64| from + share * (to - from);
        Place {
            point: [0, 1, 2].map(|k| between(above.point[k], below.point[k])),
            t: between(above.t, below.t),
            clearance: 0.0,
        }
    }))
}

/// For each event but the last, whether AB up to the next one is over known ground.
fn chords<H: HeightField + ?Sized>(field: &H, events: &[Event]) -> Result<Vec<bool>, ReadError> {
    let mut posts = crate::terrain::Posts::new(field);
    let mut known = Vec::with_capacity(events.len());
    for pair in events.windows(2) {
        // Both ends of a chord are on the closed face over which it runs, and on no common smaller one.
        let mut all = true;
        match pair[0].face.joined(&pair[1].face) {
            Some(face) => {
                for p in face {
                    all &= !posts.at(p)?.void;
                }
            }
            None => all = false,
        }
        known.push(all);
    }
    Ok(known)
}

/// All events of AB in the grid, in exact order from A to B, each point once. Parameters never decrease.
fn events<H: HeightField + ?Sized>(field: &H, a: [f64; 3], b: [f64; 3]) -> Result<Vec<Event>, LosError> {
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite(b, ["bx", "by", "bz"])?;
    let mut walk = Walk::new(field, a, b);
    let grid = field.grid();
    let mut crossed = Vec::new();
    if let Some(span) = Span::new(grid, a, b) {
        for sweep in Family::ALL.map(|family| Sweep::new(family, grid, span, a, b)) {
            for n in 0..sweep.count {
                if let Some(event) = event(&mut walk, &sweep, n)? {
                    crossed.push((event, sweep.family, sweep.line(n), sweep.t_error));
                }
            }
        }
    }
    crossed.sort_by(|(e, family, c, e_error), (f, other, d, f_error)| {
        let (t, u) = (e.place.t, f.place.t);
        if (t - u).abs() > e_error + f_error {
            return t.total_cmp(&u);
        }
        exact_parameter(*family, *c, a, b).cmp(&exact_parameter(*other, *d, a, b))
    });
    // AB meets a post once, but crosses a line of several families there.
    crossed.dedup_by(|(e, ..), (f, ..)| e.face == f.face && matches!(e.face, Face::Post(_)));
    let mut events: Vec<Event> = Vec::with_capacity(crossed.len() + 2);
    events.extend(end(&mut walk, LinePoint::A, a, 0.0)?);
    let mut reached: f64 = 0.0;
    events.extend(crossed.into_iter().map(|(mut event, ..)| {
        // Rounded parameters of close crossings may be out of order by their errors; the true ones are not.
        reached = event.place.t.clamp(reached, 1.0);
        event.place.t = reached;
        event
    }));
    events.extend(end(&mut walk, LinePoint::B, b, 1.0)?);
    Ok(events)
}

/// The event at an end; `None` outside the grid.
fn end<H>(walk: &mut Walk<'_, H>, point: LinePoint, at: [f64; 3], t: f64) -> Result<Option<Event>, ReadError>
where
    H: HeightField + ?Sized,
{
    let Some(face) = Face::at(walk.posts.grid(), plan(at)) else { return Ok(None) };
    let heights = face.heights(&mut walk.posts)?;
    let clearance = heights.map_or(0.0, |heights| at[2] - surface_over(face, heights, plan(at)));
    let sign = heights.map(|heights| face.height_sign::<Exact>(heights, at));
    Ok(Some(Event::new(point, face, Place { point: at, t, clearance }, sign)))
}

/// Crossing `n` of a sweep as an event; `None` outside the grid.
fn event<H>(walk: &mut Walk<'_, H>, sweep: &Sweep, n: i64) -> Result<Option<Event>, ReadError>
where
    H: HeightField + ?Sized,
{
    let (family, crossing) = (sweep.family, sweep.crossing(n));
    let Some((v, on_post)) = walk.place::<Exact>(sweep, crossing) else { return Ok(None) };
    let p = family.post(crossing.c, v);
    let (point, face) = if on_post {
        // Any line through the post that AB is not parallel to; its second post need not be in the grid.
        let across = if walk.a[1] == walk.b[1] { Post::new(p.i, p.j + 1) } else { Post::new(p.i + 1, p.j) };
        (LinePoint::Crossing(p, across), Face::Post([p]))
    } else {
        let q = family.post(crossing.c, v + 1);
        (LinePoint::Crossing(p, q), Face::Edge([p, q]))
    };
    let sign = match walk.cross::<Exact>(sweep, n)? {
        Found::Known(sign) => Some(sign),
        Found::Unknown => None,
        Found::Outside => return Ok(None),
    };
    let heights = face.heights(&mut walk.posts)?;
    let place = match sweep.trusted {
        true => rounded_place(sweep, crossing, v, on_post, heights),
        false => exact_place(walk, sweep, crossing.c, face, heights),
    };
    Ok(Some(Event::new(point, face, place, sign)))
}

/// The place of a crossing between posts `v` and `v + 1`, or on the first, within the errors of the sweep.
fn rounded_place(sweep: &Sweep, crossing: Crossing, v: i64, on_post: bool, heights: Option<[f64; 3]>) -> Place {
    let fraction = if on_post { 0.0 } else { (crossing.v - v as f64).clamp(0.0, 1.0) };
    let [x, y] = sweep.family.point_at(crossing.c, v as f64 + fraction);
    let clearance = heights.map_or(0.0, |[p, q, _]| {
        let ground = if on_post { p } else { p + fraction * (q - p) };
        crossing.z - ground
    });
    Place { point: [x, y, crossing.z], t: sweep.parameter(crossing.c), clearance }
}

/// The place of a crossing, to nearest.
fn exact_place<H>(walk: &Walk<'_, H>, sweep: &Sweep, c: i64, face: Face, heights: Option<[f64; 3]>) -> Place
where
    H: HeightField + ?Sized,
{
    let t = exact_parameter(sweep.family, c, walk.a, walk.b);
    let [x, y, z] = [0, 1, 2].map(|k| {
        let from = rational(walk.a[k]);
        let to = rational(walk.b[k]);
        &from + &t * (to - &from)
    });
    let nearest = |v: &BigRational| v.to_f64().unwrap_or(0.0);
    let point = [nearest(&x), nearest(&y), nearest(&z)];
    let clearance = heights.map_or(0.0, |heights| nearest(&(z - exact_height_over(face, heights, [x, y]))));
    Place { point, t: nearest(&t), clearance }
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
