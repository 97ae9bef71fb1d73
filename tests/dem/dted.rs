//! DTED cells: sign and magnitude, zones, datums, levels, and what is refused.

use sightline::dem::{self, DemError, OpenOptions};

use crate::encoders::Dted;
use crate::{Folder, assert_same, open, read};

fn height(i: usize, j: usize) -> i16 {
    7 * i as i16 - 11 * j as i16
}

#[test]
fn a_cell_holds_its_heights_south_row_first_and_its_place() {
    let folder = Folder::new();
    let cell = Dted { interval: (60, 30), corner: ("0063030W", "0510000S"), ..Dted::default() };
    let path = folder.put("w006.dt1", cell.encode(|i, j| ((i, j) != (2, 1)).then(|| height(i, j))));
    let mut raster = open(&path).unwrap();
    let info = raster.info();
    assert_eq!((info.nx, info.ny, info.unit_m, info.format.as_str()), (5, 4, 1.0, "DTED, level 1"));
    let place = info.georeference;
    assert_eq!((place.epsg, place.geographic), (Some(4326), true));
    assert_eq!(place.origin, [-(6.0 + 30.0 / 60.0 + 30.0 / 3600.0), -51.0]);
    assert_eq!(place.step, [6.0 / 3600.0, 3.0 / 3600.0], "fewer meridians towards the pole");
    assert!(info.notes.iter().any(|n| n.contains("EGM96")) && info.notes.iter().any(|n| n.contains("arc-seconds")));
    let mut expected: Vec<_> = (0..20).map(|n| f64::from(height(n % 5, n / 5))).collect();
    expected[5 + 2] = f64::NAN;
    assert_same(&read(&mut *raster).unwrap(), &expected, "cell");
    raster.release();
    assert_same(&read(&mut *raster).unwrap(), &expected, "after letting go");
}

#[test]
fn large_cells_are_read_band_by_band_in_any_order() {
    let folder = Folder::new();
    let cell = Dted { nx: 1201, ny: 1201, ..Dted::default() };
    let mut raster = open(&folder.put("cell.dt1", cell.encode(|i, j| Some((i * 3 + j * 2) as i16)))).unwrap();
    let mut row = vec![0.0; 1201];
    for j in [0, 1200, 435, 436, 437, 872, 3] {
        raster.read_rows(j, &mut row).unwrap();
        assert!((0..).zip(&row).all(|(i, h)| *h == f64::from(i * 3 + j * 2)), "row {j}");
    }
}

#[test]
fn tape_labels_trailing_bytes_and_a_wrong_level_are_taken_with_a_note() {
    let folder = Folder::new();
    let cell = Dted { series: "DTED0", datums: "MSLNAD27", ..Dted::default() }.encode(|_, _| Some(-3));
    let labelled = [format!("{:80}{:80}", "VOL1", "HDR1").as_bytes(), &cell, b"more"].concat();
    let mut raster = open(&folder.put("cell.dt2", labelled)).unwrap();
    let notes = raster.info().notes.join("; ");
    for words in ["named .dt2 but holds DTED0", "4 bytes after the last record", "NAD27", "mean sea level"] {
        assert!(notes.contains(words), "{words} in {notes}");
    }
    assert_eq!(raster.info().georeference.epsg, None);
    assert_same(&read(&mut *raster).unwrap(), &[-3.0; 20], "cell");
}

#[test]
fn damage_and_other_conventions_are_refused_with_words() {
    let folder = Folder::new();
    let sound = Dted::default().encode(|i, j| Some(height(i, j)));
    let error = |content: &[u8]| match open(&folder.put("cell.dt1", content)).and_then(|mut r| read(&mut *r)) {
        Err(e @ (DemError::Malformed { .. } | DemError::Refused { .. })) => e.to_string(),
        other => panic!("{other:?}"),
    };
    let changed = |at: usize, bytes: &[u8]| {
        let mut content = sound.clone();
        content[at..at + bytes.len()].copy_from_slice(bytes);
        content
    };
    assert!(error(&sound[..sound.len() - 1]).contains("cut short"));
    assert!(error(&sound[..700]).contains("within its headers"));
    let record = 3428;
    assert!(error(&changed(record, &[0xab])).contains("meridian 0"));
    assert!(error(&changed(record + 9, &[77])).contains("check sum"));
    assert!(error(&changed(record + 20 + 5, &[2])).contains("missing or out of order"));
    assert!(error(&changed(80 + 264, b"0000045.0")).contains("rotated"));
    assert!(error(&changed(47, b"0001")).contains("at least 2"));
    assert!(error(&changed(20, b"00x0")).contains("longitude interval"));
    assert!(error(&changed(11, b"N")).contains("longitude"));
    // -5 in two's complement is -32763 in sign and magnitude.
    let wrong = Dted::default().encode(|_, _| Some(-32_763));
    let words = error(&wrong);
    assert!(words.contains("two's complement") && words.contains("post (0, 0)"), "{words}");
    let options = OpenOptions { nodata: Some(-32_763.0), ..OpenOptions::default() };
    let mut raster = dem::open(&[folder.put("cell.dt1", wrong)], &options, &mut |_| ()).unwrap();
    assert!(read(&mut *raster).unwrap().iter().all(|h| h.is_nan()));
}
