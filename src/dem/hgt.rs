//! One SRTM tile: `.hgt`, raw or packed in `.zip` or `.gz`.
//!
//! A tile is a square of big-endian 16-bit heights in metres, north row first, without a header: its size tells the
//! spacing and its name the south-west corner (NASA/USGS, "SRTM Topography", section 3.1: `N44W072` is 44 degrees
//! north, 72 degrees west). Posts on the border are shared with the neighbours. -32768 is void.
//!
//! A raw tile is read row by row from the file. A packed one is unpacked whole when its first row is wanted: at most
//! 25 MiB, and never more than the two sizes that a tile can have, whatever the archive says. Where many are wanted at
//! once they are unpacked into nameless files in the folder for temporary ones.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use zip::ZipArchive;

use super::DemError;
use super::spool::nameless;

/// Posts along the side of a tile: 3 arc-seconds, 1 arc-second.
const SIDES: [u32; 2] = [1201, 3601];
/// The sample that stands for no data.
pub(super) const VOID: i16 = -32_768;
/// The format's name in messages.
pub(super) const FORMAT: &str = "SRTM .hgt tile";
/// Most files that a tile's zip archive may hold: the tile and a few texts.
const MAX_ZIP_ENTRIES: usize = 16;
/// Length of a zip archive's end record without its comment, and of the longest comment.
const ZIP_END_BYTES: usize = 22;
const MAX_ZIP_COMMENT_BYTES: usize = 65_535;

/// Posts along the side of a tile of `bytes`, unpacked.
pub(super) fn side_of(bytes: u64) -> Option<u32> {
    SIDES.into_iter().find(|&n| u64::from(n) * u64::from(n) * 2 == bytes)
}

/// The south-west corner of a tile in whole degrees.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) struct Corner {
    /// Degrees north.
    pub(super) lat: i32,
    /// Degrees east.
    pub(super) lon: i32,
}

impl Corner {
    /// The corner that a file name begins with, in either letter case: `N44W072.hgt`, `s30w178.SRTMGL1.hgt.zip`.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        let name = name.as_bytes();
        let digits = |range: std::ops::Range<usize>| {
            let text = name.get(range)?;
            text.iter().try_fold(0, |n, c| c.is_ascii_digit().then(|| n * 10 + i32::from(c - b'0')))
        };
        let sign = |at: usize, plus: u8, minus: u8| match name.get(at)?.to_ascii_uppercase() {
            c if c == plus => Some(1),
            c if c == minus => Some(-1),
            _ => None,
        };
        let corner = Self { lat: sign(0, b'N', b'S')? * digits(1..3)?, lon: sign(3, b'E', b'W')? * digits(4..7)? };
        ((-90..90).contains(&corner.lat) && (-180..180).contains(&corner.lon)).then_some(corner)
    }
}

impl std::fmt::Display for Corner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (ns, ew) = (if self.lat < 0 { 'S' } else { 'N' }, if self.lon < 0 { 'W' } else { 'E' });
        write!(f, "{ns}{:02}{ew}{:03}", self.lat.abs(), self.lon.abs())
    }
}

/// How a tile is packed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Packing {
    /// Not at all.
    Raw,
    /// The only `.hgt` entry of a zip archive.
    Zip,
    /// A gzip stream.
    Gzip,
}

/// What of a tile is at hand.
enum Held {
    Nothing,
    File(File),
    Bytes(Vec<u8>),
}

/// One tile, opened when its first row is read.
pub(super) struct Tile {
    path: PathBuf,
    packing: Packing,
    /// The south-west corner.
    pub(super) corner: Corner,
    /// Posts along a side.
    pub(super) side: u32,
    /// Whether it is unpacked into a file.
    pub(super) is_one_of_many: bool,
    held: Held,
    row: Vec<u8>,
}

