//! Any bytes as a packed SRTM tile: zip or gzip by its first bytes.

#![no_main]

use libfuzzer_sys::fuzz_target;
use sightline_fuzz::read;

fuzz_target!(|bytes: &[u8]| read(&[("N44W072.hgt.zip", bytes)]));
