//! Shaded relief: how bright ground of a slope is, and a small picture of a whole terrain.

use sightline_client::raster::{self, Picture};
use sightline_proto::diamond::Post;

use crate::{
    database::Database,
    terrain::{Posts, ReadError, SceneScale, extremes::BLOCK_SIDE},
};

/// How much steeper slopes look to the light than they are.
const RELIEF: f64 = 1.6;
/// Pixels along the longer side of a small picture.
const LONGER_PX: f64 = 512.0;
/// Colours from the least height to the greatest, evenly apart.
const HEIGHTS: [[f64; 3]; 5] =
    [[0.42, 0.58, 0.40], [0.70, 0.74, 0.50], [0.86, 0.76, 0.56], [0.74, 0.60, 0.50], [0.97, 0.97, 0.97]];
/// Brightness of voids.
const VOID_LIGHT: f64 = 0.9;

/// Brightness of ground that rises by so much a metre east and north: sun in the north-west, and sky.
pub(super) fn brightness([east, north]: [f64; 2]) -> f64 {
    let [east, north] = [east, north].map(|slope| slope * RELIEF);
    let length = (1.0 + east * east + north * north).sqrt();
    let sun = (0.5417 * east - 0.5417 * north + 0.6428) / length;
    0.38 + 0.16 / length + 0.70 * sun.max(0.0)
}

/// A picture of a terrain from above, north up, in true proportions: shaded, tinted by height, voids blue. Where a pixel
/// covers a block of the database's least and greatest heights it shows the greatest, so that a large terrain is not read.
pub(super) fn thumbnail(database: &Database) -> Result<Picture, ReadError> {
    let (grid, SceneScale { east_m, north_m, up_m }) = (database.grid(), database.scale());
    let steps_m = [east_m, north_m];
    let size_m = [f64::from(grid.nx() - 1) * east_m, f64::from(grid.ny() - 1) * north_m];
    let px_m = size_m[0].max(size_m[1]) / LONGER_PX;
    let [width, height] = size_m.map(|m| (m / px_m).round().max(1.0) as u32);
    let coarse = px_m / east_m.max(north_m) >= f64::from(BLOCK_SIDE);
    let mut posts = Posts::new(database);
    let mut height_at = |x: u32, y: u32| -> Result<Option<f64>, ReadError> {
        let along = |pixel: u32, axis: usize| (f64::from(pixel) * px_m / steps_m[axis]) as u32;
        let post = grid.clamp(Post::new(along(x, 0), along(y, 1)));
        if coarse && let Some((least, greatest)) = posts.block_around(post.i, post.j)? {
            return Ok(least.is_finite().then(|| f64::from(greatest) * up_m));
        }
        let drawn = posts.at(post)?;
        Ok((!drawn.void).then_some(drawn.z * up_m))
    };
    // Rows from the south, one more to the north and one column more to the east for the slopes.
    let mut row = (0..=width).map(|x| height_at(x, 0)).collect::<Result<Vec<_>, _>>()?;
    let mut picture = Picture::blank(width, height, [0; 3]);
    let (low, high) = database.height_range();
    let range_m = [low, high].map(|z| f64::from(z) * up_m);
    for y in 0..height {
        let north = (0..=width).map(|x| height_at(x, y + 1)).collect::<Result<Vec<_>, _>>()?;
        let from = ((height - 1 - y) * width * 3) as usize;
        for (x, pixel) in picture.rgb[from..][..3 * width as usize].chunks_exact_mut(3).enumerate() {
            let (tint, light) = match (row[x], row[x + 1], north[x]) {
                (Some(z), Some(east), Some(north)) => {
                    (height_tint(z, range_m), brightness([(east - z) / px_m, (north - z) / px_m]))
                }
                (Some(z), ..) => (height_tint(z, range_m), VOID_LIGHT),
                _ => (raster::NO_DATA.map(f64::from), VOID_LIGHT),
            };
            pixel.iter_mut().zip(tint).for_each(|(out, v)| *out = (255.0 * v * light).clamp(0.0, 255.0) as u8);
        }
        row = north;
    }
    Ok(picture)
}

fn height_tint(z_m: f64, [low_m, high_m]: [f64; 2]) -> [f64; 3] {
    let share = if high_m > low_m { ((z_m - low_m) / (high_m - low_m)).clamp(0.0, 1.0) } else { 0.0 };
    let place = share * (HEIGHTS.len() - 1) as f64;
    let n = (place as usize).min(HEIGHTS.len() - 2);
    let t = place - n as f64;
    [0, 1, 2].map(|k| HEIGHTS[n][k] * (1.0 - t) + HEIGHTS[n + 1][k] * t)
}
