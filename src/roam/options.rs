//! What may be asked of refinement beside camera and target: regions of interest, a cap on work, and what to leave out for
//! comparison.

use glam::{DVec2, DVec3};
use thiserror::Error;

/// Greatest number of regions of a view.
pub const MAX_REGIONS: usize = 64;
/// Greatest weight of a region.
const MAX_WEIGHT: f64 = 1_048_576.0;
/// Greatest radius of a region, and distance of its middle from post (0, 0) along an axis: as far as an eye may be.
const MAX_REACH_M: f64 = 1e8;

/// A disc in plan in which priorities count for more.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Region {
    /// Its middle, in metres east and north in the scene frame.
    pub centre_m: DVec2,
    /// Its radius in metres.
    pub radius_m: f64,
    /// What priorities are multiplied by, from 1 to 2^20.
    pub weight: f64,
}

/// Why regions were refused.
#[derive(Clone, Copy, PartialEq, Debug, Error)]
pub enum RegionsError {
    /// More than the limit.
    #[error("{0} regions; at most {MAX_REGIONS}")]
    TooMany(usize),
    /// One that makes no sense.
    #[error(
        "{0:?}: the middle must be within {MAX_REACH_M} m of 0, the radius from 0 to {MAX_REACH_M} m, the weight from 1 to {MAX_WEIGHT}"
    )]
    Region(Region),
}

/// Regions of interest.
///
/// A diamond's priority is multiplied by the greatest weight of a region that its ball reaches, or 1. A ball that holds
/// another one reaches whatever that one reaches (the margin by which balls are nested is above the rounding of the
/// distance), so its weight is not lower; products of numbers that are not negative keep their order, rounded. So no
/// child comes before its parent, with regions as without.
#[derive(Clone, PartialEq, Default, Debug)]
pub struct Regions(Vec<Region>);

impl Regions {
    /// Checks regions.
    pub fn new(regions: Vec<Region>) -> Result<Self, RegionsError> {
        if regions.len() > MAX_REGIONS {
            return Err(RegionsError::TooMany(regions.len()));
        }
        let sound = |r: &Region| {
            // Not a number is in no range.
            let near = -MAX_REACH_M..=MAX_REACH_M;
            near.contains(&r.centre_m.x)
                && near.contains(&r.centre_m.y)
                && (0.0..=MAX_REACH_M).contains(&r.radius_m)
                && (1.0..=MAX_WEIGHT).contains(&r.weight)
        };
        match regions.iter().find(|r| !sound(r)) {
            Some(&region) => Err(RegionsError::Region(region)),
            None => Ok(Self(regions)),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// What the priority of a ball is multiplied by.
    pub(super) fn weight(&self, centre: DVec3, radius_m: f64) -> f64 {
        let mut weight = 1.0_f64;
        for region in &self.0 {
            let (dx, dy) = (centre.x - region.centre_m.x, centre.y - region.centre_m.y);
            // Not `distance <= reach`: a ball of unknown extent reaches everything.
            let misses = (dx * dx + dy * dy).sqrt() > radius_m + region.radius_m;
            if !misses {
                weight = weight.max(region.weight);
            }
        }
        weight
    }
}

/// How a view is refined, beside its camera and target.
#[derive(Clone, PartialEq, Debug)]
pub struct Options {
    /// Where priorities count for more. The distortion bound is reported without their weights.
    pub regions: Regions,
    /// At most so many splits and merges an update that are done for a better mesh. Those done to come under the
    /// greatest number of triangles, or for sight lines, are not counted. With a cap the mesh depends on those before;
    /// where nothing changes it reaches, update by update, the one without.
    pub max_operations: Option<u32>,
    /// Whether priorities that cannot matter yet are put off. No result depends on it, only the work.
    pub deferral: bool,
    /// Whether a diamond is not tested against planes of the frustum that its parent is clear of. No result depends on
    /// it, only the work.
    pub inherited_culling: bool,
    /// Whether the mesh of one update leads to the next. No result depends on it without a cap, only the work.
    pub incremental: bool,
}

impl Default for Options {
    fn default() -> Self {
        let regions = Regions::default();
        Self { regions, max_operations: None, deferral: true, inherited_culling: true, incremental: true }
    }
}
