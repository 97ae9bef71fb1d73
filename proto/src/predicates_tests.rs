//! The predicates against rational arithmetic, rung against rung, and their algebra.

use std::cell::Cell;

use num_rational::BigRational;
use num_traits::Signed;
use proptest::prelude::*;

use crate::predicates::{
    Exact, ExactOnly, FilterOnly, Kernel, Sign, compare, dyadic_orient2d, dyadic_orient3d, height_of_crossing,
    orient2d, orient2d_with, orient3d, orient3d_with, plan, rounded_orient2d, rounded_orient3d, side_of_crossing,
    whole_orient2d, whole_orient3d,
};

/// Numbers that meet: small integers, their neighbours, and the ends of the range.
fn awkward() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => (-4..5_i32).prop_map(f64::from),
        2 => (-4..5_i32).prop_map(|v| f64::from(v).next_up()),
        1 => (-4..5_i32).prop_map(|v| f64::from(v) * 5e-324),
        1 => (-4..5_i32).prop_map(|v| f64::from(v) * 1e300),
        1 => (-4..5_i32).prop_map(|v| f64::from(v) * 0.1),
        1 => any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |v| v.is_finite()),
    ]
}

fn rational(v: f64) -> BigRational {
    BigRational::from_float(v).unwrap()
}

fn sign(v: &BigRational) -> Sign {
    match (v.is_positive(), v.is_negative()) {
        (true, _) => Sign::Positive,
        (_, true) => Sign::Negative,
        _ => Sign::Zero,
    }
}

/// The determinant of three rows, by the rule of Sarrus.
fn determinant([a, b, c]: [[BigRational; 3]; 3]) -> BigRational {
    let term = |i: usize, j: usize, k: usize| &a[i] * &b[j] * &c[k];
    term(0, 1, 2) + term(1, 2, 0) + term(2, 0, 1) - term(2, 1, 0) - term(0, 2, 1) - term(1, 0, 2)
}

fn from_to(p: [f64; 3], q: [f64; 3]) -> [BigRational; 3] {
    [0, 1, 2].map(|k| rational(q[k]) - rational(p[k]))
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    [awkward(), awkward(), awkward()]
}

proptest! {
    #[test]
    fn orientations_are_those_of_rational_arithmetic(a in point(), b in point(), c in point(), d in point()) {
        let turn = |p: [f64; 3], q: [f64; 3], r: [f64; 3]| {
            let (u, v) = (from_to(p, q), from_to(p, r));
            sign(&(&u[0] * &v[1] - &u[1] * &v[0]))
        };
        prop_assert_eq!(orient2d(plan(a), plan(b), plan(c)), turn(a, b, c));
        let volume = sign(&determinant([from_to(a, b), from_to(a, c), from_to(a, d)]));
        prop_assert_eq!(orient3d(a, b, c, d), volume);
        prop_assert_eq!(orient3d(b, a, c, d), -volume);
    }

    #[test]
    fn crossings_are_those_of_rational_arithmetic(
        a in point(), b in point(), p in point(), q in point(), t in [point(), point(), point()],
    ) {
        let (ga, gb) = (orient2d(plan(p), plan(q), plan(a)), orient2d(plan(p), plan(q), plan(b)));
        prop_assume!(ga != gb);
        let side = |u: [f64; 3], v: [f64; 3], x: &[BigRational; 3]| {
            let e = from_to(u, v);
            &e[0] * (&x[1] - rational(u[1])) - &e[1] * (&x[0] - rational(u[0]))
        };
        let (ra, rb) = (a.map(rational), b.map(rational));
        let (sa, sb) = (side(p, q, &ra), side(p, q, &rb));
        let weight = &sa / (&sa - &sb);
        let x = [0, 1, 2].map(|k| &ra[k] + &weight * (&rb[k] - &ra[k]));
        prop_assert_eq!(
            side_of_crossing::<Exact>([plan(a), plan(b)], [plan(p), plan(q)], [plan(t[0]), plan(t[1])]),
            sign(&side(t[0], t[1], &x))
        );
        let up = [0, 1, 2].map(|k| &x[k] - rational(t[0][k]));
        prop_assert_eq!(
            height_of_crossing::<Exact>([a, b], [plan(p), plan(q)], t),
            sign(&determinant([from_to(t[0], t[1]), from_to(t[0], t[2]), up]))
        );
    }
}

