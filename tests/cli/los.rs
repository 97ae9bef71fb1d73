//! The verb `los` as a user meets it: words, exit statuses, JSON, files of lines.

use std::{
    fs,
    path::{Path, PathBuf},
};

use super::{sightline, status, text};

/// A database of 9 x 5 posts, 10 m apart from (100, 200): flat but for a ridge 4 m high along x = 140, with a void post
/// in the north-east corner.
pub(super) fn ridge(folder: &Path) -> PathBuf {
    let mut grid = "ncols 9\nnrows 5\nxllcenter 100\nyllcenter 200\ncellsize 10\nNODATA_value -9999\n".to_owned();
    for row in 0..5 {
        for column in 0..9 {
            grid += match (row, column) {
                (0, 8) => "-9999 ",
                (_, 4) => "4 ",
                _ => "0 ",
            };
        }
        grid += "\n";
    }
    let (input, database) = (folder.join("ridge.asc"), folder.join("ridge.db"));
    fs::write(&input, grid).unwrap();
    let path = |p: &'static str| folder.join(p).to_str().unwrap().to_owned();
    let done = sightline(&["ingest", &path("ridge.asc"), "-o", &path("ridge.db"), "--unit", "1", "--quiet"]);
    assert_eq!(status(&done), 0, "{}", text(&done.stderr));
    database
}

fn ask(database: &Path, more: &[&str]) -> serde_json::Value {
    let mut args = vec!["los", database.to_str().unwrap(), "--json"];
    args.extend(more);
    let output = sightline(&args);
    assert_eq!(status(&output), 0, "{more:?}: {}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn one_line_is_answered_in_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    let blocked = ask(&database, &["--from", "100,220,2", "--to", "180,220,2"]);
    assert_eq!(blocked["verdict"], "BLOCKED");
    assert_eq!(blocked["range_m"], 80.0);
    assert_eq!(blocked["first_from_a"]["position"], serde_json::json!([3.5, 2.0, 2.0]));
    assert_eq!(blocked["first_from_b"]["range_m"], 35.0);
    let in_posts = ask(&database, &["--from", "0,2,2", "--to", "8,2,2", "--coords", "grid"]);
    assert_eq!(in_posts["resolved"], blocked["resolved"]);
    let touching = ["--from", "100,220,4", "--to", "180,220,4"];
    let grazing = ask(&database, &touching);
    assert_eq!((&grazing["verdict"], &grazing["grazes"]), (&"VISIBLE".into(), &true.into()));
    assert_eq!(grazing["least_clearance"], 0.0);
    assert_eq!(ask(&database, &[&touching[..], &["--strict"]].concat())["verdict"], "BLOCKED");
    let above = ask(&database, &["--from", "135,220,1.5", "--to", "135,210,1.5", "--altitude", "agl"]);
    assert_eq!(above["resolved"]["a"], serde_json::json!([3.5, 2.0, 3.5]));
}

#[test]
fn what_takes_longer_comes_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    let low = ["--from", "100,220,2", "--to", "180,220,2"];
    assert!(ask(&database, &low)["derived"].is_null());
    let derived = &ask(&database, &[&low[..], &["--derive"]].concat())["derived"];
    // A ridge of height 4 in the middle, and 2 units above ground: half-way behind it the line must be at 6.
    assert_eq!(derived["least_target_height"], 6.0);
    assert_eq!(derived["deepest"]["clearance"], -2.0);
    assert_eq!(derived["triangle_from_a"], serde_json::json!([[3, 1], [4, 2], [3, 2]]));
    let line: Vec<_> = derived["line"].as_array().unwrap().iter().map(|s| s["state"].as_str().unwrap()).collect();
    assert_eq!(line, ["ABOVE", "BELOW", "ABOVE"]);
    let ground: Vec<_> = derived["ground"].as_array().unwrap().iter().map(|s| s["state"].as_str().unwrap()).collect();
    assert_eq!(ground, ["SEEN", "HIDDEN"]);
}

#[test]
fn a_curved_earth_lowers_lines() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    // 80 m long, half a unit above the ridge: a sphere of 1000 m bulges by 0.8 m.
    let high = ["--from", "100,220,4.5", "--to", "180,220,4.5"];
    let by = |more: &[&str]| ask(&database, &[&high[..], more].concat())["verdict"].clone();
    assert_eq!(by(&["--earth", "flat", "--earth-radius", "1000"]), "VISIBLE");
    assert_eq!(by(&["--earth", "sphere"]), "VISIBLE");
    assert_eq!(by(&["--earth", "sphere", "--earth-radius", "1000"]), "BLOCKED");
    assert_eq!(by(&["--earth", "sphere", "--earth-radius", "1000", "--refraction", "2"]), "VISIBLE");
    let target = database.to_str().unwrap();
    let refused = sightline(&[&["los", target, "--earth", "sphere", "--earth-radius", "-1"], &high[..]].concat());
    assert_eq!(status(&refused), 2, "{}", text(&refused.stderr));
}

