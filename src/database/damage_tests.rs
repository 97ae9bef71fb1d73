//! Damage: flipped bytes, cut files, files that shrink, writers that crash, fronts that lie.

use std::{
    io,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use sightline_proto::diamond::Post;

use super::{
    Database, OpenError, OpenOptions, WriteError,
    budget::Budget,
    crown::encode_corners,
    directory::{self, BLOCK_ENTRIES, Entry},
    draft::Draft,
    envelope,
    format::{self, Element, Kind},
    layout::Paging,
    manifest::{Manifest, TerrainManifest},
    scratch::Scratch,
    source::PageSource,
    tests::{SCALE, description, terrain},
    verify::verify_source,
    writer::{Content, Sink, heights_of, plan, publish},
};
use crate::{
    terrain::{Grid, HeightField, MemoryField, PageId, Posts, ReadError, extremes},
    wedgie::{Effort, ErrorBounds, LatticeSize},
};

/// Bytes in memory that can shrink, and that count what is read of them.
#[derive(Clone, Default)]
pub(super) struct Bytes {
    bytes: Arc<Vec<u8>>,
    cut: Arc<AtomicU64>,
    read: Arc<AtomicU64>,
}

impl Bytes {
    pub(super) fn boxed(bytes: &[u8]) -> Box<dyn PageSource> {
        Box::new(Self { bytes: Arc::new(bytes.to_vec()), ..Self::default() })
    }
}

impl PageSource for Bytes {
    fn length(&self) -> io::Result<u64> {
        Ok(self.bytes.len() as u64 - self.cut.load(Ordering::Relaxed))
    }

    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()> {
        self.read.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let end = offset + bytes.len() as u64;
        if end > self.length()? {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        bytes.copy_from_slice(&self.bytes[offset as usize..end as usize]);
        Ok(())
    }
}

/// A sink in memory that fails after a number of writes.
struct Memory {
    bytes: Vec<u8>,
    writes_left: usize,
}

impl Sink for Memory {
    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        self.writes_left = self.writes_left.checked_sub(1).ok_or(io::ErrorKind::StorageFull)?;
        let end = offset as usize + bytes.len();
        self.bytes.resize(self.bytes.len().max(end), 0);
        self.bytes[offset as usize..end].copy_from_slice(bytes);
        Ok(())
    }
}

/// The bytes that `writes` writes of a database of `field` leave, and whether it was complete.
pub(super) fn written(field: &MemoryField, writes: usize) -> (Vec<u8>, bool) {
    let folder = tempfile::tempdir().unwrap();
    let scratch = Scratch::beside(&folder.path().join("it"), 0).unwrap();
    let budget = Budget { cache_bytes: 0, effort: Effort { rows: Effort::ROWS_STEP, bands: 1 } };
    let draft = Draft::complete(&scratch, heights_of(field, &scratch).unwrap(), SCALE, budget, &|_| ()).unwrap();
    let mut sink = Memory { bytes: Vec::new(), writes_left: writes };
    let mut content = Content::plan(&draft, &description()).unwrap();
    let done = content.write(&mut sink, Path::new("memory"), &mut |_| ()).is_ok();
    (sink.bytes, done)
}

pub(super) const NO_CACHE: OpenOptions = OpenOptions { cache_bytes: 0 };

fn pages(grid: Grid) -> impl Iterator<Item = PageId> {
    let (columns, rows) = grid.pages();
    (0..rows).flat_map(move |pj| (0..columns).map(move |pi| PageId { pi, pj }))
}

/// Every height page of `database` is that of `field`, or an error; the number of errors.
fn unreadable_pages(database: &Database, field: &MemoryField) -> usize {
    let mut unreadable = 0;
    for id in pages(field.grid()) {
        match database.page(id) {
            Ok(page) => {
                let expected = field.page(id).unwrap();
                let all = (0..64).flat_map(|j| (0..64).map(move |i| (i, j)));
                assert!(all.into_iter().all(|(i, j)| page.at(i, j) == expected.at(i, j)), "wrong heights in {id:?}");
            }
            Err(ReadError::Damaged { .. }) => unreadable += 1,
            Err(error) => panic!("{error}"),
        }
    }
    unreadable
}

#[test]
fn every_flipped_byte_is_found_and_none_gives_a_wrong_height() {
    let field = terrain(68, 21, 3, 1, true);
    let (bytes, done) = written(&field, usize::MAX);
    assert!(done);
    let sound = verify_source(Bytes::boxed(&bytes), &|_, _| ()).unwrap();
    assert!(sound.damage.is_empty() && sound.good_pages == sound.pages, "{sound:?}");
    for at in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[at] ^= 1 << (at % 8);
        let Ok(verification) = verify_source(Bytes::boxed(&bad), &|_, _| ()) else {
            assert!(Database::open_whole(Bytes::boxed(&bad), NO_CACHE).is_err(), "byte {at}");
            continue;
        };
        assert!(!verification.damage.is_empty(), "verify does not see byte {at}");
        let database = Database::open_whole(Bytes::boxed(&bad), NO_CACHE).unwrap();
        unreadable_pages(&database, &field);
    }
}

