//! Properties of what is derived from a line, on lines and grids made to be degenerate.

use proptest::prelude::*;
use sightline_proto::{
    diamond::{Post, Triangle},
    predicates::Sign,
    verdict::LinePoint,
};

use super::{
    tests::{ask, heights, line},
    *,
};
use crate::terrain::{MemoryField, Posts};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn derived_values_exist_exactly_when_the_verdict_says((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let blocked = ask(&field, a, b) == Verdict::Blocked;
        let derived = derive(&field, a, b, Options::default()).unwrap();
        prop_assert_eq!(derived.first_from_a.is_some(), blocked);
        prop_assert_eq!(derived.first_from_b.is_some(), blocked);
        prop_assert_eq!(derived.deepest.is_some(), blocked);
        if let (Some(first), Some(deepest), Some(last)) = (derived.first_from_a, derived.deepest, derived.first_from_b) {
            prop_assert!(first.place.t <= deepest.t && deepest.t <= last.place.t, "{:?}", derived);
            prop_assert!(deepest.clearance < 0.0);
        }
        if let Some(least) = derived.least_clearance {
            prop_assert!(!blocked && least.clearance >= 0.0);
        }
    }

    #[test]
    fn witnesses_lie_below_known_ground((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let witnesses = witnesses(&field, a, b).unwrap();
        prop_assert_eq!(!witnesses.is_empty(), ask(&field, a, b) == Verdict::Blocked);
        for witness in witnesses {
            prop_assert!(witness.depth > 0.0);
            prop_assert!(below_some_triangle(&field, a, b, witness.point), "{:?}", witness);
        }
    }
}

/// Whether the point is strictly below the plane of a finest triangle over which it lies. Looks at all triangles.
fn below_some_triangle(field: &MemoryField, a: [f64; 3], b: [f64; 3], point: LinePoint) -> bool {
    let grid = field.grid();
    let mut posts = Posts::new(field);
    let mut found = false;
    for (j, i) in (0..grid.ny() - 1).flat_map(|j| (0..grid.nx() - 1).map(move |i| (j, i))) {
        let [sw, se, nw, ne] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(di, dj)| Post::new(i + di, j + dj));
        let triangles = match (i + j) % 2 {
            0 => [[se, ne, sw], [nw, sw, ne]],
            _ => [[ne, nw, se], [sw, se, nw]],
        };
        for [apex, e1, e0] in triangles {
            let corners = [apex, e1, e0].map(|p| [f64::from(p.i), f64::from(p.j), posts.at(p).unwrap().z]);
            let over = point.in_triangle(a, b, &Triangle { apex, e0, e1 });
            found |= over && point.height_against_plane(a, b, corners) == Sign::Negative;
        }
    }
    found
}

#[test]
fn a_known_ridge_is_described() {
    // A ridge of height 4 along x = 4 on flat ground; the line at height 2 enters and leaves it half-way up.
    let field = MemoryField::from_fn(9, 5, |i, _| Some(if i == 4 { 4.0 } else { 0.0 })).unwrap();
    let derived = derive(&field, [0.0, 2.0, 2.0], [8.0, 2.0, 2.0], Options::default()).unwrap();
    assert_eq!(derived.first_from_a.unwrap().place, Place { point: [3.5, 2.0, 2.0], t: 0.4375, clearance: 0.0 });
    assert_eq!(derived.first_from_b.unwrap().place, Place { point: [4.5, 2.0, 2.0], t: 0.5625, clearance: 0.0 });
    assert_eq!(derived.deepest.unwrap(), Place { point: [4.0, 2.0, 2.0], t: 0.5, clearance: -2.0 });
    let over = derive(&field, [0.0, 2.0, 5.0], [8.0, 2.0, 5.0], Options::default()).unwrap();
    assert_eq!(over.least_clearance.unwrap(), Place { point: [4.0, 2.0, 5.0], t: 0.5, clearance: 1.0 });
    assert_eq!(over.first_from_a, None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn stretches_cover_the_line_and_agree_with_the_verdict((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let stretches = line_stretches(&field, a, b, Earth::Flat).unwrap();
        covered(&stretches)?;
        let has = |state| stretches.iter().any(|s| s.state == state);
        let expected = match (has(LineState::Below), has(LineState::Unknown)) {
            (true, _) => Verdict::Blocked,
            (_, true) => Verdict::Unknown,
            _ => Verdict::Visible,
        };
        prop_assert_eq!(ask(&field, a, b), expected, "{:?}", stretches);
    }

    #[test]
    fn least_target_heights_are_the_least_that_are_not_blocked((a, b) in line(), heights in heights(), strict: bool) {
        let field = heights.field();
        let options = Options { strict, ..Options::default() };
        let blocked = |z| line_of_sight(&field, a, [b[0], b[1], z], options).unwrap().verdict == Verdict::Blocked;
        if let Some(z) = least_target_height(&field, a, [b[0], b[1]], options).unwrap() {
            prop_assert!(!blocked(z) && blocked(z.next_down()), "{}", z);
        } else if a[..2] != b[..2] && ask(&field, a, a) != Verdict::Blocked {
            // Nothing blocks, or everything does.
            prop_assert!(blocked(f64::MAX) || !blocked(-f64::MAX));
        }
    }

    #[test]
    fn a_flat_sphere_is_flat((a, b) in line(), heights in heights(), strict: bool) {
        let field = heights.field();
        let flat = Options { strict, ..Options::default() };
        let walked = derived::curved_answer(&mut walk::Walk::new(&field, a, b), a, b, flat).unwrap();
        prop_assert_eq!(walked, line_of_sight(&field, a, b, flat).unwrap());
    }
}

/// Whether stretches follow each other from 0 to 1, each in another state than the last.
fn covered<S: PartialEq + std::fmt::Debug>(stretches: &[Stretch<S>]) -> Result<(), TestCaseError> {
    prop_assert_eq!(stretches[0].from, 0.0);
    prop_assert_eq!(stretches[stretches.len() - 1].to, 1.0);
    for pair in stretches.windows(2) {
        prop_assert!(pair[0].to == pair[1].from && pair[0].state != pair[1].state, "{:?}", stretches);
    }
    prop_assert!(stretches.iter().all(|s| s.from <= s.to));
    Ok(())
}
