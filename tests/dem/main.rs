//! The elevation readers, from outside: each format on small samples written here, hostile ones among them, and real
//! files where the folder with them is named.

mod ascii;
mod check;
mod dted;
mod encoders;
mod geotiff;
mod hgt;
mod hostile;
mod join;
mod mutations;
mod picture;
mod raw;
mod real;
mod resample;
mod samples;
mod usgs;

use std::path::{Path, PathBuf};

use sightline::dem::{self, DemError, OpenOptions, Raster};

/// Opens one file without options.
fn open(path: &Path) -> Result<Box<dyn Raster>, DemError> {
    dem::open(&[path.to_owned()], &OpenOptions::default(), &mut |_| ())
}

/// Opens one file whose reader may keep nothing at hand.
fn open_in_no_memory(path: &Path) -> Result<Box<dyn Raster>, DemError> {
    dem::open(&[path.to_owned()], &OpenOptions { memory_bytes: 0, ..OpenOptions::default() }, &mut |_| ())
}

/// All heights, south row first.
fn read(raster: &mut dyn Raster) -> Result<Vec<f64>, DemError> {
    let (nx, ny) = (raster.info().nx as usize, raster.info().ny);
    let mut heights = vec![0.0; nx * ny as usize];
    for (j, row) in (0..ny).zip(heights.chunks_exact_mut(nx)) {
        raster.read_rows(j, row)?;
    }
    Ok(heights)
}

/// A folder of its own for a test, with the means to put files into it.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn put(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        // A new file each time: some file systems write a file through to the disc when it was truncated.
        let _ = std::fs::remove_file(&path);
        std::fs::write(&path, content).unwrap();
        path
    }
}

/// Two lists of heights are the same, NaN equal to NaN.
fn assert_same(found: &[f64], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (n, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!(a == b || (a.is_nan() && b.is_nan()), "{what}: height {n} is {a}, not {b}");
    }
}
