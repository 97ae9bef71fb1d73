//! Heights as differences from what the posts around them foretell.
//!
//! A post is foretold as the mean of its diamond's four corners: the base ends and the apexes, one of which is missing on
//! the border. (The base's midpoint, which is where the mesh passes before the split, is worse: a diamond is split where
//! its midpoint is off.) The difference goes as the bit length of its size, sign, and the bits below the highest.

use crate::{codec::DecodeError, context::Context, diamond::Post, range_coder::Coder};

/// Greatest bit length of a difference of 32-bit heights.
const MAX_LENGTH: u32 = 32;
/// How many contexts count the steps from the expected length; further steps share the last.
const STEPS: usize = 8;
/// The running mean counts sixteenths.
const MEAN_SHIFT: u32 = 4;
/// The running mean before the first height.
const FIRST_MEAN: u64 = 64;

/// The heights at a diamond's corners. An apex beyond the border counts like the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corners {
    pub(crate) base: [i32; 2],
    pub(crate) apexes: [i32; 2],
}

/// What has been learnt of heights.
pub(crate) struct Heights {
    /// Running mean of the sizes of differences, in sixteenths.
    mean: u64,
    is_long: Context,
    longer: [Context; STEPS],
    shorter: [Context; STEPS],
    negative: [Context; 6],
    second_bit: [Context; 2 * STEPS],
}

impl Heights {
    pub(crate) fn new() -> Self {
        Self {
            mean: FIRST_MEAN << MEAN_SHIFT,
            is_long: Context::expecting(112, 4),
            longer: [76, 56, 56, 56, 56, 56, 56, 56].map(|one| Context::expecting(one, 4)),
            shorter: [128, 106, 90, 80, 80, 80, 80, 80].map(|one| Context::expecting(one, 4)),
            negative: [128, 128, 144, 112, 160, 96].map(|one| Context::expecting(one, 4)),
            second_bit: [Context::expecting(112, 2); 2 * STEPS],
        }
    }

    /// The bit length that the heights so far let expect.
    pub(crate) fn usual_length(&self) -> u32 {
        bit_length((self.mean >> MEAN_SHIFT) as i64)
    }

    /// Codes the height of `p`, whose difference is expected to have `length` bits.
    pub(crate) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        p: Post,
        corners: &Corners,
        length: u32,
        said: i32,
    ) -> Result<i32, DecodeError> {
        let sum = |[a, b]: [i32; 2]| i64::from(a) + i64::from(b);
        let (base, apexes) = (sum(corners.base), sum(corners.apexes));
        let foretold = (base + apexes) >> 2;
        let off = self.difference(coder, apexes - base, length, i64::from(said) - foretold);
        coder.check()?;
        let size = off.unsigned_abs();
        self.mean = self.mean - (self.mean >> MEAN_SHIFT) + size;
        let height = foretold + off;
        i32::try_from(height).map_err(|_| DecodeError::Height { post: p, height })
    }

    fn difference<C: Coder>(&mut self, coder: &mut C, lean: i64, expected: u32, said: i64) -> i64 {
        let length = self.length(coder, expected, bit_length(said));
        if length == 0 {
            return 0;
        }
        let steep = i64::from(bit_length(lean) >= expected) + i64::from(bit_length(lean) > expected + 1);
        let sign = 2 * steep as usize + usize::from(lean < 0);
        let negative = coder.bit(&mut self.negative[sign], said < 0);
        let mut size = 1;
        let mut left = length - 1;
        let digits = said.unsigned_abs();
        if left > 0 {
            left -= 1;
            let steps = (STEPS as u32 + length).saturating_sub(expected).min(2 * STEPS as u32 - 1) as usize;
            let second = coder.bit(&mut self.second_bit[steps], digits >> left & 1 == 1);
            size = 2 | u64::from(second);
        }
        size = size << left | coder.raw(left, digits & ((1 << left) - 1));
        if negative { -(size as i64) } else { size as i64 }
    }

    fn length<C: Coder>(&mut self, coder: &mut C, expected: u32, said: u32) -> u32 {
        let context = |steps: u32| (steps as usize).min(STEPS - 1);
        let mut length = expected;
        if expected == 0 || coder.bit(&mut self.is_long, said >= expected) {
            while length < MAX_LENGTH && coder.bit(&mut self.longer[context(length - expected)], said > length) {
                length += 1;
            }
            return length;
        }
        length -= 1;
        while length > 0 && coder.bit(&mut self.shorter[context(expected - 1 - length)], said < length) {
            length -= 1;
        }
        length
    }
}

/// Bits of the size of `v`: 0 for 0.
pub(crate) fn bit_length(v: i64) -> u32 {
    64 - v.unsigned_abs().leading_zeros()
}
