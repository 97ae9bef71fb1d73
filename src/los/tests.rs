//! Properties of the verdict, most of them against the naive reference, on lines and grids made to be degenerate.

use std::cell::Cell;

use proptest::prelude::*;
use sightline_proto::predicates::{Exact, Kernel, Sign};

use super::*;
use crate::terrain::{MemoryField, synthetic};

/// Heights by row, `None` for void.
#[derive(Clone, Debug)]
pub(super) struct Heights {
    pub(super) nx: u32,
    pub(super) rows: Vec<Option<f64>>,
}

impl Heights {
    pub(super) fn ny(&self) -> u32 {
        self.rows.len() as u32 / self.nx
    }

    pub(super) fn field(&self) -> MemoryField {
        MemoryField::from_fn(self.nx, self.ny(), |i, j| self.rows[(j * self.nx + i) as usize]).unwrap()
    }
}

/// Small grids of small heights, so that points often meet planes; some with voids.
pub(super) fn heights() -> impl Strategy<Value = Heights> {
    let void_share = prop_oneof![2 => Just(0_u32), 1 => Just(2), 1 => Just(6)];
    (2..8_u32, 2..8_u32, void_share).prop_flat_map(|(nx, ny, voids)| {
        let height = prop_oneof![(-2..3_i32).prop_map(f64::from), Just(0.5), Just(0.1)];
        let post = (0..12_u32, height).prop_map(move |(n, z)| (n >= voids).then_some(z));
        proptest::collection::vec(post, (nx * ny) as usize).prop_map(move |rows| Heights { nx, rows })
    })
}

/// A plan coordinate on, between, just beside or far outside the posts.
fn coordinate() -> impl Strategy<Value = f64> {
    let whole = || (-1..9_i32).prop_map(f64::from);
    prop_oneof![
        6 => whole(),
        3 => whole().prop_map(|v| v + 0.5),
        1 => whole().prop_map(|v| v + 0.25),
        1 => whole().prop_map(f64::next_up),
        1 => whole().prop_map(f64::next_down),
        4 => -1.0..9.0_f64,
        1 => prop_oneof![Just(1e300), Just(-1e300), Just(5e-324), Just(-0.0), Just(1e9), Just(-4e6), Just(1e17)],
    ]
}

fn altitude() -> impl Strategy<Value = f64> {
    let whole = || (-3..4_i32).prop_map(f64::from);
    prop_oneof![
        6 => whole(),
        2 => whole().prop_map(|v| v / 4.0),
        1 => whole().prop_map(f64::next_up),
        1 => whole().prop_map(f64::next_down),
        3 => -3.0..3.0_f64,
        1 => prop_oneof![Just(5e-324), Just(1e300), Just(0.1)],
    ]
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    [coordinate().boxed(), coordinate().boxed(), altitude().boxed()]
}

/// A point M and the ends M - s d and M + t d: all exact, since the numbers have few bits.
pub(super) fn through() -> impl Strategy<Value = ([f64; 3], [f64; 3], [f64; 3])> {
    let small = |range: std::ops::Range<i32>| range.prop_map(|v| f64::from(v) / 2.0);
    let middle = [small(0..15).boxed(), small(0..15).boxed(), small(-4..5).boxed()];
    let direction = [-3..4_i32, -3..4_i32, -3..4_i32];
    (middle, direction, 0..5_i32, 0..5_i32).prop_map(|(m, d, s, t)| {
        let at = |n: i32| [0, 1, 2].map(|k| m[k] + f64::from(n * d[k]) / 4.0);
        (at(-s * 4), m, at(t * 3))
    })
}

pub(super) fn line() -> impl Strategy<Value = ([f64; 3], [f64; 3])> {
    prop_oneof![2 => (point(), point()), 2 => through().prop_map(|(a, _, b)| (a, b))]
}