#[test]
fn precisions_are_obeyed_and_say_what_they_are_worth() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    // Half a unit below the ridge.
    let low = ["--from", "100,220,3.5", "--to", "180,220,3.5"];
    let by = |precision| ask(&database, &[&low[..], &["--precision", precision]].concat());
    assert_eq!(by("exact"), ask(&database, &low));
    assert_eq!((&by("exact")["verdict"], &by("exact")["certain"]), (&"BLOCKED".into(), &true.into()));
    for precision in ["f64", "fast", "tolerance:0"] {
        assert_eq!(by(precision)["verdict"], "BLOCKED", "{precision}");
        assert_eq!(by(precision)["certain"], precision == "tolerance:0", "{precision}");
    }
    for bad in ["tolerance:-1", "tolerance:NaN", "tolerance", "exakt"] {
        let target = database.to_str().unwrap();
        let output = sightline(&[&["los", target, "--precision", bad], &low[..]].concat());
        assert_eq!(status(&output), 2, "{bad}");
        assert!(text(&output.stderr).contains("tolerance:H"), "{}", text(&output.stderr));
    }
}

#[test]
fn unknown_ground_is_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    let passing = ask(&database, &["--from", "180,230,9", "--to", "180,240,9"]);
    assert_eq!(passing["verdict"], "UNKNOWN");
    assert!(passing["resolved"].is_object());
    let standing = ask(&database, &["--from", "100,230,9", "--to", "180,240,9", "--altitude", "agl"]);
    assert_eq!(standing["verdict"], "UNKNOWN");
    assert!(standing["resolved"].is_null() && standing["reason"].as_str().unwrap().contains("no ground"));
}

#[test]
fn a_batch_keeps_its_rows_and_gets_answers() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    let (input, output) = (folder.path().join("lines.csv"), folder.path().join("answers.csv"));
    let rows = ["name,bx,by,bz,ax,ay,az", "\"over, high\",180,220,5,100,220,5", "low,180,220,2,100,220,2"];
    fs::write(&input, rows.join("\r\n")).unwrap();
    let [database, input, output] = [&database, &input, &output].map(|p| p.to_str().unwrap());
    let done = sightline(&["los", database, "--batch", input, "-o", output]);
    assert_eq!(status(&done), 0, "{}", text(&done.stderr));
    assert!(text(&done.stderr).contains("2 lines: 1 visible (0 grazing), 0 unknown, 1 blocked"));
    let answers = fs::read_to_string(output).unwrap();
    let answers: Vec<_> = answers.lines().collect();
    assert!(answers[0].starts_with("name,bx,by,bz,ax,ay,az,verdict,grazes,range_m,"));
    assert!(answers[1].starts_with("\"over, high\",180,220,5,100,220,5,VISIBLE,false,80,"), "{}", answers[1]);
    assert!(answers[2].starts_with("low,180,220,2,100,220,2,BLOCKED,false,80,"), "{}", answers[2]);
    let again = sightline(&["los", database, "--batch", input, "-o", output]);
    assert_eq!(status(&again), 4);
    assert!(text(&again.stderr).contains("--force"));
    let printed = sightline(&["los", database, "--batch", input, "--quiet"]);
    assert_eq!(text(&printed.stdout).lines().collect::<Vec<_>>(), answers);
}

#[test]
fn bad_input_says_what_and_where() {
    let folder = tempfile::tempdir().unwrap();
    let database = ridge(folder.path());
    let database = database.to_str().unwrap();
    let input = folder.path().join("lines.csv");
    let batch = |content: &str| {
        fs::write(&input, content).unwrap();
        let output = sightline(&["los", database, "--batch", input.to_str().unwrap()]);
        assert!(output.stdout.is_empty());
        (status(&output), text(&output.stderr).to_owned())
    };
    let header = "ax,ay,az,bx,by,bz\n";
    let cases = [
        ("", "it is empty"),
        (header, "no lines of sight"),
        ("ax,ay,az,bx,by\n1,2,3,4,5\n", "no column bz"),
        ("ax,ay,az,bx,by,bz,ax\n1,2,3,4,5,6,7\n", "column ax twice"),
        (&format!("{header}\n1,2,3,4,5,6\n1,2,3,4,5\n"), "line 4: 5 fields"),
        (&format!("{header}1,2,3,4,5,6\n1,2,nan,4,5,6\n"), "line 3: az is 'nan'"),
        (&format!("{header}1,2,3,4,5,inf\n"), "line 2: bz is 'inf'"),
        (&format!("{header}1,2,3,4,five,6\n"), "line 2: by is 'five'"),
    ];
    for (content, expected) in cases {
        let (status, message) = batch(content);
        assert_eq!(status, 3, "{message}");
        assert!(message.contains(expected) && message.contains("lines.csv"), "{message}");
    }
    let ask = |more: &[&str]| {
        let output = sightline(&[&["los", database], more].concat());
        (status(&output), text(&output.stderr).to_owned())
    };
    assert_eq!(ask(&[]).0, 2);
    assert_eq!(ask(&["--from", "1,2,3"]).0, 2);
    assert_eq!(ask(&["--from", "1,2,NaN", "--to", "1,2,3"]).0, 2);
    let (code, message) = ask(&["--from", "1,2,3", "--to", "1,2,3", "--coords", "geographic"]);
    assert_eq!(code, 2);
    assert!(message.contains("neither longitude and latitude"), "{message}");
    let unreachable = sightline(&["los", "http://127.0.0.1:1", "--from", "1,2,3", "--to", "1,2,3"]);
    assert_eq!(status(&unreachable), 4);
    assert!(text(&unreachable.stderr).contains("127.0.0.1:1"));
    assert_eq!(status(&sightline(&["los", "no-such.db", "--from", "1,2,3", "--to", "1,2,3"])), 3);
}
