//! Properties of verdicts on a curved Earth, against the reference in fractions and against geometry.

use proptest::prelude::*;

use super::{
    tests::{Heights, heights, line, through},
    *,
};
use crate::terrain::{MemoryField, SceneScale, synthetic};

/// Curvatures from the real to the absurd, so that bulges meet posts, edges and planes.
fn earth() -> impl Strategy<Value = Earth> {
    let one =
        || prop_oneof![Just(0.0), Just(0.25), Just(0.125), Just(0.1), Just(2.0), Just(1e-9), Just(5e-324), Just(1e200)];
    (one(), one()).prop_map(|(east, north)| Earth::curved(east, north).unwrap())
}

fn curved(field: &MemoryField, a: [f64; 3], b: [f64; 3], earth: Earth) -> Answer {
    line_of_sight(field, a, b, Options { earth, ..Options::default() }).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn curved_answers_are_the_naive_ones((a, b) in line(), heights in heights(), earth in earth(), strict: bool) {
        let (field, options) = (heights.field(), Options { strict, earth, ..Options::default() });
        let expected = naive::line_of_sight(&field, a, b, options).unwrap();
        prop_assert_eq!(line_of_sight(&field, a, b, options).unwrap(), expected);
        prop_assert_eq!(line_of_sight(&field, b, a, options).unwrap(), expected, "reversed");
    }

    #[test]
    fn curved_derived_values_exist_exactly_when_the_verdict_says(
        (a, b) in line(), heights in heights(), earth in earth(), strict: bool,
    ) {
        let (field, options) = (heights.field(), Options { strict, earth, ..Options::default() });
        let answer = line_of_sight(&field, a, b, options).unwrap();
        let derived = derive(&field, a, b, options).unwrap();
        let blocked = answer.verdict == Verdict::Blocked;
        prop_assert_eq!([derived.first_from_a.is_some(), derived.first_from_b.is_some()], [blocked; 2]);
        if let Some(least) = derived.least_clearance {
            prop_assert!(!blocked && least.clearance >= 0.0);
        }
        let stretches = line_stretches(&field, a, b, earth).unwrap();
        let lenient = line_of_sight(&field, a, b, Options { strict: false, ..options }).unwrap().verdict;
        prop_assert_eq!(stretches.iter().any(|s| s.state == LineState::Below), lenient == Verdict::Blocked);
    }

    #[test]
    fn more_curvature_or_higher_ground_never_unblocks(
        (a, b) in line(), heights in heights(), earth in earth(), by in 0.0..3.0_f64, post: usize,
    ) {
        let field = heights.field();
        let before = curved(&field, a, b, earth).verdict;
        prop_assert!(line_of_sight(&field, a, b, Options::default()).unwrap().verdict <= before);
        let mut raised = heights.clone();
        let post = post % raised.rows.len();
        raised.rows[post] = raised.rows[post].map(|z| z + by);
        prop_assert!(before <= curved(&raised.field(), a, b, earth).verdict);
    }

    /// In the limit of no curvature, contact blocks and nothing else changes.
    #[test]
    fn the_least_curvature_turns_contact_into_obstruction((a, _, b) in through(), heights in dyadic()) {
        let field = heights.field();
        let least = f64::from_bits(1);
        let bent = curved(&field, a, b, Earth::curved(least, least).unwrap()).verdict;
        let moves = a[..2] != b[..2];
        let strict = line_of_sight(&field, a, b, Options { strict: moves, ..Options::default() }).unwrap().verdict;
        prop_assert_eq!(bent, strict);
        prop_assert_eq!(curved(&field, a, b, Earth::curved(0.0, 0.0).unwrap()).verdict,
            line_of_sight(&field, a, b, Options::default()).unwrap().verdict);
    }

    /// The lowered line is a parabola; here it touches a plane in one point, inside a face, on an edge or on a post.
    #[test]
    fn a_parabola_that_touches_a_plane_grazes(
        slopes in [-3..4_i32, -3..4_i32], ends in [1..28_i32, 1..28_i32, 1..28_i32, 1..28_i32], s in 1..16_i32,
        curvature in [0..6_i32, 0..6_i32], side in 0..2_usize,
    ) {
        let field = synthetic::plane(8, 8, slopes[0], slopes[1]).unwrap();
        let [ax, ay, bx, by] = ends.map(|v| f64::from(v) / 4.0);
        let [east, north] = curvature.map(|k| if k == 0 { 0.0 } else { 0.5_f64.powi(k) });
        let w = (bx - ax) * (bx - ax) * east + (by - ay) * (by - ay) * north;
        prop_assume!(w > 0.0);
        // All exact: the clearance is w (t - s)^2.
        let s = f64::from(s) / 16.0;
        let ground = |x: f64, y: f64| f64::from(slopes[0]) * x + f64::from(slopes[1]) * y;
        let a = [ax, ay, ground(ax, ay) + w * s * s];
        let b = [bx, by, ground(bx, by) + w * (1.0 - s) * (1.0 - s)];
        let earth = Earth::curved(east, north).unwrap();
        let touching = curved(&field, a, b, earth);
        prop_assert_eq!((touching.verdict, touching.grazes), (Verdict::Visible, true));
        let strict = Options { strict: true, earth, ..Options::default() };
        prop_assert_eq!(line_of_sight(&field, a, b, strict).unwrap().verdict, Verdict::Blocked);
        let obstruction = derive(&field, a, b, strict).unwrap().first_from_a.unwrap();
        prop_assert!((obstruction.place.t - s).abs() < 1e-6, "{:?}", obstruction);
        let shifted = |by: fn(f64) -> f64| {
            let mut ends = [a, b];
            ends[side][2] = by(ends[side][2]);
            curved(&field, ends[0], ends[1], earth)
        };
        let over = shifted(f64::next_up);
        prop_assert_eq!((over.verdict, over.grazes), (Verdict::Visible, false));
        prop_assert_eq!(shifted(f64::next_down).verdict, Verdict::Blocked);
    }

    #[test]
    fn least_target_heights_are_least_on_a_sphere((a, b) in line(), heights in heights(), earth in earth(), strict: bool) {
        let field = heights.field();
        let options = Options { strict, earth, ..Options::default() };
        let blocked = |z| line_of_sight(&field, a, [b[0], b[1], z], options).unwrap().verdict == Verdict::Blocked;
        if let Some(z) = least_target_height(&field, a, [b[0], b[1]], options).unwrap() {
            prop_assert!(!blocked(z) && blocked(z.next_down()), "{}", z);
        }
    }
}

