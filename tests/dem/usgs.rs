//! USGS ASCII DEM: profiles of any length, units, datums, and what is refused.

use sightline::dem::DemError;

use crate::encoders::Usgs;
use crate::{Folder, assert_same, open, open_in_no_memory, read};

const NAN: f64 = f64::NAN;

#[test]
fn profiles_that_begin_anywhere_leave_voids_around_them() {
    let folder = Folder::new();
    let profiles = [(1, vec![10, 11]), (0, vec![20, -32_767, 22, 23]), (2, vec![32])];
    let expected = [[NAN, 20.0, NAN], [10.0, NAN, NAN], [11.0, 22.0, 32.0], [NAN, 23.0, NAN]].concat();
    let dem = Usgs::default();
    for (name, content) in [("records.dem", dem.encode(&profiles)), ("lines.DEM", dem.encode_lines(&profiles))] {
        let mut raster = open(&folder.put(name, content)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let info = raster.info();
        assert_eq!((info.nx, info.ny, info.unit_m), (3, 4, 1.0), "{name}");
        let place = info.georeference;
        assert_eq!((place.epsg, place.origin, place.step), (Some(26_710), [557_820.0, 5_108_100.0], [30.0; 2]));
        assert!(info.notes.iter().any(|n| n.contains("NGVD 29")));
        assert_same(&read(&mut *raster).unwrap(), &expected, name);
        // With its samples in a file.
        assert_same(&read(&mut *open_in_no_memory(&folder.0.path().join(name)).unwrap()).unwrap(), &expected, name);
    }
}

/// More posts than a band has, so that profiles are read a piece at a time.
#[test]
fn profiles_of_many_bands_come_out_row_by_row() {
    let folder = Folder::new();
    let height = |i: usize, j: usize| (i * 31 + j * 7) as i32 % 3000;
    let profiles: Vec<_> =
        (0..700).map(|i| (i % 40, (i % 40..900 + i % 30).map(|j| height(i, j)).collect::<Vec<_>>())).collect();
    let path = folder.put("large.dem", Usgs::default().encode(&profiles));
    for mut raster in [open(&path).unwrap(), open_in_no_memory(&path).unwrap()] {
        let (nx, ny) = (raster.info().nx as usize, raster.info().ny as usize);
        assert_eq!((nx, ny), (700, 929));
        let found = read(&mut *raster).unwrap();
        for (n, found) in found.iter().enumerate() {
            let (i, j) = (n % nx, n / nx);
            let known = (i % 40..900 + i % 30).contains(&j);
            assert!(if known { *found == f64::from(height(i, j)) } else { found.is_nan() }, "({i}, {j}): {found}");
        }
    }
}

#[test]
fn the_first_profile_need_not_be_the_most_southern() {
    let folder = Folder::new();
    let mut raster = open(&folder.put("a.dem", Usgs::default().encode(&[(3, vec![1]), (0, vec![2])]))).unwrap();
    assert_eq!(raster.info().georeference.origin, [557_820.0, 5_108_100.0]);
    assert_same(&read(&mut *raster).unwrap(), &[NAN, 2.0, NAN, NAN, NAN, NAN, 1.0, NAN], "heights");
}

#[test]
fn feet_tenths_and_a_profiles_datum_come_out_in_metres() {
    let folder = Folder::new();
    let dem = Usgs { feet: true, resolution: [30.0, 30.0, 0.1], profile_datum: 100.0, ..Usgs::default() };
    let mut raster = open(&folder.put("a.dem", dem.encode(&[(0, vec![5, -5]), (0, vec![0, 10])]))).unwrap();
    assert!((raster.info().unit_m - 0.030_48).abs() < 1e-12);
    let found = read(&mut *raster).unwrap();
    for (found, feet) in found.iter().zip([100.5, 100.0, 99.5, 101.0]) {
        assert!((found - feet * 0.3048).abs() < 1e-9, "{found} for {feet} feet");
    }
}

#[test]
fn long_profiles_run_over_several_records_and_degrees_are_arc_seconds() {
    let folder = Folder::new();
    let origin = [-122.0 * 3600.0, 46.0 * 3600.0];
    let dem = Usgs { geographic: true, resolution: [3.0, 3.0, 1.0], origin, datum: " 1 3", ..Usgs::default() };
    let profiles: Vec<_> = (0..3).map(|i| (0, (0..700).map(|j| i * 1000 + j).collect())).collect();
    let mut raster = open(&folder.put("a.dem", dem.encode(&profiles))).unwrap();
    let place = raster.info().georeference;
    assert_eq!((raster.info().nx, raster.info().ny, place.epsg, place.geographic), (3, 700, Some(4326), true));
    assert!((place.origin[0] + 122.0).abs() < 1e-9 && (place.step[1] - 3.0 / 3600.0).abs() < 1e-12);
    let found = read(&mut *raster).unwrap();
    for j in 0..700 {
        assert_eq!(found[j * 3..j * 3 + 3], [0.0, 1000.0, 2000.0].map(|z| z + j as f64), "row {j}");
    }
}

#[test]
fn what_is_no_grid_is_refused_with_words() {
    let folder = Folder::new();
    let profiles = [(0, vec![1, 2]), (0, vec![3, 4])];
    let sound = Usgs::default().encode(&profiles);
    let error = |content: &[u8]| match open(&folder.put("a.dem", content)).map(drop) {
        Err(e @ (DemError::Malformed { .. } | DemError::Refused { .. })) => e.to_string(),
        other => panic!("{other:?}"),
    };
    let changed = |at: usize, text: &str| {
        let mut content = sound.clone();
        content[at..at + text.len()].copy_from_slice(text.as_bytes());
        content
    };
    assert!(error(&sound[..1024]).contains("0 of 2 profiles"));
    assert!(error(&sound[..2048]).contains("1 of 2 profiles"));
    assert!(error(&changed(150, "     2")).contains("regular grid"));
    assert!(error(&changed(156, "     2")).contains("reference system"));
    assert!(error(&changed(528, "     1")).contains("unit code 1"));
    assert!(error(&changed(534, "     3")).contains("unit code 3"));
    assert!(error(&changed(858, "     1")).contains("at least 2"));
    assert!(error(&changed(1024 + 144, "  1.5x")).contains("sample 0"));
    assert!(error(&changed(1024 + 18, "     2")).contains("one column"));
    let shifted = Usgs { origin: [557_820.0, 5_108_100.0], ..Usgs::default() };
    let mut records = shifted.records(&profiles);
    records.swap(1, 2);
    let swapped: Vec<_> = records.iter().flat_map(|r| format!("{r:1024}").into_bytes()).collect();
    assert!(error(&swapped).contains("next column"));
    // Two samples a million rows apart are no grid.
    let far = [(0, vec![1]), (900_000, vec![2])];
    assert!(error(&Usgs::default().encode(&far)).contains("scattered"));
}
