//! Implicit bintrees, after White, "GEOmancy", sections 3.2 and 3.3: arrays in which node k has the children 2k + 1 and
//! 2k + 2, with the variance of each node, and the queues of section 3.4.

use super::queue::FixedQueue;

/// The left child of a node.
pub(super) fn left_child(node: u32) -> u32 {
    2 * node + 1
}

/// The right child of a node.
pub(super) fn right_child(node: u32) -> u32 {
    2 * node + 2
}

/// The node above one that is no root.
pub(super) fn parent(node: u32) -> u32 {
    (node - 1) / 2
}

/// A triangle's apex, left end and right end in posts of its tile.
pub(super) type Corners = [[u32; 2]; 3];

/// The corners of every node of a kind of tree, all the way down to half cells.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    corners: Vec<Corners>,
}

impl Shape {
    /// The shape of a tile of `cells` a side below a root.
    pub(super) fn new(cells: u32, root: Corners) -> Self {
        let levels = 2 * cells.trailing_zeros();
        let mut corners = vec![root];
        for node in 0..(1_usize << levels) - 1 {
            let [apex, left, right] = corners[node];
            let middle = [0, 1].map(|k| (left[k] + right[k]) / 2);
            corners.extend([[middle, apex, left], [middle, right, apex]]);
        }
        Self { corners }
    }

    pub(super) fn len(&self) -> u32 {
        self.corners.len() as u32
    }

    pub(super) fn corners(&self, node: u32) -> Corners {
        self.corners[node as usize]
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.corners.as_slice())
    }
}

/// One bintree of a tile.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    variance: Vec<f32>,
    is_split: Vec<bool>,
    /// All visible triangles.
    split_queue: FixedQueue,
    /// Split nodes neither of whose children is.
    merge_queue: FixedQueue,
}

impl Tree {
    /// A tree with only its root visible; `height_m` gives the heights of the tile's posts.
    pub(super) fn new(shape: &Shape, height_m: impl Fn(u32, u32) -> f64) -> Self {
        let nodes = shape.len();
        let inner = (nodes - 1) / 2;
        let mut variance = vec![0.0_f32; nodes as usize];
        for node in (0..inner).rev() {
            let [_, left, right] = shape.corners(node);
            let z = |[u, v]: [u32; 2]| height_m(u, v);
            let middle = [0, 1].map(|k| (left[k] + right[k]) / 2);
            let own = (z(middle) - 0.5 * (z(left) + z(right))).abs() as f32;
            let children = variance[left_child(node) as usize].max(variance[right_child(node) as usize]);
            variance[node as usize] = own.max(children);
        }
        let mut split_queue = FixedQueue::new(inner + 1);
        split_queue.push(&variance, 0);
        let merge_queue = FixedQueue::new(inner.max(1));
        Self { variance, is_split: vec![false; nodes as usize], split_queue, merge_queue }
    }

    pub(super) fn variance(&self, node: u32) -> f32 {
        self.variance[node as usize]
    }

    pub(super) fn is_split(&self, node: u32) -> bool {
        self.is_split[node as usize]
    }

    /// Number of visible triangles.
    pub(super) fn triangles(&self) -> usize {
        self.split_queue.active().len()
    }

    /// The visible triangles in ascending order of variance.
    pub(super) fn visible(&self) -> impl Iterator<Item = u32> {
        self.split_queue.active().iter().copied()
    }

    /// The visible triangle of greatest variance, if that is above `most`.
    pub(super) fn next_split(&self, most: f32) -> Option<u32> {
        self.split_queue.active().last().copied().filter(|&node| self.variance(node) > most)
    }

    /// The nodes of the merge queue with a variance of at most `most`.
    pub(super) fn mergeable(&self, most: f32) -> Vec<u32> {
        self.merge_queue.active().iter().copied().take_while(|&node| self.variance(node) <= most).collect()
    }

    /// Whether a node is split and neither of its children is.
    pub(super) fn can_merge(&self, node: u32) -> bool {
        self.is_split(node) && !self.is_split(left_child(node)) && !self.is_split(right_child(node))
    }

    /// The split operation. The node is visible, or split already: then nothing happens.
    pub(super) fn split(&mut self, node: u32) {
        if self.is_split(node) {
            return;
        }
        self.is_split[node as usize] = true;
        self.split_queue.remove(&self.variance, node);
        self.merge_queue.push(&self.variance, node);
        for child in [left_child(node), right_child(node)] {
            self.split_queue.push(&self.variance, child);
        }
        if node > 0 {
            self.merge_queue.remove(&self.variance, parent(node));
        }
    }

    /// The merge operation on a node that can be merged.
    pub(super) fn merge(&mut self, node: u32) {
        self.is_split[node as usize] = false;
        self.merge_queue.remove(&self.variance, node);
        self.split_queue.push(&self.variance, node);
        for child in [left_child(node), right_child(node)] {
            self.split_queue.remove(&self.variance, child);
        }
        if node > 0 && self.can_merge(parent(node)) {
            self.merge_queue.push(&self.variance, parent(node));
        }
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.variance.as_slice())
            + self.is_split.len()
            + self.split_queue.bytes()
            + self.merge_queue.bytes()
    }
}