#[test]
fn damage_to_one_page_fails_the_queries_that_meet_it_and_no_others() {
    let field = terrain(200, 200, 8, 1, false);
    let (mut bytes, _) = written(&field, usize::MAX);
    let database = Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).unwrap();
    let paging = Paging::of_heights(200, 200);
    let (_, entry) = database.page_bytes(database.heights, &paging, 5).unwrap();
    bytes[entry.offset as usize + 17] ^= 1;
    let database = Database::open_whole(Bytes::boxed(&bytes), OpenOptions::default()).unwrap();
    assert_eq!(unreadable_pages(&database, &field), 1);
    let id = paging.id(5);
    let error = database.page(id).unwrap_err().to_string();
    assert!(error.contains(&format!("page ({}, {}) of heights", id.pi, id.pj)), "{error}");
    let found = verify_source(Bytes::boxed(&bytes), &|_, _| ()).unwrap();
    assert_eq!((found.damage.len(), found.pages - found.good_pages), (1, 1), "{found:?}");
    assert!(error.contains(found.damage[0].split(':').next().unwrap()), "{error} {found:?}");
}

#[test]
fn a_file_cut_at_any_length_is_refused_and_verify_names_what_is_gone() {
    let field = terrain(68, 21, 4, 1, true);
    let (bytes, _) = written(&field, usize::MAX);
    for length in 0..bytes.len() {
        let cut = || Bytes::boxed(&bytes[..length]);
        let error = Database::open_whole(cut(), NO_CACHE).unwrap_err();
        assert!(error.is_damage() || length == 0, "{length}: {error}");
        if let Ok(found) = verify_source(cut(), &|_, _| ()) {
            assert!(found.damage.len() >= 2 && found.good_pages < found.pages, "{length}: {found:?}");
        }
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(matches!(Database::open_whole(Bytes::boxed(&longer), NO_CACHE), Err(OpenError::Length { .. })));
}

#[test]
fn a_file_that_shrinks_while_open_is_an_error_for_what_is_gone() {
    let field = terrain(200, 130, 4, 1, false);
    let (bytes, _) = written(&field, usize::MAX);
    let source = Bytes { bytes: Arc::new(bytes), ..Bytes::default() };
    let database = Database::open_whole(Box::new(source.clone()), NO_CACHE).unwrap();
    let heights = database.sections[database.heights];
    let half = heights.offset + directory::bytes(heights.pages).unwrap() + 5 * 8192;
    source.cut.store(source.bytes.len() as u64 - half, Ordering::Relaxed);
    let unreadable = unreadable_pages(&database, &field);
    assert!((1..12).contains(&unreadable), "{unreadable}");
    assert!(matches!(database.bounds(Post::new(64, 64)), Err(ReadError::Damaged { .. })));
}

#[test]
fn a_real_file_cut_while_open_is_an_error_and_not_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.sldb");
    let field = terrain(130, 66, 4, 1, false);
    super::tests::write_to(&path, &field);
    let database = Database::open(&path, OpenOptions::default()).unwrap();
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(2000).unwrap();
    assert_eq!(unreadable_pages(&database, &field), 6);
    assert!(matches!(Database::open(&path, OpenOptions::default()), Err(OpenError::Length { .. })));
}

#[test]
fn a_crash_after_any_write_leaves_no_database() {
    let field = terrain(130, 40, 6, 1, true);
    let mut writes = 0;
    loop {
        let (bytes, done) = written(&field, writes);
        if done {
            break;
        }
        assert!(Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).is_err(), "after {writes} writes");
        writes += 1;
    }
    assert!(writes > 10);
}

