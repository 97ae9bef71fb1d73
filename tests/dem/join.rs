//! Mosaics of files of any format: the seam rule, and what does not fit.

use std::path::PathBuf;

use sightline::dem::{self, DemError, OpenOptions, Raster, SeamReport};

use crate::encoders::{Dted, hgt};
use crate::{Folder, assert_same, read};

const NAN: f64 = f64::NAN;

fn join(paths: &[&PathBuf]) -> Result<Box<dyn Raster>, DemError> {
    let paths: Vec<_> = paths.iter().map(|p| (*p).clone()).collect();
    dem::open(&paths, &OpenOptions::default(), &mut |_| ())
}

fn refused(paths: &[&PathBuf]) -> String {
    match join(paths).map(drop) {
        Err(DemError::Mosaic { detail }) => detail,
        other => panic!("{other:?}"),
    }
}

/// A grid in metres whose south-western post lies at (x, y).
pub(super) fn grid(x: f64, y: f64, step: f64, rows: &[&str]) -> String {
    let (nx, ny) = (rows[0].split(' ').count(), rows.len());
    let rows = rows.join("\n");
    format!("ncols {nx}\nnrows {ny}\nxllcenter {x}\nyllcenter {y}\ncellsize {step}\n{rows}\n")
}

#[test]
fn known_beats_void_and_the_south_western_part_wins() {
    let folder = Folder::new();
    // Two parts that share a column, one further north that overlaps both, and one that follows without a shared post.
    let sw = folder.put("sw.asc", grid(1000.0, 2000.0, 10.0, &["1 1 -9999", "1 1 1"]));
    let se = folder.put("se.asc", grid(1020.0, 2000.0, 10.0, &["2 2 2", "2 2 2"]));
    let north = folder.put("n.asc", grid(1010.0, 2010.0, 10.0, &["3 3.5 3", "3 3 3"]));
    let east = folder.put("e.asc", grid(1050.0, 2000.0, 10.0, &["4 4", "4 4"]));
    let expected =
        [[1.0, 1.0, 1.0, 2.0, 2.0, 4.0, 4.0], [1.0, 1.0, 2.0, 2.0, 2.0, 4.0, 4.0], [NAN, 3.0, 3.5, 3.0, NAN, NAN, NAN]]
            .concat();
    for order in [[&sw, &se, &north, &east], [&east, &north, &se, &sw]] {
        let mut raster = join(&order).unwrap();
        let info = raster.info();
        assert_eq!((info.nx, info.ny, info.unit_m), (7, 3, 1.0 / 64.0));
        assert_eq!((info.georeference.origin, info.georeference.step), ([1000.0, 2000.0], [10.0, 10.0]));
        assert_same(&read(&mut *raster).unwrap(), &expected, "mosaic");
        let report = SeamReport {
            tiles: 4,
            missing_tiles: 0,
            compared_posts: 1 + 3,
            differing_posts: 4,
            largest_difference_m: 2.0,
            filled_posts: 1,
            uncovered_posts: 4,
        };
        assert_eq!(raster.seams(), Some(report));
        assert_same(&read(&mut *raster).unwrap(), &expected, "again");
        assert_eq!(raster.seams(), Some(report), "each row is counted once");
    }
}

#[test]
fn what_lies_on_no_common_lattice_is_refused_with_the_reason() {
    let folder = Folder::new();
    let rows = &["1 2 3", "4 5 6"];
    let base = folder.put("base.asc", grid(1000.0, 2000.0, 10.0, rows));
    let other = |name: &str, x: f64, step: f64| folder.put(name, grid(x, 2000.0, step, rows));
    assert!(refused(&[&base, &other("coarse.asc", 1020.0, 20.0)]).contains("different spacings"));
    assert!(refused(&[&base, &other("phase.asc", 1025.0, 10.0)]).contains("2.5 posts apart"));
    assert!(refused(&[&base, &other("same.asc", 1000.0, 10.0)]).contains("the same place"));
    assert!(refused(&[&base, &other("far.asc", 1040.0, 10.0)]).contains("does not adjoin"));
    assert!(refused(&[&base, &other("beyond.asc", 1e12, 10.0)]).contains("posts apart"));
    let degrees = folder.put("degrees.asc", grid(7.0, 50.0, 0.01, rows));
    assert!(refused(&[&base, &degrees]).contains("reference systems"));
    // Coordinates printed with few digits are still on the lattice.
    assert!(join(&[&base, &other("printed.asc", 1030.1, 10.0001)]).is_ok());
}

#[test]
fn cells_of_dted_adjoin_each_other_and_tiles_of_srtm() {
    let folder = Folder::new();
    let cell = |corner| Dted { nx: 1201, ny: 1201, corner, ..Dted::default() };
    let south = folder.put("s.dt1", cell(("0070000E", "0490000N")).encode(|_, _| Some(5)));
    let north = folder.put("n.dt1", cell(("0070000E", "0500000N")).encode(|_, j| (j > 0).then_some(6)));
    let east = folder.put("N49E008.hgt", hgt(1201, |_, _| 5));
    let mut raster = join(&[&north, &east, &south]).unwrap();
    assert_eq!((raster.info().nx, raster.info().ny), (2401, 2401));
    let heights = read(&mut *raster).unwrap();
    let at = |i: usize, j: usize| heights[j * 2401 + i];
    assert_eq!((at(0, 0), at(1200, 1200), at(2400, 1200), at(0, 1201)), (5.0, 5.0, 5.0, 6.0));
    assert!(at(2400, 1201).is_nan());
    let seams = raster.seams().unwrap();
    assert_eq!((seams.compared_posts, seams.differing_posts, seams.filled_posts), (1201, 0, 1201));
    let zone = Dted { nx: 601, interval: (60, 30), ..cell(("0070000E", "0510000N")) };
    let zone = folder.put("zone.dt1", zone.encode(|_, _| Some(7)));
    assert!(refused(&[&south, &zone]).contains("different spacings"));
}
