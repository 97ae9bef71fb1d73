//! A server that is killed while clients fly: they notice, resume at the one that follows, and every frame that any of
//! them ever received was true.

use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use prost::Message;
use sightline::session::journal::{Entry, JournalReader};
use sightline_client::{Client, ClientError, Event, View, v1};
use tokio::time::timeout;

use super::{replay::golden, serve::Server, sightline, status, text};

const PATIENCE: Duration = Duration::from_secs(20);
const CLIENTS: u64 = 4;
const LINES: u64 = 8;

fn settings(triangles: u32) -> v1::ViewSettings {
    let pinhole = v1::Perspective { tan_half_fov: 0.6, near_m: 1.0 };
    v1::ViewSettings {
        projection: Some(v1::view_settings::Projection::Perspective(pinhole)),
        viewport_width_px: 640,
        viewport_height_px: 480,
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles })),
        ..Default::default()
    }
}

/// Looking straight down from somewhere over the terrain.
fn pose(terrain: &v1::TerrainDescription, n: u64) -> v1::Pose {
    let at = |part: u64, posts: u32, metres: f64| (part % 97) as f64 / 97.0 * f64::from(posts - 1) * metres;
    v1::Pose {
        eye: Some(v1::Position {
            x: at(7 * n, terrain.nx, terrain.metres_per_post_east),
            y: at(11 * n, terrain.ny, terrain.metres_per_post_north),
            z: terrain.max_height * terrain.metres_per_height_unit + 500.0,
        }),
        rotation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    }
}

fn moved(terrain: &v1::TerrainDescription, step: u64) -> v1::ChangeExerciseRequest {
    let entity = |id: u64| {
        let at = |part: u64, posts: u32| (part % 89) as f64 / 89.0 * f64::from(posts - 1);
        let position =
            Some(v1::Position { x: at(13 * id + step, terrain.nx), y: at(17 * id + step, terrain.ny), z: 2.0 });
        let (frame, altitude) = (v1::CoordinateFrame::Grid.into(), v1::AltitudeReference::AboveGround.into());
        v1::Entity { id, position, frame, altitude, ground_m: 0.0 }
    };
    let put_entities = (0..2 * LINES).map(entity).collect();
    v1::ChangeExerciseRequest { name: "flown".into(), put_entities, ..Default::default() }
}

fn lines() -> Vec<v1::SightLine> {
    let end = |entity_id| {
        let anchor = v1::anchor::Anchor::Entity(v1::EntityAnchor { entity_id, height_offset_m: 0.0 });
        Some(v1::Anchor { anchor: Some(anchor) })
    };
    (0..LINES).map(|id| v1::SightLine { id, a: end(2 * id), b: end(2 * id + 1), ..Default::default() }).collect()
}

/// What a client received: hashes of its frames, each of which its own replica had, and how many there were.
#[derive(Default)]
struct Received {
    hashes: BTreeSet<u64>,
    frames: u32,
}

impl Received {
    /// Takes a frame that fits; no line may come out otherwise in silence.
    fn take(&mut self, view: &View) {
        assert!(view.scene().silent_disagreements().is_empty());
        self.hashes.insert(view.scene().replica().hash());
        self.frames += 1;
    }
}

/// Flies until the connection is lost, or `poses` poses were flown.
async fn fly(
    view: &mut View,
    received: &mut Received,
    first: u64,
    poses: u64,
    count: &AtomicU32,
) -> Option<ClientError> {
    let terrain = view.scene().terrain().clone();
    for n in first..first + poses {
        if let Err(error) = view.steer(pose(&terrain, n)).await {
            return Some(error);
        }
        match timeout(PATIENCE, view.next()).await.expect("a frame, or the loss is noticed") {
            Ok(Some(Event::Frame(_))) => received.take(view),
            Ok(Some(Event::Exercise(_))) => {}
            Ok(Some(event)) => panic!("{event:?}"),
            Ok(None) => return Some(ClientError::Closed),
            Err(error) => return Some(error),
        }
        count.fetch_add(1, Ordering::Relaxed);
    }
    None
}

