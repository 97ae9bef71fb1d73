//! The server as clients meet it: really started, on a loopback port.

mod access;
mod epochs;
mod faults;
mod leases;
mod lines;
mod port;
mod read_ahead;
mod recording;
mod resume;
mod slow;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use sightline::{
    exercise::Site,
    los::{self, Options},
    service::{self, Limits, MAX_BATCH_LINES, MAX_STREAM_LINES, Options as ServeOptions, ServedTerrain},
    session::Details,
    terrain::{Georeference, Grid, HeightField, HeightPage, PageId, ReadError, SceneScale, synthetic},
    wedgie::{DiamondBounds, ErrorBounds, MemoryTerrain},
};
use sightline_client::{Client, ClientError, Event, View, v1};
use sightline_proto::{
    diamond::Post,
    v1::{stream_scene_request::Request as Wish, stream_scene_response::Response as Word},
    verdict::{MeshVerdict, verdict_on_mesh},
};
use tokio::{net::TcpListener, sync::oneshot, task::JoinHandle, time::timeout};
use tonic::Code;

const SCALE: SceneScale = SceneScale { east_m: 30.0, north_m: 25.0, up_m: 0.5 };
/// Longer than anything here takes on a slow machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// A terrain in memory that lies somewhere, and whose pages can be made unreadable.
struct TestTerrain {
    memory: MemoryTerrain,
    georeference: Option<Georeference>,
    damaged: AtomicBool,
    /// Whether reading a page takes its time.
    slow: AtomicBool,
    /// Whether reading a page waits until this is over.
    stuck: AtomicBool,
    /// Pages read.
    reads: AtomicU64,
}

impl TestTerrain {
    fn new(georeference: Option<Georeference>) -> Arc<Self> {
        let memory = MemoryTerrain::new(synthetic::fractal(90, 70, 11, 1500).unwrap(), SCALE).unwrap();
        Arc::new(Self {
            memory,
            georeference,
            damaged: AtomicBool::new(false),
            slow: AtomicBool::new(false),
            stuck: AtomicBool::new(false),
            reads: AtomicU64::new(0),
        })
    }
}

impl HeightField for TestTerrain {
    fn grid(&self) -> Grid {
        self.memory.grid()
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        if self.damaged.load(Ordering::Relaxed) {
            return Err(ReadError::Damaged { what: "page 3".into(), detail: "its checksum is wrong".into() });
        }
        self.reads.fetch_add(1, Ordering::Relaxed);
        while self.stuck.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(2));
        }
        if self.slow.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.memory.page(id)
    }
}

impl ErrorBounds for TestTerrain {
    fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError> {
        self.memory.bounds(p)
    }
}

impl ServedTerrain for TestTerrain {
    fn site(&self) -> Site {
        Site { scale: SCALE, georeference: self.georeference }
    }

    fn details(&self) -> Result<Details, ReadError> {
        Ok(Details { version: vec![7; 16], height_range: [-900.0, 900.0], void_posts: 0 })
    }

    fn pages_read(&self) -> Option<u64> {
        Some(self.reads.load(Ordering::Relaxed))
    }
}

/// A started server.
struct Running {
    address: String,
    stop: oneshot::Sender<()>,
    done: JoinHandle<Result<(), service::ServeError>>,
}

impl Running {
    async fn start(terrain: Arc<TestTerrain>, limits: Limits) -> Self {
        Self::start_with(terrain, ServeOptions { limits, ..ServeOptions::default() }).await
    }

    async fn start_with(terrain: Arc<TestTerrain>, options: ServeOptions) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (stop, stopped) = oneshot::channel();
        let shutdown = async move {
            let _ = stopped.await;
        };
        let done = tokio::spawn(service::serve_with(listener, terrain, options, shutdown));
        Self { address, stop, done }
    }

    async fn client(&self) -> Client {
        Client::connect(&self.address).await.unwrap()
    }
}

async fn started() -> (Running, Client) {
    let running = Running::start(TestTerrain::new(None), Limits::default()).await;
    let client = running.client().await;
    (running, client)
}

