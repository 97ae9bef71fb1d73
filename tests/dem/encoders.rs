//! Small writers of the formats that are read, for samples of any content. They are as plain as the formats allow, so
//! that what a test asks for is what the file holds.

use std::io::Write;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};

/// A tile's bytes: `height(i, j)` from the south-west.
pub(crate) fn hgt(side: usize, height: impl Fn(usize, usize) -> i16) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(side * side * 2);
    for j in (0..side).rev() {
        for i in 0..side {
            bytes.extend(height(i, j).to_be_bytes());
        }
    }
    bytes
}

/// A DTED cell to be, whole seconds of longitude and latitude, tenths of an arc-second between posts.
#[derive(Clone, Debug)]
pub(crate) struct Dted {
    pub(crate) nx: usize,
    pub(crate) ny: usize,
    pub(crate) corner: (&'static str, &'static str),
    pub(crate) interval: (u32, u32),
    pub(crate) series: &'static str,
    pub(crate) datums: &'static str,
}

impl Default for Dted {
    fn default() -> Self {
        let corner = ("0070000E", "0500000N");
        Self { nx: 5, ny: 4, corner, interval: (30, 30), series: "DTED1", datums: "E96WGS84" }
    }
}

impl Dted {
    /// The file: `height(i, j)` from the south-west, `None` for void.
    pub(crate) fn encode(&self, height: impl Fn(usize, usize) -> Option<i16>) -> Vec<u8> {
        let mut uhl = format!(
            "UHL1{}{}{:04}{:04}0000U  {:12}{:04}{:04}0",
            self.corner.0, self.corner.1, self.interval.0, self.interval.1, "", self.nx, self.ny
        );
        uhl = format!("{uhl:80}");
        let mut dsi = format!("{:648}", "DSIU");
        let mut set = |at: usize, text: &str| dsi.replace_range(at..at + text.len(), text);
        set(59, self.series);
        set(141, self.datums);
        set(264, "0000000.0");
        let mut bytes = format!("{uhl}{dsi}{:2700}", "ACC").into_bytes();
        for i in 0..self.nx {
            let start = bytes.len();
            bytes.extend([0xaa, 0, 0, 0, (i >> 8) as u8, i as u8, 0, 0]);
            for j in 0..self.ny {
                let word = match height(i, j) {
                    Some(h) => h.unsigned_abs() | if h < 0 { 0x8000 } else { 0 },
                    None => 0xffff,
                };
                bytes.extend(word.to_be_bytes());
            }
            let sum: u32 = bytes[start..].iter().map(|b| u32::from(*b)).sum();
            bytes.extend(sum.to_be_bytes());
        }
        bytes
    }
}

