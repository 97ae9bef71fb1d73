//! See `src/mesh_payload.rs`.

#![no_main]

#[path = "../src/mesh_payload.rs"]
mod mesh_payload;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = mesh_payload::check(bytes);
});