/// Waits until the health service says so of the server.
async fn health(running: &Running, wanted: tonic_health::ServingStatus) {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let mut health = tonic_health::pb::health_client::HealthClient::new(endpoint.connect().await.unwrap());
    let request = tonic_health::pb::HealthCheckRequest { service: String::new() };
    let mut watch = health.watch(request).await.unwrap().into_inner();
    let told =
        async { while watch.message().await.unwrap().expect("a watch of health goes on").status != wanted as i32 {} };
    timeout(PATIENCE, told).await.expect("health tells");
}

/// The status with which a call was refused, and that it explains itself.
#[track_caller]
fn refusal<T: std::fmt::Debug>(result: Result<T, ClientError>, code: Code, words: &str) {
    match result {
        Err(ClientError::Refused(status)) => {
            assert_eq!(status.code(), code, "{status}");
            assert!(status.message().contains(words), "'{words}' in {status}");
        }
        other => panic!("{code:?} expected: {other:?}"),
    }
}

fn end(x: f64, y: f64, z: f64) -> Option<v1::SightLineEnd> {
    let position = Some(v1::Position { x, y, z });
    let (frame, altitude) = (v1::CoordinateFrame::Grid.into(), v1::AltitudeReference::AboveGround.into());
    Some(v1::SightLineEnd { position, frame, altitude })
}

fn settings(triangles: u32) -> v1::ViewSettings {
    v1::ViewSettings {
        projection: Some(v1::view_settings::Projection::Perspective(v1::Perspective {
            tan_half_fov: 0.6,
            near_m: 1.0,
        })),
        viewport_width_px: 800,
        viewport_height_px: 600,
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles })),
        subscription: None,
        regions: Vec::new(),
    }
}

/// Looking straight down from high above a place.
fn pose(x: f64, y: f64) -> v1::Pose {
    v1::Pose {
        eye: Some(v1::Position { x, y, z: 1500.0 }),
        rotation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    }
}

fn entity(id: u64, x: f64, y: f64) -> v1::Entity {
    let end = end(x, y, 4.0).unwrap();
    v1::Entity { id, position: end.position, frame: end.frame, altitude: end.altitude, ground_m: 0.0 }
}

fn between(id: u64, a: u64, b: u64) -> v1::SightLine {
    let end = |entity_id| {
        let anchor = v1::EntityAnchor { entity_id, height_offset_m: 0.0 };
        Some(v1::Anchor { anchor: Some(v1::anchor::Anchor::Entity(anchor)) })
    };
    v1::SightLine { id, a: end(a), b: end(b), ..Default::default() }
}

/// An exercise of `lines` lines between entities spread over the terrain.
async fn exercise(client: &Client, name: &str, lines: u64) {
    client.create_exercise(name).await.unwrap();
    let place = |id: u64| entity(id, (id * 37 % 880) as f64 * 0.1, (id * 53 % 690) as f64 * 0.1);
    let change = v1::ChangeExerciseRequest {
        name: name.into(),
        put_entities: (0..2 * lines).map(place).collect(),
        put_sight_lines: (0..lines).map(|id| between(id, 2 * id, 2 * id + 1)).collect(),
        ..Default::default()
    };
    assert_eq!(client.change_exercise(change).await.unwrap(), 1);
}

/// The next frame of a view.
async fn frame(view: &mut View) -> v1::Frame {
    loop {
        match timeout(PATIENCE, view.next()).await.expect("a frame in time").unwrap().expect("an open view") {
            Event::Frame(frame) => return frame,
            Event::Exercise(_) => {}
            event => panic!("{event:?}"),
        }
    }
}

