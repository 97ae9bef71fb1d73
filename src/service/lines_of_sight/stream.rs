//! Questions as they arise: groups of lines in, answers out as they are ready.
//!
//! A group is read only when there is room for it, and its room is free again only when its answers have been handed
//! over: so a client that does not read is not read either, and nothing queues.

use std::sync::Arc;

use sightline_proto::v1;
use tokio::sync::Semaphore;
use tonic::{Status, Streaming};
use tracing::Instrument;

use super::{
    super::{
        MAX_STREAM_GROUPS, MAX_STREAM_LINES, ServedTerrain, Shared,
        status::unequal,
        wanted::{Call, Wanted, deadline_exceeded},
    },
    Sender,
    batch::Batch,
};

/// The life of one stream.
pub(super) async fn run<T: ServedTerrain>(
    shared: Arc<Shared<T>>,
    mut groups: Streaming<v1::StreamLinesOfSightRequest>,
    sender: Sender<v1::StreamLinesOfSightResponse>,
    wanted: Wanted,
    call: Call,
) {
    let mut stopping = shared.stopping.clone();
    let end = tokio::select! {
        end = answer_all(&shared, &mut groups, &sender, &wanted) => end,
        () = wanted.expired() => Err(deadline_exceeded()),
        () = super::super::stopped(&mut stopping) => Err(Status::unavailable("the server is stopping")),
        () = sender.closed() => Ok(()),
    };
    drop(call);
    if let Err(status) = end {
        let _ = sender.send(Err(status)).await;
    }
}

async fn answer_all<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    groups: &mut Streaming<v1::StreamLinesOfSightRequest>,
    sender: &Sender<v1::StreamLinesOfSightResponse>,
    wanted: &Wanted,
) -> Result<(), Status> {
    let room = Arc::new(Semaphore::new(MAX_STREAM_GROUPS));
    let gone = |_| Status::cancelled("the client has gone");
    loop {
        let place = Arc::clone(&room).acquire_owned().await.map_err(|_| Status::internal("the stream has no room"))?;
        let Some(group) = groups.message().await? else { break };
        let (shared, sender, wanted) = (Arc::clone(shared), sender.clone(), wanted.clone());
        let group = async move {
            let answers = answer(&shared, group, wanted).await;
            let _ = sender.send(Ok(answers)).await;
            drop(place);
        };
        tokio::spawn(group.in_current_span());
    }
    // The client has said all: what it asked is still answered.
    let all = u32::try_from(MAX_STREAM_GROUPS).unwrap_or(u32::MAX);
    room.acquire_many(all).await.map(drop).map_err(|_| Status::internal("the stream has no room"))?;
    if sender.is_closed() { Err(gone(())) } else { Ok(()) }
}

async fn answer<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    v1::StreamLinesOfSightRequest { ids, lines }: v1::StreamLinesOfSightRequest,
    wanted: Wanted,
) -> v1::StreamLinesOfSightResponse {
    let batch = Batch::new(lines.unwrap_or_default(), &shared.site, MAX_STREAM_LINES.min(shared.limits.batch_lines));
    let batch = batch.and_then(|batch| match batch.len() == ids.len() {
        true => Ok(batch),
        false => Err(unequal("ids, lines", &[ids.len(), batch.len()])),
    });
    let answered = match batch {
        Err(status) => Err(status),
        Ok(batch) => {
            let inner = Arc::clone(shared);
            let work = move || batch.answer_all(&*inner.terrain, &inner.site, &wanted);
            shared.run(work).await.and_then(|answered| answered)
        }
    };
    match answered {
        Ok((v1::QueryLineOfSightBatchResponse { verdicts, grazes, certain, .. }, exact_lines)) => {
            shared.metrics.answered(&verdicts, exact_lines);
            v1::StreamLinesOfSightResponse { ids, verdicts, grazes, certain, refusal: None }
        }
        Err(status) => {
            shared.health.observe(status.code());
            let refusal = v1::Refusal { code: i32::from(status.code()) as u32, message: status.message().into() };
            v1::StreamLinesOfSightResponse { ids, refusal: Some(refusal), ..Default::default() }
        }
    }
}
