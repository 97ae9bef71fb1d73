//! What a raw raster's header says, whichever kind it is.

use std::ffi::OsString;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::dem::DemError;
use crate::dem::sample::Sample;
use crate::terrain::Georeference;

use super::{envi, esri};

/// The longest header that is taken.
const MAX_BYTES: u64 = 1 << 18;
/// Most posts along a side, as for any raster.
const MAX_SIDE: u64 = (1 << 30) + 1;
/// Most bands; hyperspectral rasters have a few hundred.
const MAX_BANDS: u64 = 65_536;

/// Where the samples of the first band lie, and what they mean.
pub(super) struct Header {
    /// The kind of header, for the description of the format.
    pub(super) format: &'static str,
    pub(super) nx: u32,
    pub(super) ny: u32,
    pub(super) bands: u64,
    pub(super) sample: Sample,
    pub(super) big_endian: bool,
    /// Bytes before the first sample, from one sample to the next, and from one row to the next.
    pub(super) skip: u64,
    pub(super) pixel_stride: u64,
    pub(super) row_stride: u64,
    pub(super) nodata: Option<f64>,
    pub(super) georeference: Georeference,
    pub(super) notes: Vec<String>,
}

impl Header {
    /// Reads the header beside `raster`.
    pub(super) fn read(raster: &Path) -> Result<Self, DemError> {
        let Some(path) = beside(raster) else {
            let found = "a raw raster without its header file".to_owned();
            return Err(DemError::Unsupported { path: raster.to_owned(), found });
        };
        let mut text = Vec::new();
        let file = File::open(&path).map_err(|e| DemError::io(&path, &e))?;
        file.take(MAX_BYTES).read_to_end(&mut text).map_err(|e| DemError::io(&path, &e))?;
        let text = String::from_utf8_lossy(&text);
        let text = text.trim_start_matches(['\u{feff}', ' ', '\r', '\n', '\t']);
        if text.starts_with("ENVI") { envi::read(&path, text) } else { esri::read(raster, &path, text) }
    }

    /// Bytes from a row's first sample to the end of its last.
    pub(super) fn row_span_bytes(&self) -> u64 {
        u64::from(self.nx - 1) * self.pixel_stride + self.sample.bytes() as u64
    }

    /// The least length of the file; `None` when that is beyond all files.
    pub(super) fn needed_bytes(&self) -> Option<u64> {
        let rows = u64::from(self.ny - 1).checked_mul(self.row_stride)?;
        self.skip.checked_add(rows)?.checked_add(self.row_span_bytes())
    }
}

/// The header beside a raster: `name.hdr`, or `name.bil.hdr`.
pub(in crate::dem) fn beside(raster: &Path) -> Option<PathBuf> {
    let appended = |extension: &str| {
        let mut name = OsString::from(raster);
        name.push(format!(".{extension}"));
        PathBuf::from(name)
    };
    let endings = ["hdr", "HDR", "Hdr"];
    let mut names = endings.iter().flat_map(|e| [raster.with_extension(e), appended(e)]);
    names.find(|path| path != raster && path.is_file())
}

/// How bands lie beside each other.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Interleave {
    /// Row after row, in each one band after the other.
    Bil,
    /// Post after post, in each one band after the other.
    Bip,
    /// Band after band.
    Bsq,
}

impl Interleave {
    pub(super) fn of(word: &str) -> Option<Self> {
        match word.trim().to_ascii_lowercase().as_str() {
            "bil" => Some(Self::Bil),
            "bip" => Some(Self::Bip),
            "bsq" => Some(Self::Bsq),
            _ => None,
        }
    }

    /// Bytes from one sample of the first band to the next, and from one of its rows to the next, without padding.
    /// No overflow: sides, bands and sizes are limited.
    pub(super) fn strides(self, nx: u32, bands: u64, sample: Sample) -> (u64, u64) {
        let size = sample.bytes() as u64;
        let row = u64::from(nx) * size;
        match self {
            Self::Bil => (size, row * bands),
            Self::Bip => (size * bands, row * bands),
            Self::Bsq => (size, row),
        }
    }
}

/// The words of a header by key, lower case, and errors about them.
pub(super) struct Words<'a> {
    pub(super) path: &'a Path,
    pub(super) words: Vec<(String, String)>,
}

impl Words<'_> {
    /// The last value of `key`.
    pub(super) fn get(&self, key: &str) -> Option<&str> {
        self.words.iter().rev().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }

    /// The number of `key`, if it is there.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>, DemError> {
        let Some(word) = self.get(key) else { return Ok(None) };
        let number = word.parse::<f64>().ok().filter(|n| n.is_finite());
        number.map(Some).ok_or_else(|| self.malformed(format!("{key} is {:?}, which is no number", clip(word))))
    }

    /// The whole number of `key`, if it is there.
    pub(super) fn count(&self, key: &str) -> Result<Option<u64>, DemError> {
        let Some(word) = self.get(key) else { return Ok(None) };
        let number = word.parse::<u64>().ok();
        number.map(Some).ok_or_else(|| self.malformed(format!("{key} is {:?}, which is no whole number", clip(word))))
    }

    /// The number of posts along a side.
    pub(super) fn side(&self, key: &str) -> Result<u32, DemError> {
        let n = self.count(key)?.ok_or_else(|| self.malformed(format!("{key} is missing")))?;
        let detail = || self.malformed(format!("{key} is {n}; a grid has 2 to 2^30 + 1 posts a side"));
        u32::try_from(n).ok().filter(|_| (2..=MAX_SIDE).contains(&n)).ok_or_else(detail)
    }

    /// The number of bands, 1 when it is not given.
    pub(super) fn bands(&self, key: &str) -> Result<u64, DemError> {
        let n = self.count(key)?.unwrap_or(1);
        let detail = || self.malformed(format!("{key} is {n}; 1 to {MAX_BANDS} bands are read"));
        (1..=MAX_BANDS).contains(&n).then_some(n).ok_or_else(detail)
    }

    pub(super) fn malformed(&self, detail: impl Into<String>) -> DemError {
        DemError::malformed(self.path, "header of a raw raster", detail)
    }

    pub(super) fn refused(&self, detail: impl Into<String>) -> DemError {
        DemError::refused(self.path, detail)
    }
}

/// The beginning of a word, for a message.
pub(super) fn clip(word: &str) -> String {
    word.chars().take(40).collect()
}