#[tokio::test]
async fn the_terrain_is_described_and_its_heights_are_exact() {
    let georeference = Georeference { epsg: Some(4326), geographic: true, origin: [10.0, 50.0], step: [0.25, 0.5] };
    let running = Running::start(TestTerrain::new(Some(georeference)), Limits::default()).await;
    let client = running.client().await;
    let terrain = client.terrain().await.unwrap();
    assert_eq!((terrain.nx, terrain.ny, terrain.root_exponent), (90, 70, 7));
    assert_eq!((terrain.epsg, terrain.geographic, terrain.metres_per_height_unit), (4326, true, 0.5));
    let posts: Vec<(u32, u32)> = vec![(0, 0), (89, 69), (13, 40)];
    let request = v1::GetHeightsRequest {
        frame: v1::CoordinateFrame::Geographic.into(),
        x: posts.iter().map(|p| 10.0 + 0.25 * f64::from(p.0)).chain([0.0]).collect(),
        y: posts.iter().map(|p| 50.0 + 0.5 * f64::from(p.1)).chain([0.0]).collect(),
        normals: false,
    };
    let heights = client.heights(request.clone()).await.unwrap();
    assert_eq!(heights.known, [true, true, true, false]);
    for (n, (i, j)) in posts.into_iter().enumerate() {
        assert_eq!(heights.z[n], 0.5 * f64::from(synthetic::fractal_height(i, j, 11, 1500)));
    }
    let short = v1::GetHeightsRequest { x: vec![1.0], ..request.clone() };
    refusal(client.heights(short).await, Code::InvalidArgument, "equally long");
    let wild = v1::GetHeightsRequest { frame: 77, ..request.clone() };
    refusal(client.heights(wild).await, Code::InvalidArgument, "77");
    let nan = v1::GetHeightsRequest { x: vec![f64::NAN], y: vec![1.0], ..request };
    refusal(client.heights(nan).await, Code::InvalidArgument, "finite");
}

#[tokio::test]
async fn queries_answer_as_the_library_does_and_batches_as_queries() {
    let (_running, client) = started().await;
    let field = TestTerrain::new(None);
    let lines: Vec<[f64; 4]> = (0..9_000_u32)
        .map(|n| [n % 83, n % 61, n * 7 % 89, n * 5 % 67].map(|v| f64::from(v) + f64::from(n % 4) * 0.25))
        .collect();
    let column = |k: usize| lines.iter().map(|line| line[k]).collect::<Vec<_>>();
    let request = v1::QueryLineOfSightBatchRequest {
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        strict: false,
        ax: column(0),
        ay: column(1),
        az: vec![4.0; lines.len()],
        bx: column(2),
        by: column(3),
        bz: vec![4.0; lines.len()],
        options: None,
    };
    let batch = client.query_batch(request.clone()).await.unwrap();
    assert_eq!(batch.verdicts.len(), lines.len());
    let (mut visible, mut blocked) = (0, 0);
    for (n, line) in lines.iter().enumerate() {
        let ends = [[line[0], line[1]], [line[2], line[3]]]
            .map(|[x, y]| los::on_ground(&*field, x, y, 4.0).unwrap().map(|z| [x, y, z]));
        let expected = match ends {
            [Some(a), Some(b)] => los::line_of_sight(&*field, a, b, Options::default()).unwrap().verdict,
            _ => los::Verdict::Unknown,
        };
        assert_eq!(batch.verdicts[n].as_str_name(), format!("VERDICT_{}", expected.name()), "line {n}");
        visible += u32::from(expected == los::Verdict::Visible);
        blocked += u32::from(expected == los::Verdict::Blocked);
        if n % 997 == 0 {
            let (a, b) = (end(line[0], line[1], 4.0), end(line[2], line[3], 4.0));
            let answer =
                client.query(v1::QueryLineOfSightRequest { a, b, derive: true, ..Default::default() }).await.unwrap();
            assert_eq!(answer.verdict(), batch.verdicts[n]);
            assert_eq!(answer.first_from_a.is_some(), expected == los::Verdict::Blocked);
            assert_eq!(answer.least_clearance.is_some(), expected == los::Verdict::Visible);
        }
    }
    assert!(visible > 1000 && blocked > 1000, "{visible} visible, {blocked} blocked");
    bad_queries(&client, request).await;
}

