//! The verb `mesh` as a user meets it: files, words, exit statuses, JSON.

use std::{fs, path::Path};

use super::{sightline, status};

/// A database of 70 x 66 posts, 10 m apart, with its south-west post at (1005, 2005).
pub(super) fn database(folder: &Path) -> String {
    let (grid, database) = (folder.join("hills.asc"), folder.join("hills.sldb"));
    let mut text = "ncols 70\nnrows 66\nxllcorner 1000\nyllcorner 2000\ncellsize 10\nNODATA_value -9999\n".to_owned();
    for row in 0..66 {
        text += &(0..70).map(|column| format!("{} ", (column * 13 + row * 7) % 41)).collect::<String>();
        text += "\n";
    }
    fs::write(&grid, text).unwrap();
    let done = sightline(&["ingest", grid.to_str().unwrap(), "-o", database.to_str().unwrap(), "--quiet"]);
    assert_eq!(status(&done), 0, "{}", String::from_utf8_lossy(&done.stderr));
    database.to_str().unwrap().to_owned()
}

#[test]
fn meshes_are_written_as_ply_obj_and_glb() {
    let folder = tempfile::tempdir().unwrap();
    let db = database(folder.path());
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();

    let done = sightline(&["mesh", &db, "-o", &path("m.ply"), "--triangles", "500", "--json"]);
    assert_eq!(status(&done), 0, "{}", String::from_utf8_lossy(&done.stderr));
    let document: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert!((499..=500).contains(&document["triangles"].as_u64().unwrap()));
    assert_eq!(document["bound_unit"], "m");
    let ply = fs::read(path("m.ply")).unwrap();
    assert!(ply.starts_with(b"ply\nformat binary_little_endian 1.0\n"));

    let again = ["mesh", &db, "-o", &path("m.ply"), "--triangles", "500"];
    assert_eq!(status(&sightline(&again)), 4, "what exists is kept");
    assert_eq!(status(&sightline(&[&again[..], &["--force"]].concat())), 0);

    let done = sightline(&["mesh", &db, "-o", &path("m.obj"), "--error", "5", "--json"]);
    let document: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert!(document["bound"].as_f64().unwrap() <= 5.0);
    let obj = fs::read_to_string(path("m.obj")).unwrap();
    let faces = obj.lines().filter(|line| line.starts_with("f ")).count();
    assert_eq!(document["drawn_triangles"].as_u64(), Some(faces as u64));

    assert_eq!(status(&sightline(&["mesh", &db, "-o", &path("m.glb"), "--error", "5"])), 0);
    let glb = fs::read(path("m.glb")).unwrap();
    assert_eq!((&glb[..4], &glb[8..12]), (&b"glTF"[..], &(glb.len() as u32).to_le_bytes()[..]));

    let piped = sightline(&["mesh", &db, "-o", "-", "--triangles", "9", "--quiet"]);
    assert!(piped.stdout.starts_with(b"ply\n") && piped.stderr.is_empty());
}

#[test]
fn a_mesh_for_an_eye_gets_its_sight_lines_right() {
    let folder = tempfile::tempdir().unwrap();
    let db = database(folder.path());
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut lines = "id,ax,ay,az,bx,by,bz\n".to_owned();
    for n in 0..20 {
        lines += &format!("{n},{},{},2,{},{},2\n", 1010 + 30 * n, 2010, 1640 - 30 * n, 2600);
    }
    fs::write(path("lines.csv"), lines).unwrap();
    for fidelity in ["verdict", "wedgie", "profile"] {
        let out = path(&format!("{fidelity}.ply"));
        let (lines, triangles) = (path("lines.csv"), "6000");
        let view = ["--eye", "1200,2100,60", "--look", "1400,2400,3", "--fov", "50", "--viewport", "800x600"];
        let what = ["--lines", &lines, "--fidelity", fidelity, "--altitude", "agl", "--json"];
        let base = ["mesh", &db, "-o", &out, "--triangles", triangles];
        let done = sightline(&[&base[..], &view, &what].concat());
        assert_eq!(status(&done), 0, "{}", String::from_utf8_lossy(&done.stderr));
        let document: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        assert_eq!(document["sight_lines"].as_u64(), Some(20));
        assert_eq!(document["unsatisfied_lines"].as_array().map(Vec::len), Some(0), "{fidelity}");
        assert_eq!(document["bound_unit"], "px");
    }
}

#[test]
fn what_makes_no_sense_is_refused_with_the_right_status() {
    let folder = tempfile::tempdir().unwrap();
    let db = database(folder.path());
    let out = folder.path().join("m.ply").to_str().unwrap().to_owned();
    let lines = folder.path().join("lines.csv").to_str().unwrap().to_owned();
    fs::write(&lines, "ax,ay,az,bx,by,bz\n1,2,3,4,5,here\n").unwrap();
    for (expected, args) in [
        (2, vec!["-o", &out]),
        (2, vec!["-o", &out, "--triangles", "1"]),
        (2, vec!["-o", &out, "--triangles", "9", "--error", "1"]),
        (2, vec!["-o", &out, "--error", "-1"]),
        (2, vec!["-o", &out, "--pixels", "1"]),
        (2, vec!["-o", &out, "--triangles", "9", "--eye", "0,0,0"]),
        (2, vec!["-o", &out, "--triangles", "9", "--eye", "1,1,1", "--look", "1,1,1"]),
        (2, vec!["-o", &out, "--triangles", "9", "--eye", "1,1,1", "--look", "2,1,1", "--fov", "180"]),
        (2, vec!["-o", "mesh.stl", "--triangles", "9"]),
        (2, vec!["-o", "-", "--triangles", "9", "--json"]),
        (3, vec!["-o", &out, "--triangles", "9", "--lines", &lines]),
        (3, vec!["-o", &out, "--triangles", "9", "--lines", "no such file"]),
        (4, vec!["-o", "/no/such/folder/m.ply", "--triangles", "9"]),
    ] {
        let done = sightline(&[&["mesh", &db][..], &args].concat());
        assert_eq!(status(&done), expected, "{args:?}: {}", String::from_utf8_lossy(&done.stderr));
        assert!(!done.stderr.is_empty() && done.stdout.is_empty());
    }
    assert_eq!(status(&sightline(&["mesh", "no such database", "-o", &out, "--triangles", "9"])), 3);
}
