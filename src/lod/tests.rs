//! The suite that every system passes, and the measures against naive ones.

use std::{collections::BTreeMap, sync::Arc};

use glam::{DQuat, DVec3};
use num_rational::BigRational;
use num_traits::{Signed, Zero};
use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
    verdict::{MeshVerdict, verdict_on_mesh},
};

use super::{
    conformity::{self, NotOnce},
    measure::{heights_at_posts, surface, vertical_error},
    mesh::Vertex,
    sight::{SightIndex, passes_below},
    *,
};
use crate::terrain::{
    Grid, MemoryField, SceneScale,
    synthetic::{fractal, mix},
};

const SCALE: SceneScale = SceneScale { east_m: 70.0, north_m: 90.0, up_m: 1.0 };

fn ground(nx: u32, ny: u32, seed: u64) -> Arc<Ground> {
    Ground::read(&fractal(nx, ny, seed, 900).unwrap(), SCALE).unwrap()
}

/// A number in [0, 1) that depends on `seed` and `n` only.
fn unit(seed: u64, n: u64) -> f64 {
    (mix(seed ^ mix(n)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// An eye above the terrain at fractions of its sides, looking north and a little down.
fn view(ground: &Ground, x: f64, y: f64, above_m: f64) -> LodView {
    let extent = DVec3::new(f64::from(ground.grid().nx() - 1), f64::from(ground.grid().ny() - 1), 0.0);
    let mut eye = SCALE.scene_from_grid(extent * DVec3::new(x, y, 0.0));
    eye.z = ground.ground_m(eye) + above_m;
    LodView::new(eye, DQuat::from_xyzw(0.6, 0.0, 0.0, 0.8), 0.5, 1.0, [800, 600]).unwrap()
}

/// Sizes that are and are not 2^m + 1, down to the least.
const SIZES: [(u32, u32); 6] = [(129, 129), (65, 65), (50, 37), (34, 5), (3, 3), (2, 2)];

#[test]
fn every_mesh_covers_its_rectangle_once_without_undocumented_cracks() {
    for algorithm in Algorithm::ALL {
        for (n, (nx, ny)) in SIZES.into_iter().enumerate() {
            let ground = ground(nx, ny, n as u64);
            let mut system = algorithm.prepare(&ground);
            for (step, most) in [40, 300, 2500, 100_000, 900].into_iter().enumerate() {
                let view = view(&ground, 0.1 + 0.2 * step as f64, 0.3, 50.0 * (1 + step) as f64);
                let frame = system.update(&view, Target::Triangles(most)).unwrap();
                let what = format!("{} on {nx} x {ny}, {most} triangles", algorithm.name());
                let found = conformity::check(&frame.mesh).unwrap_or_else(|e| panic!("{what}: {e}"));
                assert_eq!(found.t_junctions, 0, "{what}: {found:?}");
                assert!(frame.mesh.extent[0] + 1 >= nx && frame.mesh.extent[1] + 1 >= ny, "{what}");
                assert_eq!(vertical_error(&frame.mesh, &ground).uncovered, 0, "{what}");
            }
        }
    }
}

#[test]
fn counts_are_kept_and_more_triangles_are_closer_to_the_surface() {
    let ground = ground(129, 129, 5);
    let view = view(&ground, 0.5, 0.2, 100.0);
    for algorithm in Algorithm::ALL {
        let mut system = algorithm.prepare(&ground);
        let least = system.update(&view, Target::Setting(algorithm.range().coarse)).unwrap().mesh.len();
        let most = system.update(&view, Target::Setting(algorithm.range().fine)).unwrap().mesh.len();
        let mut rms = f64::INFINITY;
        for target in [500, 2000, 8000, 40_000] {
            let frame = system.update(&view, Target::Triangles(target)).unwrap();
            let what = format!("{}, {target} triangles: {}", algorithm.name(), frame.mesh.len());
            assert!(frame.mesh.len() <= least.max(target as usize), "{what}");
            assert!(frame.mesh.len() * 2 >= most.min(target as usize), "far below the target: {what}");
            let error = vertical_error(&frame.mesh, &ground).rms;
            assert!(error <= rms * 1.05, "{what}: {error} after {rms}");
            rms = error;
            if algorithm == Algorithm::Published {
                // Its queues go on where they stopped, and its metric need not settle.
                continue;
            }
            let again = system.update(&view, Target::Setting(frame.statistics.setting)).unwrap();
            assert_eq!(again.mesh.plan(), frame.mesh.plan(), "{what}: its setting gives another mesh");
        }
    }
}

#[test]
fn the_same_calls_give_the_same_meshes() {
    let ground = ground(65, 65, 9);
    for algorithm in Algorithm::ALL {
        let fly = || {
            let mut system = algorithm.prepare(&ground);
            (0..6)
                .map(|n| {
                    let view = view(&ground, 0.15 * f64::from(n), 0.1 * f64::from(n), 40.0);
                    system.update(&view, Target::Triangles(700)).unwrap()
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(fly(), fly(), "{}", algorithm.name());
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    let ground = ground(17, 17, 1);
    let view = view(&ground, 0.5, 0.5, 10.0);
    for algorithm in Algorithm::ALL.into_iter().filter(|&a| a != Algorithm::Full) {
        let mut system = algorithm.prepare(&ground);
        for bad in [f64::NAN, -1.0, 0.0, f64::INFINITY] {
            let refused = system.update(&view, Target::Setting(bad));
            assert!(matches!(refused, Err(LodError::Setting { .. })), "{} {bad}", algorithm.name());
        }
    }
}

#[test]
fn the_finest_mesh_is_the_terrain() {
    let ground = ground(33, 33, 3);
    let view = view(&ground, 0.5, 0.5, 10.0);
    for algorithm in Algorithm::ALL.into_iter().filter(|&a| !culls(a)) {
        let frame = algorithm.prepare(&ground).update(&view, Target::Setting(algorithm.range().fine)).unwrap();
        let error = vertical_error(&frame.mesh, &ground);
        assert!(error.max_at_posts < 1e-9, "{}: {error:?}", algorithm.name());
        if same_diagonals(algorithm) {
            assert!(error.max < 1e-9, "{}: {error:?}", algorithm.name());
        }
    }
}

/// Whether a system spends no triangle out of view.
fn culls(algorithm: Algorithm) -> bool {
    algorithm == Algorithm::Published
}

/// Whether the cells of a system's finest mesh are cut as those of the finest surface.
fn same_diagonals(algorithm: Algorithm) -> bool {
    !matches!(algorithm, Algorithm::GeoMipMap | Algorithm::ImprovedGeoMipMap | Algorithm::TStrip)
}

/// The deviation at one post by trying every triangle.
fn naive_deviation(mesh: &IndexedMesh, ground: &Ground, x: f64, y: f64) -> f64 {
    let mut worst = f64::NAN;
    for t in mesh.iter() {
        let [a, b, c] = t.map(|v| v.point());
        let turn = |p: [f64; 3], q: [f64; 3]| (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]);
        let w = [turn(b, c), turn(c, a), turn(a, b)];
        if w.iter().all(|&w| w >= 0.0) {
            let z = (w[0] * a[2] + w[1] * b[2] + w[2] * c[2]) / (w[0] + w[1] + w[2]);
            worst = worst.max((z - surface(ground, x, y)).abs());
        }
    }
    worst
}

#[test]
fn errors_are_those_of_a_naive_measure() {
    let ground = ground(33, 20, 11);
    let view = view(&ground, 0.3, 0.3, 30.0);
    for algorithm in Algorithm::ALL {
        let mesh = algorithm.prepare(&ground).update(&view, Target::Triangles(250)).unwrap().mesh;
        let error = vertical_error(&mesh, &ground);
        let (mut max, mut sum, mut squares) = (0.0_f64, 0.0, 0.0);
        for j in 0..20 {
            for i in 0..33 {
                let d = naive_deviation(&mesh, &ground, f64::from(i), f64::from(j));
                (max, sum, squares) = (max.max(d), sum + d, squares + d * d);
            }
        }
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * (1.0 + b);
        let what = algorithm.name();
        assert!(close(error.max_at_posts, max), "{what}: {error:?} {max}");
        assert!(close(error.mean, sum / 660.0) && close(error.rms, (squares / 660.0).sqrt()), "{what}: {error:?}");
        // No point between posts is worse than the greatest.
        for n in 0..2000 {
            let d = naive_deviation(&mesh, &ground, 32.0 * unit(n, 1), 19.0 * unit(n, 2));
            assert!(d <= error.max + 1e-9, "{what}: {d} {error:?}");
        }
        let heights = heights_at_posts(&mesh, &ground);
        let far = heights.iter().enumerate().map(|(n, z)| (z - ground.z(n as u32 % 33, n as u32 / 33)).abs());
        assert!(close(far.fold(0.0, f64::max), error.max_at_posts), "{what}");
    }
}

fn vertex(i: u32, j: u32, z: f64) -> Vertex {
    Vertex { post: Post::new(i, j), z }
}

fn mesh_of(extent: [u32; 2], vertices: &[(u32, u32, f64)], triangles: &[[u32; 3]]) -> IndexedMesh {
    let vertices = vertices.iter().map(|&(i, j, z)| vertex(i, j, z)).collect();
    IndexedMesh { extent, vertices, triangles: triangles.to_vec() }
}

#[test]
fn conformity_sees_holes_overlaps_turns_and_cracks() {
    let corners = [(0, 0, 0.0), (4, 0, 0.0), (4, 4, 0.0), (0, 4, 0.0), (2, 2, 3.0), (1, 2, 0.0)];
    let mesh = |triangles: &[[u32; 3]]| mesh_of([4, 4], &corners, triangles);
    let whole = conformity::check(&mesh(&[[0, 1, 2], [0, 2, 3]])).unwrap();
    assert_eq!((whole.t_junctions, whole.gap_max), (0, 0.0));
    // The centre splits one side of the diagonal only: one T-junction, three high.
    let torn = conformity::check(&mesh(&[[0, 1, 4], [1, 2, 4], [0, 2, 3]])).unwrap();
    assert_eq!((torn.t_junctions, torn.gap_max), (1, 3.0));
    let refused = |triangles: &[[u32; 3]]| conformity::check(&mesh(triangles)).unwrap_err();
    assert!(matches!(refused(&[[0, 1, 2]]), NotOnce::Uncovered { .. }), "a hole");
    assert!(matches!(refused(&[[0, 1, 2], [0, 2, 3], [0, 1, 4]]), NotOnce::Uncovered { .. }), "an overlap");
    assert!(matches!(refused(&[[0, 1, 2], [0, 2, 3], [0, 2, 3]]), NotOnce::Uncovered { .. }), "a triangle twice");
    assert!(matches!(refused(&[[0, 1, 2], [0, 3, 2]]), NotOnce::Turned(_)), "clockwise");
    assert!(matches!(refused(&[[0, 1, 2], [0, 2, 3], [0, 4, 2]]), NotOnce::Turned(_)), "no area");
    // Edges that run in odd directions: a fan around (1, 2).
    let fan = conformity::check(&mesh(&[[0, 1, 5], [1, 2, 5], [2, 3, 5], [3, 0, 5]])).unwrap();
    assert_eq!(fan.t_junctions, 0);
    assert!(matches!(refused(&[[0, 1, 5], [1, 2, 5], [2, 3, 5], [3, 0, 4]]), NotOnce::Uncovered { .. }));
}

/// Whether some point of AB over a triangle and the grid is strictly below its plane, in rationals: AB is cut by each
/// half plane in turn, and the ends of what remains decide.
fn rational_passes_below(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], grid: Grid) -> bool {
    let r = |v: f64| BigRational::from_float(v).unwrap();
    let (a, b, [p, q, s]) = (a.map(r), b.map(r), corners.map(|c| c.map(r)));
    let zero = BigRational::zero();
    let (east, north) = (r(f64::from(grid.nx() - 1)), r(f64::from(grid.ny() - 1)));
    let turn = |p: &[BigRational; 3], q: &[BigRational; 3], x: &[BigRational; 3]| {
        (&q[0] - &p[0]) * (&x[1] - &p[1]) - (&q[1] - &p[1]) * (&x[0] - &p[0])
    };
    let sides = |x: &[BigRational; 3]| {
        [turn(&p, &q, x), turn(&q, &s, x), turn(&s, &p, x), x[0].clone(), x[1].clone(), &east - &x[0], &north - &x[1]]
    };
    let (mut low, mut high) = (zero.clone(), r(1.0));
    for (ga, gb) in sides(&a).into_iter().zip(sides(&b)) {
        let slope = &gb - &ga;
        if slope.is_zero() {
            if ga.is_negative() {
                return false;
            }
            continue;
        }
        let root = -&ga / &slope;
        if slope.is_positive() { low = low.max(root) } else { high = high.min(root) }
    }
    let below = |t: &BigRational| {
        let x = [0, 1, 2].map(|k| &a[k] + t * (&b[k] - &a[k]));
        let area = turn(&p, &q, &s);
        let plane = (turn(&q, &s, &x) * &p[2] + turn(&s, &p, &x) * &q[2] + turn(&p, &q, &x) * &s[2]) / area;
        x[2] < plane
    };
    low <= high && (below(&low) || below(&high))
}

#[test]
fn single_triangles_are_passed_below_as_in_rational_arithmetic() {
    let grid = Grid::new(6, 5).unwrap();
    let mut counts = [0; 2];
    for seed in 0..60_000 {
        let small = |n: u64, most: f64| (most * unit(seed, n)).floor();
        let corner = |n: u64| [small(n, 9.0), small(n + 1, 9.0), small(n + 2, 4.0)];
        let corners = [corner(10), corner(20), corner(30)];
        let [p, q, s] = corners;
        if (q[0] - p[0]) * (s[1] - p[1]) - (q[1] - p[1]) * (s[0] - p[0]) <= 0.0 {
            continue;
        }
        // Integers and halves: lines through corners, along edges, in planes and of length zero are common.
        let end = |n: u64| [small(n, 20.0) / 2.0 - 1.0, small(n + 1, 20.0) / 2.0 - 1.0, small(n + 2, 8.0) / 2.0];
        let (a, b) = (end(40), if seed % 13 == 0 { end(40) } else { end(50) });
        let expected = rational_passes_below(a, b, corners, grid);
        assert_eq!(passes_below(a, b, corners, grid), expected, "seed {seed}: {a:?} {b:?} {corners:?}");
        assert_eq!(passes_below(b, a, corners, grid), expected, "seed {seed}, turned round");
        counts[usize::from(expected)] += 1;
    }
    assert!(counts[0] > 1000 && counts[1] > 1000, "{counts:?}");
}

#[test]
fn verdicts_on_the_finest_mesh_are_those_on_the_finest_surface() {
    let field = fractal(70, 41, 21, 300).unwrap();
    let ground = Ground::read(&field, SCALE).unwrap();
    let view = view(&ground, 0.5, 0.5, 10.0);
    let mut counts = [0; 2];
    for algorithm in Algorithm::ALL.into_iter().filter(|&a| same_diagonals(a) && !culls(a)) {
        let mesh = algorithm.prepare(&ground).update(&view, Target::Setting(algorithm.range().fine)).unwrap().mesh;
        let index = SightIndex::new(&mesh, ground.grid());
        for seed in 0..300 {
            let end = |n: u64| {
                let (i, j) = ((70.0 * unit(seed, n)) as u32, (41.0 * unit(seed, n + 1)) as u32);
                [f64::from(i), f64::from(j), ground.z(i, j) + (4.0 * unit(seed, n + 2)).floor()]
            };
            let (a, b) = (end(1), end(5));
            let truth = crate::los::line_of_sight(&field, a, b, crate::los::Options::default()).unwrap().verdict;
            let expected =
                if truth == crate::los::Verdict::Blocked { MeshVerdict::Blocked } else { MeshVerdict::Visible };
            assert_eq!(index.verdict(a, b), expected, "{}, seed {seed}", algorithm.name());
            counts[usize::from(expected == MeshVerdict::Blocked)] += 1;
        }
    }
    assert!(counts[0] > 20 && counts[1] > 20, "{counts:?}");
}

#[test]
fn a_terrain_too_large_for_one_array_is_refused() {
    let field = MemoryField::from_fn(MAX_SIDE + 2, 2, |_, _| Some(0.0)).unwrap();
    assert!(matches!(Ground::read(&field, SCALE), Err(LodError::TooLarge { .. })));
}

#[test]
fn morphing_moves_vertices_and_tears_nothing() {
    let ground = ground(129, 129, 13);
    let view = view(&ground, 0.4, 0.4, 60.0);
    let heights: Vec<f64> = (0..129 * 129).map(|n| ground.z(n % 129, n / 129)).collect();
    let (low, high) = heights.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &z| (l.min(z), h.max(z)));
    for algorithm in [Algorithm::Quadtree, Algorithm::GeoMipMap, Algorithm::ImprovedGeoMipMap, Algorithm::TStrip] {
        let mut system = algorithm.prepare(&ground);
        let still = system.update(&view, Target::Triangles(6000)).unwrap();
        system.set_morph(true);
        let morphed = system.update(&view, Target::Setting(still.statistics.setting)).unwrap();
        assert_eq!(still.mesh.plan(), morphed.mesh.plan(), "{}", algorithm.name());
        let found = conformity::check(&morphed.mesh).unwrap();
        assert_eq!(found.t_junctions, 0, "{}", algorithm.name());
        let moved = morphed.mesh.vertices.iter().filter(|v| v.z != ground.z(v.post.i, v.post.j)).count();
        assert!(moved > 0 && moved < morphed.mesh.vertices.len(), "{}: {moved}", algorithm.name());
        // Between the levels, so never beyond the terrain's own range.
        assert!(morphed.mesh.vertices.iter().all(|v| (low..=high).contains(&v.z)), "{}", algorithm.name());
    }
}

/// A mesh of the hierarchy: random posts with all their ancestors.
struct Sparse {
    root: RootSquare,
    grid: (u32, u32),
    active: BTreeMap<Post, f64>,
}

impl Sparse {
    fn new(ground: &Ground, seed: u64, posts: u64) -> Self {
        let grid = ground.grid();
        let root = grid.root();
        let side = u64::from(root.side()) + 1;
        let mut open: Vec<Post> = (0..posts)
            .map(|n| Post::new((mix(seed ^ mix(2 * n)) % side) as u32, (mix(seed ^ mix(2 * n + 1)) % side) as u32))
            .collect();
        open.extend(root.corners());
        let mut active = BTreeMap::new();
        while let Some(p) = open.pop() {
            if active.insert(p, ground.z(p.i, p.j)).is_none() {
                open.extend(root.parents(p));
            }
        }
        Self { root, grid: (grid.nx(), grid.ny()), active }
    }
}

impl Mesh for Sparse {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        self.grid
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.active.get(&p).copied()
    }
}

#[test]
fn bintree_meshes_have_the_same_verdicts_either_way() {
    let mut counts = [0; 2];
    for seed in 0..12 {
        let ground = ground(41, 30, seed);
        let bintree = Sparse::new(&ground, seed, 3 + 10 * seed);
        let mesh = IndexedMesh::of(&bintree);
        assert_eq!(conformity::check(&mesh).unwrap().t_junctions, 0, "seed {seed}");
        let index = SightIndex::new(&mesh, ground.grid());
        for n in 0..150 {
            // Posts and points beside the grid; heights near the surface, so that lines in the mesh are common.
            let end = |k: u64| {
                let (i, j) = ((50.0 * unit(n, k)).floor(), (36.0 * unit(n, k + 1)).floor());
                let z = ground.z((i as u32).min(40), (j as u32).min(29)) + (5.0 * unit(n, k + 2)).floor() - 1.0;
                [i - 4.0, j - 3.0, z]
            };
            let (a, b) = (end(10 * seed), end(10 * seed + 5));
            let expected = verdict_on_mesh(&bintree, a, b);
            assert_eq!(index.verdict(a, b), expected, "seed {seed}, line {n}: {a:?} {b:?}");
            counts[usize::from(expected == MeshVerdict::Blocked)] += 1;
        }
    }
    assert!(counts[0] > 100 && counts[1] > 100, "{counts:?}");
}
