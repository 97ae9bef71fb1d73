//! An open database: pages by need, through a bounded cache, each checked when it is read.

use std::{
    fs::File,
    io,
    path::Path,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicU64, Ordering},
    },
};

use sightline_proto::diamond::Post;
use xxhash_rust::xxh3::xxh3_64;

use super::{
    cache::Cache,
    crown::{CORNERS_BYTES, Crown, decode_corners},
    directory::{self, BLOCK_ENTRIES, Entry, IS_CONSTANT},
    envelope,
    error::OpenError,
    format::{self, Element, HEADER_BYTES, Header, Kind, SECTION_BYTES, Section},
    layout::{BoundsPlace, Paging, stored_levels},
    manifest::{MANIFEST_LIMIT, Manifest, Provenance, TerrainManifest},
    pages::{self, BoundsPage},
    source::{FileSource, PageSource},
};
use crate::{
    terrain::{
        Georeference, Grid, HeightField, HeightPage, PAGE_SIDE, PageId, ReadError, SceneScale,
        extremes::{self, ExtremesPage},
    },
    wedgie::{DiamondBounds, ErrorBounds, finest_bounds_with},
};

/// How a database is read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct OpenOptions {
    /// Bytes of decoded pages kept in memory. When all heights take no more than half of them, those that were read are
    /// kept for good, where readers find them without a lock.
    pub cache_bytes: usize,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { cache_bytes: 256 << 20 }
    }
}

/// A section as `info` shows it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SectionInfo {
    /// What it holds.
    pub name: String,
    /// Bytes in the file, directory included.
    pub bytes: u64,
    /// Number of pages.
    pub pages: u64,
}

/// What was read of a file.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Reads {
    /// Pages of heights, bounds and extremes, each by itself.
    pub pages: u64,
    /// Blocks of directories, each by itself.
    pub directory_blocks: u64,
    /// Bytes of these blocks.
    pub directory_bytes: u64,
    /// Reads of all the coarsest lattices of bounds at once.
    pub crowns: u64,
    /// Bytes of all these reads.
    pub bytes: u64,
}

/// The same of one section, counted by all readers.
#[derive(Default)]
struct Counts {
    pages: Count,
    directory_blocks: Count,
}

impl Counts {
    fn so_far(&self) -> Reads {
        let [(pages, bytes), (directory_blocks, directory_bytes)] = [&self.pages, &self.directory_blocks]
            .map(|Count(reads, bytes)| (reads.load(Ordering::Relaxed), bytes.load(Ordering::Relaxed)));
        Reads { pages, directory_blocks, directory_bytes, crowns: 0, bytes: bytes + directory_bytes }
    }
}

/// Reads of one kind, and their bytes.
#[derive(Default)]
struct Count(AtomicU64, AtomicU64);

/// An open terrain database. Shared by threads; everything that reads it is `&self`.
pub struct Database {
    pub(super) source: Box<dyn PageSource>,
    /// The version of its format.
    format: u32,
    pub(super) file_bytes: u64,
    pub(super) sections: Vec<Section>,
    pub(super) manifest: Manifest,
    grid: Grid,
    /// Number of the section of heights, and of the bounds of each stored level, from level 1.
    pub(super) heights: usize,
    pub(super) lattices: Vec<usize>,
    /// Numbers of the sections of extremes, from level 1; none in files without.
    pub(super) extremes: Vec<usize>,
    /// Number of the section of corners, in files that have it.
    pub(super) corners: Option<usize>,
    crown: Crown,
    /// The pages of heights read so far, row by row from the south, where all of them may be kept.
    kept: Option<Box<[OnceLock<Arc<HeightPage>>]>>,
    cache: Cache<Cached>,
    /// By section.
    reads: Box<[Counts]>,
    crowns_read: AtomicU64,
}

#[derive(Clone)]
enum Cached {
    Heights(Arc<HeightPage>),
    Bounds(Arc<BoundsPage>),
    Extremes(Arc<ExtremesPage>),
    Directory(Arc<[Entry]>),
}

