//! The walk that people write: from cell to cell (Amanatides and Woo, "A fast voxel traversal algorithm for ray
//! tracing", 1987), and in each the height of the line against that of the surface where it crosses the cell's diagonal
//! and where it leaves. All in rounded f64.

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

    fn height(&self, i: usize, j: usize) -> f64 {
        f64::from(self.heights[j * self.nx + i])
    }

    /// The surface at a place of cell (i, j), from its west and south.
    fn surface(&self, (i, j): (usize, usize), [u, v]: [f64; 2]) -> f64 {
        let [sw, se, nw, ne] = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| self.height(i, j));
        match ((i + j) % 2 == 0, u > v, u + v > 1.0) {
            (true, true, _) => sw + u * (se - sw) + v * (ne - se),
            (true, false, _) => sw + v * (nw - sw) + u * (ne - nw),
            (false, _, true) => ne + (1.0 - u) * (nw - ne) + (1.0 - v) * (se - ne),
            (false, _, false) => sw + u * (se - sw) + v * (nw - sw),
        }
    }

    pub fn is_blocked(&self, [a, b]: [[f64; 3]; 2]) -> bool {
        let by = [0, 1, 2].map(|k| b[k] - a[k]);
        let last = [self.nx - 2, self.ny - 2];
        let mut cell = [0, 1].map(|k| (a[k] as usize).min(last[k]));
        let goal = [0, 1].map(|k| (b[k] as usize).min(last[k]));
        let leaves = |cell: [usize; 2], k: usize| match by[k] {
            d if d > 0.0 => (cell[k] as f64 + 1.0 - a[k]) / d,
            d if d < 0.0 => (cell[k] as f64 - a[k]) / d,
            _ => f64::INFINITY,
        };
        let mut t = 0.0;
        loop {
            let ends = [leaves(cell, 0), leaves(cell, 1)];
            let axis = usize::from(ends[1] < ends[0]);
            let end = ends[axis].min(1.0);
            let at = |t: f64| [0, 1].map(|k| a[k] + t * by[k] - cell[k] as f64);
            let below = |t: f64| a[2] + t * by[2] < self.surface((cell[0], cell[1]), at(t));
            let side = |[u, v]: [f64; 2]| if (cell[0] + cell[1]) % 2 == 0 { u - v } else { u + v - 1.0 };
            let (from, to) = (side(at(t)), side(at(end)));
            if from * to < 0.0 && below(t + (end - t) * from / (from - to)) || below(end) {
                return true;
            }
            if end >= 1.0 || cell == goal {
                return false;
            }
            let next = cell[axis] as i64 + if by[axis] > 0.0 { 1 } else { -1 };
            if next < 0 || next > last[axis] as i64 {
                return false;
            }
            cell[axis] = next as usize;
            t = end;
        }
    }
}
