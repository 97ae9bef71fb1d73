//! DTED levels 0, 1 and 2 (`.dt0`, `.dt1`, `.dt2`), after MIL-PRF-89020B, "Digital Terrain Elevation Data", section 3.13
//! and appendix: three headers of fixed width (UHL, DSI, ACC), then one record a meridian, from west to east, of
//! big-endian sign-magnitude heights in metres from south to north, with a check sum.
//!
//! Posts are as far apart east as the header says: cells in the zones beyond 50 degrees of latitude have fewer meridians,
//! so their east and north steps differ. -32767 is void. Taken besides: tape labels (VOL, HDR) before the headers, and
//! bytes after the last record, with a note. Refused: a check sum that is wrong, meridians that are missing or out of
//! order, a rotated grid, and heights beyond -12,000 to 9,000 m, the format's range: those come from writers of
//! two's-complement numbers, whose other negative heights cannot be told from positive ones of wrong sign.
//!
//! When the first row is read all records are checked in one pass. Kept at hand: a band of rows of at most
//! [`BAND_SAMPLES`] samples, or one row.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::terrain::Georeference;

use super::{DemError, OpenOptions, Raster, RasterInfo, crs};

/// The format's name in messages.
const FORMAT: &str = "DTED cell";
/// Lengths of the three headers, and of a tape label.
const UHL_BYTES: usize = 80;
const DSI_BYTES: usize = 648;
const ACC_BYTES: usize = 2700;
const LABEL_BYTES: usize = 80;
/// Most tape labels before the headers.
const MAX_LABELS: usize = 8;
/// A record's mark, its header with the mark, and its check sum.
const MARK: u8 = 0xaa;
const RECORD_HEAD_BYTES: usize = 8;
const SUM_BYTES: usize = 4;
/// The sample that stands for no data, once decoded.
const VOID: i32 = -32_767;
/// Heights that the format allows.
const RANGE_M: Range<i32> = -12_000..9_001;
/// Most samples of a band of rows at hand.
const BAND_SAMPLES: usize = 1 << 19;
/// Tenths of an arc-second in a degree.
const TENTHS: f64 = 36_000.0;

/// A DTED cell.
pub(super) struct Dted {
    path: PathBuf,
    info: RasterInfo,
    /// Where the first record begins.
    records: u64,
    nodata: Option<f64>,
    /// Whether all records were checked.
    checked: bool,
    file: Option<File>,
    band_rows: u32,
    /// The band at hand, counted from the south, and its samples, meridian after meridian.
    held: Option<u32>,
    band: Vec<u8>,
}

