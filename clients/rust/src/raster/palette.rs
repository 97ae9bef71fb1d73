//! Colours: hypsometric tints, light from the north-west, sky.

use glam::DVec3;

/// The lower side of the terrain, seen when the eye is under the mesh.
pub(super) const UNDERSIDE: [f32; 3] = [0.35, 0.05, 0.25];
/// Ground without data.
pub const NO_DATA: [f32; 3] = [0.45, 0.62, 0.80];
/// Edges of triangles.
pub(super) const WIRE: [f32; 3] = [0.05, 0.08, 0.12];
/// Where a map shows no terrain.
pub(super) const PAPER: [f32; 3] = [0.93, 0.93, 0.90];

const HORIZON: [f32; 3] = [0.86, 0.90, 0.93];
const ZENITH: [f32; 3] = [0.24, 0.46, 0.74];
const BELOW: [f32; 3] = [0.62, 0.66, 0.68];

/// Tints from the lowest to the highest ground, evenly spaced.
const TINTS: [[f32; 3]; 8] = [
    [0.27, 0.47, 0.33],
    [0.42, 0.59, 0.36],
    [0.62, 0.69, 0.42],
    [0.80, 0.75, 0.50],
    [0.76, 0.62, 0.42],
    [0.64, 0.49, 0.37],
    [0.70, 0.64, 0.60],
    [0.96, 0.96, 0.97],
];

/// The tint of ground at a fraction of the height range.
pub(super) fn hypsometric(fraction: f64) -> [f32; 3] {
    let at = fraction.clamp(0.0, 1.0) * (TINTS.len() - 1) as f64;
    let k = (at as usize).min(TINTS.len() - 2);
    super::fill::mix(TINTS[k], TINTS[k + 1], (at - k as f64) as f32)
}

/// Brightness of ground with this unit normal, about 0.35 to 1.2: sun in the north-west, 40 degrees up, and sky.
pub(super) fn light(normal: DVec3) -> f64 {
    let sun = DVec3::new(-0.5417, 0.5417, 0.6428);
    0.36 + 0.20 * normal.z + 0.62 * normal.dot(sun).max(0.0)
}

/// The sky in a unit direction of the scene frame.
pub(super) fn sky(direction: DVec3) -> [f32; 3] {
    let up = direction.z as f32;
    if up < 0.0 {
        return super::fill::mix(HORIZON, BELOW, (-up * 2.0).min(1.0));
    }
    // 1 - (1 - up)^3 rises fast at the horizon and flattens overhead.
    let rest = 1.0 - up.min(1.0);
    super::fill::mix(HORIZON, ZENITH, 1.0 - rest * rest * rest)
}
