//! Exact lines of sight on the finest terrain, and what follows from them.
//!
//! Each call computes off the network threads, in shares; between two shares it asks whether it is still wanted.

mod batch;
mod derived;
mod maps;
mod single;
mod stream;

use std::sync::Arc;

use sightline_proto::{
    predicates::exact_signs_here,
    v1::{self, line_of_sight_service_server::LineOfSightService},
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use tracing::Instrument;

use self::batch::Batch;
use super::{
    DEFECT, MAX_ANSWERING, ServedTerrain, Service, Shared,
    limits::limited,
    status::{IntoStatus, too_many},
    wanted::{Call, Wanted, deadline_exceeded},
};
use crate::{
    exercise::{Place, Site},
    terrain::HeightField,
};

/// What a server stream sends.
type Sender<R> = mpsc::Sender<Result<R, Status>>;

#[tonic::async_trait]
impl<T: ServedTerrain> LineOfSightService for Service<T> {
    async fn query_line_of_sight(
        &self,
        request: Request<v1::QueryLineOfSightRequest>,
    ) -> Result<Response<v1::QueryLineOfSightResponse>, Status> {
        let query = |terrain: &T, site: &Site, request, _: &Wanted| {
            let before = exact_signs_here();
            let answer = single::query(terrain, site, request)?;
            Ok((answer, exact_signs_here() > before))
        };
        let (answer, is_exact) = self.compute(request, query).await?.into_inner();
        self.0.metrics.answered(&[answer.verdict], is_exact.into());
        Ok(Response::new(answer))
    }

    type QueryLineOfSightBatchStream = ReceiverStream<Result<v1::QueryLineOfSightBatchResponse, Status>>;

    async fn query_line_of_sight_batch(
        &self,
        request: Request<v1::QueryLineOfSightBatchRequest>,
    ) -> Result<Response<Self::QueryLineOfSightBatchStream>, Status> {
        let (wanted, call) = Wanted::of(&request);
        let (request, limit) = (request.into_inner(), self.0.limits.batch_lines);
        if request.ax.len() > limit {
            return Err(limited("batch_lines", "lines in one batch", request.ax.len() as u64, limit as u64));
        }
        let batch = Batch::new(request, &self.0.site, limit)?;
        self.produce(wanted, call, move |shared, wanted, sender| batch.send_all(shared, wanted, &sender))
    }

    type StreamLinesOfSightStream = ReceiverStream<Result<v1::StreamLinesOfSightResponse, Status>>;

    async fn stream_lines_of_sight(
        &self,
        request: Request<Streaming<v1::StreamLinesOfSightRequest>>,
    ) -> Result<Response<Self::StreamLinesOfSightStream>, Status> {
        let (wanted, call) = Wanted::of(&request);
        let (sender, receiver) = mpsc::channel(1);
        let run = stream::run(Arc::clone(&self.0), request.into_inner(), sender, wanted, call);
        tokio::spawn(run.in_current_span());
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn query_ray(&self, request: Request<v1::QueryRayRequest>) -> Result<Response<v1::QueryRayResponse>, Status> {
        self.compute(request, |terrain, site, request, _| derived::ray(terrain, site, request)).await
    }

    async fn query_horizon(
        &self,
        request: Request<v1::QueryHorizonRequest>,
    ) -> Result<Response<v1::QueryHorizonResponse>, Status> {
        self.compute(request, derived::horizon).await
    }

    async fn query_profile(
        &self,
        request: Request<v1::QueryProfileRequest>,
    ) -> Result<Response<v1::QueryProfileResponse>, Status> {
        self.compute(request, |terrain, site, request, _| derived::profile(terrain, site, request)).await
    }

    type QueryViewshedStream = ReceiverStream<Result<v1::QueryViewshedResponse, Status>>;

    async fn query_viewshed(
        &self,
        request: Request<v1::QueryViewshedRequest>,
    ) -> Result<Response<Self::QueryViewshedStream>, Status> {
        let (wanted, call) = Wanted::of(&request);
        let request = maps::ViewshedRequest::new(request.into_inner(), &self.0.site)?;
        self.produce(wanted, call, move |shared, wanted, sender| request.send_all(shared, wanted, &sender))
    }

    type QueryIntervisibilityStream = ReceiverStream<Result<v1::QueryIntervisibilityResponse, Status>>;

    async fn query_intervisibility(
        &self,
        request: Request<v1::QueryIntervisibilityRequest>,
    ) -> Result<Response<Self::QueryIntervisibilityStream>, Status> {
        let (wanted, call) = Wanted::of(&request);
        let request = maps::Matrix::new(request.into_inner(), &self.0.site)?;
        self.produce(wanted, call, move |shared, wanted, sender| request.send_all(shared, wanted, &sender))
    }
}

impl<T: ServedTerrain> Service<T> {
    /// One answer to one question.
    async fn compute<Q, A>(
        &self,
        request: Request<Q>,
        answer: impl FnOnce(&T, &Site, Q, &Wanted) -> Result<A, Status> + Send + 'static,
    ) -> Result<Response<A>, Status>
    where
        Q: Send + 'static,
        A: Send + 'static,
    {
        // Dropped with this future, which is when the client cancels.
        let (wanted, _call) = Wanted::of(&request);
        let (shared, request, asked) = (Arc::clone(&self.0), request.into_inner(), wanted.clone());
        let work = self.0.run(move || {
            asked.check()?;
            answer(&*shared.terrain, &shared.site, request, &asked)
        });
        tokio::select! {
            answered = work => answered?.map(Response::new),
            () = wanted.expired() => Err(deadline_exceeded()),
        }
    }

    /// Many answers to one question: one waits while the next is computed, so a client that does not read holds no more
    /// than that. The work ends when the client goes or its deadline passes. It takes no turn of [`Shared::run`], which a
    /// slow reader would keep: what is heavy in it runs on rayon's pool.
    fn produce<A: Send + 'static>(
        &self,
        wanted: Wanted,
        call: Call,
        work: impl FnOnce(&Shared<T>, &Wanted, Sender<A>) -> Result<(), Status> + Send + 'static,
    ) -> Result<Response<ReceiverStream<Result<A, Status>>>, Status> {
        let place = Arc::clone(&self.0.answering).try_acquire_owned();
        let place = place.map_err(|_| too_many("streams of answers under way", MAX_ANSWERING, MAX_ANSWERING))?;
        let (sender, receiver) = mpsc::channel(1);
        let (shared, observer) = (Arc::clone(&self.0), Arc::clone(&self.0));
        let span = tracing::Span::current();
        let run = async move {
            let (asked, answers) = (wanted.clone(), sender.clone());
            let done = tokio::task::spawn_blocking(move || {
                let done = span.in_scope(|| work(&shared, &asked, answers));
                drop(place);
                done
            });
            let end = tokio::select! {
                done = done => done.unwrap_or_else(|_| Err(Status::internal(DEFECT))),
                () = wanted.expired() => Err(deadline_exceeded()),
                () = sender.closed() => Ok(()),
            };
            drop(call);
            if let Err(status) = end {
                let _ = sender.send(Err(observer.health.seen(status))).await;
            }
        };
        tokio::spawn(run.in_current_span());
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Hands an answer over from a thread that computes; waits while the client does not read.
fn send<A>(sender: &Sender<A>, wanted: &Wanted, answer: A) -> Result<(), Status> {
    wanted.check()?;
    sender.blocking_send(Ok(answer)).map_err(|_| Status::cancelled("the client has gone"))
}

/// A place in the grid frame; `None` when it is given above ground that is unknown.
fn point(terrain: &impl HeightField, site: &Site, place: &Place) -> Result<Option<[f64; 3]>, Status> {
    site.grid_from_place(terrain, place, 0.0).map_err(IntoStatus::into_status)
}

/// The ends in the grid frame; `None` when one is given above ground that is unknown.
fn resolve(terrain: &impl HeightField, site: &Site, ends: [Place; 2]) -> Result<Option<[[f64; 3]; 2]>, Status> {
    Ok(point(terrain, site, &ends[0])?.zip(point(terrain, site, &ends[1])?).map(|(a, b)| [a, b]))
}

/// Slant distance in the scene frame.
fn range_m(site: &Site, from: [f64; 3], to: [f64; 3]) -> f64 {
    let [x, y, z] = (site.scale.scene_from_grid(to.into()) - site.scale.scene_from_grid(from.into())).to_array();
    (x * x + y * y + z * z).sqrt()
}
