//! Positions as callers give them, and how they become points of the grid frame: once, in f64 (DESIGN 2).
//!
//! The verdict is exact for the resolved point, which every reply carries, so the rounding here is seen by everyone
//! alike and by no one twice.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Entity, SightLine};

use crate::{
    los::{self, LosError},
    terrain::{Georeference, HeightField, SceneScale},
};

/// The frame in which a position is given.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Frame {
    /// Posts east, posts north, height units.
    Grid,
    /// The reference system of the elevation model, metres up.
    Map,
    /// Longitude and latitude in degrees, metres up.
    Geographic,
    /// Metres east, north and up of post (0, 0).
    Scene,
}

/// What the third number of a position means.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Altitude {
    /// Above the vertical datum.
    Absolute,
    /// Above the finest surface.
    AboveGround,
}

/// A position as a caller gave it.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Place {
    /// East, north, up in `frame`.
    pub position: [f64; 3],
    /// The frame.
    pub frame: Frame,
    /// What up means.
    pub altitude: Altitude,
}

/// Why a position cannot be resolved.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum PlaceError {
    /// NaN or infinite, as given or once in the grid frame.
    #[error("position ({}, {}, {}) is not finite in the grid frame", .0[0], .0[1], .0[2])]
    NotFinite([f64; 3]),
    /// Map coordinates on terrain without a georeference.
    #[error("the terrain has no georeference: give positions in the grid or the scene frame")]
    NoGeoreference,
    /// Longitude and latitude on terrain in another reference system.
    #[error(
        "the terrain's reference system is neither longitude and latitude nor web Mercator nor a UTM zone with a known EPSG code: give \
         positions in the map, grid or scene frame, or ingest it with --crs EPSG:N"
    )]
    NotGeographic,
    /// Longitude and latitude that the terrain's projection does not reach.
    #[error(
        "longitude {} and latitude {} lie beyond the map projection of the terrain; they are degrees east and north, in \
         this order", .0[0], .0[1]
    )]
    BeyondProjection([f64; 2]),
    /// The ground could not be found.
    #[error(transparent)]
    Ground(#[from] LosError),
}

/// Where a terrain lies, as far as positions on it are concerned.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Site {
    /// The constants of the scene frame.
    pub scale: SceneScale,
    /// The place of the grid on Earth; `None` when it is nowhere in particular.
    pub georeference: Option<Georeference>,
}

impl Site {
    /// A plan position in posts.
    pub fn grid_from_plan(&self, frame: Frame, x: f64, y: f64) -> Result<[f64; 2], PlaceError> {
        let [x_grid, y_grid] = match frame {
            Frame::Grid => [x, y],
            Frame::Scene => [x / self.scale.east_m, y / self.scale.north_m],
            Frame::Map => {
                let georeference = self.georeference.ok_or(PlaceError::NoGeoreference)?;
                georeference.grid_from_map(x, y)
            }
            Frame::Geographic => {
                let georeference = self.georeference.ok_or(PlaceError::NoGeoreference)?;
                let map = georeference.map_from_geographic(x, y).ok_or_else(|| match georeference.has_geographic() {
                    true => PlaceError::BeyondProjection([x, y]),
                    false => PlaceError::NotGeographic,
                });
                let [x, y] = map?;
                georeference.grid_from_map(x, y)
            }
        };
        if !(x_grid.is_finite() && y_grid.is_finite()) {
            return Err(PlaceError::NotFinite([x, y, 0.0]));
        }
        Ok([x_grid, y_grid])
    }

    /// Whether a sight line with these ends is within its range and region. Rounded: no verdict hangs on it.
    pub(super) fn is_active(&self, line: &SightLine, ends: [[f64; 3]; 2]) -> Result<bool, PlaceError> {
        let [a, b] = ends.map(|end| self.scale.scene_from_grid(DVec3::from_array(end)));
        let in_range = line.range_m.is_none_or(|range_m| a.distance(b) <= range_m);
        let Some(region) = &line.region else { return Ok(in_range) };
        let [x, y] = self.grid_from_plan(region.frame, region.centre[0], region.centre[1])?;
        let centre = self.scale.scene_from_grid(DVec3::new(x, y, 0.0)).truncate();
        Ok(in_range && [a, b].iter().all(|end| end.truncate().distance(centre) <= region.radius_m))
    }

    /// The points between which a mesh must pass so that it is within an entity's `ground_m` of the finest surface at its
    /// place, each moved outward to an f64; `None` when it asks for nothing or stands over unknown ground.
    pub(super) fn ground_band(
        &self,
        field: &impl HeightField,
        entity: &Entity,
    ) -> Result<Option<[[f64; 3]; 2]>, PlaceError> {
        let Some(ground_m) = entity.ground_m else { return Ok(None) };
        let [x, y] = self.grid_from_plan(entity.place.frame, entity.place.position[0], entity.place.position[1])?;
        let height = ground_m / self.scale.up_m;
        let above = los::on_ground(field, x, y, height)?;
        // The step below the least f64 that is not below what is asked for.
        let below = los::on_ground(field, x, y, -height)?.map(f64::next_down);
        Ok(above.zip(below).map(|(above, below)| [[x, y, above], [x, y, below]]))
    }

    /// Height units in one unit of the third coordinate of `frame`.
    pub fn units_up(&self, frame: Frame) -> f64 {
        if frame == Frame::Grid { 1.0 } else { 1.0 / self.scale.up_m }
    }

    /// The point of the grid frame `offset_m` metres above `place`; `None` when it is given above ground and the ground
    /// there is unknown.
    ///
    /// A height above ground becomes the least f64 not below exact surface + height, offset included.
    pub fn grid_from_place(
        &self,
        field: &impl HeightField,
        place: &Place,
        offset_m: f64,
    ) -> Result<Option<[f64; 3]>, PlaceError> {
        let [x, y, z] = place.position;
        let [x_grid, y_grid] = self.grid_from_plan(place.frame, x, y)?;
        let height =
            if place.frame == Frame::Grid { z + offset_m / self.scale.up_m } else { (z + offset_m) / self.scale.up_m };
        if !height.is_finite() {
            return Err(PlaceError::NotFinite([x, y, z + offset_m]));
        }
        let z_grid = match place.altitude {
            Altitude::Absolute => Some(height),
            Altitude::AboveGround => los::on_ground(field, x_grid, y_grid, height)?,
        };
        match z_grid {
            Some(z_grid) if !z_grid.is_finite() => Err(PlaceError::NotFinite([x, y, z + offset_m])),
            z_grid => Ok(z_grid.map(|z_grid| [x_grid, y_grid, z_grid])),
        }
    }
}
