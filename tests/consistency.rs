//! The consistency test, the demonstration and the headless scene generator as a user runs them: as processes.
//!
//! An honest server has no findings; each sabotage of one client is counted, exactly as often as it betrays a line.

use std::{
    fmt::Write as _,
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::{Arc, OnceLock},
};

use serde_json::Value;
use sightline::{
    database::{Database, OpenOptions},
    service,
    terrain::synthetic::fractal_height,
};

fn sightline(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sightline")).args(args).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Rough ground of 97 x 97 posts, 30 m apart, with a hole in it; ingested once for all tests of this file.
fn database() -> &'static Path {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("sightline-consistency-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (grid, database) = (folder.join("rough.asc"), folder.join("rough.sightline"));
        let mut asc = String::from("ncols 97\nnrows 97\nxllcorner 0\nyllcorner 0\ncellsize 30\nNODATA_value -9999\n");
        for j in (0..97).rev() {
            for i in 0..97 {
                let hole = (40..46).contains(&i) && (40..46).contains(&j);
                write!(asc, "{} ", if hole { -9999 } else { fractal_height(i, j, 7, 300) }).unwrap();
            }
            asc.push('\n');
        }
        std::fs::write(&grid, asc).unwrap();
        let path = |p: &Path| p.to_str().unwrap().to_owned();
        let done = sightline(&["ingest", &path(&grid), "-o", &path(&database), "--unit", "1", "--force"]);
        assert!(done.status.success(), "{}", text(&done.stderr));
        database
    })
}

/// Runs a small test; gives its exit status and document.
fn consistency(more: &[&str]) -> (i32, Value) {
    let database = database().to_str().unwrap();
    let base = ["--json", "--quiet", "consistency", database, "--clients", "2", "--budgets", "300..2000"];
    let done = sightline(&[&base[..], more].concat());
    let document = serde_json::from_slice(&done.stdout)
        .unwrap_or_else(|e| panic!("{e}: {} {}", text(&done.stdout), text(&done.stderr)));
    (done.status.code().unwrap(), document)
}

#[test]
fn independent_clients_agree_with_the_terrain_and_plain_meshes_do_not() {
    let (status, found) = consistency(&["--sight-lines", "20", "--frames", "12", "--seed", "3"]);
    assert_eq!(status, 0, "{found:#}");
    let all = &found["all"];
    assert_eq!(found["findings"], 0);
    assert!(all["frames"].as_u64().unwrap() >= 24, "{all:#}");
    let count = |name: &str| all[name].as_u64().unwrap();
    assert_eq!(count("comparisons") + count("unknown"), 20 * count("frames"), "{all:#}");
    let share = |name: &str| found[name].as_f64().unwrap();
    assert!((20.0..=50.0).contains(&share("visible_percent")), "{found:#}");
    assert!(share("plain_wrong_percent") >= 10.0, "{found:#}");
    assert!(found["checks"]["naive"].as_u64().unwrap() >= 1, "{found:#}");
}

#[test]
fn other_fidelities_have_no_findings_either() {
    for fidelity in ["wedgie", "profile", "obstruction:100"] {
        let (status, found) =
            consistency(&["--sight-lines", "8", "--frames", "4", "--fidelity", fidelity, "--seed", "5"]);
        assert_eq!((status, &found["findings"]), (0, &Value::from(0)), "{fidelity}: {found:#}");
    }
}

