//! Lines of all lengths over grids of several pages, against the plain walk: what is settled by a glance, by least
//! heights of blocks and by stretches is what looking at every crossing gives.

use super::*;
use crate::terrain::{MemoryField, synthetic};

/// A number in [0, 1).
fn unit(n: u64) -> f64 {
    (synthetic::mix(n) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Hills of 16-bit, 32-bit or fractional heights, with or without voids.
fn field(kind: u64) -> MemoryField {
    let height = move |i: u32, j: u32| {
        let z = f64::from(synthetic::fractal_height(i, j, kind, 700));
        let z = [z, z * 4000.0, z * 0.1][kind as usize % 3];
        let void = kind >= 3 && synthetic::mix(u64::from(i / 7) << 32 | u64::from(j / 5)).is_multiple_of(60);
        (!void).then_some(z)
    };
    MemoryField::from_fn(200, 150, height).unwrap()
}

/// Line number `n`: its ends are near, on or below the ground, sometimes at posts or on edges, up to `reach` apart.
fn line(field: &MemoryField, n: u64, reach: f64) -> [[f64; 3]; 2] {
    let limits = [199.0, 149.0];
    let snap = |v: f64, k: u64| match synthetic::mix(n * 16 + k) % 8 {
        0 => v.round(),
        1 => (v * 2.0).round() / 2.0,
        _ => v,
    };
    let from = [0, 1].map(|k: usize| snap(limits[k] * unit(n * 16 + k as u64), 4 + k as u64));
    let to = [0, 1].map(|k: usize| {
        let v = from[k] + reach * (2.0 * unit(n * 16 + 2 + k as u64) - 1.0);
        snap(v.clamp(0.0, limits[k]), 6 + k as u64)
    });
    let above = [0.0, 2.0, 30.0, -1.0][(synthetic::mix(n) % 4) as usize];
    [from, to].map(|[x, y]| [x, y, on_ground(field, x, y, above).unwrap().unwrap_or(100.0)])
}

fn ask(field: &MemoryField, [a, b]: [[f64; 3]; 2], precision: Precision) -> Answer {
    Lines::new(field).ask(a, b, Options { precision, ..Options::default() }).unwrap()
}

#[test]
fn exact_answers_are_those_of_the_plain_walk() {
    let mut counts = [0; 3];
    for kind in 0..6 {
        let field = field(kind);
        for n in 0..2_000 {
            let line = line(&field, kind << 32 | n, [6.0, 40.0, 200.0][n as usize % 3]);
            let strict = n % 5 == 0;
            let options = Options { strict, ..Options::default() };
            let plain = Lines::plain(&field).ask(line[0], line[1], options).unwrap();
            let [forth, back] =
                [[0, 1], [1, 0]].map(|[a, b]| Lines::new(&field).ask(line[a], line[b], options).unwrap());
            assert_eq!((forth, back), (plain, plain), "{line:?}, heights {kind}, strict {strict}");
            counts[plain.verdict as usize] += 1;
        }
    }
    assert!(counts.iter().all(|&count| count > 200), "{counts:?}");
}

#[test]
fn rounded_answers_are_exact_ones_away_from_ties() {
    for kind in 0..6 {
        let field = field(kind);
        for n in 0..1_000 {
            let [a, b] = line(&field, kind << 40 | n, [6.0, 40.0, 200.0][n as usize % 3]);
            let moved = |by: f64| [[a[0], a[1], a[2] + by], [b[0], b[1], b[2] + by]];
            for (precision, near) in [(Precision::F64, 1e-6), (Precision::Fast, 2.0)] {
                let [low, high] = [-near, near].map(|by| ask(&field, moved(by), Precision::Exact).verdict);
                let found = ask(&field, [a, b], precision);
                assert!(!found.certain);
                assert!(low != high || found.verdict == low, "{a:?} {b:?}, heights {kind}, {precision}");
            }
        }
    }
}

#[test]
fn curved_lines_over_several_pages_are_those_walked_in_full() {
    let mut counts = [0; 3];
    for kind in 0..6 {
        let field = field(kind);
        let earth = Earth::curved(0.002, 0.003).unwrap();
        for n in 0..150 {
            let [a, b] = line(&field, kind << 48 | n, 200.0);
            let options = Options { earth, strict: n % 4 == 0, ..Options::default() };
            let plain = Lines::plain(&field).ask(a, b, options).unwrap();
            assert_eq!(Lines::new(&field).ask(a, b, options).unwrap(), plain, "{a:?} {b:?}, heights {kind}");
            counts[plain.verdict as usize] += 1;
        }
    }
    assert!(counts.iter().all(|&count| count > 20), "{counts:?}");
}

/// Heights whose differences overflow decide nothing by rounded numbers.
#[test]
fn cliffs_beyond_the_range_of_numbers_are_exact() {
    let field = MemoryField::from_fn(9, 9, |i, _| Some(if i < 4 { -1.7e308 } else { 1.7e308 })).unwrap();
    for (x, verdict) in [(3.25, Verdict::Visible), (3.75, Verdict::Blocked)] {
        for (a, b) in [([1.0, 3.25, 0.0], [x, 4.75, 0.0]), ([x, 1.5, 0.0], [x, 6.25, 0.0])] {
            assert_eq!(ask(&field, [a, b], Precision::Exact).verdict, verdict, "{a:?} {b:?}");
            assert_eq!(Lines::plain(&field).ask(a, b, Options::default()).unwrap().verdict, verdict);
        }
    }
}
