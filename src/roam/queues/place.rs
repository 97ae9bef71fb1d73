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

/// A heap that is built when it is first asked.
#[derive(Debug)]
pub(super) struct Heap<P> {
    pub(super) heap: BinaryHeap<P>,
    pub(super) built: bool,
}

impl<P: Ord> Heap<P> {
    pub(super) fn new() -> Self {
        Self { heap: BinaryHeap::new(), built: false }
    }

    pub(super) fn forget(&mut self) {
        self.heap.clear();
        self.built = false;
    }

    pub(super) fn build(&mut self, places: impl Iterator<Item = P>) {
        let mut vec = std::mem::take(&mut self.heap).into_vec();
        vec.clear();
        vec.extend(places);
        (self.heap, self.built) = (vec.into(), true);
    }

    pub(super) fn push(&mut self, place: P) {
        if self.built {
            self.heap.push(place);
        }
    }
}