impl Cached {
    fn heights(self) -> Option<Arc<HeightPage>> {
        match self {
            Self::Heights(page) => Some(page),
            _ => None,
        }
    }
}

/// Keys of the cache: the section, then the row and column of a page (25 bits each) or, with a bit of its own, the
/// number of a directory block. The place in the file is not needed as long as the cache has the page.
fn page_key(section: usize, id: PageId) -> u64 {
    (section as u64) << 56 | u64::from(id.pj) << 25 | u64::from(id.pi)
}

fn block_key(section: usize, n: u64) -> u64 {
    (section as u64) << 56 | 1 << 55 | n
}

impl Database {
    /// Opens the database at `path`: reads its header, table of sections and manifest, and no page.
    pub fn open(path: &Path, options: OpenOptions) -> Result<Self, OpenError> {
        Self::open_whole(Box::new(FileSource::new(File::open(path)?)), options)
    }

    /// Opens what `source` holds if it is all there.
    pub(super) fn open_whole(source: Box<dyn PageSource>, options: OpenOptions) -> Result<Self, OpenError> {
        let database = Self::open_source(source, options)?;
        database.check_length()?;
        Ok(database)
    }

    /// Whether the file is as long as it says.
    pub(super) fn check_length(&self) -> Result<(), OpenError> {
        let found = self.source.length()?;
        if found == self.file_bytes {
            return Ok(());
        }
        let where_cut = match self.sections.iter().find(|s| found < s.offset + s.length) {
            Some(section) => format!("cut within its {}", section.name()),
            None => "with bytes behind its end".into(),
        };
        Err(OpenError::Length { expected: self.file_bytes, found, where_cut })
    }

    /// Opens what `source` holds, whether or not its length is right.
    pub(super) fn open_source(source: Box<dyn PageSource>, options: OpenOptions) -> Result<Self, OpenError> {
        let there = source.length()?;
        let mut head = vec![0; usize::try_from(there).unwrap_or(HEADER_BYTES).min(HEADER_BYTES)];
        source.read_exact_at(&mut head, 0)?;
        let header = format::decode_header(&head)?;
        let table_bytes = header.sections as usize * SECTION_BYTES;
        let table = read(&*source, || "table of sections".into(), HEADER_BYTES as u64, table_bytes)?;
        let sections = format::decode_table(&header, &table)?;
        let manifest = read_manifest(&*source, &sections)?;
        let grid = Grid::new(manifest.terrain.nx, manifest.terrain.ny)
            .map_err(|e| OpenError::damaged("manifest", e.to_string()))?;
        let Numbers { heights, lattices, corners, extremes } = check_sections(&sections, grid, header.version)?;
        let (columns, rows) = grid.pages();
        let pages_of_heights = columns as usize * rows as usize;
        let bytes = pages_of_heights.saturating_mul(pages::most_heights_weight(sections[heights].element));
        let keeps_all = bytes <= options.cache_bytes / 2;
        let kept = keeps_all.then(|| (0..pages_of_heights).map(|_| OnceLock::new()).collect());
        let cache = Cache::new(options.cache_bytes - if keeps_all { bytes } else { 0 });
        let Header { version: format, file_bytes, .. } = header;
        let crown = Crown::of(&sections, &lattices, corners);
        let reads = sections.iter().map(|_| Counts::default()).collect();
        Ok(Self {
            source,
            format,
            file_bytes,
            sections,
            manifest,
            grid,
            heights,
            lattices,
            extremes,
            corners,
            crown,
            kept,
            cache,
            reads,
            crowns_read: AtomicU64::new(0),
        })
    }

    /// The extent of the grid.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// The constants of the scene frame.
    pub fn scale(&self) -> SceneScale {
        self.manifest.terrain.scale
    }

    /// Where the grid lies on Earth, if its source said so.
    pub fn georeference(&self) -> Option<Georeference> {
        self.manifest.terrain.georeference
    }

