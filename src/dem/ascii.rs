//! Esri ASCII grids (`.asc`), after Esri's "ASCII raster format": a header of words and numbers, then `ncols` x `nrows`
//! numbers, north row first.
//!
//! Taken: any letter case and order of the header; `xllcorner` or `xllcenter` for each axis; `cellsize`, or `dx` and
//! `dy`; a missing `NODATA_value` means -9999 as Esri says; rows broken over lines. Refused, naming the line: words
//! that are no numbers, too few values, too many.
//!
//! The file is scanned once when it is opened, to count the values and note where each band of rows begins. Kept at
//! hand: 16 bytes a band, and one band of at least one row and at most [`BAND_VALUES`] values.

use std::fs::File;
use std::io::{BufRead, BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::terrain::Georeference;

use super::nodata::Nodata;
use super::{DemError, FLOAT_UNIT_M, MAX_HEIGHT_M, OpenOptions, Progress, Raster, RasterInfo, crs, prj};

/// The format's name in messages.
const FORMAT: &str = "Esri ASCII grid";
/// The longest word that is taken; the longest f64 in full has fewer significant characters in any sane file.
const MAX_WORD_BYTES: usize = 512;
/// Values of a band, when rows are shorter.
const BAND_VALUES: u32 = 8192;
/// Values between two calls of the progress hook.
const PROGRESS_VALUES: u64 = 1 << 18;
/// What a file without `NODATA_value` means by it.
const DEFAULT_NODATA: f64 = -9999.0;

/// An Esri ASCII grid.
pub(super) struct AsciiGrid {
    path: PathBuf,
    info: RasterInfo,
    nodata: Nodata,
    /// Where each band begins, from the north.
    bands: Vec<Place>,
    band_rows: u32,
    /// The band at hand.
    held: Option<usize>,
    values: Vec<f64>,
}

impl AsciiGrid {
    /// Reads the header and counts the values.
    pub(super) fn open(
        path: &Path,
        options: &OpenOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self, DemError> {
        let mut words = Words::at(path, Place { offset: 0, line: 1 })?;
        let header = Header::read(&mut words)?;
        let nodata = Nodata::new(Some(options.nodata.or(header.nodata).unwrap_or(DEFAULT_NODATA)), true);
        let band_rows = (BAND_VALUES / header.nx).max(1);
        let (bands, whole) = scan(&mut words, &header, nodata, band_rows, progress)?;
        let mut georeference = header.georeference;
        let mut notes = Vec::new();
        prj::read(path, &mut georeference, &mut notes)?;
        crs::override_epsg(&mut georeference, options.epsg, &mut notes);
        crs::check(path, &georeference, header.nx, header.ny)?;
        let (kind, unit_m) = if whole { ("whole metres", 1.0) } else { ("decimals", FLOAT_UNIT_M) };
        let format = format!("{FORMAT}, {kind}");
        let info = RasterInfo { format, nx: header.nx, ny: header.ny, georeference, unit_m, notes };
        Ok(Self { path: path.to_owned(), info, nodata, bands, band_rows, held: None, values: Vec::new() })
    }

    /// Puts band `band` at hand.
    fn hold(&mut self, band: usize) -> Result<(), DemError> {
        if self.held == Some(band) {
            return Ok(());
        }
        self.held = None;
        let north = band as u32 * self.band_rows;
        let rows = self.band_rows.min(self.info.ny - north);
        let mut words = Words::at(&self.path, self.bands[band])?;
        self.values.clear();
        for n in 0..rows * self.info.nx {
            let Some(word) = words.next()? else {
                return Err(words.error("the file has become shorter since it was opened"));
            };
            let value = number(word).ok_or_else(|| words.not_a_number())?;
            let void = self.nodata.is_void(value);
            if !void && value.abs() > MAX_HEIGHT_M {
                let (i, j) = (n % self.info.nx, self.info.ny - 1 - north - n / self.info.nx);
                return Err(DemError::ImpossibleHeight { path: self.path.clone(), i, j, height: value });
            }
            self.values.push(if void { f64::NAN } else { value });
        }
        self.held = Some(band);
        Ok(())
    }
}

impl Raster for AsciiGrid {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let from_north = self.info.ny - 1 - j;
        self.hold((from_north / self.band_rows) as usize)?;
        let start = (from_north % self.band_rows) as usize * out.len();
        out.copy_from_slice(&self.values[start..start + out.len()]);
        Ok(())
    }
}

/// Counts the values and notes the bands; also whether all are whole numbers.
fn scan(
    words: &mut Words,
    header: &Header,
    nodata: Nodata,
    band_rows: u32,
    progress: &mut dyn FnMut(Progress),
) -> Result<(Vec<Place>, bool), DemError> {
    let total = u64::from(header.nx) * u64::from(header.ny);
    let band_values = u64::from(band_rows) * u64::from(header.nx);
    let (mut bands, mut whole, mut count) = (Vec::new(), true, 0_u64);
    while let Some(word) = words.next()? {
        if count == total {
            let detail = format!("more than the {} x {} values that the header declares", header.nx, header.ny);
            return Err(words.error(&detail));
        }
        if whole && !word.iter().all(|c| c.is_ascii_digit() || matches!(c, b'+' | b'-')) {
            let value = number(word).ok_or_else(|| words.not_a_number())?;
            whole = value.fract() == 0.0 || nodata.is_void(value);
        }
        if count.is_multiple_of(band_values) {
            bands.push(words.word_place);
        }
        if count.is_multiple_of(PROGRESS_VALUES) {
            progress(Progress { done: words.here.offset, total: words.bytes });
        }
        count += 1;
    }
    if count < total {
        let detail = format!(
            "the file ends after {count} of the {} x {} = {total} values that the header declares; it is cut short: \
             fetch it again",
            header.nx, header.ny
        );
        return Err(words.error(&detail));
    }
    progress(Progress { done: words.bytes, total: words.bytes });
    Ok((bands, whole))
}

fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// What the header says.
struct Header {
    nx: u32,
    ny: u32,
    georeference: Georeference,
    nodata: Option<f64>,
}

/// The words of a header, and the numbers after them as met.
const KEYS: [&str; 10] =
    ["ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "dx", "dy", "nodata_value"];

impl Header {
    fn read(words: &mut Words) -> Result<Self, DemError> {
        let mut values = [None; KEYS.len()];
        while let Some(word) = words.next()? {
            let text = String::from_utf8_lossy(word).to_ascii_lowercase();
            let Some(key) = KEYS.iter().position(|k| *k == text.trim_start_matches('\u{feff}')) else {
                if number(word).is_none() {
                    let detail = format!("{:?} is neither a word of the header nor a number", clip(&text));
                    return Err(words.error(&detail));
                }
                words.again = true;
                break;
            };
            if values[key].is_some() {
                return Err(words.error(&format!("{} is given twice", KEYS[key])));
            }
            let Some(word) = words.next()? else { return Err(words.error("the header ends in the middle")) };
            values[key] = Some(number(word).ok_or_else(|| words.not_a_number())?);
        }
        Self::from_values(words, values)
    }

    fn from_values(words: &Words, values: [Option<f64>; KEYS.len()]) -> Result<Self, DemError> {
        let [columns, rows, xll, xll_centre, yll, yll_centre, cell, dx, dy, nodata] = values;
        let wanted = |value: Option<f64>, name: &str| {
            value.ok_or_else(|| words.error(&format!("the header does not give {name}")))
        };
        let count = |value: Option<f64>, name: &str| {
            let n = wanted(value, name)?;
            let fits = (2.0..=f64::from((1_u32 << 30) + 1)).contains(&n) && n.fract() == 0.0;
            let detail = format!("{name} is {n}; a grid has 2 to 2^30 + 1 posts a side");
            fits.then_some(n as u32).ok_or_else(|| words.error(&detail))
        };
        let step = [wanted(dx.or(cell), "cellsize")?, wanted(dy.or(cell), "cellsize")?];
        let origin = |corner: Option<f64>, centre: Option<f64>, step: f64, name: &str| match (corner, centre) {
            (_, Some(at)) => Ok(at),
            (Some(at), None) => Ok(at + 0.5 * step),
            (None, None) => wanted(None, name),
        };
        let origin = [origin(xll, xll_centre, step[0], "xllcorner")?, origin(yll, yll_centre, step[1], "yllcorner")?];
        let georeference = Georeference { epsg: None, geographic: false, origin, step };
        Ok(Self { nx: count(columns, "ncols")?, ny: count(rows, "nrows")?, georeference, nodata })
    }
}

/// A place in the text.
#[derive(Clone, Copy, Debug)]
struct Place {
    offset: u64,
    line: u64,
}

/// The words of a text file, with where each begins.
struct Words {
    path: PathBuf,
    reader: BufReader<File>,
    bytes: u64,
    here: Place,
    word: Vec<u8>,
    word_place: Place,
    /// Whether the last word is to be given again.
    again: bool,
}

impl Words {
    fn at(path: &Path, here: Place) -> Result<Self, DemError> {
        let open = || {
            let mut file = File::open(path)?;
            file.seek(SeekFrom::Start(here.offset))?;
            let bytes = file.metadata()?.len();
            Ok((BufReader::with_capacity(1 << 16, file), bytes))
        };
        let (reader, bytes) = open().map_err(|e| DemError::io(path, &e))?;
        Ok(Self { path: path.to_owned(), reader, bytes, here, word: Vec::new(), word_place: here, again: false })
    }

    /// The next word, or `None` at the end of the file.
    fn next(&mut self) -> Result<Option<&[u8]>, DemError> {
        if std::mem::take(&mut self.again) {
            return Ok(Some(&self.word));
        }
        self.word.clear();
        loop {
            let chunk = self.reader.fill_buf().map_err(|e| DemError::io(&self.path, &e))?;
            if chunk.is_empty() {
                return Ok((!self.word.is_empty()).then_some(&self.word));
            }
            let (mut used, mut done) = (0, false);
            for &c in chunk {
                if c.is_ascii_whitespace() {
                    done = !self.word.is_empty();
                    if done {
                        break;
                    }
                    self.here.line += u64::from(c == b'\n');
                } else {
                    if self.word.is_empty() {
                        self.word_place = Place { offset: self.here.offset + used as u64, line: self.here.line };
                    }
                    self.word.push(c);
                    done = self.word.len() > MAX_WORD_BYTES;
                }
                used += 1;
                if done {
                    break;
                }
            }
            self.reader.consume(used);
            self.here.offset += used as u64;
            if self.word.len() > MAX_WORD_BYTES {
                return Err(self.not_a_number());
            }
            if done {
                return Ok(Some(&self.word));
            }
        }
    }

    fn error(&self, detail: &str) -> DemError {
        DemError::malformed(&self.path, FORMAT, format!("line {}: {detail}", self.word_place.line))
    }

    fn not_a_number(&self) -> DemError {
        self.error(&format!("{:?} is not a number", clip(&String::from_utf8_lossy(&self.word))))
    }
}

/// The beginning of a word, for a message.
fn clip(word: &str) -> String {
    word.chars().take(24).collect()
}