proptest! {
    /// Points rounded onto a line or plane: rounded determinants of these are often of the wrong sign.
    #[test]
    fn almost_ties_are_decided_as_rational_arithmetic_does(
        a in [-9.0..9.0_f64, -9.0..9.0, -9.0..9.0],
        b in [-9.0..9.0_f64, -9.0..9.0, -9.0..9.0],
        c in [-9.0..9.0_f64, -9.0..9.0, -9.0..9.0],
        (s, t) in (-1.0..2.0_f64, -1.0..2.0_f64),
    ) {
        let on_line = [0, 1, 2].map(|k| a[k] + s * (b[k] - a[k]));
        let in_plane = [0, 1, 2].map(|k| on_line[k] + t * (c[k] - a[k]));
        let (u, v) = (from_to(a, b), from_to(a, on_line));
        prop_assert_eq!(orient2d(plan(a), plan(b), plan(on_line)), sign(&(&u[0] * &v[1] - &u[1] * &v[0])));
        let volume = sign(&determinant([from_to(a, b), from_to(a, c), from_to(a, in_plane)]));
        prop_assert_eq!(orient3d(a, b, c, in_plane), volume);
    }
}

#[test]
fn neighbours_of_a_tie_are_told_apart() {
    let (a, b) = ([0.1, 0.1], [0.3, 0.3]);
    assert_eq!(orient2d(a, b, [0.2, 0.2]), Sign::Zero);
    assert_eq!(orient2d(a, b, [0.2, 0.2_f64.next_up()]), Sign::Positive);
    assert_eq!(orient2d(a, b, [0.2, 0.2_f64.next_down()]), Sign::Negative);
    assert_eq!(orient2d_with::<FilterOnly>([0.0, 0.0], [1e-200, 1e-200], [1e-200, 2e-200]), Sign::Zero);
    assert_eq!(orient2d([0.0, 0.0], [1e-200, 1e-200], [1e-200, 2e-200]), Sign::Positive);
}

thread_local! {
    /// Signs that a filter settled, and signs that were left to exact arithmetic.
    static COUNTS: Cell<[u32; 2]> = const { Cell::new([0; 2]) };
}

struct Counting;

impl Kernel for Counting {
    fn settled() {
        COUNTS.set([COUNTS.get()[0] + 1, COUNTS.get()[1]]);
    }

    fn unsettled(_estimate: Sign, exact: impl FnOnce() -> Sign) -> Sign {
        COUNTS.set([COUNTS.get()[0], COUNTS.get()[1] + 1]);
        exact()
    }
}

/// The rung that answers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Rung {
    Filter,
    Whole,
    Dyadic,
}

fn rung(ask: impl FnOnce() -> Sign, whole: Option<Sign>) -> (Rung, Sign) {
    COUNTS.set([0; 2]);
    let sign = ask();
    let rung = match (COUNTS.get(), whole) {
        ([1, 0], _) => Rung::Filter,
        ([0, 1], Some(_)) => Rung::Whole,
        ([0, 1], None) => Rung::Dyadic,
        (counts, _) => panic!("{counts:?} signs were asked for"),
    };
    (rung, sign)
}

