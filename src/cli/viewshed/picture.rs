//! A viewshed as a picture: shaded relief from above, north up, in true proportions; what is seen is tinted, what is
//! not lies in the dark, unknown ground is blue, and a ring marks the observer.

use sightline_client::raster::Picture;
use sightline_proto::diamond::Post;

use crate::{
    cli::relief::brightness,
    los::{Tile, Verdict},
    terrain::{HeightField, PAGE_SIDE, Posts, ReadError, SceneScale},
};

/// Pixels along the longer side.
const LONGER_PX: f64 = 1200.0;
/// Samples along each side of a pixel.
const SAMPLES: u32 = 2;
const SEEN: [f64; 3] = [1.0, 0.80, 0.30];
const HIDDEN: [f64; 3] = [0.40, 0.46, 0.52];
const UNKNOWN: [f64; 3] = [0.45, 0.62, 0.80];
const PAPER: [f64; 3] = [0.95, 0.95, 0.92];
const OBSERVER: [u8; 3] = [205, 20, 40];

/// The cells of a viewshed, all of them: one byte a post.
pub(super) struct Map {
    low: [u32; 2],
    high: [u32; 2],
    cells: Vec<Option<Verdict>>,
}

impl Map {
    /// A map without cells yet of posts from `[west, south]` to `[east, north]`.
    pub(super) fn new([low, high]: [[u32; 2]; 2]) -> Self {
        let [wide, tall] = [0, 1].map(|k| (high[k] - low[k] + 1) as usize);
        Self { low, high, cells: vec![None; wide * tall] }
    }

    fn at(&self, i: u32, j: u32) -> usize {
        (j - self.low[1]) as usize * (self.high[0] - self.low[0] + 1) as usize + (i - self.low[0]) as usize
    }

    pub(super) fn add(&mut self, tile: &Tile) {
        for (n, &verdict) in (0..).zip(&tile.cells) {
            if verdict.is_some() {
                let at = self.at(tile.page.pi * PAGE_SIDE + n % PAGE_SIDE, tile.page.pj * PAGE_SIDE + n / PAGE_SIDE);
                self.cells[at] = verdict;
            }
        }
    }

    /// Draws the map.
    pub(super) fn draw<H>(
        &self,
        field: &H,
        scale: SceneScale,
        observer: [f64; 3],
        caption: &[String],
    ) -> Result<Picture, ReadError>
    where
        H: HeightField + ?Sized,
    {
        let steps = [scale.east_m, scale.north_m];
        // Half a post more on each side: a cell is drawn around its post.
        let size_m = [0, 1].map(|k| f64::from(self.high[k] - self.low[k] + 1) * steps[k]);
        let px_m = size_m[0].max(size_m[1]) / LONGER_PX;
        let [width, height] = size_m.map(|m| (m / px_m).ceil().max(1.0) as u32);
        let mut picture = Picture::blank(width, height, [0; 3]);
        let mut posts = Posts::new(field);
        let mut pixels = Vec::with_capacity(picture.rgb.len());
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0; 3];
                for sample in 0..SAMPLES * SAMPLES {
                    let place = |pixel: u32, k: u32| f64::from(pixel) + (f64::from(k) + 0.5) / f64::from(SAMPLES);
                    let east = place(x, sample % SAMPLES) * px_m / steps[0] - 0.5;
                    let north = (size_m[1] - place(y, sample / SAMPLES) * px_m) / steps[1] - 0.5;
                    let at = [f64::from(self.low[0]) + east, f64::from(self.low[1]) + north];
                    let colour = self.colour(&mut posts, scale, at)?;
                    sum = [0, 1, 2].map(|k| sum[k] + colour[k]);
                }
                let share = 255.0 / f64::from(SAMPLES * SAMPLES);
                pixels.extend(sum.map(|v| (v * share).clamp(0.0, 255.0) as u8));
            }
        }
        picture.rgb = pixels;
        let east = (observer[0] - f64::from(self.low[0]) + 0.5) * steps[0] / px_m;
        let down = (size_m[1] - (observer[1] - f64::from(self.low[1]) + 0.5) * steps[1]) / px_m;
        mark(&mut picture, [east, down]);
        picture.caption(caption);
        Ok(picture)
    }

    /// The colour of a point of the grid frame.
    fn colour<H>(&self, posts: &mut Posts<'_, H>, scale: SceneScale, at: [f64; 2]) -> Result<[f64; 3], ReadError>
    where
        H: HeightField + ?Sized,
    {
        let [i, j] = [0, 1].map(|k| (at[k].round().max(0.0) as u32).clamp(self.low[k], self.high[k]));
        let Some(verdict) = self.cells[self.at(i, j)] else { return Ok(PAPER) };
        let tint = match verdict {
            Verdict::Visible => SEEN,
            Verdict::Blocked => HIDDEN,
            Verdict::Unknown => UNKNOWN,
        };
        let light = light(posts, scale, at)?;
        Ok(tint.map(|v| v * light))
    }
}

/// Brightness of the ground at a point, from slopes between posts.
fn light<H>(posts: &mut Posts<'_, H>, scale: SceneScale, [x, y]: [f64; 2]) -> Result<f64, ReadError>
where
    H: HeightField + ?Sized,
{
    let grid = posts.grid();
    let (i, j) = (x.max(0.0) as u32, y.max(0.0) as u32);
    let (i, j) = (i.min(grid.nx() - 2), j.min(grid.ny() - 2));
    let mut z = [0.0; 4];
    for (z, [di, dj]) in z.iter_mut().zip([[0, 0], [1, 0], [0, 1], [1, 1]]) {
        let post = posts.at(Post::new(i + di, j + dj))?;
        if post.void {
            return Ok(0.9);
        }
        *z = post.z * scale.up_m;
    }
    let [u, v] = [(x - f64::from(i)).clamp(0.0, 1.0), (y - f64::from(j)).clamp(0.0, 1.0)];
    let east = ((z[1] - z[0]) * (1.0 - v) + (z[3] - z[2]) * v) / scale.east_m;
    let north = ((z[2] - z[0]) * (1.0 - u) + (z[3] - z[1]) * u) / scale.north_m;
    Ok(brightness([east, north]))
}

/// A dot in a white ring.
fn mark(picture: &mut Picture, [x, y]: [f64; 2]) {
    let reach = 11;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let (px, py) = (x.floor() + f64::from(dx), y.floor() + f64::from(dy));
            let away = ((px + 0.5 - x) * (px + 0.5 - x) + (py + 0.5 - y) * (py + 0.5 - y)).sqrt();
            if px < 0.0 || py < 0.0 {
                continue;
            }
            let edge = |radius: f64| ((radius - away).clamp(0.0, 1.0) * 255.0) as u32;
            picture.blend(px as u32, py as u32, [20, 20, 24], edge(10.0));
            picture.blend(px as u32, py as u32, [255, 255, 255], edge(9.0));
            picture.blend(px as u32, py as u32, OBSERVER, edge(5.5));
        }
    }
}