    /// The terrain version: a hash of heights, voids, bounds, scale and place.
    pub fn version(&self) -> [u8; 16] {
        self.manifest.version
    }

    /// Least and greatest height of the posts that are not void, in height units.
    pub fn height_range(&self) -> (i32, i32) {
        (self.manifest.terrain.lowest, self.manifest.terrain.highest)
    }

    /// Number of posts without data.
    pub fn void_posts(&self) -> u64 {
        self.manifest.terrain.void_posts
    }

    /// What is stated of the terrain as a whole.
    pub fn terrain(&self) -> &TerrainManifest {
        &self.manifest.terrain
    }

    /// Where the terrain came from.
    pub fn provenance(&self) -> &Provenance {
        &self.manifest.provenance
    }

    /// Bytes of the file.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// What was read since it was opened.
    pub fn reads(&self) -> Reads {
        let crowns = self.crowns_read.load(Ordering::Relaxed);
        let start = Reads { crowns, bytes: crowns * self.crown.bytes(), ..Reads::default() };
        self.reads_by_section().into_iter().fold(start, |all, of| Reads {
            pages: all.pages + of.pages,
            directory_blocks: all.directory_blocks + of.directory_blocks,
            directory_bytes: all.directory_bytes + of.directory_bytes,
            crowns,
            bytes: all.bytes + of.bytes,
        })
    }

    /// The same of each section, in their order; nothing of what was read of several at once.
    pub fn reads_by_section(&self) -> Vec<Reads> {
        self.reads.iter().map(Counts::so_far).collect()
    }

    /// The sections in the order of the file.
    pub fn sections(&self) -> Vec<SectionInfo> {
        let info = |s: &Section| SectionInfo { name: s.name(), bytes: s.length, pages: s.pages };
        self.sections.iter().map(info).collect()
    }

    /// The stored bounds of the diamond at `p`: zero beyond its lattice; `None` for posts with an odd coordinate,
    /// whose bounds follow from a few heights.
    pub fn stored_bounds(&self, p: Post) -> Result<Option<DiamondBounds>, ReadError> {
        Ok(self.stored(p)?.map(|(bounds, _)| bounds))
    }

    /// The same, with the drawn height of the post where that stands beside its bounds.
    fn stored(&self, p: Post) -> Result<Option<(DiamondBounds, Option<f64>)>, ReadError> {
        if (p.i | p.j) % 2 == 1 {
            return Ok(None);
        }
        let Some((number, place)) = BoundsPlace::of(p).and_then(|place| {
            let number = *self.lattices.get(place.level as usize - 1)?;
            let s = &self.sections[number];
            (place.at.0 < s.columns && place.at.1 < s.rows).then_some((number, place))
        }) else {
            return Ok(Some((DiamondBounds::default(), None)));
        };
        let (id, quad, n) = place.in_page();
        let page = self.bounds_page(number, id)?;
        Ok(Some((page.at(quad, n), page.height_at(quad, n))))
    }

    /// Where page `id` of the heights is kept for good.
    #[inline]
    fn kept_page(&self, id: PageId) -> Option<&OnceLock<Arc<HeightPage>>> {
        let (columns, _) = self.grid.pages();
        self.kept.as_ref()?.get(id.pj as usize * columns as usize + id.pi as usize)
    }

    fn bounds_page(&self, section: usize, id: PageId) -> Result<Arc<BoundsPage>, ReadError> {
        let key = page_key(section, id);
        if let Some(Cached::Bounds(page)) = self.cache.get(key) {
            return Ok(page);
        }
        let paging = Paging::of_lattice(self.sections[section].columns, self.sections[section].rows);
        let (bytes, entry) = self.page_bytes(section, &paging, paging.number(id))?;
        let page = pages::decode_bounds(&bytes, self.sections[section].element, paging.size(id), entry.flags)
            .map_err(|e| self.damaged(section, id, e))?;
        let page = Arc::new(page);
        self.cache.insert(key, Cached::Bounds(Arc::clone(&page)), page.weight());
        Ok(page)
    }

