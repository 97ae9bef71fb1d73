//! USGS ASCII DEM (`.dem`), after USGS, "Standards for Digital Elevation Models, Part 2: Specifications" (1997): a header
//! (record A), then one profile (record B) a column, from west to east, each with heights from south to north.
//!
//! Taken: UTM in metres and longitude and latitude in arc-seconds; heights in metres or feet of any resolution, with a
//! profile's own datum; profiles that begin and end where they like, as those of 7.5-minute quadrangles do: posts beyond
//! their ends are void, and so are -32767 and -32768. Records of 1024 bytes, or lines of at most that. Datum 0, which is
//! older than the field, is NAD27, told in a note. Refused: state plane systems, rotated grids, profiles between the
//! columns, numbers that are none, fewer profiles than declared. Record C, which says how accurate the whole is, is
//! passed over.
//!
//! The file is read once when it is opened. Kept at hand: all samples, 4 bytes each for 6 bytes of text, in memory or, where
//! they are too many, in a file; and a band of rows of at most [`BAND_SAMPLES`] samples, or one row.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use crate::terrain::Georeference;

use super::nodata::Nodata;
use super::spool::Spool;
use super::{DemError, MAX_HEIGHT_M, OpenOptions, Progress, Raster, RasterInfo, crs};

/// The format's name in messages.
const FORMAT: &str = "USGS ASCII DEM";
/// Length of a record, and of a sample.
const RECORD_BYTES: usize = 1024;
const SAMPLE_BYTES: usize = 6;
/// Bytes of a sample at hand.
const SAMPLE_WORD: usize = 4;
/// Samples in a profile's first record after its head, and in each further one.
const HEAD_BYTES: usize = 144;
const FIRST_SAMPLES: usize = 146;
const MORE_SAMPLES: usize = 170;
/// Most samples of a band of rows at hand.
const BAND_SAMPLES: u32 = 1 << 19;
/// What a post has in a band where no profile is: no sample has so many digits.
const NOTHING: i32 = i32::MIN;
/// Most posts of the whole rectangle for each sample. A quadrangle fills nine tenths of its own, a diagonal strip less.
const MAX_POSTS_PER_SAMPLE: u64 = 64;
/// The most by which a profile may begin beside the lattice, in posts. A guess; the files print to the millimetre.
const MAX_SHIFT_POSTS: f64 = 0.01;
/// Profiles between two calls of the progress hook.
const PROGRESS_PROFILES: u32 = 64;
const FOOT_M: f64 = 0.3048;

/// One column.
struct Profile {
    /// The row of the first sample.
    south: u32,
    /// Height of its datum, in the file's unit.
    datum: f64,
    /// Number of its first sample among those of all profiles, and how many it has.
    first: u64,
    count: u32,
}

/// A USGS ASCII DEM.
pub(super) struct UsgsDem {
    path: PathBuf,
    info: RasterInfo,
    nodata: Nodata,
    /// File units a sample step, and metres a file unit.
    resolution: f64,
    file_unit_m: f64,
    /// From west to east.
    profiles: Vec<Profile>,
    /// The samples of all of them.
    samples: Spool,
    samples_bytes: u64,
    band_rows: u32,
    /// The band at hand, counted from the south, row by row.
    held: Option<u32>,
    band: Vec<i32>,
}

