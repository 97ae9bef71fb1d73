//! The ground at a point: its height, the triangle that it belongs to, and the way that faces.

use rayon::prelude::*;
use sightline_proto::diamond::Post;

use super::{
    LosError, check_finite,
    earth::Plane,
    surface::{Face, known_triangle, surface_over},
};
use crate::terrain::{HeightField, Posts, ReadError, SceneScale};

/// Points of a batch that one core takes together.
const BATCH_SHARE: usize = 256;

/// Known ground at a point.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct GroundPoint {
    /// Height of the surface, rounded to nearest, in height units.
    pub height: f64,
    /// The triangle that holds the point, counter-clockwise; on an edge or a post, of the known ones around it that
    /// whose centroid has the lowest (j, i). `None` when all around are unknown.
    pub triangle: Option<[Post; 3]>,
    /// The upward unit normal of that triangle in the scene frame (east, north, up in metres).
    pub normal: Option<[f64; 3]>,
}

/// The ground at a plan point in the grid frame; `None` where it is unknown.
pub fn ground<H>(field: &H, scale: SceneScale, x: f64, y: f64) -> Result<Option<GroundPoint>, LosError>
where
    H: HeightField + ?Sized,
{
    at(&mut Posts::new(field), scale, [x, y])
}

/// [`ground`] at many points, over all cores, in the order of `points`. The first error in that order wins.
pub fn ground_batch<H>(field: &H, scale: SceneScale, points: &[[f64; 2]]) -> Result<Vec<Option<GroundPoint>>, LosError>
where
    H: HeightField + ?Sized,
{
    let shares = points.par_chunks(BATCH_SHARE).map(|share| {
        let mut posts = Posts::new(field);
        share.iter().map(|&point| at(&mut posts, scale, point)).collect::<Result<Vec<_>, _>>()
    });
    let found: Vec<_> = shares.collect();
    Ok(found.into_iter().collect::<Result<Vec<_>, _>>()?.concat())
}

fn at<H>(posts: &mut Posts<'_, H>, scale: SceneScale, [x, y]: [f64; 2]) -> Result<Option<GroundPoint>, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite([x, y, 0.0], ["x", "y", "z"])?;
    let Some(face) = Face::at(posts.grid(), [x, y]) else { return Ok(None) };
    let Some(heights) = face.heights(posts)? else { return Ok(None) };
    let height = surface_over(face, heights, [x, y]);
    let triangle = known_triangle(posts, face)?;
    let normal = triangle.map(|triangle| normal(posts, scale, triangle)).transpose()?.flatten();
    Ok(Some(GroundPoint { height, triangle, normal }))
}

/// The upward unit normal of a triangle in the scene frame; `None` when it is not known.
pub(super) fn normal<H>(
    posts: &mut Posts<'_, H>,
    scale: SceneScale,
    triangle: [Post; 3],
) -> Result<Option<[f64; 3]>, ReadError>
where
    H: HeightField + ?Sized,
{
    let face = Face::Triangle(triangle);
    let Some(heights) = face.heights(posts)? else { return Ok(None) };
    let plane = Plane::new(face, heights);
    let slope = |[low, high]: [f64; 2], step_m: f64| (high - low) * scale.up_m / step_m;
    let (east, north) = (slope(plane.east, scale.east_m), slope(plane.north, scale.north_m));
    // Scaled by the greatest part, so that the square of a cliff of 1e300 does not overflow.
    let size = east.abs().max(north.abs()).max(1.0);
    let [x, y, z] = [-east / size, -north / size, 1.0 / size];
    let length = (x * x + y * y + z * z).sqrt();
    Ok(Some([x / length, y / length, z / length]))
}
