//! The horizon: how high the ground stands, azimuth by azimuth.
//!
//! The horizon angle is the supremum of the elevation angles of known ground along an azimuth, as far as the greatest
//! range. Its tangent is rounded: with an error e of a height (some 1e-15 of the heights and of the range) it is off by
//! e / d for a crest at distance d.

use rayon::prelude::*;

use super::{
    LosError, check_finite,
    derived::crest::view,
    earth::{Earth, Line},
    ray::{degrees_of_slope, ray_end},
    walk::Walk,
};
use crate::terrain::{HeightField, SceneScale};

/// The horizon at one azimuth.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Horizon {
    /// Clockwise from grid north, in degrees.
    pub azimuth_deg: f64,
    /// The crest; `None` when no known ground lies along the azimuth, or the observer is below ground.
    pub crest: Option<HorizonCrest>,
    /// The observer is strictly below known ground and sees nothing.
    pub below_ground: bool,
    /// Some of the ground is unknown, so the horizon may be higher.
    pub over_unknown: bool,
}

/// The ground that makes the horizon.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct HorizonCrest {
    /// Elevation above the horizontal, in degrees.
    pub elevation_deg: f64,
    /// Its tangent.
    pub tangent: f64,
    /// Distance in plan, in the scene frame. 0 for an observer on the ground that falls from there on.
    pub range_m: f64,
    /// Where, in the grid frame: a point of the ground.
    pub point: [f64; 3],
}

/// The horizon at each azimuth (degrees clockwise from grid north), over all cores, in the order given. The first error
/// in that order wins. On a curved Earth the ground falls away, and elevations with it.
pub fn horizon<H>(
    field: &H,
    from: [f64; 3],
    azimuths_deg: &[f64],
    range_m: f64,
    scale: SceneScale,
    earth: Earth,
) -> Result<Vec<Horizon>, LosError>
where
    H: HeightField + ?Sized,
{
    let one = |&azimuth_deg: &f64| at(field, from, azimuth_deg, range_m, scale, earth);
    let found: Vec<_> = azimuths_deg.par_iter().map(one).collect();
    found.into_iter().collect()
}

fn at<H>(
    field: &H,
    from: [f64; 3],
    azimuth_deg: f64,
    range_m: f64,
    scale: SceneScale,
    earth: Earth,
) -> Result<Horizon, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(from, ["x", "y", "z"])?;
    let end = ray_end(from, azimuth_deg, 0.0, range_m, scale, Earth::Flat)?;
    let level = Line::new(from, [end[0], end[1], from[2]], earth);
    let seen = view(&mut Walk::new(field, level.a, level.b), level)?;
    let crest = seen.crest.map(|crest| {
        // The rise is that of the line before it is lowered; at the start that adds W.
        let slope = crest.rise - level.bend;
        let tangent = slope * scale.up_m / range_m;
        let t = crest.t;
        let along = |from: f64, to: f64| from + t * (to - from);
        HorizonCrest {
            elevation_deg: degrees_of_slope(tangent),
            tangent,
            range_m: t * range_m,
            point: [
                along(level.a[0], level.b[0]),
                along(level.a[1], level.b[1]),
                from[2] + t * crest.rise - level.bulge(t),
            ],
        }
    });
    Ok(Horizon { azimuth_deg, crest, below_ground: seen.below, over_unknown: seen.unknown })
}
