//! Numbers from one end of the range to the other: ends, heights, and what is no number.

use sightline::los::{LosError, Options, Verdict, line_of_sight, naive};

use super::{Asked, Terrain, mix};

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
fn nan_and_infinity_are_refused_in_every_coordinate() {
    let field = Asked::new(&Terrain::rough(3, 3, 1)).fields.remove(0).1;
    for (n, name) in ["ax", "ay", "az", "bx", "by", "bz"].into_iter().enumerate() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut ends = [[0.5, 0.5, 9.0], [1.5, 1.5, 9.0]];
            ends[n / 3][n % 3] = bad;
            let [a, b] = ends;
            for answer in [
                line_of_sight(&field, a, b, Options::default()),
                naive::line_of_sight(&field, a, b, Options::default()),
            ] {
                match answer {
                    Err(LosError::NotFinite { what, value }) => {
                        assert_eq!((what, value.to_bits()), (name, bad.to_bits()))
                    }
                    other => panic!("{name} = {bad}: {other:?}"),
                }
            }
        }
    }
}

#[test]
fn grids_of_two_by_two() {
    for heights in 0..16_u32 {
        let asked = Asked::new(&Terrain::new(2, 2, move |i, j| Some(f64::from(heights >> (2 * j + i) & 1))));
        let places = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5], [0.25, 0.5], [-0.5, 0.5], [1.0, 1.5]];
        for (n, [ax, ay]) in places.into_iter().enumerate() {
            for [bx, by] in &places[n..] {
                for (az, bz) in [(0.0, 1.0), (0.5, 0.5), (1.0, 0.0), (1.0, 1.0)] {
                    asked.ask([ax, ay, az], [*bx, *by, bz]);
                }
            }
        }
    }
    let asked = Asked::new(&Terrain::new(2, 2, |_, _| Some(0.0)));
    assert_eq!(asked.ask([0.0, 0.0, 0.0], [1.0, 1.0, 0.0]), Verdict::Visible);
}