impl Dted {
    /// Reads the headers.
    pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let mut file = File::open(path).map_err(|e| DemError::io(path, &e))?;
        let bytes = file.metadata().map_err(|e| DemError::io(path, &e))?.len();
        let mut head = Vec::new();
        let wanted = MAX_LABELS * LABEL_BYTES + UHL_BYTES + DSI_BYTES;
        file.by_ref().take(wanted as u64).read_to_end(&mut head).map_err(|e| DemError::io(path, &e))?;
        let labels = head
            .chunks_exact(LABEL_BYTES)
            .take(MAX_LABELS)
            .take_while(|l| l.starts_with(b"VOL") || l.starts_with(b"HDR"))
            .count();
        let start = labels * LABEL_BYTES;
        let Some(head) = head.get(start..start + UHL_BYTES + DSI_BYTES) else {
            return Err(malformed(path, "it ends within its headers; it is cut short: fetch it again"));
        };
        let header = Header { path, uhl: &head[..UHL_BYTES], dsi: &head[UHL_BYTES..] };
        let records = (start + UHL_BYTES + DSI_BYTES + ACC_BYTES) as u64;
        let info = header.describe(options)?;
        let needed = records + u64::from(info.nx) * record_bytes(info.ny) as u64;
        let mut dted = Self {
            path: path.to_owned(),
            records,
            nodata: options.nodata,
            checked: false,
            file: None,
            band_rows: (BAND_SAMPLES / info.nx as usize).clamp(1, info.ny as usize) as u32,
            held: None,
            band: Vec::new(),
            info,
        };
        if bytes < needed {
            let (nx, ny) = (dted.info.nx, dted.info.ny);
            let detail = format!(
                "it holds {bytes} bytes, {nx} meridians of {ny} posts take {needed}; it is cut short: fetch it again"
            );
            return Err(malformed(path, detail));
        }
        if bytes > needed {
            dted.info.notes.push(format!("{} bytes after the last record are passed over", bytes - needed));
        }
        Ok(dted)
    }

    /// Checks all records, once.
    fn check(&mut self) -> Result<(), DemError> {
        if self.checked {
            return Ok(());
        }
        let file = File::open(&self.path).map_err(|e| DemError::io(&self.path, &e))?;
        let mut reader = BufReader::with_capacity(1 << 16, file);
        reader.seek(SeekFrom::Start(self.records)).map_err(|e| DemError::io(&self.path, &e))?;
        let mut record = vec![0; record_bytes(self.info.ny)];
        for meridian in 0..self.info.nx {
            reader.read_exact(&mut record).map_err(|e| DemError::io(&self.path, &e))?;
            let bad = |what: &str| malformed(&self.path, format!("the record of meridian {meridian} {what}"));
            let (content, sum) = record.split_at(record.len() - SUM_BYTES);
            if content[0] != MARK {
                return Err(bad("does not begin with its mark; it is damaged: fetch it again"));
            }
            let says = u16::from_be_bytes([content[4], content[5]]);
            if u32::from(says) != meridian {
                return Err(bad(&format!("says that it is meridian {says}: some are missing or out of order")));
            }
            let found = content.iter().fold(0_u32, |sum, byte| sum.wrapping_add(u32::from(*byte)));
            let declared = u32::from_be_bytes([sum[0], sum[1], sum[2], sum[3]]);
            if found != declared {
                let what = format!("has the check sum {found}, not {declared} as it says; fetch it again");
                return Err(bad(&what));
            }
        }
        self.checked = true;
        Ok(())
    }

    /// Puts band `band` at hand.
    fn hold(&mut self, band: u32) -> Result<(), DemError> {
        if self.held == Some(band) {
            return Ok(());
        }
        self.check()?;
        self.held = None;
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(File::open(&self.path).map_err(|e| DemError::io(&self.path, &e))?),
        };
        let south = band * self.band_rows;
        let rows = self.band_rows.min(self.info.ny - south) as usize;
        self.band.resize(rows * self.info.nx as usize * 2, 0);
        let record = record_bytes(self.info.ny) as u64;
        let first = self.records + RECORD_HEAD_BYTES as u64 + u64::from(south) * 2;
        for (meridian, samples) in (0..).zip(self.band.chunks_exact_mut(rows * 2)) {
            file.seek(SeekFrom::Start(first + meridian * record))
                .and_then(|_| file.read_exact(samples))
                .map_err(|e| DemError::io(&self.path, &e))?;
        }
        self.held = Some(band);
        Ok(())
    }

    fn out_of_range(&self, i: u32, j: u32, height: i32) -> DemError {
        let detail = format!(
            "the height at post ({i}, {j}) is {height}, beyond the format's -12000 to 9000 m; negative heights seem to \
             be written as two's complement, not sign and magnitude: write the cell again, for example with \
             gdal_translate -of DTED; or say what it means with --nodata={height}"
        );
        malformed(&self.path, detail)
    }
}

impl Raster for Dted {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let band = j / self.band_rows;
        self.hold(band)?;
        let south = band * self.band_rows;
        let meridian_bytes = self.band_rows.min(self.info.ny - south) as usize * 2;
        let at = (j - south) as usize * 2;
        for ((i, out), samples) in (0..).zip(out).zip(self.band.chunks_exact(meridian_bytes)) {
            let height = sign_magnitude([samples[at], samples[at + 1]]);
            *out = match f64::from(height) {
                metres if height == VOID || self.nodata == Some(metres) => f64::NAN,
                metres if RANGE_M.contains(&height) => metres,
                _ => return Err(self.out_of_range(i, j, height)),
            };
        }
        Ok(())
    }

    fn release(&mut self) {
        (self.file, self.held, self.band) = (None, None, Vec::new());
    }
}

fn malformed(path: &Path, detail: impl Into<String>) -> DemError {
    DemError::malformed(path, FORMAT, detail)
}

fn record_bytes(ny: u32) -> usize {
    RECORD_HEAD_BYTES + ny as usize * 2 + SUM_BYTES
}

/// The highest bit is the sign, the others are the magnitude.
fn sign_magnitude(bytes: [u8; 2]) -> i32 {
    let word = i32::from(u16::from_be_bytes(bytes));
    if word & 0x8000 == 0 { word } else { -(word & 0x7fff) }
}

/// The headers that say how to read the cell.
struct Header<'a> {
    path: &'a Path,
    uhl: &'a [u8],
    dsi: &'a [u8],
}