    /// The checked bytes of page `n` of a section, and its directory entry.
    pub(super) fn page_bytes(&self, section: usize, paging: &Paging, n: u64) -> Result<(Vec<u8>, Entry), ReadError> {
        let entry = self.directory_block(section, n / BLOCK_ENTRIES)?[(n % BLOCK_ENTRIES) as usize];
        let id = paging.id(n);
        let s = &self.sections[section];
        let length = entry.length as usize;
        let end = entry.offset.checked_add(u64::from(entry.length));
        if entry.offset < s.offset || end.is_none_or(|end| end > s.offset + s.length) {
            return Err(self.damaged(section, id, "its directory entry points outside the section"));
        }
        let unknown = if self.format == 1 { entry.flags & IS_CONSTANT } else { 0 };
        if unknown != 0 || pages::page_bytes(s.element, paging.size(id), entry.flags) != Some(length) {
            return Err(self.damaged(section, id, "its directory entry states another length than the page has"));
        }
        let bytes = self.fetch(section, |counts| &counts.pages, || page_name(s, id), entry.offset, length)?;
        if xxh3_64(&bytes) != entry.checksum {
            return Err(self.damaged(section, id, "its checksum does not fit its bytes"));
        }
        Ok((bytes, entry))
    }

    /// Block `n` of the directory of a section.
    pub(super) fn directory_block(&self, section: usize, n: u64) -> Result<Arc<[Entry]>, ReadError> {
        let key = block_key(section, n);
        if let Some(Cached::Directory(block)) = self.cache.get(key) {
            return Ok(block);
        }
        let s = &self.sections[section];
        let (at, length) = directory::block_span(s.pages, n);
        let what = || format!("block {n} of the directory of {}", s.name());
        let bytes = self.fetch(section, |counts| &counts.directory_blocks, what, s.offset + at, length)?;
        let Some(block) = directory::decode_block(n, &bytes) else {
            return Err(ReadError::Damaged { what: what(), detail: "its checksum does not fit its bytes".into() });
        };
        let block: Arc<[Entry]> = block.into();
        self.cache.insert(key, Cached::Directory(Arc::clone(&block)), length);
        Ok(block)
    }

    /// Reads a part of a section that has `length` bytes, which the caller has bounded: from the crown where it is in it, else
    /// by itself, and then it is counted as `which`.
    fn fetch(
        &self,
        section: usize,
        which: impl Fn(&Counts) -> &Count,
        what: impl Fn() -> String,
        offset: u64,
        length: usize,
    ) -> Result<Vec<u8>, ReadError> {
        let was_read = || {
            self.crowns_read.fetch_add(1, Ordering::Relaxed);
        };
        if let Some(bytes) = self.crown.get(&*self.source, offset, length, was_read) {
            return Ok(bytes.into());
        }
        let bytes = read(&*self.source, what, offset, length)?;
        let Count(reads, read_bytes) = which(&self.reads[section]);
        reads.fetch_add(1, Ordering::Relaxed);
        read_bytes.fetch_add(length as u64, Ordering::Relaxed);
        Ok(bytes)
    }

    pub(super) fn damaged(&self, section: usize, id: PageId, detail: impl Into<String>) -> ReadError {
        ReadError::Damaged { what: page_name(&self.sections[section], id), detail: detail.into() }
    }
}

