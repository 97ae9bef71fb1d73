//! Properties of whole databases: what was written is read, and damage never goes by.

use std::path::Path;

use sightline_proto::diamond::Post;

use super::*;
use crate::{
    terrain::{Georeference, Grid, HeightField, MemoryField, PageId, Posts, ReadError, SceneScale, synthetic},
    wedgie::{DiamondBounds, ErrorBounds, MemoryTerrain},
};

pub(super) const SCALE: SceneScale = SceneScale { east_m: 80.0, north_m: 92.5, up_m: 1.0 };

pub(super) fn description() -> Description {
    Description { scale: SCALE, georeference: None, provenance: Provenance::default() }
}

/// Rough terrain of `nx` by `ny` posts times `factor`, a tenth of it void if `voids`.
pub(super) fn terrain(nx: u32, ny: u32, seed: u64, factor: i32, voids: bool) -> MemoryField {
    MemoryField::from_fn(nx, ny, |i, j| {
        let void = voids && synthetic::mix(u64::from(i / 3) << 32 | u64::from(j / 2) ^ seed).is_multiple_of(10);
        (!void).then(|| f64::from(synthetic::fractal_height(i, j, seed, 900) * factor))
    })
    .unwrap()
}

pub(super) fn write_to(path: &Path, field: &MemoryField) -> Written {
    write(path, false, field, &description(), &mut |_| ()).unwrap()
}

/// Height and void of every post of the grid, and the bounds of every diamond.
type Everything = (Vec<(f64, bool)>, Vec<DiamondBounds>);

/// All drawn posts and bounds, or the first error.
fn everything<T: HeightField + ErrorBounds>(t: &T) -> Result<Everything, ReadError> {
    let (grid, root) = (t.grid(), t.grid().root());
    let mut posts = Posts::new(t);
    let all = |nx: u32, ny: u32| (0..ny).flat_map(move |j| (0..nx).map(move |i| Post::new(i, j)));
    let heights = all(grid.nx(), grid.ny()).map(|p| posts.at(p).map(|post| (post.z, post.void)));
    let heights = heights.collect::<Result<_, _>>()?;
    let diamonds = all(root.side() + 1, root.side() + 1).filter(|&p| !root.is_corner(p));
    Ok((heights, diamonds.map(|p| t.bounds(p)).collect::<Result<_, _>>()?))
}

#[test]
fn heights_that_fit_the_cache_stay_where_readers_find_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.sldb");
    write_to(&path, &terrain(100, 70, 1, 1, true));
    let [read, unread] = [1, 0].map(|pi| PageId { pi, pj: 0 });
    for (cache_bytes, stays) in [(1 << 20, true), (20_000, false)] {
        let database = Database::open(&path, OpenOptions { cache_bytes }).unwrap();
        assert!(database.resident(read).is_none());
        let page = database.page(read).unwrap();
        let resident = database.resident(read);
        assert_eq!(resident.is_some(), stays, "{cache_bytes}");
        assert!(resident.is_none_or(|resident| std::ptr::eq(resident, &*page)));
        assert!(database.resident(unread).is_none());
    }
}

#[test]
fn what_is_written_is_read_with_all_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        (2, 2, 1, false),
        (3, 2, 1, false),
        (2, 70, 1, true),
        (65, 65, 1, false),
        (64, 129, 1, true),
        (200, 131, 100, true),
        (257, 90, -70_000, true),
    ];
    for (n, (nx, ny, factor, voids)) in cases.into_iter().enumerate() {
        let field = terrain(nx, ny, n as u64, factor, voids);
        let path = folder.path().join(format!("{n}.sldb"));
        let written = write_to(&path, &field);
        // A cache of no size reads every page anew, and gives the same.
        for cache_bytes in [0, 200_000, 256 << 20] {
            let database = Database::open(&path, OpenOptions { cache_bytes }).unwrap();
            assert_eq!(Database::grid(&database), Grid::new(nx, ny).unwrap());
            assert_eq!((database.version(), database.scale()), (written.version, SCALE));
            assert_eq!(database.file_bytes(), std::fs::metadata(&path).unwrap().len());
            let memory = MemoryTerrain::new(field.clone(), SCALE).unwrap();
            let (heights, bounds) = everything(&database).unwrap();
            let (expected_heights, expected_bounds) = everything(&memory).unwrap();
            assert_eq!(heights, expected_heights, "{nx} x {ny}");
            assert_eq!(bounds, expected_bounds, "{nx} x {ny}");
            let known = heights.iter().filter(|h| !h.1).map(|h| h.0 as i32);
            let range = (known.clone().min().unwrap(), known.max().unwrap());
            assert_eq!(database.height_range(), range);
            assert_eq!(database.void_posts(), heights.iter().filter(|h| h.1).count() as u64);
            if nx * ny > 1000 || cache_bytes == 200_000 {
                break;
            }
        }
    }
}

