//! Everything on one port: pages over HTTP/1.1, and views over gRPC-Web as a browser does it.

use std::io::Read;

use prost::Message;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use super::*;

/// A request over HTTP/1.1 whose answer is read as it comes.
struct Answer {
    stream: TcpStream,
    head: String,
    /// Bytes of the body that have not been taken, without the lengths of chunks.
    body: Vec<u8>,
    /// Bytes received that are not yet sorted.
    raw: Vec<u8>,
}

impl Answer {
    async fn to(address: &str, method: &str, path: &str, headers: &str, body: &[u8]) -> Self {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let length = body.len();
        let head = format!("{method} {path} HTTP/1.1\r\nhost: {address}\r\ncontent-length: {length}\r\n{headers}\r\n");
        stream.write_all(&[head.as_bytes(), body].concat()).await.unwrap();
        let mut answer = Self { stream, head: String::new(), body: Vec::new(), raw: Vec::new() };
        loop {
            if let Some(end) = answer.raw.windows(4).position(|w| w == b"\r\n\r\n") {
                answer.head = String::from_utf8(answer.raw.drain(..end + 4).collect()).unwrap().to_lowercase();
                return answer;
            }
            assert!(answer.receive().await, "the connection ended");
        }
    }

    async fn receive(&mut self) -> bool {
        let mut buffer = [0; 4096];
        let read = timeout(PATIENCE, self.stream.read(&mut buffer)).await.expect("an answer in time").unwrap();
        self.raw.extend(&buffer[..read]);
        read > 0
    }

    fn sort(&mut self) {
        if !self.head.contains("transfer-encoding: chunked") {
            self.body.append(&mut self.raw);
            return;
        }
        while let Some(end) = self.raw.windows(2).position(|w| w == b"\r\n") {
            let length = usize::from_str_radix(std::str::from_utf8(&self.raw[..end]).unwrap(), 16).unwrap();
            if self.raw.len() < end + 2 + length + 2 {
                return;
            }
            self.body.extend(&self.raw[end + 2..end + 2 + length]);
            self.raw.drain(..end + 2 + length + 2);
        }
    }

    /// The first `n` bytes of the body that were not taken.
    async fn take(&mut self, n: usize) -> Vec<u8> {
        self.sort();
        while self.body.len() < n {
            assert!(self.receive().await, "the connection ended");
            self.sort();
        }
        self.body.drain(..n).collect()
    }

    /// The next message of gRPC-Web, or the trailers at the end.
    async fn message<M: Message + Default>(&mut self) -> Result<M, String> {
        let head = self.take(5).await;
        let length = u32::from_be_bytes([head[1], head[2], head[3], head[4]]) as usize;
        let body = self.take(length).await;
        if head[0] == 0x80 { Err(String::from_utf8(body).unwrap()) } else { Ok(M::decode(&*body).unwrap()) }
    }
}

pub(super) async fn get(address: &str, path: &str) -> (String, String) {
    let mut answer = Answer::to(address, "GET", path, "connection: close\r\n", b"").await;
    while answer.receive().await {}
    answer.sort();
    (answer.head, String::from_utf8(answer.body).unwrap())
}

/// A call of gRPC-Web.
async fn call(address: &str, method: &str, request: &impl Message) -> Answer {
    let body = request.encode_to_vec();
    let framed = [&[0][..], &(body.len() as u32).to_be_bytes(), &body].concat();
    let headers = "content-type: application/grpc-web+proto\r\nx-request-id: mine-1\r\n";
    Answer::to(address, "POST", &format!("/sightline.v1.{method}"), headers, &framed).await
}

/// The answer to a call with one; the refusal stands in the trailers or in the headers.
async fn unary<M: Message + Default + std::fmt::Debug>(
    address: &str,
    method: &str,
    request: &impl Message,
) -> Result<M, String> {
    let mut answer = call(address, method, request).await;
    if answer.head.contains("grpc-status") {
        return Err(answer.head);
    }
    let message = answer.message().await?;
    let trailers = answer.message::<M>().await.unwrap_err();
    assert!(trailers.contains("grpc-status:0"), "{trailers}");
    Ok(message)
}

