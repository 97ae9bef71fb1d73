//! Mutations of a kept corpus on a stable toolchain, for the tests that stand in for libFuzzer where there is no C++
//! compiler: `proto/tests/fuzz.rs` and `tests/dem/mutations.rs`.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant, SystemTime},
};

/// Longest input in bytes.
const MAX_BYTES: usize = 16_384;

/// xorshift64* (Vigna, "An experimental exploration of Marsaglia's xorshift generators, scrambled", 2016).
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed | 1)
    }

    pub(crate) fn roll(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// From 0 to `end` - 1; 0 when there is none.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        ((self.roll() >> 32) as usize * end) >> 32
    }
}

/// Some changes of an input.
pub(crate) fn mutated(dice: &mut Dice, pool: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = pool[dice.below(pool.len())].clone();
    for _ in 0..1 + dice.below(4) {
        let (at, kind) = (dice.below(bytes.len().max(1)), dice.below(8));
        match kind {
            _ if bytes.is_empty() => bytes.push(dice.roll() as u8),
            0 | 1 => bytes[at] ^= 1 << dice.below(8),
            2 => bytes[at] = dice.roll() as u8,
            3 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][dice.below(5)],
            4 => bytes.truncate(at),
            5 => bytes.insert(at, dice.roll() as u8),
            6 => {
                let length = dice.below(40);
                bytes.extend((0..length).map(|_| dice.roll() as u8));
            }
            _ => {
                // The beginning of this one, the end of another.
                let other = &pool[dice.below(pool.len())];
                bytes.truncate(at);
                bytes.extend_from_slice(&other[dice.below(other.len().max(1)).min(other.len())..]);
            }
        }
    }
    bytes.truncate(MAX_BYTES);
    bytes
}

/// The files of a folder of `tests/fuzz/corpus`, by name.
pub(crate) fn corpus(folder: &Path) -> Vec<Vec<u8>> {
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// How long a run goes on, and where it begins: `SIGHTLINE_FUZZ_SECONDS` and `SIGHTLINE_FUZZ_SEED`.
pub(crate) struct Run {
    pub(crate) seed: u64,
    seconds: Option<u64>,
    short: u64,
    began: Instant,
}

impl Run {
    /// A run of `short` inputs from the same seed each time, unless the environment asks for another.
    pub(crate) fn new(short: u64) -> Self {
        let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a whole number"));
        let seconds = number("SIGHTLINE_FUZZ_SECONDS");
        let now = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(1, |d| d.as_nanos() as u64);
        let seed = number("SIGHTLINE_FUZZ_SEED").unwrap_or_else(|| if seconds.is_some() { now() } else { 1 });
        Self { seed, seconds, short, began: Instant::now() }
    }

    pub(crate) fn goes_on(&self, inputs: u64) -> bool {
        match self.seconds {
            Some(seconds) => self.began.elapsed() < Duration::from_secs(seconds),
            None => inputs < self.short,
        }
    }
}
