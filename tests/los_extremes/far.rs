//! Grids of more posts than 2^32, of which only what a line needs exists; and terrain far from post (0, 0).

use std::sync::Arc;

use sightline::{
    los::{Options, Verdict, line_of_sight, naive},
    terrain::{Grid, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, ReadError, Samples},
};

use super::{End, Terrain, mix, without_filters};

/// A grid of any size whose pages are made when they are asked for.
struct Sparse<F> {
    grid: Grid,
    height: F,
}

impl<F: Fn(u32, u32) -> Option<f64> + Send + Sync> HeightField for Sparse<F> {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        let mut heights = vec![0.0; PAGE_POSTS];
        let mut voids = Box::new([0_u64; PAGE_POSTS / 64]);
        for (n, z) in heights.iter_mut().enumerate() {
            let (i, j) = (n as u32 % PAGE_SIDE + id.pi * PAGE_SIDE, n as u32 / PAGE_SIDE + id.pj * PAGE_SIDE);
            match (self.height)(i, j) {
                Some(height) => *z = height,
                None => voids[n / 64] |= 1 << (n % 64),
            }
        }
        let voids = voids.iter().any(|&v| v != 0).then_some(voids);
        Ok(Arc::new(HeightPage::new(Samples::F64(heights.into()), voids)))
    }
}

/// All ways to ask of a field that is too large to be read whole.
fn ask<H: HeightField>(field: &H, a: End, b: End) -> Verdict {
    let options = Options::default();
    let expected = naive::line_of_sight(field, a, b, options).unwrap();
    for (from, to) in [(a, b), (b, a)] {
        assert_eq!(line_of_sight(field, from, to, options).unwrap(), expected, "{from:?} to {to:?}");
        assert_eq!(without_filters(field, from, to, options), expected, "{from:?} to {to:?}");
    }
    expected.verdict
}

#[test]
fn terrain_at_offsets_of_4e6_and_1e9_has_the_same_lines() {
    let home = super::Asked::new(&Terrain::rough(9, 8, 41));
    let rough = |i: u32, j: u32| (i < 9 && j < 8).then(|| (mix(41 ^ u64::from(i * 1000 + j)) % 4) as f64);
    for (dx, dy) in [(4_000_000, 4_000_000), (4_000_001, 3_999_999), (1_000_000_000, 1_000_000_000), (1_000_000_000, 0)]
    {
        let grid = Grid::new(dx + 9, dy + 8).unwrap();
        assert!(dy == 0 || grid.posts() > 1 << 32);
        // Around it there is no data, which is as unknown as what lies outside.
        let field = Sparse { grid, height: move |i: u32, j: u32| rough(i.checked_sub(dx)?, j.checked_sub(dy)?) };
        let mut blocked = 0;
        for n in 0..60_u64 {
            let eighth = |k: u64| (mix(n * 8 + k) % 72) as f64 / 8.0;
            let end = |k| [eighth(k), eighth(k + 1), eighth(k + 2) / 2.0];
            let there = |[x, y, z]: End| [x + f64::from(dx), y + f64::from(dy), z];
            let verdict = ask(&field, there(end(0)), there(end(4)));
            assert_eq!(verdict, home.ask(end(0), end(4)), "moved by {dx}, {dy}, line {n}");
            blocked += u32::from(verdict == Verdict::Blocked);
        }
        assert!(blocked > 10, "{blocked}");
    }
}

#[test]
fn lines_across_a_grid_of_more_than_2_to_the_32_posts() {
    let grid = Grid::new((1 << 30) + 1, (1 << 30) + 1).unwrap();
    let field = Sparse { grid, height: |i: u32, j: u32| Some((mix(u64::from(i) << 32 | u64::from(j)) % 4) as f64) };
    let corner = f64::from(1_u32 << 30);
    for (a, b) in [
        // Along the border, over the last posts, and through the middle of nowhere.
        ([corner, corner, 3.0], [corner - 700.0, corner - 300.5, 3.0]),
        ([corner - 900.0, 0.0, 3.5], [corner, 0.0, 3.0]),
        ([5e8 + 0.125, 1e9 + 0.25, 3.0], [5e8 + 800.5, 1e9 - 1_100.75, 3.0]),
        ([5e8, 1e9, 2.0], [5e8 + 12.0, 1e9 + 9.0, 3.0]),
        ([5e8 + 1.0, 1e9, 0.0], [5e8 + 1.0, 1e9, 9.0]),
    ] {
        ask(&field, a, b);
        ask(&field, [a[0], a[1], a[2].next_up()], [b[0], b[1], b[2].next_up()]);
    }
}
