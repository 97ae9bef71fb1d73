//! What a reader gives: a raster's description and its rows.

use crate::terrain::Georeference;

use super::DemError;

/// Heights further than this from 0 are refused: no place has them, and with [`FLOAT_UNIT_M`] they still fit 32 bits.
pub const MAX_HEIGHT_M: f64 = 16_777_216.0;

/// The height unit suggested for rasters of floating-point samples: 2^-6 m, about 16 mm.
///
/// A power of two, so that the quantised heights are exact numbers of metres; fine against the 0.05 to 0.15 m accuracy
/// of lidar models; and [`MAX_HEIGHT_M`] fits in 31 bits.
pub const FLOAT_UNIT_M: f64 = 1.0 / 64.0;

/// Bytes that readers keep at hand unless they are told otherwise.
pub const DEFAULT_READER_BYTES: usize = 128 << 20;

/// What the user says over what the files say.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct OpenOptions {
    /// The sample value that means "no data", in place of the file's own. NaN and infinite samples are void anyway.
    pub nodata: Option<f64>,
    /// EPSG code of the horizontal reference system, in place of the file's own.
    pub epsg: Option<u32>,
    /// How PNG pictures hold heights, in place of what their path says.
    pub png: Option<PngHeights>,
    /// How files that are not on the lattice of the finest one are brought there; they are refused without it.
    pub resample: Option<Resampling>,
    /// Bytes that all files together may keep at hand while a row is read. What is more waits in nameless files in the
    /// folder for temporary ones. A few rows, and 10 MiB for a decoder, are not counted.
    pub memory_bytes: usize,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { nodata: None, epsg: None, png: None, resample: None, memory_bytes: DEFAULT_READER_BYTES }
    }
}

/// How heights between posts are found.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Resampling {
    /// That of the nearest post.
    Nearest,
    /// The bilinear mean of the four posts around; void where one of them is.
    Bilinear,
}

impl std::fmt::Display for Resampling {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Nearest => "nearest",
            Self::Bilinear => "bilinear",
        })
    }
}

/// How a PNG picture holds heights.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PngHeights {
    /// 16-bit grey samples, in metres.
    Gray16,
    /// Terrarium: red and green and blue are whole and 256ths of metres above -32,768 m.
    Terrarium,
    /// Mapbox Terrain-RGB: red, green and blue are tenths of metres above -10,000 m.
    Mapbox,
}

/// How far a long scan has come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Progress {
    /// Bytes done.
    pub done: u64,
    /// Bytes in all.
    pub total: u64,
}

/// What is known of a raster before its heights are read.
#[derive(Clone, PartialEq, Debug)]
pub struct RasterInfo {
    /// The format in words, such as "SRTM .hgt" or "GeoTIFF, int16".
    pub format: String,
    /// Posts from west to east, at least 2.
    pub nx: u32,
    /// Posts from south to north, at least 2.
    pub ny: u32,
    /// Where the posts lie: pixel centres of an area raster. Without georeference: origin 0 and unit steps.
    pub georeference: Georeference,
    /// Suggested height unit in metres: what makes integer samples exact; [`FLOAT_UNIT_M`] for floating point.
    pub unit_m: f64,
    /// What the user should know: a reference system or vertical datum in words, an assumption made.
    pub notes: Vec<String>,
}

impl RasterInfo {
    /// Checks that `out` is a whole number of rows from `j0` within the raster.
    pub(super) fn assert_rows(&self, j0: u32, out: &[f64]) {
        let nx = self.nx as usize;
        assert!(out.len().is_multiple_of(nx), "{} heights are not whole rows of {nx}", out.len());
        let rows = out.len() / nx;
        assert!(j0 as usize + rows <= self.ny as usize, "rows {j0} + {rows} of {}", self.ny);
    }
}

/// What the overlaps of a mosaic's tiles showed, over the rows read so far.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct SeamReport {
    /// Tiles of the mosaic.
    pub tiles: u32,
    /// Tiles of whole degrees that a rectangle would have but that were not given; 0 for mosaics of other formats.
    pub missing_tiles: u32,
    /// Posts that are known in more than one tile.
    pub compared_posts: u64,
    /// Those of them whose heights differ; the south-western tile won.
    pub differing_posts: u64,
    /// The largest difference, in metres.
    pub largest_difference_m: f64,
    /// Posts that are void in one tile and known in another; the known one won.
    pub filled_posts: u64,
    /// Posts of the rectangle that no tile covers; they are void.
    pub uncovered_posts: u64,
}

/// An elevation raster whose rows are read on demand.
///
/// Reading each row once, from south to north, is what every reader is made for; other orders are right but may cost
/// more. Readers keep a band of rows at hand: the height of a block row (strip or tile) in GeoTIFF, one text row in
/// Esri ASCII, the decompressed tiles of one row of tiles for zipped `.hgt` (25 MiB each), 1 MiB in DTED, 4 MiB and twice
/// the file in PNG, all samples in USGS ASCII DEM, and nothing for raw `.hgt` and raw rasters with a header. Where that is
/// more than [`OpenOptions::memory_bytes`], it waits in files.
pub trait Raster: Send {
    /// What is known of the raster.
    fn info(&self) -> &RasterInfo;

    /// Reads row `j` (0 is the southernmost) into `out`, which is nx long, west to east.
    ///
    /// Heights are in metres, finite and at most [`MAX_HEIGHT_M`] from 0; NaN is void.
    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError>;

    /// Reads `out.len() / nx` whole rows from row `j0` into `out`, row-major, south row first; see
    /// [`Raster::read_row`].
    ///
    /// # Panics
    /// When `out` is not a whole number of rows within the raster: that is the caller's defect, not the input's.
    fn read_rows(&mut self, j0: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info().assert_rows(j0, out);
        let nx = self.info().nx as usize;
        (j0..).zip(out.chunks_exact_mut(nx)).try_for_each(|(j, row)| self.read_row(j, row))
    }

    /// What the tiles' overlaps showed in the rows read so far; `None` when there is only one file.
    fn seams(&self) -> Option<SeamReport> {
        None
    }

    /// Lets go of what is kept at hand: the next rows will be read far from the last ones, or not at all.
    fn release(&mut self) {}

    /// Keeps at most so many bytes at hand from now on, see [`OpenOptions::memory_bytes`].
    fn limit_memory(&mut self, bytes: usize) -> Result<(), DemError> {
        let _ = bytes;
        Ok(())
    }

    /// Bytes that are kept at hand at most, about, beyond what is the same for all files.
    fn memory_bytes(&self) -> u64 {
        0
    }
}
