//! A recorded server and its replay, as an operator meets them.

use std::{fs, path::Path};

use sightline_client::{Client, Event, v1};

use super::{
    serve::{Server, database},
    sightline, status, text,
};

/// Opens a view and flies `poses` poses, a frame each; the hash of the last mesh.
async fn fly(address: &str, poses: u32) -> u64 {
    let pinhole = v1::Perspective { tan_half_fov: 0.6, near_m: 1.0 };
    let settings = v1::ViewSettings {
        projection: Some(v1::view_settings::Projection::Perspective(pinhole)),
        viewport_width_px: 640,
        viewport_height_px: 480,
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles: 30 })),
        ..Default::default()
    };
    let pose = |n: u32| v1::Pose {
        eye: Some(v1::Position { x: f64::from(n % 40), y: 20.0, z: 60.0 }),
        rotation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    };
    let client = Client::connect(address).await.unwrap();
    let mut view = client.open_view("", settings, pose(0)).await.unwrap();
    for n in 0..poses {
        let wanted = if n == 0 { 0 } else { view.steer(pose(n)).await.unwrap() };
        while !matches!(view.next().await.unwrap(), Some(Event::Frame(frame)) if frame.pose_sequence == wanted) {}
    }
    view.scene().replica().hash()
}

#[test]
fn a_killed_server_is_replayed_and_what_does_not_fit_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let database = database(folder.path());
    let record = folder.path().join("session.journal");
    let record = record.to_str().unwrap();
    let (mut server, address) = Server::start_with(&database, &["--record", record]);
    tokio::runtime::Runtime::new().unwrap().block_on(fly(&address, 10));
    server.0.kill().unwrap();
    server.0.wait().unwrap();

    let again = sightline(&["serve", &database, "--record", record]);
    assert_eq!(status(&again), 4, "a recording is never written over");
    // In a folder, each start makes one.
    let records = folder.path().join("records");
    fs::create_dir(&records).unwrap();
    for started in 1..=2 {
        let (mut server, address) = Server::start_with(&database, &["--record", records.to_str().unwrap()]);
        let told = sightline(&["status", &address, "--json"]);
        let told: serde_json::Value = serde_json::from_slice(&told.stdout).unwrap();
        assert!(told["recording"]["bytes"].as_u64() > Some(0) && told["recording"]["ended"].is_null(), "{told}");
        server.0.kill().unwrap();
        server.0.wait().unwrap();
        assert_eq!(fs::read_dir(&records).unwrap().count(), started);
    }
    let replay = |record: &str, database: &str| sightline(&["replay", record, "--db", database, "--json"]);
    let whole = replay(record, &database);
    assert_eq!(status(&whole), 0, "{}", text(&whole.stderr));
    let found: serde_json::Value = serde_json::from_slice(&whole.stdout).unwrap();
    assert_eq!((&found["identical"], &found["replayed"]["frames"]), (&true.into(), &10.into()));
    assert!(text(&whole.stderr).contains("killed"));

    let bytes = fs::read(record).unwrap();
    let part = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let cut = replay(&part("cut", &bytes[..bytes.len() - 5]), &database);
    assert_eq!(status(&cut), 0, "{}", text(&cut.stderr));
    assert!(text(&cut.stderr).contains("bytes into record"), "{}", text(&cut.stderr));
    let mut bad = bytes.clone();
    bad[bytes.len() / 2] ^= 1;
    for (record, database, words) in [
        (part("damaged", &bad), &database, "checksum"),
        (part("empty", &[]), &database, "empty"),
        (part("other", b"not a recording, whatever it may be"), &database, "magic"),
        (record.to_owned(), &golden("terrain-20x13-v1.sldb"), "recorded on terrain"),
        (folder.path().join("nothing").to_str().unwrap().to_owned(), &database, "No such file"),
    ] {
        let output = replay(&record, database);
        let said = text(&output.stderr);
        assert!(status(&output) == 3 && said.contains(words) && output.stdout.is_empty(), "'{words}' in {said}");
    }
}

pub(super) fn golden(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name).to_str().unwrap().to_owned()
}
