//! Viewsheds and intervisibility matrices.

use std::ops::ControlFlow;

use rayon::prelude::*;
use sightline_proto::v1;
use tonic::Status;

use super::{
    super::{
        MAX_MATRIX_POINTS, MAX_VIEWSHED_CELLS, ServedTerrain, Shared, convert,
        status::{IntoStatus, too_many, unequal},
        wanted::Wanted,
    },
    Sender, point, send,
};
use crate::{
    exercise::{Place, Site},
    los::{Lines, Options, Progress, Region, Tile, Verdict, View, ViewshedError, viewshed},
    terrain::PAGE_SIDE,
};

pub(super) struct ViewshedRequest {
    observer: Place,
    target_height: f64,
    region: Region,
    options: Options,
}

impl ViewshedRequest {
    pub(super) fn new(request: v1::QueryViewshedRequest, site: &Site) -> Result<Self, Status> {
        use v1::query_viewshed_request::Region as Wire;
        let observer = convert::end(request.observer, "observer")?;
        let options = Options { strict: request.strict, ..convert::exact_options(request.options.as_ref(), site)? };
        let region = match request.region {
            Some(Wire::RadiusM(metres)) => {
                // Squares, so that the limit is kept before anything is computed.
                let cells = (2.0 * metres / site.scale.east_m) * (2.0 * metres / site.scale.north_m);
                check_cells(cells)?;
                Region::Radius { metres, scale: site.scale }
            }
            Some(Wire::Rectangle(v1::PostRectangle { first_i, last_i, first_j, last_j })) => {
                let side = |first: u32, last: u32| f64::from(first.abs_diff(last)) + 1.0;
                check_cells(side(first_i, last_i) * side(first_j, last_j))?;
                Region::Rectangle { i: [first_i, last_i], j: [first_j, last_j] }
            }
            None => return Err(Status::invalid_argument("region is missing")),
        };
        Ok(Self { observer, target_height: request.target_height_m / site.scale.up_m, region, options })
    }

    pub(super) fn send_all<T: ServedTerrain>(
        &self,
        shared: &Shared<T>,
        wanted: &Wanted,
        sender: &Sender<v1::QueryViewshedResponse>,
    ) -> Result<(), Status> {
        let terrain = &*shared.terrain;
        let observer = point(terrain, &shared.site, &self.observer)?;
        let observer = observer.ok_or_else(|| Status::failed_precondition("no ground is known under the observer"))?;
        let Options { strict, earth, .. } = self.options;
        let view = View { observer, target_height: self.target_height, region: self.region, strict, earth };
        let mut end = Ok(());
        let found = viewshed(terrain, &view, |tile: Tile, progress| {
            end = send(sender, wanted, tile_to_wire(&tile, progress));
            if end.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        match found {
            Ok(_) | Err(ViewshedError::Stopped) => end,
            Err(ViewshedError::Los(error)) => Err(error.into_status()),
            Err(error) => Err(Status::invalid_argument(error.to_string())),
        }
    }
}

fn check_cells(cells: f64) -> Result<(), Status> {
    if cells > MAX_VIEWSHED_CELLS as f64 {
        return Err(too_many("cells in the square around a viewshed", cells as usize, MAX_VIEWSHED_CELLS));
    }
    Ok(())
}

fn tile_to_wire(tile: &Tile, progress: Progress) -> v1::QueryViewshedResponse {
    let cell = |cell: &Option<Verdict>| match cell {
        None => 0,
        Some(verdict) => i32::from(convert::verdict_to_wire(Some(*verdict)).0) as u8,
    };
    v1::QueryViewshedResponse {
        first_i: tile.page.pi * PAGE_SIDE,
        first_j: tile.page.pj * PAGE_SIDE,
        cells: tile.cells.iter().map(cell).collect(),
        done: progress.done,
        total: progress.total,
    }
}

pub(super) struct Matrix {
    places: Vec<Place>,
    options: Options,
}

impl Matrix {
    pub(super) fn new(request: v1::QueryIntervisibilityRequest, site: &Site) -> Result<Self, Status> {
        let lengths = [request.x.len(), request.y.len(), request.z.len()];
        if lengths.iter().any(|&length| length != lengths[0]) {
            return Err(unequal("x, y, z", &lengths));
        }
        if lengths[0] > MAX_MATRIX_POINTS {
            return Err(too_many("points in one matrix", lengths[0], MAX_MATRIX_POINTS));
        }
        let (frame, altitude) = (convert::frame(request.frame)?, convert::altitude(request.altitude)?);
        let options = Options { strict: request.strict, ..convert::options(request.options.as_ref(), site)? };
        let place = |n: usize| Place { position: [request.x[n], request.y[n], request.z[n]], frame, altitude };
        Ok(Self { places: (0..lengths[0]).map(place).collect(), options })
    }

    pub(super) fn send_all<T: ServedTerrain>(
        &self,
        shared: &Shared<T>,
        wanted: &Wanted,
        sender: &Sender<v1::QueryIntervisibilityResponse>,
    ) -> Result<(), Status> {
        let terrain = &*shared.terrain;
        let named = |n: usize, status: Status| Status::new(status.code(), format!("point {n}: {}", status.message()));
        let mut points = Vec::with_capacity(self.places.len());
        for (n, place) in self.places.iter().enumerate() {
            points.push(point(terrain, &shared.site, place).map_err(|status| named(n, status))?);
        }
        for (row, &from) in points.iter().enumerate() {
            let verdict = |lines: &mut Lines<'_, T>, &to: &Option<[f64; 3]>| {
                let Some((from, to)) = from.zip(to) else { return Ok(v1::Verdict::Unknown.into()) };
                let answer = lines.ask(from, to, self.options).map_err(|error| named(row, error.into_status()))?;
                Ok(convert::verdict_to_wire(Some(answer.verdict)).0.into())
            };
            let others = points[row + 1..].par_iter().map_init(|| Lines::new(terrain), verdict);
            let verdicts: Vec<Result<i32, Status>> = others.collect();
            let verdicts = verdicts.into_iter().collect::<Result<_, _>>()?;
            send(sender, wanted, v1::QueryIntervisibilityResponse { row: row as u32, verdicts })?;
        }
        Ok(())
    }
}
