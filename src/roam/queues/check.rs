//! Checks all that is taken for granted of lists, guards and priorities, for tests.

use super::{
    DualQueue, Terrain,
    nodes::{List, Side},
};
use crate::view::Planes;

impl<T: Terrain> DualQueue<T> {
    /// Checks all that is taken for granted of lists, guards and priorities, by computing everything.
    pub(in crate::roam) fn check(&self) {
        for node in self.nodes.all() {
            let (is, _) = self.priority(node, Planes::default());
            let children = self.root.children(node.post).filter(|&c| self.height_of(c).is_some()).count();
            assert_eq!(usize::from(node.active_children), children);
            let side = if !node.active {
                Side::Split
            } else if node.required || children > 0 {
                assert_eq!(node.list(), List::NONE);
                continue;
            } else {
                Side::Merge
            };
            if node.list() == List::hot(side) {
                assert_eq!((node.look, node.priority.to_bits()), (self.look, is.to_bits()));
                continue;
            }
            let lists = (0..List::BUCKETS.into()).map(|tick| List::due(side, tick));
            assert!(lists.into_iter().any(|list| list == node.list()), "{node:?} is in no list");
            let beyond = match side {
                Side::Split => is == 0.0 || is < self.split_guard.value,
                Side::Merge => is > self.merge_guard.value,
            };
            assert!(beyond, "{is} of {node:?} is not beyond {:?}, {:?}", self.split_guard, self.merge_guard);
        }
    }
}
