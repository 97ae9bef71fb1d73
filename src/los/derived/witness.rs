//! Witnesses: the places where a blocked line is deepest, one for each dip below the ground.

use sightline_proto::verdict::LinePoint;

use super::event::{Event, Events};
use crate::{
    los::{
        LosError, check_finite,
        earth::{Earth, Line},
        walk::Walk,
    },
    terrain::{HeightField, ReadError},
};

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

/// Obstructed points of AB on a flat Earth: the deepest of each dip below known ground, deepest dip first (from A on
/// ties), at most [`MAX_WITNESSES`]. Empty exactly when AB is not blocked.
pub fn witnesses<H: HeightField + ?Sized>(field: &H, a: [f64; 3], b: [f64; 3]) -> Result<Vec<Witness>, LosError> {
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite(b, ["bx", "by", "bz"])?;
    Ok(witnesses_on(&mut Walk::new(field, a, b), a, b)?)
}

/// [`witnesses`] for finite ends.
pub(in crate::los) fn witnesses_on<H>(
    walk: &mut Walk<'_, H>,
    a: [f64; 3],
    b: [f64; 3],
) -> Result<Vec<Witness>, ReadError>
where
    H: HeightField + ?Sized,
{
    let mut events = Events::new(walk, Line::new(a, b, Earth::Flat));
    let mut dips = Vec::new();
    // A dip is deeper than what comes before and no less deep than what comes after.
    let (mut before, mut candidate) = (0.0, None::<Event>);
    loop {
        if before == 0.0 {
            events.pass(|stretch| stretch.line > stretch.ground)?;
        }
        let event = events.step()?;
        let depth = event.map_or(0.0, |event| event.depth());
        if let Some(dip) = candidate.take()
            && dip.depth() >= depth
        {
            dips.push(Witness { point: dip.point, depth: dip.depth() });
        }
        if depth > before {
            candidate = event;
        }
        before = depth;
        if event.is_none() {
            break;
        }
    }
    dips.sort_by(|v, w| w.depth.total_cmp(&v.depth));
    dips.truncate(MAX_WITNESSES);
    Ok(dips)
}