impl Header<'_> {
    fn describe(&self, options: &OpenOptions) -> Result<RasterInfo, DemError> {
        if !self.uhl.starts_with(b"UHL") || !self.dsi.starts_with(b"DSI") {
            return Err(malformed(self.path, "it does not begin with the headers UHL and DSI"));
        }
        let steps = [(20..24, "longitude interval"), (24..28, "latitude interval")];
        let counts = [(47..51, "number of meridians"), (51..55, "number of posts a meridian")];
        let (nx, ny) = (self.count(counts[0].clone())?, self.count(counts[1].clone())?);
        let mut step = [0.0; 2];
        for (step, (range, name)) in step.iter_mut().zip(steps) {
            *step = f64::from(self.number(self.uhl, range, name)?) / TENTHS;
        }
        let origin = [self.angle(4, "longitude", *b"EW")?, self.angle(12, "latitude", *b"NS")?];
        // Empty or a number that is 0.
        let angle = text(&self.dsi[264..273]);
        if angle.parse::<f64>().map_or(!angle.is_empty(), |angle| angle != 0.0) {
            let detail =
                format!("its grid is rotated by {angle}; warp it to north-up first, for example with gdalwarp");
            return Err(DemError::refused(self.path, detail));
        }
        let mut georeference = Georeference { epsg: None, geographic: true, origin, step };
        let mut notes = Vec::new();
        georeference.epsg = match text(&self.dsi[144..149]).as_str() {
            "WGS84" => Some(4326),
            "WGS72" => Some(4322),
            other => {
                notes.push(format!("the horizontal datum is named {other:?}; its longitudes and latitudes are kept"));
                None
            }
        };
        notes.push(match text(&self.dsi[141..144]).as_str() {
            "MSL" => "heights are above mean sea level, by the file's word".to_owned(),
            "E96" => "heights are above the EGM96 geoid, by the file's word".to_owned(),
            other => format!("the vertical datum is named {other:?}"),
        });
        if step[0] != step[1] {
            notes.push(format!(
                "posts lie {} arc-seconds apart east and {} north, as is usual towards the poles",
                step[0] * 3600.0,
                step[1] * 3600.0
            ));
        }
        let series = text(&self.dsi[59..64]);
        self.note_level(&series, &mut notes);
        crs::override_epsg(&mut georeference, options.epsg, &mut notes);
        crs::check(self.path, &georeference, nx, ny)?;
        let level = series.strip_prefix("DTED").map_or_else(|| "unnamed".to_owned(), str::to_owned);
        Ok(RasterInfo { format: format!("DTED, level {level}"), nx, ny, georeference, unit_m: 1.0, notes })
    }

    /// Notes a file name that promises another level than the headers.
    fn note_level(&self, series: &str, notes: &mut Vec<String>) {
        let named = self.path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        if let Some(level) = named.strip_prefix("dt")
            && series.strip_prefix("DTED").is_some_and(|says| says != level)
        {
            notes.push(format!("the file is named .{named} but holds {series}; it is read as its headers say"));
        }
    }

    fn number(&self, header: &[u8], range: Range<usize>, name: &str) -> Result<u32, DemError> {
        let word = text(&header[range]);
        let digits = !word.is_empty() && word.bytes().all(|c| c.is_ascii_digit());
        let value = word.parse().ok().filter(|_| digits);
        value.ok_or_else(|| malformed(self.path, format!("its {name} is {word:?}, which is no number")))
    }

    fn count(&self, (range, name): (Range<usize>, &str)) -> Result<u32, DemError> {
        let n = self.number(self.uhl, range, name)?;
        let detail = || malformed(self.path, format!("its {name} is {n}; a grid has at least 2 posts a side"));
        (n >= 2).then_some(n).ok_or_else(detail)
    }

    /// An angle of the south-west corner, written DDDMMSSH from `at` on, in degrees.
    fn angle(&self, at: usize, name: &str, [plus, minus]: [u8; 2]) -> Result<f64, DemError> {
        let [degrees, minutes, seconds] =
            [at..at + 3, at + 3..at + 5, at + 5..at + 7].map(|r| self.number(self.uhl, r, name));
        let value = f64::from(degrees?) + f64::from(minutes?) / 60.0 + f64::from(seconds?) / 3600.0;
        match self.uhl[at + 7] {
            half if half == plus => Ok(value),
            half if half == minus => Ok(-value),
            half => {
                let [half, plus, minus] = [half, plus, minus].map(char::from);
                Err(malformed(self.path, format!("its {name} ends in {half:?}, not in {plus} or {minus}")))
            }
        }
    }
}

/// Header text without the blanks around it.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim_matches(|c: char| c.is_whitespace() || c == '\0').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_sign_and_magnitude() {
        let cases = [(0, 0), (1, 1), (0x7fff, 32_767), (0x8001, -1), (0x8000, 0), (0x8057, -87), (0xffff, VOID)];
        for (word, height) in cases {
            assert_eq!(sign_magnitude(u16::to_be_bytes(word)), height, "{word:#x}");
        }
    }
}