async fn bad_queries(client: &Client, good: v1::QueryLineOfSightBatchRequest) {
    let empty = v1::QueryLineOfSightBatchRequest::default();
    refusal(client.query_batch(empty).await, Code::InvalidArgument, "without lines");
    let mut short = good.clone();
    short.bz.pop();
    refusal(client.query_batch(short).await, Code::InvalidArgument, "equally long");
    let mut nan = good.clone();
    nan.by[5_000] = f64::NAN;
    refusal(client.query_batch(nan).await, Code::InvalidArgument, "line 5000");
    let map = v1::QueryLineOfSightBatchRequest { frame: 0, ..good };
    refusal(client.query_batch(map).await, Code::FailedPrecondition, "no georeference");
    let column = vec![0.0; MAX_BATCH_LINES + 1];
    let [ax, ay, az, bx, by, bz] = [(); 6].map(|()| column.clone());
    let many = v1::QueryLineOfSightBatchRequest { ax, ay, az, bx, by, bz, ..Default::default() };
    refusal(client.query_batch(many.clone()).await, Code::ResourceExhausted, "250000");
    let vast = v1::QueryLineOfSightBatchRequest { ax: vec![0.0; 3 << 20], ..many };
    refusal(client.query_batch(vast).await, Code::ResourceExhausted, "limits.request_bytes");
    let infinite =
        v1::QueryLineOfSightRequest { a: end(1.0, f64::INFINITY, 1.0), b: end(1.0, 1.0, 1.0), ..Default::default() };
    refusal(client.query(infinite).await, Code::InvalidArgument, "finite");
    let half = v1::QueryLineOfSightRequest { a: end(1.0, 1.0, 1.0), ..Default::default() };
    refusal(client.query(half).await, Code::InvalidArgument, "end b is missing");
}

#[tokio::test]
async fn exercises_are_changed_whole_or_not_at_all() {
    let (_running, client) = started().await;
    refusal(client.create_exercise("no spaces").await, Code::InvalidArgument, "letters");
    exercise(&client, "one", 6).await;
    refusal(client.create_exercise("one").await, Code::AlreadyExists, "'one'");
    for name in ["two", ""] {
        refusal(client.exercise(name).await, Code::NotFound, name);
        refusal(client.delete_exercise(name).await, Code::NotFound, name);
    }
    let before = client.exercise("one").await.unwrap();
    assert_eq!((before.epoch, before.entities.len(), before.sight_lines.len()), (1, 12, 6));
    let change = || v1::ChangeExerciseRequest { name: "one".into(), ..Default::default() };
    let put = |lines: Vec<v1::SightLine>| v1::ChangeExerciseRequest { put_sight_lines: lines, ..change() };
    let cases = [
        (v1::ChangeExerciseRequest { remove_entities: vec![3], ..change() }, Code::FailedPrecondition, "sight line 1"),
        (v1::ChangeExerciseRequest { remove_entities: vec![99], ..change() }, Code::NotFound, "entity 99"),
        (v1::ChangeExerciseRequest { remove_sight_lines: vec![99], ..change() }, Code::NotFound, "sight line 99"),
        (put(vec![between(7, 0, 99)]), Code::NotFound, "entity 99"),
        (put(vec![between(7, 0, 1), between(7, 0, 2)]), Code::InvalidArgument, "twice"),
        (put(vec![between(u64::MAX, 0, 1)]), Code::InvalidArgument, "eye"),
        (put(vec![v1::SightLine { a: None, ..between(7, 0, 1) }]), Code::InvalidArgument, "sight line 7"),
        (put(vec![v1::SightLine { fidelity: 9, ..between(7, 0, 1) }]), Code::InvalidArgument, "fidelity 9"),
        (
            v1::ChangeExerciseRequest { put_entities: vec![entity(1, f64::NAN, 0.0)], ..change() },
            Code::InvalidArgument,
            "entity 1",
        ),
        (v1::ChangeExerciseRequest { name: "two".into(), ..change() }, Code::NotFound, "'two'"),
    ];
    for (mut bad, code, words) in cases {
        // A change that would do, to see that nothing of it stays.
        bad.put_entities.push(entity(5, 1.0, 1.0));
        refusal(client.change_exercise(bad).await, code, words);
    }
    assert_eq!(client.exercise("one").await.unwrap(), before);
    let moved = v1::ChangeExerciseRequest { put_entities: vec![entity(5, 1.0, 1.0)], ..change() };
    assert_eq!(client.change_exercise(moved).await.unwrap(), 2);
    let outlines = client.list_exercises().await.unwrap();
    let expected = v1::ExerciseSummary { name: "one".into(), epoch: 2, entities: 12, sight_lines: 6 };
    assert_eq!(outlines, [expected]);
    client.delete_exercise("one").await.unwrap();
    assert!(client.list_exercises().await.unwrap().is_empty());
}

