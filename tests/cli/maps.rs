//! The verbs `viewshed`, `matrix`, `profile` and `height` as a user meets them.

use std::{
    fs,
    path::{Path, PathBuf},
};

use sightline::dem;

use super::{los::ridge, sightline, status, text};

fn run(args: &[&str]) -> String {
    let output = sightline(args);
    assert_eq!(status(&output), 0, "{args:?}: {}", text(&output.stderr));
    text(&output.stdout).to_owned()
}

fn json(args: &[&str]) -> serde_json::Value {
    serde_json::from_str(&run(&[args, &["--json"]].concat())).unwrap()
}

fn name(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn place() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    (folder, database)
}

#[test]
fn a_viewshed_is_a_geotiff_in_the_right_place_and_a_picture() {
    let (folder, database) = place();
    let (tif, png) = (folder.path().join("seen.tif"), folder.path().join("seen.png"));
    let look = ["viewshed", name(&database), "--from", "120,220,2", "--altitude", "agl", "--radius", "42"];
    let summary = json(&[&look[..], &["-o", name(&tif)]].concat());
    // Columns 0 to 6 of rows 0 to 4 but two corners beyond the radius: seen up to the ridge, which hides what follows.
    let (cells, visible) = (summary["cells"].as_u64().unwrap(), summary["visible"].as_u64().unwrap());
    assert_eq!((cells, visible), (33, 25), "{summary}");
    let mut raster = dem::open(std::slice::from_ref(&tif), &dem::OpenOptions::default(), &mut |_| {}).unwrap();
    let info = raster.info();
    let place = info.georeference;
    assert_eq!((info.nx, info.ny, place.origin, place.step), (7, 5, [100.0, 200.0], [10.0, 10.0]));
    for j in 0..5 {
        let mut row = [0.0; 7];
        raster.read_row(j, &mut row).unwrap();
        for (i, value) in (0..7_u32).zip(row) {
            let expected = if i == 6 && j % 4 == 0 { None } else { Some(if i <= 4 { 1.0 } else { 0.0 }) };
            assert_eq!(Some(value).filter(|v| !v.is_nan()), expected, "post ({i}, {j})");
        }
    }
    let again = sightline(&[&look[..], &["-o", name(&tif)]].concat());
    assert_eq!(status(&again), 4, "an existing file is refused");
    assert!(text(&again.stderr).contains("--force"));
    run(&[&look[..], &["-o", name(&tif), "--force", "--quiet"]].concat());
    assert!(!folder.path().join("seen.tif.partial").exists());
    run(&[&look[..], &["-o", name(&png), "--target-height", "3"]].concat());
    assert_eq!(&fs::read(&png).unwrap()[..8], b"\x89PNG\r\n\x1a\n");
}

#[test]
fn a_viewshed_without_sense_is_refused_with_a_hint() {
    let (folder, database) = place();
    let out = folder.path().join("seen.tif");
    let look = |from: &str, radius: &str, to: &str| {
        let args = ["viewshed", name(&database), "--from", from, "--altitude", "agl", "--radius", radius, "-o", to];
        let output = sightline(&args);
        (status(&output), text(&output.stderr).to_owned())
    };
    for (from, radius, to, expected, hint) in [
        ("120,220,2", "-5", name(&out), 2, "above 0"),
        ("120,220,2", "50", "seen.jpg", 2, ".tif or .png"),
        ("180,240,2", "50", name(&out), 3, "absolute"),
        ("9999,9999,2", "50", name(&out), 3, "absolute"),
    ] {
        let (code, words) = look(from, radius, to);
        assert!(code == expected && words.contains(hint), "{from} {radius} {to}: {code} {words}");
        assert!(!out.exists());
    }
}

#[test]
fn a_profile_has_every_break_as_a_table_and_as_a_plot() {
    let (folder, database) = place();
    let ends = ["--from", "100,220,2", "--to", "180,220,2"];
    let file = |name: &str| folder.path().join(name);
    let to = |out: &Path| [&["profile", name(&database)][..], &ends, &["-o", name(out)]].concat().join(" ");
    let csv = run(&[&["profile", name(&database)][..], &ends, &["-o", "-"]].concat());
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0].join(","), "t,range_m,x,y,ground,line,clearance,state,ground_state");
    assert_eq!(rows.len(), 10, "a break at each of nine posts\n{csv}");
    assert_eq!(rows[5], ["0.5", "40", "140", "220", "4", "2", "-2", "BELOW", "SEEN"]);
    assert_eq!(rows[7][8], "HIDDEN");
    for (file, begin) in [(file("p.svg"), "<svg"), (file("p.png"), "\u{fffd}PNG"), (file("p.json"), "{")] {
        let args = to(&file);
        run(&args.split(' ').collect::<Vec<_>>());
        let bytes = fs::read(&file).unwrap();
        assert!(String::from_utf8_lossy(&bytes).starts_with(begin), "{file:?}");
    }
    let document: serde_json::Value = serde_json::from_slice(&fs::read(file("p.json")).unwrap()).unwrap();
    assert_eq!((&document["verdict"], &document["obstructed_at"]), (&"BLOCKED".into(), &(35.0 / 80.0).into()));
    assert_eq!(document["breaks"].as_array().unwrap().len(), 9);
    let svg = fs::read_to_string(file("p.svg")).unwrap();
    assert!(svg.contains("obstructed at 35 m") && svg.contains("range (m)") && svg.ends_with("</svg>\n"));
    let both = sightline(&[&["profile", name(&database)][..], &ends, &["-o", "-", "--json"]].concat());
    assert_eq!(status(&both), 2);
}

