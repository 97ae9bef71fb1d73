//! Any bytes as a PNG of heights, coloured by its name or grey. The decoder passes over check sums when it is fuzzed.

#![no_main]

use libfuzzer_sys::fuzz_target;
use sightline_fuzz::read;

fuzz_target!(|bytes: &[u8]| {
    read(&[("terrarium.png", bytes)]);
    read(&[("grey.png", bytes)]);
});
