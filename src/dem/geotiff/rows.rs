//! The rows of one block, strip or tile, one after the other: what is needed of a block that is too large to be decoded
//! at once. All of TIFF's codecs but LERC can be read that way.
//!
//! Codecs: TIFF 6.0, sections 9 (PackBits) and 13 (LZW), TIFF Technical Note 3 (deflate, the predictor of floating-point
//! numbers), RFC 8878 (Zstandard).

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;

use flate2::read::ZlibDecoder;
use ruzstd::decoding::StreamingDecoder;
use tiff_reader::{ByteOrder, Ifd};
use weezl::{BitOrder, LzwStatus, decode::Configuration};

use super::layout::{DEFLATE, LZW, NONE, PACK_BITS, ZSTD};
use crate::dem::sample::Sample;

/// Bytes of a block that are read at once.
const BUFFER_BYTES: u64 = 1 << 16;
/// The largest window of Zstandard that is always allowed: RFC 8878 recommends that decoders support 8 MB.
const WINDOW_BYTES: u64 = 8 << 20;
/// Predictors: none, differences of integers, differences of the bytes of floating-point numbers.
const PLAIN: u16 = 1;
const INTEGERS: u16 = 2;
const FLOATS: u16 = 3;

/// How the samples of a block are written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coding {
    compression: u16,
    predictor: u16,
    big_endian: bool,
    bits_reversed: bool,
    sample: Sample,
    /// Samples of a pixel that lie together; the first is the height.
    interleaved: usize,
    /// Most bytes that Zstandard may look back.
    window_bytes: u64,
}

impl Coding {
    /// The coding of an image, where rows of its blocks can be had one by one.
    pub(super) fn of(
        ifd: &Ifd,
        order: ByteOrder,
        sample: Sample,
        predictor: u16,
        interleaved: usize,
        memory_bytes: usize,
    ) -> Option<Self> {
        let compression = ifd.compression();
        let known = [NONE, LZW, DEFLATE[0], DEFLATE[1], PACK_BITS, ZSTD].contains(&compression);
        let coding = Self {
            compression,
            predictor,
            big_endian: order == ByteOrder::BigEndian,
            bits_reversed: ifd.fill_order() == 2,
            sample,
            interleaved,
            window_bytes: WINDOW_BYTES.max(memory_bytes as u64),
        };
        known.then_some(coding)
    }

    /// Whether a row can be had without those before it.
    pub(super) fn is_direct(&self) -> bool {
        self.compression == NONE
    }

    /// Decodes rows of a block, `width` pixels each, that lies at `offset` and takes `length` bytes of `file`. Gives each
    /// row's heights, in the machine's byte order, to `put`. Rows begin with the first unless the coding is direct.
    pub(super) fn rows(
        &self,
        file: &File,
        (offset, length): (u64, u64),
        width: usize,
        rows: Range<usize>,
        put: &mut dyn FnMut(usize, &[u8]) -> io::Result<()>,
    ) -> io::Result<()> {
        let row_bytes = width * self.interleaved * self.sample.bytes();
        let skipped = (rows.start as u64 * row_bytes as u64).min(length);
        debug_assert!(skipped == 0 || self.is_direct(), "rows that follow from others");
        let mut file = file;
        file.seek(SeekFrom::Start(offset + skipped))?;
        let stored = Reversible { input: file.take(length - skipped), is_reversed: self.bits_reversed };
        let stored = BufReader::with_capacity(BUFFER_BYTES.min(length - skipped).max(1) as usize, stored);
        let mut decoder = self.decoder(stored)?;
        let (mut row, mut other) = (vec![0; row_bytes], Vec::new());
        for n in rows {
            decoder.read_exact(&mut row)?;
            self.undo(&mut row, &mut other)?;
            put(n, self.first_samples(&mut row))?;
        }
        Ok(())
    }

