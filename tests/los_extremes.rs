//! Lines of sight at the extremes: named cases, each compared with the naive reference, which shares no code with the
//! product; with and without skipping, strict and not, from both ends, and on the transposed terrain.
//!
//! `SIGHTLINE_QUERIES` sets the number of random queries, `SIGHTLINE_SEED` their seed; both are printed.

use sightline::{
    los::{Lines, Options, Pyramid, Verdict, naive},
    terrain::{MemoryField, synthetic::mix},
};

/// Heights by column and row.
struct Terrain {
    nx: u32,
    ny: u32,
    height: Box<dyn Fn(u32, u32) -> Option<f64>>,
}

impl Terrain {
    fn new(nx: u32, ny: u32, height: impl Fn(u32, u32) -> Option<f64> + 'static) -> Self {
        Self { nx, ny, height: Box::new(height) }
    }

    /// Small whole heights, so that lines often touch.
    fn rough(nx: u32, ny: u32, seed: u64) -> Self {
        Self::new(nx, ny, move |i, j| Some((mix(seed ^ u64::from(i * 1000 + j)) % 4) as f64))
    }
}

/// A terrain as it is and transposed, with bounds of blocks.
struct Asked {
    fields: [(MemoryField, Pyramid); 2],
}

impl Asked {
    fn new(terrain: &Terrain) -> Self {
        let Terrain { nx, ny, height } = terrain;
        let with_bounds = |field: MemoryField| {
            let pyramid = Pyramid::build(&field).unwrap();
            (field, pyramid)
        };
        let straight = MemoryField::from_fn(*nx, *ny, height).unwrap();
        let transposed = MemoryField::from_fn(*ny, *nx, |i, j| height(j, i)).unwrap();
        Self { fields: [with_bounds(straight), with_bounds(transposed)] }
    }

    /// The verdict, which all ways to ask must give.
    fn ask(&self, a: [f64; 3], b: [f64; 3]) -> Verdict {
        for strict in [true, false] {
            let options = Options { strict, ..Options::default() };
            let expected = naive::line_of_sight(&self.fields[0].0, a, b, options).unwrap();
            for (transposed, (field, pyramid)) in self.fields.iter().enumerate() {
                let turned = |[x, y, z]: [f64; 3]| if transposed == 1 { [y, x, z] } else { [x, y, z] };
                for (from, to) in [(turned(a), turned(b)), (turned(b), turned(a))] {
                    for bounds in [None, Some(pyramid)] {
                        let answer = Lines::new(field, bounds).ask(from, to, options).unwrap();
                        assert_eq!(
                            answer,
                            expected,
                            "{from:?} to {to:?}, strict {strict}, transposed {transposed}, skipping {}",
                            bounds.is_some()
                        );
                    }
                }
            }
            if !strict {
                return expected.verdict;
            }
        }
        unreachable!("the second question is not strict")
    }

    /// The line and its neighbours: each height a unit in the last place and 1e-13 up and down. Tells how many of them
    /// are blocked.
    fn ask_beside(&self, a: [f64; 3], b: [f64; 3]) -> usize {
        let moves: [fn(f64) -> f64; 5] = [|z| z, f64::next_up, f64::next_down, |z| z + 1e-13, |z| z - 1e-13];
        let moved = |by: fn(f64) -> f64, [x, y, z]: [f64; 3]| [x, y, by(z)];
        moves.iter().filter(|&&by| self.ask(moved(by, a), moved(by, b)) == Verdict::Blocked).count()
    }
}

#[test]
fn ends_from_the_least_to_the_greatest_numbers() {
    let asked = Asked::new(&Terrain::rough(3, 3, 1));
    // Products of the larger ones are beyond 2^511, and beyond the range.
    let plan = [-0.0, 5e-324, 1e-300, 1.0, 2.0, 1e154, -1e155, 1e300, -1e300, f64::MAX];
    let heights = [5e-324, -0.0, 1.0, 1e300, -f64::MAX];
    for n in 0..400_u64 {
        let pick = |k: u64, of: &[f64]| of[(mix(n * 8 + k) % of.len() as u64) as usize];
        let end = |k| [pick(k, &plan), pick(k + 1, &plan), pick(k + 2, &heights)];
        asked.ask(end(0), end(4));
    }
}

#[test]
fn lines_from_post_to_post_and_beside() {
    let asked = Asked::new(&Terrain::rough(5, 4, 3));
    let mut blocked = 0;
    for n in 0..20 * 20_u32 {
        let (p, q) = (n % 20, n / 20);
        let end = |p: u32| [f64::from(p % 5), f64::from(p / 5), (mix(3 ^ u64::from(p % 5 * 1000 + p / 5)) % 4) as f64];
        if p < q {
            blocked += asked.ask_beside(end(p), end(q));
        }
    }
    assert!(blocked > 200, "{blocked}");
}

#[test]
fn lines_along_edges_diagonals_and_the_border() {
    let asked = Asked::new(&Terrain::rough(6, 6, 5));
    for z in [0.0, 1.0, 2.0, 3.0] {
        for (a, b) in [
            ([0.0, 0.0], [5.0, 0.0]),
            ([0.0, 5.0], [5.0, 5.0]),
            ([5.0, -1.0], [5.0, 6.0]),
            ([0.0, 0.0], [5.0, 5.0]),
            ([4.0, 0.0], [0.0, 4.0]),
            ([0.5, 0.5], [3.25, 3.25]),
            ([-1.0, 1.0], [1.0, -1.0]),
            ([1.0, 0.0], [5.0, 4.0]),
            ([2.0, 0.25], [2.0, 4.75]),
        ] {
            asked.ask_beside([a[0], a[1], z], [b[0], b[1], z]);
            asked.ask_beside([a[0], f64::next_up(a[1]), z], [b[0], b[1], 3.0 - z]);
        }
    }
}

