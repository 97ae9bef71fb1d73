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
    let tilted = p.i.is_multiple_of(2) || p.j.is_multiple_of(2);
    if !is_inner(grid, p) {
        return outer(grid, scale, p, tilted, &mut |q| height(grid.clamp(q)));
    }
    let steps = Steps::new(scale, 1);
    let mut at = |di: i32, dj: i32| height(Post::new(p.i.wrapping_add_signed(di), p.j.wrapping_add_signed(dj)));
    if tilted {
        let cross = Cross { z: at(0, 0)?, west: at(-1, 0)?, east: at(1, 0)?, south: at(0, -1)?, north: at(0, 1)? };
        return Ok(cross.bounds(&steps, deviation, p.i % 2 == 1));
    }
    let mut rows = [[0.0; 5]; 5];
    for (row, dj) in rows.iter_mut().zip(-2_i32..) {
        for (z, di) in row.iter_mut().zip(-2_i32..) {
            if di.abs() + dj.abs() <= 2 {
                *z = at(di, dj)?;
            }
        }
    }
    Ok(square(&steps, &rows, rises(p)))
}

/// Whether all heights that the bounds of the diamond at `p` follow from are in the grid.
#[inline]
fn is_inner(grid: Grid, p: Post) -> bool {
    p.i >= 2 && p.j >= 2 && p.i + 2 < grid.nx() && p.j + 2 < grid.ny()
}

/// Whether the base of the square diamond of half-length 1 at `p` runs from south-west to north-east.
#[inline]
fn rises(p: Post) -> bool {
    (p.i / 2 + p.j / 2).is_multiple_of(2)
}

/// A bound on how far a height is from the middle of two others.
pub(super) trait Deviate: Fn(f64, [f64; 2]) -> f64 + Copy {}

impl<F: Fn(f64, [f64; 2]) -> f64 + Copy> Deviate for F {}

/// Squares of the metres of a step of some posts east and north, and metres per height unit.
pub(super) struct Steps {
    pub(super) east2: f64,
    pub(super) north2: f64,
    up: f64,
}

impl Steps {
    #[inline]
    pub(super) fn new(scale: SceneScale, posts: u32) -> Self {
        let [east, north] = [scale.east_m, scale.north_m].map(|post_m| f64::from(posts) * post_m);
        Self { east2: east * east, north2: north * north, up: scale.up_m }
    }

    #[inline]
    pub(super) fn rise2(&self, from: f64, to: f64) -> f64 {
        let rise = (from - to) * self.up;
        rise * rise
    }
}

/// The heights of a post and of its four neighbours.
pub(super) struct Cross {
    pub(super) z: f64,
    pub(super) west: f64,
    pub(super) east: f64,
    pub(super) south: f64,
    pub(super) north: f64,
}

impl Cross {
    /// The bounds of the tilted diamond of half-length 1 at the post, whose base runs east or north.
    #[inline]
    pub(super) fn bounds(&self, steps: &Steps, deviate: impl Deviate, base_runs_east: bool) -> DiamondBounds {
        let Self { z, west, east, south, north } = *self;
        let tight = round_up(deviate(z, if base_runs_east { [west, east] } else { [south, north] }));
        let across = steps.east2 + steps.rise2(z, west).max(steps.rise2(z, east));
        let along = steps.north2 + steps.rise2(z, south).max(steps.rise2(z, north));
        DiamondBounds { tight, nested: tight, radius_m: round_up(across.max(along).sqrt() * BALL_MARGIN) }
    }
}

/// The bounds of the square diamond of half-length 1 in the middle of five rows.
#[inline]
fn square(steps: &Steps, rows: &[[f64; 5]; 5], rises: bool) -> DiamondBounds {
    let [far_south, south, row, north, far_north] = rows;
    let z = row[2];
    let base = if rises { [south[1], north[3]] } else { [south[3], north[1]] };
    let corners = [south[1], south[3], north[1], north[3]].map(|corner| steps.rise2(z, corner));
    let mut reach = (steps.east2 + steps.north2 + corners.into_iter().fold(0.0, f64::max)).sqrt();
    let mut tight = round_up(deviation(z, base));
    let children = [
        (Cross { z: row[1], west: row[0], east: z, south: south[1], north: north[1] }, false),
        (Cross { z: row[3], west: z, east: row[4], south: south[3], north: north[3] }, false),
        (Cross { z: south[2], west: south[1], east: south[3], south: far_south[2], north: z }, true),
        (Cross { z: north[2], west: north[1], east: north[3], south: z, north: far_north[2] }, true),
    ];
    for (child, base_runs_east) in children {
        let inner = child.bounds(steps, deviation, base_runs_east);
        let step2 = if base_runs_east { steps.north2 } else { steps.east2 };
        tight = tight.max(inner.tight);
        reach = reach.max((step2 + steps.rise2(z, child.z)).sqrt() + f64::from(inner.radius_m));
    }
    DiamondBounds { tight, nested: tight, radius_m: round_up(reach * BALL_MARGIN) }
}

/// The bounds of a diamond on the border of the grid or of the root square.
fn outer(
    grid: Grid,
    scale: SceneScale,
    p: Post,
    tilted: bool,
    height: &mut impl FnMut(Post) -> Result<f64, ReadError>,
) -> Result<DiamondBounds, ReadError> {
    let root = grid.root();
    let (z, base) = (height(p)?, base_ends(root, p));
    let ends = [height(base[0])?, height(base[1])?];
    let own = if grid.contains(p) { deviation(z, ends) } else { 0.0 };
    let tight = round_up(own);
    let mut reach = reach_of_corners(root, scale, p, z, height)?;
    let mut bounds = DiamondBounds { tight, nested: tight, radius_m: 0.0 };
    for child in root.children(p) {
        debug_assert!(!tilted, "tilted diamonds of half-length 1 have no children");
        let mut inner = DiamondBounds::default();
        if child.i <= grid.nx() && child.j <= grid.ny() {
            inner = outer(grid, scale, child, true, height)?;
        }
        bounds.tight = bounds.tight.max(inner.tight);
        reach = far(reach, distance_m(scale, p, z, child, height(child)?) + f64::from(inner.radius_m));
    }
    bounds.nested = bounds.tight;
    bounds.radius_m = round_up(reach * BALL_MARGIN);
    Ok(bounds)
}

fn base_ends(root: RootSquare, p: Post) -> [Post; 2] {
    root.base_ends(p).expect("a post that is no corner has a diamond")
}

/// A bound on |z - (end0 + end1) / 2|: exact when f64 arithmetic is, else rounded up.
pub(super) fn deviation(z: f64, ends: [f64; 2]) -> f64 {
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
fn reach_of_corners(
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
