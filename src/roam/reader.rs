//! What refinement reads of a terrain: the height and the bounds of one post after another, mostly near the last ones.

use std::sync::Arc;

use glam::DVec3;
use sightline_proto::diamond::Post;

use super::Terrain;
use crate::{
    terrain::{Grid, HeightPage, PAGE_SIDE, PageId, ReadError, SceneScale},
    wedgie::{DiamondBounds, finest_bounds_with},
};

/// Pages of heights kept at hand, 4 by 2 of them: a split reads within a few posts of the last one, or elsewhere.
const HELD: usize = 8;

/// A reader of heights and bounds that keeps the last pages it met.
#[derive(Debug)]
pub(super) struct Reader<T> {
    terrain: Arc<T>,
    grid: Grid,
    scale: SceneScale,
    held: [Option<(PageId, Arc<HeightPage>)>; HELD],
}

impl<T: Terrain> Reader<T> {
    pub(super) fn new(terrain: Arc<T>, scale: SceneScale) -> Self {
        let grid = terrain.grid();
        Self { terrain, grid, scale, held: [const { None }; HELD] }
    }

    pub(super) fn terrain(&self) -> &Arc<T> {
        &self.terrain
    }

    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    pub(super) fn scale(&self) -> SceneScale {
        self.scale
    }

    /// Thickness, centre and radius in metres in the scene frame of what bounds the diamond at `p`, whose height and bounds
    /// are given.
    #[inline]
    pub(super) fn ball(&self, p: Post, z: f64, nested: f32, radius_m: f32) -> (f64, DVec3, f64) {
        let at = DVec3::new(f64::from(p.i), f64::from(p.j), z);
        (f64::from(nested) * self.scale.up_m, self.scale.scene_from_grid(at), f64::from(radius_m))
    }

    /// The drawn height of a post of the root square and the bounds of its diamond.
    pub(super) fn read(&mut self, p: Post) -> Result<(f64, DiamondBounds), ReadError> {
        if (p.i | p.j) % 2 == 1 {
            // Three quarters of all posts: their bounds follow from a few heights, which are at hand.
            let z = self.height(self.grid.clamp(p))?;
            return Ok((z, finest_bounds_with(self.grid, self.scale, p, |q| self.height(q))?));
        }
        // In its page of heights a post is far from all others that the mesh has there, the coarser the farther.
        let (bounds, z) = self.terrain.bounds_and_height(p)?;
        let z = z.map_or_else(|| self.height(self.grid.clamp(p)), Ok)?;
        Ok((z, bounds))
    }

    /// The drawn height of a post of the grid.
    #[inline]
    pub(super) fn height(&mut self, p: Post) -> Result<f64, ReadError> {
        let id = PageId::of(p);
        let slot = &mut self.held[(id.pi % 4 + id.pj % 2 * 4) as usize];
        let page = match slot {
            Some((held, page)) if *held == id => page,
            _ => &slot.insert((id, self.terrain.page(id)?)).1,
        };
        Ok(page.at(p.i % PAGE_SIDE, p.j % PAGE_SIDE).z)
    }
}
