//! PNG pictures: what their samples mean is said by the user or the path, and never guessed.

use png::{BitDepth, ColorType};
use sightline::dem::{self, DemError, OpenOptions, PngHeights, Raster};

use crate::encoders::png;
use crate::{Folder, assert_same, open, read};

const NAN: f64 = f64::NAN;

fn open_as(path: &std::path::Path, kind: PngHeights) -> Result<Box<dyn Raster>, DemError> {
    dem::open(&[path.to_owned()], &OpenOptions { png: Some(kind), ..OpenOptions::default() }, &mut |_| ())
}

fn refused(found: Result<Box<dyn Raster>, DemError>) -> String {
    match found.map(drop) {
        Err(DemError::Refused { detail, .. }) => detail,
        other => panic!("{other:?}"),
    }
}

#[test]
fn sixteen_grey_bits_are_metres() {
    let folder = Folder::new();
    let grey = png(2, ColorType::Grayscale, BitDepth::Sixteen, &[0, 1, 1, 0, 0xff, 0xff, 0, 0]);
    let path = folder.put("a.png", grey);
    let mut raster = open(&path).unwrap();
    assert_same(&read(&mut *raster).unwrap(), &[65_535.0, 0.0, 1.0, 256.0], "south row first");
    assert_eq!((raster.info().unit_m, raster.info().georeference.epsg), (1.0, None));
    assert!(!raster.info().georeference.is_placed());
    assert!(refused(open_as(&path, PngHeights::Terrarium)).contains("16-bit grey"));
}

#[test]
fn coloured_pictures_are_read_as_the_user_or_the_path_says_and_else_refused() {
    let folder = Folder::new();
    let rgb = png(2, ColorType::Rgb, BitDepth::Eight, &[128, 1, 128, 0, 0, 0, 1, 134, 161, 128, 0, 0]);
    let terrarium = [f64::from(0x0001_86a1) / 256.0 - 32_768.0, 0.0, 1.5, NAN];
    let mapbox = [0.1, 828_860.8, 828_899.2, NAN];
    let path = folder.put("a.png", &rgb);
    let words = refused(open(&path));
    assert!(words.contains("--png terrarium") && words.contains("--png mapbox"), "{words}");
    assert!(refused(open_as(&path, PngHeights::Gray16)).contains("coloured"));
    let read_as = |path: &std::path::Path, kind| {
        let mut raster = match kind {
            Some(kind) => open_as(path, kind),
            None => open(path),
        };
        read(&mut **raster.as_mut().unwrap()).unwrap()
    };
    assert_same(&read_as(&path, Some(PngHeights::Terrarium)), &terrarium, "said to be Terrarium");
    assert_same(&read_as(&path, Some(PngHeights::Mapbox)), &mapbox, "said to be Terrain-RGB");
    assert_same(&read_as(&folder.put("Terrarium_7.png", &rgb), None), &terrarium, "by its name");
    let named = folder.put("terrain-rgb.png", &rgb);
    assert_same(&read_as(&named, None), &mapbox, "by its name");
    assert_same(&read_as(&named, Some(PngHeights::Terrarium)), &terrarium, "the user's word stands over the name");
    assert!(refused(open(&folder.put("mapbox_or_terrarium.png", &rgb))).contains("--png"));
    let transparent = png(2, ColorType::Rgba, BitDepth::Eight, &[128, 0, 0, 255, 128, 0, 0, 0].repeat(2));
    assert_same(&read_as(&folder.put("terrarium.png", transparent), None), &[0.0, NAN, 0.0, NAN], "alpha");
}

#[test]
fn a_tile_path_places_it_in_web_mercator_and_tiles_join() {
    let folder = Folder::new();
    for x in 0..2 {
        std::fs::create_dir_all(folder.0.path().join(format!("terrarium/1/{x}"))).unwrap();
    }
    let tile = |metres: u8| png(4, ColorType::Rgb, BitDepth::Eight, &[128, metres, 0].repeat(16));
    let west = folder.put("terrarium/1/0/0.png", tile(7));
    let east = folder.put("terrarium/1/1/0.png", tile(8));
    let half = 20_037_508.342_789_244;
    let place = open(&east).unwrap().info().georeference;
    assert_eq!((place.epsg, place.step, place.origin), (Some(3857), [half / 4.0; 2], [half / 8.0; 2]));
    let mut both = dem::open(&[east, west], &OpenOptions::default(), &mut |_| ()).unwrap();
    assert_eq!((both.info().nx, both.info().ny), (8, 4));
    let expected = [[7.0; 4], [8.0; 4]].concat().repeat(4);
    assert_same(&read(&mut *both).unwrap(), &expected, "tiles share no posts");
}

#[test]
fn large_pictures_are_unpacked_band_by_band() {
    let folder = Folder::new();
    // 12.5 MB of samples in a few kilobytes: more than a band.
    let side = 2500;
    let rows: Vec<_> = (0..side).flat_map(|row: u16| row.to_be_bytes().repeat(side.into())).collect();
    let path = folder.put("a.png", png(side.into(), ColorType::Grayscale, BitDepth::Sixteen, &rows));
    let mut raster = open(&path).unwrap();
    let mut row = vec![0.0; side.into()];
    for j in [0, 1, 1000, 2499] {
        raster.read_rows(j, &mut row).unwrap();
        assert!(row.iter().all(|h| *h == f64::from(2499 - j)), "row {j}");
    }
}

#[test]
fn other_kinds_of_pictures_are_refused() {
    let folder = Folder::new();
    for (color, depth) in [(ColorType::Grayscale, BitDepth::Eight), (ColorType::Rgb, BitDepth::Sixteen)] {
        let content = png(2, color, depth, &vec![9; color.samples() * depth as usize / 8 * 4]);
        assert!(refused(open(&folder.put("a.png", content))).contains("16-bit grey"), "{color:?}");
    }
}