#[test]
fn a_failed_or_panicking_ingest_leaves_the_old_database_or_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.sldb");
    let fail = |_: &mut std::fs::File| -> Result<(), WriteError> { Err(WriteError::AllVoid { posts: 1 }) };
    assert!(publish(&path, false, fail).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let old = super::tests::write_to(&path, &terrain(9, 9, 1, 1, false));
    let half = |file: &mut std::fs::File| -> Result<(), WriteError> {
        file.write_at(0, b"half").unwrap();
        panic!("killed")
    };
    let unwound = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| publish(&path, true, half)));
    assert!(unwound.is_err());
    assert_eq!(Database::open(&path, OpenOptions::default()).unwrap().version(), old.version);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// A front that states a terrain of 69,000 x 69,000 posts, 20 GB, and the pages that are needed at one place, over nothing
/// but a hole.
struct Huge {
    front: Vec<u8>,
    /// What is there besides, by its offset in the file.
    pieces: Vec<(u64, Vec<u8>)>,
    file_bytes: u64,
}

/// The page of heights that the huge file has.
const THERE: PageId = PageId { pi: 1000, pj: 500 };

fn huge() -> Huge {
    let grid = Grid::new(69_000, 69_000).unwrap();
    let (nx, ny) = (grid.nx(), grid.ny());
    let terrain = TerrainManifest { nx, ny, scale: SCALE, georeference: None, lowest: 0, highest: 9, void_posts: 0 };
    let manifest = Manifest { terrain, provenance: super::Provenance::default(), version: [7; 16] };
    let manifest = envelope::seal(&manifest).unwrap();
    let lattices: Vec<_> = (1..grid.root().exponent())
        .map(|k| LatticeSize::of(grid, k))
        .map(|size| (size, 33 * u64::from(size.columns.div_ceil(2)) * u64::from(size.rows.div_ceil(2))))
        .collect();
    let extremes: Vec<_> = (1..extremes::levels(grid) + 1)
        .map(|level| extremes::extent(grid, level))
        .map(|(columns, rows)| 4 * u64::from(columns) * u64::from(rows))
        .collect();
    let (sections, file_bytes) =
        plan(manifest.len() as u64, grid, Element::I16, 2 * grid.posts(), &lattices, &extremes);
    let per_post = file_bytes as f64 / grid.posts() as f64;
    assert!((4.7..4.8).contains(&per_post) && file_bytes > 20_000_000_000, "{per_post} bytes a post");
    let heights = sections.iter().find(|s| s.kind == Kind::Heights).unwrap();
    let (n, page) = (Paging::of_heights(nx, ny).number(THERE), 7_i16.to_le_bytes().repeat(4096));
    let (block, place) = (n / BLOCK_ENTRIES, (n % BLOCK_ENTRIES) as usize);
    let offset = heights.offset + directory::bytes(heights.pages).unwrap() + 8192 * n;
    let mut entries = vec![Entry::default(); BLOCK_ENTRIES as usize];
    entries[place] = Entry { offset, checksum: xxhash_rust::xxh3::xxh3_64(&page), length: 8192, flags: 0 };
    let directory = directory::encode_block(block, &entries);
    let pieces = vec![(heights.offset + directory::block_span(heights.pages, block).0, directory), (offset, page)];
    Huge { front: [format::encode_front(&sections, file_bytes), manifest].concat(), pieces, file_bytes }
}

/// Set for a process of its own that looks at how much it reads and holds.
const ALONE: &str = "SIGHTLINE_OPEN_HUGE";

/// A number that the system states of this process, in a line that starts with `name`.
fn stated(file: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/self/{file}")).ok()?;
    text.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
}