/// `content` as a gzip stream.
pub(crate) fn gz(content: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

/// `content` as the entry `name` of a zip archive.
pub(crate) fn zip(name: &str, content: &[u8]) -> Vec<u8> {
    zip_of(&[(name, content)])
}

/// A zip archive of several entries.
pub(crate) fn zip_of(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in entries {
        writer.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
        writer.write_all(content).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// The codec of a TIFF sample.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Codec {
    None,
    Lzw,
    Deflate,
    PackBits,
    Lerc,
    Zstd,
}

impl Codec {
    pub(crate) const ALL: [Self; 6] = [Self::None, Self::Lzw, Self::Deflate, Self::PackBits, Self::Lerc, Self::Zstd];

    fn code(self) -> u32 {
        match self {
            Self::None => 1,
            Self::Lzw => 5,
            Self::Deflate => 8,
            Self::PackBits => 32_773,
            Self::Lerc => 34_887,
            Self::Zstd => 50_000,
        }
    }

    fn pack(self, block: &[u8], width: usize, height: usize, sample: &Samples) -> Vec<u8> {
        match self {
            Self::None => block.to_vec(),
            Self::Lzw => lzw(block),
            Self::Deflate => {
                let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
                encoder.write_all(block).unwrap();
                encoder.finish().unwrap()
            }
            Self::PackBits => pack_bits(block),
            Self::Lerc => lerc(block, width, height, sample),
            Self::Zstd => zstd(block),
        }
    }
}

fn lzw(block: &[u8]) -> Vec<u8> {
    weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(block).unwrap()
}

fn zstd(block: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(block, ruzstd::encoding::CompressionLevel::Fastest)
}

/// Runs of three equal bytes and more as such, and now and then a byte that says nothing.
fn pack_bits(mut block: &[u8]) -> Vec<u8> {
    let mut packed = Vec::new();
    while let Some(&first) = block.first() {
        let run_at = |from: usize| block[from..].iter().take(128).take_while(|byte| **byte == block[from]).count();
        let run = run_at(0);
        if run >= 3 {
            packed.extend([(1 - run as i16) as u8, first, 0x80]);
            block = &block[run..];
        } else {
            let length = (0..block.len().min(128)).find(|&at| run_at(at) >= 3).unwrap_or(block.len().min(128));
            packed.push(length as u8 - 1);
            packed.extend_from_slice(&block[..length]);
            block = &block[length..];
        }
    }
    packed
}

/// A Lerc2 blob of version 2, which has no sum: all posts valid, all values in one sweep.
fn lerc(block: &[u8], width: usize, height: usize, sample: &Samples) -> Vec<u8> {
    let mut blob = b"Lerc2 ".to_vec();
    let type_code = match sample {
        Samples::I16 => 2,
        Samples::U16 => 3,
        Samples::I32 => 4,
        Samples::F32 => 6,
        Samples::F64 => 7,
    };
    let size = 6 + 7 * 4 + 3 * 8 + 4 + 1 + block.len();
    for value in [2, height, width, width * height, 8, size, type_code] {
        blob.extend((value as i32).to_le_bytes());
    }
    for value in [0.0, -1e6, 1e6_f64] {
        blob.extend(value.to_le_bytes());
    }
    blob.extend([0, 0, 0, 0, 1]);
    blob.extend_from_slice(block);
    blob
}

/// The sample type of a TIFF.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Samples {
    I16,
    U16,
    I32,
    F32,
    F64,
}

impl Samples {
    pub(crate) const ALL: [Self; 5] = [Self::I16, Self::U16, Self::I32, Self::F32, Self::F64];

    fn format_and_bits(self) -> (u32, u32) {
        match self {
            Self::I16 => (2, 16),
            Self::U16 => (1, 16),
            Self::I32 => (2, 32),
            Self::F32 => (3, 32),
            Self::F64 => (3, 64),
        }
    }

    /// The sample's bytes, most significant first.
    fn bytes(self, value: f64) -> Vec<u8> {
        match self {
            Self::I16 => (value as i16).to_be_bytes().to_vec(),
            Self::U16 => (value as u16).to_be_bytes().to_vec(),
            Self::I32 => (value as i32).to_be_bytes().to_vec(),
            Self::F32 => (value as f32).to_be_bytes().to_vec(),
            Self::F64 => value.to_be_bytes().to_vec(),
        }
    }
}

/// What a TIFF sample is to be.
#[derive(Clone, Debug)]
pub(crate) struct Tiff {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) samples: Samples,
    pub(crate) codec: Codec,
    /// 1 none, 2 horizontal differences of integers, 3 floating point.
    pub(crate) predictor: u32,
    /// Tiles of this side; strips of as many rows when `None`.
    pub(crate) tile: Option<usize>,
    pub(crate) rows_per_strip: usize,
    pub(crate) big: bool,
    pub(crate) big_endian: bool,
    pub(crate) nodata: Option<&'static str>,
    /// GDAL's metadata in XML.
    pub(crate) metadata: Option<&'static str>,
    /// ModelPixelScale and ModelTiepoint, or ModelTransformation.
    pub(crate) doubles: Vec<(u16, Vec<f64>)>,
    /// GeoKeys: (key, value) pairs of one SHORT each.
    pub(crate) geokeys: Vec<(u16, u16)>,
    /// Blocks that are not stored.
    pub(crate) missing: Vec<usize>,
    /// Whether the bits of stored bytes are the other way round.
    pub(crate) bits_reversed: bool,
    /// Further tags of one LONG.
    pub(crate) extra: Vec<(u16, u32)>,
}

