//! Any bytes as an Esri ASCII grid.

#![no_main]

use libfuzzer_sys::fuzz_target;
use sightline_fuzz::read;

fuzz_target!(|bytes: &[u8]| read(&[("grid.asc", bytes)]));
