//! Where a grid lies on Earth, and how long its steps are in metres.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::projection::Projection;

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
/// Half the distance on a map over which its scale is measured: the scale's change and the rounding of degrees are both
/// below 1e-8 of it.
const HALF_STEP_M: f64 = 50.0;
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

    /// Whether longitude and latitude can be had of a place on the map and the other way: the map is in degrees, web
    /// Mercator, or a UTM zone whose code is known.
    pub fn has_geographic(&self) -> bool {
        self.geographic || self.projection().is_some()
    }

    fn projection(&self) -> Option<Projection> {
        self.epsg.and_then(Projection::of_epsg)
    }

    /// Longitude and latitude in degrees, of the map's own datum, as map coordinates: to 0.1 mm. `None` when
    /// [`Self::has_geographic`] is not so, or the place is more than ten degrees of longitude off a zone's middle.
    pub fn map_from_geographic(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        if self.geographic {
            return Some([longitude, latitude]);
        }
        self.projection()?.map_from_geographic([longitude, latitude])
    }

    /// Map coordinates as longitude and latitude in degrees; the inverse of [`Self::map_from_geographic`].
    pub fn geographic_from_map(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        if self.geographic {
            return Some([x, y]);
        }
        self.projection()?.geographic_from_map([x, y])
    }

    /// The scene frame's constants at the centre of a grid of `nx` by `ny` posts with a height unit of `unit_m`
    /// metres: true metres on the WGS84 ellipsoid, where [`Self::has_geographic`]; else the map's own. Uses `libm`-grade
    /// transcendental functions once, when a database is made; the constants are stored.
    pub fn scene_scale(&self, nx: u32, ny: u32, unit_m: f64) -> SceneScale {
        let [x, y] = self.map_from_grid(0.5 * f64::from(nx - 1), 0.5 * f64::from(ny - 1));
        let true_m = if self.geographic { Some(degree_m(y)) } else { self.true_metres(x, y) };
        let [east, north] = true_m.unwrap_or([1.0; 2]);
        SceneScale { east_m: self.step[0] * east, north_m: self.step[1] * north, up_m: unit_m }
    }

    /// True metres in a metre of the map east and north of a place; `None` where the projection is not known.
    fn true_metres(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        let length = |[east, north]: [f64; 2]| {
            let [a, b] = [-1.0, 1.0].map(|side| self.geographic_from_map(x + side * east, y + side * north));
            let ([lon_a, lat_a], [lon_b, lat_b]) = (a?, b?);
            let degree = degree_m(0.5 * (lat_a + lat_b));
            let turn = (lon_b - lon_a + 180.0).rem_euclid(360.0) - 180.0;
            let (de, dn) = (turn * degree[0], (lat_b - lat_a) * degree[1]);
            Some((de * de + dn * dn).sqrt() / (2.0 * HALF_STEP_M))
        };
        Some([length([HALF_STEP_M, 0.0])?, length([0.0, HALF_STEP_M])?])
    }

    /// How far the Earth bulges above the middle of a chord of length `range_m`: L^2 / 8R, in metres.
    pub fn sagitta_m(range_m: f64) -> f64 {
        range_m * range_m / (8.0 * EARTH_RADIUS_M)
    }
}

/// The lengths of a degree east and north at a latitude in degrees, in metres on the WGS84 ellipsoid.
fn degree_m(latitude: f64) -> [f64; 2] {
    let (sin, cos) = latitude.to_radians().sin_cos();
    let w2 = 1.0 - WGS84_E2 * sin * sin;
    let prime_vertical = WGS84_A / w2.sqrt();
    let meridian = prime_vertical * (1.0 - WGS84_E2) / w2;
    [prime_vertical * cos, meridian].map(|radius| radius.to_radians())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against geodesics of 100 m by PROJ 9.5 at Mount Whitney.
    #[test]
    fn scene_metres_are_true_metres() {
        let known = [
            (32_611, [384_381.795_377, 4_048_892.754_522], [1.000_235_364_4, 1.000_235_364_4]),
            (3_857, [-13_168_238.600_765, 4_380_516.844_251], [0.803_997_406_3, 0.800_518_247_0]),
            (2_056, [2_600_000.0, 1_200_000.0], [1.0, 1.0]),
        ];
        for (epsg, [x, y], expected) in known {
            let step = [25.0, 10.0];
            let origin = [x - 1_000.0 * step[0], y - 500.0 * step[1]];
            let place = Georeference { epsg: Some(epsg), geographic: false, origin, step };
            let scale = place.scene_scale(2_001, 1_001, 0.1);
            let found = [scale.east_m / step[0], scale.north_m / step[1]];
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 2e-8), "{epsg}: {found:?}");
            assert_eq!(scale.up_m, 0.1);
        }
        let degrees = Georeference { epsg: Some(4_326), geographic: true, origin: [0.0, -0.5], step: [1.0, 1.0] };
        let scale = degrees.scene_scale(2, 2, 1.0);
        assert!(
            (scale.east_m - 111_319.490_8).abs() < 1e-3 && (scale.north_m - 110_574.275_8).abs() < 1e-3,
            "{scale:?}"
        );
    }
}
