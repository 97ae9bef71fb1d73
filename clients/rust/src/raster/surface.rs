//! Triangles in the scene frame, ready to draw.

use std::{collections::BTreeMap, sync::Arc};

use glam::DVec3;
use sightline_proto::{
    diamond::{Post, Triangle},
    mesh::Mesh,
};

use super::Voids;

/// Triangles in the scene frame (metres east, north and up of post (0, 0)).
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Surface {
    /// Corner positions.
    pub vertices: Vec<[f64; 3]>,
    /// Indices of the corners of each triangle, counter-clockwise seen from above.
    pub triangles: Vec<[u32; 3]>,
    /// South-west and north-east corner of the plan rectangle that is drawn; what lies beyond is cut off.
    pub extent: [[f64; 2]; 2],
    /// Where its ground is filled in for want of data.
    pub voids: Option<Arc<Voids>>,
}

impl Surface {
    /// The triangles of a mesh that share interior with its grid. `metres` are the scene frame's constants: metres
    /// per post east and north, metres per height unit.
    pub fn of_mesh(mesh: &impl Mesh, metres: [f64; 3]) -> Self {
        let (nx, ny) = mesh.grid_size();
        let east_north = [f64::from(nx - 1) * metres[0], f64::from(ny - 1) * metres[1]];
        let mut out = Self { extent: [[0.0; 2], east_north], ..Self::default() };
        let mut index = BTreeMap::new();
        mesh.for_each_triangle(|t| {
            if meets_grid(&t, nx, ny) {
                let corners = t.corners().map(|p| *index.entry(p).or_insert_with(|| out.push(mesh, p, metres)));
                out.triangles.push(corners);
            }
        });
        out
    }

    fn push(&mut self, mesh: &impl Mesh, p: Post, metres: [f64; 3]) -> u32 {
        // Corners of a mesh's triangles are active by definition; a mesh that says otherwise is drawn flat there.
        let z = mesh.height(p).unwrap_or(0.0);
        self.vertices.push([f64::from(p.i) * metres[0], f64::from(p.j) * metres[1], z * metres[2]]);
        (self.vertices.len() - 1) as u32
    }

    /// Whether the ground at a place of the plan is filled in.
    pub(super) fn is_void(&self, x_m: f64, y_m: f64) -> bool {
        self.voids.as_ref().is_some_and(|voids| {
            let [low, high] = self.extent;
            voids.at([(x_m - low[0]) / (high[0] - low[0]), (y_m - low[1]) / (high[1] - low[1])])
        })
    }

    /// Least and greatest height in metres; both 0 without vertices.
    pub fn height_range_m(&self) -> [f64; 2] {
        let mut heights = self.vertices.iter().map(|v| v[2]);
        let Some(first) = heights.next() else { return [0.0; 2] };
        heights.fold([first; 2], |[low, high], z| [low.min(z), high.max(z)])
    }

    /// Area-weighted unit normals of the vertices, after stretching heights by `relief`.
    pub(super) fn normals(&self, relief: f64) -> Vec<DVec3> {
        let mut sums = vec![DVec3::ZERO; self.vertices.len()];
        for t in &self.triangles {
            let n = self.face_normal(t, relief);
            for &v in t {
                sums[v as usize] += n;
            }
        }
        sums.into_iter().map(|n| n.normalize_or(DVec3::Z)).collect()
    }

    /// Normal of a triangle, twice its area long, after stretching heights by `relief`.
    pub(super) fn face_normal(&self, t: &[u32; 3], relief: f64) -> DVec3 {
        let [a, b, c] = t.map(|v| DVec3::from_array(self.vertices[v as usize]) * DVec3::new(1.0, 1.0, relief));
        (b - a).cross(c - a)
    }
}

/// Whether the triangle's bounding box shares interior with the grid: exact, for a bintree triangle reaches the
/// south-western corner of its box or has its box wholly on one side of each grid border.
fn meets_grid(t: &Triangle, nx: u32, ny: u32) -> bool {
    let west = t.corners().iter().map(|p| p.i).min().unwrap_or(0);
    let south = t.corners().iter().map(|p| p.j).min().unwrap_or(0);
    west < nx - 1 && south < ny - 1
}
