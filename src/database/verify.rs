//! Reads every page of a database and names those that do not hold what was written.

use std::path::Path;

use rayon::prelude::*;
use sightline_proto::diamond::Post;
use xxhash_rust::xxh3::Xxh3;

use super::{
    Database, OpenError, OpenOptions,
    directory::{self, BLOCK_ENTRIES},
    format::{Kind, Section},
    layout::{Paging, QUAD_DIAMONDS, QUAD_SIDE, quad_post},
    pages::{self, BoundsPage},
    source::{FileSource, PageSource},
    writer::{hash_section, is_hashed},
};
use crate::terrain::{
    HeightField, PAGE_POSTS, PAGE_SIDE, PageId, ReadError,
    extremes::{BLOCK_SIDE, Extremes, extent},
};

/// What verification found.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Verification {
    /// Pages of all sections.
    pub pages: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Pages whose bytes were read and found good.
    pub good_pages: u64,
    /// What is wrong, in the order of the file; empty for a sound database.
    pub damage: Vec<String>,
    /// Sections of a kind that this program does not know, and so could not check.
    pub unknown_sections: Vec<String>,
}

/// Checks the database at `path`: every page, every checksum, the terrain version, and what the manifest says of the
/// heights. An error means that its front matter is no longer (or never was) that of a database.
///
/// `progress` is told how many pages more were checked, and how many there are in all, from any thread.
pub fn verify(path: &Path, progress: &(dyn Fn(u64, u64) + Sync)) -> Result<Verification, OpenError> {
    verify_source(Box::new(FileSource::new(std::fs::File::open(path)?)), progress)
}

