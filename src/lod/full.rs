//! Full resolution: every post, the finest surface itself. What all others are measured against.
//!
//! The "brute force approach" of Ye and Wang, "View-dependent Real-time Terrain Rendering Using Static LOD", section
//! 2.5. It departs in the diagonals of its cells, which are those of the finest surface.

use std::sync::Arc;

use sightline_proto::diamond::{Post, diagonal_rises};

use super::{Frame, Ground, LevelOfDetail, LodError, LodView, Statistics, Target, mesh::MeshBuilder};

/// All posts of the grid.
#[derive(Debug)]
pub struct Full {
    ground: Arc<Ground>,
    builder: MeshBuilder,
}

impl Full {
    /// Needs no preparation.
    pub fn new(ground: Arc<Ground>) -> Self {
        let builder = MeshBuilder::new(ground.side());
        Self { ground, builder }
    }
}

impl LevelOfDetail for Full {
    /// Every target gives the same mesh.
    fn update(&mut self, _view: &LodView, _target: Target) -> Result<Frame, LodError> {
        let grid = self.ground.grid();
        let mut triangles = Vec::with_capacity(2 * grid.posts() as usize);
        for j in 0..grid.ny() - 1 {
            for i in 0..grid.nx() - 1 {
                let [sw, se] = [Post::new(i, j), Post::new(i + 1, j)];
                let [nw, ne] = [Post::new(i, j + 1), Post::new(i + 1, j + 1)];
                triangles.extend(if diagonal_rises(sw) {
                    [[sw, se, ne], [sw, ne, nw]]
                } else {
                    [[sw, se, nw], [se, ne, nw]]
                });
            }
        }
        let extent = [grid.nx() - 1, grid.ny() - 1];
        let mesh = self.builder.build(extent, &triangles, |p| self.ground.z(p.i, p.j));
        Ok(Frame { mesh, bound_px: Some(0.0), statistics: Statistics::default() })
    }

    fn memory_bytes(&self) -> usize {
        self.builder.bytes()
    }
}
