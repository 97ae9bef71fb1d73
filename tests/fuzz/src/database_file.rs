//! Any bytes as a terrain database: refused, or read as far as they go. The target of libFuzzer and the mutations of
//! `tests/dem/mutations.rs` ask the same of the same corpus.
//!
//! A checksum does not protect from who can compute it, so [`repair`] puts all of them right, by `FORMAT.md` alone.

use std::path::Path;

use sightline::{
    database::{self, Database, OpenOptions},
    terrain::{HeightField, PageId, extremes},
    wedgie::ErrorBounds,
};
use sightline_proto::diamond::Post;
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

const HEADER_BYTES: usize = 40;
const SECTION_BYTES: usize = 56;
const MANIFEST: u32 = 1;
const CORNERS: u32 = 5;
/// Bytes of a manifest before its value, of a directory's entry, and entries of a block of it.
const MANIFEST_HEAD_BYTES: usize = 32;
const ENTRY_BYTES: usize = 24;
const BLOCK_ENTRIES: u64 = 128;
/// Pages along a side, and posts along a line, that are read of a file: one may state many.
const PAGES: u32 = 8;
const POSTS: u32 = 400;

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at.checked_add(8)?)?.try_into().ok()?))
}

fn put(bytes: &mut [u8], at: usize, value: u64) -> Option<()> {
    bytes.get_mut(at..at.checked_add(8)?)?.copy_from_slice(&value.to_le_bytes());
    Some(())
}

/// A place in the file, if there is one.
fn place(number: u64) -> Option<usize> {
    usize::try_from(number).ok()
}

/// Puts the stated length and all checksums right, as far as the places for them are in the file.
pub(crate) fn repair(bytes: &mut [u8]) -> Option<()> {
    let sections = u32_at(bytes, 12)?.min(64) as usize;
    for at in (0..sections).map(|n| HEADER_BYTES + n * SECTION_BYTES) {
        let (Some(kind), Some(pages)) = (u32_at(bytes, at), u64_at(bytes, at + 24)) else { break };
        let (Some(offset), Some(length)) = (u64_at(bytes, at + 32), u64_at(bytes, at + 40)) else { break };
        let _ = match kind {
            MANIFEST => repair_manifest(bytes, offset, length),
            CORNERS => repair_corners(bytes, offset),
            _ => repair_pages(bytes, offset, pages),
        };
    }
    put(bytes, 16, bytes.len() as u64)?;
    let table = xxh3_64(bytes.get(HEADER_BYTES..HEADER_BYTES + sections * SECTION_BYTES)?);
    put(bytes, 24, table)?;
    let header = xxh3_64(&bytes[..32]);
    put(bytes, 32, header)
}

fn repair_manifest(bytes: &mut [u8], offset: u64, length: u64) -> Option<()> {
    let start = place(offset)?;
    let end = place(offset.checked_add(length)?)?;
    let version = u32_at(bytes, start.checked_add(8)?)?;
    let sum = xxh3_64_with_seed(bytes.get(start.checked_add(MANIFEST_HEAD_BYTES)?..end)?, version.into());
    put(bytes, start + 24, sum)
}

fn repair_corners(bytes: &mut [u8], offset: u64) -> Option<()> {
    let start = place(offset)?;
    let end = start.checked_add(16)?;
    let sum = xxh3_64(bytes.get(start..end)?);
    put(bytes, end, sum)
}

fn repair_pages(bytes: &mut [u8], offset: u64, pages: u64) -> Option<()> {
    let mut at = place(offset)?;
    for block in 0..pages.div_ceil(BLOCK_ENTRIES) {
        let entries = (pages - block * BLOCK_ENTRIES).min(BLOCK_ENTRIES) as usize;
        for entry in (0..entries).map(|n| at + n * ENTRY_BYTES) {
            let (first, length) = (place(u64_at(bytes, entry)?)?, u32_at(bytes, entry + 16)? as usize);
            let page = first.checked_add(length).and_then(|end| bytes.get(first..end));
            let sum = page.map_or(0, xxh3_64);
            put(bytes, entry + 8, sum)?;
        }
        let end = at + entries * ENTRY_BYTES;
        let sum = xxh3_64_with_seed(bytes.get(at..end)?, block);
        put(bytes, end, sum)?;
        at = end + 8;
    }
    Some(())
}

/// Panics where a promise is broken: what is called sound must be read. Else the words of what is wrong first.
pub(crate) fn check(path: &Path, bytes: &[u8]) -> Result<(), String> {
    std::fs::write(path, bytes).expect("the folder for temporary files can be written to");
    let verified = database::verify(path, &|_, _| ());
    let database = Database::open(path, OpenOptions { cache_bytes: 1 << 20 }).map_err(|error| error.to_string())?;
    let read = read(&database);
    match verified {
        Ok(found) if found.damage.is_empty() => assert!(read.is_ok(), "called sound, but {read:?}"),
        Ok(found) => return Err(found.damage[0].clone()),
        Err(error) => return Err(error.to_string()),
    }
    read
}

/// Reads this and that.
fn read(database: &Database) -> Result<(), String> {
    let grid = HeightField::grid(database);
    for level in 0..extremes::levels(grid) + 1 {
        let pages = if level == 0 { Some(grid.pages()) } else { extremes::pages(grid, level) };
        let (columns, rows) = pages.unwrap_or_default();
        for (pj, pi) in (0..rows.min(PAGES)).flat_map(|pj| (0..columns.min(PAGES)).map(move |pi| (pj, pi))) {
            let id = PageId { pi, pj };
            let read = if level == 0 { database.page(id).map(drop) } else { database.extremes(level, id).map(drop) };
            read.map_err(|error| error.to_string())?;
        }
    }
    database.corner_heights().map_err(|error| error.to_string())?;
    let (root, side) = (grid.root(), grid.root().side());
    for (i, j) in (0..=side).take(POSTS as usize).flat_map(|n| [(0, n), (side / 2, n), (n, 2.min(side)), (n, n)]) {
        let p = Post::new(i, j);
        if !root.is_corner(p) {
            database.bounds(p).map_err(|error| error.to_string())?;
        }
    }
    Ok(())
}
