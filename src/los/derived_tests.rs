//! Properties of what is derived from a line, on lines and grids made to be degenerate.

use num_rational::BigRational;
use num_traits::ToPrimitive;
use proptest::prelude::*;
use sightline_proto::{
    diamond::{Post, Triangle},
    predicates::Sign,
    verdict::{LinePoint, passes_below},
};

use super::{
    tests::{Heights, ask, heights, line, through},
    *,
};
use crate::terrain::{MemoryField, Posts, SceneScale, synthetic};

/// A known edge a unit in the last place from A, between unknown triangles: no slope towards it can be told.
#[test]
fn a_target_height_is_found_where_only_ground_beside_the_observer_blocks() {
    let known = [(4, 0), (3, 1)];
    let field = MemoryField::from_fn(5, 2, |i, j| known.contains(&(i, j)).then_some(0.0)).unwrap();
    let a = [3.0_f64.next_up(), 1.0, 0.0];
    assert_eq!(least_target_height(&field, a, [0.0, -0.513], Options::default()).unwrap(), Some(0.0));
}

/// The way is a single point, and A stands there on an edge of curved ground.
#[test]
fn ground_under_the_observer_is_seen_by_it() {
    let field = MemoryField::from_fn(3, 2, |i, j| Some(if (i, j) == (1, 1) { 2.0 } else { 0.0 })).unwrap();
    for earth in [Earth::Flat, Earth::curved(0.125, 0.0625).unwrap()] {
        let stretches = ground_stretches(&field, [1.5, 0.5, 1.0], [1.5, 0.5], earth).unwrap();
        assert!(stretches.iter().all(|s| s.state == GroundState::Seen), "{earth:?}: {stretches:?}");
    }
}

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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn derived_values_are_near_the_exact_ones((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let exactly = naive::exactly(&field, a, b, Earth::Flat).unwrap();
        let derived = derive(&field, a, b, Options::default()).unwrap();
        let f = |v: &BigRational| v.to_f64().unwrap();
        prop_assert_eq!(derived.first_from_a.is_some(), exactly.first_t.is_some());
        // Where the line goes under at a small angle, t is off by more: by the error of the clearance over the slope.
        let size = a.iter().chain(&b).fold(8.0_f64, |m, v| m.max(v.abs()));
        let bound = 1e-13 * size;
        if let (Some(first), Some(t)) = (derived.first_from_a, &exactly.first_t) {
            let depth = derived.deepest.map_or(0.0, |deepest| -deepest.clearance);
            if depth > 1e-3 && size < 100.0 {
                prop_assert!((first.place.t - f(t)).abs() <= 1e-9, "{:?} {}", first, f(t));
            }
        }
        let least = derived.deepest.or(derived.least_clearance).map(|place| place.clearance);
        prop_assert_eq!(least.is_some(), exactly.least_clearance.is_some());
        if let (Some(least), Some(exact)) = (least, &exactly.least_clearance) {
            prop_assert!((least - f(exact)).abs() <= bound || size > 1e290, "{} {}", least, f(exact));
        }
        if a[..2] != b[..2] && ask(&field, a, a) != Verdict::Blocked {
            // The least f64 that is not below the exact height, if there is one.
            let least = least_target_height(&field, a, [b[0], b[1]], Options::default()).unwrap();
            let fits = |z: f64| BigRational::from_float(z).unwrap() >= *exactly.target_height.as_ref().unwrap();
            match least {
                Some(z) => prop_assert!(fits(z) && !fits(z.next_down()), "{}", z),
                None => prop_assert!(exactly.target_height.is_none() || !fits(f64::MAX) || fits(-f64::MAX)),
            }
        }
    }

    #[test]
    fn curved_clearances_are_near_the_exact_ones((a, _, b) in through(), heights in heights(), north in 0..8_u32) {
        let field = heights.field();
        let earth = Earth::curved(0.25, f64::from(north) / 8.0).unwrap();
        let exact = naive::exactly(&field, a, b, earth).unwrap().least_clearance.map(|v| v.to_f64().unwrap());
        let derived = derive(&field, a, b, Options { earth, ..Options::default() }).unwrap();
        let least = derived.deepest.or(derived.least_clearance).map(|place| place.clearance);
        prop_assert_eq!(least.is_some(), exact.is_some());
        if let (Some(least), Some(exact)) = (least, exact) {
            prop_assert!((least - exact).abs() <= 1e-12, "{} {}", least, exact);
        }
    }

    /// The ground at t is in the state of the line to it.
    #[test]
    fn ground_is_seen_when_the_line_to_it_is_visible(
        (a, _, b) in through(),
        heights in super::earth_tests::dyadic(),
        curved in 0..3_u32,
    ) {
        let field = heights.field();
        let earth = Earth::curved(f64::from(curved) / 8.0, f64::from(curved) / 16.0).unwrap();
        let stretches = ground_stretches(&field, a, [b[0], b[1]], earth).unwrap();
        covered(&stretches)?;
        for k in 0..=64 {
            let t = f64::from(k) / 64.0;
            // Exact, since all are multiples of 1/4 below 2^10; and so is the ground on a dyadic grid.
            let [x, y] = [0, 1].map(|axis| a[axis] + t * (b[axis] - a[axis]));
            let verdict = match on_ground(&field, x, y, 0.0).unwrap() {
                None => Verdict::Unknown,
                Some(z) => {
                let options = Options { earth, ..Options::default() };
                Lines::new(&field).ask(a, [x, y, z], options).unwrap().verdict
            }
            };
            let expected = match verdict {
                Verdict::Visible => GroundState::Seen,
                Verdict::Blocked => GroundState::Hidden,
                Verdict::Unknown => GroundState::Unknown,
            };
            // At a boundary, which may be rounded, either side.
            let mut states = stretches.iter().filter(|s| s.from - 1e-12 <= t && t <= s.to + 1e-12).map(|s| s.state);
            prop_assert!(states.any(|state| state == expected), "{} {:?} {:?}", t, expected, stretches);
        }
    }

    #[test]
    fn the_triangle_entered_lies_above_the_line((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let derived = derive(&field, a, b, Options::default()).unwrap();
        let mut posts = Posts::new(&field);
        for first in [derived.first_from_a, derived.first_from_b].into_iter().flatten() {
            let Some(triangle) = first.triangle else { continue };
            let corners = triangle.map(|p| [f64::from(p.i), f64::from(p.j), posts.at(p).unwrap().z]);
            prop_assert!(triangle.iter().all(|&p| !posts.at(p).unwrap().void));
            prop_assert!(passes_below(a, b, corners, (field.grid().nx(), field.grid().ny())), "{:?}", triangle);
        }
    }

    #[test]
    fn raising_the_terrain_brings_obstructions_nearer((a, b) in line(), heights in heights(), post: usize) {
        let mut raised = heights.clone();
        let post = post % raised.rows.len();
        raised.rows[post] = raised.rows[post].map(|z| z + 1.0);
        let first = |h: &Heights| naive::exactly(&h.field(), a, b, Earth::Flat).unwrap().first_t;
        let least = |h: &Heights| least_target_height(&h.field(), a, [b[0], b[1]], Options::default()).unwrap();
        if let Some(before) = first(&heights) {
            prop_assert!(first(&raised).is_some_and(|after| after <= before));
        }
        if let (Some(before), Some(after)) = (least(&heights), least(&raised)) {
            prop_assert!(after >= before);
        }
        let state = |h: &Heights| derive(&h.field(), a, b, Options::default()).unwrap();
        if let (Some(before), Some(after)) = (state(&heights).deepest, state(&raised).deepest) {
            prop_assert!(after.clearance <= before.clearance + 1e-12 * before.clearance.abs().max(1.0));
        }
    }

    #[test]
    fn profiles_are_the_ground((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let breaks = profile(&field, [a[0], a[1]], [b[0], b[1]], 1000).unwrap();
        let size = a[..2].iter().chain(&b[..2]).fold(8.0_f64, |m, v| m.max(v.abs()));
        // Only the two ends may have a face in common.
        let ends_only = breaks.len() == 2;
        prop_assert!(breaks.windows(2).all(|pair| pair[0].t <= pair[1].t && (ends_only || pair[0].face != pair[1].face)));
        prop_assert!(breaks.last().is_none_or(|last| !last.known_after));
        for at in &breaks {
            let known = at.face.posts().iter().all(|p| heights.rows[(p.j * heights.nx + p.i) as usize].is_some());
            prop_assert_eq!(at.ground.is_some(), known);
            if let (Face::Post([p]), Some(z)) = (at.face, at.ground) {
                prop_assert_eq!(Some(z), heights.rows[(p.j * heights.nx + p.i) as usize]);
            } else if let (Some(z), true) = (at.ground, size < 100.0)
                && let Some(near) = surface_height(&field, at.point[0], at.point[1]).unwrap()
            {
                prop_assert!((z - near).abs() < 1e-12, "{:?} {}", at, near);
            }
        }
        if !breaks.is_empty() {
            let limit = breaks.len() - 1;
            prop_assert_eq!(profile(&field, [a[0], a[1]], [b[0], b[1]], limit), Err(LosError::TooManyBreaks { limit }));
        }
    }

    #[test]
    fn rays_hit_where_their_line_is_obstructed((a, b) in line(), heights in heights()) {
        let field = heights.field();
        let met = ray(&field, a, b, SceneScale::UNIT, Earth::Flat).unwrap();
        let first = derive(&field, a, b, Options::default()).unwrap().first_from_a;
        match met.end {
            RayEnd::Miss => prop_assert!(first.is_none()),
            RayEnd::StartsBelow => prop_assert_eq!(ask(&field, a, a), Verdict::Blocked),
            RayEnd::Hit(hit) => {
                prop_assert_eq!((Some(hit.t), hit.triangle), (first.map(|f| f.place.t), first.and_then(|f| f.triangle)));
                let length = hit.normal.map_or(1.0, |[x, y, z]| x * x + y * y + z * z);
                prop_assert!((length - 1.0).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn directions_are_azimuth_and_elevation() {
    let scale = SceneScale { east_m: 2.0, north_m: 4.0, up_m: 0.5 };
    let end = |azimuth, elevation| ray_end([10.0, 20.0, 3.0], azimuth, elevation, 8.0, scale, Earth::Flat).unwrap();
    assert_eq!(end(0.0, 0.0), [10.0, 22.0, 3.0]);
    assert_eq!(end(90.0, 0.0), [14.0, 20.0, 3.0]);
    assert_eq!(end(-180.0, 0.0), [10.0, 18.0, 3.0]);
    assert_eq!(end(630.0, 0.0), [6.0, 20.0, 3.0]);
    assert_eq!(end(12.0, 90.0), [10.0, 20.0, 19.0]);
    let [x, y, z] = end(30.0, 30.0);
    let cos = 0.75_f64.sqrt();
    for (value, expected) in [(x, 10.0 + 2.0 * cos), (y, 20.0 + 2.0 * cos * cos), (z, 3.0 + 8.0)] {
        assert!((value - expected).abs() < 1e-12, "{value} {expected}");
    }
    let bad = |azimuth, range| ray_end([0.0; 3], azimuth, 0.0, range, scale, Earth::Flat).is_err();
    assert!(bad(f64::NAN, 1.0) && bad(0.0, 0.0) && bad(0.0, -1.0) && bad(0.0, f64::INFINITY));
}

#[test]
fn nothing_rises_above_the_horizon_and_something_reaches_it() {
    let field = synthetic::fractal(64, 64, 4, 60).unwrap();
    let scale = SceneScale { east_m: 30.0, north_m: 30.0, up_m: 1.0 };
    let from = [31.3, 30.1, on_ground(&field, 31.3, 30.1, 2.0).unwrap().unwrap()];
    let azimuths: Vec<f64> = (0..72).map(|n| f64::from(n) * 5.0).collect();
    for seen in horizon(&field, from, &azimuths, 700.0, scale, Earth::Flat).unwrap() {
        let crest = seen.crest.unwrap();
        assert!(!seen.below_ground && !seen.over_unknown);
        let looks = |elevation: f64| {
            let end = ray_end(from, seen.azimuth_deg, elevation, 700.0, scale, Earth::Flat).unwrap();
            ask(&field, from, end)
        };
        assert_eq!(looks(crest.elevation_deg + 1e-6), Verdict::Visible, "{seen:?}");
        assert_eq!(looks(crest.elevation_deg - 1e-3), Verdict::Blocked, "{seen:?}");
        let ground = surface_height(&field, crest.point[0], crest.point[1]).unwrap().unwrap();
        assert!((ground - crest.point[2]).abs() < 1e-9, "{seen:?} {ground}");
    }
    let below = [31.3, 30.1, from[2] - 3.0];
    assert!(horizon(&field, below, &[10.0], 700.0, scale, Earth::Flat).unwrap()[0].below_ground);
}

#[test]
fn normals_are_those_of_the_triangle() {
    let field = synthetic::plane(5, 5, 3, -4).unwrap();
    let scale = SceneScale { east_m: 2.0, north_m: 4.0, up_m: 0.5 };
    // Slopes in metres: 3 * 0.5 / 2 east, -4 * 0.5 / 4 north.
    let length = (0.75_f64 * 0.75 + 0.25 + 1.0).sqrt();
    let points = [[1.0, 1.0], [1.5, 2.0], [2.25, 3.5], [4.0, 4.0], [0.0, 0.0], [4.5, 1.0]];
    let found = ground_batch(&field, scale, &points).unwrap();
    for (&[x, y], found) in points.iter().zip(&found) {
        assert_eq!(*found, ground(&field, scale, x, y).unwrap());
        let Some(found) = found else {
            assert!(x > 4.0);
            continue;
        };
        assert_eq!(found.height, 3.0 * x - 4.0 * y);
        let [east, north, up] = found.normal.unwrap();
        let off = (east * length + 0.75).abs() + (north * length - 0.5).abs() + (up * length - 1.0).abs();
        assert!(off < 1e-14, "{found:?}");
    }
    assert_eq!(found[0].unwrap().triangle.unwrap(), [Post::new(0, 0), Post::new(1, 0), Post::new(1, 1)]);
    let lone = MemoryField::from_fn(3, 3, |i, j| (i == 1 && j == 1).then_some(7.0)).unwrap();
    let lone = ground(&lone, scale, 1.0, 1.0).unwrap().unwrap();
    assert_eq!((lone.height, lone.triangle, lone.normal), (7.0, None, None));
}

/// What is passed over changes nothing: the same with every crossing looked at.
#[test]
fn passing_over_stretches_changes_no_derived_value() {
    let rough = synthetic::fractal(300, 270, 5, 60).unwrap();
    let holed = MemoryField::from_fn(300, 270, |i, j| {
        let void = synthetic::mix(u64::from(i / 3 * 1000 + j / 2)).is_multiple_of(900);
        (!void).then(|| f64::from(synthetic::fractal_height(i, j, 5, 60)))
    })
    .unwrap();
    let lakes = MemoryField::from_fn(300, 270, |i, j| Some(f64::from(synthetic::fractal_height(i, j, 9, 60).max(3))));
    let curved = Earth::curved(3e-3, 2e-3).unwrap();
    for field in [rough, holed, lakes.unwrap()] {
        for n in 0..240 {
            let [a, b] = super::tests::manufactured(n, 269.0);
            let (mut plain, mut passing) = (walk::Walk::new(&field, a, b), walk::Walk::new(&field, a, b));
            plain.manner.plain = true;
            let mut walks = [&mut plain, &mut passing];
            for earth in [Earth::Flat, curved] {
                let options = Options { earth, strict: n.is_multiple_of(3), ..Options::default() };
                let line = earth::Line::new(a, b, earth);
                let level = earth::Line::new(a, [b[0], b[1], a[2]], earth);
                let derived = walks.each_mut().map(|walk| derived::derive_on(walk, a, b, options).unwrap());
                assert_eq!(derived[0], derived[1], "line {n}: {a:?} {b:?} {earth:?}");
                let stretches = walks.each_mut().map(|w| derived::stretches::line_stretches_on(w, line).unwrap());
                assert_eq!(stretches[0], stretches[1], "line {n}: {a:?} {b:?} {earth:?}");
                let views = walks.each_mut().map(|walk| derived::crest::view(walk, level).unwrap());
                assert_eq!(views[0], views[1], "line {n}: {a:?} {b:?} {earth:?}");
                let ground = walks.each_mut().map(|w| derived::stretches::ground_stretches_on(w, level).unwrap());
                assert_eq!(ground[0], ground[1], "line {n}: {a:?} {b:?} {earth:?}");
                if earth.is_flat() {
                    let found = walks.each_mut().map(|walk| derived::witness::witnesses_on(walk, a, b).unwrap());
                    assert_eq!(found[0], found[1], "line {n}: {a:?} {b:?}");
                }
            }
        }
    }
}
