//! How an image's samples are stored, checked against the length of the file.

use std::ops::Range;
use std::path::Path;

use tiff_reader::{ByteOrder, Ifd};

use super::rows::Coding;
use crate::dem::DemError;
use crate::dem::sample::Sample;

/// Most bytes of a block and of a band of blocks that are decoded at once.
pub(super) const MAX_BAND_BYTES: usize = 1 << 30;
/// A block of this size is allowed whatever the file's length, and a row of heights of eight times as many.
const FREE_BYTES: u64 = 1 << 20;
/// Bands are made of as many rows, or rows of blocks, as fit in this.
const BAND_BYTES: u64 = 1 << 20;
/// TIFF compression codes.
pub(super) const NONE: u16 = 1;
pub(super) const LZW: u16 = 5;
pub(super) const DEFLATE: [u16; 2] = [8, 32_946];
pub(super) const PACK_BITS: u16 = 32_773;
const LERC: u16 = 34_887;
pub(super) const ZSTD: u16 = 50_000;
/// Others that are met, by name. Some of them lose what heights need.
const OTHER_COMPRESSIONS: [(u16, &str); 9] = [
    (2, "CCITT RLE"),
    (3, "CCITT fax 3"),
    (4, "CCITT fax 4"),
    (6, "old JPEG"),
    (7, "JPEG"),
    (34_712, "JPEG 2000"),
    (34_925, "LZMA"),
    (50_001, "WebP"),
    (50_002, "JPEG XL"),
];
/// TIFF's orientation tag; 1 is north row first, west column first.
const TAG_ORIENTATION: u16 = 274;
/// Photometric interpretations of one-band rasters: white is zero, black is zero.
const GREY: [u16; 2] = [0, 1];

/// A checked layout.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) sample: Sample,
    /// Bands of the file, of which the first is read.
    pub(super) bands: usize,
    /// Number of blocks of the first band that are not stored.
    pub(super) missing_blocks: usize,
    /// Which ones, row by row of blocks; empty when there are none.
    missing: Vec<bool>,
    pub(super) block_width: usize,
    pub(super) block_height: usize,
    /// Samples of a pixel that a block holds, and parts of the table of blocks of which the first is for the first band.
    interleaved: usize,
    planes: usize,
    compression: u16,
    predictor: u16,
    /// Rows that are at hand together.
    band_height: usize,
}

impl Layout {
    /// Checks the directory of an image in a file of `file_bytes`.
    pub(super) fn check(path: &Path, ifd: &Ifd, file_bytes: u64) -> Result<Self, DemError> {
        let malformed = |detail: String| DemError::malformed(path, super::FORMAT, detail);
        let raster = ifd.raster_layout().map_err(|e| super::malformed(path, &e))?;
        let (width, height) = (ifd.width(), ifd.height());
        if [width, height].iter().any(|n| !(2..=(1 << 30) + 1).contains(n)) {
            return Err(malformed(format!("{width} x {height} posts; a grid has 2 to 2^30 + 1 posts a side")));
        }
        if u64::from(width) > FREE_BYTES.max(file_bytes / 4) {
            return Err(malformed(format!("rows of {width} posts are too long for a file of {file_bytes} bytes")));
        }
        let sample = sample_of(path, ifd, &raster)?;
        let (block_width, block_height) = block_size(ifd, width, height);
        if block_width == 0 || block_height == 0 {
            return Err(malformed("its blocks have no extent".to_owned()));
        }
        let bands = raster.samples_per_pixel;
        let (planes, interleaved) = if raster.planar_configuration == 1 { (1, bands) } else { (bands, 1) };
        let mut layout = Self {
            width,
            height,
            sample,
            bands,
            missing_blocks: 0,
            missing: Vec::new(),
            block_width,
            block_height,
            interleaved,
            planes,
            compression: ifd.compression(),
            predictor: raster.predictor,
            band_height: 1,
        };
        let table = layout.table(path, ifd)?;
        layout.check_blocks(path, &table, file_bytes)?;
        layout.use_whole_blocks();
        Ok(layout)
    }

    /// How samples are written, where rows of blocks can be had one by one.
    pub(super) fn coding(&self, ifd: &Ifd, order: ByteOrder, memory_bytes: usize) -> Option<Coding> {
        Coding::of(ifd, order, self.sample, self.predictor, self.interleaved, memory_bytes)
    }

    /// Makes bands of whole blocks.
    pub(super) fn use_whole_blocks(&mut self) {
        let blocks = (BAND_BYTES / self.rows_bytes(self.block_height)).max(1) as usize;
        self.band_height = self.block_height.saturating_mul(blocks).min(self.height as usize);
    }