impl HeightField for Database {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        let key = page_key(self.heights, id);
        let kept = self.kept_page(id);
        let found = match kept {
            Some(kept) => kept.get().cloned(),
            None => self.cache.get(key).and_then(Cached::heights),
        };
        if let Some(page) = found {
            return Ok(page);
        }
        let paging = Paging::of_heights(self.grid.nx(), self.grid.ny());
        let (bytes, entry) = self.page_bytes(self.heights, &paging, paging.number(id))?;
        let element = self.sections[self.heights].element;
        let page = pages::decode_heights(&bytes, element, paging.size(id), entry.flags)
            .map_err(|e| self.damaged(self.heights, id, e))?;
        let page = Arc::new(page);
        if let Some(kept) = kept {
            // Another thread may have read the same page meanwhile.
            return Ok(Arc::clone(kept.get_or_init(|| page)));
        }
        self.cache.insert(key, Cached::Heights(Arc::clone(&page)), pages::heights_weight(&page));
        Ok(page)
    }

    #[inline]
    fn resident(&self, id: PageId) -> Option<&HeightPage> {
        self.kept_page(id)?.get().map(|page| &**page)
    }

    fn extremes(&self, level: u32, id: PageId) -> Result<Option<Arc<ExtremesPage>>, ReadError> {
        let Some(&section) = (level as usize).checked_sub(1).and_then(|n| self.extremes.get(n)) else {
            return Ok(None);
        };
        let key = page_key(section, id);
        if let Some(Cached::Extremes(page)) = self.cache.get(key) {
            return Ok(Some(page));
        }
        let s = &self.sections[section];
        let paging = Paging::of_heights(s.columns, s.rows);
        let (bytes, entry) = self.page_bytes(section, &paging, paging.number(id))?;
        let values = pages::decode_extremes(&bytes, s.element, paging.size(id), entry.flags);
        let page = Arc::new(ExtremesPage::new(&*values.map_err(|e| self.damaged(section, id, e))?));
        self.cache.insert(key, Cached::Extremes(Arc::clone(&page)), page.weight());
        Ok(Some(page))
    }

    fn corner_heights(&self) -> Result<Option<[f64; 4]>, ReadError> {
        let Some(section) = self.corners else { return Ok(None) };
        let s = &self.sections[section];
        let bytes = self.fetch(section, |counts| &counts.pages, || s.name(), s.offset, CORNERS_BYTES)?;
        let Some(heights) = decode_corners(&bytes) else {
            return Err(ReadError::Damaged { what: s.name(), detail: "its checksum does not fit its bytes".into() });
        };
        Ok(Some(heights.map(f64::from)))
    }
}

impl ErrorBounds for Database {
    fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError> {
        if let Some(bounds) = self.stored_bounds(p)? {
            return Ok(bounds);
        }
        let mut held: Option<(PageId, Arc<HeightPage>)> = None;
        finest_bounds_with(self.grid, self.scale(), p, |q| {
            let id = PageId::of(q);
            let page = match held.take() {
                Some((at, page)) if at == id => page,
                _ => self.page(id)?,
            };
            let z = page.at(q.i % PAGE_SIDE, q.j % PAGE_SIDE).z;
            held = Some((id, page));
            Ok(z)
        })
    }

    fn bounds_and_height(&self, p: Post) -> Result<(DiamondBounds, Option<f64>), ReadError> {
        match self.stored(p)? {
            Some(found) => Ok(found),
            None => Ok((self.bounds(p)?, None)),
        }
    }
}

impl std::fmt::Debug for Database {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Database").field("manifest", &self.manifest).finish_non_exhaustive()
    }
}

fn page_name(section: &Section, id: PageId) -> String {
    format!("page ({}, {}) of {}", id.pi, id.pj, section.name())
}

/// Reads `length` bytes, which the caller has bounded by a constant or by the length of the file.
fn read(source: &dyn PageSource, what: impl Fn() -> String, offset: u64, length: usize) -> Result<Vec<u8>, ReadError> {
    let mut bytes = vec![0; length];
    match source.read_exact_at(&mut bytes, offset) {
        Ok(()) => Ok(bytes),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
            Err(ReadError::Damaged { what: what(), detail: "the file ends before it does".into() })
        }
        Err(error) => Err(ReadError::Io { what: what(), detail: error.to_string() }),
    }
}

impl From<ReadError> for OpenError {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Damaged { what, detail } => Self::damaged("front", format!("{what}: {detail}")),
            ReadError::Io { .. } => Self::Io(io::Error::other(error.to_string())),
        }
    }
}