#[test]
fn lines_across_a_lake() {
    let asked = Asked::new(&Terrain::new(20, 12, |_, _| Some(7.0)));
    for (a, b) in [([0.0, 0.0], [19.0, 11.0]), ([0.3, 0.7], [18.9, 10.1]), ([3.0, 3.0], [9.0, 9.0])] {
        let at = |[x, y]: [f64; 2], z| [x, y, z];
        assert_eq!(asked.ask(at(a, 7.0), at(b, 7.0)), Verdict::Visible);
        assert_eq!(asked.ask(at(a, 7.0), at(b, f64::next_up(7.0))), Verdict::Visible);
        assert_eq!(asked.ask(at(a, 7.0), at(b, f64::next_down(7.0))), Verdict::Blocked);
        assert_eq!(asked.ask_beside(at(a, 7.0), at(b, 7.0)), 2);
    }
}

#[test]
fn an_end_in_the_plane_of_another_triangle() {
    // Slopes that meet in ridges; ends far off in the plane of one of them.
    let height = |i: u32, j: u32| Some(f64::from(i.abs_diff(4)) * 3.0 - f64::from(j) * 2.0);
    let asked = Asked::new(&Terrain::new(9, 7, height));
    for (x, y) in [(0.5, 0.5), (1.25, 3.5), (2.0, 6.0)] {
        let in_plane = |x: f64, y: f64| [x, y, (4.0 - x) * 3.0 - y * 2.0];
        asked.ask_beside(in_plane(x, y), in_plane(x + 6.0, y));
        asked.ask_beside(in_plane(x, y), in_plane(-x, y + 0.5));
    }
}

#[test]
fn spikes_cliffs_and_heights_from_1e_45_to_3e38() {
    for (low, high) in [(1e-45, 3e38), (0.0, 1e-45), (-3e38, 3e38), (5e-324, 1e300)] {
        let asked =
            Asked::new(&Terrain::new(12, 9, move |i, j| Some(if (i, j) == (5, 4) || i > 9 { high } else { low })));
        for z in [low, high, high / 2.0, low.next_up(), high.next_down()] {
            for (a, b) in [([0.0, 4.0], [9.0, 4.0]), ([1.0, 0.0], [9.0, 8.0]), ([0.0, 3.5], [11.0, 4.5])] {
                asked.ask([a[0], a[1], z], [b[0], b[1], z]);
                asked.ask([a[0], a[1], low], [b[0], b[1], z]);
            }
        }
    }
}

#[test]
fn a_void_at_every_place_of_the_triangles() {
    for (nx, ny) in [(2, 2), (3, 3), (2, 3)] {
        for void in 0..nx * ny {
            let height = move |i, j| (j * nx + i != void).then_some(f64::from((i + j) % 3));
            let asked = Asked::new(&Terrain::new(nx, ny, height));
            let ends = [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5], [1.0, 0.25], [0.25, 0.5], [0.75, 0.25]];
            for (n, a) in ends.iter().enumerate() {
                for b in &ends[n..] {
                    for z in [0.0, 1.0, 5.0] {
                        asked.ask([a[0], a[1], z], [b[0], b[1], 1.0]);
                    }
                }
            }
        }
    }
}

#[test]
fn vertical_zero_length_and_one_ulp_lines() {
    let asked = Asked::new(&Terrain::rough(4, 4, 9));
    for (x, y) in [(0.0, 0.0), (1.0, 2.0), (1.5, 1.5), (2.0, 0.5), (0.3, 0.9), (3.0, 3.0), (-0.5, 1.0)] {
        for z in [-1.0, 0.0, 1.0, 1.5, 2.0, 3.0, 9.0] {
            asked.ask([x, y, z], [x, y, z]);
            asked.ask([x, y, z], [x, y, 9.0]);
            asked.ask([x, y, z], [x.next_up(), y, z]);
            asked.ask([x, y, z], [x.next_down(), y.next_up(), z.next_down()]);
        }
    }
}

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

fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a whole number")))
}

#[test]
fn random_lines_are_the_naive_ones() {
    let (queries, seed) = (setting("SIGHTLINE_QUERIES", 600), setting("SIGHTLINE_SEED", 1));
    println!("SIGHTLINE_QUERIES={queries} SIGHTLINE_SEED={seed}");
    let mut counts = [0_u64; 3];
    for n in 0..queries.div_ceil(20) {
        let salt = mix(seed ^ mix(n));
        let (nx, ny) = (2 + (salt % 30) as u32, 2 + (salt >> 8) as u32 % 30);
        let voids = [0, 0, 3, 20][(salt >> 16) as usize % 4];
        let asked = Asked::new(&Terrain::new(nx, ny, move |i, j| {
            let post = mix(salt ^ u64::from(i * 1000 + j));
            (post % 1000 >= voids).then_some((post >> 20) as f64 % 5.0)
        }));
        for k in 0..20 {
            let draw = |m: u64| mix(salt ^ ((k * 8 + m + 1) << 32));
            let place = |m: u64, size: u32| match draw(m) % 4 {
                0 => (draw(m + 100) % u64::from(size)) as f64,
                1 => ((draw(m + 100) % u64::from(size)) as f64).next_up(),
                _ => (draw(m + 100) >> 11) as f64 / (1_u64 << 53) as f64 * f64::from(size),
            };
            let end = |m| [place(m, nx), place(m + 1, ny), place(m + 2, 8)];
            counts[asked.ask(end(0), end(4)) as usize] += 1;
        }
    }
    println!("visible, unknown, blocked: {counts:?}");
    assert!(queries < 600 || counts.iter().all(|&count| count > 20), "{counts:?}");
}