    /// Makes bands of rows that are had one by one: any number of them where they can be had without those before them.
    pub(super) fn use_rows(&mut self, is_direct: bool) {
        let rows = if is_direct { (BAND_BYTES / self.rows_bytes(1)).max(1) as usize } else { self.block_height };
        self.band_height = rows.min(self.height as usize);
    }

    /// Bytes of heights of so many rows.
    pub(super) fn rows_bytes(&self, rows: usize) -> u64 {
        (u64::from(self.width) * self.sample.bytes() as u64).saturating_mul(rows as u64)
    }

    /// Bytes that a band of whole blocks takes while it is decoded on some threads: itself, and for each thread a block as it
    /// is stored and as it is decoded.
    pub(super) fn whole_bytes(&self, threads: usize) -> u64 {
        let blocks = self.blocks().0.saturating_mul(self.band_height.div_ceil(self.block_height)).min(threads);
        let band = self.rows_bytes(self.band_height);
        band.saturating_add(self.block_bytes().saturating_mul(2).saturating_mul(blocks as u64))
    }

    /// Bytes of a decoded block.
    fn block_bytes(&self) -> u64 {
        let posts = (self.block_width as u64).saturating_mul(self.block_height as u64);
        posts.saturating_mul((self.sample.bytes() * self.interleaved) as u64)
    }

    /// What is said where blocks are too large to be decoded at once and cannot be had row by row.
    pub(super) fn refusal(&self, path: &Path, memory_bytes: u64) -> DemError {
        let detail = format!(
            "its blocks are compressed with LERC and decode to {} bytes each, a row of them to {}, which does not fit into \
             the {memory_bytes} bytes that its reader may take; write it out with small tiles (gdal_translate -co \
             TILED=YES -co COMPRESS=DEFLATE), or give more --memory",
            self.block_bytes(),
            self.rows_bytes(self.band_height)
        );
        DemError::refused(path, detail)
    }

    /// Columns and rows of blocks.
    fn blocks(&self) -> (usize, usize) {
        ((self.width as usize).div_ceil(self.block_width), (self.height as usize).div_ceil(self.block_height))
    }

    /// Offset and length of each block of the first band, of tables that are as long as the image needs.
    pub(super) fn table(&self, path: &Path, ifd: &Ifd) -> Result<Vec<(u64, u64)>, DemError> {
        let (offsets, lengths) = if ifd.is_tiled() {
            (ifd.tile_offsets(), ifd.tile_byte_counts())
        } else {
            (ifd.strip_offsets(), ifd.strip_byte_counts())
        };
        let (offsets, lengths) = (offsets.unwrap_or_default(), lengths.unwrap_or_default());
        let (columns, rows) = self.blocks();
        let blocks = (columns * rows).checked_mul(self.planes);
        if blocks != Some(offsets.len()) || blocks != Some(lengths.len()) {
            let detail = format!(
                "{} x {} posts in blocks of {} x {} do not need tables of {} and {} blocks",
                self.width,
                self.height,
                self.block_width,
                self.block_height,
                offsets.len(),
                lengths.len()
            );
            return Err(DemError::malformed(path, super::FORMAT, detail));
        }
        Ok(offsets.into_iter().zip(lengths).take(columns * rows).collect())
    }

    /// Checks that each block is in the file, and that its stored bytes can hold what they decode to.
    fn check_blocks(&mut self, path: &Path, table: &[(u64, u64)], file_bytes: u64) -> Result<(), DemError> {
        let (columns, rows) = self.blocks();
        let mut row_stored = 0_u64;
        for (n, &(offset, stored)) in table.iter().enumerate() {
            if n.is_multiple_of(columns) {
                row_stored = 0;
            }
            if offset == 0 || stored == 0 {
                self.missing.resize(columns * rows, false);
                self.missing[n] = true;
                self.missing_blocks += 1;
                continue;
            }
            self.check_block(path, n, (offset, stored), file_bytes)?;
            row_stored = row_stored.saturating_add(stored);
            if row_stored > file_bytes {
                let detail = format!("its blocks overlap: a row of them claims {row_stored} of {file_bytes} bytes");
                return Err(DemError::malformed(path, super::FORMAT, detail));
            }
        }
        if self.missing_blocks == table.len() {
            return Err(DemError::refused(path, "none of its blocks is stored: it holds no heights"));
        }
        Ok(())
    }