fn read_manifest(source: &dyn PageSource, sections: &[Section]) -> Result<Manifest, OpenError> {
    let section = match sections.first() {
        Some(s) if s.kind == Kind::Manifest => s,
        _ => return Err(OpenError::damaged("table of sections", "the first section is not the manifest")),
    };
    let unused = [section.element.number(), section.level, section.columns, section.rows];
    if unused != [0; 4] || section.pages != 0 {
        return Err(OpenError::damaged("table of sections", "a reserved field is not zero"));
    }
    let length = usize::try_from(section.length).unwrap_or(usize::MAX);
    if length > MANIFEST_LIMIT {
        return Err(OpenError::damaged("manifest", format!("it is longer than {MANIFEST_LIMIT} bytes")));
    }
    let bytes = read(source, || "manifest".into(), section.offset, length)?;
    envelope::open::<Manifest, MANIFEST_LIMIT>(&bytes).map_err(|e| match e {
        envelope::EnvelopeError::Version { .. } => OpenError::Unsupported(format!("a newer manifest ({e})")),
        e => OpenError::damaged("manifest", e.to_string()),
    })
}

/// The numbers of sections: of heights, of bounds by level from 1, of corners, of extremes by level from 1.
struct Numbers {
    heights: usize,
    lattices: Vec<usize>,
    corners: Option<usize>,
    extremes: Vec<usize>,
}

/// Checks the sections of a file of this format version against the grid.
fn check_sections(sections: &[Section], grid: Grid, format: u32) -> Result<Numbers, OpenError> {
    let damaged = |detail: String| OpenError::damaged("table of sections", detail);
    let mut heights = Vec::new();
    let mut lattices = Vec::new();
    let mut corners = None;
    let mut extremes = Vec::new();
    let levels = stored_levels(grid.root().exponent()).len();
    for (number, section) in sections.iter().enumerate().skip(1) {
        let side = grid.root().side();
        let fits = match (section.kind, section.element) {
            (Kind::Heights, Element::I16 | Element::I32) => {
                heights.push(number);
                section.level == 0 && (section.columns, section.rows) == (grid.nx(), grid.ny())
            }
            (Kind::Bounds, element) if element.is_of_bounds() => {
                lattices.push(number);
                let most = side.checked_shr(section.level).map_or(0, |n| n + 1);
                let fits = section.columns <= most && section.rows <= most;
                section.level as usize == lattices.len() && fits && (format >= 3 || !element.has_heights_beside())
            }
            (Kind::Extremes, Element::PairI16 | Element::PairI32) => {
                extremes.push(number);
                section.level as usize == extremes.len()
                    && (section.columns, section.rows) == extremes::extent(grid, section.level)
            }
            (Kind::Corners, Element::Byte) => {
                let is_behind_bounds = lattices.len() == levels && extremes.is_empty();
                let unused = [section.level, section.columns, section.rows];
                let is_plain = unused == [0; 3] && section.length == CORNERS_BYTES as u64;
                is_behind_bounds && is_plain && corners.replace(number).is_none()
            }
            (Kind::Other(_), _) => continue,
            _ => false,
        };
        let pages = Paging::of_section(section).map_or(0, |paging| paging.pages());
        let directory = directory::bytes(pages).filter(|&bytes| bytes <= section.length);
        if !fits || section.pages != pages || directory.is_none() {
            return Err(damaged(format!("the entry of {} does not fit the grid", section.name())));
        }
    }
    let levels_of_extremes = extremes::levels(grid) as usize;
    if !extremes.is_empty() && extremes.len() != levels_of_extremes {
        return Err(damaged(format!(
            "{} sections of extremes, where {levels_of_extremes} or none are needed",
            extremes.len()
        )));
    }
    match heights[..] {
        [heights] if lattices.len() == levels => Ok(Numbers { heights, lattices, corners, extremes }),
        _ => Err(damaged(format!(
            "{} sections of heights and {} of bounds, where 1 and {levels} are needed",
            heights.len(),
            lattices.len()
        ))),
    }
}
