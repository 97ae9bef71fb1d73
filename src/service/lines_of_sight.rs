//! Exact lines of sight on the finest terrain, one or many.

use std::sync::Arc;

use rayon::prelude::*;
use sightline_proto::v1::{self, line_of_sight_service_server::LineOfSightService};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::{
    MAX_BATCH_LINES, ServedTerrain, Service, convert,
    status::{IntoStatus, too_many, unequal},
};
use crate::{
    exercise::{Altitude, Frame, Place, Site},
    los::{self, Derived, Options, Verdict},
    terrain::{Georeference, HeightField},
};

/// Answers in one message of a batch: small enough that the first come soon.
const CHUNK_LINES: usize = 4_096;

#[tonic::async_trait]
impl<T: ServedTerrain> LineOfSightService for Service<T> {
    async fn query_line_of_sight(
        &self,
        request: Request<v1::QueryLineOfSightRequest>,
    ) -> Result<Response<v1::QueryLineOfSightResponse>, Status> {
        let request = request.into_inner();
        let ends = [convert::end(request.a, "end a")?, convert::end(request.b, "end b")?];
        let (terrain, site) = (Arc::clone(&self.0.terrain), self.0.site);
        let options = Options { strict: request.strict, ..Options::default() };
        self.0.run(move || query(&*terrain, &site, ends, options, request.derive)).await?.map(Response::new)
    }

    type QueryLineOfSightBatchStream = ReceiverStream<Result<v1::QueryLineOfSightBatchResponse, Status>>;

