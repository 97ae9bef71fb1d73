//! One view of a server over its stream: steers, receives, checks, acknowledges.

use prost::Message;
use sightline_proto::v1::{
    self, scene_service_client::SceneServiceClient, stream_scene_request::Request, stream_scene_response::Response,
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use crate::{
    ClientError,
    scene::{self, SceneError, SceneState},
};

/// Messages that may wait to be sent. An acknowledgement that finds no room is dropped: the next one covers it.
const OUTBOX: usize = 64;

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
    outbox: mpsc::Sender<v1::StreamSceneRequest>,
    inbox: Streaming<v1::StreamSceneResponse>,
    scene: SceneState,
    opened: v1::StreamSceneResponse,
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

impl View {
    pub(crate) async fn open(
        mut scenes: SceneServiceClient<crate::Secured>,
        open: v1::OpenView,
    ) -> Result<Self, ClientError> {
        let max_triangles = open.settings.as_ref().map_or(0, max_triangles);
        let with_lines = !open.exercise.is_empty();
        let (outbox, requests) = mpsc::channel(OUTBOX);
        outbox.try_send(request(Request::Open(open))).map_err(|_| ClientError::Closed)?;
        let mut inbox = scenes.stream_scene(ReceiverStream::new(requests)).await?.into_inner();
        let first = inbox.message().await?.ok_or(ClientError::Closed)?;
        let Some(Response::Opened(opened)) = &first.response else {
            return Err(ClientError::Protocol("the first message of a view is not its opening"));
        };
        let scene = SceneState::new(opened, max_triangles, with_lines)?;
        let (opened, last) = (first, None);
        let (pose_sequence, received_sequence, snapshot_due, lost) = (0, 0, false, false);
        let frame_time_ms = 0.0;
        Ok(Self {
            outbox,
            inbox,
            scene,
            opened,
            last,
            pose_sequence,
            received_sequence,
            frame_time_ms,
            snapshot_due,
            lost,
        })
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
        self.opened.encode_to_vec()
    }

    /// Moves the viewpoint; returns the pose's number, which the frame made for it carries.
    pub async fn steer(&mut self, pose: v1::Pose) -> Result<u64, ClientError> {
        self.pose_sequence += 1;
        self.send(self.steering(Some(pose), None)).await?;
        Ok(self.pose_sequence)
    }

    /// Changes camera, target and subscription.
    pub async fn change_settings(&mut self, settings: v1::ViewSettings) -> Result<(), ClientError> {
        // Frames under way may still be of the old target.
        self.scene.allow_triangles(max_triangles(&settings));
        self.send(self.steering(None, Some(settings))).await
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
        let Some(message) = self.inbox.message().await? else { return Ok(None) };
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
                self.try_send(self.steering(None, None));
                frame.cloned().map(Event::Frame).ok_or(ClientError::Protocol("a frame that is none"))
            }
            (Err(error), Some(_)) => {
                (self.lost, self.snapshot_due) = (true, true);
                Ok(Event::Lost(error))
            }
            (Err(error), None) => Err(error.into()),
        }
    }

    fn steering(&self, pose: Option<v1::Pose>, settings: Option<v1::ViewSettings>) -> Request {
        let (pose_sequence, applied_sequence) = (self.pose_sequence, self.scene.replica().sequence());
        let frame_time_ms = if pose.is_some() { self.frame_time_ms } else { 0.0 };
        Request::Steer(v1::SteerView { pose, pose_sequence, applied_sequence, settings, frame_time_ms, pace: None })
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
        self.outbox.try_send(request(what)).is_ok()
    }

    async fn send(&self, what: Request) -> Result<(), ClientError> {
        self.outbox.send(request(what)).await.map_err(|_| ClientError::Closed)
    }
}

fn request(request: Request) -> v1::StreamSceneRequest {
    v1::StreamSceneRequest { request: Some(request) }
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