pub(super) fn ask(field: &MemoryField, a: [f64; 3], b: [f64; 3]) -> Verdict {
    line_of_sight(field, a, b, Options::default()).unwrap().verdict
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn answers_are_the_naive_ones((a, b) in line(), heights in heights(), strict: bool) {
        let (field, options) = (heights.field(), Options { strict, ..Options::default() });
        let expected = naive::line_of_sight(&field, a, b, options).unwrap();
        prop_assert_eq!(line_of_sight(&field, a, b, options).unwrap(), expected);
        prop_assert_eq!(line_of_sight(&field, b, a, options).unwrap(), expected, "reversed");
        let mut plain = Lines::plain(&field);
        prop_assert_eq!(plain.ask(a, b, options).unwrap(), expected, "plain");
        prop_assert_eq!(plain.ask(b, a, options).unwrap(), expected, "plain, reversed");
    }

    #[test]
    fn parts_make_the_whole((a, m, b) in through(), heights in heights()) {
        let field = heights.field();
        prop_assert_eq!(ask(&field, a, b), ask(&field, a, m).max(ask(&field, m, b)));
    }

    #[test]
    fn raising_the_terrain_never_unblocks((a, b) in line(), heights in heights(), post: usize, by in 0.0..3.0_f64) {
        let mut raised = heights.clone();
        let post = post % raised.rows.len();
        raised.rows[post] = raised.rows[post].map(|z| z + by);
        let (before, after) = (ask(&heights.field(), a, b), ask(&raised.field(), a, b));
        prop_assert!(before <= after, "{:?} became {:?}", before, after);
    }

    #[test]
    fn heights_above_ground_are_least((x, y) in (0.0..7.0_f64, 0.0..7.0_f64), height in 0.0..3.0_f64,
                                      heights in heights()) {
        let field = heights.field();
        let resolved = on_ground(&field, x, y, 0.0).unwrap();
        let stands = |z: f64| ask(&field, [x, y, z], [x, y, z]);
        match resolved {
            None => prop_assert_eq!(stands(0.0), Verdict::Unknown),
            Some(z) => {
                prop_assert_eq!(stands(z), Verdict::Visible);
                prop_assert_eq!(stands(z.next_down()), Verdict::Blocked);
                let ground = surface_height(&field, x, y).unwrap().unwrap();
                prop_assert!((z - ground).abs() <= 2.0 * f64::EPSILON * ground.abs().max(1e-300));
                let above = on_ground(&field, x, y, height).unwrap().unwrap();
                prop_assert!((above - ground - height).abs() <= 8.0 * f64::EPSILON);
            }
        }
    }
}

thread_local! {
    static SETTLED: Cell<u64> = const { Cell::new(0) };
    static UNSETTLED: Cell<u64> = const { Cell::new(0) };
}

/// The exact kernel, counting.
struct Counting;

impl Kernel for Counting {
    fn settled() {
        SETTLED.set(SETTLED.get() + 1);
    }

    fn unsettled(estimate: Sign, exact: impl FnOnce() -> Sign) -> Sign {
        UNSETTLED.set(UNSETTLED.get() + 1);
        Exact::unsettled(estimate, exact)
    }
}

#[test]
fn the_filter_settles_ordinary_predicates() {
    let field = synthetic::fractal(257, 257, 7, 800).unwrap();
    let at = |n: u64| {
        let unit = |k: u64| (synthetic::mix(n * 4 + k) >> 11) as f64 / (1_u64 << 53) as f64;
        let (x, y) = (256.0 * unit(0), 256.0 * unit(1));
        [x, y, on_ground(&field, x, y, 2.0 + 200.0 * unit(2)).unwrap().unwrap()]
    };
    for n in 0..2000 {
        line_of_sight_with::<Counting, _>(&field, at(2 * n), at(2 * n + 1), Options::default()).unwrap();
    }
    let (settled, unsettled) = (SETTLED.get(), UNSETTLED.get());
    println!("{settled} settled, {unsettled} not");
    assert!(settled > 50_000 && unsettled * 1000 <= settled, "{settled} settled, {unsettled} not");
}