#[test]
fn a_huge_sparse_file_opens_with_little_read_and_held_and_its_holes_are_damage() {
    if let Some(path) = std::env::var_os(ALONE) {
        let before = stated("io", "rchar:");
        let database = Database::open(Path::new(&path), OpenOptions::default()).unwrap();
        assert_eq!(database.page(THERE).unwrap().at(5, 5).z, 7.0);
        let error = database.page(PageId { pi: 100, pj: 500 }).unwrap_err();
        assert!(matches!(error, ReadError::Damaged { .. }), "{error}");
        let read = stated("io", "rchar:").zip(before).map(|(after, before)| after - before);
        assert!(read.is_none_or(|bytes| bytes < 1 << 20), "{read:?} bytes read");
        let held = stated("status", "VmHWM:");
        assert!(held.is_none_or(|kib| kib < 64 << 10), "{held:?} KiB held");
        return;
    }
    let Huge { front, pieces, file_bytes } = huge();
    let source = Bytes { bytes: Arc::new(front.clone()), ..Bytes::default() };
    let database = Database::open_source(Box::new(source.clone()), NO_CACHE).unwrap();
    assert!(matches!(database.page(PageId { pi: 0, pj: 0 }), Err(ReadError::Damaged { .. })));
    assert!(source.read.load(Ordering::Relaxed) < 16_384);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.sldb");
    std::fs::write(&path, &front).unwrap();
    let mut file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    if file.set_len(file_bytes).is_err() {
        // A file system without sparse files has no room for it.
        return;
    }
    pieces.iter().for_each(|(offset, bytes)| file.write_at(*offset, bytes).unwrap());
    let name = "database::damage_tests::a_huge_sparse_file_opens_with_little_read_and_held_and_its_holes_are_damage";
    let alone = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", name])
        .env(ALONE, &path)
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&alone.stdout);
    assert!(alone.status.success() && words.contains("1 passed"), "{words}");
}

/// Directory entries with valid checksums that point elsewhere, or state other lengths, are refused before a read.
#[test]
fn lying_directories_are_refused_without_reading_or_allocating() {
    let field = terrain(130, 70, 9, 1, true);
    let (bytes, _) = written(&field, usize::MAX);
    let database = Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).unwrap();
    let heights = database.sections[database.heights];
    assert!(heights.pages < BLOCK_ENTRIES);
    let sound = database.directory_block(database.heights, 0).unwrap();
    for (n, value) in (0..6).flat_map(|n| [0, 1, u64::from(u32::MAX), u64::MAX, u64::MAX - 9].map(|v| (n, v))) {
        let mut entries = sound.to_vec();
        match n % 3 {
            0 => entries[0].offset = value,
            1 => entries[0].length = value as u32,
            _ => entries[0].flags = 2 + value as u32 / 2, // of a page that is not constant
        }
        let mut bad = bytes.clone();
        let directory = directory::encode_block(0, &entries);
        bad[heights.offset as usize..][..directory.len()].copy_from_slice(&directory);
        let database = Database::open_whole(Bytes::boxed(&bad), NO_CACHE).unwrap();
        assert_eq!(unreadable_pages(&database, &field), 1, "field {n}, value {value}");
    }
}

/// Fronts with valid checksums whose tables do not fit the grid.
#[test]
fn lying_tables_are_refused() {
    let field = terrain(130, 70, 9, 1, false);
    let (bytes, _) = written(&field, usize::MAX);
    let sections = Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).unwrap().sections;
    for (n, field_number) in (0..sections.len()).flat_map(|n| (0..8).map(move |f| (n, f))) {
        let mut list = sections.clone();
        let s = &mut list[n];
        match field_number {
            0 => s.columns += 1,
            1 => s.rows = u32::MAX,
            2 => s.pages += 1,
            3 => s.pages = u64::MAX,
            4 => s.level += 1,
            5 => s.element = Element::Other(9),
            6 => s.offset += 1,
            _ => s.length = u64::MAX,
        }
        let front = format::encode_front(&list, bytes.len() as u64);
        let mut bad = bytes.clone();
        bad[..front.len()].copy_from_slice(&front);
        // A lattice of odd size has room for one column more: opening cannot tell, the terrain version does.
        let refused = match verify_source(Bytes::boxed(&bad), &|_, _| ()) {
            Ok(found) => !found.damage.is_empty() && field_number == 0,
            Err(_) => true,
        };
        assert!(refused, "section {n}, field {field_number}");
        let mut list = sections.clone();
        list.remove(n);
        let front = format::encode_front(&list, bytes.len() as u64);
        let mut bad = bytes.clone();
        bad[..front.len()].copy_from_slice(&front);
        assert!(Database::open_whole(Bytes::boxed(&bad), NO_CACHE).is_err(), "section {n} left out");
    }
}

/// The block around each post: what a database keeps of it.
fn blocks(field: &impl HeightField) -> Vec<Result<Option<(f32, f32)>, ReadError>> {
    let mut posts = Posts::new(field);
    let (nx, ny) = (field.grid().nx(), field.grid().ny());
    (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j))).map(|(i, j)| posts.block_around(i, j)).collect()
}

