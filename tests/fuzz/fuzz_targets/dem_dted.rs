//! Any bytes as a DTED cell, as they are and with right check sums.

#![no_main]

use libfuzzer_sys::fuzz_target;
use sightline_fuzz::{correct_dted_sums, read};

fuzz_target!(|bytes: &[u8]| {
    read(&[("cell.dt1", bytes)]);
    let mut cell = bytes.to_vec();
    correct_dted_sums(&mut cell);
    read(&[("cell.dt1", &cell)]);
});
