//! Watches of an exercise's verdicts: one task each, which tells what is new whenever its reader has taken what came before.
//!
//! One message waits for the reader; what happens meanwhile is told in the next one, so a slow reader holds up nothing and
//! costs one verdict a line.

use std::sync::Arc;

use sightline_proto::v1;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use tracing::Instrument;

use super::{
    ServedTerrain, Shared, access::Caller, followed::Followed, leases::Hold, limits::WatchSeat, status, stopped,
};
use crate::session::{MAX_SUBSCRIBED_IDS, VerdictWatch};

/// What a watch says.
pub(super) type Stream = ReceiverStream<Result<v1::WatchExerciseResponse, Status>>;

struct Task<T> {
    shared: Arc<Shared<T>>,
    /// Absent while it is looked for news.
    watch: Option<VerdictWatch>,
    followed: Followed,
    changes: watch::Receiver<u64>,
    outbox: mpsc::Sender<Result<v1::WatchExerciseResponse, Status>>,
    _seat: WatchSeat,
    _hold: Option<Hold>,
}

/// Begins a watch of `caller`.
pub(super) async fn begin<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    caller: &Caller,
    request: v1::WatchExerciseRequest,
) -> Result<Stream, Status> {
    let seat = shared.accounts.watch_seat(&caller.name)?;
    let lines = request.sight_lines.len();
    let watch = VerdictWatch::new(&request.sight_lines);
    let watch = watch.ok_or_else(|| status::too_many("sight lines to watch", lines, MAX_SUBSCRIBED_IDS))?;
    let changes = shared.changes.subscribe();
    let followed = Followed::find(shared, &request.name).await?;
    let followed = followed.ok_or_else(|| Status::invalid_argument("the name of an exercise is missing"))?;
    let hold = followed.hold(shared, &request.lease_owner);
    let (outbox, said) = mpsc::channel(1);
    let (shared, watch) = (Arc::clone(shared), Some(watch));
    let task = Task { shared, watch, followed, changes, outbox, _seat: seat, _hold: hold };
    tracing::info!(exercise = request.name, client = &*caller.name, "watch of verdicts begins");
    tokio::spawn(task.run().in_current_span());
    Ok(ReceiverStream::new(said))
}

impl<T: ServedTerrain> Task<T> {
    async fn run(mut self) {
        let mut stopping = self.shared.stopping.clone();
        let outbox = self.outbox.clone();
        let end = tokio::select! {
            end = self.live() => end,
            () = stopped(&mut stopping) => Err(Status::unavailable("the server is stopping")),
            () = outbox.closed() => Ok(()),
        };
        tracing::info!(reason = end.as_ref().err().map(Status::message), "watch of verdicts ends");
        // Its place is free, and its lease runs, before its end is told.
        drop(self);
        if let Err(status) = end {
            let _ = outbox.send(Err(status)).await;
        }
    }

    async fn live(&mut self) -> Result<(), Status> {
        let gone = |_| Status::cancelled("the client is gone");
        loop {
            // Whoever has not taken the last news is not told of what is old by then.
            let permit = self.outbox.clone().reserve_owned().await.map_err(gone)?;
            permit.send(Ok(self.news().await?));
        }
    }

    /// What is new, as soon as something is.
    async fn news(&mut self) -> Result<v1::WatchExerciseResponse, Status> {
        loop {
            self.changes.mark_unchanged();
            self.followed.look(&self.shared, &mut None).await?;
            let lost = || Status::internal(super::DEFECT);
            let (mut watch, exercise) = (self.watch.take().ok_or_else(lost)?, Arc::clone(self.followed.exercise()));
            let (watch, news) = self
                .shared
                .run(move || {
                    let news = watch.news(&exercise);
                    (watch, news)
                })
                .await?;
            self.watch = Some(watch);
            if let Some(news) = news {
                return Ok(news);
            }
            self.changes.changed().await.map_err(|_| Status::unavailable("the server is stopping"))?;
        }
    }
}
