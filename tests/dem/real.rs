//! Real elevation files of the folder that `SIGHTLINE_DEM` names. Without it these tests are ignored.

use std::path::PathBuf;

use sightline::dem::{self, DemError, OpenOptions, SeamReport};
use sightline::terrain::synthetic;

use crate::hostile::{try_read, without_panics};
use crate::{Folder, open, read};

fn folder() -> PathBuf {
    PathBuf::from(std::env::var_os("SIGHTLINE_DEM").expect("SIGHTLINE_DEM names the folder of elevation files"))
}

struct Summary {
    size: (u32, u32),
    least: f64,
    most: f64,
    voids: usize,
    seams: Option<SeamReport>,
}

fn summary(paths: &[PathBuf]) -> Result<Summary, DemError> {
    let mut raster = dem::open(paths, &OpenOptions::default(), &mut |_| ())?;
    let heights = read(&mut *raster)?;
    let known = heights.iter().filter(|h| !h.is_nan());
    let info = raster.info();
    println!("{}: {} x {}, {:?}, unit {}", paths[0].display(), info.nx, info.ny, info.georeference, info.unit_m);
    println!("    {}: {}", info.format, info.notes.join("; "));
    let (least, most) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), h| (a.min(*h), b.max(*h)));
    let voids = heights.iter().filter(|h| h.is_nan()).count();
    println!("    {least}..{most} m, {voids} void");
    Ok(Summary { size: (info.nx, info.ny), least, most, voids, seams: raster.seams() })
}

/// Rows and columns of the tile, counted from the north-west, that the derived files show.
const CROP_NORTH: usize = 200;
const CROP_WEST: usize = 500;
const CROP_SIDE: usize = 513;

