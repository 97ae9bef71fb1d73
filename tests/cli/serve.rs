//! `sightline serve` as an operator meets it: its address, a taken port, signals.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

use sightline_client::{Client, v1};

use super::{program, sightline};

/// A database of a small grid in `folder`.
pub(super) fn database(folder: &Path) -> String {
    let (input, database) = (folder.join("ramp.asc"), folder.join("ramp.sldb"));
    let rows: String = (0..5).map(|row| format!("{row} 1 2 3 4 5\n")).collect();
    fs::write(&input, format!("ncols 6\nnrows 5\nxllcorner 0\nyllcorner 0\ncellsize 10\n{rows}")).unwrap();
    let done = sightline(&["ingest", input.to_str().unwrap(), "-o", database.to_str().unwrap(), "--quiet"]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    database.to_str().unwrap().to_owned()
}

/// A server that is killed when a test fails.
pub(super) struct Server(pub(super) Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Server {
    /// Starts it on a free port; returns its address too.
    pub(super) fn start(database: &str) -> (Self, String) {
        Self::start_with(database, &[])
    }

    pub(super) fn start_with(database: &str, flags: &[&str]) -> (Self, String) {
        let child = program()
            .args(["serve", database, "--json"])
            .args(if flags.contains(&"--listen") { &[][..] } else { &["--listen", "127.0.0.1:0"] })
            .args(flags)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let mut server = Self(child.unwrap());
        let mut line = String::new();
        BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let line: serde_json::Value = serde_json::from_str(&line).unwrap();
        let address = line["address"].as_str().unwrap().to_owned();
        (server, address)
    }
}

#[test]
fn it_says_where_it_listens_and_a_taken_port_is_the_environments_fault() {
    let folder = tempfile::tempdir().unwrap();
    let database = database(folder.path());
    let (_server, address) = Server::start(&database);
    let second = sightline(&["serve", &database, "--listen", &address]);
    assert_eq!(second.status.code(), Some(4));
    let words = String::from_utf8_lossy(&second.stderr);
    assert!(words.contains(&address) && words.contains("taken"), "{words}");
}

#[test]
fn what_cannot_be_served_has_a_status_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let database = database(folder.path());
    let nothing = folder.path().join("nothing.sldb");
    assert_eq!(sightline(&["serve", nothing.to_str().unwrap()]).status.code(), Some(3));
    let damaged = folder.path().join("damaged.sldb");
    let bytes = fs::read(&database).unwrap();
    fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(sightline(&["serve", damaged.to_str().unwrap()]).status.code(), Some(3));
    for address in ["nonsense", "127.0.0.1:99999"] {
        assert_eq!(sightline(&["serve", &database, "--listen", address]).status.code(), Some(2), "{address}");
    }
}

#[cfg(unix)]
#[test]
fn signals_stop_it_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let database = database(folder.path());
    for signal in ["-TERM", "-INT"] {
        let (mut server, _) = Server::start(&database);
        let told = Command::new("/bin/sh").args(["-c", &format!("kill {signal} {}", server.0.id())]).status().unwrap();
        assert!(told.success());
        assert_eq!(server.0.wait().unwrap().code(), Some(0), "{signal}");
    }
}

#[test]
fn settings_come_from_flags_then_the_environment_then_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sightline.toml");
    fs::write(&file, "listen = \"127.0.0.1:1\"\n[limits]\nviews = 7\ntriangles = 900\n").unwrap();
    let print = |flags: &[&str]| {
        let mut command = program();
        command.args(["serve", "--print-config", "--config"]).arg(&file).args(flags);
        command.env("SIGHTLINE__LIMITS__VIEWS", "8").env("SIGHTLINE__LISTEN", "127.0.0.1:2").output().unwrap()
    };
    for (flags, listen) in [(&[][..], "127.0.0.1:2"), (&["--listen", "127.0.0.1:3"], "127.0.0.1:3")] {
        let output = print(flags);
        let text = String::from_utf8(output.stdout).unwrap();
        for line in [&format!("listen = \"{listen}\""), "views = 8", "triangles = 900", "batch_lines = 250000"] {
            assert!(text.lines().any(|found| found == line), "{line} in {text}");
        }
    }
    let ahead = String::from_utf8(print(&["--read-ahead", "0.5"]).stdout).unwrap();
    assert!(ahead.lines().any(|line| line == "read_ahead_s = 0.5"), "{ahead}");
    for seconds in ["11", "nan"] {
        let output = print(&["--read-ahead", seconds]);
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && words.contains("must be from 0 to 10"), "{words}");
    }
    fs::write(&file, "[limits]\nveiws = 7\n").unwrap();
    let output = print(&[]);
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stderr).contains("veiws"));
}

