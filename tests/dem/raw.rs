//! Raw rasters with Esri's and ENVI's headers: types, byte orders, layouts, places, and what is refused.

use std::path::PathBuf;

use sightline::dem::{DemError, FLOAT_UNIT_M};

use crate::{Folder, assert_same, open, read};

const NAN: f64 = f64::NAN;

/// A raster of 3 x 2 samples with a header beside it.
fn put(folder: &Folder, name: &str, header: &str, samples: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.put(name, samples);
    folder.put(path.with_extension("hdr").file_name().unwrap().to_str().unwrap(), header);
    path
}

fn error(path: &std::path::Path) -> String {
    match open(path).and_then(|mut r| read(&mut *r)) {
        Err(e @ (DemError::Malformed { .. } | DemError::Refused { .. } | DemError::Unsupported { .. })) => {
            e.to_string()
        }
        other => panic!("{other:?}"),
    }
}

const BIL: &str = "NROWS 2\nNCOLS 3\nNBANDS 1\nLAYOUT BIL\nULXMAP 100\nULYMAP 220\nXDIM 10\nYDIM 20\nNODATA -5\n";

#[test]
fn each_type_and_byte_order_comes_out_exactly_south_row_first() {
    let folder = Folder::new();
    let values = [1.0, 2.0, 300.0, 4.0, -5.0, 6.0];
    let expected = [4.0, NAN, 6.0, 1.0, 2.0, 300.0];
    fn bytes<const N: usize>(values: [f64; 6], big: bool, to_le: impl Fn(f64) -> [u8; N]) -> Vec<u8> {
        let order = |mut b: [u8; N]| {
            if big {
                b.reverse();
            }
            b
        };
        values.into_iter().flat_map(|v| order(to_le(v))).collect()
    }
    for (big, word) in [(false, "I"), (true, "M"), (false, "LSBFIRST"), (true, "msbfirst")] {
        let cases = [
            ("16\nPIXELTYPE SIGNEDINT", bytes(values, big, |v| (v as i16).to_le_bytes())),
            ("32\nPIXELTYPE signedint", bytes(values, big, |v| (v as i32).to_le_bytes())),
            ("32\nPIXELTYPE FLOAT", bytes(values, big, |v| (v as f32).to_le_bytes())),
            ("64\nPIXELTYPE FLOAT", bytes(values, big, |v| v.to_le_bytes())),
            ("16", bytes(values, big, |v| (v as i16).to_le_bytes())),
        ];
        for (bits, samples) in cases {
            let what = format!("{bits} {word}");
            let path = put(&folder, "a.bil", &format!("{BIL}BYTEORDER {word}\r\nNBITS {bits}\n"), samples);
            let mut raster = open(&path).unwrap_or_else(|e| panic!("{what}: {e}"));
            let info = raster.info();
            assert_eq!((info.nx, info.ny), (3, 2), "{what}");
            assert_eq!((info.georeference.origin, info.georeference.step), ([100.0, 200.0], [10.0, 20.0]), "{what}");
            assert_eq!(info.unit_m, if what.contains("FLOAT") { FLOAT_UNIT_M } else { 1.0 }, "{what}");
            assert_same(&read(&mut *raster).unwrap(), &expected, &what);
        }
    }
    let header = format!("{BIL}BYTEORDER I\nNBITS 16\nPIXELTYPE UNSIGNEDINT\n").replace("-5", "65535");
    let samples = bytes([1.0, 2.0, 3.0, 40_000.0, 65_535.0, 6.0], false, |v| (v as u16).to_le_bytes());
    let mut raster = open(&put(&folder, "a.bil", &header, samples)).unwrap();
    assert_same(&read(&mut *raster).unwrap(), &[40_000.0, NAN, 6.0, 1.0, 2.0, 3.0], "unsigned");
}

#[test]
fn skipped_bytes_padded_rows_and_the_first_of_several_bands() {
    let folder = Folder::new();
    let header = |lines: &str| format!("{BIL}NBITS 8\n{lines}").replace("NODATA -5\n", "");
    let expected = [4.0, 5.0, 6.0, 1.0, 2.0, 3.0];
    let cases = [
        (header("SKIPBYTES 2\nTOTALROWBYTES 4\n"), vec![9, 9, 1, 2, 3, 9, 4, 5, 6]),
        (header("BANDROWBYTES 4\n"), vec![1, 2, 3, 9, 4, 5, 6]),
        (header("").replace("NBANDS 1", "NBANDS 2"), vec![1, 2, 3, 9, 9, 9, 4, 5, 6, 9, 9, 9]),
        (header("").replace("NBANDS 1\nLAYOUT BIL", "NBANDS 2\nLAYOUT bip"), vec![1, 9, 2, 9, 3, 9, 4, 9, 5, 9, 6, 9]),
        (header("").replace("NBANDS 1\nLAYOUT BIL", "NBANDS 2\nLAYOUT BSQ"), vec![1, 2, 3, 4, 5, 6, 9, 9, 9, 9, 9, 9]),
    ];
    for (header, samples) in cases {
        let mut raster = open(&put(&folder, "a.bil", &header, samples)).unwrap_or_else(|e| panic!("{header}: {e}"));
        assert_same(&read(&mut *raster).unwrap(), &expected, &header);
        assert_eq!(raster.info().notes.iter().any(|n| n.contains("2 bands")), header.contains("NBANDS 2"));
    }
}