/// The hashes of all frames that a server recorded, after its recording was replayed to the same.
fn recorded(record: &str, database: &str) -> BTreeSet<u64> {
    let replayed = sightline(&["replay", record, "--db", database, "--quiet"]);
    assert_eq!(status(&replayed), 0, "{}", text(&replayed.stderr));
    let bytes = std::fs::read(record).unwrap();
    let mut reader = JournalReader::new(&bytes[..]);
    let mut hashes = BTreeSet::new();
    while let Ok(Some(entry)) = reader.next_entry() {
        let Entry::Made { said, .. } = entry else { continue };
        for message in said {
            let message = v1::StreamSceneResponse::decode(&message[..]).unwrap();
            if let Some(v1::stream_scene_response::Response::Frame(frame)) = message.response {
                hashes.insert(frame.mesh_hash);
            }
        }
    }
    hashes
}

#[test]
fn clients_of_a_killed_server_resume_and_every_frame_was_true() {
    let folder = tempfile::tempdir().unwrap();
    let (database, path) =
        (golden("terrain-20x13-v1.sldb"), |name: &str| folder.path().join(name).display().to_string());
    let state = path("state");
    let records = [path("first"), path("second")];
    let (mut server, address) = Server::start_with(&database, &["--state", &state, "--record", &records[0]]);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let count = Arc::new(AtomicU32::new(0));
    let client = runtime.block_on(async {
        let client = Client::connect(&address).await.unwrap();
        client.create_exercise("flown").await.unwrap();
        let terrain = client.terrain().await.unwrap();
        let change = v1::ChangeExerciseRequest { put_sight_lines: lines(), ..moved(&terrain, 0) };
        client.change_exercise(change).await.unwrap();
        client
    });
    let mut flying = Vec::new();
    for n in 0..CLIENTS {
        let (address, count) = (address.clone(), Arc::clone(&count));
        flying.push(runtime.spawn(async move {
            let own = Client::connect(&address).await.unwrap();
            let terrain = own.terrain().await.unwrap();
            let mut view = own.open_view("flown", settings(40 + 60 * n as u32), pose(&terrain, n)).await.unwrap();
            let mut received = Received::default();
            let lost = fly(&mut view, &mut received, 1_000 * n, u64::MAX / 2, &count).await;
            assert!(lost.is_some());
            received
        }));
    }
    let moves = Arc::new(AtomicU32::new(0));
    let done = Arc::clone(&moves);
    let moving = runtime.spawn(async move {
        let terrain = client.terrain().await.unwrap();
        for step in 1.. {
            if client.change_exercise(moved(&terrain, step)).await.is_err() {
                return;
            }
            done.store(step as u32, Ordering::Relaxed);
        }
    });
    while count.load(Ordering::Relaxed) < 40 * CLIENTS as u32 || moves.load(Ordering::Relaxed) < 3 {
        std::thread::sleep(Duration::from_millis(5));
    }
    server.0.kill().unwrap();
    server.0.wait().unwrap();
    let received: Vec<Received> = flying.into_iter().map(|flight| runtime.block_on(flight).unwrap()).collect();
    runtime.block_on(moving).unwrap();
    let first = recorded(&records[0], &database);
    for received in &received {
        assert!(received.frames > 5 && received.hashes.is_subset(&first), "a frame that no record knows");
    }

    let (mut second, _) =
        Server::start_with(&database, &["--state", &state, "--record", &records[1], "--listen", &address]);
    runtime.block_on(async {
        let client = Client::connect(&address).await.unwrap();
        let kept = client.exercise("flown").await.unwrap();
        assert_eq!(kept.sight_lines.len() as u64, LINES);
        let terrain = client.terrain().await.unwrap();
        let mut resumed = Received::default();
        for n in 0..CLIENTS {
            let mut view = client.open_view("flown", settings(40 + 60 * n as u32), pose(&terrain, n)).await.unwrap();
            let opened = async {
                loop {
                    match view.next().await.unwrap().unwrap() {
                        Event::Frame(frame) => return frame,
                        Event::Exercise(epoch) => assert_eq!(epoch, kept.epoch),
                        event => panic!("{event:?}"),
                    }
                }
            };
            let frame = timeout(PATIENCE, opened).await.expect("a first frame");
            assert_eq!((frame.base_sequence, frame.epoch), (0, kept.epoch));
            resumed.take(&view);
            assert!(fly(&mut view, &mut resumed, 10, 10, &count).await.is_none());
        }
        second.0.kill().unwrap();
        second.0.wait().unwrap();
        assert!(resumed.hashes.is_subset(&recorded(&records[1], &database)));
    });
}