#[test]
fn extremes_are_those_of_the_heights_and_a_file_without_them_is_read_too() {
    for (nx, ny, factor, voids) in
        [(200, 131, 1, true), (70, 1100, 1, false), (130, 66, -70_000, true), (64, 64, 1, true)]
    {
        let field = terrain(nx, ny, 11, factor, voids);
        let (bytes, _) = written(&field, usize::MAX);
        let database = Database::open_whole(Bytes::boxed(&bytes), OpenOptions::default()).unwrap();
        assert_eq!(blocks(&database), blocks(&field));
        let rows = 3..ny - 2;
        let stretch = |field: &dyn HeightField| Posts::new(field).greatest(1..=nx - 2, rows.start..=rows.end).unwrap();
        assert_eq!(stretch(&database), stretch(&field));
        // A kind that this program does not know, in their place.
        let mut sections = database.sections.clone();
        sections.iter_mut().filter(|s| s.kind == Kind::Extremes).for_each(|s| s.kind = Kind::Other(99));
        let front = format::encode_front(&sections, bytes.len() as u64);
        let mut without = bytes.clone();
        without[..front.len()].copy_from_slice(&front);
        let old = Database::open_whole(Bytes::boxed(&without), OpenOptions::default()).unwrap();
        assert!(blocks(&old).iter().all(|block| *block == Ok(None)));
        assert_eq!((unreadable_pages(&old, &field), old.version()), (0, database.version()));
        assert!(verify_source(Bytes::boxed(&without), &|_, _| ()).unwrap().damage.is_empty());
    }
}

/// The file with other bytes in the first page of a section, and checksums that fit them.
fn forged(bytes: &[u8], database: &Database, section: usize, change: impl FnOnce(&mut [u8])) -> Vec<u8> {
    let s = database.sections[section];
    let (mut page, entry) = database.page_bytes(section, &Paging::of_section(&s).unwrap(), 0).unwrap();
    change(&mut page);
    let mut entries = database.directory_block(section, 0).unwrap().to_vec();
    entries[0].checksum = xxhash_rust::xxh3::xxh3_64(&page);
    let directory = directory::encode_block(0, &entries);
    let mut forged = bytes.to_vec();
    forged[entry.offset as usize..][..page.len()].copy_from_slice(&page);
    forged[s.offset as usize..][..directory.len()].copy_from_slice(&directory);
    forged
}

/// A page whose bytes changed is an error for who needs it; one whose values are not those of the heights, checksum and
/// all, is found by verification.
#[test]
fn damaged_and_wrong_extremes_are_found() {
    let field = terrain(150, 1040, 3, 1, true);
    let (bytes, _) = written(&field, usize::MAX);
    let database = Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).unwrap();
    for (level, &section) in database.extremes.iter().enumerate() {
        let paging = Paging::of_section(&database.sections[section]).unwrap();
        let (_, entry) = database.page_bytes(section, &paging, 0).unwrap();
        let mut bad = bytes.clone();
        bad[entry.offset as usize] ^= 1;
        let damaged = Database::open_whole(Bytes::boxed(&bad), NO_CACHE).unwrap();
        let error = damaged.extremes(level as u32 + 1, PageId { pi: 0, pj: 0 }).unwrap_err().to_string();
        assert!(error.contains(&format!("page (0, 0) of extremes of level {}", level + 1)), "{error}");
        assert_eq!(blocks(&damaged).iter().any(Result::is_err), level == 0);
        // The same change under a checksum that fits it: the least height is one less.
        let bad = forged(&bytes, &database, section, |page| {
            let least = i16::from_le_bytes([page[0], page[1]]) - 1;
            page[..2].copy_from_slice(&least.to_le_bytes());
        });
        let found = verify_source(Bytes::boxed(&bad), &|_, _| ()).unwrap();
        assert!(found.damage.iter().any(|d| d.contains("not those of the heights")), "{found:?}");
    }
    assert_eq!(database.extremes.len(), 2);
}