#[test]
fn lines_over_pages_and_far_beyond_the_grid_are_the_naive_ones() {
    let field = synthetic::fractal(150, 131, 3, 60).unwrap();
    let voids = MemoryField::from_fn(150, 131, |i, j| {
        (!synthetic::mix(u64::from(i * 1000 + j)).is_multiple_of(50))
            .then(|| f64::from(synthetic::fractal_height(i, j, 3, 60)))
    })
    .unwrap();
    for seed in 0..150_u64 {
        let number = |k: u64, low: f64, high: f64| {
            low + (high - low) * (synthetic::mix(seed * 16 + k) >> 11) as f64 / (1_u64 << 53) as f64
        };
        let reach = [150.0, 150.0, 1e6, 1e18][seed as usize % 4];
        let round = |v: f64| if seed % 3 == 0 { v.round() } else { v };
        let end = |k| [round(number(k, -2.0, reach)), round(number(k + 1, -2.0, 140.0)), number(k + 2, 0.0, 60.0)];
        let (a, b) = (end(0), end(4));
        for field in [&field, &voids] {
            let expected = naive::line_of_sight(field, a, b, Options::default()).unwrap();
            assert_eq!(line_of_sight(field, a, b, Options::default()).unwrap(), expected, "{seed}: {a:?} {b:?}");
            let plain = Lines::plain(field).ask(a, b, Options::default()).unwrap();
            assert_eq!(plain, expected, "plain, {seed}: {a:?} {b:?}");
        }
    }
}

/// A line over a terrain, of a kind that the number picks: any, whole ends, level on a lake, along a diagonal, in the
/// plane of two triangles, an ulp beside each; from just above the ground to well above all of it.
pub(super) fn manufactured(n: u64, size: f64) -> [[f64; 3]; 2] {
    let unit = |k: u64| (synthetic::mix(n * 16 + k) >> 11) as f64 / (1_u64 << 53) as f64;
    let mut ends = [0, 4].map(|k| [size * unit(k), size * unit(k + 1), -40.0 + 90.0 * unit(k + 2)]);
    if n.is_multiple_of(2) {
        ends = ends.map(|p| p.map(f64::round));
    }
    match n / 2 % 6 {
        0 => ends[1][2] = ends[0][2],
        1 => ends[1][1] = ends[0][1] + (ends[1][0] - ends[0][0]),
        2 => ends[1][0] = ends[0][0],
        3 => ends[1][0] = ends[0][0].next_up(),
        4 => ends = ends.map(|[x, y, z]| [x, y, z.floor().next_down()]),
        _ => {}
    }
    ends
}

#[test]
fn skipping_changes_no_answer() {
    let rough = synthetic::fractal(300, 270, 5, 60).unwrap();
    let holed = MemoryField::from_fn(300, 270, |i, j| {
        let void = synthetic::mix(u64::from(i / 3 * 1000 + j / 2)).is_multiple_of(300);
        (!void).then(|| f64::from(synthetic::fractal_height(i, j, 5, 60)))
    })
    .unwrap();
    let lakes = MemoryField::from_fn(300, 270, |i, j| Some(f64::from(synthetic::fractal_height(i, j, 9, 60).max(3))));
    let spikes = MemoryField::from_fn(300, 270, |i, j| Some(if (i * 31 + j * 17) % 997 == 0 { 30.0 } else { -30.0 }));
    let mut counts = [0; 3];
    for field in [rough, holed, lakes.unwrap(), spikes.unwrap()] {
        let mut walked = Lines::plain(&field);
        let mut skipping = Lines::new(&field);
        for n in 0..6000 {
            let [a, b] = manufactured(n, 300.0);
            let options = Options { strict: n.is_multiple_of(5), ..Options::default() };
            let expected = walked.ask(a, b, options).unwrap();
            assert_eq!(skipping.ask(a, b, options).unwrap(), expected, "line {n}: {a:?} {b:?}");
            counts[expected.verdict as usize] += 1;
        }
    }
    assert!(counts.iter().all(|&count| count > 500), "{counts:?}");
}

