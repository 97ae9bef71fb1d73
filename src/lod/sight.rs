//! The exact verdict of a sight line on any mesh of triangles over posts.
//!
//! The same two-valued verdict as on a bintree mesh (`sightline_proto::verdict`): BLOCKED when some point of the closed
//! segment AB over the grid rectangle lies strictly below the mesh, else VISIBLE. Edges here may run in any direction,
//! so a triangle is not cut at the border of the grid; instead the border's four sides join the triangle's three as half
//! planes. The part of AB over all of them is an interval whose ends are A, B or crossings with one of the lines. Over
//! one triangle both the line and the mesh are linear, so those ends decide; every sign is exact
//! (`sightline_proto::predicates`).
//!
//! At a crack both sides count: the line must clear each triangle.

use sightline_proto::{
    predicates::{Exact, Sign, height_of_crossing, orient2d, orient3d, plan, side_of_crossing},
    verdict::MeshVerdict,
};

use super::mesh::IndexedMesh;
use crate::terrain::Grid;

/// Cells along the side of a bin of triangles. A guess: small against long lines, large against triangles; a
/// measurement of `SightIndex::verdict` on large meshes would change it.
const BIN_CELLS: u32 = 32;

/// A half plane in plan: the points to the left of the directed line, or on it.
type HalfPlane = [[f64; 2]; 2];

/// Whether some point of AB over the closed triangle `corners` (counter-clockwise in plan, not of area zero) and the
/// grid rectangle lies strictly below the triangle's plane. Exact for all finite numbers.
pub fn passes_below(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], grid: Grid) -> bool {
    let [p, q, r] = corners;
    let (pa, pb) = (plan(a), plan(b));
    let sides = corners.map(|c| orient2d(pa, pb, plan(c)));
    if sides[0] != Sign::Zero && sides[1] == sides[0] && sides[2] == sides[0] {
        return false;
    }
    let ends = [orient3d(p, q, r, a), orient3d(p, q, r, b)];
    if ends[0] != Sign::Negative && ends[1] != Sign::Negative {
        return false;
    }
    let planes = half_planes(corners, grid);
    // On which side of each half plane the two ends lie.
    let at: Vec<[Sign; 2]> = planes.iter().map(|[u, v]| [orient2d(*u, *v, pa), orient2d(*u, *v, pb)]).collect();
    for end in 0..2 {
        if ends[end] == Sign::Negative && at.iter().all(|s| s[end] >= Sign::Zero) {
            return true;
        }
    }
    (0..planes.len()).any(|k| {
        let [sa, sb] = at[k];
        sa != sb
            && height_of_crossing::<Exact>([a, b], planes[k], corners) == Sign::Negative
            && (0..planes.len())
                .all(|n| n == k || side_of_crossing::<Exact>([pa, pb], planes[k], planes[n]) >= Sign::Zero)
    })
}

/// The sides of a triangle, and those of the grid where the triangle leaves it.
fn half_planes(corners: [[f64; 3]; 3], grid: Grid) -> Vec<HalfPlane> {
    let [p, q, r] = corners.map(plan);
    let (east, north) = (f64::from(grid.nx() - 1), f64::from(grid.ny() - 1));
    let mut planes = vec![[p, q], [q, r], [r, p]];
    if corners.iter().any(|c| c[0] < 0.0 || c[0] > east || c[1] < 0.0 || c[1] > north) {
        planes.extend([
            [[0.0, 0.0], [1.0, 0.0]],
            [[east, 0.0], [east, 1.0]],
            [[1.0, north], [0.0, north]],
            [[0.0, 1.0], [0.0, 0.0]],
        ]);
    }
    planes
}

/// The triangles of a mesh in bins, for many sight lines on one mesh.
#[derive(Debug)]
pub struct SightIndex<'a> {
    mesh: &'a IndexedMesh,
    grid: Grid,
    columns: u32,
    rows: u32,
    /// The triangles whose bounding box meets each bin.
    bins: Vec<Vec<u32>>,
}

impl<'a> SightIndex<'a> {
    /// Bins the triangles of `mesh`, a mesh of a terrain of extent `grid`.
    pub fn new(mesh: &'a IndexedMesh, grid: Grid) -> Self {
        let count = |cells: u32| cells / BIN_CELLS + 1;
        let (columns, rows) = (count(mesh.extent[0]), count(mesh.extent[1]));
        let mut bins = vec![Vec::new(); columns as usize * rows as usize];
        for (n, t) in mesh.iter().enumerate() {
            let [i, j] = [t.map(|v| v.post.i / BIN_CELLS), t.map(|v| v.post.j / BIN_CELLS)];
            let range = |v: [u32; 3]| v[0].min(v[1]).min(v[2])..=v[0].max(v[1]).max(v[2]);
            for row in range(j) {
                for column in range(i) {
                    bins[(row * columns + column) as usize].push(n as u32);
                }
            }
        }
        Self { mesh, grid, columns, rows, bins }
    }

    /// The verdict of AB. Ends are finite, in the grid frame. Exact and symmetric in A and B.
    pub fn verdict(&self, a: [f64; 3], b: [f64; 3]) -> MeshVerdict {
        let range = |axis: usize, bins: u32| {
            let bin = |v: f64| (v / f64::from(BIN_CELLS)).floor().clamp(0.0, f64::from(bins - 1)) as u32;
            bin(a[axis].min(b[axis]))..=bin(a[axis].max(b[axis]))
        };
        for row in range(1, self.rows) {
            for column in range(0, self.columns) {
                if self.line_meets(column, row, a, b) && self.blocked_in(column, row, a, b) {
                    return MeshVerdict::Blocked;
                }
            }
        }
        MeshVerdict::Visible
    }

    /// Whether the line may meet a triangle of a bin: exact for the bin's own closed square, which is enough, since a
    /// triangle is in every bin that it meets.
    fn line_meets(&self, column: u32, row: u32, a: [f64; 3], b: [f64; 3]) -> bool {
        let (x, y) = (f64::from(column * BIN_CELLS), f64::from(row * BIN_CELLS));
        let s = f64::from(BIN_CELLS);
        let sides = [[x, y], [x + s, y], [x, y + s], [x + s, y + s]].map(|c| orient2d(plan(a), plan(b), c));
        sides[0] == Sign::Zero || sides.iter().any(|&t| t != sides[0])
    }

    fn blocked_in(&self, column: u32, row: u32, a: [f64; 3], b: [f64; 3]) -> bool {
        let apart = |p: f64, q: f64, v: [f64; 3]| {
            let (low, high) = (p.min(q), p.max(q));
            v.iter().all(|&v| v < low) || v.iter().all(|&v| v > high)
        };
        self.bins[(row * self.columns + column) as usize].iter().any(|&n| {
            let corners = self.mesh.corners(self.mesh.triangles[n as usize]).map(|v| v.point());
            let axis = |k: usize| corners.map(|c| c[k]);
            !apart(a[0], b[0], axis(0)) && !apart(a[1], b[1], axis(1)) && passes_below(a, b, corners, self.grid)
        })
    }
}

/// The verdict of AB on `mesh`, for a single line.
pub fn verdict(mesh: &IndexedMesh, grid: Grid, a: [f64; 3], b: [f64; 3]) -> MeshVerdict {
    SightIndex::new(mesh, grid).verdict(a, b)
}
