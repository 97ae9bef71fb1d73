//! Clients that do not read, in numbers: nothing queues for them, and those that do read notice nothing.

use super::*;

/// Views that never acknowledge.
const SILENT: usize = 20;
/// Poses that each of them sends.
const POSES: u64 = 100;

/// The frames that the server has made.
async fn frames_made(client: &Client) -> u64 {
    client.status().await.unwrap().frames
}

fn opening(triangles: u32) -> v1::StreamSceneRequest {
    let (settings, pose) = (Some(settings(triangles)), Some(pose(0.0, 0.0)));
    wish(Wish::Open(v1::OpenView { settings, pose, ..Default::default() }))
}

fn steering(n: u64, applied_sequence: u64) -> v1::StreamSceneRequest {
    let pose = Some(pose((n * 137 % 2_600) as f64, (n * 71 % 1_700) as f64));
    wish(Wish::Steer(v1::SteerView { pose, pose_sequence: n, applied_sequence, ..Default::default() }))
}

#[tokio::test]
async fn views_that_never_acknowledge_get_three_frames_each_and_harm_nobody() {
    let (running, client) = started().await;
    let mut silent = Vec::new();
    for _ in 0..SILENT {
        let (sender, call) = raw_stream(&running.address).await;
        sender.send(opening(2_000)).await.unwrap();
        silent.push((sender, call.await.unwrap().unwrap()));
    }
    let mut good = client.open_view("", settings(2_000), pose(1.0, 1.0)).await.unwrap();
    let mut received = 0;
    for n in 1..=POSES {
        for (sender, _) in &silent {
            timeout(PATIENCE, sender.send(steering(n, 0))).await.expect("poses are taken").unwrap();
        }
        let wanted = good.steer(pose((n * 20) as f64, 300.0)).await.unwrap();
        while frame(&mut good).await.pose_sequence != wanted {
            received += 1;
        }
        received += 1;
    }
    assert!(received >= POSES, "each pose of the client that reads had its frame");
    // Those that are silent may still be on their way to their third.
    let all = SILENT as u64 * 3 + received;
    let settled = async {
        while frames_made(&client).await < all {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(PATIENCE, settled).await.expect("three frames each");
    assert_eq!(frames_made(&client).await, all, "and no more");
}

#[tokio::test]
async fn what_a_client_acknowledges_without_reading_is_bounded_by_its_window() {
    /// The client's window of HTTP/2, in bytes.
    const WINDOW_BYTES: u32 = 8_192;
    let (running, client) = started().await;
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let endpoint = endpoint.initial_stream_window_size(WINDOW_BYTES);
    let mut scenes = v1::scene_service_client::SceneServiceClient::new(endpoint.connect().await.unwrap());
    let (sender, receiver) = tokio::sync::mpsc::channel(16);
    sender.send(opening(3_000)).await.unwrap();
    let stream = scenes.stream_scene(tokio_stream::wrappers::ReceiverStream::new(receiver)).await.unwrap().into_inner();
    // It acknowledges whatever the server has made, so that only the network is in its way.
    let (mut made, mut still, mut n) = (0, 0, 0);
    while still < 40 {
        n += 1;
        sender.send(steering(n, made)).await.unwrap();
        tokio::time::sleep(Duration::from_millis(5)).await;
        let now = frames_made(&client).await;
        still = if now == made { still + 1 } else { 0 };
        made = now;
        assert!(n < 4_000, "frames without end for a client that does not read: {made}");
    }
    let sent = client.status().await.unwrap().sent_bytes;
    assert!(made >= 3 && sent < 100_000, "{made} frames, {sent} bytes");
    // It reads at last: what was held, in order, and then the newest state.
    let mut stream = stream;
    let (mut sequence, mut pose_sequence) = (0, 0);
    while pose_sequence < n {
        let message = timeout(PATIENCE, stream.message()).await.expect("a frame").unwrap().unwrap();
        let Some(Word::Frame(frame)) = message.response else { continue };
        assert_eq!(frame.sequence, sequence + 1);
        (sequence, pose_sequence) = (frame.sequence, frame.pose_sequence);
        sender
            .send(wish(Wish::Steer(v1::SteerView { applied_sequence: sequence.max(made), ..Default::default() })))
            .await
            .unwrap();
    }
    assert!(sequence <= made + 3, "frame {sequence}, {made} made before it read");
}
