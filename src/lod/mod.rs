//! The other level-of-detail systems of the papers, built to be compared with this project's own.
//!
//! One trait, [`LevelOfDetail`]: view and target in; mesh, bound and statistics out. One closed enum, [`System`], with one
//! file per system, which opens with its paper and where it departs. None of them is a setting of our refinement: this
//! module does not import `roam`. All give the same kind of mesh ([`IndexedMesh`]) and are measured by the same
//! functions: [`conformity`], [`measure`] (vertical error) and [`sight`] (exact verdicts of sight lines).
//!
//! Meshes are of the whole terrain: what lies outside the view is asked about too, by sight lines between others. What
//! culling would spare a renderer is counted by [`IndexedMesh::drawn`].

pub mod conformity;
mod full;
pub mod measure;
mod mesh;
mod quadtree;
pub mod sight;
mod steer;
mod terrain;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use thiserror::Error;

use crate::terrain::ReadError;

pub use full::Full;
pub use mesh::{IndexedMesh, Vertex, changed};
pub use quadtree::Quadtree;
pub use steer::SettingRange;
pub use terrain::{Ground, LodView, MAX_SIDE};

/// What a system aims for.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Target {
    /// At most this many triangles, if the system can do with so few: it gives its coarsest mesh otherwise.
    Triangles(u32),
    /// The system's own setting; see [`Algorithm::setting`].
    Setting(f64),
}

/// Why a system gave no mesh.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum LodError {
    /// The setting is out of range.
    #[error("a setting of {setting}; it must be from {least} to {greatest}")]
    Setting {
        /// What was given.
        setting: f64,
        /// The least that is accepted.
        least: f64,
        /// The greatest that is accepted.
        greatest: f64,
    },
    /// The terrain does not fit one array.
    #[error(
        "a root square of {side} cells a side; the systems for comparison hold at most {MAX_SIDE}: cut the terrain"
    )]
    TooLarge {
        /// Cells a side.
        side: u32,
    },
    /// Heights could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// What one update gives.
#[derive(Clone, PartialEq, Debug)]
pub struct Frame {
    /// The mesh.
    pub mesh: IndexedMesh,
    /// The screen-space error in pixels that the system promises, if it promises any. A promise, not a proof: the report
    /// compares it with what is measured.
    pub bound_px: Option<f64>,
    /// What the update did.
    pub statistics: Statistics,
}

/// What an update did. Counts that a system does not have are 0.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Statistics {
    /// The setting used.
    pub setting: f64,
    /// Decisions about level of detail: blocks, tiles or triangles tested against the metric.
    pub decisions: u64,
    /// Triangles or diamonds split, forced ones included.
    pub splits: u64,
    /// Triangles or diamonds merged.
    pub merges: u64,
    /// Tiles whose triangles differ from those of the frame before.
    pub dirty_tiles: u64,
    /// Bytes of index buffers sent again.
    pub index_bytes: u64,
    /// Triangle strips of the system's own making.
    pub strips: u64,
    /// Triangle fans of the system's own making.
    pub fans: u64,
}

/// A system of the papers, prepared for one terrain.
pub trait LevelOfDetail {
    /// The mesh for a view. The same sequence of calls gives the same meshes, bit for bit.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError>;

    /// Bytes held besides the height map.
    fn memory_bytes(&self) -> usize;
}

/// Which system.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub enum Algorithm {
    /// Every post.
    Full,
    /// Roettger's continuous level of detail.
    Quadtree,
}

impl Algorithm {
    /// All systems.
    pub const ALL: [Self; 2] = [Self::Full, Self::Quadtree];

    /// A short name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full resolution",
            Self::Quadtree => "quadtree (Roettger)",
        }
    }

    /// What the system's setting is, and its unit.
    pub fn setting(self) -> &'static str {
        match self {
            Self::Full => "none",
            Self::Quadtree => "desired global resolution c",
        }
    }

    /// The range of the setting.
    pub fn range(self) -> SettingRange {
        match self {
            Self::Full => SettingRange { coarse: 1.0, fine: 1.0 },
            Self::Quadtree => quadtree::RANGE,
        }
    }

    /// Prepares the system for a terrain: what its paper computes beforehand.
    pub fn prepare(self, ground: &Arc<Ground>) -> System {
        let ground = Arc::clone(ground);
        match self {
            Self::Full => System::Full(Full::new(ground)),
            Self::Quadtree => System::Quadtree(Quadtree::new(ground, quadtree::MINIMUM_RESOLUTION)),
        }
    }
}

/// A prepared system.
#[derive(Debug)]
pub enum System {
    /// Every post.
    Full(Full),
    /// Roettger's continuous level of detail.
    Quadtree(Quadtree),
}

impl System {
    fn inner(&mut self) -> &mut dyn LevelOfDetail {
        match self {
            Self::Full(system) => system,
            Self::Quadtree(system) => system,
        }
    }
}

impl LevelOfDetail for System {
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        self.inner().update(view, target)
    }

    fn memory_bytes(&self) -> usize {
        match self {
            Self::Full(system) => system.memory_bytes(),
            Self::Quadtree(system) => system.memory_bytes(),
        }
    }
}
