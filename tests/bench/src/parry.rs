//! The height field of parry3d (f64), made to have our triangulation: y is up, z is north.

use parry3d_f64::{
    math::{Point, Vector},
    na::DMatrix,
    query::{Ray, RayCast},
    shape::{HeightField as ParryField, HeightFieldCellStatus},
};
use sightline::terrain::{HeightField, MemoryField, PAGE_SIDE, PageId, ReadError};

pub struct Parry {
    field: ParryField,
    /// Half the width of the grid, east and north: parry puts its middle at the origin.
    half: [f64; 2],
}

impl Parry {
    pub fn new(field: &MemoryField) -> Result<Self, ReadError> {
        let grid = field.grid();
        let (nx, ny) = (grid.nx() as usize, grid.ny() as usize);
        let mut heights = DMatrix::zeros(ny, nx);
        for pi in 0..grid.pages().0 {
            for pj in 0..grid.pages().1 {
                let page = field.page(PageId { pi, pj })?;
                let (west, south) = (pi * PAGE_SIDE, pj * PAGE_SIDE);
                for i in west..(west + PAGE_SIDE).min(grid.nx()) {
                    for j in south..(south + PAGE_SIDE).min(grid.ny()) {
                        heights[(j as usize, i as usize)] = page.at(i - west, j - south).z;
                    }
                }
            }
        }
        let (east, north) = (nx as f64 - 1.0, ny as f64 - 1.0);
        let mut parry = ParryField::new(heights, Vector::new(east, 1.0, north));
        for j in 0..ny - 1 {
            for i in (j % 2..nx - 1).step_by(2) {
                // Diagonals from south-west to north-east, where i + j is even.
                parry.set_cell_status(j, i, HeightFieldCellStatus::ZIGZAG_SUBDIVISION);
            }
        }
        Ok(Self { field: parry, half: [east / 2.0, north / 2.0] })
    }

    pub fn is_blocked(&self, [a, b]: [[f64; 3]; 2]) -> bool {
        let [from, to] = [a, b].map(|[x, y, z]| Point::new(x - self.half[0], z, y - self.half[1]));
        self.field.cast_local_ray(&Ray::new(from, to - from), 1.0, false).is_some()
    }
}
