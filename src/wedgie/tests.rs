//! Bounds against a naive reference, and the nesting that refinement rests on.

use sightline_proto::diamond::{Post, RootSquare, Triangle};

use super::*;
use crate::terrain::{HeightField, MemoryField, Posts, SceneScale, synthetic};

const SCALE: SceneScale = SceneScale { east_m: 23.5, north_m: 30.25, up_m: 1.0 };

/// Every diamond of a root square.
fn diamonds(root: RootSquare) -> impl Iterator<Item = Post> {
    let s = root.side();
    (0..=s).flat_map(move |j| (0..=s).map(move |i| Post::new(i, j))).filter(move |&p| !root.is_corner(p))
}

/// The height of the plane over `t` at post `p` by barycentric weights, or `None` outside the closed triangle.
fn plane_height(t: &Triangle, p: Post, posts: &mut Posts<'_, MemoryField>) -> Option<f64> {
    let corners = t.corners();
    let area = |a: Post, b: Post, c: Post| {
        let [a, b, c] = [a, b, c].map(|p| (i64::from(p.i), i64::from(p.j)));
        (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)
    };
    let [p0, p1, p2] = corners;
    let weights = [area(p1, p2, p), area(p2, p0, p), area(p0, p1, p)];
    if weights.iter().any(|&w| w < 0) {
        return None;
    }
    let total = area(p0, p1, p2) as f64;
    let sum: f64 = corners.iter().zip(weights).map(|(&c, w)| posts.at(c).unwrap().z * w as f64).sum();
    Some(sum / total)
}

/// Deviation of the diamond at `p` by asking every post of the grid.
fn naive_tight(field: &MemoryField, p: Post) -> f64 {
    let grid = field.grid();
    let mut posts = Posts::new(field);
    let mut greatest = 0.0_f64;
    for t in grid.root().triangles(p) {
        for j in 0..grid.ny() {
            for i in 0..grid.nx() {
                let q = Post::new(i, j);
                if let Some(z) = plane_height(&t, q, &mut posts) {
                    greatest = greatest.max((posts.at(q).unwrap().z - z).abs());
                }
            }
        }
    }
    greatest
}

fn fields() -> Vec<MemoryField> {
    let mut fields: Vec<_> = [(2, 2), (2, 3), (3, 3), (4, 9), (17, 5), (9, 9), (23, 18), (33, 17), (14, 33)]
        .into_iter()
        .map(|(nx, ny)| synthetic::fractal(nx, ny, u64::from(nx), 200).unwrap())
        .collect();
    let voids = |i: u32, j: u32| (i * 7 % 5 != j % 3).then(|| f64::from(synthetic::fractal_height(i, j, 9, 50)));
    fields.push(MemoryField::from_fn(19, 11, voids).unwrap());
    fields
}

#[test]
fn tight_is_the_greatest_deviation_of_any_post() {
    for field in fields() {
        let terrain = MemoryTerrain::new(field.clone(), SCALE).unwrap();
        for p in diamonds(field.grid().root()) {
            // Both ways are exact on small integers.
            let naive = naive_tight(&field, p);
            assert_eq!(terrain.bounds(p).unwrap().tight, round_up(naive), "{p:?} of {:?}", field.grid());
        }
    }
}

#[test]
fn blocks_join_where_the_grid_is_larger_than_one() {
    for (nx, ny) in [(65, 65), (66, 65), (129, 70), (100, 65), (131, 129)] {
        let field = synthetic::fractal(nx, ny, 3, 300).unwrap();
        let terrain = MemoryTerrain::new(field.clone(), SCALE).unwrap();
        for p in diamonds(field.grid().root()).filter(|p| (p.i | p.j) % 16 == 0) {
            assert_eq!(terrain.bounds(p).unwrap().tight, round_up(naive_tight(&field, p)), "{p:?} of {nx} x {ny}");
        }
    }
}

