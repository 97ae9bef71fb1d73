//! The recorded sessions of the conformance suite (`clients/README.md`), replayed by this client.
//!
//! It also proves that the recordings are current: each message encodes back to the very same bytes, so it holds nothing
//! that the protocol of today does not know, and so does each mesh payload against its base.

mod session;

use std::{fs, path::Path};

use prost::Message;
use serde_json::Value;
use sightline_client::{
    scene::{Event, SceneError, SceneState},
    v1::{self, stream_scene_response::Response},
};

fn sessions() -> Vec<(String, Vec<Value>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../conformance");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let read = |path: &Path| -> Vec<Value> {
        fs::read_to_string(path).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    paths.iter().map(|path| (path.display().to_string(), read(path))).collect()
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|n| u8::from_str_radix(&hex[n..n + 2], 16).unwrap()).collect()
}

/// The message of a line, which must encode to the same bytes again.
fn message(line: &Value) -> v1::StreamSceneResponse {
    let recorded = bytes(line["message"].as_str().unwrap());
    let message = v1::StreamSceneResponse::decode(&recorded[..]).unwrap();
    assert_eq!(message.encode_to_vec(), recorded, "the protocol has changed: record the sessions anew");
    message
}

/// The scene after the first two lines of a session.
fn opened(lines: &[Value]) -> SceneState {
    let header = &lines[0];
    let max_triangles = header["max_triangles"].as_u64().unwrap() as u32;
    let Some(Response::Opened(opened)) = message(&lines[1]).response else { panic!("not opened") };
    SceneState::new(&opened, max_triangles, header["lines_expected"].as_bool().unwrap()).unwrap()
}

#[test]
fn conformance_of_a_frame_left_out() {
    for (name, lines) in sessions() {
        let mut scene = opened(&lines);
        let left_out = 2 + lines[2..].iter().enumerate().filter(|(_, line)| line["held"].is_object()).nth(2).unwrap().0;
        let (mut lost, mut refused, mut recovered) = (false, 0, 0);
        for (n, line) in lines.iter().enumerate().skip(2) {
            let message = message(line);
            let is_delta = matches!(&message.response, Some(Response::Frame(frame)) if frame.base_sequence != 0);
            if n == left_out {
                lost = true;
            } else if lost && is_delta {
                let before = scene.replica().posts();
                assert!(
                    matches!(scene.apply(&message), Err(SceneError::Frame(_) | SceneError::Naming { .. })),
                    "{name}"
                );
                assert_eq!(scene.replica().posts(), before, "{name}");
                refused += 1;
            } else if scene.apply(&message).unwrap() == Event::Frame {
                assert_eq!(session::held(&scene), line["held"], "{name}");
                recovered += usize::from(std::mem::take(&mut lost));
            }
        }
        assert!(refused > 0 && recovered > 0, "{name}: {refused}, {recovered}");
    }
}

#[test]
fn conformance_of_recorded_sessions() {
    let sessions = sessions();
    assert!(sessions.len() >= 2);
    for (name, lines) in sessions {
        let mut scene = opened(&lines);
        let (mut snapshots, mut deltas, mut updates) = (0, 0, 0);
        for line in &lines[2..] {
            let (message, before) = (message(line), scene.replica().clone());
            match scene.apply(&message).unwrap() {
                Event::Exercise => updates += 1,
                Event::Frame => {
                    assert_eq!(session::held(&scene), line["held"], "{name}");
                    assert!(scene.silent_disagreements().is_empty(), "{name}");
                    let Some(Response::Frame(frame)) = message.response else { panic!("{name}") };
                    let base = (frame.base_sequence != 0).then_some(&before);
                    assert_eq!(session::hex(&scene.replica().encode(base)), session::hex(&frame.mesh), "{name}");
                    *if base.is_some() { &mut deltas } else { &mut snapshots } += 1;
                }
            }
        }
        assert!(snapshots >= 2 && deltas >= 10 && updates >= 3, "{name}: {snapshots}, {deltas}, {updates}");
    }
}
