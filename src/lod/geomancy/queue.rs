//! The queues of White, "GEOmancy", section 3.4: arrays of a fixed length with a marker for their active part.
//!
//! Kept in the order of (variance, node), so that both ends can be had and an entry found by bisection.

/// Nodes of one tree in ascending order of variance.
#[derive(Clone, Debug)]
pub(super) struct FixedQueue {
    nodes: Box<[u32]>,
    len: usize,
}

impl FixedQueue {
    /// A queue for at most `most` nodes.
    pub(super) fn new(most: u32) -> Self {
        Self { nodes: vec![0; most as usize].into_boxed_slice(), len: 0 }
    }

    /// The active part.
    pub(super) fn active(&self) -> &[u32] {
        &self.nodes[..self.len]
    }

    fn place(&self, variance: &[f32], node: u32) -> Result<usize, usize> {
        let v = |n: u32| variance[n as usize];
        self.active().binary_search_by(|&n| v(n).total_cmp(&v(node)).then(n.cmp(&node)))
    }

    /// Adds a node, unless it is there.
    pub(super) fn push(&mut self, variance: &[f32], node: u32) {
        if let Err(at) = self.place(variance, node) {
            self.nodes.copy_within(at..self.len, at + 1);
            self.nodes[at] = node;
            self.len += 1;
        }
    }

    /// Removes a node, if it is there.
    pub(super) fn remove(&mut self, variance: &[f32], node: u32) {
        if let Ok(at) = self.place(variance, node) {
            self.nodes.copy_within(at + 1..self.len, at);
            self.len -= 1;
        }
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.nodes)
    }
}
