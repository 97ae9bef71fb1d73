//! GeoTIFF, by the crates geotiff-reader and tiff-reader: TIFF and BigTIFF, both byte orders, strips and tiles, all of
//! their codecs and predictors, integer samples of 8 to 32 bits and floating-point ones of 32 and 64.
//!
//! What they do not promise is checked here, before a block is decoded: that the block tables have the length that the
//! image needs, that every block lies in the file, and that it is no larger than the stored bytes can hold (`layout`). A
//! panic in a decoder is caught as the last resort, because the codecs are many and the input is hostile; none is known.
//!
//! Only the first image that is not an overview counts, and its first band. Blocks that are not stored are void.
//! NODATA is tag 42113 in any spelling; without the tag, the usual values that no place has are void. A known gap: where
//! integer samples carry a LERC mask, tiff-reader gives masked pixels as 0; GDAL writes no such file.
//!
//! Kept at hand: one band of whole blocks from west to east, decoded by tiff-reader on all threads. Where that would be
//! more than the reader may take, or than twice the file and [`FREE_BYTES`], such as for a file of one strip, blocks are
//! decoded row by row (`rows`) into a [`Spool`]. Samples without compression are read that way, too, some rows at a time.

mod layout;
mod place;
mod rows;

use std::fs::File;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use geotiff_reader::{GeoTiffFile, GeoTiffOpenOptions};
use tiff_reader::{Ifd, ParseBudgets, TiffFile};

use super::nodata::{self, Nodata};
use super::sample::Sample;
use super::spool::Spool;
use super::{DemError, FLOAT_UNIT_M, MAX_HEIGHT_M, OpenOptions, Raster, RasterInfo, crs};
use layout::Layout;
use rows::Coding;

/// The format's name in messages.
const FORMAT: &str = "GeoTIFF";
/// Most images (overviews, masks) that a file may hold.
const MAX_IMAGES: usize = 64;
/// Most entries of an image's directory.
const MAX_TAGS: usize = 256;
/// GDAL's tags: free metadata in XML, and the value that stands for no data.
const TAG_GDAL_METADATA: u16 = 42112;
const TAG_GDAL_NODATA: u16 = 42113;
/// Bit of NewSubfileType that marks an overview, and the tag.
const TAG_NEW_SUBFILE_TYPE: u16 = 254;

/// What a band may take at hand whatever the file's length.
const FREE_BYTES: u64 = 8 << 20;

/// The decoder's handle.
enum Handle {
    /// With georeference.
    Geo(Box<GeoTiffFile>),
    /// A plain TIFF.
    Plain(TiffFile),
}

impl Handle {
    fn tiff(&self) -> &TiffFile {
        match self {
            Self::Geo(file) => file.tiff(),
            Self::Plain(file) => file,
        }
    }
}

/// An elevation raster in a TIFF file.
pub(super) struct GeoTiff {
    path: PathBuf,
    info: RasterInfo,
    handle: Handle,
    image: usize,
    layout: Layout,
    nodata: Nodata,
    /// Metres per sample unit.
    sample_m: f64,
    file_bytes: u64,
    /// Bytes that may be at hand.
    memory_bytes: u64,
    by_row: Option<ByRow>,
    /// The band at hand, counted from the north, and its samples in the machine's byte order.
    held: Option<usize>,
    bytes: Spool,
    row: Vec<u8>,
}

/// What reads blocks row by row.
struct ByRow {
    file: File,
    coding: Coding,
    /// Offset and length of each block.
    table: Vec<(u64, u64)>,
}

