//! Any bytes as a terrain database, as they are and with right check sums: see `src/database_file.rs`.

#![no_main]

#[path = "../src/database_file.rs"]
mod database_file;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let path = std::env::temp_dir().join(format!("sightline-fuzz-{}.sldb", std::process::id()));
    let _ = database_file::check(&path, bytes);
    let mut repaired = bytes.to_vec();
    if database_file::repair(&mut repaired).is_some() {
        let _ = database_file::check(&path, &repaired);
    }
});
