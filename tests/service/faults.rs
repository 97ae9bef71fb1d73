//! What bad clients and bad luck do to a server: the others go on, and health tells.

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};
use tonic_health::ServingStatus;

use super::*;

/// The troubles that the server tells.
async fn troubles(client: &Client) -> Vec<String> {
    client.status().await.unwrap().troubles
}

#[tokio::test]
async fn a_damaged_page_makes_the_server_unhealthy() {
    let terrain = TestTerrain::new(None);
    let running = Running::start(Arc::clone(&terrain), Limits::default()).await;
    let client = running.client().await;
    assert!(troubles(&client).await.is_empty());
    terrain.damaged.store(true, Ordering::Relaxed);
    let line = v1::QueryLineOfSightRequest { a: end(1.0, 1.0, 1.0), b: end(9.0, 9.0, 1.0), ..Default::default() };
    refusal(client.query(line).await, Code::DataLoss, "page 3");
    assert!(troubles(&client).await[0].contains("damaged"));
    health(&running, ServingStatus::NotServing).await;
}

#[tokio::test]
async fn half_open_connections_and_noise_harm_nobody() {
    let limits = Limits { connections: 12, ..Limits::default() };
    let running = Running::start(TestTerrain::new(None), limits).await;
    let client = running.client().await;
    let mut view = client.open_view("", settings(300), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    // Some say nothing, some noise, one an endless header, one a frame of HTTP/2 that no peer may send.
    let mut strangers = Vec::new();
    for n in 0..10_u8 {
        let mut stream = TcpStream::connect(&running.address).await.unwrap();
        let noise: Vec<u8> = match n % 4 {
            0 => Vec::new(),
            1 => (0..2_000_u32).map(|k| (k * 37 % 251) as u8).collect(),
            2 => [b"GET / HTTP/1.1\r\nx: ".to_vec(), vec![b'a'; 40_000]].concat(),
            _ => [b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec(), vec![0xff; 64]].concat(),
        };
        let _ = stream.write_all(&noise).await;
        strangers.push(stream);
    }
    view.steer(pose(900.0, 900.0)).await.unwrap();
    frame(&mut view).await;
    // Noise is answered by an end; silence is still there.
    for n in [1, 3] {
        let mut rest = Vec::new();
        timeout(PATIENCE, strangers[n].read_to_end(&mut rest)).await.expect("an end").ok();
    }
    assert!(client.status().await.unwrap().connections <= 12);
    drop(strangers);
    let alone = async {
        while client.status().await.unwrap().connections > 1 {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, alone).await.expect("their places are free");
}

/// With every place taken by connections that say nothing, a client waits for one of them to be ended, not for ever; and a
/// client that has called is left alone, whatever its protocol.
#[tokio::test]
async fn a_flood_of_silent_connections_gives_its_places_back() {
    let limits = Limits { connections: 12, silence_s: 0.4, ..Limits::default() };
    let running = Running::start(TestTerrain::new(None), limits).await;
    let client = running.client().await;
    let mut view = client.open_view("", settings(300), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    let mut browser = TcpStream::connect(&running.address).await.unwrap();
    let ask = b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n";
    browser.write_all(ask).await.unwrap();
    let mut answer = [0; 512];
    let read = timeout(PATIENCE, browser.read(&mut answer)).await.unwrap().unwrap();
    assert!(answer[..read].starts_with(b"HTTP/1.1 200"));
    let mut silent = Vec::new();
    for n in 0..20 {
        let mut stream = TcpStream::connect(&running.address).await.unwrap();
        // Half of them begin as HTTP/2 does, and stop.
        stream.write_all(&b"PRI * HTTP"[..5 * (n % 2)]).await.unwrap();
        silent.push(stream);
    }
    let late = timeout(PATIENCE, async { running.client().await.terrain().await }).await.expect("a place in time");
    late.unwrap();
    for mut stream in silent {
        let end = timeout(PATIENCE, stream.read(&mut [0; 64])).await.expect("an end");
        assert!(matches!(end, Ok(0) | Err(_)), "{end:?}");
    }
    view.steer(pose(500.0, 500.0)).await.unwrap();
    frame(&mut view).await;
    browser.write_all(ask).await.unwrap();
    let read = timeout(PATIENCE, browser.read(&mut answer)).await.unwrap().unwrap();
    assert!(answer[..read].starts_with(b"HTTP/1.1 200"), "one that has called may be silent");
}

/// What is no message of gRPC is refused, and only the call that it came with.
#[tokio::test]
async fn malformed_messages_end_their_call_alone() {
    let (running, client) = started().await;
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let mut raw = tonic::client::Grpc::new(endpoint.connect().await.unwrap());
    let whole = v1::QueryRayRequest { azimuth_deg: 1.0, range_m: 7.0, ..Default::default() };
    let whole = prost::Message::encode_to_vec(&whole);
    // Cut short, with a wire type that is none, with a length beyond the end, and no protobuf at all.
    let wild: Vec<u8> = (0..300_u32).map(|n| (n * 131 % 251) as u8).collect();
    for bytes in [&whole[..whole.len() - 1], &[0x0f, 1], &[0x0a, 0xff, 0xff, 0x03, 1], &wild] {
        let path = tonic::codegen::http::uri::PathAndQuery::from_static("/sightline.v1.LineOfSightService/QueryRay");
        let request = tonic::Request::new(bytes.to_vec());
        raw.ready().await.unwrap();
        let status = raw.unary::<_, Vec<u8>, _>(request, path, Raw).await.unwrap_err();
        assert!(matches!(status.code(), Code::Internal | Code::InvalidArgument), "{status}");
    }
    client.terrain().await.unwrap();
    assert!(troubles(&client).await.is_empty());
}

/// Sends and receives bytes as they are.
#[derive(Default)]
struct Raw;

impl tonic::codec::Codec for Raw {
    type Encode = Vec<u8>;
    type Decode = Vec<u8>;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

impl tonic::codec::Encoder for Raw {
    type Item = Vec<u8>;
    type Error = tonic::Status;

    fn encode(&mut self, item: Vec<u8>, into: &mut tonic::codec::EncodeBuf<'_>) -> Result<(), tonic::Status> {
        prost::bytes::BufMut::put_slice(into, &item);
        Ok(())
    }
}

impl tonic::codec::Decoder for Raw {
    type Item = Vec<u8>;
    type Error = tonic::Status;

    fn decode(&mut self, from: &mut tonic::codec::DecodeBuf<'_>) -> Result<Option<Vec<u8>>, tonic::Status> {
        let length = prost::bytes::Buf::remaining(from);
        Ok(Some(prost::bytes::Buf::copy_to_bytes(from, length).to_vec()))
    }
}

/// Work that finds no core for over a second is told by health, and health heals when the cores are free again.
#[tokio::test]
async fn work_that_waits_too_long_makes_the_server_unhealthy() {
    let terrain = TestTerrain::new(None);
    let running = Running::start(Arc::clone(&terrain), Limits::default()).await;
    let client = running.client().await;
    health(&running, ServingStatus::Serving).await;
    terrain.stuck.store(true, Ordering::Relaxed);
    let threads = std::thread::available_parallelism().map_or(2, usize::from);
    let line = v1::QueryLineOfSightRequest { a: end(1.0, 1.0, 1.0), b: end(9.0, 9.0, 1.0), ..Default::default() };
    let asked: Vec<_> = (0..=threads)
        .map(|_| {
            let (client, line) = (client.clone(), line);
            tokio::spawn(async move { client.query(line).await })
        })
        .collect();
    health(&running, ServingStatus::NotServing).await;
    assert!(troubles(&client).await[0].contains("for a core"));
    terrain.stuck.store(false, Ordering::Relaxed);
    health(&running, ServingStatus::Serving).await;
    for answer in asked {
        answer.await.unwrap().unwrap();
    }
}

/// What is logged of a call has the id that its client gave, and so has what its view does later.
#[tokio::test]
async fn the_log_of_a_call_has_its_id() {
    let log = Log::default();
    // Were the log's dispatcher the only one, a callsite that another test meets first would be asked about on that thread,
    // which has none, and be silent for good; with two, each callsite asks both.
    let _second = tracing::Dispatch::new(tracing::subscriber::NoSubscriber::default());
    let subscriber = tracing_subscriber::fmt().with_writer(log.clone()).with_ansi(false).finish();
    let _guard = tracing::subscriber::set_default(subscriber);
    let (running, client) = started().await;
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let channel = endpoint.connect().await.unwrap();
    let with_id = |id: &'static str| {
        move |mut request: tonic::Request<()>| {
            request.metadata_mut().insert("x-request-id", id.parse().unwrap());
            Ok(request)
        }
    };
    let mut exercises =
        v1::exercise_service_client::ExerciseServiceClient::with_interceptor(channel.clone(), with_id("refused-7"));
    let status = exercises.get_exercise(v1::GetExerciseRequest { name: "none".into() }).await.unwrap_err();
    assert_eq!(status.metadata().get("x-request-id").unwrap(), "refused-7");
    let mut scenes = v1::scene_service_client::SceneServiceClient::with_interceptor(channel, with_id("view-8"));
    let open = v1::OpenView { settings: Some(settings(100)), pose: Some(pose(1.0, 1.0)), ..Default::default() };
    let wishes = tokio_stream::iter([wish(Wish::Open(open))]);
    let mut stream = scenes.stream_scene(wishes).await.unwrap().into_inner();
    while stream.message().await.unwrap().is_some() {}
    client.terrain().await.unwrap();
    for (words, id) in [("refused", "refused-7"), ("view opened", "view-8"), ("view closed", "view-8")] {
        let seen = log.text().lines().any(|line| line.contains(words) && line.contains(&format!("id=\"{id}\"")));
        assert!(seen, "'{words}' with {id} in\n{}", log.text());
    }
}

/// What was logged on this thread.
#[derive(Clone, Default)]
struct Log(Arc<std::sync::Mutex<Vec<u8>>>);

impl Log {
    fn text(&self) -> String {
        String::from_utf8(self.0.lock().unwrap().clone()).unwrap()
    }
}

impl std::io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl tracing_subscriber::fmt::MakeWriter<'_> for Log {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

#[tokio::test]
async fn floods_and_greed_are_refused_by_the_name_of_the_limit() {
    let limits = Limits {
        calls_per_s_per_client: 40,
        triangles_per_client: 1_000,
        triangles_per_view: 900,
        batch_lines: 100,
        things_per_exercise: 10,
        request_bytes: 20_000,
        ..Limits::default()
    };
    let running = Running::start(TestTerrain::new(None), limits).await;
    let client = running.client().await;
    let exhausted = Code::ResourceExhausted;
    refusal(client.open_view("", settings(901), pose(1.0, 1.0)).await, exhausted, "limits.triangles_per_view");
    let mut view = client.open_view("", settings(800), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    refusal(client.open_view("", settings(201), pose(1.0, 1.0)).await, exhausted, "limits.triangles_per_client");
    let [ax, ay, az, bx, by, bz] = [(); 6].map(|()| vec![1.0; 101]);
    let batch = v1::QueryLineOfSightBatchRequest { ax, ay, az, bx, by, bz, ..Default::default() };
    refusal(client.query_batch(batch).await, exhausted, "limits.batch_lines");
    client.create_exercise("one").await.unwrap();
    let many = v1::ChangeExerciseRequest {
        name: "one".into(),
        put_entities: (0..11).map(|id| entity(id, 3.0, 3.0)).collect(),
        ..Default::default()
    };
    refusal(client.change_exercise(many).await, exhausted, "limits.things_per_exercise");
    // A message of a stream that is too long ends that stream alone.
    let list =
        v1::Subscription { lines: Some(v1::subscription::Lines::List(v1::LineList { ids: vec![u64::MAX; 9_000] })) };
    let mut greedy = client.open_view("", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut greedy).await;
    greedy.change_settings(v1::ViewSettings { subscription: Some(list), ..settings(100) }).await.unwrap();
    refusal(timeout(PATIENCE, greedy.next()).await.unwrap(), exhausted, "limits.request_bytes");
    let flood = async {
        loop {
            if let Err(error) = client.terrain().await {
                return error;
            }
        }
    };
    refusal::<()>(Err(timeout(PATIENCE, flood).await.unwrap()), exhausted, "limits.calls_per_s_per_client");
    view.steer(pose(500.0, 500.0)).await.unwrap();
    frame(&mut view).await;
}

/// The beginning of a request, and no end.
struct Begun(Option<Vec<u8>>);

impl http_body::Body for Begun {
    type Data = prost::bytes::Bytes;
    type Error = tonic::Status;

    fn poll_frame(
        mut self: std::pin::Pin<&mut Self>,
        _: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Option<Result<http_body::Frame<Self::Data>, tonic::Status>>> {
        match self.0.take() {
            Some(bytes) => std::task::Poll::Ready(Some(Ok(http_body::Frame::data(bytes.into())))),
            None => std::task::Poll::Pending,
        }
    }
}

/// How a request for heights ends of whose message of 90,000 bytes so many come.
async fn begin(channel: tonic::transport::Channel, bytes: usize) -> ClientError {
    let message = [&[0][..], &90_000_u32.to_be_bytes(), &vec![0; bytes]].concat();
    let body = Begun(Some(message).filter(|_| bytes > 0));
    let request = tonic::codegen::http::Request::post("http://server/sightline.v1.TerrainService/GetHeights")
        .header("content-type", "application/grpc")
        .body(tonic::body::Body::new(body))
        .unwrap();
    let mut channel = channel;
    std::future::poll_fn(|cx| tonic::codegen::Service::poll_ready(&mut channel, cx)).await.unwrap();
    let response = timeout(PATIENCE, tonic::codegen::Service::call(&mut channel, request)).await;
    tonic::Status::from_header_map(response.expect("an end").unwrap().headers()).expect("a status").into()
}

async fn channel(running: &Running) -> tonic::transport::Channel {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    endpoint.connect().await.unwrap()
}

/// Requests that begin and do not end hold no more memory than is allowed.
#[tokio::test]
async fn bytes_of_requests_under_way_are_bounded() {
    let limits = Limits {
        request_bytes: 100_000,
        bytes_under_way_per_client: 150_000,
        bytes_under_way: 400_000,
        ..Limits::default()
    };
    let running = Running::start(TestTerrain::new(None), limits).await;
    let (client, channel) = (running.client().await, channel(&running).await);
    let until = async |enough: &dyn Fn(u64) -> bool| {
        let looking = async {
            loop {
                let limits = client.status().await.unwrap().limits;
                if enough(limits.iter().find(|limit| limit.name == "bytes_under_way").unwrap().used) {
                    return;
                }
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(PATIENCE, looking).await.expect("what is held is counted, and what has ended is not");
    };
    let first = tokio::spawn(begin(channel.clone(), 80_000));
    until(&|used| used >= 80_000).await;
    refusal::<()>(
        Err(begin(channel.clone(), 80_000).await),
        Code::ResourceExhausted,
        "limits.bytes_under_way_per_client",
    );
    first.abort();
    until(&|used| used < 1_000).await;
}

/// Requests that do not arrive are ended; a view may be silent for as long as it likes.
#[tokio::test]
async fn requests_that_drip_are_ended() {
    let limits = Limits { receiving_s: 1.0, ..Limits::default() };
    let running = Running::start(TestTerrain::new(None), limits).await;
    let (client, channel) = (running.client().await, channel(&running).await);
    let mut view = client.open_view("", settings(300), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    for bytes in [80_000, 0] {
        refusal::<()>(Err(begin(channel.clone(), bytes).await), Code::DeadlineExceeded, "limits.receiving_s");
    }
    view.steer(pose(900.0, 900.0)).await.unwrap();
    frame(&mut view).await;
}

#[tokio::test]
async fn a_view_keeps_the_pace_that_its_client_chose_and_says_so() {
    let (running, _client) = started().await;
    let (sender, call) = raw_stream(&running.address).await;
    let pace = Some(v1::Pace { max_rate_hz: 20.0, max_bytes_per_s: 0 });
    let open = v1::OpenView { settings: Some(settings(300)), pose: Some(pose(0.0, 0.0)), pace, ..Default::default() };
    sender.send(wish(Wish::Open(open))).await.unwrap();
    let mut stream = call.await.unwrap().unwrap();
    let (mut frames, mut held_back, mut first) = (0_u32, 0, None);
    while frames < 8 {
        let message = timeout(PATIENCE, stream.message()).await.unwrap().unwrap().unwrap();
        let Some(Word::Frame(frame)) = message.response else { continue };
        frames += 1;
        let first = *first.get_or_insert_with(std::time::Instant::now);
        // No sooner than planned; the frame that began it all may have been late itself.
        let planned = Duration::from_millis(50) * frames.saturating_sub(2);
        assert!(first.elapsed() + Duration::from_millis(25) >= planned, "frame {frames} after {:?}", first.elapsed());
        held_back += u32::from(frame.held_back_ms > 0);
        let steer = v1::SteerView {
            pose: Some(pose(40.0 * f64::from(frames), 7.0)),
            pose_sequence: frame.sequence,
            applied_sequence: frame.sequence,
            ..Default::default()
        };
        sender.send(wish(Wish::Steer(steer))).await.unwrap();
    }
    assert!(held_back >= 5, "{held_back} frames say that they were held back");
    let bad = v1::SteerView { pace: Some(v1::Pace { max_rate_hz: -1.0, max_bytes_per_s: 0 }), ..Default::default() };
    sender.send(wish(Wish::Steer(bad))).await.unwrap();
    let status = timeout(PATIENCE, stream.message()).await.unwrap().unwrap_err();
    assert!(status.code() == Code::InvalidArgument && status.message().contains("max_rate_hz"), "{status}");
}
