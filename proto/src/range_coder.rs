//! A binary range coder: bits under given probabilities as bytes, and back.
//!
//! Follows G. N. N. Martin, "Range encoding: an algorithm for removing redundancy from a digitised message", 1979, for
//! bits only. Integers only, so the same bytes on every machine. It departs in its end: the encoder writes the fewest
//! bytes that name a number of the last interval, and the decoder checks that they are those, so a message has one
//! form. `WIRE.md` gives each step.

use crate::{
    codec::DecodeError,
    context::{Context, PROBABILITY_ONE_BITS},
};

/// Below this, the range is widened by a byte.
const LEAST_RANGE: u32 = 1 << 24;
/// The range before the first bit.
const FIRST_RANGE: u32 = u32::MAX;
/// Most bits without a context that go in one step.
const RAW_STEP_BITS: u32 = 8;

/// One end of the line: the encoder is told what to say, the decoder tells what was said. A walk written against this
/// is written once.
///
/// A decoder that has gone wrong goes on with bits that mean nothing, so that a bit costs no more than a bit; who takes
/// them asks [`Coder::check`] before anything follows from them.
pub(crate) trait Coder {
    /// One bit under a context, which learns from it. The decoder ignores `said`.
    fn bit(&mut self, context: &mut Context, said: bool) -> bool;

    /// A number of `width` bits, all of them equally likely. The decoder ignores `said`.
    fn raw(&mut self, width: u32, said: u64) -> u64;

    /// Whether everything up to here was said.
    fn check(&self) -> Result<(), DecodeError>;
}

/// The part of `range` that belongs to a bit that is 1: at least 1, and less than `range`.
fn part_of_one(range: u32, context: &Context) -> u32 {
    (range >> PROBABILITY_ONE_BITS) * context.probability()
}

/// Writes bits.
pub(crate) struct Encoder {
    bytes: Vec<u8>,
    low: u32,
    range: u32,
}

impl Encoder {
    /// Writes after `head`.
    pub(crate) fn new(head: Vec<u8>) -> Self {
        Self { bytes: head, low: 0, range: FIRST_RANGE }
    }

    #[inline]
    fn raise(&mut self, by: u32) {
        let (low, carry) = self.low.overflowing_add(by);
        self.low = low;
        if carry {
            self.carry();
        }
    }

    /// Adds one to the bytes written, read as one number. They never are all 255 when it comes: the number coded stays
    /// below 1.
    #[cold]
    fn carry(&mut self) {
        for byte in self.bytes.iter_mut().rev() {
            *byte = byte.wrapping_add(1);
            if *byte != 0 {
                return;
            }
        }
    }

    #[inline]
    fn widen(&mut self) {
        while self.range < LEAST_RANGE {
            self.bytes.push((self.low >> 24) as u8);
            self.low <<= 8;
            self.range <<= 8;
        }
    }

    /// The bytes, ended with the fewest that name a number of the last interval.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        let (count, value) = ending(self.low, self.range);
        if value < self.low {
            self.carry();
        }
        self.bytes.extend(&value.to_be_bytes()[..count]);
        self.bytes
    }
}

/// How many bytes end a message, and the 32 bits that they begin: the least multiple of the greatest power of 256 in
/// `low..low + range`, modulo 2^32.
fn ending(low: u32, range: u32) -> (usize, u32) {
    for count in 0..4 {
        let below = u32::MAX >> (8 * count);
        let value = (u64::from(low) + u64::from(below)) & !u64::from(below);
        if value - u64::from(low) < u64::from(range) {
            return (count, value as u32);
        }
    }
    (4, low)
}

impl Coder for Encoder {
    #[inline]
    fn bit(&mut self, context: &mut Context, said: bool) -> bool {
        let one = part_of_one(self.range, context);
        if said {
            self.range = one;
        } else {
            self.raise(one);
            self.range -= one;
        }
        context.learn(said);
        self.widen();
        said
    }

    #[inline]
    fn raw(&mut self, width: u32, said: u64) -> u64 {
        let mut left = width;
        while left > 0 {
            let step = left.min(RAW_STEP_BITS);
            left -= step;
            self.range >>= step;
            self.raise(self.range * (said >> left & ((1 << step) - 1)) as u32);
            self.widen();
        }
        said
    }

    fn check(&self) -> Result<(), DecodeError> {
        Ok(())
    }
}

/// Reads bits. Behind the bytes given come zeros, but the message must end where they do.
pub(crate) struct Decoder<'a> {
    bytes: &'a [u8],
    /// How many bytes have left the window of four.
    passed: usize,
    /// What the window holds beyond the interval's lower end: always less than `range`.
    above_low: u32,
    range: u32,
    /// A digit was met that no encoder writes.
    is_odd: bool,
}

