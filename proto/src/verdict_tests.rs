//! The verdict on a mesh and its parts against fractions, on random small meshes with padding and awkward lines.

use std::{collections::BTreeMap, ops::ControlFlow};

use num_rational::BigRational;
use num_traits::{Signed, Zero};
use proptest::prelude::*;

use crate::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
    predicates::Sign,
    verdict::{LinePoint, MeshVerdict, for_each_triangle_met, passes_above, passes_below, verdict_on_mesh},
};

const SIDE: u32 = 8;

#[derive(Clone, Debug)]
struct SmallMesh {
    size: (u32, u32),
    active: BTreeMap<Post, f64>,
}

impl Mesh for SmallMesh {
    fn root(&self) -> RootSquare {
        RootSquare::new(3).unwrap()
    }

    fn grid_size(&self) -> (u32, u32) {
        self.size
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.active.get(&p).copied()
    }
}

impl SmallMesh {
    fn triangles(&self) -> Vec<Triangle> {
        let mut all = Vec::new();
        self.for_each_triangle(|t| all.push(t));
        all
    }

    fn corners(&self, t: &Triangle) -> [[f64; 3]; 3] {
        t.corners().map(|p| [f64::from(p.i), f64::from(p.j), self.active[&p]])
    }
}

/// Meshes closed from a few random posts; the grid may be much smaller than the square.
fn mesh() -> impl Strategy<Value = SmallMesh> {
    let post = (0..=SIDE, 0..=SIDE).prop_map(|(i, j)| Post::new(i, j));
    let height = || prop_oneof![(-2..3_i32).prop_map(f64::from), Just(0.1), Just(0.5)];
    let heights = proptest::collection::vec(height(), 81);
    let size = prop_oneof![Just((9, 9)), (2..=9_u32, 2..=9_u32)];
    (size, proptest::collection::vec(post, 0..6), heights).prop_map(|(size, seeds, heights)| {
        let root = RootSquare::new(3).unwrap();
        let mut waiting: Vec<_> = seeds.into_iter().chain(root.corners()).collect();
        let mut active = BTreeMap::new();
        while let Some(p) = waiting.pop() {
            waiting.extend(root.parents(p));
            active.insert(p, heights[(p.j * 9 + p.i) as usize]);
        }
        SmallMesh { size, active }
    })
}

fn coordinate() -> impl Strategy<Value = f64> {
    let whole = || (-1..10_i32).prop_map(f64::from);
    prop_oneof![
        24 => whole(),
        12 => whole().prop_map(|v| v + 0.5),
        4 => whole().prop_map(f64::next_up),
        4 => whole().prop_map(f64::next_down),
        12 => -1.0..9.0_f64,
        1 => prop_oneof![Just(1e300), Just(-1e300), Just(5e-324)],
    ]
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    let z = prop_oneof![12 => (-3..4_i32).prop_map(f64::from), 4 => -3.0..3.0_f64, 1 => Just(1e300)];
    [coordinate().boxed(), coordinate().boxed(), z.boxed()]
}

/// Two points, often on one line of posts, so that AB runs along edges and through corners.
fn line() -> impl Strategy<Value = ([f64; 3], [f64; 3])> {
    let along = (0..4_usize, 0..9_i32, 0..9_i32, [-6..7_i32, -3..4_i32, -6..7_i32, -3..4_i32]);
    let along = along.prop_map(|(direction, i, j, [s, az, t, bz])| {
        let (di, dj) = [(1, 0), (0, 1), (1, 1), (1, -1)][direction];
        let at = |n: i32, z: i32| [f64::from(2 * i + n * di) / 2.0, f64::from(2 * j + n * dj) / 2.0, f64::from(z)];
        (at(s, az), at(t, bz))
    });
    prop_oneof![(point(), point()), along]
}

fn rational(v: f64) -> BigRational {
    BigRational::from_float(v).unwrap()
}

/// The point of AB at t.
fn at(a: [f64; 3], b: [f64; 3], t: &BigRational) -> [BigRational; 3] {
    [0, 1, 2].map(|k| rational(a[k]) + t * (rational(b[k]) - rational(a[k])))
}

fn turn(p: [f64; 3], q: [f64; 3], x: &[BigRational; 3]) -> BigRational {
    (rational(q[0]) - rational(p[0])) * (&x[1] - rational(p[1]))
        - (rational(q[1]) - rational(p[1])) * (&x[0] - rational(p[0]))
}