    async fn query_line_of_sight_batch(
        &self,
        request: Request<v1::QueryLineOfSightBatchRequest>,
    ) -> Result<Response<Self::QueryLineOfSightBatchStream>, Status> {
        let batch = Arc::new(Batch::new(request.into_inner())?);
        // One chunk waits while the next is computed; a client that does not read holds no more than that.
        let (sender, receiver) = mpsc::channel(1);
        let service = self.clone();
        tokio::spawn(async move {
            let shared = &service.0;
            for first in (0..batch.len()).step_by(CHUNK_LINES) {
                let (terrain, site, batch) = (Arc::clone(&shared.terrain), shared.site, Arc::clone(&batch));
                let chunk = shared.run(move || batch.answer(first, &*terrain, &site)).await;
                let chunk = chunk.and_then(|chunk| chunk);
                let failed = chunk.is_err();
                if sender.send(chunk).await.is_err() || failed {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Many lines in columns of equal length.
struct Batch {
    request: v1::QueryLineOfSightBatchRequest,
    frame: Frame,
    altitude: Altitude,
}

impl Batch {
    fn new(request: v1::QueryLineOfSightBatchRequest) -> Result<Self, Status> {
        let columns = [&request.ax, &request.ay, &request.az, &request.bx, &request.by, &request.bz];
        let lengths = columns.map(Vec::len);
        if lengths.iter().any(|&length| length != lengths[0]) {
            return Err(unequal("ax, ay, az, bx, by, bz", &lengths));
        }
        if lengths[0] == 0 {
            return Err(Status::invalid_argument("a batch without lines"));
        }
        if lengths[0] > MAX_BATCH_LINES {
            return Err(too_many("lines in one batch", lengths[0], MAX_BATCH_LINES));
        }
        let (frame, altitude) = (convert::frame(request.frame)?, convert::altitude(request.altitude)?);
        Ok(Self { request, frame, altitude })
    }

    fn len(&self) -> usize {
        self.request.ax.len()
    }

    fn ends(&self, n: usize) -> [Place; 2] {
        let request = &self.request;
        let place = |position| Place { position, frame: self.frame, altitude: self.altitude };
        [place([request.ax[n], request.ay[n], request.az[n]]), place([request.bx[n], request.by[n], request.bz[n]])]
    }

    /// The chunk that begins with line `first`.
    fn answer(
        &self,
        first: usize,
        terrain: &impl HeightField,
        site: &Site,
    ) -> Result<v1::QueryLineOfSightBatchResponse, Status> {
        let range = first..self.len().min(first + CHUNK_LINES);
        let options = Options { strict: self.request.strict, ..Options::default() };
        let answer = |n: usize| -> Result<(v1::Verdict, bool), Status> {
            let named = |status: Status| Status::new(status.code(), format!("line {n}: {}", status.message()));
            let Some([a, b]) = resolve(terrain, site, self.ends(n)).map_err(named)? else {
                return Ok((v1::Verdict::Unknown, false));
            };
            let answer = los::line_of_sight(terrain, a, b, options).map_err(|e| named(e.into_status()))?;
            Ok((convert::verdict_to_wire(Some(answer.verdict)).0, answer.grazes))
        };
        // All are computed, then the first error in order wins, so that the answer does not depend on threads.
        let answers: Vec<_> = range.into_par_iter().map(answer).collect();
        let (mut verdicts, mut grazes) = (Vec::with_capacity(answers.len()), Vec::with_capacity(answers.len()));
        for answer in answers {
            let (verdict, graze) = answer?;
            verdicts.push(verdict.into());
            grazes.push(graze);
        }
        Ok(v1::QueryLineOfSightBatchResponse { first_index: first as u32, verdicts, grazes })
    }
}

/// The ends in the grid frame; `None` when one is given above ground that is unknown.
fn resolve(terrain: &impl HeightField, site: &Site, ends: [Place; 2]) -> Result<Option<[[f64; 3]; 2]>, Status> {
    let point = |place: &Place| site.grid_from_place(terrain, place, 0.0).map_err(IntoStatus::into_status);
    Ok(point(&ends[0])?.zip(point(&ends[1])?).map(|(a, b)| [a, b]))
}

fn query(
    terrain: &impl HeightField,
    site: &Site,
    ends: [Place; 2],
    options: Options,
    derive: bool,
) -> Result<v1::QueryLineOfSightResponse, Status> {
    let Some([a, b]) = resolve(terrain, site, ends)? else {
        let (verdict, reason) = convert::verdict_to_wire(None);
        let (verdict, unknown_reason) = (verdict.into(), reason.into());
        return Ok(v1::QueryLineOfSightResponse { verdict, unknown_reason, ..Default::default() });
    };
    let answer = los::line_of_sight(terrain, a, b, options).map_err(IntoStatus::into_status)?;
    let (verdict, reason) = convert::verdict_to_wire(Some(answer.verdict));
    let (east_m, north_m) = ((b[0] - a[0]) * site.scale.east_m, (b[1] - a[1]) * site.scale.north_m);
    let range_m = (east_m * east_m + north_m * north_m).sqrt();
    let derived =
        if derive { los::derive(terrain, a, b, options).map_err(IntoStatus::into_status)? } else { Derived::default() };
    let seen_from = |end: [f64; 3], first: Option<los::Obstruction>| {
        let place = first?.place;
        let [x_m, y_m, z_m] =
            (site.scale.scene_from_grid(place.point.into()) - site.scale.scene_from_grid(end.into())).to_array();
        let range_m = (x_m * x_m + y_m * y_m + z_m * z_m).sqrt();
        Some(v1::Obstruction { position: Some(convert::position_to_wire(place.point)), range_m })
    };
    let (first_from_a, first_from_b) = (seen_from(a, derived.first_from_a), seen_from(b, derived.first_from_b));
    let [a, b] = [a, b].map(|end| Some(convert::position_to_wire(end)));
    Ok(v1::QueryLineOfSightResponse {
        verdict: verdict.into(),
        unknown_reason: reason.into(),
        resolved: Some(v1::Segment { a, b }),
        grazes: answer.verdict == Verdict::Visible && answer.grazes,
        range_m,
        sagitta_m: site.georeference.map_or(0.0, |_| Georeference::sagitta_m(range_m)),
        first_from_a,
        first_from_b,
        least_clearance: derived.least_clearance.filter(|_| answer.verdict == Verdict::Visible).map(|p| p.clearance),
    })
}
