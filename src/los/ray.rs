//! Rays: the first ground in a direction.
//!
//! A ray is the line from a point to the point at the greatest range, so it hits ground exactly when that line is
//! BLOCKED. A direction is given by azimuth, clockwise from grid north, and elevation above the horizontal, in the
//! scene frame (metres). Turning these into an end is the one place in this module with transcendental functions, those
//! of `libm`, which give the same bits everywhere; the ray is exact for the end that comes out.

use sightline_proto::diamond::Post;

use super::{
    LosError, check_finite,
    derived::{Until, survey},
    earth::{Earth, Line},
    ground::normal,
    walk::Walk,
};
use crate::terrain::{HeightField, SceneScale};

/// How a ray ends.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum RayEnd {
    /// It begins strictly below known ground.
    StartsBelow,
    /// It goes below known ground.
    Hit(RayHit),
    /// It does not, up to its end.
    Miss,
}

/// Where a ray goes below known ground.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct RayHit {
    /// The point in the grid frame; on a curved Earth lowered by the bulge, that is: on the ground.
    pub point: [f64; 3],
    /// As a part of the ray.
    pub t: f64,
    /// The triangle that it enters; see [`super::Obstruction`].
    pub triangle: Option<[Post; 3]>,
    /// The upward unit normal of that triangle in the scene frame.
    pub normal: Option<[f64; 3]>,
}

/// What a ray meets.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Ray {
    /// How it ends.
    pub end: RayEnd,
    /// Whether it passes unknown ground before, so that nobody knows whether it ends there.
    pub over_unknown: bool,
}

/// The first known ground from `from` towards `to`. Ends in the grid frame; the scale is that of the normal.
pub fn ray<H>(field: &H, from: [f64; 3], to: [f64; 3], scale: SceneScale, earth: Earth) -> Result<Ray, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(from, ["ax", "ay", "az"])?;
    check_finite(to, ["bx", "by", "bz"])?;
    let mut walk = Walk::new(field, from, to);
    let line = Line::new(from, to, earth);
    let met = survey(&mut walk, line, false, Until::Obstructed)?;
    let end = match met.first {
        None => RayEnd::Miss,
        Some(_) if met.starts_below => RayEnd::StartsBelow,
        Some(first) => {
            let [x, y, z] = first.place.point;
            let triangle = first.triangle;
            let normal = triangle.map(|triangle| normal(&mut walk.posts, scale, triangle)).transpose()?.flatten();
            let t = first.place.t;
            RayEnd::Hit(RayHit { point: [x, y, z - line.bulge(t)], t, triangle, normal })
        }
    };
    Ok(Ray { end, over_unknown: met.unknown })
}

/// The end, in the grid frame, of a ray of `range_m` metres from `from`; angles in degrees, azimuth clockwise from grid
/// north, elevation above the horizontal at `from`. On a curved Earth the end is raised by what the ground falls away
/// over that distance, so that the ray sets out at that elevation.
pub fn ray_end(
    from: [f64; 3],
    azimuth_deg: f64,
    elevation_deg: f64,
    range_m: f64,
    scale: SceneScale,
    earth: Earth,
) -> Result<[f64; 3], LosError> {
    check_finite(from, ["x", "y", "z"])?;
    check_finite([azimuth_deg, elevation_deg, range_m], ["azimuth", "elevation", "range"])?;
    if range_m <= 0.0 {
        return Err(LosError::OutOfBounds { what: "the range", value: range_m, must: "above 0" });
    }
    let (sin_azimuth, cos_azimuth) = sin_cos_degrees(azimuth_deg);
    let (sin, cos) = sin_cos_degrees(elevation_deg);
    let [dx, dy] = [cos * sin_azimuth * range_m / scale.east_m, cos * cos_azimuth * range_m / scale.north_m];
    let [east, north] = earth.coefficients();
    let rise = sin * range_m / scale.up_m + (dx * dx * east + dy * dy * north);
    let end = [from[0] + dx, from[1] + dy, from[2] + rise];
    check_finite(end, ["x of the ray's end", "y of the ray's end", "z of the ray's end"])?;
    Ok(end)
}

/// Sine and cosine of an angle in degrees; exact for whole right angles.
fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    // The remainder is exact. Now within 45 degrees of a quarter turn.
    let turn = degrees % 360.0;
    let quarters = libm::rint(turn / 90.0);
    let (sin, cos) = libm::sincos((turn - 90.0 * quarters) * (std::f64::consts::PI / 180.0));
    match (quarters as i64).rem_euclid(4) {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// The elevation angle, in degrees, of a slope.
pub(super) fn degrees_of_slope(tangent: f64) -> f64 {
    libm::atan(tangent) * (180.0 / std::f64::consts::PI)
}
