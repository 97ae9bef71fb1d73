//! Esri ASCII grids: the header in its variants, and what is refused where.

use sightline::dem::{self, DemError, FLOAT_UNIT_M, OpenOptions};

use crate::{Folder, assert_same, open, read};

const HEADER: &str = "ncols 3\nnrows 2\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -1\n";
const NAN: f64 = f64::NAN;

#[test]
fn heights_come_south_row_first_with_voids() {
    let folder = Folder::new();
    let path = folder.put("grid.asc", format!("{HEADER}1 2 3\n4 -1 6\n"));
    let mut raster = open(&path).unwrap();
    let info = raster.info();
    assert_eq!((info.nx, info.ny, info.unit_m), (3, 2, 1.0));
    assert_eq!((info.georeference.origin, info.georeference.step), ([105.0, 205.0], [10.0, 10.0]));
    assert_same(&read(&mut *raster).unwrap(), &[4.0, NAN, 6.0, 1.0, 2.0, 3.0], "grid");
}

#[test]
fn the_header_may_come_in_any_letter_case_order_and_registration() {
    let folder = Folder::new();
    let text = "\u{feff}NROWS 2\r\nNcols 3 XLLCENTER 105 yllcorner 2e2\r\nDX 10\ndy 20\n1.5 2 3e0 +4\n.5 -9999";
    let mut raster = open(&folder.put("grid.ASC", text)).unwrap();
    let info = raster.info();
    assert_eq!((info.georeference.origin, info.georeference.step), ([105.0, 210.0], [10.0, 20.0]));
    assert_eq!(info.unit_m, FLOAT_UNIT_M);
    assert_same(
        &read(&mut *raster).unwrap(),
        &[4.0, 0.5, NAN, 1.5, 2.0, 3.0],
        "rows broken over lines, -9999 by default",
    );
}

#[test]
fn long_grids_are_read_band_by_band_in_any_order() {
    let folder = Folder::new();
    let (nx, ny) = (250_usize, 200_usize);
    let value = |i: usize, j: usize| (7 * i + 1000 * j) as f64;
    let mut text = format!("ncols {nx}\nnrows {ny}\nxllcorner 0\nyllcorner 0\ncellsize 10\n");
    for j in (0..ny).rev() {
        let row: Vec<_> = (0..nx).map(|i| value(i, j).to_string()).collect();
        text += &(row.join(" ") + "\n");
    }
    let mut calls = Vec::new();
    let path = folder.put("grid.asc", &text);
    let mut raster = dem::open(&[path], &OpenOptions::default(), &mut |p| calls.push(p)).unwrap();
    assert_eq!(calls.last().map(|p| (p.done, p.total)), Some((text.len() as u64, text.len() as u64)));
    for j in [0, 199, 100, 99, 101, 3] {
        let mut row = vec![0.0; nx];
        raster.read_rows(j as u32, &mut row).unwrap();
        assert_same(&row, &(0..nx).map(|i| value(i, j)).collect::<Vec<_>>(), &format!("row {j}"));
    }
}

#[test]
fn what_is_wrong_is_told_with_its_line() {
    let folder = Folder::new();
    let cases = [
        (format!("{HEADER}1 2 3\n4 5\n"), "line 8", "5 of the 3 x 2 = 6"),
        (format!("{HEADER}1 2 3\n4 5 6 7\n"), "line 8", "more than"),
        (format!("{HEADER}1 2 3\n4 5,5 6\n"), "line 8", "\"5,5\" is not a number"),
        (format!("{HEADER}1 two 3\n4 5 6\n"), "line 7", "\"two\""),
        ("ncols 3\nnrows\n".to_owned(), "line 2", "in the middle"),
        ("ncols 3\nrows 2\n".to_owned(), "line 2", "rows"),
        ("ncols 3\nncols 3\n".to_owned(), "line 2", "twice"),
        ("ncols 3\nnrows 1e12\nxllcorner 0\nyllcorner 0\ncellsize 1\n5".to_owned(), "", "nrows"),
        ("ncols 2.5\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n5".to_owned(), "", "ncols"),
        ("ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\n1 2 3 4 5 6".to_owned(), "", "cellsize"),
    ];
    for (text, line, detail) in cases {
        match open(&folder.put("grid.asc", &text)).and_then(|mut r| read(&mut *r)) {
            Err(e @ DemError::Malformed { .. }) => {
                let message = e.to_string();
                assert!(message.contains(line) && message.contains(detail), "{message}");
            }
            other => panic!("{text:?}: {other:?}"),
        }
    }
    for cell in ["0", "-1", "nan", "inf", "1e-320"] {
        let text = format!("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize {cell}\n1 2 3 4");
        assert!(matches!(open(&folder.put("grid.asc", text)), Err(DemError::Refused { .. })), "{cell}");
    }
    let text = format!("{HEADER}1 2 3\n4 5 1e30\n");
    let found = open(&folder.put("grid.asc", text)).and_then(|mut r| read(&mut *r));
    assert!(matches!(found, Err(DemError::ImpossibleHeight { i: 2, j: 0, .. })), "{found:?}");
}

#[test]
fn the_prj_file_beside_it_names_the_reference_system() {
    let folder = Folder::new();
    let path = folder.put("grid.asc", "ncols 2\nnrows 2\nxllcorner 10\nyllcorner 50\ncellsize 0.001\n1 2 3 4");
    let place = || open(&path).map(|r| (r.info().georeference.epsg, r.info().georeference.geographic));
    assert_eq!(place(), Ok((None, true)), "degrees by their size");
    let geographic = r#"GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984"],UNIT["Degree",0.0174532925199433]]"#;
    folder.put("grid.prj", geographic);
    assert_eq!(place(), Ok((Some(4326), true)));
    folder.put("grid.prj", format!(r#"PROJCS["WGS_1984_UTM_Zone_33S",{geographic},UNIT["Meter",1.0]]"#));
    assert_eq!(place(), Ok((Some(32_733), false)));
    folder.put("grid.prj", format!(r#"PROJCS["Texas",{geographic},UNIT["Foot_US",0.3048006]]"#));
    assert!(matches!(place(), Err(DemError::Refused { .. })));
}
