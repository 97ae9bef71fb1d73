//! Where a grid lies on Earth, and how long its steps are in metres.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The three constants that turn the grid frame into the scene frame (metres east, north and up of post (0, 0)).
///
/// A positive scaling changes no sign, so straight lines, planes and verdicts survive it.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct SceneScale {
    /// Metres per post east, finite and above 0.
    pub east_m: f64,
    /// Metres per post north, finite and above 0.
    pub north_m: f64,
    /// Metres per height unit, finite and above 0.
    pub up_m: f64,
}

impl SceneScale {
    /// A scale of one metre in all directions.
    pub const UNIT: Self = Self { east_m: 1.0, north_m: 1.0, up_m: 1.0 };

    /// The constants as a vector.
    pub fn as_vec(self) -> DVec3 {
        DVec3::new(self.east_m, self.north_m, self.up_m)
    }

    /// A point of the grid frame in the scene frame.
    pub fn scene_from_grid(self, p: DVec3) -> DVec3 {
        p * self.as_vec()
    }

    /// A point of the scene frame in the grid frame.
    pub fn grid_from_scene(self, p: DVec3) -> DVec3 {
        p / self.as_vec()
    }
}

/// The affine place of a grid in a horizontal reference system: north-up, without rotation.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Georeference {
    /// EPSG code of the horizontal reference system; `None` when the file does not say.
    pub epsg: Option<u32>,
    /// Whether map coordinates are longitude and latitude in degrees.
    pub geographic: bool,
    /// Map coordinates of post (0, 0), the south-west corner.
    pub origin: [f64; 2],
    /// Map units per post east and north, both finite and above 0.
    pub step: [f64; 2],
}

/// Semi-major axis of WGS84 in metres.
const WGS84_A: f64 = 6_378_137.0;
/// First eccentricity of WGS84, squared.
const WGS84_E2: f64 = 6.694_379_990_141_316e-3;
/// Mean radius of the Earth in metres (IUGG R1), for the sagitta of a line.
pub const EARTH_RADIUS_M: f64 = 6_371_008.8;

impl Georeference {
    /// Whether a raster says where it lies: readers give origin 0 and steps of 1 when it does not.
    pub fn is_placed(&self) -> bool {
        self.epsg.is_some() || self.geographic || self.origin != [0.0; 2] || self.step != [1.0; 2]
    }

    /// A map coordinate pair in posts.
    pub fn grid_from_map(&self, x: f64, y: f64) -> [f64; 2] {
        [(x - self.origin[0]) / self.step[0], (y - self.origin[1]) / self.step[1]]
    }

    /// A pair in posts as map coordinates.
    pub fn map_from_grid(&self, x: f64, y: f64) -> [f64; 2] {
        [self.origin[0] + x * self.step[0], self.origin[1] + y * self.step[1]]
    }

    /// The scene frame's constants at the centre of a grid of `nx` by `ny` posts with a height unit of `unit_m`
    /// metres. For longitude and latitude: the lengths of a degree on the WGS84 ellipsoid there. Uses `libm`-grade
    /// transcendental functions once, when a database is made; the constants are stored.
    pub fn scene_scale(&self, nx: u32, ny: u32, unit_m: f64) -> SceneScale {
        if !self.geographic {
            return SceneScale { east_m: self.step[0], north_m: self.step[1], up_m: unit_m };
        }
        let [_, latitude] = self.map_from_grid(0.5 * f64::from(nx - 1), 0.5 * f64::from(ny - 1));
        let (sin, cos) = latitude.to_radians().sin_cos();
        let w2 = 1.0 - WGS84_E2 * sin * sin;
        let prime_vertical = WGS84_A / w2.sqrt();
        let meridian = prime_vertical * (1.0 - WGS84_E2) / w2;
        let degree = std::f64::consts::PI / 180.0;
        SceneScale {
            east_m: self.step[0] * degree * prime_vertical * cos,
            north_m: self.step[1] * degree * meridian,
            up_m: unit_m,
        }
    }

    /// How far the Earth bulges above the middle of a chord of length `range_m`: L^2 / 8R, in metres.
    pub fn sagitta_m(range_m: f64) -> f64 {
        range_m * range_m / (8.0 * EARTH_RADIUS_M)
    }
}