impl Tile {
    /// Looks at the tile in `path`, of which nothing is kept at hand yet.
    pub(super) fn look(path: &Path, packing: Packing) -> Result<Self, DemError> {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let mut corner = Corner::from_name(&name);
        let mut file = File::open(path).map_err(|e| DemError::io(path, &e))?;
        let bytes = match packing {
            Packing::Raw => file.metadata().map_err(|e| DemError::io(path, &e))?.len(),
            Packing::Gzip => gzip_declared_bytes(path, &mut file)?,
            Packing::Zip => {
                let mut archive = open_zip(path, file)?;
                let entry = hgt_entry(path, &mut archive)?;
                let inside = Corner::from_name(&entry.name);
                if let (Some(a), Some(b)) = (corner, inside)
                    && a != b
                {
                    let detail = format!("the archive is named {a} but holds {b}; rename it, or fetch it again");
                    return Err(DemError::malformed(path, FORMAT, detail));
                }
                corner = corner.or(inside);
                entry.bytes
            }
        };
        let side = side_of(bytes).ok_or_else(|| wrong_size(path, bytes))?;
        let corner = corner.ok_or_else(|| {
            let detail = "its name does not say where it lies; name it after its south-west corner, as in N44W072.hgt";
            DemError::malformed(path, FORMAT, detail)
        })?;
        Ok(Self {
            path: path.to_owned(),
            packing,
            corner,
            side,
            held: Held::Nothing,
            row: Vec::new(),
            is_one_of_many: false,
        })
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Lets go of what is at hand.
    pub(super) fn release(&mut self) {
        self.held = Held::Nothing;
    }

    /// Big-endian samples of row `j`, counted from the south, west to east.
    pub(super) fn row(&mut self, j: u32) -> Result<&[u8], DemError> {
        if matches!(self.held, Held::Nothing) {
            self.held = self.load()?;
        }
        let length = self.side as usize * 2;
        let start = (self.side - 1 - j) as usize * length;
        match &mut self.held {
            Held::Bytes(bytes) => Ok(&bytes[start..start + length]),
            Held::File(file) => {
                self.row.resize(length, 0);
                file.seek(SeekFrom::Start(start as u64))
                    .and_then(|_| file.read_exact(&mut self.row))
                    .map_err(|e| DemError::io(&self.path, &e))?;
                Ok(&self.row)
            }
            Held::Nothing => unreachable!("loaded above"),
        }
    }

    fn load(&self) -> Result<Held, DemError> {
        let file = File::open(&self.path).map_err(|e| DemError::io(&self.path, &e))?;
        match self.packing {
            Packing::Raw => Ok(Held::File(file)),
            Packing::Gzip => self.unpack(GzDecoder::new(file)),
            Packing::Zip => {
                let mut archive = open_zip(&self.path, file)?;
                let entry = hgt_entry(&self.path, &mut archive)?;
                let stream = archive.by_index(entry.index).map_err(|e| zip_error(&self.path, &e))?;
                self.unpack(stream)
            }
        }
    }

    /// Unpacks exactly one tile into a file.
    fn unpack_to_file(&self, mut stream: impl Read) -> Result<Held, DemError> {
        let bad = |e: std::io::Error| DemError::malformed(&self.path, FORMAT, format!("it cannot be unpacked: {e}"));
        let mut file = nameless().map_err(|e| DemError::io(&std::env::temp_dir(), &e))?;
        let want = u64::from(self.side) * u64::from(self.side) * 2;
        let copied = std::io::copy(&mut stream.by_ref().take(want), &mut file).map_err(bad)?;
        if copied < want {
            return Err(wrong_size(&self.path, copied));
        }
        self.expect_end(stream)?;
        Ok(Held::File(file))
    }

    /// Reading on to the end makes the unpacker check its sum.
    fn expect_end(&self, mut stream: impl Read) -> Result<(), DemError> {
        let bad = |e: std::io::Error| DemError::malformed(&self.path, FORMAT, format!("it cannot be unpacked: {e}"));
        if stream.read(&mut [0]).map_err(bad)? != 0 {
            let want = u64::from(self.side) * u64::from(self.side) * 2;
            let detail = format!("it unpacks to more than the {want} bytes that it declares; fetch it again");
            return Err(DemError::malformed(&self.path, FORMAT, detail));
        }
        Ok(())
    }

    /// Unpacks exactly one tile, in two steps, so that a lying archive costs no more than it really holds.
    fn unpack(&self, mut stream: impl Read) -> Result<Held, DemError> {
        if self.is_one_of_many {
            return self.unpack_to_file(stream);
        }
        let bad = |e: std::io::Error| DemError::malformed(&self.path, FORMAT, format!("it cannot be unpacked: {e}"));
        let want = self.side as usize * self.side as usize * 2;
        let mut bytes = Vec::new();
        for step in [want / 16, want] {
            bytes.reserve_exact(step - bytes.len());
            let missing = (step - bytes.len()) as u64;
            stream.by_ref().take(missing).read_to_end(&mut bytes).map_err(bad)?;
            if bytes.len() < step {
                return Err(wrong_size(&self.path, bytes.len() as u64));
            }
        }
        self.expect_end(stream)?;
        Ok(Held::Bytes(bytes))
    }
}

fn wrong_size(path: &Path, bytes: u64) -> DemError {
    let [three, one] = SIDES.map(|n| u64::from(n) * u64::from(n) * 2);
    let detail = format!(
        "it holds {bytes} bytes, a tile holds {three} (1201 x 1201, 3 arc-seconds) or {one} (3601 x 3601, 1 \
         arc-second); it is cut short or something else: fetch it again"
    );
    DemError::malformed(path, FORMAT, detail)
}

/// The unpacked length that a gzip file's last four bytes declare; checked when it is unpacked.
fn gzip_declared_bytes(path: &Path, file: &mut File) -> Result<u64, DemError> {
    let mut last = [0; 4];
    match file.seek(SeekFrom::End(-4)).and_then(|_| file.read_exact(&mut last)) {
        Ok(()) => Ok(u64::from(u32::from_le_bytes(last))),
        Err(e) => Err(DemError::io(path, &e)),
    }
}

fn zip_error(path: &Path, error: &zip::result::ZipError) -> DemError {
    DemError::malformed(path, "zip archive of an SRTM .hgt tile", format!("{error}; fetch it again"))
}

/// Opens an archive after a look at its end record: the number of entries that it declares is allocated for at once.
fn open_zip(path: &Path, mut file: File) -> Result<ZipArchive<File>, DemError> {
    let entries = zip_entries(&mut file).map_err(|e| DemError::io(path, &e))?;
    match entries {
        Some(1..=MAX_ZIP_ENTRIES) => ZipArchive::new(file).map_err(|e| zip_error(path, &e)),
        Some(n) => {
            let detail = format!("the zip archive declares {n} files; a tile's holds one .hgt and at most some texts");
            Err(DemError::refused(path, detail))
        }
        None => {
            let detail = "it has no end record; it is cut short: fetch it again";
            Err(DemError::malformed(path, "zip archive of an SRTM .hgt tile", detail))
        }
    }
}

/// Entries that the last end record of a zip archive declares (APPNOTE.TXT, section 4.3.16).
fn zip_entries(file: &mut File) -> std::io::Result<Option<usize>> {
    let length = file.metadata()?.len();
    let tail_bytes = length.min((ZIP_END_BYTES + MAX_ZIP_COMMENT_BYTES) as u64);
    let mut tail = vec![0; tail_bytes as usize];
    file.seek(SeekFrom::Start(length - tail_bytes))?;
    file.read_exact(&mut tail)?;
    file.rewind()?;
    let end = tail.windows(ZIP_END_BYTES).rev().find(|w| w.starts_with(b"PK\x05\x06"));
    Ok(end.map(|w| usize::from(u16::from_le_bytes([w[10], w[11]]))))
}

/// The one `.hgt` entry of an archive.
struct HgtEntry {
    index: usize,
    name: String,
    bytes: u64,
}

fn hgt_entry(path: &Path, archive: &mut ZipArchive<File>) -> Result<HgtEntry, DemError> {
    let mut found = None;
    for index in 0..archive.len() {
        let entry = archive.by_index_raw(index).map_err(|e| zip_error(path, &e))?;
        let name = entry.name().rsplit(['/', '\\']).next().unwrap_or_default().to_owned();
        // macOS puts a hidden companion beside each file that it packs.
        if !name.to_ascii_lowercase().ends_with(".hgt") || name.starts_with('.') || entry.is_dir() {
            continue;
        }
        if entry.encrypted() {
            return Err(DemError::refused(path, "the zip archive is encrypted; unpack it first"));
        }
        if found.is_some() {
            return Err(DemError::refused(path, "the zip archive holds several .hgt files; unpack it first"));
        }
        found = Some(HgtEntry { index, name, bytes: entry.size() });
    }
    found.ok_or_else(|| DemError::refused(path, "the zip archive holds no .hgt file; unpack it first"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_gives_its_corner_in_any_letter_case_and_nothing_else_does() {
        let corner = |name| Corner::from_name(name).map(|c| (c.lat, c.lon));
        assert_eq!(corner("N44W072.hgt"), Some((44, -72)));
        assert_eq!(corner("s30e178.SRTMGL1.HGT.ZIP"), Some((-30, 178)));
        assert_eq!(corner("n00w000"), Some((0, 0)));
        for name in ["", "N44", "N4AW072.hgt", "X44W072.hgt", "N90E000.hgt", "N10E180.hgt", "N44W07", "44N072W.hgt"] {
            assert_eq!(corner(name), None, "{name}");
        }
        assert_eq!(Corner { lat: -3, lon: 7 }.to_string(), "S03E007");
    }

    #[test]
    fn a_tile_unpacked_into_a_file_is_the_same_tile() {
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("N44W072.hgt.gz");
        let pack = |bytes: &[u8]| {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(bytes).unwrap();
            std::fs::write(&path, encoder.finish().unwrap()).unwrap();
        };
        let samples: Vec<u8> = (0..1201 * 1201_u32).flat_map(|n| ((n % 1709) as i16).to_be_bytes()).collect();
        pack(&samples);
        let tile = |is_one_of_many| Tile { is_one_of_many, ..Tile::look(&path, Packing::Gzip).unwrap() };
        let [mut whole, mut in_file] = [false, true].map(tile);
        for j in [0, 1, 600, 1200] {
            assert_eq!(in_file.row(j).unwrap(), whole.row(j).unwrap(), "row {j}");
        }
        assert!(matches!((&whole.held, &in_file.held), (Held::Bytes(_), Held::File(_))));
        // Its end says that it is a tile, and it is not.
        for bytes in [&samples[..1000], &[&samples[..], &[0; 8]].concat()] {
            pack(bytes);
            let mut lying = std::fs::read(&path).unwrap();
            let end = lying.len() - 4;
            lying[end..].copy_from_slice(&(samples.len() as u32).to_le_bytes());
            std::fs::write(&path, lying).unwrap();
            assert!(tile(true).row(0).is_err(), "{} bytes", bytes.len());
        }
    }
}
