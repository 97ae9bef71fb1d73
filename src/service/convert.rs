//! Messages to domain types and back. Unknown enum values are refused, unset ones have the meaning that the proto says.

use std::time::Duration;

use sightline_proto::v1;
use tonic::Status;

use crate::{
    exercise::{Altitude, Anchor, Change, Disc, Entity, Frame, Granted, Lease, LineState, Place, SightLine, Site},
    los::{Earth, LosError, Options, Precision, Verdict},
    roam::Fidelity,
};

fn unknown(what: &str, value: i32) -> Status {
    Status::invalid_argument(format!("{what} {value} is none that this server knows"))
}

fn missing(what: &str) -> Status {
    Status::invalid_argument(format!("{what} is missing"))
}

/// Puts before an error what it is about.
fn of(what: &str, id: u64, status: &Status) -> Status {
    Status::new(status.code(), format!("{what} {id}: {}", status.message()))
}

pub(super) fn frame(value: i32) -> Result<Frame, Status> {
    use v1::CoordinateFrame as Wire;
    Ok(match Wire::try_from(value).map_err(|_| unknown("coordinate frame", value))? {
        Wire::Grid => Frame::Grid,
        Wire::Unspecified | Wire::Map => Frame::Map,
        Wire::Geographic => Frame::Geographic,
        Wire::Scene => Frame::Scene,
    })
}

pub(super) fn altitude(value: i32) -> Result<Altitude, Status> {
    use v1::AltitudeReference as Wire;
    Ok(match Wire::try_from(value).map_err(|_| unknown("altitude reference", value))? {
        Wire::Unspecified | Wire::Absolute => Altitude::Absolute,
        Wire::AboveGround => Altitude::AboveGround,
    })
}

pub(super) fn place(position: Option<v1::Position>, frame_value: i32, altitude_value: i32) -> Result<Place, Status> {
    let v1::Position { x, y, z } = position.ok_or_else(|| missing("position"))?;
    Ok(Place { position: [x, y, z], frame: frame(frame_value)?, altitude: altitude(altitude_value)? })
}

pub(super) fn end(end: Option<v1::SightLineEnd>, what: &str) -> Result<Place, Status> {
    let end = end.ok_or_else(|| missing(what))?;
    let named = |status: Status| Status::new(status.code(), format!("{what}: {}", status.message()));
    place(end.position, end.frame, end.altitude).map_err(named)
}

/// How lines are to be answered; `strict` is left to the caller.
pub(super) fn options(options: Option<&v1::QueryOptions>, site: &Site) -> Result<Options, Status> {
    use v1::Precision as Wire;
    let Some(options) = options else { return Ok(Options::default()) };
    let invalid = |error: LosError| Status::invalid_argument(format!("options: {error}"));
    let precision = match Wire::try_from(options.precision).map_err(|_| unknown("precision", options.precision))? {
        Wire::Unspecified | Wire::Exact => Precision::Exact,
        Wire::F64 => Precision::F64,
        Wire::Fast => Precision::Fast,
        Wire::Tolerance if options.tolerance >= 0.0 => Precision::Tolerance(options.tolerance),
        Wire::Tolerance => return Err(invalid(LosError::BadTolerance(options.tolerance))),
    };
    let earth = match options.sphere {
        None => Earth::Flat,
        Some(v1::SphericalEarth { radius_m, refraction }) => {
            let refraction = if refraction == 0.0 { 1.0 } else { refraction };
            Earth::sphere(radius_m, refraction, site.scale).map_err(invalid)?
        }
    };
    Ok(Options { precision, earth, ..Options::default() })
}

/// [`options`] of what is always exact.
pub(super) fn exact_options(given: Option<&v1::QueryOptions>, site: &Site) -> Result<Options, Status> {
    let options = options(given, site)?;
    if options.precision != Precision::Exact {
        return Err(Status::invalid_argument("options: this is answered with PRECISION_EXACT only"));
    }
    Ok(options)
}

fn anchor(anchor: Option<v1::Anchor>, what: &str) -> Result<Anchor, Status> {
    match anchor.and_then(|anchor| anchor.anchor).ok_or_else(|| missing(what))? {
        v1::anchor::Anchor::Entity(v1::EntityAnchor { entity_id, height_offset_m }) => {
            Ok(Anchor::Entity { id: entity_id, offset_m: height_offset_m })
        }
        v1::anchor::Anchor::Point(point) => Ok(Anchor::Point(place(point.position, point.frame, point.altitude)?)),
    }
}