impl Default for Tiff {
    fn default() -> Self {
        Self {
            width: 9,
            height: 7,
            samples: Samples::I16,
            codec: Codec::None,
            predictor: 1,
            tile: None,
            rows_per_strip: 3,
            big: false,
            big_endian: false,
            nodata: None,
            metadata: None,
            doubles: vec![(33550, vec![0.5, 0.25, 0.0]), (33922, vec![0.0, 0.0, 0.0, 10.0, 50.0, 0.0])],
            geokeys: vec![(1024, 2), (1025, 1), (2048, 4326)],
            missing: Vec::new(),
            bits_reversed: false,
            extra: Vec::new(),
        }
    }
}

impl Tiff {
    /// The file: `height(i, row)` with rows from the north.
    pub(crate) fn encode(&self, height: impl Fn(usize, usize) -> f64) -> Vec<u8> {
        let (bw, bh) = self.tile.map_or((self.width, self.rows_per_strip), |side| (side, side));
        let mut blocks = Vec::new();
        for row in (0..self.height).step_by(bh) {
            for column in (0..self.width).step_by(bw) {
                let rows = if self.tile.is_some() { bh } else { bh.min(self.height - row) };
                let packed = self.block(&height, [column, row], [bw, rows]);
                blocks.push(if self.missing.contains(&blocks.len()) { Vec::new() } else { packed });
            }
        }
        self.assemble(&blocks)
    }

    fn block(
        &self,
        height: &impl Fn(usize, usize) -> f64,
        [west, north]: [usize; 2],
        [width, rows]: [usize; 2],
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        for row in north..north + rows {
            let inside = |i: usize| i < self.width && row < self.height;
            let values: Vec<_> = (west..west + width).map(|i| if inside(i) { height(i, row) } else { 0.0 }).collect();
            let samples: Vec<_> = values.iter().map(|v| self.samples.bytes(*v)).collect();
            bytes.extend(self.row(&samples));
        }
        let mut packed = self.codec.pack(&bytes, width, rows, &self.samples);
        if self.bits_reversed {
            packed.iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        }
        packed
    }