#[test]
fn status_tells_the_essentials() {
    let folder = tempfile::tempdir().unwrap();
    let (_server, address) = Server::start(&database(folder.path()));
    let output = sightline(&["status", &address, "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let status: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&status["serving"], &status["limits"]["views"]["limit"]), (&true.into(), &1_000.into()));
    assert_eq!(sightline(&["status", "127.0.0.1:1"]).status.code(), Some(4));
}

/// However far a change has come when the server is killed: what was answered is there again, whole.
#[test]
fn a_server_that_is_killed_comes_back_with_its_exercises() {
    let folder = tempfile::tempdir().unwrap();
    let database = database(folder.path());
    let state = folder.path().join("state");
    let state = state.to_str().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (mut epoch, mut seen) = (0, 0);
    for round in 0..4_u64 {
        let (mut server, address) = Server::start_with(&database, &["--state", state]);
        runtime.block_on(async {
            let client = Client::connect(&address).await.unwrap();
            if round == 0 {
                client.create_exercise("kept").await.unwrap();
            }
            let found = client.exercise("kept").await.unwrap();
            // The change that was under way may have been kept, too.
            assert!(found.epoch == epoch || found.epoch == epoch + 1, "{} after {epoch}", found.epoch);
            let heights: Vec<f64> = found.entities.iter().map(|entity| entity.position.unwrap().z).collect();
            assert!(
                heights.iter().all(|&z| z == found.epoch as f64)
                    && heights.len() == if found.epoch == 0 { 0 } else { 50 }
            );
            assert!(found.sight_lines.iter().all(|line| line.verdict() == v1::Verdict::Visible));
            seen += found.sight_lines.len();
            epoch = found.epoch;
            for _ in 0..6 {
                epoch = client.change_exercise(raised(epoch + 1)).await.unwrap();
            }
            let next = tokio::spawn(async move { client.change_exercise(raised(epoch + 1)).await });
            tokio::time::sleep(std::time::Duration::from_millis(round)).await;
            server.0.kill().unwrap();
            server.0.wait().unwrap();
            if let Ok(answered) = next.await.unwrap() {
                epoch = answered;
            }
        });
    }
    assert_eq!(seen, 3 * 49);
    let (_server, address) = Server::start_with(&database, &["--state", state]);
    let second = sightline(&["serve", &database, "--listen", "127.0.0.1:0", "--state", state]);
    assert_eq!(second.status.code(), Some(3), "{address}");
    assert!(String::from_utf8_lossy(&second.stderr).contains("another server has it open"));
}

/// Fifty entities in a row, all at one height, and lines between neighbours.
fn raised(height: u64) -> v1::ChangeExerciseRequest {
    let entity = |id: u64| v1::Entity {
        id,
        position: Some(v1::Position { x: id as f64 * 0.1, y: 2.0, z: height as f64 }),
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        ground_m: 0.0,
    };
    let end = |entity_id| {
        let anchor = v1::anchor::Anchor::Entity(v1::EntityAnchor { entity_id, height_offset_m: 0.0 });
        Some(v1::Anchor { anchor: Some(anchor) })
    };
    let line = |id: u64| v1::SightLine { id, a: end(id), b: end(id + 1), ..v1::SightLine::default() };
    v1::ChangeExerciseRequest {
        name: "kept".into(),
        put_entities: (0..50).map(entity).collect(),
        put_sight_lines: (0..49).map(line).collect(),
        ..v1::ChangeExerciseRequest::default()
    }
}