pub(super) fn verify_source(
    source: Box<dyn PageSource>,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Verification, OpenError> {
    let database = Database::open_source(source, OpenOptions { cache_bytes: 8 << 20 })?;
    let mut found = Verification { bytes: database.file_bytes, ..Verification::default() };
    if let Err(error) = database.check_length() {
        found.damage.push(error.to_string());
    }
    let mut hash = Xxh3::new();
    let terrain = database.manifest.terrain.hashed_bytes();
    hash.update(&terrain.map_err(|e| OpenError::damaged("manifest", e.to_string()))?);
    let mut heights = None;
    let total = database.sections.iter().map(|s| s.pages).sum();
    let progress = |more| progress(more, total);
    for (number, section) in database.sections.iter().enumerate() {
        let Some(paging) = Paging::of_section(section).filter(|_| !matches!(section.kind, Kind::Other(_))) else {
            match section.kind {
                Kind::Other(_) => found.unknown_sections.push(section.name()),
                Kind::Corners => found.damage.extend(check_corners(&database).err()),
                _ => {}
            }
            continue;
        };
        let blocks = (0..directory::blocks(section.pages)).into_par_iter();
        let seen = blocks.map(|n| check_block(&database, number, &paging, n, &progress));
        let seen = seen.collect::<Vec<_>>().into_iter().fold(Seen::start_of(section), Seen::followed_by);
        if seen.end != section.offset + section.length && seen.damage.is_empty() {
            found.damage.push(format!("the pages of {} do not fill it", section.name()));
        }
        found.pages += section.pages;
        found.good_pages += seen.checksums.len() as u64;
        if is_hashed(section) {
            hash_section(&mut hash, section);
            seen.checksums.iter().for_each(|checksum| hash.update(&checksum.to_le_bytes()));
        }
        found.damage.extend(seen.damage);
        heights = heights.or((section.kind == Kind::Heights).then_some((seen.range, seen.void_posts)));
    }
    if found.damage.is_empty() {
        let stated = (Some(database.height_range()), database.void_posts());
        if heights != Some(stated) {
            found.damage.push("the manifest states another range of heights or number of voids".into());
        }
        if hash.digest128().to_be_bytes() != database.version() {
            found.damage.push("the terrain version is not the hash of the content".into());
        }
    }
    Ok(found)
}

/// What was seen of consecutive pages of a section.
#[derive(Default)]
struct Seen {
    checksums: Vec<u64>,
    damage: Vec<String>,
    /// Where the first page starts and the last one ends.
    start: Option<u64>,
    end: u64,
    /// Range of known heights.
    range: Option<(i32, i32)>,
    void_posts: u64,
}

impl Seen {
    fn start_of(section: &Section) -> Self {
        let end = section.offset + directory::bytes(section.pages).unwrap_or(0);
        Self { end, ..Self::default() }
    }

    fn followed_by(mut self, next: Self) -> Self {
        if next.start.is_some_and(|start| start != self.end) && self.damage.is_empty() && next.damage.is_empty() {
            self.damage.push(format!("the pages do not lie end to end at byte {}", self.end));
        }
        self.checksums.extend(next.checksums);
        self.damage.extend(next.damage);
        self.range = [self.range, next.range].into_iter().flatten().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        self.void_posts += next.void_posts;
        self.end = if next.start.is_some() { next.end } else { self.end };
        self
    }

    fn failed(error: ReadError) -> Self {
        Self { damage: vec![words(error)], ..Self::default() }
    }
}

/// What could not be read, and why.
fn words(error: ReadError) -> String {
    match error {
        ReadError::Damaged { what, detail } | ReadError::Io { what, detail } => format!("{what}: {detail}"),
    }
}

fn check_block(database: &Database, section: usize, paging: &Paging, n: u64, progress: &(dyn Fn(u64) + Sync)) -> Seen {
    let pages = database.sections[section].pages;
    let (first, last) = (n * BLOCK_ENTRIES, ((n + 1) * BLOCK_ENTRIES).min(pages));
    let seen = match database.directory_block(section, n) {
        Ok(_) => (first..last)
            .map(|n| check_page(database, section, paging, n).unwrap_or_else(Seen::failed))
            .reduce(Seen::followed_by)
            .unwrap_or_default(),
        Err(error) => Seen::failed(error),
    };
    progress(last - first);
    seen
}

fn check_page(database: &Database, section: usize, paging: &Paging, n: u64) -> Result<Seen, ReadError> {
    let (bytes, entry) = database.page_bytes(section, paging, n)?;
    let (id, size) = (paging.id(n), paging.size(paging.id(n)));
    let damaged = |detail| database.damaged(section, id, detail);
    let mut seen = Seen {
        checksums: vec![entry.checksum],
        start: Some(entry.offset),
        end: entry.offset + bytes.len() as u64,
        ..Seen::default()
    };
    let s = &database.sections[section];
    if s.kind == Kind::Bounds {
        let page = pages::decode_bounds(&bytes, s.element, size, entry.flags).map_err(damaged)?;
        check_beside(database, s, id, &page, size.0).map_err(damaged)?;
        return Ok(seen);
    }
    if s.kind == Kind::Extremes {
        let values = pages::decode_extremes(&bytes, s.element, size, entry.flags).map_err(damaged)?;
        check_extremes(database, s.level, id, &values).map_err(damaged)?;
        return Ok(seen);
    }
    let page = pages::decode_heights(&bytes, s.element, size, entry.flags).map_err(damaged)?;
    debug_assert!(size.0 <= PAGE_SIDE && size.1 <= PAGE_SIDE);
    for (j, i) in (0..size.1).flat_map(|j| (0..size.0).map(move |i| (j, i))) {
        let post = page.at(i, j);
        if post.void {
            seen.void_posts += 1;
        } else {
            let z = post.z as i32;
            let (lowest, highest) = seen.range.unwrap_or((z, z));
            seen.range = Some((lowest.min(z), highest.max(z)));
        }
    }
    Ok(seen)
}

/// Holds a page of extremes against the level below. What cannot be read there is damage of its own, found there.
fn check_extremes(database: &Database, level: u32, id: PageId, values: &[Extremes; PAGE_POSTS]) -> Result<(), String> {
    // Pages of the level below along the side of this one, and the values of this one that each gives.
    let (side, gives) = if level == 1 { (BLOCK_SIDE, PAGE_SIDE / BLOCK_SIDE) } else { (PAGE_SIDE, 1) };
    let (columns, rows) = extent(database.grid(), level - 1);
    let (columns, rows) = (columns.div_ceil(PAGE_SIDE), rows.div_ceil(PAGE_SIDE));
    let (west, south) = (id.pi * side, id.pj * side);
    for below in
        (south..rows.min(south + side)).flat_map(|pj| (west..columns.min(west + side)).map(move |pi| PageId { pi, pj }))
    {
        let found: Vec<_> = if level == 1 {
            let Ok(page) = database.page(below) else { continue };
            Extremes::of_blocks(&page, database.grid().page_size(below)).collect()
        } else {
            let Ok(Some(page)) = database.extremes(level - 1, below) else { continue };
            vec![page.all()]
        };
        let across = if level == 1 { database.grid().page_size(below).0.div_ceil(BLOCK_SIDE) } else { 1 };
        for (n, value) in (0..).zip(found) {
            let (i, j) = ((below.pi - west) * gives + n % across, (below.pj - south) * gives + n / across);
            if values[(j * PAGE_SIDE + i) as usize] != value {
                return Err("its values are not those of the heights".into());
            }
        }
    }
    Ok(())
}

/// Holds the heights of the corners against those of the posts. What cannot be read there is damage of its own, found there.
fn check_corners(database: &Database) -> Result<(), String> {
    let heights = database.corner_heights().map_err(words)?;
    for (corner, z) in database.grid().root().corners().into_iter().zip(heights.into_iter().flatten()) {
        let p = database.grid().clamp(corner);
        let page = database.page(PageId::of(p)).ok();
        if page.is_some_and(|page| page.at(p.i % PAGE_SIDE, p.j % PAGE_SIDE).z != z) {
            return Err("corners: its heights are not those of the posts".into());
        }
    }
    Ok(())
}

/// Holds the heights beside the bounds of a page against those of the posts. What cannot be read there is damage of its own,
/// found there.
fn check_beside(
    database: &Database,
    section: &Section,
    id: PageId,
    page: &BoundsPage,
    quads_a_row: u32,
) -> Result<(), String> {
    let mut held: Option<(PageId, Option<_>)> = None;
    for (n, &z) in page.heights().iter().enumerate() {
        let quad = (n / QUAD_DIAMONDS) as u32;
        let (u, v) = (id.pi * QUAD_SIDE + quad % quads_a_row, id.pj * QUAD_SIDE + quad / quads_a_row);
        let (a, b) = quad_post(u, v, n % QUAD_DIAMONDS);
        if a >= section.columns || b >= section.rows {
            continue;
        }
        let p = database.grid().clamp(Post::new(a << section.level, b << section.level));
        let from = PageId::of(p);
        let heights = match held.take() {
            Some((at, heights)) if at == from => heights,
            _ => database.page(from).ok(),
        };
        if heights.as_ref().is_some_and(|page| page.at(p.i % PAGE_SIDE, p.j % PAGE_SIDE).z != f64::from(z)) {
            return Err("its heights are not those of the posts".into());
        }
        held = Some((from, heights));
    }
    Ok(())
}
