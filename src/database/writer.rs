//! Writes a database beside its place and renames it into place: a crash leaves what was there before, or nothing.
//!
//! When all pages are made (`draft`), the sizes of all sections are known. So pages are written once, in the order of the
//! file, a block of a directory's at a time, and the front matter last.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

use super::{
    budget::{Budget, DEFAULT_MEMORY_BYTES},
    crown::{CORNERS_BYTES, encode_corners},
    directory::{self, BLOCK_ENTRIES, Entry},
    draft::{Draft, Heights, Measured},
    envelope,
    error::WriteError,
    format::{self, Element, Kind, REQUIRED, Section},
    layout::{Paging, stored_levels},
    manifest::{MANIFEST_LIMIT, Manifest, Provenance, TerrainManifest},
    pages,
    scratch::Scratch,
};
use crate::{
    terrain::{Georeference, Grid, HeightField, PAGE_POSTS, PAGE_SIDE, PageId, SceneScale, extremes},
    wedgie::LatticeSize,
};

/// What is said of a terrain besides its heights.
#[derive(Clone, PartialEq, Debug)]
pub struct Description {
    /// Metres per post east and north and per height unit.
    pub scale: SceneScale,
    /// Where the grid lies on Earth, if known.
    pub georeference: Option<Georeference>,
    /// Where the terrain came from.
    pub provenance: Provenance,
}

/// What was written.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Written {
    /// The terrain version.
    pub version: [u8; 16],
    /// Bytes of the file.
    pub file_bytes: u64,
}

/// Writes `field`, whose heights must be 32-bit integers, and its bounds as a database at `path`.
///
/// `progress` is told the share of posts that is written. An existing file is replaced only if `replace` says so, and
/// only once the new one is complete and on the disk.
pub fn write(
    path: &Path,
    replace: bool,
    field: &impl HeightField,
    description: &Description,
    progress: &mut dyn FnMut(u64),
) -> Result<Written, WriteError> {
    refuse_existing(path, replace)?;
    let budget = budget(DEFAULT_MEMORY_BYTES, field.grid())?;
    let scratch = Scratch::beside(path, budget.cache_bytes)?;
    let draft = Draft::complete(&scratch, heights_of(field, &scratch)?, description.scale, budget, &|_| ())?;
    publish(path, replace, |file| Content::plan(&draft, description)?.write(file, path, progress))
}

/// Shares of memory for a grid and the threads of this pool.
pub(super) fn budget(memory_bytes: usize, grid: Grid) -> Result<Budget, WriteError> {
    Budget::new(memory_bytes, grid, rayon::current_num_threads()).map_err(|needed| WriteError::Memory {
        needed,
        given: memory_bytes,
        nx: grid.nx(),
        ny: grid.ny(),
    })
}

/// The heights of `field`, whose void posts are filled, as pages.
pub(super) fn heights_of<'a>(field: &impl HeightField, scratch: &'a Scratch) -> Result<Heights<'a>, WriteError> {
    let grid = field.grid();
    let mut heights = Heights::new(scratch, grid);
    for pj in 0..grid.pages().1 {
        heights.push_row(pj, |id| measured(field, id))?;
    }
    Ok(heights)
}

fn measured(field: &impl HeightField, id: PageId) -> Result<Measured, WriteError> {
    let (page, (w, h)) = (field.page(id)?, field.grid().page_size(id));
    let (mut heights, mut voids, mut known) = (vec![0; PAGE_POSTS], [0; PAGE_POSTS / 64], None);
    for (j, i) in (0..h).flat_map(|j| (0..w).map(move |i| (j, i))) {
        let post = page.at(i, j);
        let z = pages::exact_i32(post.z).ok_or_else(|| WriteError::Height {
            i: id.pi * PAGE_SIDE + i,
            j: id.pj * PAGE_SIDE + j,
            z: post.z,
        })?;
        heights[(j * PAGE_SIDE + i) as usize] = z;
        if post.void {
            voids[j as usize] |= 1 << i;
        } else {
            let (lowest, highest) = known.unwrap_or((z, z));
            known = Some((z.min(lowest), z.max(highest)));
        }
    }
    Ok(Measured::new(&heights, &voids, known))
}

/// Where a writer puts bytes: a file, or in tests one that fails.
pub(super) trait Sink {
    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<()>;
}

impl Sink for File {
    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        use io::{Seek, SeekFrom, Write};
        self.seek(SeekFrom::Start(offset))?;
        self.write_all(bytes)
    }
}

/// Refuses an output that exists, unless it is to be replaced.
pub(super) fn refuse_existing(path: &Path, replace: bool) -> Result<(), WriteError> {
    if !replace && path.exists() { Err(WriteError::Exists(path.into())) } else { Ok(()) }
}

