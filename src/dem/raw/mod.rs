//! Raw rasters beside a text that describes them: Esri's BIL, BIP, BSQ and FLT, GTOPO30's `.dem`, and ENVI's. North row
//! first; `header` says how the samples lie.
//!
//! Only the first band counts. Kept at hand: one row.

mod envi;
mod esri;
mod header;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::nodata::Nodata;
use super::{DemError, FLOAT_UNIT_M, MAX_HEIGHT_M, OpenOptions, Raster, RasterInfo, crs};
use header::Header;

pub(super) use header::beside;

/// The format's name in messages.
const FORMAT: &str = "raw raster with a header";

/// A raw raster.
pub(super) struct RawRaster {
    path: PathBuf,
    info: RasterInfo,
    header: Header,
    nodata: Nodata,
    file: Option<File>,
    row: Vec<u8>,
}

impl RawRaster {
    /// Reads the header and checks the length of the file.
    pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let bytes = std::fs::metadata(path).map_err(|e| DemError::io(path, &e))?.len();
        let mut header = Header::read(path)?;
        let (nx, ny, sample) = (header.nx, header.ny, header.sample);
        let needed = header.needed_bytes().filter(|needed| *needed <= bytes);
        let Some(needed) = needed else {
            let detail = format!(
                "it holds {bytes} bytes, too few for {nx} x {ny} samples of {} as its header says; it is cut short: fetch \
                 it again",
                sample.name()
            );
            return Err(DemError::malformed(path, FORMAT, detail));
        };
        let mut notes = std::mem::take(&mut header.notes);
        if header.bands > 1 {
            notes.push(format!("the file has {} bands; the first is taken as heights", header.bands));
        } else if bytes > needed {
            notes.push(format!("the file holds {} bytes more than its header says", bytes - needed));
        }
        let nodata = match (options.nodata.or(header.nodata), sample.is_signed()) {
            (Some(value), _) => Nodata::new(Some(value), true),
            (None, true) => {
                let floats = if sample.is_float() { ", -9999" } else { "" };
                notes.push(format!("the header declares no NODATA value; -32768, -32767{floats} are taken as void"));
                Nodata::undeclared(true, sample.is_float())
            }
            (None, false) => Nodata::new(None, false),
        };
        let mut georeference = header.georeference;
        crs::override_epsg(&mut georeference, options.epsg, &mut notes);
        crs::check(path, &georeference, nx, ny)?;
        let unit_m = if sample.is_float() { FLOAT_UNIT_M } else { 1.0 };
        let format = format!("{}, {}", header.format, sample.name());
        let info = RasterInfo { format, nx, ny, georeference, unit_m, notes };
        Ok(Self { path: path.to_owned(), info, header, nodata, file: None, row: Vec::new() })
    }
}

impl Raster for RawRaster {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let io = |e| DemError::io(&self.path, &e);
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(File::open(&self.path).map_err(io)?),
        };
        let header = &self.header;
        let size = header.sample.bytes();
        let from_north = u64::from(self.info.ny - 1 - j);
        self.row.resize(header.row_span_bytes() as usize, 0);
        file.seek(SeekFrom::Start(header.skip + from_north * header.row_stride))
            .and_then(|_| file.read_exact(&mut self.row))
            .map_err(io)?;
        let stride = header.pixel_stride as usize;
        if stride != size {
            (1..out.len()).for_each(|i| self.row.copy_within(i * stride..i * stride + size, i * size));
        }
        let samples = &mut self.row[..out.len() * size];
        if header.big_endian != cfg!(target_endian = "big") {
            samples.chunks_exact_mut(size).for_each(<[u8]>::reverse);
        }
        header.sample.decode(samples, out);
        for (i, height) in (0..).zip(out.iter_mut()) {
            if self.nodata.is_void(*height) {
                *height = f64::NAN;
            } else if height.abs() > MAX_HEIGHT_M {
                return Err(DemError::ImpossibleHeight { path: self.path.clone(), i, j, height: *height });
            }
        }
        Ok(())
    }

    fn release(&mut self) {
        (self.file, self.row) = (None, Vec::new());
    }
}
