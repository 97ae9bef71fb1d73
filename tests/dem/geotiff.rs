//! GeoTIFF: every combination of sample type, codec, predictor, byte order, layout and flavour gives the same heights.

use std::path::Path;

use sightline::dem::{self, DemError, FLOAT_UNIT_M, OpenOptions};

use crate::encoders::{Codec, Samples, Tiff};
use crate::{Folder, assert_same, open, open_in_no_memory, read};

/// A height for every column and row from the north; never negative, so that unsigned samples hold it.
fn height(i: usize, row: usize) -> f64 {
    (1000 + (37 * i * i + 11 * row * (i + 3)) % 20_000) as f64
}

/// [`height`] of all posts, south row first.
fn expected(width: usize, rows: usize) -> Vec<f64> {
    (0..rows).rev().flat_map(|row| (0..width).map(move |i| height(i, row))).collect()
}

#[test]
fn every_codec_predictor_sample_type_layout_and_byte_order_gives_the_same_heights() {
    let folder = Folder::new();
    let mut tried = 0;
    for codec in Codec::ALL {
        for samples in Samples::ALL {
            for predictor in 1..=3 {
                let float = matches!(samples, Samples::F32 | Samples::F64);
                if (predictor == 3) != (float && predictor > 1) || (codec == Codec::Lerc && predictor > 1) {
                    continue;
                }
                for (tile, big, big_endian) in
                    [(None, false, false), (Some(16), true, false), (None, true, true), (Some(16), false, true)]
                {
                    let tiff = Tiff {
                        width: 37,
                        height: 29,
                        samples,
                        codec,
                        predictor,
                        tile,
                        big,
                        big_endian,
                        ..Tiff::default()
                    };
                    let path = folder.put("sample.tif", tiff.encode(height));
                    let what = format!("{tiff:?}");
                    let mut raster = open(&path).unwrap_or_else(|e| panic!("{what}: {e}"));
                    let unit_m = if float { FLOAT_UNIT_M } else { 1.0 };
                    assert_eq!((raster.info().nx, raster.info().ny, raster.info().unit_m), (37, 29, unit_m), "{what}");
                    let found = read(&mut *raster).unwrap_or_else(|e| panic!("{what}: {e}"));
                    assert_same(&found, &expected(37, 29), &what);
                    let by_row = read(&mut *open_in_no_memory(&path).unwrap());
                    match codec {
                        Codec::Lerc => {
                            assert!(by_row.unwrap_err().to_string().contains("gdal_translate -co TILED=YES"))
                        }
                        _ => assert_same(&by_row.unwrap_or_else(|e| panic!("{what}: {e}")), &found, &what),
                    }
                    tried += 1;
                }
            }
        }
    }
    assert_eq!(tried, 4 * (5 * 10 + 5));
}

/// Real streams of each codec, of pixels with several samples, of bits the other way round, in a file of one strip: what
/// rows of it give is what tiff-reader gives for all of it.
#[test]
fn a_strip_gives_the_same_by_rows_as_at_once() {
    let folder = Folder::new();
    for codec in [Codec::None, Codec::Lzw, Codec::Deflate, Codec::PackBits, Codec::Zstd] {
        for (samples, predictor) in [(Samples::I16, 2), (Samples::F32, 3), (Samples::F64, 2), (Samples::I32, 1)] {
            for (bits_reversed, bands) in [(false, 3), (true, 1)] {
                let tiff = Tiff {
                    width: 31 * bands,
                    height: 100,
                    rows_per_strip: 100,
                    samples,
                    codec,
                    // Differences between columns, read as those between pixels, are other heights; whole ones fit.
                    predictor: if bands == 1 || samples == Samples::I16 { predictor } else { 1 },
                    bits_reversed,
                    ..Tiff::default()
                };
                let mut bytes = tiff.encode(height);
                if bands > 1 {
                    set_long(&mut bytes, 256, 31);
                    set_short(&mut bytes, 277, bands as u16);
                }
                let path = folder.put("strip.tif", bytes);
                let what = format!("{tiff:?}");
                let whole = read(&mut *open(&path).unwrap()).unwrap_or_else(|e| panic!("{what}: {e}"));
                assert!(whole[1] == height(bands, 99) || (bands > 1 && tiff.predictor > 1), "{what}");
                assert_same(&read(&mut *open_in_no_memory(&path).unwrap()).unwrap(), &whole, &what);
            }
        }
    }
}