/// Lets `fill` write a new file beside `path`, and moves it there once it is on the disk.
pub(super) fn publish<T>(
    path: &Path,
    replace: bool,
    fill: impl FnOnce(&mut File) -> Result<T, WriteError>,
) -> Result<T, WriteError> {
    let io_error = |error| WriteError::Io { path: path.into(), error };
    refuse_existing(path, replace)?;
    let name = path.file_name().ok_or_else(|| io_error(io::Error::other("it is not the name of a file")))?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let beside = folder.join(format!(".{}.{}.partial", name.to_string_lossy(), std::process::id()));
    let partial = Partial(beside);
    let mut file = File::create(&partial.0).map_err(io_error)?;
    let result = fill(&mut file)?;
    file.sync_all().map_err(io_error)?;
    drop(file);
    partial.move_to(path, replace)?;
    // The name itself must survive a crash too. Systems that cannot open a folder keep names without it.
    if let Ok(folder) = File::open(folder) {
        folder.sync_all().map_err(io_error)?;
    }
    Ok(result)
}

/// An unfinished file, removed when it is dropped.
struct Partial(PathBuf);

impl Partial {
    fn move_to(self, path: &Path, replace: bool) -> Result<(), WriteError> {
        let io_error = |error| WriteError::Io { path: path.into(), error };
        if replace {
            return fs::rename(&self.0, path).map_err(io_error);
        }
        // A hard link, unlike a rename, refuses to take the place of a file that came up meanwhile.
        match fs::hard_link(&self.0, path) {
            Ok(()) => Ok(()),
            Err(_) if path.exists() => Err(WriteError::Exists(path.into())),
            Err(_) => fs::rename(&self.0, path).map_err(io_error),
        }
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // It is gone already when it was renamed into place; and there is nobody left to tell.
        let _ = fs::remove_file(&self.0);
    }
}

/// Everything that is about to be written, with the plan of the file.
pub(super) struct Content<'a> {
    draft: &'a Draft<'a>,
    manifest: Manifest,
    sections: Vec<Section>,
    file_bytes: u64,
}

/// A page as it is written.
struct Page {
    bytes: Vec<u8>,
    flags: u32,
    checksum: u64,
}

impl<'a> Content<'a> {
    /// Plans the file.
    pub(super) fn plan(draft: &'a Draft<'a>, description: &Description) -> Result<Self, WriteError> {
        let (heights, grid) = (&draft.heights, draft.heights.grid());
        let (lowest, highest) = heights.known.ok_or(WriteError::AllVoid { posts: grid.posts() })?;
        let terrain = TerrainManifest {
            nx: grid.nx(),
            ny: grid.ny(),
            scale: description.scale,
            georeference: description.georeference,
            lowest,
            highest,
            void_posts: heights.void_posts,
        };
        terrain.check().map_err(WriteError::Description)?;
        let manifest = Manifest { terrain, provenance: description.provenance.clone(), version: [0; 16] };
        let manifest_bytes = envelope::seal(&manifest)?.len();
        if manifest_bytes > MANIFEST_LIMIT {
            let words =
                format!("the manifest has {manifest_bytes} bytes, more than {MANIFEST_LIMIT}: name fewer sources");
            return Err(WriteError::Description(words));
        }
        debug_assert_eq!(draft.lattices.shelves.len(), stored_levels(grid.root().exponent()).len());
        let element = heights.element();
        let lattices: Vec<_> =
            draft.lattices.shelves.iter().map(|(size, shelf)| (*size, shelf.stored_bytes())).collect();
        let extremes: Vec<_> = draft.extremes.iter().map(|shelf| shelf.stored_bytes()).collect();
        let (sections, file_bytes) =
            plan(manifest_bytes as u64, grid, element, heights.bytes(element), &lattices, &extremes);
        Ok(Self { draft, manifest, sections, file_bytes })
    }

    /// Writes the file: pages with their directories, then the front matter.
    pub(super) fn write(
        &mut self,
        sink: &mut (impl Sink + Send),
        path: &Path,
        progress: &mut dyn FnMut(u64),
    ) -> Result<Written, WriteError> {
        let io_error = |error| WriteError::Io { path: path.into(), error };
        let mut hash = Xxh3::new();
        hash.update(&self.manifest.terrain.hashed_bytes()?);
        for section in &self.sections {
            if section.kind == Kind::Corners {
                let corners = encode_corners(self.draft.heights.of_corners()?);
                sink.write_at(section.offset, &corners).map_err(io_error)?;
            }
            let Some(paging) = Paging::of_section(section) else { continue };
            let is_hashed = is_hashed(section);
            if is_hashed {
                hash_section(&mut hash, section);
            }
            let mut offset = section.offset + directory::bytes(section.pages).unwrap_or(0);
            let blocks = directory::blocks(section.pages);
            let mut at_hand = self.block(section, paging, 0)?;
            for block in 0..blocks {
                let pages = std::mem::take(&mut at_hand);
                // The pages of the next block are fetched while this one is written.
                let (written, next) = rayon::join(
                    || write_block(sink, section, block, offset, pages),
                    || if block + 1 < blocks { self.block(section, paging, block + 1) } else { Ok(Vec::new()) },
                );
                let entries = written.map_err(io_error)?;
                at_hand = next?;
                for entry in entries {
                    offset += u64::from(entry.length);
                    if is_hashed {
                        hash.update(&entry.checksum.to_le_bytes());
                    }
                }
                progress((self.draft.heights.grid().posts() as f64 * (offset as f64 / self.file_bytes as f64)) as u64);
            }
            debug_assert_eq!(offset, section.offset + section.length);
        }
        self.manifest.version = hash.digest128().to_be_bytes();
        let manifest = envelope::seal(&self.manifest)?;
        sink.write_at(self.sections[0].offset, &manifest).map_err(io_error)?;
        sink.write_at(0, &format::encode_front(&self.sections, self.file_bytes)).map_err(io_error)?;
        Ok(Written { version: self.manifest.version, file_bytes: self.file_bytes })
    }