#[test]
fn an_flt_header_gives_the_corner_and_floats() {
    let folder = Folder::new();
    let header = "ncols 3\nnrows 2\nxllcorner 100\nyllcorner 200\ncellsize 10\nbyteorder LSBFIRST\n";
    let samples: Vec<_> = [1.5_f32, -9999.0, 3.0, 4.0, 5.0, 6.25].into_iter().flat_map(f32::to_le_bytes).collect();
    let mut raster = open(&put(&folder, "a.flt", header, &samples)).unwrap();
    assert_eq!(raster.info().georeference.origin, [105.0, 205.0], "the corner of a corner pixel, not its centre");
    assert_same(&read(&mut *raster).unwrap(), &[4.0, 5.0, 6.25, 1.5, NAN, 3.0], "-9999 is void by default");
    let utm = r#"PROJCS["WGS_1984_UTM_Zone_33N",GEOGCS["x"],UNIT["Meter",1.0]]"#;
    folder.put("a.prj", utm);
    assert_eq!(open(&folder.0.path().join("a.flt")).unwrap().info().georeference.epsg, Some(32_633));
}

#[test]
fn an_envi_header_may_stand_behind_any_name() {
    let folder = Folder::new();
    let header = "ENVI\ndescription = {\n samples = 99}\nsamples = 3\nlines   = 2\nbands   = 1\nheader offset = 1\n\
                  data type = 12\ninterleave = bsq\nbyte order = 1\n\
                  map info = {UTM, 1.5, 1.5, 500000, 4000000, 10, 20, 33, South, WGS-84, units=Meters}\n\
                  data ignore value = 7\n";
    let samples = [0, 0, 1, 0, 2, 0, 3, 0, 4, 0, 7, 255, 255];
    for (name, header_name) in [("scene.dat", "scene.dat.hdr"), ("scene2", "scene2.hdr"), ("scene3.img", "scene3.HDR")]
    {
        folder.put(header_name, header);
        let mut raster = open(&folder.put(name, samples)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let place = raster.info().georeference;
        assert_eq!((place.epsg, place.origin, place.step), (Some(32_733), [500_000.0, 3_999_980.0], [10.0, 20.0]));
        assert_same(&read(&mut *raster).unwrap(), &[4.0, NAN, 65_535.0, 1.0, 2.0, 3.0], name);
    }
    let geographic = header
        .replace("UTM, 1.5, 1.5, 500000, 4000000, 10, 20, 33, South", "Geographic Lat/Lon, 1, 1, 7, 50, 0.01, 0.01");
    let geographic = geographic.replace("Meters", "Degrees");
    let path = put(&folder, "b.dat", &geographic, samples);
    let place = open(&path).unwrap().info().georeference;
    assert_eq!((place.epsg, place.geographic), (Some(4326), true));
    assert!((place.origin[0] - 7.005).abs() < 1e-12 && (place.origin[1] - 49.985).abs() < 1e-12);
    for (from, to, words) in [
        ("data type = 12", "data type = 6", "data type 6"),
        ("units=Meters", "units=Feet", "\"Feet\""),
        ("units=Meters", "rotation=12.5", "rotated"),
        ("byte order = 1\n", "", "byte order"),
        ("map info = {UTM, 1.5", "map info = {UTM, x", "map info"),
        ("header offset", "file compression = 1\nheader offset", "compressed"),
    ] {
        let found = error(&put(&folder, "c.dat", &header.replace(from, to), samples));
        assert!(found.contains(words), "{words} in {found}");
    }
}

#[test]
fn what_the_header_leaves_open_or_gets_wrong_is_refused_with_words() {
    let folder = Folder::new();
    let bil = |lines: &str, samples: usize| error(&put(&folder, "a.bil", &format!("{BIL}{lines}"), vec![0; samples]));
    assert!(bil("NBITS 32\n", 24).contains("PIXELTYPE FLOAT"));
    assert!(bil("NBITS 12\n", 24).contains("12 bits"));
    assert!(bil("NBITS 16\nBYTEORDER X\n", 12).contains("neither I nor M"));
    assert!(bil("NBITS 16\nLAYOUT BOX\n", 12).contains("none of BIL"));
    assert!(bil("NBITS 16\nTOTALROWBYTES 5\n", 12).contains("too short"));
    assert!(bil("NBITS 16\nBYTEORDER I\n", 11).contains("too few"));
    assert!(bil("NBITS 16\nNODATA what\n", 12).contains("NODATA"));
    assert!(bil("NBITS 16\nNROWS 1\n", 12).contains("2 to 2^30"));
    assert!(bil("NBITS 16\nSKIPBYTES 18446744073709551615\n", 12).contains("too few"));
    let alone = folder.put("alone.flt", [0; 24]);
    assert!(error(&alone).contains("without its header file"));
}

#[test]
fn a_header_beside_a_dem_file_makes_it_a_raw_raster() {
    let folder = Folder::new();
    // GTOPO30: no PIXELTYPE, big-endian.
    let header = format!("BYTEORDER M\nNBITS 16\n{BIL}").replace("-5", "-9999");
    let samples: Vec<_> = [1_i16, 2, 3, -9999, -5, 6].into_iter().flat_map(i16::to_be_bytes).collect();
    let path = folder.put("E020N40.DEM", samples);
    folder.put("E020N40.HDR", header);
    let mut raster = open(&path).unwrap();
    assert_same(&read(&mut *raster).unwrap(), &[NAN, -5.0, 6.0, 1.0, 2.0, 3.0], "GTOPO30");
    assert!(raster.info().notes.iter().any(|n| n.contains("signed is taken")));
}
