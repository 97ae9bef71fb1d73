//! The readers of elevation files, and of databases, against mutations of the kept corpus, on a stable toolchain: what the
//! targets of `tests/fuzz` ask with libFuzzer, without its view of the code. The words of a refusal take the place of that: inputs
//! that are refused in new words are mutated further.
//!
//! A run is part of a second, the same each time. `SIGHTLINE_FUZZ_SECONDS=60` goes on for so long, from another seed each
//! time, which is printed; `SIGHTLINE_FUZZ_SEED` repeats one.

#[path = "../fuzz/src/database_file.rs"]
mod database_file;
#[path = "../fuzz/src/mutate.rs"]
mod mutate;

use std::{collections::BTreeSet, path::Path};

use mutate::{Dice, Run, corpus, mutated};

use crate::{
    Folder,
    hostile::{put_input, try_read, without_panics},
};

/// Inputs of a run that nobody asks to be long.
const SHORT_RUN: u64 = 150;
/// Most inputs that are kept to be mutated.
const MAX_POOL: usize = 1_000;
/// Rows that are read of a raster.
const ROWS: u32 = 64;

/// Hands mutations of a corpus to `attempt`, which says what is wrong with one; `None` for what is no input.
fn survives(target: &str, mut attempt: impl FnMut(&[u8]) -> Option<Result<(), String>>) {
    let run = Run::new(SHORT_RUN);
    let mut pool = corpus(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(target));
    let (mut dice, mut seen, mut inputs, mut read) = (Dice::new(run.seed), BTreeSet::new(), 0, 0);
    while run.goes_on(inputs) {
        let bytes = mutated(&mut dice, &pool);
        inputs += 1;
        let mut found = None;
        without_panics(&format!("{target}, seed {}, input {inputs}: {bytes:02x?}", run.seed), || {
            found = attempt(&bytes)
        });
        let Some(found) = found else { continue };
        read += u64::from(found.is_ok());
        let words = found.err().unwrap_or_default();
        let words: String = words.chars().filter(|c| !c.is_ascii_digit()).collect();
        if seen.insert(words) && pool.len() < MAX_POOL {
            pool.push(bytes);
        }
    }
    println!("{target}: seed {}, {inputs} inputs, {read} of them read, {} outcomes", run.seed, seen.len());
    assert!(seen.len() > 3, "{target}: {} outcomes", seen.len());
}

fn survives_mutations(target: &str, name: &str) {
    let folder = Folder::new();
    survives(target, |bytes| {
        let path = put_input(&folder, name, bytes)?;
        Some(try_read(&path, ROWS).map_err(|error| error.to_string()))
    });
}

/// As they are, and with every checksum put right.
#[test]
fn mutations_of_databases_are_refused_or_read() {
    let folder = Folder::new();
    let path = folder.0.path().join("it.sldb");
    survives("database_open", |bytes| {
        let _ = database_file::check(&path, bytes);
        let mut repaired = bytes.to_vec();
        database_file::repair(&mut repaired)?;
        Some(database_file::check(&path, &repaired))
    });
}

/// What they are mutations of is sound, and mending what is sound changes nothing.
#[test]
fn the_kept_databases_are_sound() {
    let folder = Folder::new();
    let path = folder.0.path().join("it.sldb");
    for bytes in corpus(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus/database_open")) {
        assert_eq!(database_file::check(&path, &bytes), Ok(()));
        let mut repaired = bytes.clone();
        assert_eq!(database_file::repair(&mut repaired), Some(()));
        assert_eq!(repaired, bytes);
    }
}

#[test]
fn mutations_of_ascii_grids_are_errors_or_rasters() {
    survives_mutations("dem_ascii", "grid.asc");
}

#[test]
fn mutations_of_dted_cells_are_errors_or_rasters() {
    survives_mutations("dem_dted", "cell.dt1");
}

#[test]
fn mutations_of_tiffs_are_errors_or_rasters() {
    survives_mutations("dem_geotiff", "raster.tif");
}

#[test]
fn mutations_of_packed_srtm_tiles_are_errors_or_rasters() {
    survives_mutations("dem_hgt", "N44W072.hgt.zip");
}

#[test]
fn mutations_of_pictures_are_errors_or_rasters() {
    survives_mutations("dem_png", "terrarium.png");
}

#[test]
fn mutations_of_raw_rasters_and_headers_are_errors_or_rasters() {
    survives_mutations("dem_raw", "grid.bil");
}

#[test]
fn mutations_of_usgs_dems_are_errors_or_rasters() {
    survives_mutations("dem_usgs", "quad.dem");
}