    /// The pages of block `block` of a section's directory, in the order of the file.
    fn block(&self, section: &Section, paging: Paging, block: u64) -> Result<Vec<Page>, WriteError> {
        let pages = block * BLOCK_ENTRIES..((block + 1) * BLOCK_ENTRIES).min(section.pages);
        pages.into_par_iter().map(|n| self.page(section, paging.id(n))).collect()
    }

    fn page(&self, section: &Section, id: PageId) -> Result<Page, WriteError> {
        let level = (section.level as usize).saturating_sub(1);
        let shelf = match section.kind {
            Kind::Bounds => &self.draft.lattices.shelves[level].1,
            Kind::Extremes => &self.draft.extremes[level],
            _ => {
                let (bytes, flags) = self.draft.heights.encoded(id, section.element)?;
                return Ok(Page { checksum: xxh3_64(&bytes), bytes, flags });
            }
        };
        let entry = shelf.entry(id);
        Ok(Page { bytes: shelf.bytes(id)?, flags: entry.flags, checksum: entry.checksum })
    }
}

/// Writes the pages of a block of a section's directory from `offset` on, and the block; its entries.
fn write_block(
    sink: &mut impl Sink,
    section: &Section,
    block: u64,
    offset: u64,
    pages: Vec<Page>,
) -> io::Result<Vec<Entry>> {
    let (mut entries, mut bytes) = (Vec::with_capacity(pages.len()), Vec::new());
    for Page { bytes: of_page, flags, checksum } in pages {
        entries.push(Entry { offset: offset + bytes.len() as u64, checksum, length: of_page.len() as u32, flags });
        bytes.extend_from_slice(&of_page);
    }
    sink.write_at(offset, &bytes)?;
    let at = section.offset + directory::block_span(section.pages, block).0;
    sink.write_at(at, &directory::encode_block(block, &entries))?;
    Ok(entries)
}

/// The sections of a file and its length, from the bytes of the pages of each: of the heights, of `lattices` from k = 1
/// on, of the extremes by level.
pub(super) fn plan(
    manifest_bytes: u64,
    grid: Grid,
    element: Element,
    height_bytes: u64,
    lattices: &[(LatticeSize, u64)],
    extremes: &[u64],
) -> (Vec<Section>, u64) {
    let (flags, offset) = (REQUIRED, 0);
    let (columns, rows) = (grid.nx(), grid.ny());
    let manifest = Section {
        kind: Kind::Manifest,
        flags,
        element: Element::Byte,
        level: 0,
        columns: 0,
        rows: 0,
        pages: 0,
        offset,
        length: manifest_bytes,
    };
    let heights = Section { kind: Kind::Heights, element, columns, rows, length: height_bytes, ..manifest };
    let mut sections = vec![manifest, heights];
    for &(LatticeSize { k, columns, rows }, length) in lattices {
        let element = if element == Element::I16 { Element::BoundsI16 } else { Element::BoundsI32 };
        let (kind, level) = (Kind::Bounds, k.into());
        sections.push(Section { kind, element, level, columns, rows, length, ..manifest });
    }
    sections.push(Section { kind: Kind::Corners, flags: 0, length: CORNERS_BYTES as u64, ..manifest });
    for (level, &length) in (1..).zip(extremes) {
        let (columns, rows) = extremes::extent(grid, level);
        let element = if element == Element::I16 { Element::PairI16 } else { Element::PairI32 };
        sections.push(Section { kind: Kind::Extremes, flags: 0, element, level, columns, rows, length, ..manifest });
    }
    let mut end = format::front_bytes(sections.len());
    for section in &mut sections {
        section.pages = Paging::of_section(section).map_or(0, |paging| paging.pages());
        section.length += directory::bytes(section.pages).unwrap_or(0);
        section.offset = end;
        end += section.length;
    }
    (sections, end)
}

/// Whether the terrain version depends on a section's pages: not on what follows from the heights and is optional.
pub(super) fn is_hashed(section: &Section) -> bool {
    matches!(section.kind, Kind::Heights | Kind::Bounds)
}

/// Adds a section to the hash that is the terrain version; the checksums of its pages follow.
pub(super) fn hash_section(hash: &mut Xxh3, section: &Section) {
    let words = [section.kind.number(), section.level, section.element.number(), section.columns, section.rows];
    for word in words {
        hash.update(&word.to_le_bytes());
    }
}