/// Finds the entry of a tag with one value in a little-endian TIFF and changes the value.
fn set_value(bytes: &mut [u8], tag: u16, kind: u16, value: &[u8]) {
    let mark = [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1_u32.to_le_bytes()].concat();
    let at = bytes.windows(8).position(|w| w == mark).expect("the tag is there") + 8;
    bytes[at..at + value.len()].copy_from_slice(value);
}

fn set_long(bytes: &mut [u8], tag: u16, value: u32) {
    set_value(bytes, tag, 4, &value.to_le_bytes());
}

fn set_short(bytes: &mut [u8], tag: u16, value: u16) {
    set_value(bytes, tag, 3, &value.to_le_bytes());
}

#[test]
fn rows_come_in_any_order_and_number() {
    let folder = Folder::new();
    let tiff = Tiff {
        width: 300,
        height: 900,
        rows_per_strip: 1,
        samples: Samples::I32,
        geokeys: Vec::new(),
        ..Tiff::default()
    };
    let path = folder.put("sample.tif", tiff.encode(height));
    let all = expected(300, 900);
    let mut raster = open(&path).unwrap();
    for (j0, rows) in [(899, 1), (0, 3), (450, 450), (449, 2), (0, 900), (7, 0)] {
        let mut out = vec![0.0; rows * 300];
        raster.read_rows(j0 as u32, &mut out).unwrap();
        assert_same(&out, &all[j0 * 300..][..rows * 300], &format!("rows {j0} + {rows}"));
    }
}

