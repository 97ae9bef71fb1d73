//! A mesh as a set of active posts, and its triangles.
//!
//! A mesh is a set of active posts that contains the four corners and, with each post, its parents. Its triangles
//! follow by descending from the roots and splitting wherever the base midpoint is active. Two sides that hold the
//! same set hold the same mesh, in whatever order it was built.

use std::collections::BTreeSet;

use crate::diamond::{Post, RootSquare, Triangle};

/// A mesh that can be asked for its active posts. Heights are exact f64 values in height units.
pub trait Mesh {
    /// The root square.
    fn root(&self) -> RootSquare;

    /// Posts of the grid from west to east and from south to north; the rest of the square is padding.
    fn grid_size(&self) -> (u32, u32);

    /// The height of an active post; `None` when `p` is not active. The corners are always active.
    fn height(&self, p: Post) -> Option<f64>;

    /// Calls `visit` with every triangle of the mesh, in depth-first order.
    fn for_each_triangle(&self, mut visit: impl FnMut(Triangle))
    where
        Self: Sized,
    {
        let [south_east, north_west] = self.root().roots();
        let mut stack = vec![north_west, south_east];
        while let Some(t) = stack.pop() {
            match t.base_midpoint().filter(|&m| self.height(m).is_some()) {
                Some(m) => {
                    let [first, second] = t.children(m);
                    stack.extend([second, first]);
                }
                None => visit(t),
            }
        }
    }
}

/// The active posts of the coarsest mesh that holds `posts`: the corners, and with each post all its ancestors.
///
/// Posts outside the square are passed over.
pub fn closure(root: RootSquare, posts: impl IntoIterator<Item = Post>) -> BTreeSet<Post> {
    let mut closed = BTreeSet::from(root.corners());
    let mut open: Vec<Post> = posts.into_iter().filter(|&p| root.contains(p)).collect();
    while let Some(p) = open.pop() {
        if closed.insert(p) {
            open.extend(root.parents(p));
        }
    }
    closed
}

/// How many triangles a closed set of active posts makes: each diamond that is split adds one for each of its halves.
pub fn triangle_count<'a>(root: RootSquare, active: impl IntoIterator<Item = &'a Post>) -> u64 {
    active.into_iter().fold(2, |sum, &p| sum + root.triangles(p).count() as u64)
}