impl UsgsDem {
    /// Reads all of it.
    pub(super) fn open(
        path: &Path,
        options: &OpenOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self, DemError> {
        let mut records = Records::open(path)?;
        let Some(record) = records.next()? else { return Err(records.malformed("it has no header")) };
        let header = Header::read(&records, &record)?;
        let mut samples = Spool::new(options.memory_bytes);
        let (profiles, [west, south]) = read_profiles(&mut records, &header, &mut samples, progress)?;
        let ny = profiles.iter().map(|p| u64::from(p.south) + u64::from(p.count)).max().unwrap_or_default();
        let (nx, count) = (profiles.len() as u32, profiles.iter().map(|p| u64::from(p.count)).sum::<u64>());
        let ny = u32::try_from(ny).ok().filter(|ny| u64::from(nx) * u64::from(*ny) <= MAX_POSTS_PER_SAMPLE * count);
        let Some(ny) = ny.filter(|ny| *ny >= 2) else {
            return Err(records.malformed("its profiles are too scattered, or too short, to be a grid"));
        };
        let (map_unit, mut notes) = (header.map_unit, header.notes);
        let origin = [west * map_unit, south * map_unit];
        let step = header.step.map(|s| s * map_unit);
        let mut georeference = Georeference { epsg: header.epsg, geographic: header.geographic, origin, step };
        crs::override_epsg(&mut georeference, options.epsg, &mut notes);
        crs::check(path, &georeference, nx, ny)?;
        let nodata = options.nodata.map_or(Nodata::undeclared(true, false), |v| Nodata::new(Some(v), false));
        let unit_m = header.resolution * header.file_unit_m;
        let info = RasterInfo { format: header.format, nx, ny, georeference, unit_m, notes };
        let (resolution, file_unit_m) = (header.resolution, header.file_unit_m);
        Ok(Self {
            path: path.to_owned(),
            info,
            nodata,
            resolution,
            file_unit_m,
            profiles,
            samples,
            samples_bytes: count * SAMPLE_WORD as u64,
            band_rows: (BAND_SAMPLES / nx).clamp(1, ny),
            held: None,
            band: Vec::new(),
        })
    }

    /// Puts band `band` at hand.
    fn hold(&mut self, band: u32) -> Result<(), DemError> {
        if self.held == Some(band) {
            return Ok(());
        }
        self.held = None;
        let nx = self.profiles.len();
        let rows = band * self.band_rows..((band + 1) * self.band_rows).min(self.info.ny);
        self.band.clear();
        self.band.resize(rows.len() * nx, NOTHING);
        let mut room = vec![0; rows.len() * SAMPLE_WORD];
        for (i, profile) in self.profiles.iter().enumerate() {
            let (from, to) = (rows.start.max(profile.south), rows.end.min(profile.south + profile.count));
            if from >= to {
                continue;
            }
            let at = (profile.first + u64::from(from - profile.south)) * SAMPLE_WORD as u64;
            let bytes = self.samples.read_at(at, &mut room[..(to - from) as usize * SAMPLE_WORD]);
            let bytes = bytes.map_err(|e| DemError::io(&self.path, &e))?;
            for (j, sample) in (from - rows.start..).zip(bytes.as_chunks::<SAMPLE_WORD>().0) {
                self.band[j as usize * nx + i] = i32::from_ne_bytes(*sample);
            }
        }
        self.held = Some(band);
        Ok(())
    }
}

impl Raster for UsgsDem {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.hold(j / self.band_rows)?;
        let row = &self.band[(j % self.band_rows) as usize * out.len()..][..out.len()];
        for ((i, out), (&sample, profile)) in (0..).zip(out).zip(row.iter().zip(&self.profiles)) {
            if sample == NOTHING || self.nodata.is_void(sample.into()) {
                *out = f64::NAN;
                continue;
            }
            let height = (f64::from(sample) * self.resolution + profile.datum) * self.file_unit_m;
            // A datum that is no number fails here too.
            if height.is_nan() || height.abs() > MAX_HEIGHT_M {
                return Err(DemError::ImpossibleHeight { path: self.path.clone(), i, j, height });
            }
            *out = height;
        }
        Ok(())
    }

    fn release(&mut self) {
        (self.held, self.band) = (None, Vec::new());
    }

    fn limit_memory(&mut self, bytes: usize) -> Result<(), DemError> {
        self.samples.limit(bytes).map_err(|e| DemError::io(&self.path, &e))
    }