    fn row(&self, samples: &[Vec<u8>]) -> Vec<u8> {
        let size = samples[0].len();
        match self.predictor {
            3 => {
                let mut planes: Vec<_> = (0..size).flat_map(|byte| samples.iter().map(move |s| s[byte])).collect();
                for n in (1..planes.len()).rev() {
                    planes[n] = planes[n].wrapping_sub(planes[n - 1]);
                }
                planes
            }
            2 => {
                let value = |s: &Vec<u8>| s.iter().fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte));
                let mut last = 0;
                samples
                    .iter()
                    .flat_map(|s| {
                        let difference = value(s).wrapping_sub(std::mem::replace(&mut last, value(s)));
                        self.ordered(&difference.to_be_bytes()[8 - size..])
                    })
                    .collect()
            }
            // LERC blobs are little-endian in themselves.
            _ if self.codec == Codec::Lerc => samples.iter().flat_map(|s| s.iter().rev().copied()).collect(),
            _ => samples.iter().flat_map(|s| self.ordered(s)).collect(),
        }
    }

    /// Bytes, most significant first, in the file's order.
    fn ordered(&self, bytes: &[u8]) -> Vec<u8> {
        if self.big_endian { bytes.to_vec() } else { bytes.iter().rev().copied().collect() }
    }

    fn number(&self, value: u64, bytes: usize) -> Vec<u8> {
        self.ordered(&value.to_be_bytes()[8 - bytes..])
    }

    fn assemble(&self, blocks: &[Vec<u8>]) -> Vec<u8> {
        let (offset_size, entry, count_size) = if self.big { (8, 20, 8) } else { (4, 12, 2) };
        let header = if self.big { 16 } else { 8 };
        let mut data_at = header;
        let mut offsets = Vec::new();
        for block in blocks {
            offsets.push(if block.is_empty() { 0 } else { data_at as u32 });
            data_at += block.len();
        }
        let tags = self.tags(&offsets, blocks);
        let directory = data_at.next_multiple_of(8);
        let mut values_at = directory + count_size + tags.len() * entry + offset_size;
        let mut out = if self.big_endian { b"MM".to_vec() } else { b"II".to_vec() };
        out.extend(self.number(if self.big { 43 } else { 42 }, 2));
        if self.big {
            out.extend(self.number(8, 2));
            out.extend(self.number(0, 2));
        }
        out.extend(self.number(directory as u64, offset_size));
        blocks.iter().for_each(|block| out.extend(block));
        out.resize(directory, 0);
        out.extend(self.number(tags.len() as u64, count_size));
        let mut values = Vec::new();
        for (code, kind, count, bytes) in tags {
            out.extend(self.number(u64::from(code), 2));
            out.extend(self.number(kind, 2));
            out.extend(self.number(count as u64, offset_size));
            if bytes.len() <= offset_size {
                out.extend(&bytes);
                out.resize(out.len() + offset_size - bytes.len(), 0);
            } else {
                out.extend(self.number(values_at as u64, offset_size));
                values_at += bytes.len();
                values.extend(bytes);
            }
        }
        out.extend(self.number(0, offset_size));
        out.extend(values);
        out
    }

    /// Tags in order: code, type, count, value bytes.
    fn tags(&self, offsets: &[u32], blocks: &[Vec<u8>]) -> Vec<(u16, u64, usize, Vec<u8>)> {
        let (format, bits) = self.samples.format_and_bits();
        let short = |v: u32| (3, 1, self.number(u64::from(v), 2));
        let longs = |v: &[u32]| (4, v.len(), v.iter().flat_map(|v| self.number(u64::from(*v), 4)).collect::<Vec<_>>());
        let lengths: Vec<_> = blocks.iter().map(|b| b.len() as u32).collect();
        let mut tags = vec![
            (256, longs(&[self.width as u32])),
            (257, longs(&[self.height as u32])),
            (258, short(bits)),
            (259, short(self.codec.code())),
            (262, short(1)),
            (277, short(1)),
            (317, short(self.predictor)),
            (339, short(format)),
        ];
        if let Some(side) = self.tile {
            tags.extend([(322, longs(&[side as u32])), (323, longs(&[side as u32]))]);
            tags.extend([(324, longs(offsets)), (325, longs(&lengths))]);
        } else {
            tags.push((278, longs(&[self.rows_per_strip as u32])));
            tags.extend([(273, longs(offsets)), (279, longs(&lengths))]);
        }
        if self.bits_reversed {
            tags.push((266, short(2)));
        }
        if self.codec == Codec::Lerc {
            tags.push((50674, longs(&[2, 0])));
        }
        for (code, values) in &self.doubles {
            tags.push((*code, (12, values.len(), values.iter().flat_map(|v| self.number(v.to_bits(), 8)).collect())));
        }
        if !self.geokeys.is_empty() {
            let head = [1, 1, 0, self.geokeys.len() as u16];
            let keys = self.geokeys.iter().flat_map(|(key, value)| [*key, 0, 1, *value]);
            let shorts: Vec<_> = head.into_iter().chain(keys).collect();
            let bytes = shorts.iter().flat_map(|v| self.number(u64::from(*v), 2)).collect();
            tags.push((34735, (3, shorts.len(), bytes)));
        }
        for (code, text) in [(42112, self.metadata), (42113, self.nodata)] {
            if let Some(text) = text {
                let bytes = [text.as_bytes(), &[0]].concat();
                tags.push((code, (2, bytes.len(), bytes)));
            }
        }
        tags.extend(self.extra.iter().map(|(code, value)| (*code, longs(&[*value]))));
        tags.sort_by_key(|(code, _)| *code);
        tags.into_iter().map(|(code, (kind, count, bytes))| (code, kind, count, bytes)).collect()
    }
}

