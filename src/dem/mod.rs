//! Readers of elevation files: SRTM `.hgt`, GeoTIFF, DTED, Esri ASCII grids, raw rasters with a
//! header (BIL, FLT, ENVI), USGS ASCII DEM and PNG. Files in, rasters out, nothing else.
//!
//! [`open`] looks at the files, refuses what is not well formed, and gives a [`Raster`]: posts in the order of the
//! grid frame (south row first), heights in metres as f64, NaN where there is no data. Rows are read on demand, so
//! that a reader of the whole raster never holds it; each format says how much it keeps at hand.
//!
//! Hostile input gives an error or a well-formed raster: declared sizes are checked against the file's length before
//! anything is allocated for them.

mod ascii;
pub mod check;
mod crs;
mod dted;
mod error;
mod geotiff;
mod hgt;
mod join;
mod mosaic;
mod nodata;
mod picture;
mod prj;
mod raster;
mod raw;
mod resample;
mod sample;
mod sniff;
mod spool;
mod usgs;

use std::path::{Path, PathBuf};

pub use error::DemError;
pub use raster::{
    DEFAULT_READER_BYTES, FLOAT_UNIT_M, MAX_HEIGHT_M, OpenOptions, PngHeights, Progress, Raster, RasterInfo,
    Resampling, SeamReport,
};

use sniff::Format;

/// Opens one elevation file, or several that lie on one lattice as one raster; with [`OpenOptions::resample`] several on
/// any lattices of one reference system.
///
/// `progress` is called now and then while files are scanned, with bytes done and in all.
pub fn open(
    paths: &[PathBuf],
    options: &OpenOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Box<dyn Raster>, DemError> {
    let mut files = Vec::with_capacity(paths.len());
    for path in paths {
        files.push((path, sniff::format_of(path)?));
    }
    let packing = |(path, format): &(&PathBuf, Format)| match format {
        Format::Hgt(packing) => Some(((*path).clone(), *packing)),
        _ => None,
    };
    if files.is_empty() {
        return Err(DemError::NoInput);
    }
    let tiles = files.iter().map(packing).collect::<Option<Vec<_>>>();
    if let (Some(tiles), None) = (tiles, options.resample) {
        return Ok(Box::new(mosaic::Mosaic::open(&tiles, options)?));
    }
    let mut rasters = Vec::with_capacity(files.len());
    let each = OpenOptions { memory_bytes: options.memory_bytes / files.len(), ..*options };
    for (path, format) in files {
        rasters.push((path.clone(), open_single(path, format, &each, progress)?));
    }
    if let Some(method) = options.resample {
        rasters = join::on_finest_lattice(rasters, method)?;
    }
    match rasters.len() {
        1 => Ok(rasters.swap_remove(0).1),
        _ => Ok(Box::new(join::Join::new(rasters, options.memory_bytes)?)),
    }
}

fn open_single(
    path: &Path,
    format: Format,
    options: &OpenOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<Box<dyn Raster>, DemError> {
    Ok(match format {
        Format::Hgt(packing) => Box::new(mosaic::Mosaic::open(&[(path.to_owned(), packing)], options)?),
        Format::Ascii => Box::new(ascii::AsciiGrid::open(path, options, progress)?),
        Format::Tiff => Box::new(geotiff::GeoTiff::open(path, options)?),
        Format::Dted => Box::new(dted::Dted::open(path, options)?),
        Format::Raw => Box::new(raw::RawRaster::open(path, options)?),
        Format::Usgs => Box::new(usgs::UsgsDem::open(path, options, progress)?),
        Format::Png => Box::new(picture::Picture::open(path, options)?),
    })
}
