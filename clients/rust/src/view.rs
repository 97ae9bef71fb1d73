//! One view of a server over its stream: steers, receives, checks, acknowledges, and comes back when it was lost.

use std::{error::Error, time::Duration};

use prost::Message;
use sightline_proto::v1::{
    self, scene_service_client::SceneServiceClient, stream_scene_request::Request, stream_scene_response::Response,
};
use tokio::{
    sync::mpsc,
    time::{Instant, sleep},
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Streaming};

use crate::{
    ClientError, Secured,
    scene::{self, SceneError, SceneState},
};

/// Messages that may wait to be sent. An acknowledgement that finds no room is dropped: the next one covers it.
const OUTBOX: usize = 64;

/// How long [`View::resume`] waits between two tries.
const RETRY: Duration = Duration::from_millis(100);

/// What happened to a view.
#[derive(Clone, PartialEq, Debug)]
pub enum Event {
    /// The exercise moved on to this epoch; frames of it follow.
    Exercise(u64),
    /// A frame was received, checked and applied.
    Frame(v1::Frame),
    /// A frame did not fit; a snapshot has been asked for, and frames are passed over until it comes.
    Lost(SceneError),
    /// A frame was passed over while waiting for a snapshot.
    Skipped,
}

/// One view. Dropping it closes it.
#[derive(Debug)]
pub struct View {
    scenes: SceneServiceClient<Secured>,
    /// What was asked for last: exercise, settings, pose, pace.
    wish: v1::OpenView,
    stream: Stream,
    scene: SceneState,
    last: Option<v1::StreamSceneResponse>,
    pose_sequence: u64,
    received_sequence: u64,
    /// How long the last frame took to draw; 0 when it was told or never known.
    frame_time_ms: f64,
    /// A snapshot has still to be asked for.
    snapshot_due: bool,
    /// A frame could not be applied, and no snapshot has come since.
    lost: bool,
}

/// An open stream.
#[derive(Debug)]
struct Stream {
    outbox: mpsc::Sender<v1::StreamSceneRequest>,
    inbox: Streaming<v1::StreamSceneResponse>,
    /// Its first message.
    opening: v1::StreamSceneResponse,
}

impl Stream {
    async fn open(
        scenes: &mut SceneServiceClient<Secured>,
        wish: v1::OpenView,
    ) -> Result<(Self, v1::ViewOpened), ClientError> {
        let (outbox, requests) = mpsc::channel(OUTBOX);
        outbox.try_send(request(Request::Open(wish))).map_err(|_| ClientError::Closed)?;
        let mut inbox = scenes.stream_scene(ReceiverStream::new(requests)).await?.into_inner();
        let opening = inbox.message().await?.ok_or(ClientError::Closed)?;
        let Some(Response::Opened(opened)) = opening.response.clone() else {
            return Err(ClientError::Protocol("the first message of a view is not its opening"));
        };
        Ok((Self { outbox, inbox, opening }, opened))
    }
}

impl View {
    pub(crate) async fn open(mut scenes: SceneServiceClient<Secured>, wish: v1::OpenView) -> Result<Self, ClientError> {
        let (stream, opened) = Stream::open(&mut scenes, wish.clone()).await?;
        let scene = SceneState::new(&opened, asked(&wish), !wish.exercise.is_empty())?;
        Ok(Self {
            scenes,
            wish,
            stream,
            scene,
            last: None,
            pose_sequence: 0,
            received_sequence: 0,
            frame_time_ms: 0.0,
            snapshot_due: false,
            lost: false,
        })
    }

    /// Opens the view anew, with its last pose, settings and pace, after its stream was lost: [`View::next`] gave an error or
    /// `None`. Tries until a server answers or `within` is over; cancelling it changes nothing.
    ///
    /// The mesh of the last frame stays until the first new one, which is a snapshot; what that changes is all that
    /// [`crate::buffers::MeshBuffers`] uploads. Poses are numbered from 1 again. A server that was started anew may not
    /// have the exercise any more: then this is refused, `NotFound`. With another terrain it is
    /// [`SceneError::OtherTerrain`].
    pub async fn resume(&mut self, within: Duration) -> Result<(), ClientError> {
        let deadline = Instant::now() + within;
        let (stream, opened) = loop {
            match Stream::open(&mut self.scenes, self.wish.clone()).await {
                Err(error) if is_away(&error) && Instant::now() < deadline => sleep(RETRY).await,
                answer => break answer?,
            }
        };
        self.scene.reopen(&opened, asked(&self.wish))?;
        (self.stream, self.last) = (stream, None);
        (self.pose_sequence, self.received_sequence) = (0, 0);
        (self.snapshot_due, self.lost) = (false, false);
        Ok(())
    }

    /// What the client knows.
    pub fn scene(&self) -> &SceneState {
        &self.scene
    }

    /// The last message received, encoded: what a recording keeps. [`View::opening_bytes`] comes before all of them.
    pub fn last_bytes(&self) -> Option<Vec<u8>> {
        self.last.as_ref().map(Message::encode_to_vec)
    }

