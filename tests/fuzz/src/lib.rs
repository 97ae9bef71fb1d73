//! The elevation readers' own source, without the server around it, so that fuzzing them builds a fifth of the crates;
//! and what every reader's target does.

#![cfg(feature = "readers")]

#[path = "../../../src/dem/mod.rs"]
pub mod dem;

pub mod terrain;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use dem::{MAX_HEIGHT_M, OpenOptions};

/// Rows that are read of a raster: a header may declare a million.
const ROWS: u32 = 64;

/// Writes the files and reads the last one as the user would. An error, or a raster that keeps its promises.
pub fn read(files: &[(&str, &[u8])]) {
    let folder = folder();
    let mut path = PathBuf::new();
    for (name, content) in files {
        path = folder.join(name);
        std::fs::write(&path, content).expect("the folder for temporary files can be written to");
    }
    let Ok(mut raster) = dem::open(&[path], &OpenOptions::default(), &mut |_| ()) else { return };
    let info = raster.info().clone();
    assert!(info.nx >= 2 && info.ny >= 2 && info.unit_m > 0.0);
    let place = info.georeference;
    assert!(place.step.iter().all(|s| *s > 0.0 && s.is_finite()) && place.origin.iter().all(|o| o.is_finite()));
    let mut row = vec![0.0; info.nx as usize];
    // From both edges, so that readers of either direction have to turn round.
    for n in 0..info.ny.min(ROWS) {
        let j = if n % 2 == 0 { n / 2 } else { info.ny - 1 - n / 2 };
        if raster.read_rows(j, &mut row).is_err() {
            return;
        }
        assert!(row.iter().all(|h| h.is_nan() || h.abs() <= MAX_HEIGHT_M));
    }
}

/// A folder of this process.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let path = std::env::temp_dir().join(format!("sightline-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("the folder for temporary files can be written to");
        path
    })
}

/// Corrects the check sums of a DTED cell, which a fuzzer would hardly ever hit.
pub fn correct_dted_sums(cell: &mut [u8]) {
    const RECORDS: usize = 3428;
    let digits = cell.get(51..55).and_then(|d| std::str::from_utf8(d).ok()?.parse::<usize>().ok());
    let (Some(posts), Some(records)) = (digits, cell.get_mut(RECORDS..)) else { return };
    for record in records.chunks_exact_mut(12 + 2 * posts) {
        let (content, sum) = record.split_at_mut(8 + 2 * posts);
        let found = content.iter().fold(0_u32, |sum, byte| sum.wrapping_add(u32::from(*byte)));
        sum.copy_from_slice(&found.to_be_bytes());
    }
}

/// The header and the samples of a raw raster: a length of two bytes, little-endian, and so many of the header.
pub fn split_raw(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<2>()?;
    rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))
}
