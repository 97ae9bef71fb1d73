//! Refinement: the best mesh for a view and a triangle budget, incremental from frame to frame.
//!
//! Follows Duchaineau et al., "ROAMing Terrain" and "Good terrain geometry, cheap!", sections 4, 6 and 7: a split queue and
//! a merge queue over the bintree hierarchy, driven by a screen-space bound. It departs in three ways. The unit of both
//! queues is the diamond, named by its post, so there are no neighbour links and a mesh is a set of posts. The order
//! never ranks a child above its parent, so no split is ever forced, and the mesh is defined without reference to how
//! it was reached: the longest prefix of the order that fits. And required posts come before all others.

#[cfg(test)]
mod guarantees;
mod options;
mod preview;
mod queues;
mod reader;
mod requirements;
#[cfg(test)]
mod tests;
mod view_mesh;

use thiserror::Error;

use crate::{
    terrain::{HeightField, ReadError},
    wedgie::ErrorBounds,
};

pub use options::{MAX_REGIONS, Options, Region, Regions, RegionsError};
pub use preview::Preview;
pub use queues::Work;
pub use requirements::{Fidelity, RequiredLine};
pub use view_mesh::{MeshReport, ViewMesh};

/// Heights and bounds of one terrain.
pub trait Terrain: HeightField + ErrorBounds {}

impl<T: HeightField + ErrorBounds + ?Sized> Terrain for T {}

/// What refinement aims for.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Target {
    /// As good as a number of triangles allows. At least 2.
    TriangleBudget(u32),
    /// As few triangles as a distortion bound allows.
    ScreenError {
        /// The distortion aimed for in pixels (metres for a camera without an eye), finite and above 0.
        px: f64,
        /// Greatest number of triangles, at least 2.
        max: u32,
    },
}

/// Why a mesh could not be updated. The mesh stays what it was or becomes another valid one; the next update goes on
/// from there.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum MeshError {
    /// A mesh has at least the two triangles of the root square.
    #[error("a budget of {0} triangles; a mesh has at least 2")]
    Budget(u32),
    /// The distortion aimed for is not a positive number.
    #[error("a distortion of {0} pixels; it must be a finite number above 0")]
    ScreenError(f64),
    /// Heights or bounds could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

impl Target {
    /// The greatest number of triangles, and the priority above which a diamond is split.
    fn limits(self) -> Result<(u32, f64), MeshError> {
        let (max, px) = match self {
            Self::TriangleBudget(n) => (n, 0.0),
            Self::ScreenError { px, max } if px.is_finite() && px > 0.0 => (max, px),
            Self::ScreenError { px, .. } => return Err(MeshError::ScreenError(px)),
        };
        if max < 2 { Err(MeshError::Budget(max)) } else { Ok((max, px)) }
    }
}
