//! The mesh is what the order asks for, however it was reached; the reported bound holds; every mesh is conforming.

use std::{collections::BTreeSet, sync::Arc};

use glam::{DQuat, DVec3};
use sightline_proto::{
    diamond::{Post, Triangle},
    mesh::Mesh,
};

use super::*;
use crate::{
    terrain::{MemoryField, Posts, SceneScale, synthetic},
    view::{Camera, Projection},
    wedgie::{ErrorBounds, MemoryTerrain},
};

pub(super) const SCALE: SceneScale = SceneScale { east_m: 20.0, north_m: 30.0, up_m: 1.0 };

pub(super) fn terrain(nx: u32, ny: u32, seed: u64) -> Arc<MemoryTerrain> {
    Arc::new(MemoryTerrain::new(synthetic::fractal(nx, ny, seed, 400).unwrap(), SCALE).unwrap())
}

/// A number in [0, 1) that depends on `seed` and `n` only.
pub(super) fn unit(seed: u64, n: u64) -> f64 {
    (synthetic::mix(seed ^ synthetic::mix(n)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A random camera near the ground of `terrain`, now and then a parallel one or none.
pub(super) fn camera(terrain: &MemoryTerrain, seed: u64) -> Camera {
    if seed % 16 == 3 {
        return Camera::everywhere();
    }
    let grid = terrain.grid();
    let (x, y) = (unit(seed, 1) * f64::from(grid.nx() - 1), unit(seed, 2) * f64::from(grid.ny() - 1));
    let ground = Posts::new(terrain).at(Post::new(x as u32, y as u32)).unwrap().z;
    let eye = SCALE.scene_from_grid(DVec3::new(x, y, ground + 400.0 * unit(seed, 3)));
    let part = |n| unit(seed, n) - 0.5;
    let rotation = DQuat::from_xyzw(part(4) + 0.7, 0.3 * part(5), 0.3 * part(6), part(7) + 0.7).normalize();
    let projection = if seed % 16 == 5 {
        Projection::Orthographic { half_height_m: 300.0, near_m: 1.0 }
    } else {
        Projection::Perspective { tan_half_fov: 0.3 + unit(seed, 8), near_m: 1.0 }
    };
    Camera::new(eye, rotation, projection, [800, 600]).unwrap()
}

pub(super) fn set(mesh: &ViewMesh<MemoryTerrain>) -> BTreeSet<Post> {
    mesh.active_posts().into_iter().map(|(p, _)| p).collect()
}

/// The definition of DESIGN section 7, word by word, over all posts of the square.
pub(super) fn longest_prefix(
    terrain: &MemoryTerrain,
    camera: &Camera,
    target: Target,
    regions: &Regions,
) -> (BTreeSet<Post>, f64) {
    let (max, threshold) = target.limits().unwrap();
    let root = terrain.grid().root();
    let mut order = Vec::new();
    for p in (0..=root.side()).flat_map(|j| (0..=root.side()).map(move |i| Post::new(i, j))) {
        let Some(level) = root.level(p) else { continue };
        order.push((std::cmp::Reverse(priority(terrain, camera, p, regions).to_bits()), level, p));
    }
    order.sort();
    let (mut count, mut prefix, mut bound) = (2, BTreeSet::new(), 0.0_f64);
    let mut ended = false;
    for (weighted, _, p) in order {
        count += root.triangles(p).count() as u32;
        ended |= count > max || f64::from_bits(weighted.0) <= threshold;
        if ended {
            bound = bound.max(priority(terrain, camera, p, &Regions::default()));
        } else {
            prefix.insert(p);
        }
    }
    (prefix, bound)
}

/// The priority of a post by its definition.
pub(super) fn priority(terrain: &MemoryTerrain, camera: &Camera, p: Post, regions: &Regions) -> f64 {
    let bounds = terrain.bounds(p).unwrap();
    let z = Posts::new(terrain).at(p).unwrap().z;
    let centre = SCALE.scene_from_grid(DVec3::new(f64::from(p.i), f64::from(p.j), z));
    let radius_m = f64::from(bounds.radius_m);
    camera.priority(f64::from(bounds.nested) * SCALE.up_m, centre, radius_m) * regions.weight(centre, radius_m)
}

/// Height of the mesh at a post of the grid.
pub(super) fn height_on(mesh: &ViewMesh<MemoryTerrain>, p: Post) -> f64 {
    let z = |t: &Triangle| t.corners().map(|c| mesh.height(c).unwrap());
    let at = |t: &Triangle| height_in(t, z(t), f64::from(p.i), f64::from(p.j));
    let mut triangle = mesh.root().roots().into_iter().find(|t| at(t).is_some()).unwrap();
    while let Some(middle) = triangle.base_midpoint().filter(|&m| mesh.height(m).is_some()) {
        triangle = triangle.children(middle).into_iter().find(|t| at(t).is_some()).unwrap();
    }
    at(&triangle).unwrap()
}

/// Checks that the mesh covers the square once, has no T-junction and the stated number of triangles.
fn check_conforming(mesh: &ViewMesh<MemoryTerrain>, report: &MeshReport) {
    let root = mesh.root();
    let (mut triangles, mut area) = (0, 0);
    mesh.for_each_triangle(|t: Triangle| {
        triangles += 1;
        let [a, b, c] = t.corners().map(|p| (i64::from(p.i), i64::from(p.j)));
        area += (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
        for (p, q) in [(t.apex, t.e0), (t.apex, t.e1), (t.e0, t.e1)] {
            // Further bisection would put a post at the middle of each side; none is active.
            let middle = Post::new((p.i + q.i) / 2, (p.j + q.j) / 2);
            let is_post = (p.i + q.i) % 2 == 0 && (p.j + q.j) % 2 == 0;
            assert!(!is_post || mesh.height(middle).is_none(), "T-junction at {middle:?}");
        }
    });
    assert_eq!(triangles, report.triangles);
    assert_eq!(area, 2 * i64::from(root.side()) * i64::from(root.side()));
    for p in set(mesh) {
        assert!(root.parents(p).all(|q| mesh.height(q).is_some()), "{p:?} without a parent");
    }
}

#[test]
fn any_sequence_of_views_gives_the_longest_prefix_that_fits() {
    for (nx, ny, seed) in [(65, 65, 1), (50, 33, 2), (33, 47, 3), (3, 2, 4), (2, 2, 5)] {
        let terrain = terrain(nx, ny, seed);
        let mut mesh = ViewMesh::new(Arc::clone(&terrain), SCALE).unwrap();
        for step in 0..60 {
            let camera = camera(&terrain, seed * 1000 + step);
            let n = 2 + (unit(seed, 50 + step) * unit(seed, 90 + step) * 3000.0) as u32;
            let target = if step % 5 == 0 {
                Target::ScreenError { px: 0.2 + 40.0 * unit(seed, 500 + step), max: n }
            } else {
                Target::TriangleBudget(n)
            };
            let report = mesh.update(&camera, target, &[]).unwrap();
            let (expected, bound) = longest_prefix(&terrain, &camera, target, &Regions::default());
            assert_eq!(set(&mesh), expected, "seed {seed}, step {step}");
            assert_eq!(report.bound_px.to_bits(), bound.to_bits(), "seed {seed}, step {step}");
            mesh.check();
            check_conforming(&mesh, &report);
        }
    }
}

#[test]
fn small_movements_give_the_same_as_from_scratch() {
    let terrain = terrain(200, 150, 7);
    let mut mesh = ViewMesh::new(Arc::clone(&terrain), SCALE).unwrap();
    let mut held: BTreeSet<Post> = BTreeSet::new();
    for step in 0..80 {
        let place = f64::from(step) * 15.0;
        let eye = DVec3::new(500.0 + place, 700.0 + 0.5 * place, 500.0);
        let rotation = DQuat::from_xyzw(0.6, 0.02 * f64::from(step), 0.0, 0.8).normalize();
        let projection = Projection::Perspective { tan_half_fov: 0.6, near_m: 1.0 };
        let camera = Camera::new(eye, rotation, projection, [640, 480]).unwrap();
        let target = Target::TriangleBudget(1500 + 700 * (step / 30 % 2));
        let report = mesh.update(&camera, target, &[]).unwrap();
        mesh.check();
        let mut scratch = ViewMesh::new(Arc::clone(&terrain), SCALE).unwrap();
        let from_scratch = scratch.update(&camera, target, &[]).unwrap();
        assert_eq!(mesh.active_posts(), scratch.active_posts());
        assert_eq!(report.bound_px.to_bits(), from_scratch.bound_px.to_bits());
        let max = if let Target::TriangleBudget(n) = target { n } else { 0 };
        assert!(report.triangles <= max && (report.triangles + 1 >= max || report.bound_px == 0.0));
        // The changes lead from frame to frame.
        assert!(report.removed.iter().all(|p| held.remove(p)));
        assert!(report.added.iter().all(|&p| held.insert(p)));
        assert_eq!(held, set(&mesh));
        // Nothing moved: nothing happens.
        let again = mesh.update(&camera, target, &[]).unwrap();
        assert_eq!(again.work, Work::default());
        assert!(again.added.is_empty() && again.removed.is_empty());
    }
}

/// Height of the mesh or of the finest surface at (x, y), by barycentric weights in the triangle that holds it.
fn height_in(t: &Triangle, z: [f64; 3], x: f64, y: f64) -> Option<f64> {
    let [a, b, c] = t.corners().map(|p| (f64::from(p.i), f64::from(p.j)));
    let area = |p: (f64, f64), q: (f64, f64), r: (f64, f64)| (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
    let w = [area(b, c, (x, y)), area(c, a, (x, y)), area(a, b, (x, y))];
    let total = area(a, b, c);
    w.iter().all(|&w| w >= 0.0).then(|| (w[0] * z[0] + w[1] * z[1] + w[2] * z[2]) / total)
}

#[test]
fn no_sampled_point_is_further_off_than_the_bound() {
    let terrain = terrain(65, 65, 11);
    let mut posts = Posts::new(&*terrain);
    let mut mesh = ViewMesh::new(Arc::clone(&terrain), SCALE).unwrap();
    let (mut finite, mut greatest_share) = (0, 0.0_f64);
    for step in 0..60_u64 {
        let camera = camera(&terrain, 40 + step);
        let n = 20 + (unit(3, step) * 1200.0) as u32;
        let report = mesh.update(&camera, Target::TriangleBudget(n), &[]).unwrap();
        let mut triangles = Vec::new();
        mesh.for_each_triangle(|t| triangles.push(t));
        for sample in 0..60 {
            // Posts have the greatest deviations, and are in no need of interpolation on the finest surface.
            let p = Post::new((unit(step, sample) * 65.0) as u32, (unit(step, 1000 + sample) * 65.0) as u32);
            let (x, y) = (f64::from(p.i), f64::from(p.j));
            let finest = DVec3::new(x, y, posts.at(p).unwrap().z);
            let drawn = triangles.iter().find_map(|t| height_in(t, t.corners().map(|c| mesh.height(c).unwrap()), x, y));
            let drawn = DVec3::new(x, y, drawn.unwrap());
            let [finest, drawn] = [finest, drawn].map(|p| SCALE.scene_from_grid(p));
            if let Some(distortion) = camera.distortion(finest, drawn) {
                assert!(distortion <= report.bound_px * (1.0 + 1e-9) + 1e-9, "step {step}: {distortion}, {report:?}");
                if report.bound_px.is_finite() {
                    finite += 1;
                    greatest_share = greatest_share.max(distortion / report.bound_px);
                }
            }
        }
    }
    assert!(finite > 100 && greatest_share > 0.1, "{finite} samples, at most {greatest_share} of the bound");
}

#[test]
fn a_view_holds_nothing_but_its_mesh() {
    // A flat terrain of 2^26 posts would not fit here as bounds of all diamonds; a small one stands for it: what is
    // held is bounded by the mesh.
    let terrain = terrain(257, 257, 5);
    let mut mesh = ViewMesh::new(Arc::clone(&terrain), SCALE).unwrap();
    for step in 0..100 {
        mesh.update(&camera(&terrain, step), Target::TriangleBudget(1000), &[]).unwrap();
    }
    assert!(mesh.posts_held() <= 4 * 1000, "{}", mesh.posts_held());
}

#[test]
fn targets_that_make_no_sense_are_refused() {
    let mut mesh = ViewMesh::new(terrain(5, 5, 1), SCALE).unwrap();
    let mut update = |target| mesh.update(&Camera::everywhere(), target, &[]).map(|r| r.triangles);
    assert_eq!(update(Target::TriangleBudget(1)), Err(MeshError::Budget(1)));
    assert_eq!(update(Target::ScreenError { px: 0.0, max: 10 }), Err(MeshError::ScreenError(0.0)));
    assert!(update(Target::ScreenError { px: f64::NAN, max: 10 }).is_err());
    assert_eq!(update(Target::TriangleBudget(2)), Ok(2));
    assert_eq!(update(Target::TriangleBudget(u32::MAX)), Ok(32));
}

#[test]
fn heights_beyond_f32_still_give_a_mesh() {
    let field = MemoryField::from_fn(9, 9, |i, j| Some(if (i * j) % 2 == 1 { 1e300 } else { -1e-300 })).unwrap();
    let terrain = Arc::new(MemoryTerrain::new(field, SCALE).unwrap());
    let mut mesh = ViewMesh::new(Arc::clone(&terrain), SCALE).unwrap();
    for step in 0..20 {
        let camera = camera(&terrain, step * 16 + 3);
        let report = mesh.update(&camera, Target::TriangleBudget(60), &[]).unwrap();
        assert!(!report.bound_px.is_nan());
        check_conforming(&mesh, &report);
    }
}