/// Heights that are multiples of a quarter.
pub(super) fn dyadic() -> impl Strategy<Value = Heights> {
    heights().prop_map(|mut heights| {
        heights.rows.iter_mut().flatten().for_each(|z| *z = (*z * 4.0).round() / 4.0);
        heights
    })
}

const SCALE: SceneScale = SceneScale { east_m: 1000.0, north_m: 1000.0, up_m: 1.0 };
const RADIUS_M: f64 = 6_371_008.8;

/// The distance of the horizon from a height: sqrt(2 k R h). Beyond, a target must rise by d^2 / (2 k R).
#[test]
fn the_radio_horizon_is_where_it_should_be() {
    let sea = synthetic::plane(200, 3, 0, 0).unwrap();
    for (k, height_m, expected_km) in [(1.0, 100.0, 35.7), (4.0 / 3.0, 100.0, 41.2), (4.0 / 3.0, 10.0, 13.0)] {
        let earth = Earth::sphere(RADIUS_M, k, SCALE).unwrap();
        let horizon_m = (2.0 * k * RADIUS_M * height_m).sqrt();
        assert!((horizon_m / 1000.0 - expected_km).abs() < 0.1, "{horizon_m}");
        let mast = [0.0, 1.3, height_m];
        let sees = |range_m: f64, z: f64| curved(&sea, mast, [range_m / 1000.0, 1.3, z], earth).verdict;
        assert_eq!(sees(horizon_m * 0.9999, 0.0), Verdict::Visible);
        assert_eq!(sees(horizon_m * 1.0001, 0.0), Verdict::Blocked);
        let options = Options { earth, ..Options::default() };
        for beyond_m in [5_000.0, 60_000.0] {
            let least = least_target_height(&sea, mast, [(horizon_m + beyond_m) / 1000.0, 1.3], options).unwrap();
            let expected = beyond_m * beyond_m / (2.0 * k * RADIUS_M);
            assert!((least.unwrap() - expected).abs() < 1e-3 * expected, "{least:?} {expected}");
        }
        // The dip of the horizon: the tangent to the sphere.
        let seen = horizon(&sea, mast, &[90.0], 150_000.0, SCALE, earth).unwrap()[0];
        let crest = seen.crest.unwrap();
        assert!((crest.tangent + horizon_m / (k * RADIUS_M)).abs() < 1e-7, "{crest:?}");
        assert!((crest.range_m - horizon_m).abs() < 1000.0 && !seen.over_unknown, "{crest:?}");
    }
}

#[test]
fn a_sphere_needs_sensible_numbers() {
    assert!(Earth::sphere(RADIUS_M, f64::INFINITY, SCALE).unwrap().is_flat());
    for (radius, k) in [(0.0, 1.0), (-1.0, 1.0), (f64::NAN, 1.0), (RADIUS_M, 0.0), (RADIUS_M, f64::NAN), (1e-320, 1.0)]
    {
        assert!(matches!(Earth::sphere(radius, k, SCALE), Err(LosError::OutOfBounds { .. })), "{radius} {k}");
    }
    assert!(Earth::curved(-0.1, 0.0).is_err() && Earth::curved(0.0, f64::INFINITY).is_err());
}

#[test]
fn real_curvature_on_rough_ground_agrees_with_the_reference() {
    let field = synthetic::fractal(18, 18, 11, 60).unwrap();
    let earth = Earth::sphere(RADIUS_M, 1.0, SceneScale { east_m: 90.0, north_m: 90.0, up_m: 1.0 }).unwrap();
    let strong = Earth::curved(0.05, 0.03).unwrap();
    let mut blocked = 0;
    for n in 0..150_u64 {
        let [a, b] = super::tests::manufactured(n, 17.0);
        for earth in [earth, strong] {
            let options = Options { earth, ..Options::default() };
            let answer = line_of_sight(&field, a, b, options).unwrap();
            assert_eq!(answer, naive::line_of_sight(&field, a, b, options).unwrap(), "line {n}: {a:?} {b:?}");
            blocked += usize::from(answer.verdict == Verdict::Blocked);
        }
    }
    assert!(blocked > 50 && blocked < 250, "{blocked}");
}