impl GeoTiff {
    /// Reads the directory and checks it.
    pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let file_bytes = std::fs::metadata(path).map_err(|e| DemError::io(path, &e))?.len();
        let handle = guarded(path, || open_handle(path, file_bytes))?;
        let tiff = handle.tiff();
        let image = match &handle {
            Handle::Geo(file) => file.base_ifd_index(),
            Handle::Plain(file) => file.ifds().iter().position(|ifd| !is_overview(ifd)).unwrap_or(0),
        };
        let ifd = tiff.ifd(image).map_err(|e| malformed(path, &e))?;
        let layout = Layout::check(path, ifd, file_bytes)?;
        let mut notes = Vec::new();
        if layout.bands > 1 {
            notes.push(format!("the file has {} bands; the first is taken as heights", layout.bands));
        }
        if layout.missing_blocks > 0 {
            notes.push(format!("{} blocks are not stored; their posts are void", layout.missing_blocks));
        }
        refuse_scaled(path, ifd)?;
        let nodata = nodata_of(path, ifd, layout.sample, options, &mut notes)?;
        let (nx, ny) = (layout.width, layout.height);
        let (mut georeference, sample_m) = match &handle {
            Handle::Geo(file) => place::of(path, file, ny, &mut notes)?,
            Handle::Plain(_) => (place::none(&mut notes), 1.0),
        };
        crs::override_epsg(&mut georeference, options.epsg, &mut notes);
        crs::check(path, &georeference, nx, ny)?;
        let unit_m = if layout.sample.is_float() { FLOAT_UNIT_M } else { sample_m };
        let format = format!("{FORMAT}, {}", layout.sample.name());
        let info = RasterInfo { format, nx, ny, georeference, unit_m, notes };
        let mut raster = Self {
            path: path.to_owned(),
            info,
            handle,
            image,
            layout,
            nodata,
            sample_m,
            file_bytes,
            memory_bytes: 0,
            by_row: None,
            held: None,
            bytes: Spool::new(0),
            row: Vec::new(),
        };
        raster.limit_memory(options.memory_bytes)?;
        Ok(raster)
    }

    /// Decodes whole blocks of some rows.
    fn whole_blocks(&self, row: usize, rows: usize) -> Result<Spool, DemError> {
        if self.layout.whole_bytes(threads()) > self.memory_bytes {
            return Err(self.layout.refusal(&self.path, self.memory_bytes));
        }
        let tiff = self.handle.tiff();
        let bytes = guarded(&self.path, || {
            tiff.read_band_window_bytes(self.image, 0, row, 0, rows, self.layout.width as usize)
                .map_err(|e| malformed(&self.path, &e))
        });
        Ok(Spool::of(bytes?))
    }

    /// Puts band `band` at hand.
    fn hold(&mut self, band: usize) -> Result<(), DemError> {
        if self.held == Some(band) {
            return Ok(());
        }
        self.release();
        let (row, rows) = self.layout.band_rows(band);
        self.bytes = match &self.by_row {
            None => self.whole_blocks(row, rows)?,
            Some(by_row) => {
                guarded(&self.path, || by_row.decode(&self.path, &self.layout, row..row + rows, self.memory_bytes))?
            }
        };
        self.held = Some(band);
        Ok(())
    }
}

impl ByRow {
    /// Decodes some rows.
    fn decode(&self, path: &Path, layout: &Layout, rows: Range<usize>, memory_bytes: u64) -> Result<Spool, DemError> {
        let bytes = layout.rows_bytes(rows.len());
        // All of it in memory, or all in a file.
        let mut spool = if bytes <= memory_bytes { Spool::of(vec![0; bytes as usize]) } else { Spool::new(0) };
        let (width, size) = (layout.width as usize, layout.sample.bytes());
        for (n, [west, north]) in layout.blocks_of(rows.clone()) {
            let stored = self.table[n];
            if stored.0 == 0 || stored.1 == 0 {
                continue;
            }
            let within = rows.start.max(north)..rows.end.min(north + layout.block_height);
            let wanted = (width - west).min(layout.block_width) * size;
            let mut put = |row: usize, samples: &[u8]| {
                let at = ((north + row - rows.start) * width + west) * size;
                spool.write_at(at as u64, &samples[..wanted])
            };
            let within = within.start - north..within.end - north;
            self.coding
                .rows(&self.file, stored, layout.block_width, within, &mut put)
                .map_err(|error| malformed(path, &format!("block {n}: {error}")))?;
        }
        Ok(spool)
    }
}

/// Threads that decode blocks side by side.
fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

impl Raster for GeoTiff {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let from_north = (self.info.ny - 1 - j) as usize;
        let band = self.layout.band_of(from_north);
        self.hold(band)?;
        let (first, _) = self.layout.band_rows(band);
        self.row.resize(out.len() * self.layout.sample.bytes(), 0);
        let start = self.layout.rows_bytes(from_north - first);
        let samples = self.bytes.read_at(start, &mut self.row).map_err(|e| DemError::io(&self.path, &e))?;
        self.layout.sample.decode(samples, out);
        self.layout.mark_missing(from_north, out);
        for (i, height) in (0..).zip(out.iter_mut()) {
            if self.nodata.is_void(*height) {
                *height = f64::NAN;
                continue;
            }
            let metres = *height * self.sample_m;
            if metres.abs() > MAX_HEIGHT_M {
                return Err(DemError::ImpossibleHeight { path: self.path.clone(), i, j, height: *height });
            }
            *height = metres;
        }
        Ok(())
    }

    fn release(&mut self) {
        (self.held, self.bytes) = (None, Spool::new(0));
    }

    fn limit_memory(&mut self, bytes: usize) -> Result<(), DemError> {
        self.release();
        let ifd = self.handle.tiff().ifd(self.image).map_err(|e| malformed(&self.path, &e))?;
        self.memory_bytes = (bytes as u64).min(self.file_bytes.saturating_mul(2).saturating_add(FREE_BYTES));
        self.layout.use_whole_blocks();
        let coding = self.layout.coding(ifd, self.handle.tiff().byte_order(), bytes);
        let fits = self.layout.whole_bytes(threads()) <= self.memory_bytes;
        self.by_row = match coding.filter(|coding| coding.is_direct() || !fits) {
            None => None,
            Some(coding) => {
                self.layout.use_rows(coding.is_direct());
                let file = File::open(&self.path).map_err(|e| DemError::io(&self.path, &e))?;
                Some(ByRow { file, coding, table: self.layout.table(&self.path, ifd)? })
            }
        };
        Ok(())
    }

    fn memory_bytes(&self) -> u64 {
        let band = match &self.by_row {
            None => self.layout.whole_bytes(threads()),
            Some(_) => self.layout.rows_bytes(self.layout.band_rows(0).1),
        };
        band.min(self.memory_bytes)
    }
}