#[test]
fn what_stands_just_beyond_a_block_is_seen() {
    // Spikes along the first row of each page: the last cells of the blocks before have them as corners.
    let spike = |along: u32, across: u32| Some(if across.is_multiple_of(64) && along % 8 == 4 { 9.0 } else { 0.0 });
    let fields =
        [MemoryField::from_fn(260, 260, spike).unwrap(), MemoryField::from_fn(260, 260, |i, j| spike(j, i)).unwrap()];
    let mut lines = fields.each_ref().map(|field| (Lines::plain(field), Lines::new(field)));
    let mut blocked = 0;
    for n in 0..4000 {
        let unit = |k: u64| (synthetic::mix(n * 8 + k) >> 11) as f64 / (1_u64 << 53) as f64;
        // Along the cells before a border, within the width of a page.
        let row = 64.0 * (1.0 + (3.0 * unit(0)).floor()) - 0.9 * unit(1);
        let from = 64.0 * (4.0 * unit(2)).floor() + 2.0 + 10.0 * unit(3);
        let to = from + 20.0 + 25.0 * unit(4);
        let z = 1.0 + 7.0 * unit(5);
        let (plain, skipping) = &mut lines[n as usize % 2];
        let turn = |p: [f64; 3]| if n.is_multiple_of(2) { p } else { [p[1], p[0], p[2]] };
        let (a, b) = (turn([from, row, z]), turn([to, row - 0.05 * unit(6), z]));
        let expected = plain.ask(a, b, Options::default()).unwrap();
        assert_eq!(skipping.ask(a, b, Options::default()).unwrap(), expected, "line {n}: {a:?} {b:?}");
        blocked += usize::from(expected.verdict == Verdict::Blocked);
    }
    assert!(blocked > 400 && blocked < 3600, "{blocked} blocked");
}

#[test]
fn tolerant_answers_are_between_those_of_raised_and_lowered_terrain() {
    let height = |i, j| (i + j * 7 != 300).then(|| f64::from(synthetic::fractal_height(i, j, 5, 60)));
    let shifted = |by: f64| MemoryField::from_fn(150, 150, |i, j| height(i, j).map(|z| z + by)).unwrap();
    let field = shifted(0.0);
    for h in [0.0, 0.5, 4.0, 30.0] {
        let (raised, lowered) = (shifted(h), shifted(-h));
        let options = Options { precision: Precision::Tolerance(h), ..Options::default() };
        let (mut uncertain, mut differ) = (0, 0);
        for n in 0..3000 {
            let [a, b] = manufactured(n, 150.0);
            let answer = Lines::new(&field).ask(a, b, options).unwrap();
            let (low, high) = (ask(&lowered, a, b), ask(&raised, a, b));
            assert!(low <= answer.verdict && answer.verdict <= high, "{h}, line {n}: {a:?} {b:?} {answer:?}");
            let exact = line_of_sight(&field, a, b, Options::default()).unwrap();
            assert!(!answer.certain || answer == exact, "{h}, line {n}: {a:?} {b:?} {answer:?}");
            uncertain += usize::from(!answer.certain);
            differ += usize::from(answer.verdict != exact.verdict);
        }
        println!("tolerance {h}: {uncertain} of 3000 within it, {differ} unlike the exact ones");
        assert_eq!(h > 0.0, uncertain > 0, "{uncertain} answers within {h}");
    }
    for bad in [-1.0, f64::NAN] {
        let options = Options { precision: Precision::Tolerance(bad), ..Options::default() };
        assert!(matches!(line_of_sight(&field, [1.0; 3], [2.0; 3], options), Err(LosError::BadTolerance(_))));
    }
}