/// Height of a point above the plane, times the doubled area.
fn above([p, q, r]: [[f64; 3]; 3], x: &[BigRational; 3]) -> BigRational {
    let weights = [turn(q, r, x), turn(r, p, x), turn(p, q, x)];
    let sum: BigRational = weights.iter().sum();
    let ground: BigRational = weights.iter().zip([p, q, r]).map(|(w, c)| w * rational(c[2])).sum();
    &x[2] * sum - ground
}

/// The parameters between which AB is over the closed triangle and the grid.
fn chord(a: [f64; 3], b: [f64; 3], [p, q, r]: [[f64; 3]; 3], (nx, ny): (u32, u32)) -> Option<[BigRational; 2]> {
    let (east, north) = (rational(f64::from(nx - 1)), rational(f64::from(ny - 1)));
    let conditions = |x: &[BigRational; 3]| {
        [turn(p, q, x), turn(q, r, x), turn(r, p, x), x[0].clone(), &east - &x[0], x[1].clone(), &north - &x[1]]
    };
    let one = rational(1.0);
    let (from, to) = (conditions(&at(a, b, &rational(0.0))), conditions(&at(a, b, &one)));
    let (mut low, mut high) = (rational(0.0), one);
    for (f, g) in from.into_iter().zip(to) {
        let slope = &g - &f;
        if slope.is_zero() {
            if f.is_negative() {
                return None;
            }
        } else if slope.is_positive() {
            low = low.max(-f / slope);
        } else {
            high = high.min(-f / slope);
        }
    }
    (low <= high).then_some([low, high])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(250))]

    #[test]
    fn verdicts_and_triangles_are_those_of_fractions(mesh in mesh(), (a, b) in line()) {
        let (mut blocked, mut met) = (false, Vec::new());
        for t in mesh.triangles() {
            let corners = mesh.corners(&t);
            let chord = chord(a, b, corners, mesh.size);
            let heights = chord.iter().flatten().map(|s| above(corners, &at(a, b, s))).collect::<Vec<_>>();
            let (below, over) = (heights.iter().any(Signed::is_negative), heights.iter().any(Signed::is_positive));
            prop_assert_eq!(passes_below(a, b, corners, mesh.size), below, "{:?}", t);
            prop_assert_eq!(passes_above(a, b, corners, mesh.size), over, "{:?}", t);
            blocked |= below;
            if chord.is_some() {
                met.push(t);
            }
        }
        let expected = if blocked { MeshVerdict::Blocked } else { MeshVerdict::Visible };
        prop_assert_eq!(verdict_on_mesh(&mesh, a, b), expected);
        prop_assert_eq!(verdict_on_mesh(&mesh, b, a), expected, "reversed");
        let mut walked = Vec::new();
        let end = for_each_triangle_met(&mesh, a, b, |t| {
            walked.push(t);
            ControlFlow::Continue(())
        });
        prop_assert!(end.is_continue());
        prop_assert_eq!(walked, met);
    }

    #[test]
    fn points_of_a_line_are_exact(mesh in mesh(), (a, b) in line(), p in 0..81_u32, q in 0..81_u32) {
        let [p, q] = [p, q].map(|n| Post::new(n % 9, n / 9));
        let [sp, sq] = [p, q].map(|p| [f64::from(p.i), f64::from(p.j), 0.0]);
        let zero = rational(0.0);
        let (ga, gb) = (turn(sp, sq, &at(a, b, &zero)), turn(sp, sq, &at(a, b, &rational(1.0))));
        let apart = (ga.is_positive() && !gb.is_positive()) || (ga.is_negative() && !gb.is_negative())
            || (ga.is_zero() && !gb.is_zero());
        let crossing = apart.then(|| (LinePoint::Crossing(p, q), &ga / (&ga - &gb)));
        for (point, t) in [(LinePoint::A, zero), (LinePoint::B, rational(1.0))].into_iter().chain(crossing) {
            let x = at(a, b, &t);
            for triangle in mesh.triangles() {
                let corners @ [u, v, w] = mesh.corners(&triangle);
                let inside = [turn(u, v, &x), turn(v, w, &x), turn(w, u, &x)].iter().all(|s| !s.is_negative());
                prop_assert_eq!(point.in_triangle(a, b, &triangle), inside);
                let height = above(corners, &x);
                let sign = match (height.is_positive(), height.is_negative()) {
                    (true, _) => Sign::Positive,
                    (_, true) => Sign::Negative,
                    _ => Sign::Zero,
                };
                prop_assert_eq!(point.height_against_plane(a, b, corners), sign);
            }
        }
    }
}
