//! How an image's samples are stored, checked against the length of the file.

use std::path::Path;

use tiff_reader::Ifd;

use crate::dem::DemError;
use crate::dem::sample::Sample;

/// Most bytes of a decoded band of blocks from west to east.
pub(super) const MAX_BAND_BYTES: usize = 1 << 30;
/// A block or band of this size is allowed whatever the file's length.
const FREE_BYTES: u64 = 1 << 20;
/// A block of this size (1024 x 1024 float32) may be left out whatever the file's length.
const FREE_MISSING_BYTES: u64 = 4 << 20;
/// Bands are made of as many rows of blocks as fit in this.
const BAND_BYTES: u64 = 1 << 20;
/// TIFF compression codes. JPEG and WebP exist as well, but lose what heights need.
const NONE: u16 = 1;
const LZW: u16 = 5;
const DEFLATE: [u16; 2] = [8, 32_946];
const PACK_BITS: u16 = 32_773;
const LERC: u16 = 34_887;
const ZSTD: u16 = 50_000;
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
    block_width: usize,
    block_height: usize,
    /// Rows of a band at hand: a multiple of the block's.
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
        let sample = sample_of(path, ifd, &raster)?;
        let (block_width, block_height) = block_size(ifd, width, height);
        if block_width == 0 || block_height == 0 {
            return Err(malformed("its blocks have no extent".to_owned()));
        }
        let row_of_blocks = (width as usize * sample.bytes()).saturating_mul(block_height) as u64;
        let band_blocks = (BAND_BYTES / row_of_blocks).max(1) as usize;
        let mut layout = Self {
            width,
            height,
            sample,
            bands: raster.samples_per_pixel,
            missing_blocks: 0,
            missing: Vec::new(),
            block_width,
            block_height,
            band_height: block_height.saturating_mul(band_blocks).min(height as usize),
        };
        let (planes, interleaved) =
            if raster.planar_configuration == 1 { (1, layout.bands) } else { (layout.bands, 1) };
        let table = layout.table(path, ifd, planes)?;
        let limits = Limits {
            file_bytes,
            ratio: greatest_ratio(ifd.compression()),
            block_bytes: (block_width as u64)
                .saturating_mul(block_height as u64)
                .saturating_mul((sample.bytes() * interleaved) as u64),
        };
        layout.check_blocks(path, &table, &limits)?;
        Ok(layout)
    }

    /// Columns and rows of blocks.
    fn blocks(&self) -> (usize, usize) {
        ((self.width as usize).div_ceil(self.block_width), (self.height as usize).div_ceil(self.block_height))
    }

    /// Offset and length of each block of the first band, of tables that are as long as the image needs.
    fn table(&self, path: &Path, ifd: &Ifd, planes: usize) -> Result<Vec<(u64, u64)>, DemError> {
        let (offsets, lengths) = if ifd.is_tiled() {
            (ifd.tile_offsets(), ifd.tile_byte_counts())
        } else {
            (ifd.strip_offsets(), ifd.strip_byte_counts())
        };
        let (offsets, lengths) = (offsets.unwrap_or_default(), lengths.unwrap_or_default());
        let (columns, rows) = self.blocks();
        let blocks = (columns * rows).checked_mul(planes);
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
    fn check_blocks(&mut self, path: &Path, table: &[(u64, u64)], limits: &Limits) -> Result<(), DemError> {
        let (columns, rows) = self.blocks();
        let mut band_stored = 0_u64;
        for (n, &(offset, stored)) in table.iter().enumerate() {
            if offset == 0 || stored == 0 {
                self.missing.resize(columns * rows, false);
                self.missing[n] = true;
                self.missing_blocks += 1;
                limits.check_missing(path)?;
            } else {
                limits.check_block(path, n, offset, stored)?;
            }
            band_stored = band_stored.saturating_add(stored);
            let below = (n / columns + 1) * self.block_height;
            let last = below >= self.height as usize || below.is_multiple_of(self.band_height);
            if last && (n + 1).is_multiple_of(columns) {
                self.check_band(path, band_stored, limits)?;
                band_stored = 0;
            }
        }
        Ok(())
    }

    fn check_band(&self, path: &Path, stored: u64, limits: &Limits) -> Result<(), DemError> {
        if stored > limits.file_bytes {
            let detail = format!("its blocks overlap: a row of them claims {stored} of {} bytes", limits.file_bytes);
            return Err(DemError::malformed(path, super::FORMAT, detail));
        }
        let bytes = self.band_height as u64 * u64::from(self.width) * self.sample.bytes() as u64;
        let allowed = FREE_BYTES.max(stored.saturating_mul(limits.ratio)).max(limits.file_bytes.saturating_mul(2));
        if bytes > allowed.min(MAX_BAND_BYTES as u64) {
            return Err(too_large(path, "a row of blocks", bytes, stored));
        }
        Ok(())
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

/// What a block may decode to.
struct Limits {
    file_bytes: u64,
    /// Most bytes that one stored byte can decode to.
    ratio: u64,
    /// Bytes of a decoded block.
    block_bytes: u64,
}

impl Limits {
    /// The decoder makes a block of zeros for one that is not stored.
    fn check_missing(&self, path: &Path) -> Result<(), DemError> {
        let allowed = FREE_MISSING_BYTES.max(self.file_bytes.saturating_mul(2)).min(MAX_BAND_BYTES as u64);
        if self.block_bytes > allowed {
            return Err(too_large(path, "a block", self.block_bytes, 0));
        }
        Ok(())
    }

    fn check_block(&self, path: &Path, n: usize, offset: u64, stored: u64) -> Result<(), DemError> {
        if offset.checked_add(stored).is_none_or(|end| end > self.file_bytes) {
            let detail = format!(
                "block {n} lies at bytes {offset} to {} of a file of {}; it is cut short: fetch it again",
                offset.saturating_add(stored),
                self.file_bytes
            );
            return Err(DemError::malformed(path, super::FORMAT, detail));
        }
        let allowed = FREE_BYTES.max(stored.saturating_mul(self.ratio)).min(MAX_BAND_BYTES as u64);
        if self.block_bytes > allowed {
            return Err(too_large(path, "a block", self.block_bytes, stored));
        }
        Ok(())
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
        let detail = format!("its compression, number {compression}, is not read; write it out with deflate");
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

fn too_large(path: &Path, what: &str, bytes: u64, stored: u64) -> DemError {
    let detail = format!(
        "{what} would decode to {bytes} bytes, more than {stored} stored bytes can hold or than is allowed at once; if \
         the file is sound, write it out with small tiles, for example with gdal_translate -co TILED=YES"
    );
    DemError::refused(path, detail)
}