fn rung2(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> (Rung, Sign) {
    rung(|| orient2d_with::<Counting>(a, b, c), whole_orient2d(a, b, c))
}

fn rung3(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> (Rung, Sign) {
    rung(|| orient3d_with::<Counting>(a, b, c, d), whole_orient3d(a, b, c, d))
}

#[test]
fn each_rung_answers_what_it_is_for() {
    use Rung::{Dyadic, Filter, Whole};
    use Sign::{Negative, Positive, Zero};
    let o = [0.0, 0.0];
    let tiny = 5e-324;
    for (name, [a, b, c], expected) in [
        ("a clear turn", [o, [3.0, 1.0], [1.0, 2.0]], (Filter, Positive)),
        ("a clear turn with one subnormal coordinate", [o, [3.0, tiny], [1.0, 2.0]], (Filter, Positive)),
        ("three posts in a row", [o, [2.0, 1.0], [4.0, 2.0]], (Whole, Zero)),
        ("points that coincide", [[0.1, 0.7], [0.1, 0.7], [0.3, 0.2]], (Whole, Zero)),
        ("zeros of both signs", [o, [-0.0, 0.0], [0.0, -0.0]], (Whole, Zero)),
        (
            "subnormals, which are whole multiples of the least",
            [o, [tiny, tiny], [tiny, 2.0 * tiny]],
            (Whole, Positive),
        ),
        ("products that underflow", [o, [1e-200, 1e-200], [1e-200, 2e-200]], (Whole, Positive)),
        (
            "one unit in the last place beside a tie",
            [[0.1; 2], [0.3; 2], [0.2, 0.2_f64.next_down()]],
            (Whole, Negative),
        ),
        ("a tie of long and short numbers", [o, [1e-30, 1e-30], [3.0, 3.0]], (Dyadic, Zero)),
        ("beside it", [o, [1e-30, 1e-30_f64.next_up()], [3.0, 3.0]], (Dyadic, Negative)),
        ("products beyond 2^511", [o, [1e160, 1.0], [2e160, 2.0]], (Dyadic, Zero)),
        ("products that overflow", [o, [1e300, 1.0], [1e300, 1e300]], (Dyadic, Positive)),
        ("differences that overflow", [[-f64::MAX, 0.0], [f64::MAX, 0.0], [0.0, tiny]], (Dyadic, Positive)),
        ("the least beside the greatest", [[-tiny, 0.0], [f64::MAX, 0.0], [0.0, -tiny]], (Dyadic, Negative)),
    ] {
        assert_eq!(rung2(a, b, c), expected, "{name}");
        assert_eq!(rung2(b, a, c).1, -expected.1, "{name}, exchanged");
    }
    let flat = [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
    let slope = [[0.0, 0.0, 0.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
    for (name, [a, b, c], d, expected) in [
        ("clearly above", flat, [1.0, 1.0, 3.0], (Filter, Positive)),
        ("on a lake", flat, [1.5, 1.25, 1.0], (Whole, Zero)),
        ("on a slope", slope, [1.0, 1.0, 0.5], (Whole, Zero)),
        ("one unit in the last place above it", slope, [1.0, 1.0, 0.5_f64.next_up()], (Dyadic, Positive)),
        ("1e-13 below it", flat, [1.0, 1.0, 1.0 - 1e-13], (Filter, Negative)),
        ("subnormal heights", flat.map(|[x, y, _]| [x, y, tiny]), [1.0, 1.0, 2.0 * tiny], (Whole, Positive)),
        (
            "cliffs beyond the range",
            [[0.0, 0.0, -f64::MAX], [4.0, 0.0, f64::MAX], [0.0, 4.0, 0.0]],
            [1.0, 1.0, 0.0],
            (Dyadic, Positive),
        ),
        (
            "a volume beyond 2^511",
            flat.map(|[x, y, z]| [x * 1e180, y * 1e180, z]),
            [1e180, 1e180, 2.0],
            (Dyadic, Positive),
        ),
    ] {
        assert_eq!(rung3(a, b, c, d), expected, "{name}");
        assert_eq!(rung3(b, a, c, d).1, -expected.1, "{name}, exchanged");
    }
}

/// Points that are often short, often almost in one plane, and sometimes extreme.
fn quadruple() -> impl Strategy<Value = [[f64; 3]; 4]> {
    let almost =
        ([point(), point(), point()], (-4..9_i32, -4..9_i32), 0..3_u32).prop_map(|([a, b, c], (s, t), off)| {
            let [s, t] = [s, t].map(|v| f64::from(v) / 4.0);
            let d = [0, 1, 2].map(|k| a[k] + s * (b[k] - a[k]) + t * (c[k] - a[k]));
            let d = [d[0], d[1], [d[2], d[2].next_up(), d[2].next_down()][off as usize]];
            // What overflowed on the way is not a number to ask with.
            [a, b, c, if d.iter().all(|v| v.is_finite()) { d } else { [1.0; 3] }]
        });
    prop_oneof![[point(), point(), point(), point()], almost]
}

fn move_by(p: [f64; 3], by: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| p[k] + by[k])
}

proptest! {
    #[test]
    fn each_rung_agrees_with_the_next([a, b, c, d] in quadruple()) {
        let settled = |(value, bound): (f64, f64)| {
            if value > bound { Some(Sign::Positive) } else { (value < -bound).then_some(Sign::Negative) }
        };
        let ([a2, b2, c2], exact2) = ([a, b, c].map(plan), dyadic_orient2d(plan(a), plan(b), plan(c)));
        for (rung, sign) in [("filter", settled(rounded_orient2d(a2, b2, c2))), ("whole", whole_orient2d(a2, b2, c2))] {
            prop_assert!(sign.is_none_or(|sign| sign == exact2), "orient2d, {rung}: {sign:?}, not {exact2:?}");
        }
        let exact3 = dyadic_orient3d(a, b, c, d);
        for (rung, sign) in [("filter", settled(rounded_orient3d(a, b, c, d))), ("whole", whole_orient3d(a, b, c, d))] {
            prop_assert!(sign.is_none_or(|sign| sign == exact3), "orient3d, {rung}: {sign:?}, not {exact3:?}");
        }
        let (u, v) = (from_to(a, b), from_to(a, c));
        prop_assert_eq!(exact2, sign(&(&u[0] * &v[1] - &u[1] * &v[0])));
        prop_assert_eq!(exact3, sign(&determinant([from_to(a, b), from_to(a, c), from_to(a, d)])));
        prop_assert_eq!(orient2d_with::<ExactOnly>(a2, b2, c2), exact2);
        prop_assert_eq!(orient3d_with::<ExactOnly>(a, b, c, d), exact3);
    }

    #[test]
    fn the_algebra_holds([a, b, c, d] in quadruple(), shift in [-4..5_i32, -4..5_i32, -4..5_i32], power in -3..4_i32) {
        let turn = |p: [f64; 3], q: [f64; 3], r: [f64; 3]| orient2d(plan(p), plan(q), plan(r));
        let (turned, volume) = (turn(a, b, c), orient3d(a, b, c, d));
        prop_assert!([turn(b, c, a), turn(c, a, b)].iter().all(|&s| s == turned));
        prop_assert!([turn(b, a, c), turn(a, c, b), turn(c, b, a)].iter().all(|&s| s == -turned));
        let even = [orient3d(b, c, a, d), orient3d(c, a, b, d), orient3d(b, a, d, c), orient3d(c, d, a, b)];
        prop_assert!(even.iter().all(|&s| s == volume), "{even:?}");
        let odd = [orient3d(b, a, c, d), orient3d(a, c, b, d), orient3d(a, b, d, c), orient3d(d, a, b, c)];
        prop_assert!(odd.iter().all(|&s| s == -volume), "{odd:?}");
        let mirrored = [a, b, c, d].map(|[x, y, z]| [-x, y, z]);
        let transposed = [a, b, c, d].map(|[x, y, z]| [y, x, z]);
        for [a, b, c, d] in [mirrored, transposed] {
            prop_assert_eq!(turn(a, b, c), -turned);
            prop_assert_eq!(orient3d(a, b, c, d), -volume);
        }
        let upside_down = [a, b, c, d].map(|[x, y, z]| [x, y, -z]);
        prop_assert_eq!(orient3d(upside_down[0], upside_down[1], upside_down[2], upside_down[3]), -volume);
        // What is moved or scaled without rounding keeps its sign.
        let by = shift.map(f64::from);
        let moved = [a, b, c, d].map(|p| move_by(p, by));
        if [a, b, c, d].iter().zip(&moved).all(|(p, m)| from_to(by, *m) == from_to([0.0; 3], *p)) {
            prop_assert_eq!(turn(moved[0], moved[1], moved[2]), turned);
            prop_assert_eq!(orient3d(moved[0], moved[1], moved[2], moved[3]), volume);
        }
        let factor = 2.0_f64.powi(power);
        let scaled = [a, b, c, d].map(|[x, y, z]| [x, y, z * factor]);
        if [a, b, c, d].iter().zip(&scaled).all(|(p, s)| rational(s[2]) == rational(p[2]) * rational(factor)) {
            prop_assert_eq!(orient3d(scaled[0], scaled[1], scaled[2], scaled[3]), volume);
        }
    }

    #[test]
    fn comparison_is_that_of_numbers(a in awkward(), b in awkward()) {
        prop_assert_eq!(compare(a, b), sign(&(rational(a) - rational(b))));
        prop_assert_eq!(compare(b, a), -compare(a, b));
    }
}

/// rustc never contracts a product and a sum into one rounding, whatever the target's features; so every machine, and
/// every level of optimisation, has these bits. (Run with the optimiser on with the other conformance tests.)
#[test]
fn conformance_of_rounded_values_and_bounds_to_golden_bits() {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut draw = || {
        // Marsaglia's xorshift; a spread of magnitudes around 1.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        let mantissa = (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
        mantissa * [1e-9, 1.0, 4096.0, 1e12][state as usize & 3]
    };
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for _ in 0..4_000 {
        let [a, b, c, d] = [(); 4].map(|()| [draw(), draw(), draw()]);
        let (turn, volume) = (rounded_orient2d(plan(a), plan(b), plan(c)), rounded_orient3d(a, b, c, d));
        for value in [turn.0, turn.1, volume.0, volume.1] {
            hash = (hash ^ value.to_bits()).wrapping_mul(0x100_0000_01b3).rotate_left(29);
        }
    }
    assert_eq!(hash, 0x887c_bbf3_3501_501e, "{hash:#018x}");
}