#[tokio::test]
async fn pages_and_grpc_share_the_port() {
    let (running, client) = started().await;
    let address = &running.address;
    let lines = v1::QueryLineOfSightRequest { a: end(1.0, 1.0, 1.0), b: end(9.0, 9.0, 1.0), ..Default::default() };
    client.query(lines).await.unwrap();
    let (head, page) = get(address, "/healthz").await;
    assert!(head.starts_with("http/1.1 200") && page == "ok\n", "{head}{page}");
    let (head, page) = get(address, "/metrics").await;
    assert!(head.starts_with("http/1.1 200") && head.contains("openmetrics"), "{head}");
    let method = "/sightline.v1.LineOfSightService/QueryLineOfSight";
    for line in [&format!("sightline_calls_total{{method=\"{method}\",code=\"0\"}} 1"), "sightline_serving 1"] {
        assert!(page.contains(line), "{line} in {page}");
    }
    // Lines from post to post over ground that they lie in: some take exact arithmetic, and not all.
    let column = |factor: u32, size: u32| (0..400_u32).map(|n| f64::from(n * factor % size)).collect::<Vec<_>>();
    let batch = v1::QueryLineOfSightBatchRequest {
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        ax: column(7, 89),
        ay: column(11, 69),
        bx: column(31, 89),
        by: column(17, 69),
        az: vec![0.0; 400],
        bz: vec![0.0; 400],
        ..Default::default()
    };
    client.query_batch(batch).await.unwrap();
    let mut view = client.open_view("", settings(300), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    let (_, page) = get(address, "/metrics").await;
    let metric = |name: &str| -> u64 {
        let line = page.lines().find_map(|line| line.strip_prefix(&format!("sightline_{name} ")));
        line.unwrap_or_else(|| panic!("no {name} in {page}")).parse().unwrap()
    };
    assert!((1..400).contains(&metric("exact_lines_total")), "{}", metric("exact_lines_total"));
    // A mesh of 300 triangles has some 150 posts that were split, less what was merged again.
    let posts = metric("splits_total") - metric("merges_total");
    assert!((140..300).contains(&posts), "{posts}");
    let (head, _) = get(address, "/nothing").await;
    assert!(head.starts_with("http/1.1 404"), "{head}");
    let status = client.status().await.unwrap();
    assert!(status.serving && status.visible + status.blocked + status.unknown == 401 && status.sent_bytes > 0);
    let answer = call(address, "NoService/Nothing", &v1::GetStatusRequest {}).await;
    assert!(answer.head.contains("grpc-status: 12"), "{}", answer.head);
}

/// The viewer is there in full, may be kept only as long as it is the same, and lets nothing in from elsewhere.
#[tokio::test]
async fn the_viewer_is_served_and_asked_about_again() {
    let (running, _) = started().await;
    let address = &running.address;
    let files =
        [("/", "text/html", "/healthz"), ("/app.js", "text/javascript", "webgl2"), ("/app.css", "text/css", "canvas")];
    for (path, media_type, part) in files {
        let (head, page) = get(address, path).await;
        assert!(head.starts_with("http/1.1 200") && head.contains(&format!("content-type: {media_type}")), "{head}");
        assert!(page.contains(part), "no {part} in {path}");
        for said in ["cache-control: no-cache", "default-src 'none'; script-src 'self';", "frame-ancestors 'none'"] {
            assert!(head.contains(said), "{said} in {head}");
        }
        // Heads are in small letters here.
        let tag = head.lines().find_map(|line| line.strip_prefix("etag: w")).unwrap();
        for (asked, status) in [(format!("W{tag}"), 304), ("\"other\"".into(), 200)] {
            let headers = format!("connection: close\r\nif-none-match: {asked}\r\naccept-encoding: br, gzip;q=0.5\r\n");
            let mut answer = Answer::to(address, "GET", path, &headers, b"").await;
            while answer.receive().await {}
            assert!(answer.head.starts_with(&format!("http/1.1 {status}")), "{}", answer.head);
            assert_eq!(answer.head.contains("content-encoding: gzip"), status == 200);
            answer.sort();
            let mut unpacked = String::new();
            if status == 200 {
                flate2::read::GzDecoder::new(&*answer.body).read_to_string(&mut unpacked).unwrap();
                assert!(unpacked == page, "{path} unpacks to something else");
            }
        }
    }
}

/// What a browser asks before a page of another origin may call.
async fn preflight(address: &str, origin: &str) -> String {
    let headers = format!(
        "origin: {origin}\r\naccess-control-request-method: POST\r\n\
         access-control-request-headers: content-type,x-grpc-web,authorization\r\nconnection: close\r\n"
    );
    let path = "/sightline.v1.TerrainService/DescribeTerrain";
    Answer::to(address, "OPTIONS", path, &headers, b"").await.head
}

#[tokio::test]
async fn pages_of_other_origins_may_call_if_the_operator_names_them() {
    let ours = "https://viewer.example";
    let options = ServeOptions { origins: vec![ours.into()], ..ServeOptions::default() };
    let running = Running::start_with(TestTerrain::new(None), options).await;
    let head = preflight(&running.address, ours).await;
    assert!(head.starts_with("http/1.1 200") && head.contains("access-control-allow-origin: https://viewer.example"));
    assert!(head.contains("access-control-allow-methods: post"), "{head}");
    for name in ["content-type", "x-grpc-web", "authorization"] {
        let allowed = head.lines().find(|line| line.starts_with("access-control-allow-headers:")).unwrap();
        assert!(allowed.contains(name), "{name} in {allowed}");
    }
    let head = preflight(&running.address, "https://other.example").await;
    assert!(!head.contains("access-control-allow-origin"), "{head}");
    let body = [0, 0, 0, 0, 0];
    let headers = format!("content-type: application/grpc-web+proto\r\norigin: {ours}\r\n");
    let path = "/sightline.v1.TerrainService/DescribeTerrain";
    let head = Answer::to(&running.address, "POST", path, &headers, &body).await.head;
    assert!(head.contains("access-control-allow-origin: https://viewer.example"), "{head}");
    assert!(head.contains("access-control-expose-headers: grpc-status,grpc-message,x-request-id"), "{head}");

    let (running, _) = started().await;
    let head = preflight(&running.address, ours).await;
    assert!(!head.contains("access-control-"), "nobody without being named: {head}");
}

#[tokio::test]
async fn a_browser_watches_several_views_on_one_stream() {
    let (running, client) = started().await;
    exercise(&client, "seen", 5).await;
    let address = &running.address;
    let mut stream = call(address, "SceneService/WatchViews", &v1::WatchViewsRequest {}).await;
    assert!(stream.head.contains("x-request-id: mine-1"), "{}", stream.head);
    use v1::watch_views_response::Response as Said;
    let begun: v1::WatchViewsResponse = stream.message().await.unwrap();
    let Some(Said::Begun(v1::WatchBegun { watch_id })) = begun.response else { panic!("{begun:?}") };
    let open = |view_id, exercise: &str| v1::OpenWatchedViewRequest {
        watch_id: watch_id.clone(),
        view_id,
        open: Some(v1::OpenView {
            exercise: exercise.into(),
            settings: Some(settings(300)),
            pose: Some(pose(100.0, 100.0)),
            ..Default::default()
        }),
    };
    for view_id in [4, 9] {
        let request = open(view_id, "seen");
        let opened = unary::<v1::OpenWatchedViewResponse>(address, "SceneService/OpenWatchedView", &request);
        opened.await.unwrap();
    }
    for (request, code) in [(open(4, ""), "grpc-status: 6"), (open(5, "none"), "grpc-status: 5")] {
        let refused = unary::<v1::OpenWatchedViewResponse>(address, "SceneService/OpenWatchedView", &request).await;
        assert!(refused.as_ref().is_err_and(|words| words.contains(code)), "{refused:?}");
    }
    // Each view opens, tells its lines and sends a first frame; then it is steered and sends the next.
    let mut scenes = std::collections::BTreeMap::new();
    let mut frames = [0; 2];
    while frames != [2, 2] {
        let said: v1::WatchViewsResponse = stream.message().await.unwrap();
        let Some(Said::Message(v1::WatchedViewMessage { view_id, message: Some(message) })) = said.response else {
            panic!("{said:?}")
        };
        if let Some(Word::Opened(opened)) = &message.response {
            scenes.insert(view_id, sightline_client::scene::SceneState::new(opened, 300, true).unwrap());
            continue;
        }
        let scene = scenes.get_mut(&view_id).unwrap();
        scene.apply(&message).unwrap();
        if let Some(Word::Frame(frame)) = &message.response {
            frames[usize::from(view_id == 9)] += 1;
            assert!(scene.silent_disagreements().is_empty());
            let steer = v1::SteerView {
                pose: Some(pose(500.0, 300.0)),
                pose_sequence: frame.sequence,
                applied_sequence: frame.sequence,
                ..Default::default()
            };
            let request = v1::tell_watched_view_request::Request::Steer(steer);
            let tell = v1::TellWatchedViewRequest { watch_id: watch_id.clone(), view_id, request: Some(request) };
            let told = unary::<v1::TellWatchedViewResponse>(address, "SceneService/TellWatchedView", &tell);
            if frame.sequence == 1 {
                told.await.unwrap();
            }
        }
    }
    let close = v1::CloseWatchedViewRequest { watch_id: watch_id.clone(), view_id: 4 };
    unary::<v1::CloseWatchedViewResponse>(address, "SceneService/CloseWatchedView", &close).await.unwrap();
    let said: v1::WatchViewsResponse = stream.message().await.unwrap();
    assert!(matches!(said.response, Some(Said::Closed(v1::WatchedViewClosed { view_id: 4, code: 0, .. }))), "{said:?}");
    unary::<v1::OpenWatchedViewResponse>(address, "SceneService/OpenWatchedView", &open(4, "")).await.unwrap();
    // With the stream go its views.
    drop(stream);
    let empty = async {
        while client.status().await.unwrap().limits.iter().any(|limit| limit.name == "views" && limit.used > 0) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, empty).await.expect("the views end");
    let tell = unary::<v1::OpenWatchedViewResponse>(address, "SceneService/OpenWatchedView", &open(4, "")).await;
    assert!(tell.is_err_and(|words| words.contains("grpc-status: 5")));
}