/// A USGS ASCII DEM to be: metres of UTM zone 10 or arc-seconds, and profiles of (row of the first sample, samples).
#[derive(Clone, Debug)]
pub(crate) struct Usgs {
    pub(crate) geographic: bool,
    pub(crate) feet: bool,
    pub(crate) resolution: [f64; 3],
    pub(crate) origin: [f64; 2],
    pub(crate) datum: &'static str,
    pub(crate) profile_datum: f64,
}

impl Default for Usgs {
    fn default() -> Self {
        let (resolution, origin) = ([30.0, 30.0, 1.0], [557_820.0, 5_108_100.0]);
        Self { geographic: false, feet: false, resolution, origin, datum: " 2 1", profile_datum: 0.0 }
    }
}

/// A number as Fortran writes it in 24 columns.
fn d24(value: f64) -> String {
    let text = format!("{value:.15e}");
    let (digits, exponent) = text.split_once('e').unwrap();
    let exponent: i32 = exponent.parse().unwrap();
    format!("{:>24}", format!("{digits}D{exponent:+03}"))
}

impl Usgs {
    /// The records, 1024 bytes each but for blanks at their ends.
    pub(crate) fn records(&self, profiles: &[(usize, Vec<i32>)]) -> Vec<String> {
        let mut a = format!("{:1024}", "A SMALL QUADRANGLE");
        let mut set = |at: usize, text: &str| a.replace_range(at..at + text.len(), text);
        let codes = [1, 1, i32::from(!self.geographic), if self.geographic { 0 } else { 10 }];
        set(144, &codes.map(|c| format!("{c:6}")).concat());
        let units = [if self.geographic { 3 } else { 2 }, if self.feet { 1 } else { 2 }, 4];
        set(528, &units.map(|c| format!("{c:6}")).concat());
        set(786, &d24(0.0));
        let [x, y, z] = self.resolution.map(|r| format!("{r:12.6}"));
        set(816, &format!("{x}{y}{z}{:6}{:6}", 1, profiles.len()));
        set(888, self.datum);
        let mut records = vec![a];
        for (column, (south, samples)) in profiles.iter().enumerate() {
            let x = self.origin[0] + column as f64 * self.resolution[0];
            let y = self.origin[1] + *south as f64 * self.resolution[1];
            let head = [1, column + 1, samples.len(), 1].map(|n| format!("{n:6}")).concat();
            let numbers = [x, y, self.profile_datum, 0.0, 0.0].map(d24).concat();
            let words: Vec<_> = samples.iter().map(|z| format!("{z:6}")).collect();
            let first = words.len().min(146);
            records.push(format!("{head}{numbers}{}", words[..first].concat()));
            records.extend(words[first..].chunks(170).map(|more| more.concat()));
        }
        records
    }

    /// The file, in records of 1024 bytes without line ends.
    pub(crate) fn encode(&self, profiles: &[(usize, Vec<i32>)]) -> Vec<u8> {
        self.records(profiles).iter().flat_map(|r| format!("{r:1024}").into_bytes()).collect()
    }

    /// The file, a line a record, without blanks at line ends.
    pub(crate) fn encode_lines(&self, profiles: &[(usize, Vec<i32>)]) -> Vec<u8> {
        self.records(profiles).iter().flat_map(|r| format!("{}\r\n", r.trim_end()).into_bytes()).collect()
    }
}

/// A PNG of `width` pixels a row.
pub(crate) fn png(width: usize, color: png::ColorType, depth: png::BitDepth, rows: &[u8]) -> Vec<u8> {
    let pixel = color.samples() * if depth == png::BitDepth::Sixteen { 2 } else { 1 };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, (rows.len() / pixel / width) as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(rows).unwrap();
    bytes
}
