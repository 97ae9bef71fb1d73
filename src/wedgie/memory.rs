//! A terrain held in memory with its bounds: for tests, conformance grids and synthetic terrain.

use std::sync::Arc;

use sightline_proto::diamond::Post;

use super::{BoundsPyramid, DiamondBounds, ErrorBounds, finest_bounds_with};
use crate::terrain::{
    Grid, HeightField, HeightPage, MemoryField, PAGE_SIDE, PageId, ReadError, SceneScale, extremes::ExtremesPage,
};

/// A height field in memory, with the bounds of all its diamonds.
#[derive(Clone, Debug)]
pub struct MemoryTerrain {
    field: MemoryField,
    pyramid: BoundsPyramid,
    scale: SceneScale,
}

impl MemoryTerrain {
    /// Computes the bounds of `field`.
    pub fn new(field: MemoryField, scale: SceneScale) -> Result<Self, ReadError> {
        let pyramid = BoundsPyramid::compute(&field, scale)?;
        Ok(Self { field, pyramid, scale })
    }

    /// The heights alone.
    pub fn field(&self) -> &MemoryField {
        &self.field
    }

    /// Metres per post and per height unit.
    pub fn scale(&self) -> SceneScale {
        self.scale
    }

    /// Bytes of the bounds.
    pub fn bounds_bytes(&self) -> usize {
        self.pyramid.lattices().iter().map(|lattice| size_of_val(lattice.bounds())).sum()
    }
}

impl HeightField for MemoryTerrain {
    fn grid(&self) -> Grid {
        self.field.grid()
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        self.field.page(id)
    }

    #[inline]
    fn resident(&self, id: PageId) -> Option<&HeightPage> {
        self.field.resident(id)
    }

    fn extremes(&self, level: u32, id: PageId) -> Result<Option<Arc<ExtremesPage>>, ReadError> {
        self.field.extremes(level, id)
    }
}

impl ErrorBounds for MemoryTerrain {
    fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError> {
        match self.pyramid.get(p) {
            Some(bounds) => Ok(bounds),
            None => finest_bounds_with(self.field.grid(), self.scale, p, |q| {
                Ok(self.field.page(PageId::of(q))?.at(q.i % PAGE_SIDE, q.j % PAGE_SIDE).z)
            }),
        }
    }
}
