//! The verb `fly` as a user meets it.

use std::fs;

use super::{mesh::database, sightline, status};

#[test]
fn a_flight_tells_what_each_frame_took_and_draws_it() {
    let folder = tempfile::tempdir().unwrap();
    let db = database(folder.path());
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (csv, svg) = (path("frames.csv"), path("flight.svg"));
    let fly = |more: &[&str]| sightline(&[&["fly", &db, "--frames", "12", "--triangles", "400"], more].concat());

    let done = fly(&["--flight", "orbit", "-o", &csv, "--plot", &svg, "--json"]);
    assert_eq!(status(&done), 0, "{}", String::from_utf8_lossy(&done.stderr));
    let document: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(document["frames"].as_array().unwrap().len(), 12);
    assert!(document["frames"][5]["triangles"].as_u64().unwrap() <= 400);
    assert_eq!(document["summary"]["ms"].as_array().unwrap().len(), 3);
    let text = fs::read_to_string(&csv).unwrap();
    assert_eq!(text.lines().count(), 13);
    assert!(fs::read_to_string(&svg).unwrap().starts_with("<svg"));
    assert_eq!(status(&fly(&["--plot", &svg])), 4, "what exists is kept");

    // Other ways to the same meshes tell the same triangles and bounds.
    let columns = |more: &[&str]| {
        let done = fly(&[&["--flight", "turn", "-o", "-"], more].concat());
        let text = String::from_utf8(done.stdout).unwrap();
        let column = |line: &str| line.split(',').skip(7).collect::<Vec<_>>().join(",");
        text.lines().map(column).collect::<Vec<_>>()
    };
    let ours = columns(&[]);
    assert_eq!(ours.len(), 13);
    assert_eq!(columns(&["--algorithm", "naive"]), ours);
    assert_eq!(columns(&["--algorithm", "scratch"]), ours);
    assert_ne!(columns(&["--algorithm", "geomipmap"]), ours);

    // Without an output, a line for each frame and the summary; asked for a distortion, it is kept.
    let text =
        |more: &[&str]| String::from_utf8(fly(&[&["--flight", "terrain-avoidance"], more].concat()).stdout).unwrap();
    assert_eq!(text(&[]).lines().count(), 1 + 12 + 6);
    assert_eq!(text(&["--quiet"]).lines().count(), 6);
    let sharp = sightline(&["fly", &db, "--frames", "12", "--flight", "orbit", "--pixels", "40", "-o", "-"]);
    let csv = String::from_utf8(sharp.stdout).unwrap();
    let bounds: Vec<f64> = csv.lines().skip(1).map(|l| l.rsplit(',').next().unwrap().parse().unwrap()).collect();
    assert!(bounds.iter().all(|&px| px > 0.0 && px <= 40.0), "{bounds:?}");
    assert_eq!(status(&fly(&["--pixels", "40", "--algorithm", "geomancy"])), 2);

    assert_eq!(status(&fly(&["--flight", "nowhere"])), 3);
    assert_eq!(status(&fly(&["--algorithm", "magic"])), 2);
    assert_eq!(status(&sightline(&["fly", &db, "--triangles", "1"])), 2);
}
