//! Hostile files: each truncation and each flipped byte of a small sample per format gives an error or a well-formed
//! raster: never a panic, even one that the reader would catch, and never a height that is no height.
//!
//! `tests/dem_memory.rs` runs the same samples and measures what they make the readers allocate.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use sightline::dem::{DemError, MAX_HEIGHT_M, Raster};

use crate::encoders::{gz, hgt, zip};
use crate::samples::{asc, dted, for_each_mutation, pngs, raws, tiffs, usgs};
use crate::{Folder, open, open_in_no_memory};

/// Panics on any thread since the first sample was tried; the reader's own net must stay empty.
static PANICS: AtomicU32 = AtomicU32::new(0);

/// Runs `attempt` and fails when anything panicked meanwhile, caught or not.
pub(crate) fn without_panics(what: &str, attempt: impl FnOnce()) {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            PANICS.fetch_add(1, Ordering::SeqCst);
            before(info);
        }));
    });
    let before = PANICS.load(Ordering::SeqCst);
    attempt();
    assert_eq!(PANICS.load(Ordering::SeqCst), before, "{what}");
}

/// Reads up to `rows` rows and checks what a raster promises. Whether it could be read.
pub(crate) fn try_read(path: &Path, rows: u32) -> Result<(), DemError> {
    check_rows(open(path)?, rows)
}

fn check_rows(mut raster: Box<dyn Raster>, rows: u32) -> Result<(), DemError> {
    let info = raster.info().clone();
    assert!(info.nx >= 2 && info.ny >= 2 && info.unit_m > 0.0);
    let place = info.georeference;
    assert!(place.step.iter().all(|s| *s > 0.0 && s.is_finite()) && place.origin.iter().all(|o| o.is_finite()));
    let mut row = vec![0.0; info.nx as usize];
    for j in 0..info.ny.min(rows) {
        raster.read_rows(j, &mut row)?;
        assert!(row.iter().all(|h| h.is_nan() || h.abs() <= MAX_HEIGHT_M));
    }
    Ok(())
}

/// Writes an input of a fuzz target under the name by which that reads it; `None` when it is no input.
pub(crate) fn put_input(folder: &Folder, name: &str, bytes: &[u8]) -> Option<PathBuf> {
    if name != "grid.bil" {
        return Some(folder.put(name, bytes));
    }
    // A length of two bytes, and so many of the header.
    let (length, rest) = bytes.split_first_chunk::<2>()?;
    let (header, samples) = rest.split_at_checked(u16::from_le_bytes(*length).into())?;
    folder.put("grid.hdr", header);
    Some(folder.put(name, samples))
}

/// Tries every mutation of `sample`; gives how many were still read.
fn survive(folder: &Folder, name: &str, sample: &[u8], rows: u32) -> u32 {
    let mut read = 0;
    assert_eq!(try_read(&folder.put(name, sample), rows), Ok(()), "{name}");
    for_each_mutation(sample, |content, what| {
        let path = folder.put(name, content);
        without_panics(&format!("{name}: {what}"), || {
            read += u32::from(try_read(&path, rows).is_ok());
            // The same with nothing at hand.
            let _ = open_in_no_memory(&path).and_then(|raster| check_rows(raster, rows));
        });
    });
    read
}

#[test]
fn every_mutation_of_a_tiff_is_an_error_or_a_raster() {
    let folder = Folder::new();
    for (name, sample) in tiffs() {
        let read = survive(&folder, name, &sample, 64);
        println!("{name}: {} bytes, {read} mutations still read", sample.len());
    }
}

#[test]
fn every_mutation_of_an_ascii_grid_is_an_error_or_a_raster() {
    survive(&Folder::new(), "grid.asc", asc().as_bytes(), 64);
}

#[test]
fn every_mutation_of_a_dted_cell_is_an_error_or_a_raster() {
    survive(&Folder::new(), "cell.dt1", &dted(), 64);
}

#[test]
fn every_mutation_of_a_usgs_dem_is_an_error_or_a_raster() {
    survive(&Folder::new(), "quad.dem", &usgs(), 64);
}

#[test]
fn every_mutation_of_a_picture_is_an_error_or_a_raster() {
    let folder = Folder::new();
    for (name, sample) in pngs() {
        survive(&folder, name, &sample, 64);
    }
}

#[test]
fn every_mutation_of_a_raw_raster_or_its_header_is_an_error_or_a_raster() {
    for ([header, raster], [text, samples]) in raws() {
        let folder = Folder::new();
        folder.put(header, &text);
        survive(&folder, raster, &samples, 64);
        let path = folder.put(raster, &samples);
        for_each_mutation(&text, |content, what| {
            folder.put(header, content);
            without_panics(&format!("{raster}: header {what}"), || drop(try_read(&path, 64)));
        });
    }
}