/// 80 m long and half a unit above the ridge: a sphere of 1000 m lowers the line there by 0.8 m.
#[test]
fn a_profile_over_a_curved_earth_has_the_line_lowered_by_its_bulge() {
    let (folder, database) = place();
    let ends = ["--from", "100,220,4.5", "--to", "180,220,4.5"];
    let profile =
        |more: &[&str], out: &str| run(&[&["profile", name(&database)][..], &ends, more, &["-o", out]].concat());
    let middle = |more: &[&str]| {
        let csv = profile(more, "-");
        csv.lines().nth(5).unwrap().split(',').map(str::to_owned).collect::<Vec<_>>()
    };
    let sphere = ["--earth", "sphere", "--earth-radius", "1000"];
    assert_eq!(middle(&[])[4..8], ["4", "4.5", "0.5", "ABOVE"]);
    let found = middle(&sphere);
    assert_eq!((found[4].as_str(), found[7].as_str()), ("4", "BELOW"));
    let [line, clearance] = [5, 6].map(|column: usize| found[column].parse::<f64>().unwrap());
    assert!((line - 3.7).abs() < 1e-12 && (clearance + 0.3).abs() < 1e-12, "{found:?}");
    assert_eq!(middle(&[&sphere[..], &["--refraction", "2"]].concat())[7], "ABOVE");
    let file = folder.path().join("curved.json");
    profile(&sphere, name(&file));
    let document: serde_json::Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    assert_eq!(document["verdict"], "BLOCKED");
    let states: Vec<_> = document["line"].as_array().unwrap().iter().map(|s| s["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["ABOVE", "BELOW", "ABOVE"]);
    let refused = ["profile", name(&database), "--earth", "sphere", "--earth-radius", "0", "-o", "-"];
    assert_eq!(status(&sightline(&[&refused[..], &ends].concat())), 2);
}

#[test]
fn heights_are_told_for_one_point_and_for_a_file() {
    let (folder, database) = place();
    let at = |at: &str| json(&["height", name(&database), "--at", at]);
    assert_eq!(at("135,220")["ground_m"], 2.0);
    assert_eq!((&at("135,220,5")["above_ground_m"], &at("135,220")["above_ground_m"]), (&3.0.into(), &().into()));
    assert_eq!(at("180,240")["known"], false);
    let normal = at("133,217")["normal"].clone();
    let [east, north, up] = [0, 1, 2].map(|k: usize| normal[k].as_f64().unwrap());
    assert!((east + 0.4 / 1.16_f64.sqrt()).abs() < 1e-12 && north == 0.0 && up > 0.9, "{normal}");
    let points = folder.path().join("points.csv");
    fs::write(&points, "id,x,y,z\na,135,220,5\nb,180,240,0\n").unwrap();
    let csv = run(&["height", name(&database), "--batch", name(&points)]);
    let lines: Vec<_> = csv.lines().collect();
    assert_eq!(lines[0], "id,x,y,z,ground_m,normal_east,normal_north,normal_up,above_ground_m");
    assert!(lines[1].starts_with("a,135,220,5,2,") && lines[1].ends_with(",3"), "{csv}");
    assert_eq!(lines[2], "b,180,240,0,,,,,");
}

#[test]
fn a_matrix_tells_which_points_see_which() {
    let (folder, database) = place();
    let points = folder.path().join("points.csv");
    fs::write(&points, "name,x,y,z\nwest,110,220,2\ntop,140,220,1\n\"east, low\",170,220,2\nvoid,180,240,1\n").unwrap();
    let ask = ["matrix", name(&database), "--points", name(&points), "--altitude", "agl"];
    let csv = run(&[&ask[..], &["--quiet"]].concat());
    let expected = "name,west,top,\"east, low\",void\n\
        west,VISIBLE,VISIBLE,BLOCKED,UNKNOWN\n\
        top,VISIBLE,VISIBLE,VISIBLE,UNKNOWN\n\
        \"east, low\",BLOCKED,VISIBLE,VISIBLE,UNKNOWN\n\
        void,UNKNOWN,UNKNOWN,UNKNOWN,UNKNOWN\n";
    assert_eq!(csv, expected);
    let out = folder.path().join("sees.json");
    let summary = json(&[&ask[..], &["-o", name(&out)]].concat())["summary"].clone();
    assert_eq!((&summary["pairs"], &summary["visible"], &summary["blocked"]), (&6.into(), &2.into(), &1.into()));
    let document: serde_json::Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    assert_eq!(document["verdicts"][2][0], "BLOCKED");
    let many: String = (0..4097).map(|n| format!("{n},0,0\n")).collect();
    fs::write(&points, format!("x,y,z\n{many}")).unwrap();
    let refused = sightline(&ask);
    assert_eq!(status(&refused), 3);
    assert!(text(&refused.stderr).contains("at most 4096"), "{}", text(&refused.stderr));
}
