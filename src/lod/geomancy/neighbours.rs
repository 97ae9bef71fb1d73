//! The neighbour map of White, "GEOmancy", section 3.5.2: one table for all bintrees of all tiles.
//!
//! A node's neighbours follow from its parent's. For a triangle seen with its base below and its apex above:
//!
//! ```text
//!          apex               left child: left neighbour  = the right child,
//!         ╱  │  ╲                         right neighbour = a child of the base neighbour,
//!   left ╱   │   ╲ right                  base neighbour  = a child of the left neighbour;
//!       ╱ L  │  R ╲           right child: mirrored.
//!      left──┴──right
//!          base               (The paper's list has "right child" as the right child's right neighbour: the left.)
//! ```
//!
//! Which child it is: below the roots a triangle's left edge is always a right edge to its neighbour and the other way
//! round; but root triangles of adjacent tiles, whose diagonals run alike, have left against left and right against
//! right.

use super::tree::{left_child, right_child};

/// In which tree a neighbour is, as seen from a tree's own.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Link {
    /// The same tree.
    Same,
    /// The tree beyond the root's left edge.
    Left,
    /// The tree beyond the root's right edge.
    Right,
    /// The tree beyond the root's base.
    Hypotenuse,
}

/// A neighbour: its tree and its node.
type Neighbour = (Link, u32);

/// The neighbour beyond the base of every node.
#[derive(Clone, Debug)]
pub(super) struct NeighbourMap {
    base: Vec<Neighbour>,
}

impl NeighbourMap {
    /// The map of trees with `nodes` nodes.
    pub(super) fn new(nodes: u32) -> Self {
        let mut base = vec![(Link::Hypotenuse, 0)];
        let (mut left, mut right) = (vec![(Link::Left, 0)], vec![(Link::Right, 0)]);
        for node in 0..(nodes - 1) / 2 {
            let n = node as usize;
            let (b, l, r) = (base[n], left[n], right[n]);
            let of = |(link, index): Neighbour, child: fn(u32) -> u32| (link, child(index));
            let root = node == 0;
            // The left child.
            left.push((Link::Same, right_child(node)));
            right.push(of(b, right_child));
            base.push(of(l, if root { left_child } else { right_child }));
            // The right child.
            left.push(of(b, left_child));
            right.push((Link::Same, left_child(node)));
            base.push(of(r, if root { right_child } else { left_child }));
        }
        Self { base }
    }

    /// The neighbour that shares a node's base: its partner in the diamond.
    pub(super) fn base(&self, node: u32) -> Neighbour {
        self.base[node as usize]
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.base.as_slice())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_of_the_first_three_levels_by_hand() {
        let map = NeighbourMap::new(15);
        // Figure 3 of the paper: the root's base neighbour is H; its children's are L and R.
        assert_eq!(map.base(0), (Link::Hypotenuse, 0));
        assert_eq!(map.base(1), (Link::Left, 1));
        assert_eq!(map.base(2), (Link::Right, 2));
        // Triangle 3 is the left child of the left child. Its base is the left edge of 1, which 2 shares as its right edge:
        // so its partner is the right child of 2, triangle 6, in the same tree, and the other way round.
        assert_eq!(map.base(3), (Link::Same, 6));
        assert_eq!(map.base(6), (Link::Same, 3));
        // Triangle 4's base is the right edge of 1, half of the root's base: beyond it, in H, lies the left edge of
        // H's right child 2, which is the base of 2's left child, triangle 5. And the mirror image.
        assert_eq!(map.base(4), (Link::Hypotenuse, 5));
        assert_eq!(map.base(5), (Link::Hypotenuse, 4));
        assert_eq!(map.base.len(), 15);
    }
}
