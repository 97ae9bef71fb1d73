//! Views for clients without bidirectional streams: one stream on which any number of views is watched, and calls that
//! open, steer and close them. The views are the same tasks as those of a stream of their own.
//!
//! A view ends with its watch, and a watch with its stream, so nothing outlives a client that vanishes. Each view has
//! one message waiting for the stream; those of the views take turns.

use std::{
    collections::BTreeMap,
    hash::{BuildHasher, RandomState},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use sightline_proto::v1::{
    self, stream_scene_request::Request as Wish, tell_watched_view_request::Request as Told,
    watch_views_response::Response as Word,
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use tracing::Instrument;

use super::{ServedTerrain, Shared, access::Caller, limits::limited, stopped, views};

/// What a client may have said to a view that has not heard it yet.
const MAX_UNHEARD: usize = 16;

/// What a watch's stream carries.
pub(super) type WatchStream = ReceiverStream<Result<v1::WatchViewsResponse, Status>>;

type Inbox = mpsc::Sender<Result<v1::StreamSceneRequest, Status>>;

#[derive(Debug)]
struct Watch {
    stream: mpsc::Sender<Result<v1::WatchViewsResponse, Status>>,
    /// Those that are closing have no inbox any more, but their number.
    views: BTreeMap<u64, Option<Inbox>>,
}

/// The watches of a server.
#[derive(Debug, Default)]
pub(super) struct Watches {
    open: Mutex<BTreeMap<String, Watch>>,
}

fn word(response: Word) -> v1::WatchViewsResponse {
    v1::WatchViewsResponse { response: Some(response) }
}

impl Watches {
    // Each change of it is one insertion or removal.
    fn open(&self) -> MutexGuard<'_, BTreeMap<String, Watch>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn inbox(&self, watch_id: &str, view_id: u64) -> Result<Inbox, Status> {
        let open = self.open();
        let watch = open.get(watch_id).ok_or_else(no_watch)?;
        let inbox = watch.views.get(&view_id).cloned().flatten();
        inbox.ok_or_else(|| Status::not_found(format!("the watch has no open view {view_id}")))
    }
}

fn no_watch() -> Status {
    Status::not_found("there is no such watch: its stream has ended, or never began")
}

/// A name that nobody guesses: two keyed hashes whose keys the system drew.
fn unguessable() -> String {
    let hash = || RandomState::new().hash_one(0_u64);
    format!("{:016x}{:016x}", hash(), hash())
}

/// Begins a watch.
pub(super) fn begin<T: ServedTerrain>(shared: &Arc<Shared<T>>) -> Result<WatchStream, Status> {
    let (stream, receiver) = mpsc::channel(1);
    let id = unguessable();
    let begun = word(Word::Begun(v1::WatchBegun { watch_id: id.clone() }));
    let _ = stream.try_send(Ok(begun));
    {
        let mut open = shared.watches.open();
        let (found, limit) = (open.len() as u64 + 1, shared.limits.views as u64);
        if found > limit {
            return Err(limited("views", "watches", found, limit));
        }
        open.insert(id.clone(), Watch { stream: stream.clone(), views: BTreeMap::new() });
    }
    let shared = Arc::clone(shared);
    let end = async move {
        let mut stopping = shared.stopping.clone();
        tokio::select! {
            () = stream.closed() => {}
            () = stopped(&mut stopping) => {
                let _ = stream.send(Err(Status::unavailable("the server is stopping"))).await;
            }
        }
        // With it go the inboxes of its views, and so the views.
        shared.watches.open().remove(&id);
        tracing::info!("watch of views ends");
    };
    tokio::spawn(end.in_current_span());
    Ok(ReceiverStream::new(receiver))
}

/// Opens a view on a watch.
pub(super) async fn open<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    caller: &Caller,
    request: v1::OpenWatchedViewRequest,
) -> Result<(), Status> {
    let v1::OpenWatchedViewRequest { watch_id, view_id, open } = request;
    let open = open.ok_or_else(|| Status::invalid_argument("open is missing"))?;
    let (inbox, heard) = mpsc::channel(MAX_UNHEARD);
    let stream = {
        let mut watches = shared.watches.open();
        let watch = watches.get_mut(&watch_id).ok_or_else(no_watch)?;
        if watch.views.contains_key(&view_id) {
            return Err(Status::already_exists(format!("the watch has a view {view_id} that has not said its end")));
        }
        watch.views.insert(view_id, Some(inbox));
        watch.stream.clone()
    };
    let said = match views::open(shared, caller, open, Box::pin(ReceiverStream::new(heard))).await {
        Ok(said) => said,
        Err(status) => {
            forget(shared, &watch_id, view_id);
            return Err(status);
        }
    };
    tokio::spawn(forward(Arc::clone(shared), watch_id, view_id, said, stream));
    Ok(())
}

fn forget<T>(shared: &Shared<T>, watch_id: &str, view_id: u64) {
    if let Some(watch) = shared.watches.open().get_mut(watch_id) {
        watch.views.remove(&view_id);
    }
}

/// Carries what a view says to the stream of its watch, and its end.
async fn forward<T: ServedTerrain>(
    shared: Arc<Shared<T>>,
    watch_id: String,
    view_id: u64,
    mut said: mpsc::Receiver<Result<v1::StreamSceneResponse, Status>>,
    stream: mpsc::Sender<Result<v1::WatchViewsResponse, Status>>,
) {
    let mut closed = v1::WatchedViewClosed { view_id, code: 0, reason: String::new() };
    while let Some(next) = said.recv().await {
        match next {
            Ok(message) => {
                let message = v1::WatchedViewMessage { view_id, message: Some(message) };
                if stream.send(Ok(word(Word::Message(message)))).await.is_err() {
                    break;
                }
            }
            Err(status) => {
                closed.code = i32::from(status.code()).unsigned_abs();
                closed.reason = status.message().to_owned();
            }
        }
    }
    forget(&shared, &watch_id, view_id);
    let _ = stream.send(Ok(word(Word::Closed(closed)))).await;
}

/// Says something to a view.
pub(super) async fn tell<T: ServedTerrain>(
    shared: &Shared<T>,
    request: v1::TellWatchedViewRequest,
) -> Result<(), Status> {
    let inbox = shared.watches.inbox(&request.watch_id, request.view_id)?;
    let wish = match request.request.ok_or_else(|| Status::invalid_argument("a message that says nothing"))? {
        Told::Steer(steer) => Wish::Steer(steer),
        Told::Snapshot(snapshot) => Wish::Snapshot(snapshot),
    };
    let told = inbox.send(Ok(v1::StreamSceneRequest { request: Some(wish) })).await;
    told.map_err(|_| Status::not_found("the view has ended"))
}

/// Closes a view.
pub(super) fn close<T>(shared: &Shared<T>, request: &v1::CloseWatchedViewRequest) -> Result<(), Status> {
    shared.watches.inbox(&request.watch_id, request.view_id)?;
    // The view hears the end of its messages when the last inbox is gone; its number is free when it has said so.
    if let Some(watch) = shared.watches.open().get_mut(&request.watch_id) {
        watch.views.insert(request.view_id, None);
    }
    Ok(())
}
