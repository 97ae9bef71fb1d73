//! How much memory a hostile elevation file can make the readers take: at most four times its length and 16 MiB, the
//! caller's row of heights included. A packed tile may take what a tile legally holds, 25 MiB.
//!
//! A test binary of its own with a single test, because the allocator that counts is the whole process's.

#![allow(unsafe_code)]

#[path = "dem/encoders.rs"]
mod encoders;
#[path = "dem/samples.rs"]
mod samples;

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use sightline::dem::{self, DemError, OpenOptions};

use encoders::{Codec, Dted, Samples, Tiff, Usgs, gz, hgt, png, zip};

/// Bytes allocated now, and the most since the last reset.
static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: every call is handed on to the system's allocator unchanged; only counters are kept beside it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::SeqCst) + layout.size();
        PEAK.fetch_max(now, Ordering::SeqCst);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::SeqCst);
        // SAFETY: the caller keeps the contract of `dealloc`, and the pointer came from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn read(path: &Path) -> Result<(), DemError> {
    let mut raster = dem::open(&[path.to_owned()], &OpenOptions::default(), &mut |_| ())?;
    let mut row = vec![0.0; raster.info().nx as usize];
    for j in 0..raster.info().ny.min(64) {
        raster.read_rows(j, &mut row)?;
    }
    Ok(())
}

/// Reads `content` and gives whether that went well and how many bytes it took at most.
fn measure(folder: &tempfile::TempDir, name: &str, content: &[u8]) -> (Result<(), DemError>, usize) {
    let path: PathBuf = folder.path().join(name);
    let _ = std::fs::remove_file(&path);
    std::fs::write(&path, content).unwrap();
    let before = NOW.load(Ordering::SeqCst);
    PEAK.store(before, Ordering::SeqCst);
    let result = read(&path);
    (result, PEAK.load(Ordering::SeqCst) - before)
}

const MIB: usize = 1 << 20;
/// What a packed tile of 1 arc-second holds, a sixteenth more while its buffer grows, and the reader's own scraps.
const LEGAL_TILE_BYTES: usize = 3601 * 3601 * 2 / 16 * 17 + MIB;

#[test]
fn a_hostile_file_takes_at_most_four_times_its_length_and_16_mib() {
    let folder = tempfile::tempdir().unwrap();
    // A first read lets the decoders' thread pool and tables come to life.
    let (_, first) = samples::tiffs().swap_remove(0);
    assert_eq!(measure(&folder, "first.tif", &first).0, Ok(()));
    let mut most = 0;
    let mut check = |name: &str, content: &[u8], what: &str| {
        let (result, peak) = measure(&folder, name, content);
        assert!(peak <= 4 * content.len() + 16 * MIB, "{name}, {what}: {peak} bytes, {result:?}");
        most = most.max(peak);
        result
    };
    for (name, sample) in samples::tiffs() {
        samples::for_each_mutation(&sample, |content, what| drop(check(name, content, what)));
    }
    samples::for_each_mutation(samples::asc().as_bytes(), |content, what| drop(check("grid.asc", content, what)));
    samples::for_each_mutation(&samples::dted(), |content, what| drop(check("cell.dt1", content, what)));
    samples::for_each_mutation(&samples::usgs(), |content, what| drop(check("quad.dem", content, what)));
    for (name, sample) in samples::pngs() {
        samples::for_each_mutation(&sample, |content, what| drop(check(name, content, what)));
    }
    for ([header, raster], [text, data]) in samples::raws() {
        std::fs::write(folder.path().join(header), &text).unwrap();
        samples::for_each_mutation(&data, |content, what| drop(check(raster, content, what)));
        samples::for_each_mutation(&text, |content, what| {
            std::fs::write(folder.path().join(header), content).unwrap();
            drop(check(raster, &data, what));
        });
        std::fs::remove_file(folder.path().join(header)).unwrap();
    }
    for (name, content) in lying_rasters() {
        check(name, &content, "a lie").expect_err(name);
    }
    check("deep.png", &deep_picture(), "as it is").expect("a sound picture");
    for (name, content) in deep_rasters() {
        check(name, &content, "as it is").expect(name);
    }
    println!("most: {most} bytes");
    for (name, content) in packed_tiles() {
        let (result, peak) = measure(&folder, name, &content);
        println!("{name}: {} bytes, {peak} at most, {result:?}", content.len());
        assert!(peak <= LEGAL_TILE_BYTES.max(4 * content.len() + 16 * MIB), "{name}: {peak} bytes, {result:?}");
    }
}