#[tokio::test]
async fn two_clients_with_different_budgets_agree_with_the_exact_verdicts() {
    let (_running, client) = started().await;
    exercise(&client, "shared", 40).await;
    let field = TestTerrain::new(None);
    let mut views = Vec::new();
    for (budget, x) in [(150, 400.0), (4_000, 2_000.0)] {
        let mut view = client.open_view("shared", settings(budget), pose(x, 700.0)).await.unwrap();
        let first = frame(&mut view).await;
        assert_eq!((first.sequence, first.base_sequence, first.epoch), (1, 0, 1));
        views.push((view, budget));
    }
    let (mut compared, mut moved) = (0, 0);
    for step in 1..12_u32 {
        let x = f64::from(step);
        let change = v1::ChangeExerciseRequest {
            name: "shared".into(),
            put_entities: vec![entity(0, 7.0 * x, 40.0), entity(9, 30.0, 5.0 * x)],
            ..Default::default()
        };
        let epoch = client.change_exercise(change).await.unwrap();
        for (view, budget) in &mut views {
            let wanted = view.steer(pose(200.0 * x, 100.0 * x)).await.unwrap();
            let mut last = frame(view).await;
            while (last.epoch, last.pose_sequence) != (epoch, wanted) {
                last = frame(view).await;
                moved += 1;
            }
            assert!(last.triangle_count <= *budget);
            compared += agreement(view, &field);
        }
    }
    assert!(compared > 300, "{compared} verdicts, {moved} frames between");
}

/// Compares each line that is not named on the client's mesh with the exact verdict on the terrain.
fn agreement(view: &View, field: &TestTerrain) -> u32 {
    let scene = view.scene();
    assert!(scene.silent_disagreements().is_empty());
    let mut compared = 0;
    for (id, line) in scene.lines() {
        let Some([a, b]) = line.ends else { continue };
        let exact = los::line_of_sight(field, a, b, Options::default()).unwrap().verdict;
        assert_eq!(line.verdict.as_str_name(), format!("VERDICT_{}", exact.name()));
        let on_mesh = match verdict_on_mesh(scene.replica(), a, b) {
            MeshVerdict::Visible => los::Verdict::Visible,
            MeshVerdict::Blocked => los::Verdict::Blocked,
        };
        let named = scene.unsatisfied().contains_key(id);
        assert!(named || exact == los::Verdict::Unknown || on_mesh == exact, "line {id} in silence");
        compared += u32::from(!named);
    }
    compared
}

