//! Views: one task each, which takes what the client and the exercise say, and sends a frame when one is due.
//!
//! The frame in the making and the one that waits for the network are the only ones held: the newest pose waits for
//! both, and for the pace that the client chose. When the client goes away its stream ends or sending fails, the task
//! ends, and with it the view. Where its messages come from, a stream or a watch, it does not know.

use std::{pin::Pin, sync::Arc, time::Instant};

use prost::Message;
use sightline_proto::v1::{
    self, stream_scene_request::Request as Wish, stream_scene_response::Response as Word, view_settings::Target,
};
use tokio::sync::{mpsc, watch};
use tokio_stream::{Stream, StreamExt};
use tonic::Status;
use tracing::Instrument;

use super::{
    Lookout, ServedTerrain, Shared, access::Caller, admission::explained, followed::Followed, leases::Hold,
    limits::Seat, read_ahead::ReadAhead, status::IntoStatus, stopped,
};
use crate::session::{Course, Event, Pacer, Pose, Settings, SettingsError, View, journal::Tape};

/// Messages of a client that are taken in a row before a frame gets its turn.
const MAX_MESSAGES_IN_A_ROW: u32 = 64;

/// What a client says.
pub(super) type Inbox = Pin<Box<dyn Stream<Item = Result<v1::StreamSceneRequest, Status>> + Send>>;
/// What a view says.
type Outbox = mpsc::Sender<Result<v1::StreamSceneResponse, Status>>;

/// Opens a view of `caller` and lets it live; returns what it says.
pub(super) async fn open<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    caller: &Caller,
    open: v1::OpenView,
    inbox: Inbox,
) -> Result<mpsc::Receiver<Result<v1::StreamSceneResponse, Status>>, Status> {
    let seat = shared.accounts.seat(&caller.name, budget(open.settings.as_ref()))?;
    let mut pacer = Pacer::default();
    pacer.set(&open.pace.unwrap_or_default()).map_err(IntoStatus::into_status)?;
    // Opened here holds one message, the view's task the next: hand-over is one deep.
    let (outbox, said) = mpsc::channel(1);
    let changes = shared.changes.subscribe();
    let (inner, exercise) = (Arc::clone(shared), open.exercise.clone());
    let Beginning { view, followed, hold, tape } = shared.run(move || make(&inner, &open)).await??;
    let (course, lookout) = (Course::new(0.0, *view.pose()), shared.read_ahead.as_ref().map(ReadAhead::lookout));
    let opened = v1::ViewOpened { terrain: Some(shared.description.clone()) };
    let _ = outbox.try_send(Ok(word(Word::Opened(opened))));
    let task = ViewTask {
        shared: Arc::clone(shared),
        view: Some(view),
        tape,
        followed,
        changes,
        inbox,
        outbox,
        seat,
        _hold: hold,
        pacer,
        course,
        lookout,
        began: Instant::now(),
        due_since_ms: None,
        unsatisfied: 0,
    };
    tracing::info!(exercise, client = &*caller.name, "view opened");
    tokio::spawn(task.run().in_current_span());
    Ok(said)
}

/// The greatest number of triangles that settings ask for; nonsense is found later.
fn budget(settings: Option<&v1::ViewSettings>) -> u32 {
    match settings.and_then(|settings| settings.target.as_ref()) {
        Some(Target::TriangleBudget(budget)) => budget.triangles.min(crate::session::MAX_TRIANGLES),
        Some(Target::ScreenError(error)) => error.max_triangles.min(crate::session::MAX_TRIANGLES),
        Some(Target::FrameTime(time)) => time.max_triangles.min(crate::session::MAX_TRIANGLES),
        None => 0,
    }
}

/// The messages of a frame that was held back for so long.
fn finished(mut words: Vec<Word>, held_back_ms: u32) -> Vec<v1::StreamSceneResponse> {
    for word in &mut words {
        if let Word::Frame(frame) = word {
            frame.held_back_ms = held_back_ms;
        }
    }
    words.into_iter().map(word).collect()
}