#[test]
fn the_version_is_of_the_content() {
    let folder = tempfile::tempdir().unwrap();
    let field = terrain(70, 66, 5, 1, false);
    let version = |name: &str, field: &MemoryField, description: &Description| {
        write(&folder.path().join(name), false, field, description, &mut |_| ()).unwrap().version
    };
    let first = version("a", &field, &description());
    let provenance = Provenance { sources: vec!["elsewhere".into()], ..Provenance::default() };
    assert_eq!(version("b", &field, &Description { provenance, ..description() }), first);
    let scale = SceneScale { up_m: 0.5, ..SCALE };
    assert_ne!(version("c", &field, &Description { scale, ..description() }), first);
    let raised = MemoryField::from_fn(70, 66, |i, j| {
        Some(f64::from(synthetic::fractal_height(i, j, 5, 900) + i32::from((i, j) == (69, 65))))
    });
    assert_ne!(version("d", &raised.unwrap(), &description()), first);
}

#[test]
fn existing_output_is_kept_unless_replacing_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.sldb");
    let (first, second) = (terrain(9, 9, 1, 1, false), terrain(9, 9, 2, 1, false));
    let old = write_to(&path, &first);
    let again = |replace| write(&path, replace, &second, &description(), &mut |_| ());
    assert!(matches!(again(false), Err(WriteError::Exists(_))));
    assert_eq!(Database::open(&path, OpenOptions::default()).unwrap().version(), old.version);
    let new = again(true).unwrap();
    assert_eq!(Database::open(&path, OpenOptions::default()).unwrap().version(), new.version);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside it");
}

#[test]
fn heights_that_a_database_cannot_hold_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.sldb");
    let attempt = |field: MemoryField| write(&path, false, &field, &description(), &mut |_| ()).unwrap_err();
    for z in [0.5, 3e9, -2_147_483_649.0] {
        let field = MemoryField::from_fn(5, 4, |i, j| Some(if (i, j) == (3, 2) { z } else { 1.0 })).unwrap();
        assert!(matches!(attempt(field), WriteError::Height { i: 3, j: 2, .. }), "{z}");
    }
    let nothing = MemoryField::from_fn(5, 4, |_, _| None).unwrap();
    assert!(matches!(attempt(nothing), WriteError::AllVoid { posts: 20 }));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn threads_that_share_a_small_cache_read_what_one_reads() {
    use rayon::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.sldb");
    let field = terrain(300, 260, 12, 1, true);
    write_to(&path, &field);
    let database = Database::open(&path, OpenOptions { cache_bytes: 400_000 }).unwrap();
    let memory = MemoryTerrain::new(field, SCALE).unwrap();
    (0..20_000_u64).into_par_iter().for_each(|n| {
        let random = synthetic::mix(n);
        let p = Post::new(random as u32 % 300, (random >> 32) as u32 % 260);
        let post = |t: &dyn HeightField| t.page(PageId::of(p)).unwrap().at(p.i % 64, p.j % 64);
        assert_eq!(post(&database), post(&memory), "{p:?}");
        if p != Post::new(0, 0) {
            assert_eq!(database.bounds(p), memory.bounds(p), "{p:?}");
        }
    });
}

/// Pages of a plain are stored as one of their cells, with voids and without; what is read does not know.
#[test]
fn a_plain_takes_little_room() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain.sldb");
    let height = |i: u32, j: u32| match (i, j) {
        (500, 300) => Some(90.0),
        (100..120, 50..60) => None,
        _ => Some(-7.0),
    };
    let field = MemoryField::from_fn(600, 400, height).unwrap();
    let written = write_to(&path, &field);
    // Nearly two thirds of that are pages on the border of the lattices, which have bounds of zero in them.
    assert!(written.file_bytes < field.grid().posts(), "{} bytes", written.file_bytes);
    let database = Database::open(&path, OpenOptions::default()).unwrap();
    assert_eq!(everything(&database).unwrap(), everything(&MemoryTerrain::new(field, SCALE).unwrap()).unwrap());
    assert!(verify(&path, &|_, _| ()).unwrap().damage.is_empty());
}

/// What is read beside the bounds of a post is its height, padding included; files of earlier versions have none.
#[test]
fn heights_beside_bounds_are_those_of_the_posts_and_spare_pages_of_heights() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [(3, 2, 1, false), (200, 131, 1, true), (70, 1100, 1, false), (257, 90, -70_000, true)];
    for (n, (nx, ny, factor, voids)) in cases.into_iter().enumerate() {
        let (field, path) = (terrain(nx, ny, 20 + n as u64, factor, voids), folder.path().join(format!("{n}.sldb")));
        write_to(&path, &field);
        let database = Database::open(&path, OpenOptions::default()).unwrap();
        let (mut posts, root, mut found) = (Posts::new(&field), field.grid().root(), 0);
        for (i, j) in (0..=root.side()).step_by(2).flat_map(|j| (0..=root.side()).step_by(2).map(move |i| (i, j))) {
            let p = Post::new(i, j);
            if root.is_corner(p) {
                continue;
            }
            let (bounds, z) = database.bounds_and_height(p).unwrap();
            assert_eq!(bounds, database.bounds(p).unwrap());
            assert!(z.is_some() || !field.grid().contains(p), "{p:?} of {nx} x {ny}");
            assert!(z.is_none_or(|z| z == posts.at(p).unwrap().z), "{p:?} of {nx} x {ny}");
            found += u64::from(z.is_some());
        }
        let bounds: u64 = database.sections().iter().filter(|s| s.name.starts_with("bounds")).map(|s| s.pages).sum();
        assert!(found >= field.grid().posts() / 4 - 1 && database.reads().pages <= bounds);
        // Of other posts bounds follow from heights, and nothing stands beside them.
        let odd = Post::new(1, 0);
        assert_eq!(database.bounds_and_height(odd).unwrap(), (database.bounds(odd).unwrap(), None));
    }
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/terrain-20x13-v2.sldb");
    let old = Database::open(&old, OpenOptions::default()).unwrap();
    let p = Post::new(4, 8);
    assert_eq!(old.bounds_and_height(p).unwrap(), (old.bounds(p).unwrap(), None));
}