    fn check_block(
        &self,
        path: &Path,
        n: usize,
        (offset, stored): (u64, u64),
        file_bytes: u64,
    ) -> Result<(), DemError> {
        if offset.checked_add(stored).is_none_or(|end| end > file_bytes) {
            let detail = format!(
                "block {n} lies at bytes {offset} to {} of a file of {file_bytes}; it is cut short: fetch it again",
                offset.saturating_add(stored)
            );
            return Err(DemError::malformed(path, super::FORMAT, detail));
        }
        let bytes = self.block_bytes();
        if bytes > FREE_BYTES.max(stored.saturating_mul(greatest_ratio(self.compression))) {
            let detail = format!(
                "block {n} would decode to {bytes} bytes, more than {stored} stored bytes can hold; if the file is sound, \
                 write it out with small tiles, for example with gdal_translate -co TILED=YES"
            );
            return Err(DemError::refused(path, detail));
        }
        Ok(())
    }

    /// The blocks that hold some of `rows`: number of each, its first column and row.
    pub(super) fn blocks_of(&self, rows: Range<usize>) -> impl Iterator<Item = (usize, [usize; 2])> {
        let (columns, (width, height)) = (self.blocks().0, (self.block_width, self.block_height));
        (rows.start / height..rows.end.div_ceil(height)).flat_map(move |row| {
            (0..columns).map(move |column| (row * columns + column, [column * width, row * height]))
        })
    }

    /// The band that holds row `row`, both counted from the north.
    pub(super) fn band_of(&self, row: usize) -> usize {
        row / self.band_height
    }

    /// First row of a band, and number of rows.
    pub(super) fn band_rows(&self, band: usize) -> (usize, usize) {
        let first = band * self.band_height;
        (first, self.band_height.min(self.height as usize - first))
    }

    /// Makes void what lies in blocks that are not stored.
    pub(super) fn mark_missing(&self, row: usize, out: &mut [f64]) {
        let (columns, _) = self.blocks();
        let first = row / self.block_height * columns;
        let Some(missing) = self.missing.get(first..first + columns) else { return };
        for (posts, _) in out.chunks_mut(self.block_width).zip(missing).filter(|(_, missing)| **missing) {
            posts.fill(f64::NAN);
        }
    }
}

fn sample_of(path: &Path, ifd: &Ifd, raster: &tiff_reader::RasterLayout) -> Result<Sample, DemError> {
    let photometric = ifd.photometric_interpretation().unwrap_or(GREY[1]);
    if !GREY.contains(&photometric) {
        let detail = "it is a colour picture, not a raster of heights; give the elevation file itself";
        return Err(DemError::refused(path, detail));
    }
    let orientation = ifd.tag(TAG_ORIENTATION).and_then(|tag| tag.value.as_u16()).unwrap_or(1);
    if orientation != 1 {
        let detail = format!("its rows are stored in orientation {orientation}; write it out with the north row first");
        return Err(DemError::refused(path, detail));
    }
    let compression = ifd.compression();
    if ![NONE, LZW, DEFLATE[0], DEFLATE[1], PACK_BITS, LERC, ZSTD].contains(&compression) {
        let name = OTHER_COMPRESSIONS.iter().find(|(code, _)| *code == compression).map_or("unnamed", |(_, name)| name);
        let detail = format!(
            "its compression, {name} (number {compression}), is not read; write it out with gdal_translate -co \
             COMPRESS=DEFLATE"
        );
        return Err(DemError::refused(path, detail));
    }
    Sample::from_tiff(raster.sample_format, raster.bits_per_sample).ok_or_else(|| {
        let detail = format!(
            "its samples (format {}, {} bits) are not read; write it out as int16, int32 or float32",
            raster.sample_format, raster.bits_per_sample
        );
        DemError::refused(path, detail)
    })
}

fn block_size(ifd: &Ifd, width: u32, height: u32) -> (usize, usize) {
    if ifd.is_tiled() {
        (ifd.tile_width().unwrap_or(0) as usize, ifd.tile_height().unwrap_or(0) as usize)
    } else {
        (width as usize, ifd.rows_per_strip().min(height) as usize)
    }
}

/// How many bytes one stored byte can decode to. For LZW: codes of at least 9 bits for strings of at most 4096 bytes.
/// For PackBits: two bytes for 128. For deflate: 1032 (zlib's documentation). ZSTD and LERC have no such bound; a block
/// more than 1032 times smaller than its samples is refused as one of deflate would be.
fn greatest_ratio(compression: u16) -> u64 {
    match compression {
        NONE => 1,
        LZW => 3641,
        PACK_BITS => 64,
        _ => 1032,
    }
}