fn word(response: Word) -> v1::StreamSceneResponse {
    v1::StreamSceneResponse { response: Some(response) }
}

/// What a view begins with.
struct Beginning<T: ServedTerrain> {
    view: View<T>,
    /// Its exercise as it is now.
    followed: Option<Followed>,
    hold: Option<Hold>,
    /// Its record, if there is one.
    tape: Option<Tape>,
}

fn make<T: ServedTerrain>(shared: &Shared<T>, open: &v1::OpenView) -> Result<Beginning<T>, Status> {
    let missing = |what| SettingsError::Missing(what).into_status();
    let settings = open.settings.as_ref().ok_or_else(|| missing("settings"))?;
    let pose = open.pose.as_ref().ok_or_else(|| missing("pose"))?;
    let settings = Settings::from_wire(settings).map_err(IntoStatus::into_status)?;
    let pose = Pose::from_wire(pose).map_err(IntoStatus::into_status)?;
    let journal = shared.journal.as_ref();
    let _order = journal.map(|journal| journal.order());
    let followed = Followed::get(shared, &open.exercise)?;
    let hold = followed.as_ref().and_then(|followed| followed.hold(shared, &open.lease_owner));
    let exercise = followed.as_ref().map(|followed| Arc::clone(followed.exercise()));
    let (terrain, scale) = (Arc::clone(&shared.terrain), shared.site.scale);
    let view = View::open(terrain, scale, &shared.description, settings, pose, exercise);
    let view = view.map_err(IntoStatus::into_status)?;
    Ok(Beginning { view, followed, hold, tape: journal.map(|journal| journal.open(open)) })
}

struct ViewTask<T: ServedTerrain> {
    shared: Arc<Shared<T>>,
    /// Absent while a frame is being made.
    view: Option<View<T>>,
    /// Likewise, and where nothing is recorded.
    tape: Option<Tape>,
    followed: Option<Followed>,
    changes: watch::Receiver<u64>,
    inbox: Inbox,
    outbox: Outbox,
    seat: Seat,
    /// Of the lease that lasts while the view is open.
    _hold: Option<Hold>,
    pacer: Pacer,
    /// Where it has been.
    course: Course,
    /// From where its pages are read ahead, if they are.
    lookout: Option<Lookout<T>>,
    /// From here the pacer and the course count.
    began: Instant,
    /// When the frame that waits became due.
    due_since_ms: Option<f64>,
    /// Lines that the last frame named.
    unsatisfied: i64,
}

