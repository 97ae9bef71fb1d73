//! The verbs `ingest`, `info` and `verify` as a user meets them: words, exit statuses, JSON.

use std::{
    fs,
    path::{Path, PathBuf},
};

use super::{program, sightline, status, text};

/// Columns and rows from the north of the sample's voids, and its heights elsewhere.
fn sample_height(column: u32, row: u32) -> Option<u32> {
    let void = row == 5 && (column == 7 || column == 8);
    (!void).then_some((column * 13 + row * 7) % 101)
}

/// An Esri ASCII grid of 70 x 66 posts of which two are void.
fn sample(folder: &Path) -> PathBuf {
    let path = folder.join("hills.asc");
    let mut grid = "ncols 70\nnrows 66\nxllcorner 1000\nyllcorner 2000\ncellsize 10\nNODATA_value -9999\n".to_owned();
    for row in 0..66 {
        for column in 0..70 {
            grid += &sample_height(column, row).map_or_else(|| "-9999 ".to_owned(), |z| format!("{z} "));
        }
        grid += "\n";
    }
    fs::write(&path, grid).unwrap();
    path
}

#[test]
fn a_grid_is_ingested_shown_and_verified() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let database = folder.path().join("hills.sldb");
    let (input, db) = (input.to_str().unwrap(), database.to_str().unwrap());

    let done = sightline(&["ingest", input, "-o", db, "--unit", "0.5", "--json", "--quiet"]);
    assert_eq!((status(&done), text(&done.stderr)), (0, ""));
    let ingested: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!((ingested["posts"].as_u64(), ingested["void_posts"].as_u64()), (Some(4620), Some(2)));

    let info = sightline(&["info", db, "--json"]);
    assert_eq!(status(&info), 0);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["version"], ingested["version"]);
    assert_eq!((info["unit_m"].as_f64(), info["highest_m"].as_f64()), (Some(0.5), Some(100.0)));
    assert_eq!(info["bytes"].as_u64(), Some(fs::metadata(&database).unwrap().len()));
    let words = sightline(&["info", db]);
    let words = text(&words.stdout);
    for expected in ["70 x 66", "0.5 m", "2 posts", "hills.asc", "heights", "bounds of step 2"] {
        assert!(words.contains(expected), "{expected} in {words}");
    }

    let verified = sightline(&["verify", db, "--quiet"]);
    assert_eq!(status(&verified), 0);
    assert!(text(&verified.stdout).contains("sound"));

    let picture = folder.path().join("hills.png");
    let draw = ["info", db, "--thumbnail", picture.to_str().unwrap()];
    assert_eq!(status(&sightline(&draw)), 0);
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(&picture).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let drawn = reader.next_frame(&mut pixels).unwrap();
    // 69 by 65 cells, the longer side in 512 pixels; the only voids are near the north-western corner.
    assert_eq!((drawn.width, drawn.height), (512, 482));
    let blue = |n: usize| i32::from(pixels[3 * n + 2]) > i32::from(pixels[3 * n]) + 40;
    let voids: Vec<_> = (0..512 * 482).filter(|&n| blue(n)).map(|n| (n % 512 * 69 / 512, n / 512 * 65 / 482)).collect();
    assert!(!voids.is_empty() && voids.iter().all(|&(i, j)| (6..=9).contains(&i) && (3..=6).contains(&j)), "{voids:?}");
    assert_eq!(status(&sightline(&draw)), 4, "a picture that exists is kept");
}

