//! Laws: parts make the whole, raised ground hides no less, and moved terrain has the same lines.

use super::{Asked, Terrain, mix};

#[test]
fn terrain_moved_by_an_even_sum_has_the_same_lines() {
    let rough = |i: u32, j: u32| Some((mix(u64::from(i * 1000 + j)) % 4) as f64);
    let home = Asked::new(&Terrain::new(6, 5, rough));
    for (dx, dy) in [(2, 4), (3, 5), (7, 1), (64, 0)] {
        // Around it there is no data, which is as unknown as what lies outside.
        let moved =
            Asked::new(&Terrain::new(6 + dx, 5 + dy, move |i, j| rough(i.checked_sub(dx)?, j.checked_sub(dy)?)));
        for n in 0..60_u64 {
            let eighth = |k: u64| (mix(n * 8 + k) % 48) as f64 / 8.0;
            let end = |k| [eighth(k), eighth(k + 1), eighth(k + 2) / 2.0];
            let there = |[x, y, z]: [f64; 3]| [x + f64::from(dx), y + f64::from(dy), z];
            let (a, b) = (end(0), end(4));
            assert_eq!(moved.ask(there(a), there(b)), home.ask(a, b), "moved by {dx}, {dy}: {a:?} {b:?}");
        }
    }
}

/// A number in eighths from 0 to below `below`.
fn eighths(draw: u64, below: u64) -> f64 {
    (mix(draw) % (8 * below)) as f64 / 8.0
}

#[test]
fn parts_at_a_point_exactly_on_the_line_make_the_whole() {
    let mut verdicts = [0_u32; 3];
    for terrain in 0..12_u64 {
        let asked = Asked::new(&Terrain::new(7, 6, move |i, j| {
            let post = mix(terrain ^ u64::from(i * 1000 + j));
            (!post.is_multiple_of(19)).then_some((post % 4) as f64)
        }));
        for n in 0..25_u64 {
            let draw = |k: u64| terrain << 32 | n << 8 | k;
            let [a, b] = [0, 3].map(|k| [eighths(draw(k), 7), eighths(draw(k + 1), 6), eighths(draw(k + 2), 5)]);
            // Eighths of eighths: no bit is lost.
            let t = (1 + mix(draw(6)) % 7) as f64 / 8.0;
            let m = [0, 1, 2].map(|k| a[k] + t * (b[k] - a[k]));
            let whole = asked.ask(a, b);
            assert_eq!(asked.ask(a, m).max(asked.ask(m, b)), whole, "{a:?} {m:?} {b:?}");
            verdicts[whole as usize] += 1;
        }
    }
    assert!(verdicts.iter().all(|&count| count > 10), "{verdicts:?}");
}

#[test]
fn raising_the_terrain_never_makes_a_line_less_hidden() {
    for n in 0..80_u64 {
        let height = move |i: u32, j: u32| (mix(n ^ u64::from(i * 1000 + j)) % 4) as f64;
        let raise = move |i: u32, j: u32| {
            let post = mix(n ^ u64::from(i * 1000 + j + 500));
            if post.is_multiple_of(3) { (post >> 8) as f64 % 3.0 * 0.5 } else { 0.0 }
        };
        let low = Asked::new(&Terrain::new(7, 6, move |i, j| Some(height(i, j))));
        let high = Asked::new(&Terrain::new(7, 6, move |i, j| Some(height(i, j) + raise(i, j))));
        for k in 0..8 {
            let draw = |m: u64| n << 32 | k << 8 | m;
            let [a, b] = [0, 3].map(|m| [eighths(draw(m), 7), eighths(draw(m + 1), 6), eighths(draw(m + 2), 5)]);
            assert!(low.ask(a, b) <= high.ask(a, b), "{a:?} {b:?}");
        }
    }
}