#[test]
fn fast_answers_are_seldom_wrong_and_never_certain() {
    let field = synthetic::fractal(300, 270, 5, 60).unwrap();
    for (precision, at_most) in [(Precision::F64, 60), (Precision::Fast, 300)] {
        let options = Options { precision, ..Options::default() };
        let mut wrong = 0;
        for n in 0..6000 {
            let [a, b] = manufactured(n, 268.0);
            let answer = Lines::new(&field).ask(a, b, options).unwrap();
            assert!(!answer.certain);
            wrong += usize::from(answer.verdict != ask(&field, a, b));
        }
        println!("{precision}: {wrong} of 6000 wrong");
        assert!(wrong <= at_most, "{precision}: {wrong} of 6000 wrong");
    }
}

#[test]
fn batches_keep_the_order() {
    let field = synthetic::fractal(40, 40, 1, 30).unwrap();
    let lines: Vec<_> = (0..500_u64)
        .map(|n| {
            let at = |k| (synthetic::mix(n * 8 + k) % 39) as f64;
            [[at(0), at(1), at(2)], [at(3), at(4), at(5)]]
        })
        .collect();
    let alone: Vec<_> = lines.iter().map(|&[a, b]| line_of_sight(&field, a, b, Options::default()).unwrap()).collect();
    assert_eq!(line_of_sight_batch(&field, &lines, Options::default()).unwrap(), alone);
    assert_eq!(line_of_sight_batch(&field, &[], Options::default()).unwrap(), []);
}

/// Large batches over several pages are asked in another order than they came in.
#[test]
fn sorted_batches_keep_the_order_and_name_the_first_error_in_it() {
    let field = synthetic::fractal(300, 200, 1, 60).unwrap();
    let mut lines: Vec<_> = (0..3_000_u64)
        .map(|n| {
            let at = |k, below: u64| (synthetic::mix(n * 8 + k) % below) as f64;
            [[at(0, 299), at(1, 199), at(2, 90)], [at(3, 299), at(4, 199), at(5, 90)]]
        })
        .collect();
    let order = batch_order(field.grid(), &lines);
    assert!(order.windows(2).filter(|pair| pair[0] > pair[1]).count() > 10, "it is sorted");
    let options = Options::default();
    let alone: Vec<_> = lines.iter().map(|&[a, b]| line_of_sight(&field, a, b, options).unwrap()).collect();
    assert_eq!(line_of_sight_batch(&field, &lines, options).unwrap(), alone);
    // In the north-east, so asked late, and where numbers that are not end up, early.
    lines[1_500] = [[290.0, 190.0, 1.0], [280.0, 180.0, f64::INFINITY]];
    (lines[2_900][0][0], lines[1_600][1][1]) = (f64::NAN, f64::NAN);
    let order = batch_order(field.grid(), &lines);
    let place = |n: u32| order.iter().position(|&asked| asked == n);
    assert!(place(2_900) < place(1_500), "the first error is not the first to be met");
    match line_of_sight_batch(&field, &lines, options) {
        Err(LosError::NotFinite { what: "bz", value }) => assert_eq!(value, f64::INFINITY),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_is_not_finite_is_refused() {
    let field = synthetic::plane(4, 4, 0, 0).unwrap();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for k in 0..3 {
            let mut a = [1.0; 3];
            a[k] = bad;
            let refused = |r: Result<Answer, LosError>| matches!(r, Err(LosError::NotFinite { .. }));
            assert!(refused(line_of_sight(&field, a, [1.0; 3], Options::default())));
            assert!(refused(line_of_sight(&field, [1.0; 3], a, Options::default())));
            assert!(refused(naive::line_of_sight(&field, a, [1.0; 3], Options::default())));
            assert!(
                witnesses(&field, a, [1.0; 3]).is_err() && derive(&field, a, [1.0; 3], Options::default()).is_err()
            );
        }
        assert!(on_ground(&field, bad, 1.0, 1.0).is_err() && on_ground(&field, 1.0, 1.0, bad).is_err());
    }
    let one_beyond = on_ground(&synthetic::plane(4, 4, 1, 0).unwrap(), 1.0, 1.0, f64::MAX);
    assert!(matches!(one_beyond, Err(LosError::OutOfRange { .. })), "{one_beyond:?}");
}