#[test]
fn servers_agree_while_budgets_change_views_jump_and_lines_come_and_go() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.png");
    let (lines, frames) = (24, 20);
    let (status, found) = consistency(&[
        "--servers",
        "2",
        "--changes",
        "budgets,jumps,lines",
        "--sight-lines",
        &lines.to_string(),
        "--frames",
        &frames.to_string(),
        "--seed",
        "4",
        "--map",
        map.to_str().unwrap(),
    ]);
    assert_eq!((status, &found["findings"]), (0, &Value::from(0)), "{found:#}");
    let (all, between) = (&found["all"], &found["between_servers"]);
    let count = |value: &Value, name: &str| value[name].as_u64().unwrap();
    // A quarter of the lines is there half of the time.
    let asked = count(all, "comparisons") + count(all, "unknown");
    assert!(asked < lines * count(all, "frames") && asked >= lines * 3 / 4 * count(all, "frames"), "{all:#}");
    assert!(count(between, "comparisons") > 100 && count(between, "disagreements") == 0, "{between:#}");
    // Budgets of 2,000 and 300 have been doubled, halved and quartered; no frame was above its own.
    assert_eq!(count(all, "over_budget"), 0);
    let most = |n: usize| count(&found["clients"][n]["found"], "most_triangles");
    assert!(most(0) > 300 || most(1) > 2_000, "{found:#}");
    assert!(std::fs::read(&map).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn each_sabotage_is_counted_as_often_as_it_betrays_a_line() {
    // A verdict turns from one epoch to the next only now and then: with 100 lines it does within 40 frames.
    for (sabotage, lines, frames, mismatches) in
        [("height", "30", "8", 0), ("split", "30", "8", 0), ("epoch", "100", "40", 1)]
    {
        let (status, found) =
            consistency(&["--sight-lines", lines, "--frames", frames, "--seed", "3", "--sabotage", sabotage]);
        let (all, victim) = (&found["all"], &found["clients"][1]["found"]);
        let betrayed = found["checks"]["sabotaged_verdicts"].as_u64().unwrap();
        assert!(betrayed >= 1, "{sabotage}: {found:#}");
        assert_eq!(status, 1, "{sabotage}: {found:#}");
        assert_eq!(victim["silent_disagreements"].as_u64(), Some(betrayed), "{sabotage}: {found:#}");
        assert_eq!(all["silent_disagreements"].as_u64(), Some(betrayed), "{sabotage}: the honest client is accused");
        assert_eq!(all["exercise_mismatches"].as_u64(), Some(mismatches), "{sabotage}: {found:#}");
        assert_eq!(all["hash_mismatches"], 0, "{sabotage}: the hash was falsified with the mesh");
    }
}

#[test]
fn what_cannot_be_tested_is_said_by_exit_status() {
    let database = database().to_str().unwrap();
    let status = |args: &[&str]| {
        let done = sightline(args);
        (done.status.code().unwrap(), text(&done.stderr))
    };
    let nowhere = "http://127.0.0.1:1";
    assert_eq!(status(&["consistency", nowhere]).0, 2);
    assert_eq!(status(&["consistency", database, database]).0, 2);
    assert_eq!(status(&["consistency", database, "--budgets", "5..1"]).0, 2);
    assert_eq!(status(&["consistency", database, "--clients", "0"]).0, 2);
    assert_eq!(status(&["consistency", "no-such-file"]).0, 3);
    let (code, said) = status(&["consistency", database, nowhere, "--sight-lines", "2", "--frames", "1"]);
    assert_eq!(code, 4, "{said}");
    assert!(said.contains("127.0.0.1:1"), "{said}");
}

#[test]
fn a_scene_generator_draws_records_and_checks_itself() {
    let folder = tempfile::tempdir().unwrap();
    let terrain = Arc::new(Database::open(database(), OpenOptions::default()).unwrap());
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let server = runtime.spawn(service::serve(listener, terrain, std::future::pending()));
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (pictures, record) = (path("pictures"), path("session"));
    let done = sightline(&[
        "--json",
        "view",
        &address,
        "-o",
        &pictures,
        "--frames",
        "6",
        "--every",
        "4",
        "--triangles",
        "900",
        "--viewport",
        "160x90",
        "--flight",
        "orbit",
        "--record",
        &record,
    ]);
    assert!(done.status.success(), "{}", text(&done.stderr));
    let told: Value = serde_json::from_slice(&done.stdout).unwrap();
    let flown = &told["flown"];
    assert_eq!((&flown["poses"], &flown["refused"]), (&Value::from(6), &Value::from(0)), "{told:#}");
    assert!(flown["most_triangles"].as_u64().unwrap() <= 900);
    // Poses 0 and 4, and the last: from the viewpoint and from above.
    let drawn: Vec<_> =
        flown["pictures"].as_array().unwrap().iter().map(|p| std::fs::read(p.as_str().unwrap()).unwrap()).collect();
    assert_eq!(drawn.len(), 6);
    assert!(drawn.iter().all(|png| png.starts_with(b"\x89PNG")));
    // What was recorded is checked against the terrain.
    let checked = sightline(&["--json", "replay", &record, "--db", database().to_str().unwrap()]);
    assert!(checked.status.success(), "{}", text(&checked.stderr));
    let checked: Value = serde_json::from_slice(&checked.stdout).unwrap();
    let replayed = &checked["replayed"];
    assert_eq!(flown["frames"], replayed["frames"]);
    assert_eq!(flown["last_hash"].as_str(), Some(&*format!("{:016x}", replayed["last_hash"].as_u64().unwrap())));
    let mut bytes = std::fs::read(&record).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path("damaged"), bytes).unwrap();
    let damaged = sightline(&["replay", &path("damaged"), "--db", database().to_str().unwrap()]);
    assert!(damaged.status.code() == Some(3) && text(&damaged.stderr).contains("checksum"));
    // Sliding is drawing only: other pictures, with the triangles of posts that leave, of the same meshes.
    let flown = |name: &str, more: &[&str]| {
        let (pictures, usual) = (path(name), ["--frames", "6", "--every", "4", "--viewport", "160x90"]);
        let done = sightline(&[&["--json", "view", &address, "-o", &pictures], &usual[..], more].concat());
        assert!(done.status.success(), "{more:?}: {}", text(&done.stderr));
        let told: Value = serde_json::from_slice(&done.stdout).unwrap();
        (told["flown"].clone(), std::fs::read(folder.path().join(name).join("view-0004-view.png")).unwrap())
    };
    let turn = ["--flight", "turn", "--triangles", "900"];
    let ((jumps, jumping), (slides, sliding)) =
        (flown("jumps", &turn), flown("slides", &[&turn[..], &["--morph", "1"]].concat()));
    assert_eq!((&jumps["last_hash"], &jumps["most_triangles"]), (&slides["last_hash"], &slides["most_triangles"]));
    assert!(slides["most_triangles_drawn"].as_u64() > slides["most_triangles"].as_u64(), "{slides:#}");
    assert!(jumps["most_triangles_drawn"].is_null() && jumping != sliding);
    let (asked, parallel) = flown(
        "asked",
        &["--orthographic", "700", "--frame-time", "50", "--region", "900,900,300,8", "--flight", "turn"],
    );
    assert!(asked["last_triangles"].as_u64() > Some(2) && parallel != jumping);
    let (sharp, _) = flown("sharp", &["--pixels", "2", "--flight", "turn", "--triangles", "50000"]);
    assert!(sharp["most_triangles"].as_u64() < Some(50_000), "{sharp:#}");
    let weak = sightline(&["view", &address, "-o", &pictures, "--region", "900,900,300,0.5"]);
    assert_eq!(weak.status.code(), Some(3), "{}", text(&weak.stderr));
    let refused = sightline(&["view", &address, "-o", &pictures, "--record", &record]);
    assert_eq!(refused.status.code(), Some(4), "an existing recording is not replaced");
    let absurd = sightline(&["view", &address, "-o", &pictures, "--flight", "sideways"]);
    assert_eq!(absurd.status.code(), Some(3), "{}", text(&absurd.stderr));
    let there = [database().to_str().unwrap(), &address, "--clients", "1", "--sight-lines", "3", "--frames", "2"];
    let tested = sightline(&[&["consistency"], &there[..]].concat());
    assert!(tested.status.success(), "{}", text(&tested.stderr));
    server.abort();
}

#[test]
fn the_demonstration_takes_another_port_aloud_and_its_pictures_differ() {
    let folder = tempfile::tempdir().unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = folder.path().to_str().unwrap();
    let done = sightline(&["demo", "--exit", "--listen", &address, "-o", output, "--frames", "5"]);
    let (said, told) = (text(&done.stderr), text(&done.stdout));
    assert!(done.status.success(), "{said}{told}");
    assert!(said.contains(&format!("{address} is taken")), "{said}");
    assert!(told.contains("silent disagreements: 0 with sight lines"), "{told}");
    let mut pictures = Vec::new();
    for line in told.lines().filter(|line| line.starts_with("  ") && line.ends_with(".png")) {
        pictures.extend(line.split(',').map(|name| std::fs::read(folder.path().join(name.trim())).unwrap()));
    }
    assert_eq!(pictures.len(), 7, "{told}");
    for (n, picture) in pictures.iter().enumerate() {
        assert!(picture.starts_with(b"\x89PNG"));
        assert!(!pictures[..n].contains(picture), "picture {n} is drawn twice");
    }
}
