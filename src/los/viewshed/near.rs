//! The horizon of the ground up to the first column a post away from A, with that column, whose posts need not lie
//! ahead: each ray is intersected with each edge.
//!
//! **Errors.** Coordinates relative to A are at most 8 here and have one rounding; a ray's side of a post, Y - m X, is
//! off by 2^-48. Rays stay away from the directions of edges by half a sector, at least 2^-18, so the share at which an
//! edge is crossed is off by 2^-29, and what follows by [`ERROR`] of the numbers it is made of. A crossing that may be
//! ahead of A counts; its projected height is a quotient of bounds, infinite where the divisor may be 0.
//!
//! **On a curved Earth** an edge may rise above its chord by a quarter of east + north. Along a path the lowered ground
//! of a triangle stands at c / x + g - w x, with w at most east + north: between two crossings less than two posts apart
//! it exceeds the greater one by at most 2 w.

use sightline_proto::predicates::FLUSHED;

use super::{
    column::{Frame, Reader},
    push::{Gap, Horizon, Sectors, greater},
};
use crate::{
    los::surface::two_sum,
    terrain::{HeightField, ReadError},
};

const ERROR: f64 = 1.0 / (1 << 27) as f64;
/// A post as near a ray as this may be on either side.
const ON_RAY: f64 = 1.0 / (1_u64 << 46) as f64;
/// A column nearer than this, in posts, is not projected.
const TOO_NEAR: f64 = 1.0 / (1_u64 << 40) as f64;

/// A post relative to A; its height is NaN where void.
#[derive(Clone, Copy, Debug)]
struct Corner {
    x: f64,
    y: f64,
    z: f64,
    /// Whether x and y are exact.
    exact: bool,
}

/// Raises the upper bounds by the ground up to column `first`; its posts are corners of the ground before it.
pub(super) fn push<H>(
    horizon: &mut Horizon,
    frame: &Frame,
    first: i64,
    reader: &mut Reader<'_, H>,
) -> Result<(), ReadError>
where
    H: HeightField + ?Sized,
{
    let middle = frame.across.floor() as i64;
    let rows = middle - 3..=middle + 4;
    let mut a = first;
    // Strips that begin at A or behind it, and the one after.
    while frame.x(a) > 0.0 {
        let before = frame.before(a);
        for b in rows.clone() {
            let mut corner = |a, b| corner(frame, reader, a, b);
            let (near, far) = (corner(before, b)?, corner(a, b)?);
            let (near_next, far_next) = (corner(before, b + 1)?, corner(a, b + 1)?);
            push_edge(horizon, frame.bulge(), near, far);
            let rises = (before + b) & 1 == 0;
            if rises {
                push_edge(horizon, frame.bulge(), near, far_next)
            } else {
                push_edge(horizon, frame.bulge(), near_next, far)
            }
            push_edge(horizon, frame.bulge(), far, far_next);
            push_post(horizon, frame.bulge(), far);
        }
        a = before;
    }
    Ok(())
}

fn corner<H>(frame: &Frame, reader: &mut Reader<'_, H>, a: i64, b: i64) -> Result<Option<Corner>, ReadError>
where
    H: HeightField + ?Sized,
{
    let Some(z) = reader.height(a, b)? else { return Ok(None) };
    let (x, y) = (frame.x(a), frame.y(b));
    let exact = two_sum(a as f64, -frame.along).1 == 0.0 && two_sum(b as f64, -frame.across).1 == 0.0;
    Ok(Some(Corner { x, y, z: z - frame.z - frame.drop(x, y), exact }))
}

/// A post ahead of A counts in all sectors that it can be in.
fn push_post(horizon: &mut Horizon, bulge: f64, corner: Option<Corner>) {
    let Some(Corner { x, y, z, .. }) = corner else { return };
    let Sectors { scale, offset, .. } = horizon.sectors;
    if x < TOO_NEAR {
        horizon.posts.fill(f64::INFINITY);
        return;
    }
    let s = z / x;
    for k in horizon.sectors.around(y / x * scale + offset) {
        horizon.posts[k] = greater(s + s.abs() * ERROR + 4.0 * bulge + FLUSHED, horizon.posts[k]);
        if z.is_nan() {
            horizon.gaps[k] = horizon.gaps[k].max(Gap::Some);
        }
    }
}

fn push_edge(horizon: &mut Horizon, bulge: f64, from: Option<Corner>, to: Option<Corner>) {
    let (Some(from), Some(to)) = (from, to) else { return };
    if from.exact && to.exact && from.x * to.y == from.y * to.x {
        // The edge's line goes through A: what a path meets of it are A and its posts.
        return;
    }
    let sectors = horizon.sectors;
    let unknown = from.z.is_nan() || to.z.is_nan();
    for ray in 0..horizon.rays.len() {
        let m = sectors.slope(sectors.base + ray as i64);
        let (side, other) = (from.y - m * from.x, to.y - m * to.x);
        if side * other > 0.0 && side.abs() > ON_RAY && other.abs() > ON_RAY {
            continue;
        }
        let share = (side / (side - other)).clamp(0.0, 1.0);
        let x = from.x + share * (to.x - from.x);
        if x <= -ERROR {
            continue;
        }
        if unknown {
            for gap in &mut horizon.gaps[ray.saturating_sub(1)..(ray + 1).min(sectors.len)] {
                *gap = (*gap).max(Gap::Some);
            }
            continue;
        }
        let z = from.z + share * (to.z - from.z) + (from.z.abs() + to.z.abs()) * ERROR + bulge + FLUSHED;
        let s = match z < 0.0 {
            true => z / (x + ERROR),
            false if x > ERROR => z / (x - ERROR),
            false => f64::INFINITY,
        };
        horizon.rays[ray] = greater(s + s.abs() * ERROR + 4.0 * bulge, horizon.rays[ray]);
    }
}
