//! A GeoTIFF of one byte a post, written in tiles in whatever order they are complete.
//!
//! It follows TIFF 6.0 (1992) and OGC GeoTIFF 1.1 (2019). A pixel is a post (PixelIsPoint), the first row is the
//! northernmost. Tiles are deflated and written as soon as they are full; what is left at the end are those that the
//! region does not fill, so memory is proportional to its reach. The directory comes last.

use std::{
    collections::BTreeMap,
    io::{self, SeekFrom, Write},
};

use flate2::{Compression, write::ZlibEncoder};

use crate::{
    cli::output::WriteSeek,
    los::{Tile, Verdict},
    terrain::{Georeference, PAGE_SIDE},
};

/// Pixels along the side of a tile; TIFF wants a multiple of 16.
const SIDE: u32 = 256;
/// The value of posts outside the region; the others' are in [`value`].
const OUTSIDE: u8 = 255;
/// A code that the GeoTIFF standard has for a reference system that is not named.
const USER_DEFINED: u16 = 32_767;

/// What a cell is in the file.
fn value(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Blocked => 0,
        Verdict::Visible => 1,
        Verdict::Unknown => 2,
    }
}

struct Part {
    bytes: Vec<u8>,
    filled: u32,
}

/// A GeoTIFF in the making.
pub(super) struct GeoTiff<'a> {
    out: &'a mut dyn WriteSeek,
    /// The westernmost column and the northernmost row.
    west: u32,
    north: u32,
    width: u32,
    height: u32,
    parts: BTreeMap<(u32, u32), Part>,
    /// Offset and length of each tile, by row.
    written: Vec<[u32; 2]>,
    end: u64,
}

impl<'a> GeoTiff<'a> {
    /// Begins a file for posts from `[west, south]` to `[east, north]`.
    pub(super) fn new(out: &'a mut dyn WriteSeek, [[west, south], [east, north]]: [[u32; 2]; 2]) -> io::Result<Self> {
        let (width, height) = (east - west + 1, north - south + 1);
        // Where the directory is, is known at the end.
        out.write_all(&[b'I', b'I', 42, 0, 0, 0, 0, 0])?;
        let tiles = width.div_ceil(SIDE) as usize * height.div_ceil(SIDE) as usize;
        Ok(Self { out, west, north, width, height, parts: BTreeMap::new(), written: vec![[0; 2]; tiles], end: 8 })
    }

    /// Adds the cells of a page.
    pub(super) fn add(&mut self, tile: &Tile) -> io::Result<()> {
        let (west, south) = (tile.page.pi * PAGE_SIDE, tile.page.pj * PAGE_SIDE);
        for (n, &verdict) in (0..).zip(&tile.cells) {
            let Some(verdict) = verdict else { continue };
            let (column, row) = (west + n % PAGE_SIDE - self.west, self.north - (south + n / PAGE_SIDE));
            let key = (row / SIDE, column / SIDE);
            let part = self
                .parts
                .entry(key)
                .or_insert_with(|| Part { bytes: vec![OUTSIDE; (SIDE * SIDE) as usize], filled: 0 });
            part.bytes[(row % SIDE * SIDE + column % SIDE) as usize] = value(verdict);
            part.filled += 1;
        }
        let full = |&(row, column): &(u32, u32), part: &Part| {
            let (wide, tall) = (SIDE.min(self.width - column * SIDE), SIDE.min(self.height - row * SIDE));
            part.filled == wide * tall
        };
        let ready: Vec<_> = self.parts.iter().filter(|(key, part)| full(key, part)).map(|(&key, _)| key).collect();
        for key in ready {
            self.put(key)?;
        }
        Ok(())
    }

    /// Writes a tile.
    fn put(&mut self, key: (u32, u32)) -> io::Result<()> {
        let bytes = self.parts.remove(&key).map_or_else(|| vec![OUTSIDE; (SIDE * SIDE) as usize], |part| part.bytes);
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(&bytes)?;
        let packed = encoder.finish()?;
        let (offset, len) = (u32::try_from(self.end), u32::try_from(packed.len()));
        let (Ok(offset), Ok(len)) = (offset, len) else {
            return Err(io::Error::other("more than 4 GiB: choose a smaller radius"));
        };
        self.written[(key.0 * self.width.div_ceil(SIDE) + key.1) as usize] = [offset, len];
        self.out.write_all(&packed)?;
        self.end += u64::from(len);
        Ok(())
    }

