//! The walk that people write: from cell to cell (Amanatides and Woo, "A fast voxel traversal algorithm for ray
//! tracing", 1987), in each the height of the line against that of the surface where it crosses the cell's diagonal and
//! where it leaves, until it is below. All in rounded f64 over one array of f32. Made as fast as a plain walk goes: no
//! division in the loop, two heights read for each comparison.

use sightline::terrain::{HeightField, MemoryField, PAGE_SIDE, PageId, ReadError};

/// Heights row by row; void posts at the height at which they are drawn.
pub struct GridWalk {
    nx: usize,
    ny: usize,
    heights: Vec<f32>,
}

impl GridWalk {
    pub fn new(field: &MemoryField) -> Result<Self, ReadError> {
        let (nx, ny) = (field.grid().nx() as usize, field.grid().ny() as usize);
        let mut heights = Vec::with_capacity(nx * ny);
        for j in 0..ny as u32 {
            for pi in 0..field.grid().pages().0 {
                let page = field.page(PageId { pi, pj: j / PAGE_SIDE })?;
                let west = pi * PAGE_SIDE;
                let posts =
                    (west..(west + PAGE_SIDE).min(nx as u32)).map(|i| page.at(i - west, j % PAGE_SIDE).z as f32);
                heights.extend(posts);
            }
        }
        Ok(Self { nx, ny, heights })
    }

    /// Rows of heights, for others that read them.
    pub fn heights(&self) -> &[f32] {
        &self.heights
    }

    pub fn is_blocked(&self, [a, b]: [[f64; 3]; 2]) -> bool {
        let [dx, dy, dz] = [0, 1, 2].map(|k| b[k] - a[k]);
        let last = [self.nx as i64 - 2, self.ny as i64 - 2];
        let (mut i, mut j) = ((a[0] as i64).min(last[0]), (a[1] as i64).min(last[1]));
        let (step_i, step_j) = (if dx > 0.0 { 1 } else { -1 }, if dy > 0.0 { 1 } else { -1 });
        let per = |d: f64| if d == 0.0 { f64::INFINITY } else { 1.0 / d };
        let (per_x, per_y) = (per(dx), per(dy));
        let next = |cell: i64, step: i64, from: f64, per: f64| {
            if per.is_infinite() { per } else { ((cell + i64::from(step > 0)) as f64 - from) * per }
        };
        let (mut t_x, mut t_y) = (next(i, step_i, a[0], per_x), next(j, step_j, a[1], per_y));
        let (d_x, d_y) = (per_x.abs(), per_y.abs());
        let (per_sum, per_difference) = (per(dx + dy), per(dx - dy));
        let stride = self.nx as i64;
        let below = |t: f64, along: f64, p: i64, q: i64| {
            let (p, q) = (f64::from(self.heights[p as usize]), f64::from(self.heights[q as usize]));
            a[2] + t * dz < p + along * (q - p)
        };
        let mut t = 0.0;
        loop {
            let corner = j * stride + i;
            let end = t_x.min(t_y).min(1.0);
            // The cell's diagonal lies on x - y = i - j, or on x + y = i + j + 1.
            let (t_diagonal, p, q) = if (i + j) & 1 == 0 {
                (((i - j) as f64 - (a[0] - a[1])) * per_difference, corner, corner + stride + 1)
            } else {
                (((i + j + 1) as f64 - (a[0] + a[1])) * per_sum, corner + stride, corner + 1)
            };
            if t_diagonal > t && t_diagonal < end && below(t_diagonal, a[0] + t_diagonal * dx - i as f64, p, q) {
                return true;
            }
            if end >= 1.0 {
                return false;
            }
            if t_x < t_y {
                let p = corner + i64::from(step_i > 0);
                if below(t_x, a[1] + t_x * dy - j as f64, p, p + stride) {
                    return true;
                }
                i += step_i;
                t = t_x;
                t_x += d_x;
            } else {
                let p = corner + if step_j > 0 { stride } else { 0 };
                if below(t_y, a[0] + t_y * dx - i as f64, p, p + 1) {
                    return true;
                }
                j += step_j;
                t = t_y;
                t_y += d_y;
            }
            if i < 0 || j < 0 || i > last[0] || j > last[1] {
                return false;
            }
        }
    }
}