#[tokio::test]
async fn views_that_make_no_sense_are_refused() {
    let (_running, client) = started().await;
    for budget in [0, 1, 1_000_000_000] {
        refusal(client.open_view("", settings(budget), pose(1.0, 1.0)).await, Code::InvalidArgument, "triangle_budget");
    }
    refusal(client.open_view("none", settings(100), pose(1.0, 1.0)).await, Code::NotFound, "'none'");
    refusal(client.open_view("", settings(100), pose(f64::NAN, 1.0)).await, Code::InvalidArgument, "eye");
    let regions = vec![v1::RegionOfInterest::default()];
    refusal(
        client.open_view("", v1::ViewSettings { regions, ..settings(100) }, pose(1.0, 1.0)).await,
        Code::InvalidArgument,
        "regions: ",
    );
    let blank = v1::ViewSettings::default();
    refusal(client.open_view("", blank, pose(1.0, 1.0)).await, Code::InvalidArgument, "projection is missing");
    let twisted = v1::Pose { rotation: Some(v1::Quaternion::default()), ..pose(1.0, 1.0) };
    refusal(client.open_view("", settings(100), twisted).await, Code::InvalidArgument, "quaternion");
    // An open view that is then steered without sense is closed with the reason.
    let mut view = client.open_view("", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    view.steer(pose(f64::INFINITY, 1.0)).await.unwrap();
    refusal(timeout(PATIENCE, view.next()).await.unwrap(), Code::InvalidArgument, "eye");
    // A pose inside the ground is no nonsense.
    let buried = v1::Pose { eye: Some(v1::Position { x: 900.0, y: 900.0, z: -5_000.0 }), ..pose(0.0, 0.0) };
    let mut view = client.open_view("", settings(100), buried).await.unwrap();
    assert!(frame(&mut view).await.triangle_count <= 100);
}

/// A scene stream without the client library's manners.
async fn raw_stream(
    address: &str,
) -> (
    tokio::sync::mpsc::Sender<v1::StreamSceneRequest>,
    tokio::task::JoinHandle<Result<tonic::Streaming<v1::StreamSceneResponse>, tonic::Status>>,
) {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{address}")).unwrap();
    let mut scenes = v1::scene_service_client::SceneServiceClient::new(endpoint.connect().await.unwrap());
    let (sender, receiver) = tokio::sync::mpsc::channel(16);
    let stream = tokio_stream::wrappers::ReceiverStream::new(receiver);
    let call = tokio::spawn(async move { scenes.stream_scene(stream).await.map(tonic::Response::into_inner) });
    (sender, call)
}

fn wish(request: Wish) -> v1::StreamSceneRequest {
    v1::StreamSceneRequest { request: Some(request) }
}

#[tokio::test]
async fn a_client_that_acknowledges_nothing_gets_three_frames() {
    let (running, _client) = started().await;
    let (sender, call) = raw_stream(&running.address).await;
    let open = v1::OpenView { settings: Some(settings(500)), pose: Some(pose(0.0, 0.0)), ..Default::default() };
    sender.send(wish(Wish::Open(open.clone()))).await.unwrap();
    let mut stream = call.await.unwrap().unwrap();
    let mut frames = 0;
    let mut pose_sequence = 0;
    loop {
        pose_sequence += 1;
        let steer =
            v1::SteerView { pose: Some(pose(10.0 * pose_sequence as f64, 5.0)), pose_sequence, ..Default::default() };
        sender.send(wish(Wish::Steer(steer))).await.unwrap();
        match timeout(Duration::from_millis(700), stream.message()).await {
            Ok(message) => match message.unwrap().unwrap().response {
                Some(Word::Frame(frame)) => {
                    frames += 1;
                    assert_eq!(frame.sequence, frames);
                }
                Some(Word::Opened(_)) => {}
                other => panic!("{other:?}"),
            },
            Err(_) => break,
        }
    }
    assert_eq!(frames, 3);
    // The acknowledgement brings a frame of the newest pose, and only that.
    let steer = v1::SteerView { applied_sequence: 3, ..Default::default() };
    sender.send(wish(Wish::Steer(steer))).await.unwrap();
    let message = timeout(PATIENCE, stream.message()).await.unwrap().unwrap().unwrap();
    let Some(Word::Frame(frame)) = message.response else { panic!("{message:?}") };
    assert_eq!((frame.sequence, frame.base_sequence, frame.pose_sequence), (4, 3, pose_sequence));
    sender.send(wish(Wish::Open(open))).await.unwrap();
    let status = timeout(PATIENCE, stream.message()).await.unwrap().unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument, "{status}");
}

#[tokio::test]
async fn a_stream_must_begin_with_an_opening() {
    let (running, _client) = started().await;
    for first in
        [Some(Wish::Steer(v1::SteerView::default())), Some(Wish::Snapshot(v1::RequestSnapshot::default())), None]
    {
        let (sender, call) = raw_stream(&running.address).await;
        sender.send(v1::StreamSceneRequest { request: first }).await.unwrap();
        let status = timeout(PATIENCE, call).await.unwrap().unwrap().unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{status}");
    }
    let (sender, call) = raw_stream(&running.address).await;
    drop(sender);
    let status = timeout(PATIENCE, call).await.unwrap().unwrap().unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument, "{status}");
}