    /// Writes the tiles that are left, and the directory.
    pub(super) fn finish(mut self, place: Option<&Georeference>) -> io::Result<()> {
        let columns = self.width.div_ceil(SIDE);
        for n in 0..self.written.len() as u32 {
            if self.written[n as usize][1] == 0 {
                self.put((n / columns, n % columns))?;
            }
        }
        let longs = |k: usize| Value::Long(self.written.iter().map(|tile| tile[k]).collect());
        let mut tags = vec![
            (256, Value::Long(vec![self.width])),
            (257, Value::Long(vec![self.height])),
            (258, Value::Short(vec![8])),
            (259, Value::Short(vec![8])),
            (262, Value::Short(vec![1])),
            (277, Value::Short(vec![1])),
            (322, Value::Long(vec![SIDE])),
            (323, Value::Long(vec![SIDE])),
            (324, longs(0)),
            (325, longs(1)),
            (339, Value::Short(vec![1])),
        ];
        if let Some(place) = place {
            let [x, y] = place.map_from_grid(f64::from(self.west), f64::from(self.north));
            tags.push((33_550, Value::Double(vec![place.step[0], place.step[1], 0.0])));
            tags.push((33_922, Value::Double(vec![0.0, 0.0, 0.0, x, y, 0.0])));
            tags.push((34_735, Value::Short(geo_keys(place))));
        }
        tags.push((42_113, Value::Ascii(OUTSIDE.to_string())));
        if self.end % 2 == 1 {
            self.out.write_all(&[0])?;
            self.end += 1;
        }
        let start = u32::try_from(self.end).map_err(io::Error::other)?;
        let directory = directory(start, &tags);
        self.out.write_all(&directory)?;
        self.out.seek(SeekFrom::Start(4))?;
        self.out.write_all(&start.to_le_bytes())
    }
}

/// The key directory: version 1.1.0, then key, 0, 1, value of each.
fn geo_keys(place: &Georeference) -> Vec<u16> {
    let code = place.epsg.and_then(|epsg| u16::try_from(epsg).ok()).unwrap_or(USER_DEFINED);
    let (model, key) = if place.geographic { (2, 2048) } else { (1, 3072) };
    [[1, 1, 0, 3], [1024, 0, 1, model], [1025, 0, 1, 2], [key, 0, 1, code]].concat()
}

enum Value {
    Ascii(String),
    Short(Vec<u16>),
    Long(Vec<u32>),
    Double(Vec<f64>),
}

impl Value {
    /// Type code, count and bytes.
    fn encoded(&self) -> (u16, usize, Vec<u8>) {
        match self {
            Self::Ascii(text) => (2, text.len() + 1, [text.as_bytes(), &[0]].concat()),
            Self::Short(v) => (3, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Self::Long(v) => (4, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Self::Double(v) => (12, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        }
    }
}

/// A directory that stands at `start`, with the values that do not fit into it behind it.
fn directory(start: u32, tags: &[(u16, Value)]) -> Vec<u8> {
    let mut entries = (tags.len() as u16).to_le_bytes().to_vec();
    let mut behind = Vec::new();
    let after = start as usize + 2 + 12 * tags.len() + 4;
    for (tag, value) in tags {
        let (kind, count, mut bytes) = value.encoded();
        entries.extend(tag.to_le_bytes());
        entries.extend(kind.to_le_bytes());
        entries.extend((count as u32).to_le_bytes());
        if bytes.len() <= 4 {
            bytes.resize(4, 0);
            entries.extend(bytes);
        } else {
            entries.extend(((after + behind.len()) as u32).to_le_bytes());
            behind.extend(bytes);
            behind.resize(behind.len().next_multiple_of(2), 0);
        }
    }
    entries.extend([0; 4]);
    entries.extend(behind);
    entries
}
