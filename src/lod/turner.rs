//! Split-only ROAM, after Turner, "Real-Time Dynamic Level of Detail Terrain Rendering with ROAM", 2000, as Inam's thesis
//! (2005), section 2.2.1, and White's "GEOmancy", section 1, describe it (Treadmarks refines the same way).
//!
//! Every frame starts from two triangles again. From the roots down, a triangle is split when its variance over its
//! distance exceeds the frame's threshold; neighbours are split by force. Variance is the distance of the base's midpoint
//! from the terrain, or the greater one of its children: found beforehand for the whole implicit tree. The distance is that of the
//! base's midpoint in the ground plane, one post added.
//!
//! It departs in keeping one tree of full depth (Turner cuts the terrain into patches and the variance tree after a few
//! levels), in variances that are floats, and in a threshold that is found for each frame, not steered from
//! frame to frame. As in the original, children that a forced split made are not looked at again.

use std::sync::Arc;

use super::{
    Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target,
    bintree::{Bintree, Change, ImplicitTree, middle},
    mesh::MeshBuilder,
};

/// The range of the threshold in pixels.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1e6, fine: 1e-6 };

/// A prepared split-only ROAM.
#[derive(Debug)]
pub struct SplitOnly {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    variance_m: ImplicitTree,
    tree: Bintree,
}

/// The variance of every triangle in metres.
pub(super) fn variances(ground: &Ground) -> ImplicitTree {
    ImplicitTree::new(ground.side(), |tri, m, children| {
        let [_, left, right] = tri.corners.map(|p| ground.z(p.i, p.j));
        let own = (ground.z(m.i, m.j) - 0.5 * (left + right)).abs() * ground.scale().up_m;
        (own as f32).max(children[0]).max(children[1])
    })
}

impl SplitOnly {
    /// Computes all variances.
    pub fn new(ground: Arc<Ground>) -> Self {
        let (builder, tree) = (MeshBuilder::new(ground.side()), Bintree::new(ground.side()));
        let variance_m = variances(&ground);
        Self { ground, builder, variance_m, tree }
    }

    /// Builds the mesh anew; returns the number of triangles looked at.
    fn tessellate(&mut self, view: &LodView, threshold_px: f64) -> u64 {
        self.tree.reset();
        let mut decisions = 0;
        let mut stack = vec![1, 0];
        while let Some(t) = stack.pop() {
            decisions += 1;
            if self.error_px(t, view) <= threshold_px {
                continue;
            }
            self.tree.split(t);
            let child = self.tree.get(t).child;
            if !self.tree.is_leaf(t) {
                stack.extend([child + 1, child]);
            }
        }
        decisions
    }

    /// Variance over distance, in pixels.
    fn error_px(&self, t: u32, view: &LodView) -> f64 {
        let tri = self.tree.get(t);
        let Some(m) = middle(tri) else { return 0.0 };
        let scale = self.ground.scale();
        let to = self.ground.scene(m.i, m.j) - view.eye();
        let distance = scale.east_m.max(scale.north_m) + (to.x * to.x + to.y * to.y).sqrt();
        f64::from(self.variance_m.get(tri)) * view.pixels() / distance
    }
}

impl LevelOfDetail for SplitOnly {
    /// The setting is the threshold in pixels. It is not a bound: the height of the eye does not count, and the
    /// variance is taken at midpoints only.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        let threshold = match target {
            Target::Setting(threshold) => RANGE.check(threshold)?,
            Target::Triangles(most) => RANGE.steer(most, |threshold| {
                self.tessellate(view, threshold);
                Ok(self.tree.leaves())
            })?,
        };
        let decisions = self.tessellate(view, threshold);
        let splits = self.tree.changes.iter().filter(|c| matches!(c, Change::Split(_))).count() as u64;
        let ground = &self.ground;
        let mesh = self.builder.build([ground.side(); 2], &self.tree.triangles(), |p| ground.z(p.i, p.j));
        let statistics = Statistics { setting: threshold, decisions, splits, ..Statistics::default() };
        Ok(Frame { mesh, bound_px: None, statistics })
    }

    fn memory_bytes(&self) -> usize {
        self.variance_m.bytes() + self.tree.bytes() + self.builder.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{MemoryField, SceneScale};

    #[test]
    fn variances_of_a_3_by_3_terrain_by_hand() {
        // North row first: 0 0 4 / 0 7 1 / 2 0 0. South-eastern root: base from (2, 2) to (0, 0).
        let heights = [[2.0, 0.0, 0.0], [0.0, 7.0, 1.0], [0.0, 0.0, 4.0]];
        let field = MemoryField::from_fn(3, 3, |i, j| Some(heights[j as usize][i as usize])).unwrap();
        let system = SplitOnly::new(Ground::read(&field, SceneScale::UNIT).unwrap());
        // Its base's middle is 7, the ends' mean (4 + 2) / 2 = 3: 4. Children: east (4 + 0) / 2 = 2 against 1; south
        // (2 + 0) / 2 = 1 against 0. So 4, 1 and 1. The north-western root: 4 too; west 1 against 0; north 2 against 0.
        let of = |root: u32| system.variance_m.get(system.tree.get(root));
        assert_eq!([of(0), of(1)], [4.0, 4.0]);
        let mut tree = system.tree.clone();
        tree.split(0);
        let children = [0, 1].map(|root| [0, 1].map(|n| system.variance_m.get(tree.get(tree.get(root).child + n))));
        assert_eq!(children, [[1.0, 1.0], [1.0, 2.0]]);
        // Seen from 9 posts beside the middle, at 600 / (2 * 0.5) pixels: 4 * 600 / (1 + 9) = 240 pixels.
        let view =
            LodView::new(glam::DVec3::new(10.0, 1.0, 50.0), glam::DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
        assert_eq!(system.error_px(0, &view), 240.0);
    }
}