#[test]
fn posts_lie_at_pixel_centres_however_the_file_says_where_it_lies() {
    let folder = Folder::new();
    let place = |doubles: Vec<(u16, Vec<f64>)>, raster_type| {
        let geokeys = vec![(1024, 2), (1025, raster_type), (2048, 4326)];
        let tiff = Tiff { doubles, geokeys, ..Tiff::default() };
        let raster = open(&folder.put("sample.tif", tiff.encode(height))).unwrap();
        raster.info().georeference
    };
    let (scale, area, point) = ((33550, vec![0.5, 0.25, 0.0]), 1, 2);
    let tie = |x, y| (33922, vec![0.0, 0.0, 0.0, x, y, 0.0]);
    let matrix = |x, y| (34264, vec![0.5, 0.0, 0.0, x, 0.0, -0.25, 0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    for (doubles, raster_type) in [
        (vec![scale.clone(), tie(10.0, 50.0)], area),
        (vec![scale.clone(), tie(10.25, 49.875)], point),
        (vec![matrix(10.0, 50.0)], area),
        (vec![matrix(10.25, 49.875)], point),
    ] {
        let found = place(doubles.clone(), raster_type);
        // The north-western post's centre is (10.25, 49.875); the southern one lies six steps further south.
        assert_eq!((found.origin, found.step), ([10.25, 48.375], [0.5, 0.25]), "{doubles:?}");
        assert_eq!((found.epsg, found.geographic), (Some(4326), true));
    }
}

#[test]
fn a_plain_tiff_has_unit_steps() {
    let folder = Folder::new();
    let tiff = Tiff { doubles: Vec::new(), geokeys: Vec::new(), ..Tiff::default() };
    let mut raster = open(&folder.put("plain.tiff", tiff.encode(height))).unwrap();
    let found = raster.info().georeference;
    assert_eq!((found.origin, found.step, found.epsg, found.geographic), ([0.0; 2], [1.0; 2], None, false));
    assert_same(&read(&mut *raster).unwrap(), &expected(9, 7), "plain");
}

#[test]
fn what_would_make_lengths_wrong_is_refused() {
    let folder = Folder::new();
    let refused = |tiff: Tiff| match open(&folder.put("sample.tif", tiff.encode(height))).map(drop) {
        Err(DemError::Refused { detail, .. }) => detail,
        other => panic!("{other:?}"),
    };
    let rotated = vec![0.4, 0.1, 0.0, 10.0, 0.1, -0.4, 0.0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    assert!(refused(Tiff { doubles: vec![(34264, rotated)], ..Tiff::default() }).contains("rotated"));
    let feet = vec![(1024, 1), (1025, 1), (3072, 2227), (3076, 9003)];
    assert!(refused(Tiff { geokeys: feet, ..Tiff::default() }).contains("9003"));
    let beyond = vec![(33550, vec![0.5, 0.25, 0.0]), (33922, vec![0.0, 0.0, 0.0, 10.0, 95.0, 0.0])];
    assert!(refused(Tiff { doubles: beyond, ..Tiff::default() }).contains("--crs"));
    let scaled = r#"<GDALMetadata><Item name="SCALE" sample="0" role="scale">0.1</Item></GDALMetadata>"#;
    assert!(refused(Tiff { metadata: Some(scaled), ..Tiff::default() }).contains("unscale"));
    assert!(refused(Tiff { extra: vec![(274, 3)], ..Tiff::default() }).contains("orientation"));
    assert!(refused(Tiff { missing: vec![0, 1, 2], ..Tiff::default() }).contains("none of its blocks"));
    let mut jpeg = Tiff::default().encode(height);
    set_short(&mut jpeg, 259, 7);
    let error = open(&folder.put("sample.tif", jpeg)).map(drop).unwrap_err().to_string();
    assert!(error.contains("JPEG (number 7)") && error.contains("gdal_translate -co COMPRESS=DEFLATE"), "{error}");
}

#[test]
fn heights_in_feet_become_metres_and_keep_an_exact_unit() {
    let folder = Folder::new();
    let geokeys = vec![(1024, 2), (1025, 1), (2048, 4326), (4099, 9002)];
    let mut raster = open(&folder.put("feet.tif", Tiff { geokeys, ..Tiff::default() }.encode(height))).unwrap();
    let unit_m = raster.info().unit_m;
    assert_eq!(unit_m, 0.3048);
    for (found, feet) in read(&mut *raster).unwrap().iter().zip(expected(9, 7)) {
        assert_eq!((found / unit_m).round(), feet);
    }
}

#[test]
fn void_is_what_the_file_declares_or_the_user_says() {
    let folder = Folder::new();
    let voids = |samples, nodata, value: f64, options: &OpenOptions| {
        let sample = |i, row| if (i, row) == (2, 3) { value } else { height(i, row) };
        let path = folder.put("sample.tif", Tiff { samples, nodata, ..Tiff::default() }.encode(sample));
        let mut raster = dem::open(&[path], options, &mut |_| ()).unwrap();
        read(&mut *raster).map(|h| h.iter().filter(|h| h.is_nan()).count())
    };
    let plain = OpenOptions::default();
    let said = OpenOptions { nodata: Some(-5.0), ..OpenOptions::default() };
    let lowest = f64::from(f32::MIN);
    assert_eq!(voids(Samples::I16, Some("-9999"), -9999.0, &plain), Ok(1));
    assert_eq!(voids(Samples::I16, Some("32767"), 32_767.0, &plain), Ok(1));
    assert_eq!(voids(Samples::I16, Some("-9999"), -32_768.0, &plain), Ok(0));
    assert_eq!(voids(Samples::I16, None, -32_768.0, &plain), Ok(1));
    assert_eq!(voids(Samples::F64, None, -32_767.0, &plain), Ok(1));
    assert_eq!(voids(Samples::F32, None, -9999.0, &plain), Ok(1));
    assert_eq!(voids(Samples::I32, None, -9999.0, &plain), Ok(0));
    assert_eq!(voids(Samples::F32, Some("nan"), -9999.0, &plain), Ok(0));
    assert_eq!(voids(Samples::F32, Some("nan"), f64::NAN, &plain), Ok(1));
    assert_eq!(voids(Samples::F32, Some("-9999"), f64::INFINITY, &plain), Ok(1));
    assert_eq!(voids(Samples::F32, Some("-3.40282346639e+38"), lowest, &plain), Ok(1));
    assert_eq!(voids(Samples::F64, Some("-1.79769313486232e+308"), f64::MIN, &plain), Ok(1));
    assert_eq!(voids(Samples::F32, Some("0.1"), 0.1, &plain), Ok(1));
    assert_eq!(voids(Samples::I16, Some("-9999"), -5.0, &said), Ok(1));
    assert_eq!(voids(Samples::I16, Some("-9999"), -9999.0, &said), Ok(0));
    match voids(Samples::F32, None, lowest, &plain) {
        Err(e @ DemError::ImpossibleHeight { i: 2, j: 3, .. }) => assert!(e.to_string().contains("--nodata")),
        other => panic!("{other:?}"),
    }
    let path = folder.put("sample.tif", Tiff { nodata: Some("missing"), ..Tiff::default() }.encode(height));
    assert!(matches!(open(&path), Err(DemError::Malformed { .. })));
}

#[test]
fn blocks_that_are_not_stored_are_void() {
    let folder = Folder::new();
    let tiff = Tiff { width: 40, height: 20, tile: Some(16), missing: vec![1, 5], ..Tiff::default() };
    let path = folder.put("sparse.tif", tiff.encode(height));
    let found = read(&mut *open(&path).unwrap()).unwrap();
    assert_same(&read(&mut *open_in_no_memory(&path).unwrap()).unwrap(), &found, "by rows");
    for (n, h) in found.iter().enumerate() {
        let (i, row) = (n % 40, 19 - n / 40);
        let void = (row < 16 && (16..32).contains(&i)) || (row >= 16 && i >= 32);
        assert_eq!(h.is_nan(), void, "post {i} of row {row}");
    }
}

#[test]
fn the_users_reference_system_replaces_the_files() {
    let folder = Folder::new();
    let path = folder.put("sample.tif", Tiff::default().encode(height));
    let options = OpenOptions { epsg: Some(32_619), ..OpenOptions::default() };
    let raster = dem::open(&[path], &options, &mut |_| ()).unwrap();
    assert_eq!((raster.info().georeference.epsg, raster.info().georeference.geographic), (Some(32_619), false));
}

/// The demo's terrain is what its `PROVENANCE.md` says; the sums were taken from the array it was made from.
#[test]
fn the_demo_terrain_is_the_jacksboro_fault() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli/demo/jacksboro.tif");
    let mut raster = open(&path).unwrap();
    let info = raster.info().clone();
    assert_eq!((info.nx, info.ny, info.unit_m), (403, 344, 1.0));
    assert_eq!((info.georeference.epsg, info.georeference.geographic), (Some(4326), true));
    let half = 0.5 / 1200.0;
    let [west, south] = info.georeference.origin;
    assert!((west - (-84.41375 + half)).abs() < 1e-9 && (south - (36.44625 + half)).abs() < 1e-9, "{west} {south}");
    assert!(info.georeference.step.iter().all(|s| (s - 1.0 / 1200.0).abs() < 1e-12));
    let heights = read(&mut *raster).unwrap();
    let corners = [heights[0], heights[402], heights[343 * 403], heights[343 * 403 + 402]];
    assert_eq!(corners, [545.0, 272.0, 483.0, 444.0]);
    assert_eq!(heights.iter().sum::<f64>(), 73_617_913.0);
    let (least, most) = heights.iter().fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(*h), b.max(*h)));
    assert_eq!((least, most), (236.0, 1076.0));
}