fn sight_line(line: &v1::SightLine) -> Result<SightLine, Status> {
    use v1::Fidelity as Wire;
    let distance_m = line.obstruction_distance_m;
    if !(distance_m >= 0.0 && distance_m.is_finite()) {
        let what = format!("obstruction_distance_m is {distance_m}: it must be finite and not negative");
        return Err(Status::invalid_argument(what));
    }
    let fidelity = match Wire::try_from(line.fidelity).map_err(|_| unknown("fidelity", line.fidelity))? {
        Wire::Unspecified | Wire::Verdict => Fidelity::Verdict,
        Wire::Wedgie => Fidelity::Wedgie,
        Wire::Profile => Fidelity::Profile,
        Wire::Obstruction => Fidelity::Obstruction { distance_m },
    };
    let (a, b) = (anchor(line.a, "end a")?, anchor(line.b, "end b")?);
    let not_negative = |what: &str, value: f64| match value >= 0.0 && value.is_finite() {
        true => Ok(value),
        false => Err(Status::invalid_argument(format!("{what} is {value}: it must be finite and not negative"))),
    };
    let range_m = Some(not_negative("range_m", line.range_m)?).filter(|&range_m| range_m > 0.0);
    let disc = |disc: v1::Disc| {
        let v1::Position { x, y, .. } = disc.centre.ok_or_else(|| missing("region.centre"))?;
        let (frame, radius_m) = (frame(disc.frame)?, not_negative("region.radius_m", disc.radius_m)?);
        Ok::<_, Status>(Disc { centre: [x, y], frame, radius_m })
    };
    let region = line.region.map(disc).transpose()?;
    Ok(SightLine { id: line.id, a, b, fidelity, priority: line.priority, range_m, region })
}

fn entity(entity: &v1::Entity) -> Result<Entity, Status> {
    if !(entity.ground_m >= 0.0 && entity.ground_m.is_finite()) {
        let what = format!("ground_m is {}: it must be finite and not negative", entity.ground_m);
        return Err(Status::invalid_argument(what));
    }
    let ground_m = Some(entity.ground_m).filter(|&ground_m| ground_m > 0.0);
    Ok(Entity { id: entity.id, place: place(entity.position, entity.frame, entity.altitude)?, ground_m })
}

pub(super) fn change(request: &v1::ChangeExerciseRequest) -> Result<Change, Status> {
    let entities = request.put_entities.iter().map(|e| entity(e).map_err(|s| of("entity", e.id, &s)));
    let lines = request.put_sight_lines.iter().map(|l| sight_line(l).map_err(|s| of("sight line", l.id, &s)));
    Ok(Change {
        remove_entities: request.remove_entities.clone(),
        remove_sight_lines: request.remove_sight_lines.clone(),
        put_entities: entities.collect::<Result<_, _>>()?,
        put_sight_lines: lines.collect::<Result<_, _>>()?,
        lease: lease(request.lease.clone())?,
    })
}

pub(super) fn lease(lease: Option<v1::Lease>) -> Result<Option<Lease>, Status> {
    let lease = lease.map(|v1::Lease { owner, term_s }| Lease::new(&owner, term_s));
    lease.transpose().map_err(|error| Status::invalid_argument(error.to_string()))
}

pub(super) fn lease_to_wire(granted: &Granted, left: Duration, streams: u32) -> v1::LeaseState {
    v1::LeaseState {
        owner: granted.lease.owner().to_string(),
        term_s: granted.lease.term_s(),
        remaining_s: left.as_secs_f64(),
        streams,
        holds_exercise: granted.holds_exercise,
        entities: granted.entities,
        sight_lines: granted.sight_lines,
    }
}

pub(super) fn position_to_wire([x, y, z]: [f64; 3]) -> v1::Position {
    v1::Position { x, y, z }
}

pub(super) fn segment_to_wire(ends: [[f64; 3]; 2]) -> v1::Segment {
    let [a, b] = ends.map(|end| Some(position_to_wire(end)));
    v1::Segment { a, b }
}

pub(super) fn entity_to_wire(entity: &Entity) -> v1::Entity {
    let frame = match entity.place.frame {
        Frame::Grid => v1::CoordinateFrame::Grid,
        Frame::Map => v1::CoordinateFrame::Map,
        Frame::Geographic => v1::CoordinateFrame::Geographic,
        Frame::Scene => v1::CoordinateFrame::Scene,
    };
    let altitude = match entity.place.altitude {
        Altitude::Absolute => v1::AltitudeReference::Absolute,
        Altitude::AboveGround => v1::AltitudeReference::AboveGround,
    };
    v1::Entity {
        id: entity.id,
        position: Some(position_to_wire(entity.place.position)),
        frame: frame.into(),
        altitude: altitude.into(),
        ground_m: entity.ground_m.unwrap_or(0.0),
    }
}

pub(super) fn line_to_wire(state: &LineState) -> v1::SightLineState {
    crate::session::line_to_wire(state)
}

/// A verdict, and why it is UNKNOWN where it is; `None`: there is no ground to stand on.
pub(super) fn verdict_to_wire(verdict: Option<Verdict>) -> (v1::Verdict, v1::UnknownReason) {
    match verdict {
        Some(Verdict::Visible) => (v1::Verdict::Visible, v1::UnknownReason::Unspecified),
        Some(Verdict::Blocked) => (v1::Verdict::Blocked, v1::UnknownReason::Unspecified),
        Some(Verdict::Unknown) => (v1::Verdict::Unknown, v1::UnknownReason::UnknownGround),
        None => (v1::Verdict::Unknown, v1::UnknownReason::NoGround),
    }
}
