//! Places in the order, and heaps of them.

use std::{cmp::Ordering, collections::BinaryHeap};

/// A place in the order: the greater one is split first.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Place {
    /// Bits of the priority, which is not negative: bits order as values.
    pub(super) priority: u64,
    pub(super) key: u64,
    pub(super) slot: u32,
    pub(super) level: u8,
}

impl Place {
    pub(super) fn priority(self) -> f64 {
        f64::from_bits(self.priority)
    }
}

impl Ord for Place {
    fn cmp(&self, other: &Self) -> Ordering {
        let coarse_first = || (other.level, other.key).cmp(&(self.level, self.key));
        self.priority.cmp(&other.priority).then_with(coarse_first)
    }
}

impl PartialOrd for Place {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// A heap that is built when it is first asked, of the posts of a side that are near the cut.
#[derive(Debug)]
pub(super) struct Heap<P> {
    pub(super) heap: BinaryHeap<P>,
    /// The priority up to which, from the side of the cut, all hot posts are in it; `None` before it is built.
    pub(super) reach: Option<f64>,
}

impl<P: Ord> Heap<P> {
    pub(super) fn new() -> Self {
        Self { heap: BinaryHeap::new(), reach: None }
    }

    pub(super) fn forget(&mut self) {
        self.heap.clear();
        self.reach = None;
    }

    /// Makes it anew from all hot posts up to `reach`.
    pub(super) fn build(&mut self, reach: f64, places: impl Iterator<Item = P>) {
        let mut vec = std::mem::take(&mut self.heap).into_vec();
        vec.clear();
        vec.extend(places);
        (self.heap, self.reach) = (vec.into(), Some(reach));
    }
}
