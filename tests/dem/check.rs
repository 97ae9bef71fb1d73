//! What the check of a raster finds, and what it leaves alone.

use sightline::dem::check::{CheckReport, Suspicion, check};
use sightline::dem::{self, OpenOptions};
use sightline::terrain::synthetic;

use crate::Folder;

const SIDE: usize = 12;

fn report(heights: &[f64]) -> CheckReport {
    let folder = Folder::new();
    let words: Vec<_> = heights.iter().map(|z| if z.is_nan() { "-1".to_owned() } else { z.to_string() }).collect();
    let header = format!("ncols {SIDE}\nnrows {}\nxllcorner 0\nyllcorner 0\ncellsize 30\n", heights.len() / SIDE);
    // The first row of the text is the northernmost.
    let rows: Vec<_> = words.chunks(SIDE).rev().map(|row| row.join(" ")).collect();
    let path = folder.put("grid.asc", format!("{header}NODATA_value -1\n{}\n", rows.join("\n")));
    let mut raster = dem::open(&[path], &OpenOptions::default(), &mut |_| ()).unwrap();
    check(&mut *raster, &mut |_| ()).unwrap()
}

/// Slopes of up to 40 m a post with some roughness.
fn hills() -> Vec<f64> {
    (0..SIDE * SIDE)
        .map(|n| (200 + 40 * (n % SIDE) + 25 * (n / SIDE)) as f64 + (synthetic::mix(n as u64) % 20) as f64)
        .collect()
}

fn found(heights: &[f64]) -> Vec<(Suspicion, u32, u32)> {
    report(heights).findings.iter().map(|f| (f.suspicion, f.i, f.j)).collect()
}

#[test]
fn sound_terrain_is_not_suspicious() {
    let sound = report(&hills());
    assert!(!sound.is_suspicious() && sound.findings.is_empty());
    assert_eq!((sound.posts, sound.void_posts), (144, 0));
    let [lowest, highest] = sound.extremes.unwrap();
    assert!(lowest.height_m < 260.0 && highest.height_m > 880.0 && (lowest.j, highest.j) == (0, 11));
    // A real pyramid: steep on all sides, but with sides.
    let mut summit = hills();
    for (n, z) in summit.iter_mut().enumerate() {
        let d = (n % SIDE).abs_diff(6).max((n / SIDE).abs_diff(6));
        *z += 80.0 * 6_usize.saturating_sub(d) as f64;
    }
    assert!(found(&summit).is_empty());
}

#[test]
fn a_post_far_above_or_below_all_its_neighbours_is_a_spike() {
    for (i, j) in [(5, 6), (0, 4), (11, 4), (4, 0), (4, 11)] {
        let mut heights = hills();
        heights[j * SIDE + i] += 600.0;
        assert_eq!(found(&heights), [(Suspicion::Spike, i as u32, j as u32)], "({i}, {j})");
        heights[j * SIDE + i] -= 1200.0;
        assert_eq!(found(&heights), [(Suspicion::Pit, i as u32, j as u32)], "({i}, {j})");
    }
    // On a plain, 50 m are allowed and no more.
    let plain = |z| {
        let mut heights = vec![100.0; SIDE * SIDE];
        heights[5 * SIDE + 5] = z;
        found(&heights).len()
    };
    assert_eq!([150.0, 150.5, 50.0, 49.5].map(plain), [0, 1, 0, 1]);
}

#[test]
fn a_spike_needs_five_known_neighbours() {
    let mut heights = vec![100.0; SIDE * SIDE];
    let at = 5 * SIDE + 5;
    heights[at] = 900.0;
    for (voids, n) in [at - SIDE - 1, at - SIDE, at - 1, at + SIDE].into_iter().enumerate() {
        assert_eq!(found(&heights).len(), 1, "{voids} voids");
        heights[n] = f64::NAN;
    }
    assert_eq!((found(&heights).len(), report(&heights).void_posts), (0, 4));
}

#[test]
fn values_that_no_ground_has_are_reported_one_by_one_and_counted() {
    let mut heights = vec![100.0; SIDE * SIDE];
    (heights[0], heights[1], heights[2], heights[SIDE]) = (-9999.0, 9000.5, -11_001.0, 32_767.0);
    let report = report(&heights);
    assert_eq!((report.marks, report.out_of_range, report.spikes + report.pits), (1, 3, 0));
    let kinds: Vec<_> = report.findings.iter().map(|f| (f.suspicion, f.i, f.j, f.height_m)).collect();
    use Suspicion::{Mark, OutOfRange};
    let expected = [
        (Mark, 0, 0, -9999.0),
        (OutOfRange, 1, 0, 9000.5),
        (OutOfRange, 2, 0, -11_001.0),
        (OutOfRange, 0, 1, 32_767.0),
    ];
    assert_eq!(kinds, expected);
    assert!(report.is_suspicious());
}

#[test]
fn void_rasters_and_tiles_that_disagree_much_are_suspicious() {
    let void = report(&[f64::NAN; SIDE * 2]);
    assert!(void.is_suspicious() && void.extremes.is_none() && void.void_posts == 24);
    let folder = Folder::new();
    let pair = |difference: f64| {
        let row = |z: f64| format!("{z} {z} {z}\n{z} {z} {z}\n");
        let grid = |x: f64, z: f64| format!("ncols 3\nnrows 2\nxllcorner {x}\nyllcorner 2000\ncellsize 10\n{}", row(z));
        let paths = [folder.put("a.asc", grid(1000.0, 100.0)), folder.put("b.asc", grid(1020.0, 100.0 + difference))];
        let mut raster = dem::open(&paths, &OpenOptions::default(), &mut |_| ()).unwrap();
        check(&mut *raster, &mut |_| ()).unwrap()
    };
    let (small, large) = (pair(16.0), pair(16.5));
    assert!(!small.is_suspicious() && small.seams.unwrap().differing_posts == 2);
    assert!(large.is_suspicious() && large.are_seams_suspicious() && large.suspicious_posts() == 0);
}
