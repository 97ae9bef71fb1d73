//! `sightline load`: what is due is all there, and what goes wrong is an error and no frame.

use std::{process::Stdio, time::Duration};

use sightline_client::Client;

use super::{program, replay::golden, serve::Server, sightline, status, text};

#[test]
fn every_pose_and_question_has_its_latency_and_nothing_is_left_behind() {
    let (_server, address) = Server::start(&golden("terrain-20x13-v1.sldb"));
    let flags =
        ["--views", "3", "--triangles", "60", "--rate", "20", "--seconds", "1", "--los", "15", "--sight-lines", "4"];
    let output = sightline(&[&["load", &address, "--json", "--quiet"], &flags[..]].concat());
    assert_eq!(status(&output), 0, "{}", text(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = |what: &str| found[what].as_u64().unwrap();
    assert_eq!((count("poses"), count("queries"), count("errors")), (60, 15, 0), "{found}");
    assert_eq!(found["frame_latency_ms"]["count"], 60);
    assert_eq!(found["query_latency_ms"]["count"], 15);
    // A pose without a frame of its own was overtaken; changes of the exercise bring further frames.
    assert!(count("frames") + count("overtaken_poses") >= 60 && count("changes") >= 1, "{found}");
    assert!(count("comparisons") >= 60 && count("silent_disagreements") == 0, "{found}");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let left = runtime.block_on(async { Client::connect(&address).await.unwrap().list_exercises().await.unwrap() });
    assert!(left.is_empty(), "{left:?}");
    assert_eq!(status(&sightline(&["load", "127.0.0.1:1", "--seconds", "1"])), 4);
    assert_eq!(status(&sightline(&["load", &address, "--rate", "0"])), 2);
}

#[test]
fn a_server_that_is_killed_is_errors_and_no_frames() {
    let (mut server, address) = Server::start(&golden("terrain-20x13-v1.sldb"));
    let load = program()
        .args(["load", &address, "--json", "--quiet", "--views", "2", "--triangles", "60", "--seconds", "1.5"])
        .args(["--rate", "20", "--los", "50"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(900));
    server.0.kill().unwrap();
    let output = load.wait_with_output().unwrap();
    assert_eq!(status(&output), 1, "{}", text(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = |what: &str| found[what].as_u64().unwrap();
    // Each view's end, and each question that nobody answered.
    assert!(count("errors") >= 3 && count("poses") < 60 && count("queries") < 75, "{found}");
    assert!(found["frame_latency_ms"]["count"].as_u64().unwrap() <= count("poses"));
}