    fn decoder<'a>(&self, stored: impl BufRead + 'a) -> io::Result<Box<dyn Read + 'a>> {
        Ok(match self.compression {
            LZW => {
                let decoder =
                    Configuration::with_tiff_size_switch(BitOrder::Msb, 8).with_yield_on_full_buffer(true).build();
                Box::new(Lzw { input: stored, decoder })
            }
            PACK_BITS => Box::new(PackBits { input: stored, run: Run::Literal(0) }),
            ZSTD => {
                let decoder = StreamingDecoder::new_with_max_window_size(stored, self.window_bytes);
                Box::new(decoder.map_err(invalid)?)
            }
            NONE => Box::new(stored),
            _ => Box::new(ZlibDecoder::new(stored)),
        })
    }

    /// Samples as they were before the predictor, in the machine's byte order.
    fn undo(&self, row: &mut [u8], other: &mut Vec<u8>) -> io::Result<()> {
        let size = self.sample.bytes();
        if self.predictor == FLOATS && self.sample.is_float() {
            // The most significant bytes of all samples, then the next, each the difference from the one before.
            for n in self.interleaved..row.len() {
                row[n] = row[n].wrapping_add(row[n - self.interleaved]);
            }
            other.clear();
            other.extend_from_slice(row);
            let count = row.len() / size;
            for (n, sample) in row.chunks_exact_mut(size).enumerate() {
                for (byte, slot) in sample.iter_mut().enumerate() {
                    let significance = if cfg!(target_endian = "big") { byte } else { size - 1 - byte };
                    *slot = other[significance * count + n];
                }
            }
            return Ok(());
        }
        if self.big_endian != cfg!(target_endian = "big") {
            row.chunks_exact_mut(size).for_each(|sample| sample.reverse());
        }
        match (self.predictor, size) {
            (PLAIN, _) => {}
            (INTEGERS, 1) => sum_up(row, self.interleaved, |[a], [b]| [a.wrapping_add(b)]),
            (INTEGERS, 2) => sum_up(row, self.interleaved, |a, b| {
                u16::from_ne_bytes(a).wrapping_add(u16::from_ne_bytes(b)).to_ne_bytes()
            }),
            (INTEGERS, 4) => sum_up(row, self.interleaved, |a, b| {
                u32::from_ne_bytes(a).wrapping_add(u32::from_ne_bytes(b)).to_ne_bytes()
            }),
            (INTEGERS, 8) => sum_up(row, self.interleaved, |a, b| {
                u64::from_ne_bytes(a).wrapping_add(u64::from_ne_bytes(b)).to_ne_bytes()
            }),
            (predictor, _) => return Err(invalid(format!("predictor {predictor} does not fit its samples"))),
        }
        Ok(())
    }

    /// Leaves the first sample of each pixel at the beginning of the row.
    fn first_samples<'a>(&self, row: &'a mut [u8]) -> &'a [u8] {
        if self.interleaved == 1 {
            return row;
        }
        let size = self.sample.bytes();
        let pixels = row.len() / (size * self.interleaved);
        for n in 1..pixels {
            row.copy_within(n * size * self.interleaved..(n * self.interleaved + 1) * size, n * size);
        }
        &row[..pixels * size]
    }
}

fn sum_up<const N: usize>(row: &mut [u8], stride: usize, add: impl Fn([u8; N], [u8; N]) -> [u8; N]) {
    let samples = row.as_chunks_mut::<N>().0;
    for n in stride..samples.len() {
        samples[n] = add(samples[n], samples[n - stride]);
    }
}

fn invalid(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

/// Stored bytes, whose bits may be in the other order (TIFF's FillOrder).
struct Reversible<R> {
    input: R,
    is_reversed: bool,
}

impl<R: Read> Read for Reversible<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(out)?;
        if self.is_reversed {
            out[..read].iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        }
        Ok(read)
    }
}

struct Lzw<R> {
    input: R,
    decoder: weezl::decode::Decoder,
}

impl<R: BufRead> Read for Lzw<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            let stored = self.input.fill_buf()?;
            let is_end = stored.is_empty();
            let step = self.decoder.decode_bytes(stored, out);
            self.input.consume(step.consumed_in);
            match step.status {
                _ if step.consumed_out > 0 || out.is_empty() => return Ok(step.consumed_out),
                Ok(LzwStatus::Done) => return Ok(0),
                Ok(_) if is_end => return Ok(0),
                Ok(_) if step.consumed_in > 0 => {}
                Ok(_) => return Err(invalid("LZW codes lead nowhere")),
                Err(error) => return Err(invalid(error)),
            }
        }
    }
}

struct PackBits<R> {
    input: R,
    run: Run,
}

/// What is left of a run.
enum Run {
    Literal(usize),
    Repeat(u8, usize),
}

impl<R: BufRead> Read for PackBits<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            match &mut self.run {
                Run::Literal(0) | Run::Repeat(_, 0) => {
                    let Some(head) = self.byte()? else { return Ok(0) };
                    self.run = match head as i8 {
                        count @ 0.. => Run::Literal(count as usize + 1),
                        // No operation.
                        i8::MIN => Run::Literal(0),
                        count => {
                            let Some(byte) = self.byte()? else { return Ok(0) };
                            Run::Repeat(byte, 1 + usize::from(count.unsigned_abs()))
                        }
                    };
                }
                Run::Literal(left) => {
                    let most = out.len().min(*left);
                    let read = self.input.read(&mut out[..most])?;
                    *left -= read;
                    return Ok(read);
                }
                Run::Repeat(byte, left) => {
                    let count = out.len().min(*left);
                    out[..count].fill(*byte);
                    *left -= count;
                    return Ok(count);
                }
            }
        }
    }
}

impl<R: BufRead> PackBits<R> {
    fn byte(&mut self) -> io::Result<Option<u8>> {
        let first = self.input.fill_buf()?.first().copied();
        self.input.consume(usize::from(first.is_some()));
        Ok(first)
    }
}
