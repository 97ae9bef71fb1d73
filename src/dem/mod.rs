//! Readers of elevation files: SRTM `.hgt`, GeoTIFF and Esri ASCII grids. Files in, rasters out, nothing else.
//!
//! [`open`] looks at the files, refuses what is not well formed, and gives a [`Raster`]: posts in the order of the
//! grid frame (south row first), heights in metres as f64, NaN where there is no data. Rows are read on demand, so
//! that a reader of the whole raster never holds it; each format says how much it keeps at hand.
//!
//! Hostile input gives an error or a well-formed raster: declared sizes are checked against the file's length before
//! anything is allocated for them.

mod ascii;
mod crs;
mod error;
mod geotiff;
mod hgt;
mod mosaic;
mod nodata;
mod prj;
mod raster;
mod sniff;

use std::path::{Path, PathBuf};

pub use error::DemError;
pub use raster::{FLOAT_UNIT_M, MAX_HEIGHT_M, OpenOptions, Progress, Raster, RasterInfo, SeamReport};

use sniff::Format;

/// Opens one elevation file, or several adjoining `.hgt` tiles as one raster.
///
/// `progress` is called now and then while files are scanned, with bytes done and in all.
pub fn open(
    paths: &[PathBuf],
    options: &OpenOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Box<dyn Raster>, DemError> {
    let [first, rest @ ..] = paths else { return Err(DemError::NoInput) };
    let packing = match sniff::format_of(first)? {
        Format::Hgt(packing) => packing,
        format if rest.is_empty() => return open_single(first, format, options, progress),
        _ => return Err(not_a_tile(first)),
    };
    let mut tiles = vec![(first.clone(), packing)];
    for path in rest {
        match sniff::format_of(path)? {
            Format::Hgt(packing) => tiles.push((path.clone(), packing)),
            _ => return Err(not_a_tile(path)),
        }
    }
    Ok(Box::new(mosaic::Mosaic::open(&tiles, options)?))
}

fn not_a_tile(path: &Path) -> DemError {
    let detail = format!("{} is not an .hgt tile; other formats are read one file at a time", path.display());
    DemError::Mosaic { detail }
}

fn open_single(
    path: &Path,
    format: Format,
    options: &OpenOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Box<dyn Raster>, DemError> {
    match format {
        Format::Hgt(packing) => Ok(Box::new(mosaic::Mosaic::open(&[(path.to_owned(), packing)], options)?)),
        Format::Ascii => Ok(Box::new(ascii::AsciiGrid::open(path, options, progress)?)),
        Format::Tiff => Ok(Box::new(geotiff::GeoTiff::open(path, options)?)),
    }
}