#[test]
fn statistics_are_those_of_the_grid_and_told_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let database = folder.path().join("hills.sldb");
    let (input, db) = (input.to_str().unwrap(), database.to_str().unwrap());
    assert_eq!(status(&sightline(&["ingest", input, "-o", db, "--unit", "0.5", "--quiet"])), 0);
    let json = |args: &[&str]| -> serde_json::Value {
        let output = sightline(args);
        assert_eq!(status(&output), 0, "{}", text(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    assert!(json(&["info", db, "--json"])["statistics"].is_null());
    let found = &json(&["info", db, "--statistics", "--json"])["statistics"];
    let mut known: Vec<_> = (0..66).flat_map(|row| (0..70).filter_map(move |i| sample_height(i, row))).collect();
    known.sort_unstable();
    let heights = &found["heights"];
    assert_eq!(heights["known_posts"].as_u64(), Some(known.len() as u64));
    let mean = f64::from(known.iter().sum::<u32>()) / known.len() as f64;
    assert!((heights["mean_m"].as_f64().unwrap() - mean).abs() < 1e-9);
    assert_eq!(heights["quantiles"][3]["height_m"].as_f64(), Some(f64::from(known[known.len() / 2 - 1])));
    assert_eq!((heights["pages"].as_u64(), heights["pages_with_voids"].as_u64()), (Some(4), Some(1)));
    let total = |list: &serde_json::Value, key: &str| -> u64 {
        list.as_array().unwrap().iter().map(|item| item[key].as_u64().unwrap()).sum()
    };
    assert_eq!(total(&heights["bands"], "posts"), known.len() as u64);
    let levels = &found["levels"];
    // Of the root square's corners one lies in the grid, and is no diamond.
    assert_eq!((levels.as_array().unwrap().len(), total(levels, "diamonds")), (14, 70 * 66 - 1));
    assert_eq!(
        (levels[0]["half_length_posts"].as_u64(), levels[13]["half_length_posts"].as_u64()),
        (Some(64), Some(1))
    );
    assert_eq!(levels[13]["half_length_m"]["east"].as_f64(), Some(10.0));
    let words = sightline(&["info", db, "--statistics"]);
    let (words, _) = (text(&words.stdout), text(&words.stderr));
    for expected in ["known         4618 posts", "50 % up to", "1 of 4 pages", "     13           1 "] {
        assert!(words.contains(expected), "{expected} in {words}");
    }
}

#[test]
fn existing_output_is_refused_without_force() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let output = folder.path().join("it.sldb");
    fs::write(&output, "precious").unwrap();
    let (input, db) = (input.to_str().unwrap(), output.to_str().unwrap());
    let refused = sightline(&["ingest", input, "-o", db]);
    assert_eq!(status(&refused), 4);
    assert!(text(&refused.stderr).contains("--force"));
    assert_eq!(fs::read(&output).unwrap(), b"precious");
    assert_eq!(status(&sightline(&["ingest", input, "-o", db, "--force", "--quiet"])), 0);
    assert_eq!(status(&sightline(&["verify", db])), 0);
}

#[test]
fn damage_is_status_1_and_what_is_no_database_is_status_3() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let output = folder.path().join("it.sldb");
    let db = output.to_str().unwrap();
    assert_eq!(status(&sightline(&["ingest", input.to_str().unwrap(), "-o", db, "--quiet"])), 0);
    let sound = fs::read(&output).unwrap();

    // Heights follow directly behind the manifest and their directory: the middle of the file is a page.
    let mut flipped = sound.clone();
    flipped[sound.len() / 2] ^= 1;
    fs::write(&output, &flipped).unwrap();
    let found = sightline(&["verify", db]);
    assert_eq!(status(&found), 1);
    assert!(text(&found.stderr).contains("page (") && text(&found.stderr).contains("checksum"));

    for cut in [sound.len() - 1, sound.len() / 2, 100, 20] {
        fs::write(&output, &sound[..cut]).unwrap();
        assert_eq!(status(&sightline(&["verify", db])), 1, "cut at {cut}");
        assert_eq!(status(&sightline(&["info", db])), 3, "cut at {cut}");
    }
    for (name, status_expected) in [(input.to_str().unwrap(), 3), ("no such file", 3)] {
        assert_eq!(status(&sightline(&["verify", name])), status_expected, "{name}");
        assert_eq!(status(&sightline(&["info", name])), status_expected, "{name}");
    }
}

