//! Whether a mesh is clear of a visible line, without looking at what lies well below it.
//!
//! The corners of mesh triangles within a triangle of the hierarchy that lies in the grid are posts of it, and none is
//! further above its plane than its thickness. So where a line passes above the plane raised by that much, it passes
//! above every mesh triangle there. A line across a valley is settled by a few large triangles.

use sightline_proto::{
    diamond::{Post, Triangle},
    verdict::passes_below,
};

use super::{RequiredLine, ground::moved, near::may_touch};
use crate::roam::{Terrain, queues::DualQueue};

/// Triangles whose diamond reaches further than this are not tried as a whole, in posts: they are seldom thin enough. A
/// guess.
const MAX_REACH: u32 = 64;

/// A triangle above the mesh or of it, with the heights of apex, e1 and e0.
type Piece = (Triangle, [f64; 3]);

/// Whether no triangle of the mesh rises above the line over the grid: the same as that its verdict on the mesh is VISIBLE.
pub(super) fn is_clear<T: Terrain>(mesh: &DualQueue<T>, line: &RequiredLine) -> bool {
    let grid = mesh.grid_posts();
    let height = |p: Post| mesh.height_of(p).unwrap_or(0.0);
    let mut open: Vec<Piece> = mesh.grid().root().roots().map(|t| (t, t.corners().map(height))).into();
    while let Some((triangle, heights)) = open.pop() {
        let middle = triangle.base_midpoint();
        if middle.is_some_and(|m| !may_touch(line, m)) {
            continue;
        }
        let corners = in_space(&triangle, heights);
        let Some((m, (z, tight))) = middle.and_then(|m| Some((m, mesh.active_at(m)?))) else {
            if passes_below(line.a, line.b, corners, grid) {
                return false;
            }
            continue;
        };
        let is_small = (m.i | m.j).trailing_zeros() <= MAX_REACH.ilog2();
        if is_small && lies_in(&triangle, grid) && clears(line, corners, tight, grid) {
            continue;
        }
        let [apex, e1, e0] = heights;
        let [first, second] = triangle.children(m);
        // Corners come as apex, e1, e0: those of (m, apex, e0) and (m, e1, apex).
        open.extend([(first, [z, e0, apex]), (second, [z, apex, e1])]);
    }
    true
}

/// Whether the line passes above a triangle raised by `tight`, or beside it.
fn clears(line: &RequiredLine, corners: [[f64; 3]; 3], tight: f32, grid: (u32, u32)) -> bool {
    moved(corners, tight.into()).is_some_and(|top| !passes_below(line.a, line.b, top, grid))
}

fn in_space(triangle: &Triangle, heights: [f64; 3]) -> [[f64; 3]; 3] {
    let [p, q, r] = triangle.corners();
    let at = |p: Post, z: f64| [f64::from(p.i), f64::from(p.j), z];
    [at(p, heights[0]), at(q, heights[1]), at(r, heights[2])]
}

/// Whether all corners are posts of the grid: thickness is not measured over padding.
fn lies_in(triangle: &Triangle, (nx, ny): (u32, u32)) -> bool {
    triangle.corners().iter().all(|p| p.i < nx && p.j < ny)
}
