//! The decoder of mesh payloads against mutations of the kept corpus, on a stable toolchain: what `tests/fuzz` asks with
//! libFuzzer, without its view of the code. What comes of an input (the refusal, how many triangles) takes the place of that:
//! inputs with an outcome that is new are mutated further.
//!
//! A run is a second's worth, the same each time. `SIGHTLINE_FUZZ_SECONDS=60` goes on for so long, from another seed each
//! time, which is printed; `SIGHTLINE_FUZZ_SEED` repeats one.

#[path = "../../tests/fuzz/src/mesh_payload.rs"]
mod mesh_payload;
#[path = "../../tests/fuzz/src/mutate.rs"]
mod mutate;

use std::{collections::BTreeSet, panic::catch_unwind, path::Path};

use mesh_payload::{MAX_TRIANGLES, check};
use mutate::{Dice, Run, corpus, mutated};
use sightline_proto::{codec::DecodeError, replica::ApplyError};

/// Inputs of a run that nobody asks to be long.
const SHORT_RUN: u64 = 3_000;
/// Inputs of a short run that are meshes at least; a long run has more. Its share of them depends on what it keeps.
const MIN_MESHES: u64 = 40;
/// Most inputs that are kept to be mutated.
const MAX_POOL: usize = 4_000;
/// Bytes that are dropped from an end that is too much.
const MAX_DROPPED: usize = 8;

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

#[test]
fn any_bytes_are_refused_without_a_trace_or_are_the_only_encoding_of_a_mesh() {
    let run = Run::new(SHORT_RUN);
    let seed = run.seed;
    println!("seed {seed}");
    let mut pool = corpus(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/corpus/mesh_payload"));
    let mut seen = BTreeSet::new();
    let mut accepted = 0_u64;
    for bytes in &pool {
        let found = check(bytes);
        seen.insert(outcome(bytes, &found));
        accepted += u64::from(found.is_ok());
    }
    assert!(accepted >= 4, "{accepted} inputs of the corpus are meshes");
    let (mut dice, mut inputs) = (Dice::new(seed), 0);
    while run.goes_on(inputs) {
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
