//! Readers of elevation files: SRTM `.hgt`, GeoTIFF and Esri ASCII grids. Files in, rasters out, nothing else.
//!
//! [`open`] looks at the files, refuses what is not well formed, and gives a [`Raster`]: posts in the order of the
//! grid frame (south row first), heights in metres as f64, NaN where there is no data. Rows are read on demand, so
//! that a reader of the whole raster never holds it; each format says how much it keeps at hand.
//!
//! Hostile input gives an error or a well-formed raster: declared sizes are checked against the file's length before
//! anything is allocated for them.

mod error;
mod raster;

use std::path::PathBuf;

pub use error::DemError;
pub use raster::{FLOAT_UNIT_M, MAX_HEIGHT_M, OpenOptions, Progress, Raster, RasterInfo, SeamReport};

/// Opens one elevation file, or several adjoining `.hgt` tiles as one raster.
///
/// `progress` is called now and then while files are scanned, with bytes done and in all.
pub fn open(
    paths: &[PathBuf],
    options: &OpenOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Box<dyn Raster>, DemError> {
    let _ = (options, progress);
    match paths {
        [] => Err(DemError::NoInput),
        [path, ..] => Err(DemError::Unsupported { path: path.clone(), found: "no reader is built in yet".to_owned() }),
    }
}