    fn memory_bytes(&self) -> u64 {
        self.samples_bytes.min(self.samples.most())
    }
}

/// Reads the profiles; also the map coordinates of the south-western post, in the file's unit.
fn read_profiles(
    records: &mut Records,
    header: &Header,
    spool: &mut Spool,
    progress: &mut dyn FnMut(Progress),
) -> Result<(Vec<Profile>, [f64; 2]), DemError> {
    let (mut profiles, mut first) = (Vec::new(), 0);
    let mut souths = Vec::new();
    let mut start = [0.0; 2];
    for column in 0..header.columns {
        if column.is_multiple_of(PROGRESS_PROFILES) {
            progress(Progress { done: records.done, total: records.bytes });
        }
        let Some(head) = records.next()? else {
            let detail =
                format!("it ends after {column} of {} profiles; it is cut short: fetch it again", header.columns);
            return Err(records.malformed(detail));
        };
        let bad = |what: &str| records.malformed(format!("profile {column}: {what}"));
        let field = Fields { record: &head };
        let [count, across] = [12, 18].map(|at| field.integer(at));
        let [Some(x), Some(y), Some(datum)] = [24, 48, 72].map(|at| field.real(at, 24)) else {
            return Err(bad("its head holds no place or datum"));
        };
        let Some(count) = count.and_then(|n| u32::try_from(n).ok()).filter(|n| *n > 0 && across == Some(1)) else {
            return Err(bad("its head does not say that it is one column of samples"));
        };
        if column == 0 {
            start = [x, y];
        }
        let at = [(x - start[0]) / header.step[0], (y - start[1]) / header.step[1]];
        let row = at[1].round();
        // Written so that what is no number fails.
        if !((at[0] - f64::from(column)).abs() <= MAX_SHIFT_POSTS && (at[1] - row).abs() <= MAX_SHIFT_POSTS) {
            return Err(bad(&format!("it begins at ({x}, {y}), which is not the next column of the grid")));
        }
        if row.abs() > f64::from(1_u32 << 30) {
            return Err(bad(&format!("it begins at ({x}, {y}), too far from the first")));
        }
        souths.push(row as i64);
        let samples = read_samples(records, head, count as usize, column)?;
        let bytes: Vec<_> = samples.iter().flat_map(|sample| sample.to_ne_bytes()).collect();
        spool.write_at(first * SAMPLE_WORD as u64, &bytes).map_err(|e| DemError::io(&records.path, &e))?;
        profiles.push(Profile { south: 0, datum, first, count });
        first += u64::from(count);
    }
    let least = souths.iter().copied().min().unwrap_or_default();
    for (profile, south) in profiles.iter_mut().zip(souths) {
        profile.south = u32::try_from(south - least).unwrap_or(u32::MAX);
    }
    progress(Progress { done: records.bytes, total: records.bytes });
    Ok((profiles, [start[0], start[1] + least as f64 * header.step[1]]))
}

/// The samples of a profile, over as many records as they take.
fn read_samples(records: &mut Records, head: Vec<u8>, count: usize, column: u32) -> Result<Vec<i32>, DemError> {
    let mut samples = Vec::new();
    let (mut record, mut from, mut room) = (head, HEAD_BYTES, FIRST_SAMPLES);
    loop {
        let fields = Fields { record: &record };
        for n in 0..room.min(count - samples.len()) {
            let Some(sample) = fields.integer(from + n * SAMPLE_BYTES) else {
                let detail = format!("profile {column}: sample {} is not a number", samples.len());
                return Err(records.malformed(detail));
            };
            samples.push(sample);
        }
        if samples.len() == count {
            return Ok(samples);
        }
        let Some(next) = records.next()? else {
            let detail = format!("it ends within profile {column}; it is cut short: fetch it again");
            return Err(records.malformed(detail));
        };
        (record, from, room) = (next, 0, MORE_SAMPLES);
    }
}

