//! One line, with derived values on request.

use sightline_proto::{diamond::Post, v1};
use tonic::Status;

use super::{
    super::{
        MAX_STRETCHES, convert,
        status::{IntoStatus, too_many},
    },
    range_m, resolve,
};
use crate::{
    exercise::Site,
    los::{self, Derived, GroundState, LineState, Obstruction, Options, Precision, Verdict},
    terrain::{Georeference, HeightField},
};

pub(super) fn query(
    terrain: &impl HeightField,
    site: &Site,
    request: v1::QueryLineOfSightRequest,
) -> Result<v1::QueryLineOfSightResponse, Status> {
    let ends = [convert::end(request.a, "end a")?, convert::end(request.b, "end b")?];
    let options = Options { strict: request.strict, ..convert::options(request.options.as_ref(), site)? };
    if (request.derive || request.stretches) && options.precision != Precision::Exact {
        return Err(Status::invalid_argument(
            "derive and stretches need PRECISION_EXACT: derived values are those of exact verdicts",
        ));
    }
    let Some([a, b]) = resolve(terrain, site, ends)? else {
        let (verdict, reason) = convert::verdict_to_wire(None);
        let (verdict, unknown_reason) = (verdict.into(), reason.into());
        return Ok(v1::QueryLineOfSightResponse { verdict, unknown_reason, certain: true, ..Default::default() });
    };
    let answer = los::line_of_sight(terrain, a, b, options).map_err(IntoStatus::into_status)?;
    let (verdict, reason) = convert::verdict_to_wire(Some(answer.verdict));
    let plan_m = range_m(site, [a[0], a[1], 0.0], [b[0], b[1], 0.0]);
    let mut response = v1::QueryLineOfSightResponse {
        verdict: verdict.into(),
        unknown_reason: reason.into(),
        resolved: Some(convert::segment_to_wire([a, b])),
        grazes: answer.verdict == Verdict::Visible && answer.grazes,
        range_m: plan_m,
        sagitta_m: site.georeference.map_or(0.0, |_| Georeference::sagitta_m(plan_m)),
        certain: answer.certain,
        ..Default::default()
    };
    if request.derive {
        let derived = los::derive(terrain, a, b, options).map_err(IntoStatus::into_status)?;
        let least = los::least_target_height(terrain, a, [b[0], b[1]], options).map_err(IntoStatus::into_status)?;
        add_derived(&mut response, site, [a, b], derived, answer.verdict);
        response.least_target_z = least;
    }
    if request.stretches {
        add_stretches(&mut response, terrain, [a, b], options)?;
    }
    Ok(response)
}

fn add_stretches(
    response: &mut v1::QueryLineOfSightResponse,
    terrain: &impl HeightField,
    [a, b]: [[f64; 3]; 2],
    options: Options,
) -> Result<(), Status> {
    let line = los::line_stretches(terrain, a, b, options.earth).map_err(IntoStatus::into_status)?;
    let ground = los::ground_stretches(terrain, a, [b[0], b[1]], options.earth).map_err(IntoStatus::into_status)?;
    let count = line.len().max(ground.len());
    if count > MAX_STRETCHES {
        return Err(too_many("stretches of one line", count, MAX_STRETCHES));
    }
    response.line = line
        .into_iter()
        .map(|stretch| {
            let state = match stretch.state {
                LineState::Above => v1::LineState::Above,
                LineState::Below => v1::LineState::Below,
                LineState::Unknown => v1::LineState::Unknown,
            };
            v1::LineStretch { from: stretch.from, to: stretch.to, state: state.into() }
        })
        .collect();
    response.ground = ground
        .into_iter()
        .map(|stretch| {
            let state = match stretch.state {
                GroundState::Seen => v1::GroundState::Seen,
                GroundState::Hidden => v1::GroundState::Hidden,
                GroundState::Unknown => v1::GroundState::Unknown,
            };
            v1::GroundStretch { from: stretch.from, to: stretch.to, state: state.into() }
        })
        .collect();
    Ok(())
}

fn add_derived(
    response: &mut v1::QueryLineOfSightResponse,
    site: &Site,
    [a, b]: [[f64; 3]; 2],
    derived: Derived,
    verdict: Verdict,
) {
    let seen_from = |end: [f64; 3], first: Option<Obstruction>| {
        first.map(|Obstruction { place, triangle }| v1::Obstruction {
            position: Some(convert::position_to_wire(place.point)),
            range_m: range_m(site, end, place.point),
            triangle: triangle.into_iter().flatten().flat_map(|Post { i, j }| [i, j]).collect(),
        })
    };
    response.first_from_a = seen_from(a, derived.first_from_a);
    response.first_from_b = seen_from(b, derived.first_from_b);
    if let Some(place) = derived.least_clearance.filter(|_| verdict == Verdict::Visible) {
        response.least_clearance = Some(place.clearance);
        response.least_clearance_at = Some(convert::position_to_wire(place.point));
    }
    if let Some(place) = derived.deepest {
        response.deepest = Some(-place.clearance);
        response.deepest_at = Some(convert::position_to_wire(place.point));
    }
}