#[tokio::test]
async fn a_client_that_vanishes_frees_its_view() {
    let running = Running::start(TestTerrain::new(None), Limits { views: 2, ..Limits::default() }).await;
    let client = running.client().await;
    let first = client.open_view("", settings(100), pose(1.0, 1.0)).await.unwrap();
    let mut second = client.open_view("", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut second).await;
    refusal(client.open_view("", settings(100), pose(1.0, 1.0)).await, Code::ResourceExhausted, "limit is 2");
    // One goes without a word, with frames under way; the other's connection dies whole.
    drop(first);
    let lonely = running.client().await;
    let again = async {
        loop {
            match lonely.open_view("", settings(100), pose(1.0, 1.0)).await {
                Ok(view) => return view,
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    let third = timeout(PATIENCE, again).await.expect("the view is freed");
    let socket_gone = tokio::task::spawn_blocking(move || drop((third, lonely)));
    socket_gone.await.unwrap();
    let again = async {
        while client.open_view("", settings(100), pose(1.0, 1.0)).await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, again).await.expect("the view is freed");
    second.steer(pose(2.0, 2.0)).await.unwrap();
    frame(&mut second).await;
}

#[tokio::test]
async fn an_exercise_that_ends_ends_its_views() {
    let (_running, client) = started().await;
    exercise(&client, "short", 3).await;
    let mut view = client.open_view("short", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    client.delete_exercise("short").await.unwrap();
    // Another exercise of the same name is another exercise.
    client.create_exercise("short").await.unwrap();
    let end = async {
        loop {
            if let Err(error) = view.next().await {
                return error;
            }
        }
    };
    refusal::<()>(Err(timeout(PATIENCE, end).await.unwrap()), Code::NotFound, "short");
}

#[tokio::test]
async fn a_damaged_page_is_data_loss_and_never_an_answer() {
    let terrain = TestTerrain::new(None);
    let running = Running::start(Arc::clone(&terrain), Limits::default()).await;
    let client = running.client().await;
    client.create_exercise("one").await.unwrap();
    let mut view = client.open_view("", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    terrain.damaged.store(true, Ordering::Relaxed);
    let request = v1::QueryLineOfSightRequest { a: end(1.0, 1.0, 1.0), b: end(9.0, 9.0, 1.0), ..Default::default() };
    refusal(client.query(request).await, Code::DataLoss, "page 3");
    let change =
        v1::ChangeExerciseRequest { name: "one".into(), put_entities: vec![entity(1, 1.0, 1.0)], ..Default::default() };
    refusal(client.change_exercise(change).await, Code::DataLoss, "page 3");
    refusal(client.open_view("", settings(100), pose(1.0, 1.0)).await.map(|_| ()), Code::DataLoss, "page 3");
    view.change_settings(settings(4_000)).await.unwrap();
    refusal(timeout(PATIENCE, view.next()).await.unwrap(), Code::DataLoss, "page 3");
}

#[tokio::test]
async fn a_server_that_stops_says_so_and_lets_go() {
    use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
    let (running, client) = started().await;
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let mut health = HealthClient::new(endpoint.connect().await.unwrap());
    let ask = |service: &str| HealthCheckRequest { service: service.into() };
    for service in ["", "sightline.v1.SceneService", "sightline.v1.LineOfSightService"] {
        let status = health.check(ask(service)).await.unwrap().into_inner().status();
        assert_eq!(status, ServingStatus::Serving, "{service}");
    }
    let mut watch = health.watch(ask("")).await.unwrap().into_inner();
    assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
    let mut view = client.open_view("", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    running.stop.send(()).unwrap();
    let told = timeout(PATIENCE, watch.message()).await.unwrap().unwrap().unwrap();
    assert_eq!(told.status(), ServingStatus::NotServing);
    refusal(timeout(PATIENCE, view.next()).await.unwrap(), Code::Unavailable, "stopping");
    drop((watch, view));
    timeout(PATIENCE, running.done).await.expect("the server ends").unwrap().unwrap();
    let error = Client::connect(&running.address).await.unwrap_err();
    assert!(error.to_string().contains(&running.address), "{error}");
}

#[tokio::test]
async fn reflection_tells_the_services() {
    use tonic_reflection::pb::v1::{
        ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
        server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
    };
    let (running, _client) = started().await;
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let mut reflection = ServerReflectionClient::new(endpoint.connect().await.unwrap());
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut answers = reflection.server_reflection_info(tokio_stream::once(request)).await.unwrap().into_inner();
    let answer = answers.message().await.unwrap().unwrap();
    let Some(MessageResponse::ListServicesResponse(list)) = answer.message_response else { panic!("{answer:?}") };
    for name in ["Terrain", "LineOfSight", "Exercise", "Scene"] {
        let name = format!("sightline.v1.{name}Service");
        assert!(list.service.iter().any(|service| service.name == name), "{name}");
    }
}