/// The coarsest lattices and the corners are one read, whoever asks first, and what is read is the same.
#[test]
fn the_coarsest_lattices_are_read_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let (field, path) = (terrain(400, 300, 31, 1, false), folder.path().join("it.sldb"));
    write_to(&path, &field);
    let database = Database::open(&path, OpenOptions::default()).unwrap();
    let (root, expected) = (field.grid().root(), MemoryTerrain::new(field, SCALE).unwrap());
    assert_eq!((root.side(), database.reads()), (512, Reads::default()));
    let mut coarse = 0;
    for (i, j) in (0..=512).step_by(8).flat_map(|j| (0..=512).step_by(8).map(move |i| (i, j))) {
        let p = Post::new(i, j);
        if !root.is_corner(p) {
            assert_eq!(database.bounds(p), expected.bounds(p));
            coarse += 1;
        }
    }
    assert_eq!(coarse, 65 * 65 - 4);
    assert!(database.corner_heights().unwrap().is_some());
    let reads = database.reads();
    assert_eq!((reads.crowns, reads.pages, reads.directory_blocks), (1, 0, 0));
    assert!((10_000..65_537).contains(&reads.bytes), "{reads:?}");
    // The next finer lattice is not in it.
    database.bounds(Post::new(4, 4)).unwrap();
    let reads = database.reads();
    assert_eq!((reads.crowns, reads.pages, reads.directory_blocks), (1, 1, 1));
    assert_eq!(database.reads_by_section().iter().map(|of| of.pages + of.directory_blocks).sum::<u64>(), 2);
}

/// Databases that a format version, or a section within it, began with are read as they were meant. With
/// SIGHTLINE_WRITE_GOLDEN set, the newest is written anew instead: for a new version or section, beside the old files.
#[test]
fn the_golden_databases_are_read_as_they_were_written() {
    let golden = |version: &str| {
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/terrain-20x13-v{version}.sldb"))
    };
    let field = terrain(20, 13, 77, 1, true);
    let place = Georeference { epsg: Some(32633), geographic: false, origin: [5e5, 5.5e6], step: [80.0, 92.5] };
    let provenance = Provenance { sources: vec!["synthetic".into()], ..Provenance::default() };
    let described = Description { georeference: Some(place), provenance, ..description() };
    if std::env::var_os("SIGHTLINE_WRITE_GOLDEN").is_some() {
        write(&golden(NEWEST_GOLDEN), true, &field, &described, &mut |_| ()).unwrap();
    }
    let corners = field.grid().root().corners().map(|p| Posts::new(&field).at(field.grid().clamp(p)).unwrap().z);
    let (expected, recomputed) = everything(&MemoryTerrain::new(field, SCALE).unwrap()).unwrap();
    // Corners follow from heights: the terrain is the same with them.
    let versions = [("1", [70, 160, 8, 24]), ("2", GOLDEN_2), ("3", GOLDEN_3), (NEWEST_GOLDEN, GOLDEN_3)];
    for (version, terrain_version) in versions {
        let golden = golden(version);
        assert!(verify(&golden, &|_, _| ()).unwrap().damage.is_empty());
        let database = Database::open(&golden, OpenOptions::default()).unwrap();
        let (heights, bounds) = everything(&database).unwrap();
        assert_eq!(heights, expected);
        // Later versions may find tighter bounds; these must stay true.
        assert!(bounds.iter().zip(&recomputed).all(|(old, new)| old.tight >= new.tight && old.nested >= new.nested));
        assert_eq!((database.georeference(), database.scale()), (Some(place), SCALE));
        assert_eq!(database.provenance(), &described.provenance);
        assert_eq!(database.version()[..4], terrain_version);
        assert_eq!(database.corner_heights(), Ok((version == NEWEST_GOLDEN).then_some(corners)));
    }
}

/// Which of the golden databases is like those that are written today.
const NEWEST_GOLDEN: &str = "3-corners";
/// The first bytes of the terrain version of the golden database of format version 2.
const GOLDEN_2: [u8; 4] = [212, 213, 222, 165];
/// Those of format version 3.
const GOLDEN_3: [u8; 4] = [138, 46, 134, 146];