/// A height beside bounds that is not that of its post, checksum and all, is found by verification; one whose bytes changed
/// is an error for who needs it.
#[test]
fn damaged_and_wrong_heights_beside_bounds_are_found() {
    let field = terrain(150, 270, 3, 1, true);
    let (bytes, _) = written(&field, usize::MAX);
    let database = Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).unwrap();
    for (k, &section) in (1..).zip(&database.lattices) {
        let paging = Paging::of_section(&database.sections[section]).unwrap();
        let (_, entry) = database.page_bytes(section, &paging, 0).unwrap();
        // The first post of the first quad lies one step east; its height is behind nine bytes of bounds.
        let (east, coarser) = (Post::new(1 << k, 0), Post::new(2 << k, 0));
        let mut bad = bytes.clone();
        bad[entry.offset as usize + 9] ^= 1;
        let damaged = Database::open_whole(Bytes::boxed(&bad), NO_CACHE).unwrap();
        let error = damaged.bounds_and_height(east).unwrap_err().to_string();
        assert!(error.contains(&format!("page (0, 0) of bounds of step {}", 1 << k)), "{error}");
        assert!(field.grid().root().is_corner(coarser) || damaged.bounds_and_height(coarser).is_ok());
        let bad = forged(&bytes, &database, section, |page| page[9] ^= 1);
        let found = verify_source(Bytes::boxed(&bad), &|_, _| ()).unwrap();
        assert!(found.damage.iter().any(|d| d.contains("not those of the posts")), "{found:?}");
    }
    assert_eq!(database.lattices.len(), 8);
}

/// The file with other heights of the corners, and a checksum that fits them if it is to.
fn with_corners(bytes: &[u8], database: &Database, heights: [i32; 4], fits: bool) -> Vec<u8> {
    let (mut out, section) = (bytes.to_vec(), database.sections[database.corners.unwrap()]);
    let mut corners = encode_corners(heights);
    corners[16] ^= u8::from(!fits);
    out[section.offset as usize..][..section.length as usize].copy_from_slice(&corners);
    out
}

#[test]
fn damaged_and_wrong_heights_of_corners_are_found_and_a_file_without_them_is_read_too() {
    // One grid reaches the corners of its root square, one is 70 posts short of them.
    for (nx, ny) in [(129, 129), (130, 186)] {
        let field = terrain(nx, ny, 3, 1, true);
        let (bytes, _) = written(&field, usize::MAX);
        let open = |bytes: &[u8]| Database::open_whole(Bytes::boxed(bytes), NO_CACHE).unwrap();
        let (database, mut posts) = (open(&bytes), Posts::new(&field));
        let expected = field.grid().root().corners().map(|p| posts.at(field.grid().clamp(p)).unwrap().z);
        assert_eq!(database.corner_heights(), Ok(Some(expected)));
        let heights = expected.map(|z| z as i32);
        let damaged = open(&with_corners(&bytes, &database, heights, false));
        assert!(damaged.corner_heights().unwrap_err().to_string().contains("corners"));
        assert_eq!(unreadable_pages(&damaged, &field), 0);
        for n in 0..4 {
            let mut wrong = heights;
            wrong[n] += 1;
            let bad = with_corners(&bytes, &database, wrong, true);
            let found = verify_source(Bytes::boxed(&bad), &|_, _| ()).unwrap();
            assert!(found.damage.iter().any(|d| d.contains("corners: its heights")), "{found:?}");
        }
        let mut sections = database.sections.clone();
        sections[database.corners.unwrap()].kind = Kind::Other(99);
        let front = format::encode_front(&sections, bytes.len() as u64);
        let mut without = bytes.clone();
        without[..front.len()].copy_from_slice(&front);
        assert_eq!((open(&without).corner_heights(), open(&without).version()), (Ok(None), database.version()));
        assert!(verify_source(Bytes::boxed(&without), &|_, _| ()).unwrap().damage.is_empty());
    }
}

/// What a format version does not have, no file of it has.
#[test]
fn a_file_of_an_older_version_has_no_heights_beside_bounds() {
    let (bytes, _) = written(&terrain(70, 40, 3, 1, false), usize::MAX);
    for version in 1..4_u32 {
        let mut other = bytes.clone();
        other[8..12].copy_from_slice(&version.to_le_bytes());
        let checksum = xxhash_rust::xxh3::xxh3_64(&other[..32]);
        other[32..40].copy_from_slice(&checksum.to_le_bytes());
        assert_eq!(Database::open_whole(Bytes::boxed(&other), NO_CACHE).is_ok(), version == 3);
    }
}