#[test]
fn mutations_of_a_packed_tile_are_errors_or_tiles() {
    let folder = Folder::new();
    let tile = hgt(1201, |_, _| 100);
    // The interior of the compressed stream is sampled: unpacking a tile for each of its bytes would take minutes.
    for (name, sample) in [("N44W072.hgt.gz", gz(&tile)), ("N44W072.hgt.zip", zip("N44W072.hgt", &tile))] {
        let path = |content: &[u8]| folder.put(name, content);
        let cut = path(&sample);
        let file = std::fs::File::options().write(true).open(&cut).unwrap();
        for length in (0..sample.len()).rev() {
            file.set_len(length as u64).unwrap();
            assert!(try_read(&cut, 1).is_err(), "{name} cut to {length}");
        }
        let interior = 80..sample.len() - 160;
        for at in (0..sample.len()).filter(|at| !interior.contains(at) || at % 97 == 0) {
            let mut content = sample.clone();
            content[at] ^= 0xff;
            let _ = try_read(&path(&content), 1);
        }
    }
}

#[test]
fn only_whole_tiles_are_tiles() {
    let folder = Folder::new();
    let tile = hgt(1201, |i, _| i as i16);
    for length in (0..2000).chain(tile.len() - 2000..tile.len()) {
        let path = folder.0.path().join("N44W072.hgt");
        std::fs::File::create(&path).unwrap().set_len(length as u64).unwrap();
        assert!(open(&path).is_err(), "{length} bytes");
    }
}

#[test]
fn files_of_other_kinds_are_told_by_name() {
    let folder = Folder::new();
    let error = |name: &str, content: &[u8]| open(&folder.put(name, content)).map(drop).unwrap_err().to_string();
    let png = b"\x89PNG\r\n\x1a\n0000";
    for name in ["a.png", "N44W072.hgt", "a.tif", "a.asc", "a"] {
        assert!(error(name, png).contains("PNG"), "{name}");
    }
    assert!(error("a.dem", &[0; 2000]).contains("no USGS ASCII DEM"));
    assert!(error("a.hdr", b"ENVI").contains("name the raster itself"));
    std::fs::remove_file(folder.0.path().join("a.hdr")).unwrap();
    assert!(error("a.tif", b"not a tiff at all").contains("without TIFF's first bytes"));
    assert!(error("a.xyz", b"UHL1 and so on").contains("DTED"));
    assert!(error("a.bil", &[0; 100]).contains("header file"));
    assert!(error("a.xyz", b"1 2 3").contains(".xyz"));
    assert!(error("a.asc", b"hello world").contains("line 1"));
    for name in ["a.tif", "a.asc", "N44W072.hgt", "a.zip"] {
        assert!(error(name, b"version https://git-lfs.github.com/spec/v1\n").contains("git lfs pull"), "{name}");
        assert!(error(name, b"").contains("empty"), "{name}");
    }
    assert!(matches!(open(folder.0.path()), Err(DemError::Directory { .. })));
    assert!(matches!(open(&folder.0.path().join("none.tif")), Err(DemError::Io { .. })));
    // A raster under another's name is read for what it is.
    let (_, tiff) = tiffs().swap_remove(0);
    assert_eq!(try_read(&folder.put("a.asc", tiff), 64), Ok(()));
    assert_eq!(try_read(&folder.put("a.tif", asc()), 64), Ok(()));
}

/// What the fuzz targets keep, by the names under which they read it.
#[test]
fn the_kept_corpus_of_each_reader_is_errors_or_rasters() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let targets = [
        ("dem_ascii", "grid.asc"),
        ("dem_dted", "cell.dt1"),
        ("dem_geotiff", "raster.tif"),
        ("dem_hgt", "N44W072.hgt.zip"),
        ("dem_png", "terrarium.png"),
        ("dem_raw", "grid.bil"),
        ("dem_usgs", "quad.dem"),
    ];
    let folder = Folder::new();
    for (target, name) in targets {
        let mut read = 0;
        for entry in std::fs::read_dir(corpus.join(target)).unwrap() {
            let path = entry.unwrap().path();
            let Some(put) = put_input(&folder, name, &std::fs::read(&path).unwrap()) else { continue };
            without_panics(&path.display().to_string(), || read += u32::from(try_read(&put, 64).is_ok()));
        }
        assert!(read > 0, "{target}: the samples that it starts from can be read");
    }
}
