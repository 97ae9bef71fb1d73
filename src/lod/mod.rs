//! The other level-of-detail systems of the papers, built to be compared with this project's own.
//!
//! One trait, [`LevelOfDetail`]: view and target in; mesh, bound and statistics out. One closed enum, [`System`], with one
//! file per system, which opens with its paper and where it departs. None of them is a setting of our refinement: this
//! module does not import `roam`. All give the same kind of mesh ([`IndexedMesh`]) and are measured by the same
//! functions: [`conformity`], [`measure`] (vertical error) and [`sight`] (exact verdicts of sight lines).
//!
//! Meshes are of the whole terrain: what lies outside the view is asked about too, by sight lines between others. What
//! culling would spare a renderer is counted by [`IndexedMesh::drawn`].

mod bintree;
mod blow;
pub mod conformity;
mod full;
mod geomancy;
mod geomipmap;
mod improved_geomipmap;
pub mod measure;
mod mesh;
mod published;
mod quadtree;
pub mod sight;
mod steer;
pub mod strips;
mod terrain;
#[cfg(test)]
mod tests;
mod tiles;
mod tstrip;
pub mod tstrip_fill;
mod tstrip_walk;
mod turner;

use std::sync::Arc;

use thiserror::Error;

use crate::terrain::ReadError;

pub use blow::NestedSpheres;
pub use full::Full;
pub use geomancy::Geomancy;
pub use geomipmap::GeoMipMap;
pub use improved_geomipmap::ImprovedGeoMipMap;
pub use mesh::{IndexedMesh, Vertex, changed};
pub use published::Published;
pub use quadtree::Quadtree;
pub use steer::SettingRange;
pub use terrain::{Ground, LodView, MAX_SIDE};
pub use tiles::TILE_CELLS;
pub use tstrip::{Metric, TStrip};
pub use tstrip_walk::SectorMaxima;
pub use turner::SplitOnly;

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
    /// By how many triangles the budget was exceeded on the way, at most.
    pub overrun: u64,
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

    /// Whether vertices move gradually between levels of detail, in systems that can; off at first, so that vertices lie
    /// on the terrain.
    fn set_morph(&mut self, _morph: bool) {}
}

/// Which system.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub enum Algorithm {
    /// Every post.
    Full,
    /// Roettger's continuous level of detail.
    Quadtree,
    /// De Boer's geometrical mipmaps.
    GeoMipMap,
    /// Geometrical mipmaps as Ye and Wang improved them.
    ImprovedGeoMipMap,
    /// Szoka's lines of blocks.
    TStrip,
    /// White's tiled ROAM.
    Geomancy,
    /// Turner's split-only ROAM.
    SplitOnly,
    /// Blow's nested spheres.
    NestedSpheres,
    /// ROAM as published.
    Published,
}

impl Algorithm {
    /// All systems.
    pub const ALL: [Self; 9] = [
        Self::Full,
        Self::Quadtree,
        Self::GeoMipMap,
        Self::ImprovedGeoMipMap,
        Self::TStrip,
        Self::Geomancy,
        Self::SplitOnly,
        Self::NestedSpheres,
        Self::Published,
    ];

    /// A short name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full resolution",
            Self::Quadtree => "quadtree (Roettger)",
            Self::GeoMipMap => "GeoMipMap (de Boer)",
            Self::ImprovedGeoMipMap => "improved GeoMipMap (Ye and Wang)",
            Self::TStrip => "T-Strip (Szoka)",
            Self::Geomancy => "GEOmancy (White)",
            Self::SplitOnly => "split-only ROAM (Turner)",
            Self::NestedSpheres => "nested spheres (Blow)",
            Self::Published => "ROAM as published (Duchaineau)",
        }
    }

    /// What the system's setting is, and its unit.
    pub fn setting(self) -> &'static str {
        match self {
            Self::Full => "none",
            Self::Quadtree => "desired global resolution c",
            Self::GeoMipMap => "error tau in pixels",
            Self::ImprovedGeoMipMap => "error tau in pixels, at about a metre of deviation",
            Self::TStrip => "LOD ratio in blocks",
            Self::Geomancy => "threshold in pixels",
            Self::SplitOnly => "threshold in pixels",
            Self::NestedSpheres => "error tau in pixels",
            Self::Published => "triangle budget",
        }
    }

    /// The range of the setting.
    pub fn range(self) -> SettingRange {
        match self {
            Self::Full => SettingRange { coarse: 1.0, fine: 1.0 },
            Self::Quadtree => quadtree::RANGE,
            Self::GeoMipMap => geomipmap::RANGE,
            Self::ImprovedGeoMipMap => improved_geomipmap::RANGE,
            Self::TStrip => tstrip::RANGE,
            Self::Geomancy => geomancy::RANGE,
            Self::SplitOnly => turner::RANGE,
            Self::NestedSpheres => blow::RANGE,
            Self::Published => published::RANGE,
        }
    }

    /// Prepares the system for a terrain: what its paper computes beforehand.
    pub fn prepare(self, ground: &Arc<Ground>) -> System {
        let ground = Arc::clone(ground);
        match self {
            Self::Full => System::Full(Full::new(ground)),
            Self::Quadtree => System::Quadtree(Quadtree::new(ground, quadtree::MINIMUM_RESOLUTION)),
            Self::GeoMipMap => System::GeoMipMap(GeoMipMap::new(ground)),
            Self::ImprovedGeoMipMap => System::ImprovedGeoMipMap(ImprovedGeoMipMap::new(ground)),
            Self::TStrip => System::TStrip(TStrip::new(ground, tstrip::Metric::Distance)),
            Self::Geomancy => System::Geomancy(Geomancy::new(ground)),
            Self::SplitOnly => System::SplitOnly(SplitOnly::new(ground)),
            Self::NestedSpheres => System::NestedSpheres(NestedSpheres::new(ground)),
            Self::Published => System::Published(Box::new(Published::new(ground))),
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
    /// De Boer's geometrical mipmaps.
    GeoMipMap(GeoMipMap),
    /// Geometrical mipmaps as Ye and Wang improved them.
    ImprovedGeoMipMap(ImprovedGeoMipMap),
    /// Szoka's lines of blocks.
    TStrip(TStrip),
    /// White's tiled ROAM.
    Geomancy(Geomancy),
    /// Turner's split-only ROAM.
    SplitOnly(SplitOnly),
    /// Blow's nested spheres.
    NestedSpheres(NestedSpheres),
    /// ROAM as published.
    Published(Box<Published>),
}

impl System {
    fn inner(&mut self) -> &mut dyn LevelOfDetail {
        match self {
            Self::Full(system) => system,
            Self::Quadtree(system) => system,
            Self::GeoMipMap(system) => system,
            Self::ImprovedGeoMipMap(system) => system,
            Self::TStrip(system) => system,
            Self::Geomancy(system) => system,
            Self::SplitOnly(system) => system,
            Self::NestedSpheres(system) => system,
            Self::Published(system) => system.as_mut(),
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
            Self::GeoMipMap(system) => system.memory_bytes(),
            Self::ImprovedGeoMipMap(system) => system.memory_bytes(),
            Self::TStrip(system) => system.memory_bytes(),
            Self::Geomancy(system) => system.memory_bytes(),
            Self::SplitOnly(system) => system.memory_bytes(),
            Self::NestedSpheres(system) => system.memory_bytes(),
            Self::Published(system) => system.memory_bytes(),
        }
    }

    fn set_morph(&mut self, morph: bool) {
        self.inner().set_morph(morph);
    }
}
