//! A terrain as all contenders get it: the same posts for the exact lines of sight, our refinement and the other systems.

use std::sync::Arc;

use glam::DQuat;

use super::{Instrument, TradeError};
use crate::{
    evaluate::flight::{Plan, Preset, Viewpoint},
    lod::{Ground, LodView},
    los,
    terrain::{HeightField, MemoryField, SceneScale},
    wedgie::MemoryTerrain,
};

/// Tangent of half the vertical field of view: 60 degrees.
const TAN_HALF_FOV: f64 = 0.577;
/// Distance of the near plane in metres.
const NEAR_M: f64 = 1.0;
/// The picture.
const VIEWPORT_PX: [u32; 2] = [1280, 720];
/// Frames in a second of a flight.
pub(super) const RATE_HZ: f64 = 30.0;

/// A terrain, prepared for exact lines and for refinement.
#[derive(Debug)]
pub struct World {
    /// Its name in tables.
    pub name: String,
    pub(super) terrain: Arc<MemoryTerrain>,
    pub(super) ground: Arc<Ground>,
    /// How long the bounds of all diamonds took.
    pub(super) bounds_s: f64,
}

impl World {
    /// A terrain of `field`'s posts, each of which is known.
    pub fn new(
        name: impl Into<String>,
        field: MemoryField,
        scale: SceneScale,
        instrument: &Instrument<'_>,
    ) -> Result<Self, TradeError> {
        let ground = Ground::read(&field, scale)?;
        let (terrain, bounds_s) = instrument.timed(|| MemoryTerrain::new(field, scale));
        Ok(Self { name: name.into(), terrain: Arc::new(terrain?), ground, bounds_s })
    }

    pub(super) fn scale(&self) -> SceneScale {
        self.ground.scale()
    }

    /// Posts east and north of the last one.
    pub(super) fn cells(&self) -> [f64; 2] {
        let grid = self.ground.grid();
        [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)]
    }

    /// The length of the shorter side in metres.
    pub(super) fn shorter_side_m(&self) -> f64 {
        let ([east, north], scale) = (self.cells(), self.scale());
        (east * scale.east_m).min(north * scale.north_m)
    }

    /// "513 x 513 posts of 30 m".
    pub fn size(&self) -> String {
        let (grid, scale) = (self.ground.grid(), self.scale());
        format!("{} x {} posts, {:.0} x {:.0} m apart", grid.nx(), grid.ny(), scale.east_m, scale.north_m)
    }

    /// Viewpoints of a preset over this terrain.
    pub(super) fn flight(&self, preset: Preset, frames: usize, seed: u64) -> Result<Vec<Viewpoint>, TradeError> {
        self.flight_at(RATE_HZ, preset, frames, seed)
    }

    /// The same at another rate.
    pub(super) fn flight_at(
        &self,
        rate_hz: f64,
        preset: Preset,
        frames: usize,
        seed: u64,
    ) -> Result<Vec<Viewpoint>, TradeError> {
        let ([east, north], scale) = (self.cells(), self.scale());
        let area_m = [[0.0; 2], [east * scale.east_m, north * scale.north_m]];
        let plan = Plan::preset(preset, area_m, frames, rate_hz, seed)?;
        let mut ground_m = Vec::new();
        for [x, y] in plan.ground_points() {
            let (x, y) = ((x / scale.east_m).clamp(0.0, east), (y / scale.north_m).clamp(0.0, north));
            let z = los::surface_height(&*self.terrain, x, y)?.unwrap_or(0.0);
            ground_m.push(z * scale.up_m);
        }
        Ok(plan.fly(&ground_m)?)
    }
}

/// The view from a viewpoint of a flight.
pub(super) fn view(viewpoint: &Viewpoint) -> Result<LodView, TradeError> {
    view_of(viewpoint, VIEWPORT_PX)
}

/// The same with a picture of another size.
pub(super) fn view_of(viewpoint: &Viewpoint, viewport_px: [u32; 2]) -> Result<LodView, TradeError> {
    let [x, y, z, w] = viewpoint.rotation;
    Ok(LodView::new(viewpoint.eye, DQuat::from_xyzw(x, y, z, w), TAN_HALF_FOV, NEAR_M, viewport_px)?)
}

/// The viewpoint that looks the other way.
pub(super) fn turned(viewpoint: &Viewpoint) -> Viewpoint {
    let [x, y, z, w] = viewpoint.rotation;
    // Half a turn about the vertical is the quaternion (0, 0, 1, 0).
    let turned = DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0) * DQuat::from_xyzw(x, y, z, w);
    Viewpoint { rotation: turned.to_array(), ..*viewpoint }
}

/// The greatest and the least height of a field in metres.
pub(super) fn height_range_m(world: &World) -> [f64; 2] {
    let grid = HeightField::grid(&*world.terrain);
    let heights = (0..grid.ny()).flat_map(|j| (0..grid.nx()).map(move |i| (i, j)));
    heights
        .map(|(i, j)| world.ground.z(i, j) * world.scale().up_m)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)])
}