fn open_handle(path: &Path, file_bytes: u64) -> Result<Handle, DemError> {
    // Every value of a directory lies in the file, so no tag may claim more, nor all of them together.
    let budget = usize::try_from(file_bytes).unwrap_or(usize::MAX);
    let options = GeoTiffOpenOptions {
        // Bands are decoded once and kept here, so the decoder's own cache would only double them.
        block_cache_bytes: 0,
        block_cache_slots: 1,
        parse_budgets: ParseBudgets {
            max_ifds: MAX_IMAGES,
            max_ifd_entries: MAX_TAGS,
            max_tag_value_bytes: budget,
            max_metadata_value_bytes: budget,
        },
        decode_output_bytes: layout::MAX_BAND_BYTES,
    };
    match GeoTiffFile::open_with_options(path, options) {
        Ok(file) => Ok(Handle::Geo(Box::new(file))),
        Err(geotiff_reader::Error::NotGeoTiff) => {
            TiffFile::open_with_options(path, options).map(Handle::Plain).map_err(|e| malformed(path, &e))
        }
        Err(e) => Err(malformed(path, &e)),
    }
}

/// Runs a decoder and turns a panic of it into an error.
fn guarded<T>(path: &Path, run: impl FnOnce() -> Result<T, DemError>) -> Result<T, DemError> {
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| {
        Err(DemError::malformed(path, FORMAT, "its decoder gave up; it is damaged: fetch it again"))
    })
}

fn malformed(path: &Path, error: &dyn std::fmt::Display) -> DemError {
    DemError::malformed(path, FORMAT, format!("{error}; it is cut short or damaged: fetch it again"))
}

fn is_overview(ifd: &Ifd) -> bool {
    ifd.tag(TAG_NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u64()).is_some_and(|flags| flags & 1 != 0)
}

/// GDAL's free metadata may say that samples are to be scaled; heights read without that would be wrong.
fn refuse_scaled(path: &Path, ifd: &Ifd) -> Result<(), DemError> {
    let Some(text) = ifd.tag(TAG_GDAL_METADATA).and_then(|tag| tag.value.as_str()) else { return Ok(()) };
    for (role, neutral) in [("role=\"scale\"", 1.0), ("role=\"offset\"", 0.0)] {
        for at in text.match_indices(role).map(|(at, _)| at) {
            let value = text[at..].split(['>', '<']).nth(1).unwrap_or_default().trim();
            if value.parse::<f64>() != Ok(neutral) {
                let detail = "its samples are scaled or offset by its metadata; write it out in metres first, for \
                              example with gdal_translate -unscale";
                return Err(DemError::refused(path, detail));
            }
        }
    }
    Ok(())
}

fn nodata_of(
    path: &Path,
    ifd: &Ifd,
    sample: Sample,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<Nodata, DemError> {
    let single = sample == Sample::F32;
    if options.nodata.is_some() {
        return Ok(Nodata::new(options.nodata, single));
    }
    let declared = match ifd.tag(TAG_GDAL_NODATA).and_then(|tag| tag.value.as_str()) {
        Some(text) => nodata::parse(text).map_err(|word| {
            let detail = format!("its NODATA value {word:?} is no number; say what it means with --nodata");
            DemError::malformed(path, FORMAT, detail)
        })?,
        None => None,
    };
    if declared.is_some() || !sample.is_signed() {
        return Ok(Nodata::new(declared, single));
    }
    let floats = if sample.is_float() { ", -9999" } else { "" };
    notes.push(format!("the file declares no NODATA value; -32768, -32767{floats} are taken as void"));
    Ok(Nodata::undeclared(true, sample.is_float()))
}
