//! The description of a terrain that clients get.

use sightline_proto::v1;

use crate::{
    exercise::Site,
    terrain::{HeightField, Posts, ReadError},
};

/// What is told of a terrain beside its grid and place.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Details {
    /// Content hash of the terrain.
    pub version: Vec<u8>,
    /// Lowest and highest height of a known post, in height units.
    pub height_range: [f64; 2],
    /// Number of void posts.
    pub void_posts: u64,
}

/// Describes the terrain of `field`. Heights of corners that are not integers are rounded down; no frame of such a
/// terrain can be made, and [`super::View::open`] says so.
pub fn describe(field: &impl HeightField, site: &Site, details: &Details) -> Result<v1::TerrainDescription, ReadError> {
    let grid = field.grid();
    let mut posts = Posts::new(field);
    let mut corner_heights = Vec::with_capacity(4);
    for corner in grid.root().corners() {
        corner_heights.push(posts.at(corner)?.z.floor() as i64);
    }
    let georeference = site.georeference.as_ref();
    let [map_origin_x, map_origin_y] = georeference.map_or([0.0; 2], |g| g.origin);
    let [map_step_x, map_step_y] = georeference.map_or([0.0; 2], |g| g.step);
    Ok(v1::TerrainDescription {
        version: details.version.clone(),
        nx: grid.nx(),
        ny: grid.ny(),
        root_exponent: grid.root().exponent().into(),
        metres_per_post_east: site.scale.east_m,
        metres_per_post_north: site.scale.north_m,
        metres_per_height_unit: site.scale.up_m,
        min_height: details.height_range[0],
        max_height: details.height_range[1],
        void_posts: details.void_posts,
        map_origin_x,
        map_origin_y,
        map_step_x,
        map_step_y,
        epsg: georeference.and_then(|g| g.epsg).unwrap_or(0),
        geographic: georeference.is_some_and(|g| g.geographic),
        corner_heights,
    })
}
