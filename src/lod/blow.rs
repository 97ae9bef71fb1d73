//! Nested spheres, after Blow (GDC 2000), as Inam's thesis (2005), section 2.2.1, restates it.
//!
//! For a threshold tau, the eyes from which a vertex matters fill a solid around it, taken to be a sphere: its radius is
//! the vertex's height above the edge that it would split, times pixels over tau. The sphere of a diamond contains those
//! of all diamonds below it, so one test at a node stands for its whole subtree, and the eye inside a sphere means
//! split. The spheres keep all three dimensions of the data where an error per triangle keeps one.
//!
//! Since a diamond's sphere lies within those of both its parents, no split is ever forced.
//!
//! It departs in recomputing the spheres when tau or the zoom changes (they do not just scale, once nested), in leaving out
//! the clustering of spheres, which saves tests, not triangles, and in starting from the root every frame: the
//! mesh for an eye is the same.

use std::sync::Arc;

use sightline_proto::diamond::{Post, RootSquare, Triangle};

use super::{Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target, mesh::MeshBuilder};

/// The range of tau in pixels.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1e6, fine: 1e-6 };

/// Widens a sphere around others. Rounding in a distance and a sum is below 2^-50 of the result, so a child's sphere
/// lies within its parent's as computed, and an eye in the one is in the other.
const MARGIN: f64 = 1.0 + 1e-12;

/// A prepared terrain with nested spheres.
#[derive(Debug)]
pub struct NestedSpheres {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    root: RootSquare,
    /// Pixels over tau for which the radii were computed.
    factor: f64,
    /// The radius of every post's sphere in metres; 0 where nothing below the post matters.
    radius_m: Vec<f64>,
}

impl NestedSpheres {
    /// Computes nothing yet: spheres depend on the threshold.
    pub fn new(ground: Arc<Ground>) -> Self {
        let builder = MeshBuilder::new(ground.side());
        let root = ground.grid().root();
        let radius_m = vec![0.0; (ground.side() as usize + 1).pow(2)];
        Self { ground, builder, root, factor: f64::NAN, radius_m }
    }

    /// Computes all spheres, finest diamonds first.
    fn nest(&mut self, factor: f64) {
        if self.factor == factor {
            return;
        }
        self.factor = factor;
        let side = self.ground.side();
        let mut half = 1;
        while half < side {
            // The children of tilted diamonds are square ones of half their size, those of square ones tilted.
            for square in [false, true] {
                for j in (0..=side).step_by(half as usize) {
                    for i in (0..=side).step_by(half as usize) {
                        let odd = [i / half % 2 == 1, j / half % 2 == 1];
                        if (odd == [true, true]) == square && odd != [false, false] {
                            self.nest_one(Post::new(i, j));
                        }
                    }
                }
            }
            half *= 2;
        }
    }

    fn nest_one(&mut self, p: Post) {
        let mut radius = self.own_radius(p);
        for child in self.root.children(p) {
            let inner = self.radius_m[self.ground.index(child.i, child.j)];
            if inner > 0.0 {
                let distance = (self.ground.scene(p.i, p.j) - self.ground.scene(child.i, child.j)).length();
                radius = radius.max((distance + inner) * MARGIN);
            }
        }
        let n = self.ground.index(p.i, p.j);
        self.radius_m[n] = radius;
    }

    /// The radius of a vertex alone: its height above the edge that it splits, times pixels over tau.
    fn own_radius(&self, p: Post) -> f64 {
        let Some([e0, e1]) = self.root.base_ends(p) else { return 0.0 };
        let middle = 0.5 * (self.ground.z(e0.i, e0.j) + self.ground.z(e1.i, e1.j));
        (self.ground.z(p.i, p.j) - middle).abs() * self.ground.scale().up_m * self.factor
    }

    fn triangles(&mut self, view: &LodView, tau_px: f64) -> (Vec<[Post; 3]>, u64) {
        self.nest(view.pixels() / tau_px);
        let (mut out, mut decisions) = (Vec::new(), 0);
        let mut stack: Vec<Triangle> = self.root.roots().into_iter().rev().collect();
        while let Some(t) = stack.pop() {
            decisions += 1;
            let inside = |m: &Post| {
                let radius = self.radius_m[self.ground.index(m.i, m.j)];
                (self.ground.scene(m.i, m.j) - view.eye()).length() < radius
            };
            match t.base_midpoint().filter(inside) {
                Some(m) => stack.extend(t.children(m).into_iter().rev()),
                None => out.push(t.corners()),
            }
        }
        (out, decisions)
    }
}

impl LevelOfDetail for NestedSpheres {
    /// The setting is tau in pixels. A vertex that is left out is at most tau from its edge; that is not a bound on the
    /// surface, whose errors add up over the levels.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        let tau = match target {
            Target::Setting(tau) => RANGE.check(tau)?,
            Target::Triangles(most) => RANGE.steer(most, |tau| Ok(self.triangles(view, tau).0.len()))?,
        };
        let (triangles, decisions) = self.triangles(view, tau);
        let ground = &self.ground;
        let mesh = self.builder.build([ground.side(); 2], &triangles, |p| ground.z(p.i, p.j));
        let statistics = Statistics { setting: tau, decisions, ..Statistics::default() };
        Ok(Frame { mesh, bound_px: None, statistics })
    }

    fn memory_bytes(&self) -> usize {
        size_of_val(self.radius_m.as_slice()) + self.builder.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{MemoryField, SceneScale, synthetic::fractal};

    #[test]
    fn spheres_of_a_3_by_3_terrain_by_hand() {
        // Flat but for the middle of the eastern edge, 3 high, and the centre, 1 high; corners 0.
        let field = MemoryField::from_fn(3, 3, |i, j| {
            Some(if (i, j) == (2, 1) { 3.0 } else { f64::from(u8::from((i, j) == (1, 1))) })
        })
        .unwrap();
        let mut system = NestedSpheres::new(Ground::read(&field, SceneScale::UNIT).unwrap());
        system.nest(10.0);
        let radius = |i, j| system.radius_m[system.ground.index(i, j)];
        // The edge's vertex: 3 * 10. The centre alone: 1 * 10; but it contains the edge's, sqrt(1 + 4) away.
        assert_eq!(radius(2, 1), 30.0);
        assert!((radius(1, 1) - (5.0_f64.sqrt() + 30.0)).abs() < 1e-9);
        assert_eq!([radius(1, 0), radius(0, 1), radius(1, 2)], [0.0; 3]);
    }

    #[test]
    fn every_sphere_contains_those_below_it() {
        let ground = Ground::read(&fractal(65, 65, 2, 500).unwrap(), SceneScale::UNIT).unwrap();
        let mut system = NestedSpheres::new(ground);
        system.nest(200.0);
        for j in 0..=64 {
            for i in 0..=64 {
                let p = Post::new(i, j);
                let at = |p: Post| (system.ground.scene(p.i, p.j), system.radius_m[system.ground.index(p.i, p.j)]);
                for child in system.root.children(p) {
                    let ((c, r), (c0, r0)) = (at(p), at(child));
                    assert!(r0 == 0.0 || (c - c0).length() + r0 <= r, "{p:?} {child:?}");
                }
            }
        }
    }
}
