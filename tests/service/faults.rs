//! What bad clients and bad luck do to a server: the others go on, and health tells.

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

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
