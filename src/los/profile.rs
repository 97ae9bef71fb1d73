//! The profile of the ground under a line: every vertex of the piecewise linear ground, for plotting and for export.

use super::{
    LosError, check_finite,
    derived::event::{Chord, Events},
    earth::{Earth, Line},
    surface::Face,
    walk::Walk,
};
use crate::terrain::HeightField;

/// A vertex of a profile.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Break {
    /// As a part of AB: 0 at A, 1 at B. Never less than that of the break before.
    pub t: f64,
    /// In the grid frame.
    pub point: [f64; 2],
    /// The smallest face there: an edge or post that is crossed; at an end of the line, whatever holds it.
    pub face: Face,
    /// Height of the ground in height units: exact at posts, elsewhere within a few roundings of the heights and of the
    /// line's extent times the slope. `None` where it is unknown.
    pub ground: Option<f64>,
    /// Whether all ground up to the next break is known; false at the last.
    pub known_after: bool,
}

/// The ground under the plan line from `a` to `b` inside the grid, by its breaks in exact order, each once. Between two
/// breaks the ground is linear, or unknown. More than `limit` breaks are an error; none means that AB misses the grid.
pub fn profile<H>(field: &H, a: [f64; 2], b: [f64; 2], limit: usize) -> Result<Vec<Break>, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite([a[0], a[1], 0.0], ["ax", "ay", "az"])?;
    check_finite([b[0], b[1], 0.0], ["bx", "by", "bz"])?;
    // The clearance of a line at height 0 is the ground, upside down.
    let line = Line::new([a[0], a[1], 0.0], [b[0], b[1], 0.0], Earth::Flat);
    let mut walk = Walk::new(field, line.a, line.b);
    let mut events = Events::new(&mut walk, line);
    let mut breaks: Vec<Break> = Vec::new();
    let mut last = None;
    while let Some(event) = events.step()? {
        if let (Some(before), Some(last)) = (breaks.last_mut(), last) {
            before.known_after = Chord::new(&line, last, event).is_some();
        }
        if breaks.len() == limit {
            return Err(LosError::TooManyBreaks { limit });
        }
        let place = event.place;
        breaks.push(Break {
            t: place.t,
            point: [place.point[0], place.point[1]],
            face: event.face,
            // Not -0.
            ground: event.is_known().then_some(0.0 - place.clearance),
            known_after: false,
        });
        last = Some(event);
    }
    Ok(breaks)
}
