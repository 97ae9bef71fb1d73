//! What a database says of its terrain as a whole: one small envelope.

use serde::{Deserialize, Serialize};

use super::envelope::{self, EnvelopeError, Sealed};
use crate::terrain::{Georeference, Grid, SceneScale};

/// Greatest length of a manifest in bytes.
pub(super) const MANIFEST_LIMIT: usize = 1 << 20;

/// The terrain as a whole. Part of what the terrain version is a hash of.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct TerrainManifest {
    /// Posts from west to east.
    pub nx: u32,
    /// Posts from south to north.
    pub ny: u32,
    /// Metres per post east and north and per height unit.
    pub scale: SceneScale,
    /// Where the grid lies on Earth, if its source said so.
    pub georeference: Option<Georeference>,
    /// Least height of a post that is not void, in height units.
    pub lowest: i32,
    /// Greatest height of a post that is not void, in height units.
    pub highest: i32,
    /// Posts without data.
    pub void_posts: u64,
}

/// A terrain version as it is shown: hexadecimal digits.
pub fn version_digits(version: &[u8]) -> String {
    version.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Where the terrain came from. Not part of the terrain version.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Provenance {
    /// Names of the files that were ingested.
    pub sources: Vec<String>,
    /// The program that wrote the file.
    pub written_by: String,
    /// How void posts were filled for drawing.
    pub void_filling: String,
    /// Posts on which adjoining sources differed.
    pub seam_disagreements: u64,
}

/// The contents of the manifest section.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(super) struct Manifest {
    pub(super) terrain: TerrainManifest,
    pub(super) provenance: Provenance,
    /// xxh3 128 of the content, big-endian, as `FORMAT.md` says.
    pub(super) version: [u8; 16],
}

impl TerrainManifest {
    /// The bytes that the terrain version is a hash of, before those of the sections.
    pub(super) fn hashed_bytes(&self) -> Result<Vec<u8>, EnvelopeError> {
        envelope::encode(self)
    }

    /// What is wrong with it, if anything.
    pub(super) fn check(&self) -> Result<(), String> {
        let grid = Grid::new(self.nx, self.ny).map_err(|e| e.to_string())?;
        let SceneScale { east_m, north_m, up_m } = self.scale;
        let positive = |v: f64| v.is_finite() && v > 0.0;
        if ![east_m, north_m, up_m].into_iter().all(positive) {
            return Err(format!("the scale {east_m} x {north_m} x {up_m} m is not finite and above 0"));
        }
        if let Some(place) = &self.georeference
            && !(place.step.into_iter().all(positive) && place.origin.into_iter().all(f64::is_finite))
        {
            return Err("the georeference is not finite, or its step not above 0".into());
        }
        if self.lowest > self.highest {
            return Err(format!("the least height {} is above the greatest, {}", self.lowest, self.highest));
        }
        if self.void_posts >= grid.posts() {
            return Err(format!("{} of {} posts are void", self.void_posts, grid.posts()));
        }
        Ok(())
    }
}

impl Sealed for Manifest {
    const MAGIC: [u8; 8] = *b"SLDBmani";
    const VERSION: u32 = 1;

    fn check(&self) -> Result<(), String> {
        self.terrain.check()
    }
}
