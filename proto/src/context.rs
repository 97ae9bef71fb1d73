//! Adaptive probabilities of bits.
//!
//! A context counts: its first bits move it far and later ones less (Krichevsky, Trofimov, "The performance of universal
//! encoding", 1981), down to a floor that lets it follow a change.

/// Bits of a probability: 2^16 stands for certainty.
pub(crate) const PROBABILITY_ONE_BITS: u32 = 16;
/// A probability stays this far from 0 and from 2^16.
const MARGIN: u32 = 32;
/// From this many bits on, a context moves by the same part of the way each time.
const MOST_SEEN: u8 = 60;

/// The probability that the next bit is 1, in units of 2^-16, and how firmly it is held.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Context {
    one: u16,
    seen: u8,
}

/// The part of the way that a context moves after `seen` bits, in units of 2^-16: 2 / (2 seen + 3), rounded down.
const PACE: [u32; 256] = {
    let mut pace = [0; 256];
    let mut seen = 0;
    while seen < pace.len() {
        // More are never counted; a table for all bytes needs no look at its length.
        let counted = if seen < MOST_SEEN as usize { seen } else { MOST_SEEN as usize };
        pace[seen] = (2 << PROBABILITY_ONE_BITS) / (2 * counted as u32 + 3);
        seen += 1;
    }
    pace
};

impl Context {
    /// A context that expects a 1 with probability `one` / 256, as firmly as if it had seen `seen` bits.
    pub(crate) const fn expecting(one: u8, seen: u8) -> Self {
        Self { one: (one as u16) << 8, seen }
    }

    /// The probability of a 1 in units of 2^-16: from 32 to 2^16 - 32.
    #[inline]
    pub(crate) fn probability(&self) -> u32 {
        self.one.into()
    }

    #[inline]
    pub(crate) fn learn(&mut self, bit: bool) {
        let one = u32::from(self.one);
        let pace = PACE[usize::from(self.seen)];
        // Towards one end, only the margin of that end can be passed.
        let moved = if bit {
            let room = (1 << PROBABILITY_ONE_BITS) - one;
            (one + ((room * pace) >> PROBABILITY_ONE_BITS)).min((1 << PROBABILITY_ONE_BITS) - MARGIN)
        } else {
            (one - ((one * pace) >> PROBABILITY_ONE_BITS)).max(MARGIN)
        };
        self.one = moved as u16;
        self.seen += u8::from(self.seen < MOST_SEEN);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conformance_of_the_paces_and_the_first_moves() {
        assert_eq!(PACE[..4], [43_690, 26_214, 18_724, 14_563]);
        assert_eq!([PACE[60], PACE[61], PACE[255]], [1_065; 3]);
        let mut context = Context::expecting(128, 0);
        context.learn(true);
        assert_eq!(context.probability(), 32_768 + 21_845);
        context.learn(false);
        assert_eq!(context.probability(), 54_613 - 21_844);
    }

    #[test]
    fn probabilities_keep_their_margin() {
        for bit in [false, true] {
            let mut context = Context::expecting(128, 0);
            for _ in 0..100_000 {
                context.learn(bit);
                assert!((32..=65_504).contains(&context.probability()));
            }
        }
    }
}
