//! Views: one task each, which takes what the client and the exercise say, and sends a frame when one is due.
//!
//! The frame in the making and the one that waits for the network are the only ones held: the newest pose waits for
//! both. When the client goes away its stream ends or sending fails, the task ends, and with it the view.

use std::sync::Arc;

use sightline_proto::v1::{
    self, scene_service_server::SceneService, stream_scene_request::Request as Wish,
    stream_scene_response::Response as Word,
};
use tokio::{
    sync::{OwnedSemaphorePermit, mpsc, watch},
    time::timeout,
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

use super::{
    OPENING_TIME, ServedTerrain, Service, Shared,
    status::{IntoStatus, too_many},
    stopped,
};
use crate::{
    exercise::Exercise,
    session::{Event, Pose, Settings, SettingsError, View},
};

/// Messages of a client that are taken in a row before a frame gets its turn.
const MAX_MESSAGES_IN_A_ROW: u32 = 64;

type Outbox = mpsc::Sender<Result<v1::StreamSceneResponse, Status>>;

#[tonic::async_trait]
impl<T: ServedTerrain> SceneService for Service<T> {
    type StreamSceneStream = ReceiverStream<Result<v1::StreamSceneResponse, Status>>;

    async fn stream_scene(
        &self,
        request: Request<Streaming<v1::StreamSceneRequest>>,
    ) -> Result<Response<Self::StreamSceneStream>, Status> {
        let shared = Arc::clone(&self.0);
        let permit = Arc::clone(&shared.views).try_acquire_owned();
        let permit = permit.map_err(|_| too_many("views", shared.limits.views + 1, shared.limits.views))?;
        let mut inbox = request.into_inner();
        let open = opening(&mut inbox).await?;
        // Opened here holds one message, the view's task the next: hand-over is one deep.
        let (outbox, stream) = mpsc::channel(1);
        let changes = shared.changes.subscribe();
        let followed = Followed::find(&shared, &open.exercise).await?;
        let view = open_view(&shared, &open, followed.as_ref().map(|f| Arc::clone(&f.exercise))).await?;
        let opened = v1::ViewOpened { terrain: Some(shared.description.clone()) };
        let _ = outbox.try_send(Ok(word(Word::Opened(opened))));
        let task = ViewTask { shared, view: Some(view), followed, changes, inbox, outbox, _permit: permit };
        tracing::info!(exercise = open.exercise, "view opened");
        tokio::spawn(task.run());
        Ok(Response::new(ReceiverStream::new(stream)))
    }
}

fn word(response: Word) -> v1::StreamSceneResponse {
    v1::StreamSceneResponse { response: Some(response) }
}

/// The first message, which must open the view.
async fn opening(inbox: &mut Streaming<v1::StreamSceneRequest>) -> Result<v1::OpenView, Status> {
    let first = timeout(OPENING_TIME, inbox.message()).await;
    let first = first.map_err(|_| Status::deadline_exceeded("the client did not say what view it wants"))??;
    match first.and_then(|first| first.request) {
        Some(Wish::Open(open)) => Ok(open),
        _ => Err(Status::invalid_argument("the first message of a view must open it")),
    }
}

async fn open_view<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    open: &v1::OpenView,
    exercise: Option<Arc<Exercise>>,
) -> Result<View<T>, Status> {
    let missing = |what| SettingsError::Missing(what).into_status();
    let settings = open.settings.as_ref().ok_or_else(|| missing("settings"))?;
    let pose = open.pose.as_ref().ok_or_else(|| missing("pose"))?;
    let settings = Settings::from_wire(settings).map_err(IntoStatus::into_status)?;
    let pose = Pose::from_wire(pose).map_err(IntoStatus::into_status)?;
    let inner = Arc::clone(shared);
    let view =
        move || View::open(Arc::clone(&inner.terrain), inner.site.scale, &inner.description, settings, pose, exercise);
    shared.run(view).await?.map_err(IntoStatus::into_status)
}

/// The exercise that a view follows, as it was last seen.
struct Followed {
    name: String,
    created: u64,
    revision: u64,
    exercise: Arc<Exercise>,
}

impl Followed {
    /// The exercise called `name`; none when the name is empty.
    async fn find<T: ServedTerrain>(shared: &Arc<Shared<T>>, name: &str) -> Result<Option<Self>, Status> {
        if name.is_empty() {
            return Ok(None);
        }
        let (inner, key) = (Arc::clone(shared), name.to_owned());
        let stored = shared.run(move || inner.store.get(&key)).await?.map_err(IntoStatus::into_status)?;
        let (created, revision, exercise) = (stored.created, stored.revision, stored.exercise);
        Ok(Some(Self { name: name.to_owned(), created, revision, exercise }))
    }

