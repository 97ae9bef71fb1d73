//! The crest of the ground along a line, seen from A: where it stands highest in the view.

use sightline_proto::predicates::Sign;

use super::{
    ahead::Stretch,
    event::{Chord, Event, Events},
};
use crate::{
    los::{
        earth::{At, Line},
        walk::Walk,
    },
    terrain::{HeightField, ReadError},
};

/// Where the ground along AB stands highest, seen from A.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(in crate::los) struct Crest {
    /// The height of B, less that of A, at which the line (lowered by its bulge) passes through the crest.
    pub(in crate::los) rise: f64,
    /// The crest as a part of AB; 0 when A stands on the ground and none of it rises above its beginning.
    pub(in crate::los) t: f64,
}

/// What is seen from A along a line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(in crate::los) struct View {
    /// `None` when there is no known ground beyond A.
    pub(in crate::los) crest: Option<Crest>,
    /// A is strictly below known ground.
    pub(in crate::los) below: bool,
    /// Some of the ground is unknown.
    pub(in crate::los) unknown: bool,
}

/// Goes along the ground under a line whose ends are level, finite and apart in plan. Rounded: the rise is within the
/// error of a clearance divided by t.
pub(in crate::los) fn view<H>(walk: &mut Walk<'_, H>, level: Line) -> Result<View, ReadError>
where
    H: HeightField + ?Sized,
{
    let mut events = Events::new(walk, level);
    let mut view = View { crest: None, below: false, unknown: false };
    let mut last: Option<Event> = None;
    loop {
        if let (Some(_), Some(crest)) = (last, view.crest) {
            // Ground below the line over the crest; what is lost in rounding is less than the crest is rounded by.
            let over = |t: f64| level.a[2] + crest.rise * t - level.bulge(t);
            let hidden = |stretch: &Stretch| {
                let [from, to] = stretch.ends.map(over);
                from.min(to) - stretch.sag > stretch.ground
            };
            last = events.pass(hidden)?.or(last);
        }
        let Some(event) = events.step()? else { break };
        let chord = last.and_then(|last| Chord::new(&level, last, event));
        view.unknown |= !event.is_known() || last.is_some() && chord.is_none() || last.is_none() && event.at != At::A;
        if event.at == At::A {
            view.below = event.is_below();
            if view.below {
                return Ok(view);
            }
        } else if event.is_known() && event.place.t > 0.0 {
            view.raise(-event.place.clearance / event.place.t, event.place.t);
        }
        if let Some(chord) = chord.filter(|_| !level.is_straight()) {
            view.inside(&level, &chord);
        }
        last = Some(event);
    }
    view.unknown |= last.is_none_or(|last| last.at != At::B);
    Ok(view)
}

impl View {
    fn raise(&mut self, rise: f64, t: f64) {
        if self.crest.is_none_or(|crest| rise > crest.rise) {
            self.crest = Some(Crest { rise, t });
        }
    }

    /// On a curved Earth the slope W t + l + c / t may be least inside a chord: at t^2 = c / W.
    fn inside(&mut self, level: &Line, chord: &Chord) {
        let (from, to) = (chord.from.place, chord.to.place);
        if chord.from.at == At::A && chord.from.sign == Some(Sign::Zero) {
            self.raise(level.bend * to.t - to.clearance / to.t, 0.0);
            return;
        }
        let l = (to.clearance - from.clearance) / (to.t - from.t) - level.bend * (from.t + to.t);
        let c = from.clearance - level.bend * from.t * from.t - l * from.t;
        let t = (c / level.bend).sqrt();
        if t > from.t && t < to.t {
            self.raise(-(level.bend * t + l + c / t), t);
        }
    }
}
