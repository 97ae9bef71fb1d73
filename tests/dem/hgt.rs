//! SRTM tiles: raw and packed, by name and size, and as mosaics.

use sightline::dem::{self, DemError, OpenOptions, SeamReport};

use crate::encoders::{gz, hgt, zip, zip_of};
use crate::{Folder, assert_same, open, read};

const SIDE: usize = 1201;

fn slope(i: usize, j: usize) -> i16 {
    (i / 2) as i16 - (j / 3) as i16
}

#[test]
fn a_tile_is_the_same_raw_zipped_and_gzipped_in_any_letter_case() {
    let folder = Folder::new();
    let tile = hgt(SIDE, |i, j| if (i, j) == (5, 7) { -32_768 } else { slope(i, j) });
    let files = [
        folder.put("n44w072.HGT", &tile),
        folder.put("N44W072.hgt.zip", zip("N44W072.HGT", &tile)),
        folder
            .put("tile.ZIP", zip_of(&[("__MACOSX/._n44w072.hgt", b"x"), ("srtm/n44w072.hgt", &tile), ("a.txt", b"")])),
        folder.put("N44W072.SRTMGL3.hgt.gz", gz(&tile)),
    ];
    for path in files {
        let what = path.display().to_string();
        let mut raster = open(&path).unwrap_or_else(|e| panic!("{e}"));
        let info = raster.info();
        assert_eq!((info.nx, info.ny, info.unit_m), (1201, 1201, 1.0), "{what}");
        assert_eq!((info.georeference.origin, info.georeference.epsg), ([-72.0, 44.0], Some(4326)), "{what}");
        assert_eq!(info.georeference.map_from_grid(1200.0, 1200.0), [-71.0, 45.0], "{what}");
        let found = read(&mut *raster).unwrap_or_else(|e| panic!("{e}"));
        for (n, h) in found.iter().enumerate() {
            let (i, j) = (n % SIDE, n / SIDE);
            assert!(if (i, j) == (5, 7) { h.is_nan() } else { *h == f64::from(slope(i, j)) }, "{what}: ({i}, {j}) {h}");
        }
        assert_eq!(raster.seams(), None);
    }
}

#[test]
fn names_and_sizes_that_are_no_tiles_are_refused() {
    let folder = Folder::new();
    let tile = hgt(SIDE, slope);
    let error = |name: &str, content: &[u8]| match open(&folder.put(name, content)).and_then(|mut r| read(&mut *r)) {
        Err(e) => e.to_string(),
        Ok(_) => panic!("{name} was read"),
    };
    assert!(error("tile.hgt", &tile).contains("N44W072.hgt"));
    assert!(error("N44W072.hgt", &tile[..tile.len() - 2]).contains("2884800 bytes"));
    assert!(error("N44W072.hgt", &[0; 1201]).contains("1201 bytes"));
    assert!(error("N44W072.hgt", &[]).contains("empty"));
    assert!(error("N44W072.hgt", b"version https://git-lfs.github.com/spec/v1\n").contains("git lfs pull"));
    assert!(error("N44W072.zip", &zip("N45W072.hgt", &tile)).contains("holds N45W072"));
    assert!(error("N44W072.zip", &zip("readme.txt", &tile)).contains("no .hgt"));
    let two = zip_of(&[("N44W072.hgt", &tile), ("N45W072.hgt", b"")]);
    assert!(error("N44W072.zip", &two).contains("several .hgt"));
    assert!(error("N44W072.hgt.gz", &gz(&tile[2..])).contains("2884800 bytes"));
    assert!(error("N44W072.hgt.gz", &gz(&[])).contains("0 bytes"));
    // A gzip file whose last four bytes promise another tile than it holds.
    let mut lying = gz(&tile);
    let end = lying.len() - 4;
    lying[end..].copy_from_slice(&25_934_402_u32.to_le_bytes());
    assert!(error("N44W072.hgt.gz", &lying).contains("cannot be unpacked"));
    let mut bomb = gz(&vec![0; 30_000_000]);
    let end = bomb.len() - 4;
    bomb[end..].copy_from_slice(&2_884_802_u32.to_le_bytes());
    assert!(error("N44W072.hgt.gz", &bomb).contains("more than"));
}

#[test]
fn in_a_mosaic_known_beats_void_else_the_south_western_tile_wins_and_all_is_counted() {
    let folder = Folder::new();
    let last = SIDE - 1;
    // South-west: void along the southern half of its eastern border. South-east: one higher on its western border.
    let sw = hgt(SIDE, |i, j| if i == last && j < 600 { -32_768 } else { 10 });
    let se = hgt(SIDE, |i, _| if i == 0 { 11 } else { 20 });
    let nw = hgt(SIDE, |_, j| if j == 0 { 10 } else { 30 });
    let paths = [
        folder.put("N10E021.hgt", se),
        folder.put("N11E020.hgt.zip", zip("N11E020.hgt", &nw)),
        folder.put("N10E020.hgt", sw),
    ];
    let mut raster = dem::open(&paths, &OpenOptions::default(), &mut |_| ()).unwrap();
    assert_eq!((raster.info().nx, raster.info().ny), (2401, 2401));
    assert_eq!(raster.info().georeference.origin, [20.0, 10.0]);
    let found = read(&mut *raster).unwrap();
    let again = read(&mut *raster).unwrap();
    assert_same(&again, &found, "reading twice");
    for (n, h) in found.iter().enumerate() {
        let (i, j) = (n % 2401, n / 2401);
        let expected = match (i, j) {
            (1200, 0..600) => 11.0,
            (0..=1200, 0..=1200) => 10.0,
            (1201.., 0..=1200) => 20.0,
            (0..=1200, 1201..) => 30.0,
            _ => f64::NAN,
        };
        assert!(*h == expected || (h.is_nan() && expected.is_nan()), "({i}, {j}) is {h}, not {expected}");
    }
    let report = SeamReport {
        tiles: 3,
        missing_tiles: 1,
        compared_posts: 601 + 1200,
        differing_posts: 601,
        largest_difference_m: 1.0,
        filled_posts: 600,
        uncovered_posts: 1200 * 1200,
    };
    assert_eq!(raster.seams(), Some(report), "each row is counted once, however often it is read");
}

#[test]
fn tiles_that_make_no_mosaic_are_refused() {
    let folder = Folder::new();
    let tile = hgt(SIDE, slope);
    let a = folder.put("N10E020.hgt", &tile);
    let b = folder.put("N10E022.hgt", &tile);
    let fine = folder.put("N10E021.hgt", vec![0; 3601 * 3601 * 2]);
    let refused = |paths: &[&std::path::PathBuf]| {
        let paths: Vec<_> = paths.iter().map(|p| (*p).clone()).collect();
        match dem::open(&paths, &OpenOptions::default(), &mut |_| ()).map(drop) {
            Err(DemError::Mosaic { detail }) => detail,
            other => panic!("{other:?}"),
        }
    };
    assert!(refused(&[&a, &b]).contains("N10E022 does not adjoin N10E020"));
    assert!(refused(&[&a, &fine]).contains("3601"));
    assert!(refused(&[&a, &a]).contains("twice"));
    assert!(matches!(dem::open(&[], &OpenOptions::default(), &mut |_| ()), Err(DemError::NoInput)));
}