    /// The message that opened the view, encoded.
    pub fn opening_bytes(&self) -> Vec<u8> {
        self.stream.opening.encode_to_vec()
    }

    /// Moves the viewpoint; returns the pose's number, which the frame made for it carries.
    pub async fn steer(&mut self, pose: v1::Pose) -> Result<u64, ClientError> {
        self.pose_sequence += 1;
        self.wish.pose = Some(pose);
        let steer = v1::SteerView { pose: Some(pose), frame_time_ms: self.frame_time_ms, ..self.steering() };
        self.send(Request::Steer(steer)).await?;
        Ok(self.pose_sequence)
    }

    /// Changes camera, target and subscription.
    pub async fn change_settings(&mut self, settings: v1::ViewSettings) -> Result<(), ClientError> {
        // Frames under way may still be of the old target.
        self.scene.allow_triangles(max_triangles(&settings));
        self.wish.settings = Some(settings.clone());
        self.send(Request::Steer(v1::SteerView { settings: Some(settings), ..self.steering() })).await
    }

    /// Changes how fast the view sends; the default is a frame on every change.
    pub async fn change_pace(&mut self, pace: v1::Pace) -> Result<(), ClientError> {
        self.wish.pace = Some(pace);
        self.send(Request::Steer(v1::SteerView { pace: Some(pace), ..self.steering() })).await
    }

    /// Says how long the last frame took to draw, with the next pose: a target of a frame time needs it.
    pub fn set_frame_time_ms(&mut self, frame_time_ms: f64) {
        self.frame_time_ms = frame_time_ms;
    }

    /// Asks for a frame that is based on nothing.
    pub async fn request_snapshot(&mut self) -> Result<(), ClientError> {
        self.send(Request::Snapshot(v1::RequestSnapshot { received_sequence: self.received_sequence })).await
    }

    /// The next event; `None` when the server has closed the view. Cancelling it loses nothing.
    pub async fn next(&mut self) -> Result<Option<Event>, ClientError> {
        self.catch_up();
        let Some(message) = self.stream.inbox.message().await? else { return Ok(None) };
        let event = self.take(&message)?;
        self.last = Some(message);
        self.catch_up();
        Ok(Some(event))
    }

    fn take(&mut self, message: &v1::StreamSceneResponse) -> Result<Event, ClientError> {
        let frame = match &message.response {
            Some(Response::Frame(frame)) => Some(frame),
            _ => None,
        };
        self.received_sequence = frame.map_or(self.received_sequence, |frame| frame.sequence);
        if self.lost && frame.is_some_and(|frame| frame.base_sequence != 0) {
            return Ok(Event::Skipped);
        }
        match (self.scene.apply(message), frame) {
            (Ok(scene::Event::Exercise), _) => Ok(Event::Exercise(self.scene.epoch())),
            (Ok(scene::Event::Frame), frame) => {
                self.lost = false;
                self.try_send(Request::Steer(self.steering()));
                frame.cloned().map(Event::Frame).ok_or(ClientError::Protocol("a frame that is none"))
            }
            (Err(error), Some(_)) => {
                (self.lost, self.snapshot_due) = (true, true);
                Ok(Event::Lost(error))
            }
            (Err(error), None) => Err(error.into()),
        }
    }

    /// An acknowledgement, to which wishes may be added.
    fn steering(&self) -> v1::SteerView {
        let (pose_sequence, applied_sequence) = (self.pose_sequence, self.scene.replica().sequence());
        v1::SteerView { pose_sequence, applied_sequence, ..Default::default() }
    }

    /// Asks for a snapshot that is due.
    fn catch_up(&mut self) {
        if self.snapshot_due {
            let ask = v1::RequestSnapshot { received_sequence: self.received_sequence };
            self.snapshot_due = !self.try_send(Request::Snapshot(ask));
        }
    }

    /// Whether the message could be put in the outbox.
    fn try_send(&self, what: Request) -> bool {
        self.stream.outbox.try_send(request(what)).is_ok()
    }

    async fn send(&self, what: Request) -> Result<(), ClientError> {
        self.stream.outbox.send(request(what)).await.map_err(|_| ClientError::Closed)
    }
}

fn request(request: Request) -> v1::StreamSceneRequest {
    v1::StreamSceneRequest { request: Some(request) }
}

/// Whether no server answered, rather than one that refused.
fn is_away(error: &ClientError) -> bool {
    match error {
        ClientError::Refused(status) => status.code() == Code::Unavailable || status.source().is_some(),
        ClientError::Closed => true,
        _ => false,
    }
}

/// The most triangles that a view asks for.
fn asked(wish: &v1::OpenView) -> u32 {
    wish.settings.as_ref().map_or(0, max_triangles)
}

/// The most triangles that frames under these settings have.
fn max_triangles(settings: &v1::ViewSettings) -> u32 {
    use v1::view_settings::Target;
    match &settings.target {
        Some(Target::TriangleBudget(budget)) => budget.triangles,
        Some(Target::ScreenError(error)) => error.max_triangles,
        Some(Target::FrameTime(time)) => time.max_triangles,
        None => 0,
    }
}
