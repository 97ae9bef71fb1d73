//! Any bytes as a TIFF.

#![no_main]

use libfuzzer_sys::fuzz_target;
use sightline_fuzz::read;

fuzz_target!(|bytes: &[u8]| read(&[("raster.tif", bytes)]));