    /// Looks again; whether it has moved on. An exercise that has ended ends its views.
    async fn look<T: ServedTerrain>(&mut self, shared: &Arc<Shared<T>>) -> Result<bool, Status> {
        let now = Self::find(shared, &self.name).await?.filter(|now| now.created == self.created);
        let now = now.ok_or_else(|| Status::not_found(format!("exercise '{}' has ended", self.name)))?;
        let moved = now.revision != self.revision;
        *self = now;
        Ok(moved)
    }
}

struct ViewTask<T: ServedTerrain> {
    shared: Arc<Shared<T>>,
    /// Absent while a frame is being made.
    view: Option<View<T>>,
    followed: Option<Followed>,
    changes: watch::Receiver<u64>,
    inbox: Streaming<v1::StreamSceneRequest>,
    outbox: Outbox,
    _permit: OwnedSemaphorePermit,
}

impl<T: ServedTerrain> ViewTask<T> {
    async fn run(mut self) {
        let mut stopping = self.shared.stopping.clone();
        let outbox = self.outbox.clone();
        let end = tokio::select! {
            end = self.live() => end,
            () = stopped(&mut stopping) => Err(Status::unavailable("the server is stopping")),
            () = outbox.closed() => Ok(()),
        };
        let frames = self.view.as_ref().map_or(0, |view| view.sent().sequence());
        tracing::info!(frames, reason = end.as_ref().err().map(Status::message), "view closed");
        if let Err(status) = end {
            // Waits behind the frame that is on its way, but not for ever: the connection's keepalive sees to that.
            let _ = outbox.send(Err(status)).await;
        }
    }

    /// The life of the view, until its client ends it or something is wrong.
    async fn live(&mut self) -> Result<(), Status> {
        let mut in_a_row = 0;
        loop {
            let is_due = self.view.as_ref().is_some_and(View::is_due);
            tokio::select! {
                biased;
                changed = self.changes.changed(), if self.followed.is_some() => {
                    changed.map_err(|_| Status::unavailable("the server is stopping"))?;
                    self.follow().await?;
                }
                message = self.inbox.message(), if !is_due || in_a_row < MAX_MESSAGES_IN_A_ROW => {
                    in_a_row += 1;
                    let Some(message) = message? else { return Ok(()) };
                    self.hear(message)?;
                }
                permit = self.outbox.clone().reserve_owned(), if is_due => {
                    in_a_row = 0;
                    let permit = permit.map_err(|_| Status::cancelled("the client is gone"))?;
                    self.deliver(permit).await?;
                }
            }
        }
    }

    fn hear(&mut self, message: v1::StreamSceneRequest) -> Result<(), Status> {
        let event = match message.request {
            Some(Wish::Steer(steer)) => Event::Steer(steer),
            Some(Wish::Snapshot(request)) => Event::Snapshot(request),
            Some(Wish::Open(_)) => return Err(Status::invalid_argument("a view is opened once")),
            None => return Err(Status::invalid_argument("a message that says nothing")),
        };
        self.tell(event)
    }

    async fn follow(&mut self) -> Result<(), Status> {
        let Some(followed) = &mut self.followed else { return Ok(()) };
        if followed.look(&self.shared).await? {
            let exercise = Arc::clone(&followed.exercise);
            self.tell(Event::Exercise(exercise))?;
        }
        Ok(())
    }

    fn tell(&mut self, event: Event) -> Result<(), Status> {
        let view = self.view.as_mut().ok_or_else(|| Status::internal("a view was lost in a defect"))?;
        view.handle(event).map_err(IntoStatus::into_status)
    }

    /// Makes the next frame and hands it over, with the update of the exercise before it.
    async fn deliver(
        &mut self,
        permit: mpsc::OwnedPermit<Result<v1::StreamSceneResponse, Status>>,
    ) -> Result<(), Status> {
        let mut view = self.view.take().ok_or_else(|| Status::internal("a view was lost in a defect"))?;
        let (view, words) = self
            .shared
            .run(move || {
                let words = view.produce();
                (view, words)
            })
            .await?;
        self.view = Some(view);
        let mut words = words.map_err(IntoStatus::into_status)?.into_iter();
        if let Some(first) = words.next() {
            permit.send(Ok(word(first)));
        }
        for next in words {
            self.outbox.send(Ok(word(next))).await.map_err(|_| Status::cancelled("the client is gone"))?;
        }
        Ok(())
    }
}