impl<T: ServedTerrain> Drop for ViewTask<T> {
    fn drop(&mut self) {
        self.shared.metrics.unsatisfied.dec_by(self.unsatisfied);
    }
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
        // Its place is free before its end is told.
        let shared = Arc::clone(&self.shared);
        drop(self);
        if let Err(status) = end {
            // Waits behind the frame that is on its way, but not for ever: the connection's keepalive sees to that.
            let _ = outbox.send(Err(shared.health.seen(status))).await;
        }
    }

    fn now_ms(&self) -> f64 {
        1e3 * self.began.elapsed().as_secs_f64()
    }

    /// The life of the view, until its client ends it or something is wrong.
    async fn live(&mut self) -> Result<(), Status> {
        let mut in_a_row = 0;
        loop {
            let is_due = self.view.as_ref().is_some_and(View::is_due);
            let now_ms = self.now_ms();
            self.due_since_ms = is_due.then(|| self.due_since_ms.unwrap_or(now_ms));
            let wait_ms = self.pacer.free_ms() - now_ms;
            let is_free = wait_ms <= 0.0;
            let pace = tokio::time::sleep(std::time::Duration::from_secs_f64(1e-3 * wait_ms.clamp(0.0, 1e7)));
            tokio::select! {
                biased;
                changed = self.changes.changed(), if self.followed.is_some() => {
                    changed.map_err(|_| Status::unavailable("the server is stopping"))?;
                    self.follow().await?;
                }
                message = self.inbox.next(), if !(is_due && is_free) || in_a_row < MAX_MESSAGES_IN_A_ROW => {
                    in_a_row += 1;
                    let Some(message) = message else { return Ok(()) };
                    self.hear(message.map_err(|status| explained(status, self.shared.limits.request_bytes))?)?;
                }
                permit = self.outbox.clone().reserve_owned(), if is_due && is_free => {
                    in_a_row = 0;
                    let permit = permit.map_err(|_| Status::cancelled("the client is gone"))?;
                    self.deliver(permit).await?;
                }
                () = pace, if is_due && !is_free => {}
            }
        }
    }

    fn hear(&mut self, message: v1::StreamSceneRequest) -> Result<(), Status> {
        let kept = self.tape.as_ref().map(|_| message.clone());
        let event = match message.request {
            Some(Wish::Steer(steer)) => Event::Steer(steer),
            Some(Wish::Snapshot(request)) => Event::Snapshot(request),
            Some(Wish::Open(_)) => return Err(Status::invalid_argument("a view is opened once")),
            None => return Err(Status::invalid_argument("a message that says nothing")),
        };
        if let Event::Steer(steer) = &event {
            if let Some(pace) = &steer.pace {
                self.pacer.set(pace).map_err(IntoStatus::into_status)?;
            }
            if steer.settings.is_some() {
                self.seat.resize(budget(steer.settings.as_ref()))?;
            }
        }
        let moves = matches!(&event, Event::Steer(steer) if steer.pose.is_some());
        self.tell(event)?;
        if let Some(view) = self.view.as_ref().filter(|_| moves) {
            let pose = *view.pose();
            self.course.steer(self.now_ms(), pose);
        }
        if let (Some(tape), Some(message)) = (&mut self.tape, kept) {
            tape.hear(&message);
        }
        Ok(())
    }

    async fn follow(&mut self) -> Result<(), Status> {
        let Some(followed) = &mut self.followed else { return Ok(()) };
        if followed.look(&self.shared, &mut self.tape).await? {
            let exercise = Arc::clone(followed.exercise());
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
        let (due_since_ms, free_ms) = (self.due_since_ms.take(), self.pacer.free_ms());
        let held_back_ms = due_since_ms.map_or(0.0, |since| (free_ms - since).max(0.0)).ceil() as u32;
        let mut tape = self.tape.take();
        let work = move || {
            let began = Instant::now();
            let words = view.produce().map(|words| finished(words, held_back_ms));
            if let (Some(tape), Ok(words)) = (&mut tape, &words) {
                tape.make(words);
            }
            (view, tape, words, began.elapsed())
        };
        let (view, tape, words, took) = self.shared.run(work).await?;
        let refined = view.work();
        if let Some(lookout) = &self.lookout {
            lookout.tell(|| view.preview(&self.course.ahead(1e3 * lookout.time().as_secs_f64())?));
        }
        (self.view, self.tape) = (Some(view), tape);
        let words = words.map_err(IntoStatus::into_status)?;
        for word in &words {
            if let Some(Word::Frame(frame)) = &word.response {
                self.count(frame);
            }
        }
        let bytes = words.iter().map(Message::encoded_len).sum();
        self.pacer.sent(self.now_ms(), bytes);
        self.shared.metrics.frame(bytes, took, held_back_ms > 0);
        self.shared.metrics.refined(refined.splits, refined.merges);
        let mut words = words.into_iter();
        if let Some(first) = words.next() {
            permit.send(Ok(first));
        }
        for next in words {
            self.outbox.send(Ok(next)).await.map_err(|_| Status::cancelled("the client is gone"))?;
        }
        Ok(())
    }

    /// Keeps count of the lines that the last frame names.
    fn count(&mut self, frame: &v1::Frame) {
        let before = if frame.base_sequence == 0 { 0 } else { self.unsatisfied };
        let now = before + frame.now_unsatisfied.len() as i64 - frame.no_longer_unsatisfied.len() as i64;
        self.shared.metrics.unsatisfied.inc_by(now - self.unsatisfied);
        self.unsatisfied = now;
    }
}