/// What record A says.
struct Header {
    columns: u32,
    geographic: bool,
    epsg: Option<u32>,
    /// Map units (metres or degrees) a unit of the file, and posts' distances in units of the file.
    map_unit: f64,
    step: [f64; 2],
    resolution: f64,
    file_unit_m: f64,
    format: String,
    notes: Vec<String>,
}

impl Header {
    /// Columns of the specification, counted from 0 here.
    fn read(records: &Records, record: &[u8]) -> Result<Self, DemError> {
        let fields = Fields { record };
        let bad = |what: String| records.malformed(what);
        let refuse = |what: String| DemError::refused(&records.path, what);
        let code = |at: usize, name: &str| fields.integer(at).ok_or_else(|| bad(format!("its header has no {name}")));
        if code(150, "pattern code")? != 1 {
            return Err(refuse("its posts are not a regular grid; only such are read".to_owned()));
        }
        if fields.real(786, 24).is_some_and(|angle| angle != 0.0) {
            return Err(refuse("its grid is rotated; warp it to north-up first, for example with gdalwarp".to_owned()));
        }
        let mut notes = Vec::new();
        let datum = Datum::of(record, &mut notes);
        let system = [code(156, "reference system")?, code(528, "unit of its ground coordinates")?];
        let (epsg, map_unit) = match system {
            [0, 3] => (datum.geographic(), 1.0 / 3600.0),
            [1, 2] => (datum.utm(code(162, "zone")?), 1.0),
            [system, unit] => {
                return Err(refuse(format!(
                    "its reference system has code {system} and unit code {unit}; only UTM in metres and longitude and \
                     latitude in arc-seconds are read: project it again, for example with gdalwarp"
                )));
            }
        };
        if epsg.is_none() {
            notes.push("its reference system has no EPSG code that is known here; say it with --crs EPSG:N".to_owned());
        }
        let file_unit_m = match code(534, "unit of its heights")? {
            1 => FOOT_M,
            2 => 1.0,
            other => return Err(bad(format!("its heights have unit code {other}, which is neither feet nor metres"))),
        };
        if file_unit_m != 1.0 {
            notes.push("heights are in feet in the file, and were turned into metres".to_owned());
        }
        let [x, y, z] = [816, 828, 840].map(|at| fields.real(at, 12).filter(|r| *r > 0.0 && r.is_finite()));
        let (Some(x), Some(y), Some(resolution)) = (x, y, z) else {
            return Err(bad("its header holds no spatial resolution".to_owned()));
        };
        let columns = code(858, "number of profiles")?;
        let Some(columns) = u32::try_from(columns).ok().filter(|n| *n >= 2) else {
            return Err(bad(format!("it has {columns} profiles; a grid has at least 2")));
        };
        let unit = if file_unit_m == 1.0 { "metres" } else { "feet" };
        let format = format!("{FORMAT}, steps of {resolution} {unit}");
        let (geographic, step) = (system[0] == 0, [x, y]);
        Ok(Self { columns, geographic, epsg, map_unit, step, resolution, file_unit_m, format, notes })
    }
}

/// A horizontal datum that the header may name.
#[derive(Clone, Copy)]
enum Datum {
    Nad27,
    Wgs72,
    Wgs84,
    Nad83,
    Other,
}

impl Datum {
    fn of(record: &[u8], notes: &mut Vec<String>) -> Self {
        let two = |at: usize| std::str::from_utf8(&record[at..at + 2]).unwrap_or_default().trim().to_owned();
        notes.push(match two(888).as_str() {
            "1" => "heights are above local mean sea level".to_owned(),
            "2" => "heights are above NGVD 29".to_owned(),
            "3" => "heights are above NAVD 88".to_owned(),
            _ => "the file does not name a vertical datum".to_owned(),
        });
        match two(890).as_str() {
            "1" => Self::Nad27,
            "2" => Self::Wgs72,
            "3" => Self::Wgs84,
            "4" => Self::Nad83,
            "" | "0" | "-9" => {
                notes.push("the file is older than the field for the horizontal datum; NAD27 is taken".to_owned());
                Self::Nad27
            }
            other => {
                notes.push(format!("the horizontal datum has the code {other:?}"));
                Self::Other
            }
        }
    }