impl<'a> Decoder<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let above_low = window(bytes, 0);
        if above_low == FIRST_RANGE {
            return Err(DecodeError::NotCanonical);
        }
        Ok(Self { bytes, passed: 0, above_low, range: FIRST_RANGE, is_odd: false })
    }

    #[inline]
    fn widen(&mut self) {
        while self.range < LEAST_RANGE {
            let next = self.bytes.get(self.passed + 4).copied().unwrap_or(0);
            self.passed += 1;
            self.above_low = self.above_low << 8 | u32::from(next);
            self.range <<= 8;
        }
    }

    /// Checks that the message ends here, in the form in which an encoder ends it.
    pub(crate) fn finish(self) -> Result<(), DecodeError> {
        self.check()?;
        let window = window(self.bytes, self.passed);
        let (count, value) = ending(window.wrapping_sub(self.above_low), self.range);
        match self.bytes.len() - self.passed {
            left if left > count => Err(DecodeError::Trailing),
            left if left < count => Err(DecodeError::Truncated),
            _ if window != value => Err(DecodeError::NotCanonical),
            _ => Ok(()),
        }
    }
}

/// Four bytes from `at` as one number, the first the highest; zeros behind the end.
fn window(bytes: &[u8], at: usize) -> u32 {
    (at..at + 4).fold(0, |word, n| word << 8 | u32::from(bytes.get(n).copied().unwrap_or(0)))
}

impl Coder for Decoder<'_> {
    #[inline]
    fn bit(&mut self, context: &mut Context, _: bool) -> bool {
        let one = part_of_one(self.range, context);
        let bit = self.above_low < one;
        if bit {
            self.range = one;
        } else {
            self.above_low -= one;
            self.range -= one;
        }
        context.learn(bit);
        self.widen();
        bit
    }

    #[inline]
    fn raw(&mut self, width: u32, _: u64) -> u64 {
        let mut value = 0;
        let mut left = width;
        while left > 0 {
            let step = left.min(RAW_STEP_BITS);
            left -= step;
            self.range >>= step;
            let digit = self.above_low / self.range;
            // The range's remainder that no digit names.
            self.is_odd |= digit >> step != 0 && self.passed <= self.bytes.len();
            self.above_low -= digit * self.range;
            value = value << step | u64::from(digit & ((1 << step) - 1));
            self.widen();
        }
        value
    }

    #[inline]
    fn check(&self) -> Result<(), DecodeError> {
        match self.is_odd {
            true => Err(DecodeError::NotCanonical),
            false if self.passed > self.bytes.len() => Err(DecodeError::Truncated),
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bits under a few contexts, and raw numbers.
    fn send<C: Coder>(coder: &mut C, symbols: &[(u8, u64)]) -> Result<Vec<u64>, DecodeError> {
        let mut contexts = [Context::expecting(128, 0); 4];
        let mut said = Vec::new();
        for &(kind, value) in symbols {
            said.push(match kind {
                0..4 => coder.bit(&mut contexts[usize::from(kind)], value & 1 == 1).into(),
                width => coder.raw(width.into(), value & ((1 << width) - 1)),
            });
            coder.check()?;
        }
        Ok(said)
    }

    fn symbols() -> impl Strategy<Value = Vec<(u8, u64)>> {
        let skewed = prop_oneof![8 => Just(0_u64), 1 => any::<u64>(), 1 => Just(u64::MAX)];
        prop::collection::vec((0..34_u8, skewed), 0..300)
    }

    proptest! {
            #[test]
            fn what_is_said_is_heard_and_has_one_form(symbols in symbols(), extra in any::<u8>()) {
                let mut encoder = Encoder::new(Vec::new());
                let said = send(&mut encoder, &symbols).unwrap();
                let bytes = encoder.finish();
                let mut decoder = Decoder::new(&bytes).unwrap();
                prop_assert_eq!(&send(&mut decoder, &symbols).unwrap(), &said);
                prop_assert_eq!(decoder.finish(), Ok(()));

                let longer = [&bytes[..], &[extra]].concat();
                let mut decoder = Decoder::new(&longer).unwrap();
    let heard = send(&mut decoder, &symbols);
                prop_assert!(heard != Ok(said) || decoder.finish() == Err(DecodeError::Trailing));
            }
        }

    #[test]
    fn a_carry_runs_through_all_bytes_before_it() {
        // Zeros under a context that expects them creep towards the upper end of the interval.
        let symbols: Vec<(u8, u64)> = (0..20_000).map(|n| (0, u64::from(n % 5_000 == 4_999))).collect();
        let mut encoder = Encoder::new(Vec::new());
        let said = send(&mut encoder, &symbols).unwrap();
        let bytes = encoder.finish();
        assert_eq!(send(&mut Decoder::new(&bytes).unwrap(), &symbols).unwrap(), said);
    }
}
