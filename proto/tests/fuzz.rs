//! The decoder of mesh payloads against mutations of the kept corpus, on a stable toolchain: what `tests/fuzz` asks with
//! libFuzzer, without its view of the code. What comes of an input (the refusal, how many triangles) takes the place of that:
//! inputs with an outcome that is new are mutated further.
//!
//! A run is a second's worth, the same each time. `SIGHTLINE_FUZZ_SECONDS=60` goes on for so long, from another seed each
//! time, which is printed; `SIGHTLINE_FUZZ_SEED` repeats one.

#[path = "../../tests/fuzz/src/mesh_payload.rs"]
mod mesh_payload;

use std::{
    collections::BTreeSet,
    fs,
    panic::catch_unwind,
    path::Path,
    time::{Duration, Instant, SystemTime},
};

use mesh_payload::{MAX_TRIANGLES, check};
use sightline_proto::{codec::DecodeError, replica::ApplyError};

/// Inputs of a run that nobody asks to be long.
const SHORT_RUN: u64 = 3_000;
/// Inputs of a short run that are meshes at least; a long run has more. Its share of them depends on what it keeps.
const MIN_MESHES: u64 = 40;
/// Most inputs that are kept to be mutated.
const MAX_POOL: usize = 4_000;
/// Bytes that are dropped from an end that is too much.
const MAX_DROPPED: usize = 8;
/// Longest input in bytes.
const MAX_BYTES: usize = 4_096;

/// xorshift64* (Vigna, "An experimental exploration of Marsaglia's xorshift generators, scrambled", 2016).
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// From 0 to `end` - 1; 0 when there is none.
    fn below(&mut self, end: usize) -> usize {
        ((self.roll() >> 32) as usize * end) >> 32
    }
}

/// Some changes of an input.
fn mutated(dice: &mut Dice, pool: &[Vec<u8>]) -> Vec<u8> {
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

/// What sets an input apart: its root square and base, the refusal, and how large its mesh is.
fn outcome(bytes: &[u8], found: &Result<u32, Option<ApplyError>>) -> (u8, String, u32) {
    let words = match found {
        Ok(_) => String::new(),
        // Without the numbers in it.
        Err(refusal) => format!("{refusal:?}").chars().filter(|c| !c.is_ascii_digit()).collect(),
    };
    let size = found.as_ref().map_or(bytes.len() as u32, |triangles| *triangles);
    (bytes.first().copied().unwrap_or(0) & 15, words, size.checked_ilog2().unwrap_or(0))
}

fn corpus() -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/corpus/mesh_payload");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

#[test]
fn any_bytes_are_refused_without_a_trace_or_are_the_only_encoding_of_a_mesh() {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a whole number"));
    let seconds = number("SIGHTLINE_FUZZ_SECONDS");
    let now = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(1, |d| d.as_nanos() as u64);
    let seed = number("SIGHTLINE_FUZZ_SEED").unwrap_or_else(|| if seconds.is_some() { now() } else { 1 }) | 1;
    println!("seed {seed}");
    let mut pool = corpus();
    let mut seen = BTreeSet::new();
    let mut accepted = 0_u64;
    for bytes in &pool {
        let found = check(bytes);
        seen.insert(outcome(bytes, &found));
        accepted += u64::from(found.is_ok());
    }
    assert!(accepted >= 4, "{accepted} inputs of the corpus are meshes");
    let (mut dice, began, mut inputs) = (Dice(seed), Instant::now(), 0);
    let goes_on = |inputs| match seconds {
        Some(seconds) => began.elapsed() < Duration::from_secs(seconds),
        None => inputs < SHORT_RUN,
    };
    while goes_on(inputs) {
        let mut bytes = mutated(&mut dice, &pool);
        // Most mutations leave bytes over: without them it may be a mesh.
        for _ in 0..=MAX_DROPPED {
            let found = catch_unwind(|| check(&bytes));
            let found = found.unwrap_or_else(|_| panic!("seed {seed}, input {inputs}: {bytes:02x?} breaks a promise"));
            accepted += u64::from(found.is_ok());
            inputs += 1;
            if seen.insert(outcome(&bytes, &found)) && pool.len() < MAX_POOL {
                pool.push(bytes.clone());
            }
            if found != Err(Some(ApplyError::Decode(DecodeError::Trailing))) {
                break;
            }
            bytes.pop();
        }
    }
    println!("{inputs} inputs, {accepted} of them meshes of up to {MAX_TRIANGLES} triangles, {} outcomes", seen.len());
    assert!(accepted >= MIN_MESHES && seen.len() > 100, "{accepted} of {inputs} are meshes, {} outcomes", seen.len());
}