/// Bands without relief are not scanned; those beside them are.
#[test]
fn a_plain_beside_hills_has_the_bounds_that_it_should() {
    let hills = |i: u32, j: u32| f64::from(synthetic::fractal_height(i, j, 6, 300));
    let field = MemoryField::from_fn(40, 140, |i, j| Some(if j > 100 { hills(i, j) } else { 7.0 })).unwrap();
    let terrain = MemoryTerrain::new(field.clone(), SCALE).unwrap();
    for p in diamonds(field.grid().root()).filter(|p| (p.i | p.j) % 4 == 0) {
        assert_eq!(terrain.bounds(p).unwrap().tight, round_up(naive_tight(&field, p)), "{p:?}");
    }
    check_nesting(&terrain);
    let middle = [Post::new(17, 31), Post::new(2, 34), Post::new(4, 40)].map(|p| terrain.bounds(p).unwrap());
    assert!(middle.iter().all(|bounds| bounds.nested == 0.0 && bounds.radius_m > 20.0), "{middle:?}");
}

/// Checks, for every diamond that has a child with bounds, that the child's bounds lie within its own.
fn check_nesting(terrain: &MemoryTerrain) {
    let root = terrain.grid().root();
    let mut posts = Posts::new(terrain);
    for p in diamonds(root) {
        let own = terrain.bounds(p).unwrap();
        assert!(!own.tight.is_nan() && !own.nested.is_nan() && !own.radius_m.is_nan());
        assert!(own.nested >= own.tight);
        let z = posts.at(p).unwrap().z;
        for child in root.children(p) {
            let inner = terrain.bounds(child).unwrap();
            assert!(inner.nested <= own.nested, "{p:?} {child:?}");
            if inner.nested > 0.0 {
                let distance = finest::distance_m(terrain.scale(), p, z, child, posts.at(child).unwrap().z);
                let reach = distance + f64::from(inner.radius_m);
                assert!(reach.is_nan() || reach <= f64::from(own.radius_m), "{p:?} {child:?}");
            }
        }
        if own.nested > 0.0 {
            for corner in root.triangles(p).flat_map(|t| t.corners()) {
                let distance = finest::distance_m(terrain.scale(), p, z, corner, posts.at(corner).unwrap().z);
                assert!(distance.is_nan() || distance <= f64::from(own.radius_m));
            }
        }
    }
}

#[test]
fn children_lie_within_their_parents() {
    for field in fields() {
        check_nesting(&MemoryTerrain::new(field, SCALE).unwrap());
    }
    check_nesting(&MemoryTerrain::new(synthetic::fractal(100, 70, 5, 2000).unwrap(), SCALE).unwrap());
}

/// Any finite heights: from subnormal to so great that f32 and f64 overflow.
#[test]
fn extreme_heights_give_bounds_that_hold_and_are_never_nan() {
    for greatest in [1e-310, 1e-45, 0.1, 1e9, 1e38, 3e38, 1e200, 1.7e308] {
        let height = |i: u32, j: u32| {
            let noise = synthetic::mix(u64::from(i) << 32 | u64::from(j)) as i64 as f64 / i64::MAX as f64;
            Some(noise * if (i + j).is_multiple_of(3) { greatest } else { greatest * 1e-30 })
        };
        let field = MemoryField::from_fn(21, 13, height).unwrap();
        let terrain = MemoryTerrain::new(field.clone(), SCALE).unwrap();
        check_nesting(&terrain);
        for p in diamonds(field.grid().root()) {
            let (naive, tight) = (naive_tight(&field, p), f64::from(terrain.bounds(p).unwrap().tight));
            // The naive sum rounds, and overflows, too.
            assert!(!naive.is_finite() || tight >= naive * (1.0 - 1e-14) - greatest * 1e-14, "{p:?} {naive} {tight}");
        }
    }
}

#[test]
fn a_plane_has_no_thickness_except_beyond_its_edge() {
    let terrain = MemoryTerrain::new(synthetic::plane(65, 65, 3, -7).unwrap(), SCALE).unwrap();
    for p in diamonds(terrain.grid().root()) {
        assert_eq!(terrain.bounds(p).unwrap().nested, 0.0);
    }
}

#[test]
fn bounds_do_not_depend_on_the_number_of_threads() {
    let field = synthetic::fractal(200, 150, 8, 900).unwrap();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| BoundsPyramid::compute(&field, SCALE)).unwrap()
    };
    assert_eq!(with(1), with(3));
}