#[test]
fn a_check_writes_nothing_and_its_status_says_whether_something_is_suspicious() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let sound = sightline(&["ingest", "--check", input.to_str().unwrap(), "--quiet"]);
    assert_eq!((status(&sound), text(&sound.stderr)), (0, ""));
    let folder = tempfile::tempdir().unwrap();
    let plain = folder.path().join("plain.asc");
    let grid = |z: i32| format!("ncols 3\nnrows 3\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3\n4 {z} 6\n7 8 9\n");
    for (z, expected) in [(5, 0), (80, 1), (-9999, 1)] {
        fs::write(&plain, grid(z)).unwrap();
        let name = plain.to_str().unwrap();
        // Nothing is void by default but what the option says, so that -9999 is a height.
        let output = sightline(&["ingest", "--check", name, "--nodata=-1", "--json", "--quiet"]);
        assert_eq!(status(&output), expected, "{z}: {}", text(&output.stderr));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(found["suspicious"].as_bool(), Some(expected == 1), "{z}");
        let words = sightline(&["ingest", "--check", name, "--nodata=-1"]);
        assert_eq!(text(&words.stdout).contains("post (1, 1) at (15.000000, 15.000000): "), expected == 1, "{z}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    let both = sightline(&["ingest", "--check", plain.to_str().unwrap(), "-o", "x.sldb"]);
    assert_eq!(status(&both), 2);
}

#[test]
fn a_coloured_picture_is_ingested_only_as_what_it_is_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tile.png");
    let mut encoder = png::Encoder::new(fs::File::create(&path).unwrap(), 2, 2);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&[128, 7, 0].repeat(4)).unwrap();
    let (input, output) = (path.to_str().unwrap(), folder.path().join("it.sldb"));
    let db = output.to_str().unwrap();
    let refused = sightline(&["ingest", input, "-o", db]);
    assert_eq!(status(&refused), 3);
    assert!(text(&refused.stderr).contains("--png terrarium"), "{}", text(&refused.stderr));
    assert_eq!(status(&sightline(&["ingest", input, "-o", db, "--png", "gray16"])), 3);
    assert_eq!(status(&sightline(&["ingest", input, "-o", db, "--png", "terrarium", "--quiet"])), 0);
    let info = sightline(&["info", db, "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!((info["highest_m"].as_f64(), info["unit_m"].as_f64()), (Some(7.0), Some(1.0 / 256.0)));
}

#[test]
fn bad_input_and_usage_have_their_own_statuses() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let input = input.to_str().unwrap();
    let output = folder.path().join("it.sldb");
    let db = output.to_str().unwrap();
    let cases: [(&[&str], i32); 8] = [
        (&["ingest", "no such file", "-o", db], 3),
        (&["ingest", input, "-o", db, "--void", "reject"], 3),
        (&["ingest", input, "-o", db, "--unit", "1e-9"], 3),
        (&["ingest", input, "-o", db, "--unit", "0"], 2),
        (&["ingest", input, "-o", db, "--crs", "4326"], 2),
        (&["ingest", input], 2),
        (&["ingest", "-o", db], 2),
        (&["ingest", folder.path().to_str().unwrap(), "-o", db], 3),
    ];
    for (args, expected) in cases {
        let output = sightline(args);
        assert_eq!(status(&output), expected, "{args:?}: {}", text(&output.stderr));
    }
    assert!(!output.exists());
}

/// However far an ingest has come when it is killed, the old database is still there and sound, or the new one is.
#[test]
fn an_ingest_that_is_killed_leaves_the_old_database_or_the_new() {
    let folder = tempfile::tempdir().unwrap();
    let input = sample(folder.path());
    let input = input.to_str().unwrap();
    let output = folder.path().join("it.sldb");
    let db = output.to_str().unwrap();
    let version = |unit: &str| {
        assert_eq!(status(&sightline(&["ingest", input, "-o", db, "--unit", unit, "--force", "--quiet"])), 0);
        fs::read(&output).unwrap()
    };
    let (new, old) = (version("0.25"), version("1"));
    let mut kept = 0;
    for delay in 0..30 {
        fs::write(&output, &old).unwrap();
        let mut ingest =
            program().args(["ingest", input, "-o", db, "--unit", "0.25", "--force", "--quiet"]).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_micros(delay * 1000));
        ingest.kill().unwrap();
        ingest.wait().unwrap();
        let found = fs::read(&output).unwrap();
        assert!(found == old || found == new, "after {delay} ms");
        kept += usize::from(found == old);
    }
    assert!(kept > 0, "the first kill comes before the program can have done anything");
}
