//! The terrain as the requirements read it: any triangle of the hierarchy in space, with its thickness.

use std::cell::RefCell;

use sightline_proto::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
};

use crate::{
    roam::Terrain,
    terrain::{Grid, PageId, Posts, ReadError},
    wedgie::DiamondBounds,
};

/// A reader of one terrain. Also the mesh of all posts, which is the finest surface with voids filled in.
pub(super) struct Ground<'a, T: Terrain> {
    terrain: &'a T,
    grid: Grid,
    posts: RefCell<Posts<'a, T>>,
    /// The first failure of a read that could not say so itself.
    failure: RefCell<Option<ReadError>>,
}

impl<'a, T: Terrain> Ground<'a, T> {
    pub(super) fn new(terrain: &'a T) -> Self {
        let posts = RefCell::new(Posts::new(terrain));
        Self { terrain, grid: terrain.grid(), posts, failure: RefCell::new(None) }
    }

    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    /// The drawn height of a post of the root square: from its page of heights where that is in memory or holds others near
    /// it, else from beside its bounds.
    fn drawn(&self, p: Post) -> Result<f64, ReadError> {
        let is_coarse = (p.i | p.j).is_multiple_of(2) && !self.grid.root().is_corner(p);
        if is_coarse
            && self.terrain.resident(PageId::of(self.grid.clamp(p))).is_none()
            && let (_, Some(z)) = self.terrain.bounds_and_height(p)?
        {
            return Ok(z);
        }
        Ok(self.posts.borrow_mut().at(p)?.z)
    }

    pub(super) fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError> {
        self.terrain.bounds(p)
    }

    /// The corners of `t` in the grid frame, counter-clockwise.
    pub(super) fn in_space(&self, t: &Triangle) -> Result<[[f64; 3]; 3], ReadError> {
        let mut corners = [[0.0; 3]; 3];
        for (slot, p) in corners.iter_mut().zip(t.corners()) {
            *slot = [f64::from(p.i), f64::from(p.j), self.drawn(p)?];
        }
        Ok(corners)
    }

    pub(super) fn terrain(&self) -> &'a T {
        self.terrain
    }

    /// `value`, unless a read failed since this was last asked.
    pub(super) fn checked<V>(&self, value: V) -> Result<V, ReadError> {
        self.failure.borrow_mut().take().map_or(Ok(value), Err)
    }
}

impl<T: Terrain> Mesh for Ground<'_, T> {
    fn root(&self) -> RootSquare {
        self.grid.root()
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.grid.nx(), self.grid.ny())
    }

    fn height(&self, p: Post) -> Option<f64> {
        match self.drawn(p) {
            Ok(z) => Some(z),
            Err(error) => {
                self.failure.borrow_mut().get_or_insert(error);
                Some(0.0)
            }
        }
    }
}

/// The plane through `corners`, raised by `by` (lowered when negative) and rounded outward; `None` when that is no
/// finite plane.
pub(super) fn moved(corners: [[f64; 3]; 3], by: f64) -> Option<[[f64; 3]; 3]> {
    let moved = corners.map(|[x, y, z]| {
        let sum = z + by;
        // TwoSum (Knuth): the part of the exact sum that rounding lost.
        let part = sum - z;
        let lost = (z - (sum - part)) + (by - part);
        let outward = match (lost > 0.0, lost < 0.0) {
            (true, _) if by > 0.0 => sum.next_up(),
            (_, true) if by < 0.0 => sum.next_down(),
            _ => sum,
        };
        [x, y, outward]
    });
    moved.iter().all(|corner| corner[2].is_finite()).then_some(moved)
}