/// A picture of many pixels in few bytes.
fn deep_picture() -> Vec<u8> {
    png(4000, png::ColorType::Grayscale, png::BitDepth::Sixteen, &vec![0; 4000 * 4000 * 2])
}

/// GeoTIFFs of one strip or a few tiles, of many posts in few bytes.
fn deep_rasters() -> Vec<(&'static str, Vec<u8>)> {
    let base = || Tiff { width: 2500, height: 2500, rows_per_strip: 2500, geokeys: Vec::new(), ..Tiff::default() };
    let packed = |codec, tile| Tiff { codec, tile, ..base() }.encode(|_, _| 7.0);
    vec![("strip.tif", packed(Codec::Deflate, None)), ("tiles.tif", packed(Codec::Lzw, Some(2048)))]
}

/// Files that declare far more than they hold.
fn lying_rasters() -> Vec<(&'static str, Vec<u8>)> {
    let header = |n: u64| format!("ncols {n}\nnrows {n}\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n");
    let base = || Tiff { geokeys: Vec::new(), rows_per_strip: 1 << 20, height: 4, ..Tiff::default() };
    let huge_tile = Tiff { tile: Some(16), missing: vec![0], ..base() };
    // One block of four rows of nine posts, under directories that declare far more posts or a far larger tile.
    let grown = |tiff: Tiff, width: u32, height: u32| {
        let mut bytes = tiff.encode(|_, _| 1.0);
        let grow = |bytes: &mut Vec<u8>, tag: u16, value: u32| {
            let mark = [&tag.to_le_bytes()[..], &4_u16.to_le_bytes(), &1_u32.to_le_bytes()].concat();
            let at = bytes.windows(8).position(|w| w == mark).expect("the tag is there");
            bytes[at + 8..at + 12].copy_from_slice(&value.to_le_bytes());
        };
        let (wide, high) = if tiff.tile.is_some() { (322, 323) } else { (256, 257) };
        grow(&mut bytes, wide, width);
        grow(&mut bytes, high, height);
        bytes
    };
    // Headers that promise the largest cell, over the records of a small one.
    let mut cell = Dted { nx: 9999, ny: 9999, ..Dted::default() }.encode(|_, _| Some(1));
    cell.truncate(MIB);
    let mut cut = deep_picture();
    cut.truncate(cut.len() / 2);
    let of = |codec, samples| Tiff { codec, samples, ..base() };
    let mut all = vec![
        ("grid.asc", header(1 << 30).into_bytes()),
        ("grid.asc", header(u64::MAX).into_bytes()),
        ("grid.asc", [&b"ncols 3 "[..], &[b'7'; MIB]].concat()),
        ("cell.dt2", cell),
        ("cut.png", cut),
        ("far.dem", Usgs::default().encode(&[(0, vec![1]), (900_000, vec![2])])),
        ("wide.tif", grown(base(), 1 << 30, 4)),
        ("tile.tif", grown(huge_tile.clone(), 1 << 14, 1 << 14)),
        ("tile.tif", grown(huge_tile, u32::MAX - 15, u32::MAX - 15)),
        ("sparse.tif", grown(Tiff { missing: vec![0], ..base() }, 60_000, 60_000)),
    ];
    for (codec, samples) in Codec::ALL.into_iter().flat_map(|codec| Samples::ALL.map(|samples| (codec, samples))) {
        all.push(("square.tif", grown(of(codec, samples), 60_000, 60_000)));
        all.push(("wide.tif", grown(of(codec, samples), 1 << 24, 4)));
        all.push(("medium.tif", grown(of(codec, samples), 500, 500)));
    }
    all
}

fn packed_tiles() -> Vec<(&'static str, Vec<u8>)> {
    let (small, large) = (hgt(1201, |_, _| 7), hgt(3601, |_, _| 7));
    // An end record that promises sixteen thousand files.
    let mut crowded = zip("N44W072.hgt", &small);
    let end = crowded.len() - 22;
    crowded[end + 8..end + 12].copy_from_slice(&[0xff, 0x3f, 0xff, 0x3f]);
    let mut lying = gz(&small);
    let end = lying.len() - 4;
    lying[end..].copy_from_slice(&25_934_402_u32.to_le_bytes());
    vec![
        ("N44W072.hgt.zip", zip("N44W072.hgt", &large)),
        ("N44W072.hgt.gz", gz(&large)),
        ("N44W072.zip", zip("N44W072.hgt", &vec![0; 100 * MIB])),
        ("N44W072.gz", gz(&vec![0; 100 * MIB])),
        ("N45W072.zip", crowded),
        ("N45W072.gz", lying),
    ]
}