#[test]
#[ignore = "needs SIGHTLINE_DEM"]
fn derived_files_hold_the_heights_of_the_crop_they_were_made_from() {
    let folder = folder();
    let tile = read(&mut *open(&folder.join("hgt/N44W072.hgt")).unwrap()).unwrap();
    let crop = |i: usize, j: usize| {
        let from_north = CROP_NORTH + CROP_SIDE - 1 - j;
        tile[(1200 - from_north) * 1201 + CROP_WEST + i]
    };
    let cases = [
        ("esri_ascii.asc", 300, 0.0),
        ("f32_lerc.tif", 0, 0.0),
        ("f32_nan_nodata_deflate.tif", 300, 0.0),
        ("f32_tiled128_lzw_pred3.tif", 300, 0.25),
        ("f64_strip_packbits.tif", 300, 0.0),
        ("i16_cog_deflate.tif", 300, 0.0),
        ("i16_multi_row_strips_7.tif", 300, 0.0),
        ("i16_pixel_is_point.tif", 300, 0.0),
        ("i16_strip_none_be.tif", 300, 0.0),
        ("i16_strip_none_le.tif", 300, 0.0),
        ("i16_tiled256_deflate_pred2.tif", 300, 0.0),
        ("i32_bigtiff_zstd.tif", 300, 0.0),
        ("u16_strip_lzw.tif", 0, 0.0),
        ("gray16_metres.png", 0, 0.0),
        ("mapbox_terrain-rgb.png", 0, 0.0),
        ("terrarium.png", 0, 0.0),
    ];
    for (name, voids, higher) in cases {
        let mut raster = open(&folder.join("derived").join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let heights = read(&mut *raster).unwrap_or_else(|e| panic!("{name}: {e}"));
        let info = raster.info();
        println!("{name}: {} x {}, {}, {:?}", info.nx, info.ny, info.format, info.georeference);
        println!("    unit {}: {}", info.unit_m, info.notes.join("; "));
        assert_eq!((info.nx, info.ny), (513, 513), "{name}");
        if name.ends_with(".png") {
            assert!(!info.georeference.is_placed(), "{name}");
        } else {
            assert!(info.georeference.geographic && info.georeference.epsg == Some(4326), "{name}");
        }
        let placed = |info: &dem::RasterInfo| info.georeference.is_placed();
        let [west, south] = info.georeference.origin;
        let expected = [-72.0 + 500.0 / 1200.0, 45.0 - 712.0 / 1200.0];
        let near = (west - expected[0]).abs() < 1e-6 && (south - expected[1]).abs() < 1e-6;
        assert!(near || !placed(info), "{name}: {west} {south}");
        assert!(!placed(info) || info.georeference.step.iter().all(|s| (s - 1.0 / 1200.0).abs() < 1e-9), "{name}");
        for (n, height) in heights.iter().enumerate() {
            let (i, j) = (n % CROP_SIDE, n / CROP_SIDE);
            let north = CROP_SIDE - 1 - j;
            let void = voids > 0 && (100..110).contains(&north) && (200..230).contains(&i);
            assert_eq!(height.is_nan(), void, "{name}: post ({i}, {j})");
            assert!(void || *height == crop(i, j) + higher, "{name}: post ({i}, {j}) is {height}, not {}", crop(i, j));
        }
    }
    let utm = summary(&[folder.join("derived/f32_utm19_nodata-9999.tif")]).unwrap();
    assert_eq!((utm.size, utm.voids), ((439, 602), 15_319));
}

#[test]
#[ignore = "needs SIGHTLINE_DEM"]
fn what_cannot_be_read_is_refused_with_words() {
    let derived = folder().join("derived");
    let refused = |name: &str| match open(&derived.join(name)).and_then(|mut r| read(&mut *r)) {
        Ok(_) => panic!("{name} was read"),
        Err(e) => {
            println!("{e}");
            e
        }
    };
    assert!(matches!(refused("N44W072_lfs_pointer.hgt"), DemError::PointerFile { .. }));
    for name in ["N44W072_truncated.hgt", "truncated.asc", "truncated.tif"] {
        assert!(matches!(refused(name), DemError::Malformed { .. }), "{name}");
    }
    for name in ["../other/gabilan.hdr", "esri_ascii.asc.aux.xml", "../README.md"] {
        assert!(matches!(refused(name), DemError::Unsupported { .. }), "{name}");
    }
    assert!(matches!(open(&derived), Err(DemError::Directory { .. })));
}

#[test]
#[ignore = "needs SIGHTLINE_DEM"]
fn files_of_the_wild_hold_what_their_table_says() {
    let folder = folder();
    let cases = [
        ("dted/n33_w116_3arc_v2.dt1", (1201, 1201), -87.0, 1619.0, 0),
        ("dted/test_data_negative.dt2", (121, 121), 0.0, 466.0, 0),
        ("dted/w114_n32.dt1", (1201, 1201), 63.0, 993.0, 0),
        ("dted/w114_n33.dt1", (1201, 1201), 134.0, 1723.0, 0),
        ("geotiff/bigtujunga.tif", (1197, 643), 315.0, 2295.0, 0),
        ("geotiff/davos_srtm1_2160.tif", (2160, 2160), 556.0, 3373.0, 0),
        ("geotiff/dom1_32_356_5699_1_nw_2020.tif", (1000, 1000), 87.29, 167.74, 0),
        ("geotiff/elev.tif", (512, 512), 0.44, 114.92, 0),
        ("geotiff/los_angeles_dem_geoid.tif", (361, 361), 41.06, 421.76, 0),
        ("geotiff/mars_gale_hirise_1m.tif", (348, 337), -4472.67, -4437.88, 0),
        ("geotiff/mt_rainier_90m.tif", (1201, 1201), 263.0, 4371.0, 9033),
        ("geotiff/palouse_hires.tif", (194, 222), 785.8, 817.58, 0),
        ("geotiff/portland-ned.tif", (864, 648), 0.0, 328.11, 0),
        ("hgt/N15W024.hgt.zip", (3601, 3601), -18.0, 1361.0, 0),
        ("hgt/N32E076.HGT", (1201, 1201), 397.0, 6416.0, 0),
        ("hgt/N42E001.hgt.zip", (1201, 1201), 349.0, 3100.0, 7652),
        ("hgt/N43E006.hgt", (1201, 1201), -12.0, 1923.0, 0),
        ("hgt/N43E007.hgt", (1201, 1201), -16.0, 2060.0, 4),
        ("hgt/N48W125.hgt.zip", (3601, 3601), -13.0, 1095.0, 6_483_876),
        // GDAL gives two rows more, wholly void, for the corners of the quadrangle.
        ("other/SainteHelens.dem", (327, 466), 682.0, 2543.0, 4151 - 2 * 327),
        ("other/gabilan.bil", (921, 859), 187.9, 307.28, 0),
        ("other/avaHit.asc", (526, 446), 1455.17, 2604.46, 74_209),
    ];
    for (name, size, least, most, voids) in cases {
        let found = summary(&[folder.join(name)]).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!((found.size, found.voids), (size, voids), "{name}");
        assert!((found.least - least).abs() < 0.006 && (found.most - most).abs() < 0.006, "{name}");
    }
}

#[test]
#[ignore = "needs SIGHTLINE_DEM"]
fn adjoining_tiles_are_one_mosaic_and_their_disagreements_are_counted() {
    let folder = folder();
    let mut tiles: Vec<_> = (36..40)
        .flat_map(|lat| (118..122).map(move |lon| format!("california/N{lat}W{lon}.hgt.zip")))
        .map(|name| folder.join(name))
        .collect();
    tiles.reverse();
    let found = summary(&tiles).unwrap();
    let seams = found.seams.unwrap();
    println!("    {seams:?}");
    assert_eq!((found.size, found.voids), ((4801, 4801), 0));
    assert_eq!((seams.tiles, seams.missing_tiles, seams.filled_posts), (16, 0, 0));
    assert_eq!((seams.compared_posts, seams.differing_posts), (6 * 4801 - 9, 2655));
    assert_eq!(seams.largest_difference_m, 1.0);

    let nice = summary(&[folder.join("hgt/N43E007.hgt"), folder.join("hgt/N43E006.hgt")]).unwrap();
    println!("    {:?}", nice.seams);
    assert_eq!(nice.size, (2401, 1201));
    let arizona = summary(&[folder.join("dted/w114_n33.dt1"), folder.join("dted/w114_n32.dt1")]).unwrap();
    println!("    {:?}", arizona.seams);
    assert_eq!((arizona.size, arizona.voids, arizona.seams.unwrap().compared_posts), ((1201, 2401), 0, 1201));
    assert_eq!((arizona.least, arizona.most), (63.0, 1723.0));
    let apart = summary(&[folder.join("hgt/N43E007.hgt"), folder.join("hgt/N44W072.hgt")]);
    assert!(matches!(apart, Err(DemError::Mosaic { .. })));
}

/// The real files exercise what the small samples cannot: dictionaries, entropy coders, bit-packed blocks.
#[test]
#[ignore = "needs SIGHTLINE_DEM"]
fn damaged_real_files_are_errors_or_rasters() {
    const SEED: u64 = 20_261_122;
    const TRIES: u64 = 60;
    println!("seed {SEED}");
    let scratch = Folder::new();
    let names: Vec<_> = std::fs::read_dir(folder().join("derived")).unwrap().map(|e| e.unwrap().path()).collect();
    for path in names.iter().filter(|p| p.extension().is_some_and(|e| e == "tif" || e == "asc" || e == "png")) {
        let (name, sound) = (path.file_name().unwrap().to_string_lossy(), std::fs::read(path).unwrap());
        let mut read_well = 0;
        for n in 0..TRIES {
            let mut content = sound.clone();
            let draw = |k: u64| synthetic::mix(SEED ^ (n << 8 | k)) as usize % sound.len();
            match n % 3 {
                0 => content.truncate(draw(0)),
                1 => content[draw(0)] ^= 1 << (n % 8),
                _ => (0..8).for_each(|k| content[draw(k)] = draw(k + 8) as u8),
            }
            let damaged = scratch.put(&name, &content);
            without_panics(&format!("{name}, try {n}"), || {
                read_well += u32::from(try_read(&damaged, u32::MAX).is_ok());
            });
        }
        println!("{name}: {read_well} of {TRIES} still read");
    }
}
