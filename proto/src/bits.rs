//! Bits in bytes, the first bit of a byte being its highest.

use crate::codec::DecodeError;

/// Appends bits.
#[derive(Default)]
pub(crate) struct BitWriter {
    bytes: Vec<u8>,
    /// Bits of the last byte that are used; 0 when there is none to fill.
    used: u32,
}

impl BitWriter {
    /// Appends the low `width` bits of `value`, highest first.
    pub(crate) fn bits(&mut self, value: u64, width: u32) {
        for n in (0..width).rev() {
            if self.used == 0 {
                self.bytes.push(0);
            }
            if let Some(last) = self.bytes.last_mut() {
                *last |= ((value >> n & 1) as u8) << (7 - self.used);
            }
            self.used = (self.used + 1) % 8;
        }
    }

    /// Appends `count` ones.
    pub(crate) fn ones(&mut self, count: u32) {
        self.bits(u64::MAX, count);
    }

    /// The bytes, the last filled up with zeros.
    pub(crate) fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// Reads bits.
pub(crate) struct BitReader<'a> {
    bytes: &'a [u8],
    /// Bits read.
    at: usize,
}

impl<'a> BitReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The next `width` bits, at most 64, highest first.
    pub(crate) fn bits(&mut self, width: u32) -> Result<u64, DecodeError> {
        let mut value = 0;
        for _ in 0..width {
            let byte = self.bytes.get(self.at / 8).ok_or(DecodeError::Truncated)?;
            value = value << 1 | u64::from(byte >> (7 - self.at % 8) & 1);
            self.at += 1;
        }
        Ok(value)
    }

    /// Checks that only the zeros that fill the last byte are left.
    pub(crate) fn finish(mut self) -> Result<(), DecodeError> {
        let padding = (8 - self.at % 8) % 8;
        if self.at.div_ceil(8) != self.bytes.len() || self.bits(padding as u32)? != 0 {
            return Err(DecodeError::Trailing);
        }
        Ok(())
    }
}
