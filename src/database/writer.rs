//! Writes a database beside its place and renames it into place: a crash leaves what was there before, or nothing.
//!
//! The sizes of all sections but the heights' follow from the grid, and the heights' from a first pass over the pages
//! that finds the range and the voids. So pages are written once, in the order of the file, and the front matter last.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use xxhash_rust::xxh3::{Xxh3, xxh3_64};

use super::{
    directory::{self, Entry},
    envelope,
    error::WriteError,
    format::{self, Element, Kind, REQUIRED, Section},
    layout::{Paging, QUAD_DIAMONDS, QUAD_SIDE, quad_post, stored_levels},
    manifest::{MANIFEST_LIMIT, Manifest, Provenance, TerrainManifest},
    pages,
};
use crate::{
    terrain::{
        Georeference, Grid, HeightField, HeightPage, PAGE_SIDE, PageId, SceneScale,
        extremes::{self, Extremes, Values},
    },
    wedgie::{BoundsPyramid, DiamondBounds, Lattice},
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
/// `progress` is told the number of posts written so far. An existing file is replaced only if `replace` says so, and
/// only once the new one is complete and on the disk.
pub fn write(
    path: &Path,
    replace: bool,
    field: &impl HeightField,
    bounds: &BoundsPyramid,
    description: &Description,
    progress: &mut dyn FnMut(u64),
) -> Result<Written, WriteError> {
    publish(path, replace, |file| Content::survey(field, bounds, description)?.write(file, path, progress))
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
pub(super) struct Content<'a, H> {
    field: &'a H,
    bounds: &'a BoundsPyramid,
    manifest: Manifest,
    /// Extremes of blocks by level from 1.
    levels: Vec<Values>,
    sections: Vec<Section>,
    file_bytes: u64,
}

/// What the first pass finds.
struct Survey {
    /// Range of known heights, and of drawn ones.
    known: Option<(i32, i32)>,
    drawn: (i32, i32),
    void_posts: u64,
    /// Bytes of all bitmaps of voids.
    bitmap_bytes: u64,
}

impl Survey {
    fn element(&self) -> Element {
        let small = i16::try_from(self.drawn.0).is_ok() && i16::try_from(self.drawn.1).is_ok();
        if small { Element::I16 } else { Element::I32 }
    }
}

impl<'a, H: HeightField> Content<'a, H> {
    /// Reads `field` once and plans the file.
    pub(super) fn survey(
        field: &'a H,
        bounds: &'a BoundsPyramid,
        description: &Description,
    ) -> Result<Self, WriteError> {
        let grid = field.grid();
        let survey = survey(field)?;
        let (lowest, highest) = survey.known.ok_or(WriteError::AllVoid { posts: grid.posts() })?;
        let terrain = TerrainManifest {
            nx: grid.nx(),
            ny: grid.ny(),
            scale: description.scale,
            georeference: description.georeference,
            lowest,
            highest,
            void_posts: survey.void_posts,
        };
        terrain.check().map_err(WriteError::Description)?;
        let manifest = Manifest { terrain, provenance: description.provenance.clone(), version: [0; 16] };
        let levels = bounds.lattices().iter().map(Lattice::k);
        if !levels.eq(stored_levels(grid.root().exponent())) {
            return Err(WriteError::Description("the bounds are not those of this grid".into()));
        }
        let lattices: Vec<_> = bounds.lattices().iter().map(|lattice| (lattice.columns(), lattice.rows())).collect();
        let manifest_bytes = envelope::seal(&manifest)?.len();
        if manifest_bytes > MANIFEST_LIMIT {
            let words =
                format!("the manifest has {manifest_bytes} bytes, more than {MANIFEST_LIMIT}: name fewer sources");
            return Err(WriteError::Description(words));
        }
        let levels = extremes::extremes_of(grid, |id| field.page(id))?;
        let bitmaps: Vec<_> = (1..).zip(&levels).map(|(level, values)| bitmap_bytes(grid, level, values)).collect();
        let (sections, file_bytes) =
            plan(manifest_bytes as u64, grid, survey.element(), survey.bitmap_bytes, &lattices, &bitmaps);
        Ok(Self { field, bounds, manifest, levels, sections, file_bytes })
    }

    /// Writes the file: pages, then directories, then the front matter.
    pub(super) fn write(
        &mut self,
        sink: &mut impl Sink,
        path: &Path,
        progress: &mut dyn FnMut(u64),
    ) -> Result<Written, WriteError> {
        let io_error = |error| WriteError::Io { path: path.into(), error };
        let mut hash = Xxh3::new();
        hash.update(&self.manifest.terrain.hashed_bytes()?);
        let mut posts = 0;
        for section in &self.sections {
            let Some(paging) = Paging::of_section(section) else { continue };
            let entries = self.write_pages(section, &paging, sink, path, &mut |cells| {
                posts += if section.kind == Kind::Heights { cells } else { 0 };
                progress(posts);
            })?;
            sink.write_at(section.offset, &directory::encode(&entries)).map_err(io_error)?;
            if is_hashed(section) {
                hash_section(&mut hash, section, entries.iter().map(|e| e.checksum));
            }
        }
        self.manifest.version = hash.digest128().to_be_bytes();
        let manifest = envelope::seal(&self.manifest)?;
        sink.write_at(self.sections[0].offset, &manifest).map_err(io_error)?;
        sink.write_at(0, &format::encode_front(&self.sections, self.file_bytes)).map_err(io_error)?;
        Ok(Written { version: self.manifest.version, file_bytes: self.file_bytes })
    }

    fn write_pages(
        &self,
        section: &Section,
        paging: &Paging,
        sink: &mut impl Sink,
        path: &Path,
        progress: &mut dyn FnMut(u64),
    ) -> Result<Vec<Entry>, WriteError> {
        let mut offset = section.offset + directory::bytes(section.pages).unwrap_or(0);
        let mut entries = Vec::new();
        for n in 0..section.pages {
            let (bytes, flags) = self.encode(section, paging, paging.id(n))?;
            sink.write_at(offset, &bytes).map_err(|error| WriteError::Io { path: path.into(), error })?;
            entries.push(Entry { offset, checksum: xxh3_64(&bytes), length: bytes.len() as u32, flags });
            offset += bytes.len() as u64;
            let (w, h) = paging.size(paging.id(n));
            progress(u64::from(w * h));
        }
        debug_assert_eq!(offset, section.offset + section.length);
        Ok(entries)
    }

    fn encode(&self, section: &Section, paging: &Paging, id: PageId) -> Result<(Vec<u8>, u32), WriteError> {
        let size = paging.size(id);
        let changed = || WriteError::Description("the terrain changed while it was written".into());
        if section.kind == Kind::Heights {
            let page = self.field.page(id)?;
            return pages::encode_heights(&page, section.element, size).ok_or_else(changed);
        }
        if section.kind == Kind::Extremes {
            let values = &self.levels[section.level as usize - 1];
            let of_page: Vec<_> = extremes::of_page(values, section.columns, id).copied().collect();
            return pages::encode_extremes(&of_page, section.element).ok_or_else(changed);
        }
        let mut out = Vec::new();
        let lattice = &self.bounds.lattices()[section.level as usize - 1];
        for (v, u) in (0..size.1).flat_map(|v| (0..size.0).map(move |u| (v, u))) {
            for n in 0..QUAD_DIAMONDS {
                let (a, b) = quad_post(id.pi * QUAD_SIDE + u, id.pj * QUAD_SIDE + v, n);
                let inside = a < section.columns && b < section.rows;
                let bounds = if inside {
                    lattice.bounds()[(b as usize) * section.columns as usize + a as usize]
                } else {
                    DiamondBounds::default()
                };
                pages::check_bounds(&bounds).map_err(WriteError::Description)?;
                pages::encode_bounds(&mut out, bounds);
            }
        }
        Ok((out, 0))
    }
}

/// Bytes of all bitmaps of voids of a level of extremes.
fn bitmap_bytes(grid: Grid, level: u32, values: &[Extremes]) -> u64 {
    let (columns, rows) = extremes::extent(grid, level);
    let paging = Paging::of_heights(columns, rows);
    let with_voids = |&n: &u64| extremes::of_page(values, columns, paging.id(n)).any(|value| value.void);
    let bytes = |n: u64| {
        let (w, h) = paging.size(paging.id(n));
        u64::from(w * h).div_ceil(8)
    };
    (0..paging.pages()).filter(with_voids).map(bytes).sum()
}

/// The sections of a file and its length, from what their sizes depend on: of `lattices` those from k = 1 on; of the
/// extremes by level the bytes of bitmaps.
pub(super) fn plan(
    manifest_bytes: u64,
    grid: Grid,
    element: Element,
    bitmap_bytes: u64,
    lattices: &[(u32, u32)],
    extremes: &[u64],
) -> (Vec<Section>, u64) {
    let (flags, offset) = (REQUIRED, 0);
    let (columns, rows) = (grid.nx(), grid.ny());
    let width = if element == Element::I16 { 2 } else { 4 };
    let length = width * grid.posts() + bitmap_bytes;
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
    let heights = Section { kind: Kind::Heights, element, columns, rows, length, ..manifest };
    let mut sections = vec![manifest, heights];
    for (level, &(columns, rows)) in (1..).zip(lattices) {
        let quads = u64::from(columns.div_ceil(2)) * u64::from(rows.div_ceil(2));
        let length = quads * (QUAD_DIAMONDS * pages::SHORT_BYTES) as u64;
        let (kind, element) = (Kind::Bounds, Element::ShortBounds);
        sections.push(Section { kind, element, level, columns, rows, length, ..manifest });
    }
    for (level, &bitmaps) in (1..).zip(extremes) {
        let (columns, rows) = extremes::extent(grid, level);
        let length = 2 * width * u64::from(columns) * u64::from(rows) + bitmaps;
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

/// Adds a section and the checksums of its pages to the hash that is the terrain version.
pub(super) fn hash_section(hash: &mut Xxh3, section: &Section, checksums: impl Iterator<Item = u64>) {
    let words = [section.kind.number(), section.level, section.element.number(), section.columns, section.rows];
    for word in words {
        hash.update(&word.to_le_bytes());
    }
    for checksum in checksums {
        hash.update(&checksum.to_le_bytes());
    }
}

fn survey(field: &impl HeightField) -> Result<Survey, WriteError> {
    let grid = field.grid();
    let paging = Paging::of_heights(grid.nx(), grid.ny());
    let mut all = Survey { known: None, drawn: (i32::MAX, i32::MIN), void_posts: 0, bitmap_bytes: 0 };
    for n in 0..paging.pages() {
        let id = paging.id(n);
        let (w, h) = paging.size(id);
        let page = field.page(id)?;
        let voids = survey_page(&page, id, (w, h), &mut all)?;
        all.void_posts += voids;
        all.bitmap_bytes += if voids > 0 { u64::from(w * h).div_ceil(8) } else { 0 };
    }
    Ok(all)
}

/// Widens the ranges of `all` by a page; the number of its voids.
fn survey_page(page: &HeightPage, id: PageId, (w, h): (u32, u32), all: &mut Survey) -> Result<u64, WriteError> {
    let mut voids = 0;
    for (j, i) in (0..h).flat_map(|j| (0..w).map(move |i| (j, i))) {
        let post = page.at(i, j);
        let z = pages::exact_i32(post.z).ok_or_else(|| WriteError::Height {
            i: id.pi * PAGE_SIDE + i,
            j: id.pj * PAGE_SIDE + j,
            z: post.z,
        })?;
        all.drawn = (all.drawn.0.min(z), all.drawn.1.max(z));
        if post.void {
            voids += 1;
        } else {
            let (lowest, highest) = all.known.unwrap_or((z, z));
            all.known = Some((lowest.min(z), highest.max(z)));
        }
    }
    Ok(voids)
}
