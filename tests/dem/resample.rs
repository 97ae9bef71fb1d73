//! Files of different spacing brought to the finest lattice on request.

use std::path::PathBuf;

use sightline::dem::{self, DemError, OpenOptions, Raster, Resampling};

use crate::encoders::hgt;
use crate::{Folder, assert_same, join, read};

const NAN: f64 = f64::NAN;

fn open(paths: &[&PathBuf], method: Resampling) -> Result<Box<dyn Raster>, DemError> {
    let paths: Vec<_> = paths.iter().map(|p| (*p).clone()).collect();
    dem::open(&paths, &OpenOptions { resample: Some(method), ..OpenOptions::default() }, &mut |_| ())
}

/// A grid whose south-western post lies at (x, 2000).
fn grid(x: f64, step: f64, rows: &[&str]) -> String {
    join::grid(x, 2000.0, step, rows)
}

#[test]
fn a_coarse_file_lies_beside_a_fine_one() {
    let folder = Folder::new();
    let fine = folder.put("fine.asc", grid(1000.0, 10.0, &["1 2 3", "1 2 3", "1 2 3"]));
    let coarse = folder.put("coarse.asc", grid(1020.0, 20.0, &["9 13 -9999", "3 7 8"]));
    let bilinear = [
        [1.0, 2.0, 3.0, 5.0, 7.0, 7.5, 8.0],
        [1.0, 2.0, 3.0, 8.0, 10.0, NAN, NAN],
        [1.0, 2.0, 3.0, 11.0, 13.0, NAN, NAN],
    ];
    let nearest = [
        [1.0, 2.0, 3.0, 7.0, 7.0, 8.0, 8.0],
        [1.0, 2.0, 3.0, 13.0, 13.0, NAN, NAN],
        [1.0, 2.0, 3.0, 13.0, 13.0, NAN, NAN],
    ];
    for (method, expected) in [(Resampling::Bilinear, bilinear), (Resampling::Nearest, nearest)] {
        for order in [[&fine, &coarse], [&coarse, &fine]] {
            let mut raster = open(&order, method).unwrap();
            let info = raster.info();
            assert_eq!((info.nx, info.ny, info.georeference.step), (7, 3, [10.0, 10.0]));
            assert!(info.notes.iter().any(|note| note.contains("coarse.asc is resampled")), "{:?}", info.notes);
            assert_same(&read(&mut *raster).unwrap(), &expected.concat(), &format!("{method}"));
        }
    }
}

#[test]
fn tiles_of_one_and_three_arc_seconds_join() {
    let folder = Folder::new();
    // A plane in both: bilinear keeps it wherever both know it.
    let west = folder.put("N44E006.hgt", hgt(1201, |column, _| column as i16));
    let east = folder.put("N44E007.hgt", hgt(3601, |column, _| 1200 + (column / 3) as i16));
    let refused = dem::open(&[west.clone(), east.clone()], &OpenOptions::default(), &mut |_| ());
    assert!(refused.is_err_and(|error| error.to_string().contains("spacing")));
    let mut raster = open(&[&west, &east], Resampling::Bilinear).unwrap();
    assert_eq!((raster.info().nx, raster.info().ny), (7201, 3601));
    let mut row = vec![0.0; 7201];
    for j in [0, 1, 1800, 3600] {
        raster.read_rows(j, &mut row).unwrap();
        for i in [0, 1, 2, 3, 1799, 3598, 3599, 3600] {
            assert!((row[i] - i as f64 / 3.0).abs() < 1e-9, "{i}: {}", row[i]);
        }
        assert_eq!([row[3601], row[3603], row[7200]], [1200.0, 1201.0, 2400.0]);
    }
}

#[test]
fn what_cannot_be_resampled_is_refused() {
    let folder = Folder::new();
    let fine = folder.put("fine.asc", grid(1000.0, 10.0, &["1 2 3", "1 2 3"]));
    let far = folder.put("far.asc", grid(9000.0, 20.0, &["1 2", "3 4"]));
    let tiny = folder.put("tiny.asc", grid(1e17, 20.0, &["1 2", "3 4"]));
    for other in [&far, &tiny] {
        assert!(matches!(open(&[&fine, other], Resampling::Nearest).map(drop), Err(DemError::Mosaic { .. })));
    }
}
