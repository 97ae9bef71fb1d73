//! The client library against a server that sends it wrong frames: it notices, says so, asks for a snapshot, goes on.

use std::time::Duration;

use sightline_client::{Client, ClientError, Event, v1};
use sightline_proto::{
    diamond::Post,
    replica::Replica,
    v1::{
        scene_service_server::{SceneService, SceneServiceServer},
        stream_scene_request::Request as Wish,
        stream_scene_response::Response as Word,
    },
};
use tokio::{
    net::TcpListener,
    sync::{Mutex, mpsc},
    time::timeout,
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming, transport::server::TcpIncoming};

const PATIENCE: Duration = Duration::from_secs(20);

/// Sends what a test hands it, and hands back what the client says.
struct Puppet {
    script: Mutex<Option<mpsc::Receiver<Result<v1::StreamSceneResponse, Status>>>>,
    heard: mpsc::Sender<Wish>,
}

#[tonic::async_trait]
impl SceneService for Puppet {
    type StreamSceneStream = ReceiverStream<Result<v1::StreamSceneResponse, Status>>;

    async fn stream_scene(
        &self,
        request: Request<Streaming<v1::StreamSceneRequest>>,
    ) -> Result<Response<Self::StreamSceneStream>, Status> {
        let (mut inbox, heard) = (request.into_inner(), self.heard.clone());
        tokio::spawn(async move {
            while let Ok(Some(message)) = inbox.message().await {
                if heard.send(message.request.unwrap()).await.is_err() {
                    return;
                }
            }
        });
        let script = self.script.lock().await.take().ok_or_else(|| Status::unavailable("played"))?;
        Ok(Response::new(ReceiverStream::new(script)))
    }

    // The client under test watches nothing.

    type WatchViewsStream = ReceiverStream<Result<v1::WatchViewsResponse, Status>>;

    async fn watch_views(&self, _: Request<v1::WatchViewsRequest>) -> Result<Response<Self::WatchViewsStream>, Status> {
        Err(Status::unimplemented("watches"))
    }

    async fn open_watched_view(
        &self,
        _: Request<v1::OpenWatchedViewRequest>,
    ) -> Result<Response<v1::OpenWatchedViewResponse>, Status> {
        Err(Status::unimplemented("watches"))
    }

    async fn tell_watched_view(
        &self,
        _: Request<v1::TellWatchedViewRequest>,
    ) -> Result<Response<v1::TellWatchedViewResponse>, Status> {
        Err(Status::unimplemented("watches"))
    }

    async fn close_watched_view(
        &self,
        _: Request<v1::CloseWatchedViewRequest>,
    ) -> Result<Response<v1::CloseWatchedViewResponse>, Status> {
        Err(Status::unimplemented("watches"))
    }
}

struct Stage {
    client: Client,
    say: mpsc::Sender<Result<v1::StreamSceneResponse, Status>>,
    heard: mpsc::Receiver<Wish>,
}

impl Stage {
    async fn set() -> Self {
        let (say, script) = mpsc::channel(16);
        let (tell, heard) = mpsc::channel(64);
        let puppet = Puppet { script: Mutex::new(Some(script)), heard: tell };
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let server = tonic::transport::Server::builder().add_service(SceneServiceServer::new(puppet));
        tokio::spawn(server.serve_with_incoming(TcpIncoming::from(listener)));
        Self { client: Client::connect(&address).await.unwrap(), say, heard }
    }

    async fn say(&self, word: Word) {
        self.say.send(Ok(v1::StreamSceneResponse { response: Some(word) })).await.unwrap();
    }

    async fn hear(&mut self) -> Wish {
        timeout(PATIENCE, self.heard.recv()).await.expect("the client speaks").unwrap()
    }
}

fn terrain() -> v1::TerrainDescription {
    v1::TerrainDescription {
        nx: 9,
        ny: 9,
        root_exponent: 3,
        metres_per_post_east: 10.0,
        metres_per_post_north: 10.0,
        metres_per_height_unit: 1.0,
        corner_heights: vec![0; 4],
        ..Default::default()
    }
}

fn settings() -> v1::ViewSettings {
    v1::ViewSettings {
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles: 50 })),
        ..Default::default()
    }
}

/// The mesh with these posts as frame `sequence`, and the frame against `base`.
fn frame(posts: &[(u32, u32, i32)], sequence: u64, base: Option<&Replica>) -> (Replica, v1::Frame) {
    let posts = posts.iter().map(|&(i, j, h)| (Post::new(i, j), h));
    let mesh = Replica::new(&terrain()).unwrap().with_posts(posts, sequence).unwrap();
    let frame = v1::Frame {
        sequence,
        base_sequence: base.map_or(0, Replica::sequence),
        mesh: mesh.encode(base),
        triangle_count: mesh.triangle_count(),
        mesh_hash: mesh.hash(),
        ..Default::default()
    };
    (mesh, frame)
}

