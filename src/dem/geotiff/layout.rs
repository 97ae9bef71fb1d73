//! How an image's samples are stored, checked against the length of the file.

use std::path::Path;

use tiff_reader::Ifd;

use crate::dem::DemError;

/// Most bytes of a decoded band of blocks from west to east.
pub(super) const MAX_BAND_BYTES: usize = 1 << 30;
/// A block or band of this size is allowed whatever the file's length.
const FREE_BYTES: u64 = 1 << 20;
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

/// The type of a sample.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Sample {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl Sample {
    /// From TIFF's SampleFormat (1 unsigned, 2 signed, 3 floating point) and BitsPerSample.
    fn from_tiff(format: u16, bits: u16) -> Option<Self> {
        Some(match (format, bits) {
            (1, 8) => Self::U8,
            (2, 8) => Self::I8,
            (1, 16) => Self::U16,
            (2, 16) => Self::I16,
            (1, 32) => Self::U32,
            (2, 32) => Self::I32,
            (3, 32) => Self::F32,
            (3, 64) => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    pub(super) fn is_signed(self) -> bool {
        !matches!(self, Self::U8 | Self::U16 | Self::U32)
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    /// Samples in the machine's byte order as f64, which holds each of these types exactly.
    pub(super) fn decode(self, bytes: &[u8], out: &mut [f64]) {
        fn each<const N: usize>(bytes: &[u8], out: &mut [f64], value: impl Fn([u8; N]) -> f64) {
            for (height, sample) in out.iter_mut().zip(bytes.as_chunks::<N>().0) {
                *height = value(*sample);
            }
        }
        match self {
            Self::U8 => each(bytes, out, |b| u8::from_ne_bytes(b).into()),
            Self::I8 => each(bytes, out, |b| i8::from_ne_bytes(b).into()),
            Self::U16 => each(bytes, out, |b| u16::from_ne_bytes(b).into()),
            Self::I16 => each(bytes, out, |b| i16::from_ne_bytes(b).into()),
            Self::U32 => each(bytes, out, |b| u32::from_ne_bytes(b).into()),
            Self::I32 => each(bytes, out, |b| i32::from_ne_bytes(b).into()),
            Self::F32 => each(bytes, out, |b| f32::from_ne_bytes(b).into()),
            Self::F64 => each(bytes, out, f64::from_ne_bytes),
        }
    }
}

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
        let columns = (width as usize).div_ceil(block_width);
        let rows = (height as usize).div_ceil(block_height);
        let planes = if raster.planar_configuration == 1 { 1 } else { raster.samples_per_pixel };
        let (offsets, lengths) = if ifd.is_tiled() {
            (ifd.tile_offsets(), ifd.tile_byte_counts())
        } else {
            (ifd.strip_offsets(), ifd.strip_byte_counts())
        };
        let (Some(offsets), Some(lengths)) = (offsets, lengths) else {
            return Err(malformed("it has no table of its blocks".to_owned()));
        };
        let blocks = (columns * rows).checked_mul(planes);
        if blocks != Some(offsets.len()) || blocks != Some(lengths.len()) {
            let detail = format!(
                "{width} x {height} posts in blocks of {block_width} x {block_height} do not need a table of {} and {} \
                 blocks",
                offsets.len(),
                lengths.len()
            );
            return Err(malformed(detail));
        }
        let interleaved = if planes == 1 { raster.samples_per_pixel } else { 1 };
        let row_bytes = width as usize * sample.bytes();
        let band_blocks = (BAND_BYTES / (row_bytes * block_height).max(1) as u64).max(1) as usize;
        let layout = Self {
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
        layout.check_blocks(path, ifd, &offsets, &lengths, interleaved, file_bytes)
    }

    /// Checks that each block is in the file, and that its stored bytes can hold what they decode to.
    fn check_blocks(
        mut self,
        path: &Path,
        ifd: &Ifd,
        offsets: &[u64],
        lengths: &[u64],
        interleaved: usize,
        file_bytes: u64,
    ) -> Result<Self, DemError> {
        let columns = (self.width as usize).div_ceil(self.block_width);
        let rows = (self.height as usize).div_ceil(self.block_height);
        let ratio = greatest_ratio(ifd.compression());
        let pixel_bytes = (self.sample.bytes() * interleaved) as u64;
        let block_bytes =
            (self.block_width as u64).saturating_mul(self.block_height as u64).saturating_mul(pixel_bytes);
        let mut band_stored = 0_u64;
        for n in 0..columns * rows {
            let (row, column) = (n / columns, n % columns);
            let (offset, stored) = (offsets[n], lengths[n]);
            if offset == 0 || stored == 0 {
                self.missing.resize(columns * rows, false);
                self.missing[n] = true;
                self.missing_blocks += 1;
            } else if offset.checked_add(stored).is_none_or(|end| end > file_bytes) {
                let detail = format!(
                    "block {n} lies at bytes {offset} to {} of a file of {file_bytes}; it is cut short: fetch it again",
                    offset.saturating_add(stored)
                );
                return Err(DemError::malformed(path, super::FORMAT, detail));
            } else if block_bytes > FREE_BYTES.max(stored.saturating_mul(ratio)) {
                return Err(too_large(path, "a block", block_bytes, stored));
            }
            band_stored = band_stored.saturating_add(stored);
            let below = (row + 1) * self.block_height;
            if column + 1 == columns && (below >= self.height as usize || below.is_multiple_of(self.band_height)) {
                if band_stored > file_bytes {
                    let detail =
                        format!("its blocks overlap: a row of them claims {band_stored} of {file_bytes} bytes");
                    return Err(DemError::malformed(path, super::FORMAT, detail));
                }
                self.check_band(path, band_stored.saturating_mul(ratio).max(2 * file_bytes))?;
                band_stored = 0;
            }
        }
        if block_bytes > MAX_BAND_BYTES as u64 {
            return Err(too_large(path, "a block", block_bytes, file_bytes));
        }
        Ok(self)
    }

    fn check_band(&self, path: &Path, allowed: u64) -> Result<(), DemError> {
        let bytes = self.band_height as u64 * u64::from(self.width) * self.sample.bytes() as u64;
        if bytes > FREE_BYTES.max(allowed).min(MAX_BAND_BYTES as u64) {
            return Err(too_large(path, "a row of blocks", bytes, allowed));
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
        let columns = (self.width as usize).div_ceil(self.block_width);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_come_out_exactly() {
        let mut out = [0.0; 2];
        let bytes: Vec<_> = [-32_768_i16, 32_767].iter().flat_map(|v| v.to_ne_bytes()).collect();
        Sample::I16.decode(&bytes, &mut out);
        assert_eq!(out, [-32_768.0, 32_767.0]);
        let bytes: Vec<_> = [u32::MAX, 1].iter().flat_map(|v| v.to_ne_bytes()).collect();
        Sample::U32.decode(&bytes, &mut out);
        assert_eq!(out, [4_294_967_295.0, 1.0]);
        let bytes: Vec<_> = [0.1_f32, f32::NAN].iter().flat_map(|v| v.to_ne_bytes()).collect();
        Sample::F32.decode(&bytes, &mut out);
        assert!(out[0] == f64::from(0.1_f32) && out[1].is_nan());
    }
}
