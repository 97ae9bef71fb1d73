//! Bounds of the finest two levels of diamonds, computed from a few heights instead of being stored.
//!
//! These are the posts with an odd coordinate: three quarters of all.
//!
//! ```text
//!   a tilted diamond     t───t     a square diamond: its triangles hold the midpoints (m) of its four sides,
//!   of half-length 1     │ m │     whose deviation is that of the tilted diamonds there, and its centre.
//!                        t───t
//! ```

use sightline_proto::diamond::{Post, RootSquare};

use super::{BALL_MARGIN, DiamondBounds, round_up};
use crate::terrain::{Grid, HeightField, Posts, ReadError, SceneScale};

/// The bounds of the diamond at `p`, a post of the root square with an odd coordinate, from the heights around it.
pub fn finest_bounds<H: HeightField + ?Sized>(
    posts: &mut Posts<'_, H>,
    scale: SceneScale,
    p: Post,
) -> Result<DiamondBounds, ReadError> {
    finest_bounds_with(posts.grid(), scale, p, |q| Ok(posts.at(q)?.z))
}

/// [`finest_bounds`] with any source of drawn heights; it is asked for posts of the grid only.
pub fn finest_bounds_with(
    grid: Grid,
    scale: SceneScale,
    p: Post,
    mut height: impl FnMut(Post) -> Result<f64, ReadError>,
) -> Result<DiamondBounds, ReadError> {
    debug_assert!(p.i % 2 == 1 || p.j % 2 == 1, "{p:?} is not of the finest two levels");
    // A diamond centred further out has no post of the grid in its closed area.
    if p.i > grid.nx() || p.j > grid.ny() {
        return Ok(DiamondBounds::default());
    }
    let mut height = |q: Post| height(grid.clamp(q));
    if p.i.is_multiple_of(2) || p.j.is_multiple_of(2) {
        return tilted(grid, scale, p, &mut height);
    }
    let root = grid.root();
    let (z, mut corners) = (height(p)?, [0.0; 2]);
    let triangle = base_triangle(root, p);
    for (slot, end) in corners.iter_mut().zip([triangle.e0, triangle.e1]) {
        *slot = height(end)?;
    }
    let own = if grid.contains(p) { deviation(z, corners) } else { 0.0 };
    let mut bounds = DiamondBounds { tight: round_up(own), nested: 0.0, radius_m: 0.0 };
    let mut reach = reach_of_corners(root, scale, p, z, &mut height)?;
    for child in root.children(p) {
        let mut inner = DiamondBounds::default();
        if child.i <= grid.nx() && child.j <= grid.ny() {
            inner = tilted(grid, scale, child, &mut height)?;
        }
        bounds.tight = bounds.tight.max(inner.tight);
        reach = far(reach, distance_m(scale, p, z, child, height(child)?) + f64::from(inner.radius_m));
    }
    bounds.nested = bounds.tight;
    bounds.radius_m = round_up(reach * BALL_MARGIN);
    Ok(bounds)
}

fn tilted(
    grid: Grid,
    scale: SceneScale,
    p: Post,
    height: &mut impl FnMut(Post) -> Result<f64, ReadError>,
) -> Result<DiamondBounds, ReadError> {
    let z = height(p)?;
    let triangle = base_triangle(grid.root(), p);
    let ends = [height(triangle.e0)?, height(triangle.e1)?];
    let tight = if grid.contains(p) { round_up(deviation(z, ends)) } else { 0.0 };
    let reach = reach_of_corners(grid.root(), scale, p, z, height)?;
    Ok(DiamondBounds { tight, nested: tight, radius_m: round_up(reach * BALL_MARGIN) })
}

fn base_triangle(root: RootSquare, p: Post) -> sightline_proto::diamond::Triangle {
    root.triangles(p).next().expect("a post that is no corner has a diamond")
}

/// A bound on |z - (end0 + end1) / 2|: exact when f64 arithmetic is, else rounded up.
fn deviation(z: f64, ends: [f64; 2]) -> f64 {
    let halves = ends.map(|end| end * 0.5);
    let (mid, mid_error) = two_sum(halves[0], halves[1]);
    let (difference, error) = two_sum(z, -mid);
    let exact = mid_error == 0.0 && error == 0.0 && halves[0] * 2.0 == ends[0] && halves[1] * 2.0 == ends[1];
    if exact {
        return difference.abs();
    }
    // Halving loses at most half of the least subnormal; the two sums lose their errors.
    let sure = difference.abs() + mid_error.abs() + error.abs();
    if sure.is_nan() { f64::INFINITY } else { sure.next_up().next_up().next_up().next_up() }
}

/// Knuth's TwoSum: the rounded sum and its error, both exact unless something overflows (then the error is NaN).
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    (sum, (a - (sum - b_part)) + (b - b_part))
}

/// Distance in metres from `p` to the furthest corner of its diamond's triangles, which are convex.
pub(super) fn reach_of_corners(
    root: RootSquare,
    scale: SceneScale,
    p: Post,
    z: f64,
    height: &mut impl FnMut(Post) -> Result<f64, ReadError>,
) -> Result<f64, ReadError> {
    let mut reach = 0.0;
    for triangle in root.triangles(p) {
        for corner in triangle.corners() {
            reach = far(reach, distance_m(scale, p, z, corner, height(corner)?));
        }
    }
    Ok(reach)
}

/// The greater of two distances, NaN (an overflow) counting as the greatest.
pub(super) fn far(a: f64, b: f64) -> f64 {
    if b <= a { a } else { b }
}

/// Distance in metres between two posts in the scene frame; NaN or +infinity when it overflows.
pub(super) fn distance_m(scale: SceneScale, p: Post, pz: f64, q: Post, qz: f64) -> f64 {
    let dx = (f64::from(p.i) - f64::from(q.i)) * scale.east_m;
    let dy = (f64::from(p.j) - f64::from(q.j)) * scale.north_m;
    let dz = (pz - qz) * scale.up_m;
    (dx * dx + dy * dy + dz * dz).sqrt()
}