#[tokio::test]
async fn a_wrong_frame_is_noticed_and_a_snapshot_mends_it() {
    let mut stage = Stage::set().await;
    stage.say(Word::Opened(v1::ViewOpened { terrain: Some(terrain()) })).await;
    let mut view = stage.client.open_view("", settings(), v1::Pose::default()).await.unwrap();
    assert!(matches!(stage.hear().await, Wish::Open(_)));

    let (first, good) = frame(&[(4, 4, 5)], 1, None);
    stage.say(Word::Frame(good.clone())).await;
    assert_eq!(view.next().await.unwrap(), Some(Event::Frame(good)));
    let acknowledged = |wish: Wish| match wish {
        Wish::Steer(steer) => (steer.applied_sequence, steer.pose.is_some()),
        other => panic!("{other:?}"),
    };
    assert_eq!(acknowledged(stage.hear().await), (1, false));

    // A height off by one: the hash tells. What follows is based on a mesh that the client does not have.
    let (second, right) = frame(&[(4, 4, 5), (4, 0, 9)], 2, Some(&first));
    let (_, off_by_one) = frame(&[(4, 4, 5), (4, 0, 8)], 2, Some(&first));
    let wrong = v1::Frame { mesh_hash: right.mesh_hash, ..off_by_one };
    let (third, next) = frame(&[(4, 4, 5), (4, 0, 9), (0, 4, 1)], 3, Some(&second));
    stage.say(Word::Frame(wrong)).await;
    stage.say(Word::Frame(next)).await;
    assert!(matches!(view.next().await.unwrap(), Some(Event::Lost(_))));
    assert_eq!(stage.hear().await, Wish::Snapshot(v1::RequestSnapshot { received_sequence: 2 }));
    assert_eq!(view.next().await.unwrap(), Some(Event::Skipped));
    assert_eq!(view.scene().replica().posts(), first.posts(), "the replica is as it was");

    let (mended, snapshot) = frame(&[(4, 4, 5), (8, 4, -3)], 4, None);
    assert_ne!(mended.hash(), third.hash());
    stage.say(Word::Frame(snapshot.clone())).await;
    assert_eq!(view.next().await.unwrap(), Some(Event::Frame(snapshot)));
    assert_eq!(view.scene().replica().hash(), mended.hash());
    assert_eq!(acknowledged(stage.hear().await), (4, false));

    drop(stage.say);
    assert_eq!(view.next().await.unwrap(), None, "the server has closed the view");
}

#[tokio::test]
async fn a_server_that_breaks_the_protocol_is_an_error() {
    let stage = Stage::set().await;
    stage.say(Word::Exercise(v1::ExerciseUpdate::default())).await;
    let error = stage.client.open_view("", settings(), v1::Pose::default()).await.unwrap_err();
    assert!(matches!(error, ClientError::Protocol(_)), "{error}");

    let stage = Stage::set().await;
    let strange = v1::TerrainDescription { root_exponent: 9, ..terrain() };
    stage.say(Word::Opened(v1::ViewOpened { terrain: Some(strange) })).await;
    let error = stage.client.open_view("", settings(), v1::Pose::default()).await.unwrap_err();
    assert!(matches!(error, ClientError::Scene(_)), "{error}");

    let stage = Stage::set().await;
    stage.say(Word::Opened(v1::ViewOpened { terrain: Some(terrain()) })).await;
    let mut view = stage.client.open_view("", settings(), v1::Pose::default()).await.unwrap();
    stage.say(Word::Opened(v1::ViewOpened { terrain: Some(terrain()) })).await;
    let error = view.next().await.unwrap_err();
    assert!(matches!(error, ClientError::Scene(_)), "{error}");
}

#[tokio::test]
async fn a_frame_of_more_triangles_than_asked_for_is_refused() {
    let stage = Stage::set().await;
    stage.say(Word::Opened(v1::ViewOpened { terrain: Some(terrain()) })).await;
    let mut settings = settings();
    settings.target = Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles: 3 }));
    let mut view = stage.client.open_view("", settings, v1::Pose::default()).await.unwrap();
    let (_, frame) = frame(&[(4, 4, 5)], 1, None);
    stage.say(Word::Frame(frame)).await;
    assert!(matches!(view.next().await.unwrap(), Some(Event::Lost(_))));
}
