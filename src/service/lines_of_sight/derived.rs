//! Rays, horizons and profiles.

use sightline_proto::v1;
use tonic::Status;

use super::{
    super::{
        MAX_AZIMUTHS, MAX_PROFILE_BREAKS, convert,
        status::{IntoStatus, too_many},
        wanted::Wanted,
    },
    point, range_m,
};
use crate::{
    exercise::Site,
    los::{self, LosError, RayEnd},
    terrain::HeightField,
};

/// Azimuths that are computed together, over all cores, before it is asked again whether the call is wanted.
const SHARE_AZIMUTHS: usize = 32;

pub(super) fn ray(
    terrain: &impl HeightField,
    site: &Site,
    request: v1::QueryRayRequest,
) -> Result<v1::QueryRayResponse, Status> {
    let earth = convert::exact_options(request.options.as_ref(), site)?.earth;
    let Some(from) = point(terrain, site, &convert::end(request.from, "from")?)? else {
        return Ok(v1::QueryRayResponse { end: v1::RayEnd::NoGround.into(), ..Default::default() });
    };
    let v1::QueryRayRequest { azimuth_deg, elevation_deg, range_m: reach_m, .. } = request;
    let to = los::ray_end(from, azimuth_deg, elevation_deg, reach_m, site.scale, earth);
    let to = to.map_err(IntoStatus::into_status)?;
    let ray = los::ray(terrain, from, to, site.scale, earth).map_err(IntoStatus::into_status)?;
    let mut response = v1::QueryRayResponse {
        resolved: Some(convert::segment_to_wire([from, to])),
        over_unknown: ray.over_unknown,
        ..Default::default()
    };
    let end = match ray.end {
        RayEnd::StartsBelow => v1::RayEnd::StartsBelow,
        RayEnd::Miss => v1::RayEnd::Miss,
        RayEnd::Hit(hit) => {
            response.hit = Some(convert::position_to_wire(hit.point));
            response.range_m = range_m(site, from, hit.point);
            response.normal = hit.normal.map(convert::position_to_wire);
            v1::RayEnd::Hit
        }
    };
    response.end = end.into();
    Ok(response)
}

pub(super) fn horizon(
    terrain: &impl HeightField,
    site: &Site,
    request: v1::QueryHorizonRequest,
    wanted: &Wanted,
) -> Result<v1::QueryHorizonResponse, Status> {
    let earth = convert::exact_options(request.options.as_ref(), site)?.earth;
    if request.azimuths_deg.len() > MAX_AZIMUTHS {
        return Err(too_many("azimuths of one horizon", request.azimuths_deg.len(), MAX_AZIMUTHS));
    }
    if let Some(n) = request.azimuths_deg.iter().position(|azimuth| !azimuth.is_finite()) {
        return Err(Status::invalid_argument(format!("azimuths_deg[{n}] is {}, not finite", request.azimuths_deg[n])));
    }
    let Some(from) = point(terrain, site, &convert::end(request.from, "from")?)? else {
        return Ok(v1::QueryHorizonResponse::default());
    };
    let resolved = Some(convert::position_to_wire(from));
    let mut response = v1::QueryHorizonResponse { resolved, ..Default::default() };
    for azimuths in request.azimuths_deg.chunks(SHARE_AZIMUTHS) {
        wanted.check()?;
        let share = los::horizon(terrain, from, azimuths, request.range_m, site.scale, earth);
        for horizon in share.map_err(IntoStatus::into_status)? {
            response.known.push(horizon.crest.is_some());
            response.elevation_deg.push(horizon.crest.map_or(0.0, |crest| crest.elevation_deg));
            response.range_m.push(horizon.crest.map_or(0.0, |crest| crest.range_m));
            response.over_unknown.push(horizon.over_unknown);
            response.below_ground |= horizon.below_ground;
        }
    }
    Ok(response)
}

pub(super) fn profile(
    terrain: &impl HeightField,
    site: &Site,
    request: v1::QueryProfileRequest,
) -> Result<v1::QueryProfileResponse, Status> {
    let earth = convert::exact_options(request.options.as_ref(), site)?.earth;
    let frame = convert::frame(request.frame)?;
    let end = |x, y| site.grid_from_plan(frame, x, y).map_err(IntoStatus::into_status);
    let (a, b) = (end(request.ax, request.ay)?, end(request.bx, request.by)?);
    let breaks = los::profile(terrain, a, b, MAX_PROFILE_BREAKS).map_err(|error| match error {
        LosError::TooManyBreaks { .. } => Status::resource_exhausted(error.to_string()),
        error => error.into_status(),
    })?;
    let mut response = v1::QueryProfileResponse::default();
    for stop in breaks {
        response.t.push(stop.t);
        response.x.push(stop.point[0]);
        response.y.push(stop.point[1]);
        response.ground.push(stop.ground.unwrap_or(0.0));
        response.known.push(stop.ground.is_some());
        response.known_after.push(stop.known_after);
        if !earth.is_flat() {
            response.bulge.push(earth.bulge(a, b, stop.t));
        }
    }
    Ok(response)
}
