//! Any header and any samples of a raw raster, as a BIL and as an FLT.

#![no_main]

use libfuzzer_sys::fuzz_target;
use sightline_fuzz::{read, split_raw};

fuzz_target!(|bytes: &[u8]| {
    let Some((header, samples)) = split_raw(bytes) else { return };
    read(&[("grid.hdr", header), ("grid.bil", samples)]);
    read(&[("grid.hdr", header), ("grid.flt", samples)]);
});