    fn geographic(self) -> Option<u32> {
        Some(match self {
            Self::Nad27 => 4267,
            Self::Wgs72 => 4322,
            Self::Wgs84 => 4326,
            Self::Nad83 => 4269,
            Self::Other => return None,
        })
    }

    /// UTM north of the equator; the register has the two American datums for American zones only.
    fn utm(self, zone: i32) -> Option<u32> {
        let (base, last) = match self {
            Self::Nad27 => (26_700, 22),
            Self::Wgs72 => (32_200, 60),
            Self::Wgs84 => (32_600, 60),
            Self::Nad83 => (26_900, 23),
            Self::Other => return None,
        };
        u32::try_from(zone).ok().filter(|zone| (1..=last).contains(zone)).map(|zone| base + zone)
    }
}

/// The fixed columns of a record.
struct Fields<'a> {
    record: &'a [u8],
}

impl Fields<'_> {
    fn text(&self, at: usize, length: usize) -> Option<&str> {
        std::str::from_utf8(self.record.get(at..at + length)?).ok().map(str::trim)
    }

    /// An integer of six columns.
    fn integer(&self, at: usize) -> Option<i32> {
        self.text(at, SAMPLE_BYTES)?.parse().ok()
    }

    /// A number with Fortran's D or E exponent.
    fn real(&self, at: usize, length: usize) -> Option<f64> {
        self.text(at, length)?.replace(['D', 'd'], "E").parse().ok()
    }
}

/// The records of a file.
struct Records {
    path: PathBuf,
    reader: BufReader<File>,
    bytes: u64,
    done: u64,
    /// Whether each record is a line.
    lines: bool,
}

impl Records {
    fn open(path: &Path) -> Result<Self, DemError> {
        let open = || {
            let file = File::open(path)?;
            let bytes = file.metadata()?.len();
            let mut head = Vec::new();
            file.try_clone()?.take(RECORD_BYTES as u64 + 2).read_to_end(&mut head)?;
            let mut reader = BufReader::with_capacity(1 << 16, file);
            std::io::Seek::rewind(&mut reader)?;
            Ok((reader, bytes, head.contains(&b'\n')))
        };
        let (reader, bytes, lines) = open().map_err(|e| DemError::io(path, &e))?;
        Ok(Self { path: path.to_owned(), reader, bytes, done: 0, lines })
    }

    /// The next record, filled up with blanks, or `None` at the end of the file.
    fn next(&mut self) -> Result<Option<Vec<u8>>, DemError> {
        let mut record = Vec::with_capacity(RECORD_BYTES + 2);
        let read = if self.lines {
            std::io::BufRead::read_until(&mut self.reader.by_ref().take(RECORD_BYTES as u64 + 2), b'\n', &mut record)
        } else {
            self.reader.by_ref().take(RECORD_BYTES as u64).read_to_end(&mut record)
        };
        self.done += read.map_err(|e| DemError::io(&self.path, &e))? as u64;
        if record.is_empty() {
            return Ok(None);
        }
        if self.lines {
            while record.ends_with(b"\n") || record.ends_with(b"\r") {
                record.pop();
            }
            if record.len() > RECORD_BYTES {
                return Err(self.malformed(format!("a line is longer than {RECORD_BYTES} bytes")));
            }
        }
        record.resize(RECORD_BYTES, b' ');
        Ok(Some(record))
    }

    fn malformed(&self, detail: impl Into<String>) -> DemError {
        DemError::malformed(&self.path, FORMAT, detail)
    }
}
