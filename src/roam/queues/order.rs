//! The two queues, and the loop that takes from them until the mesh is what the order asks for.

use std::cmp::Reverse;

use super::{
    Allowance, DualQueue, Place, Terrain,
    nodes::{List, Side},
    pace::GAP,
};
use crate::terrain::ReadError;

/// How far beyond the cut a queue reaches before all else is put into it, as a factor. Posts further off are seldom
/// asked for in a frame.
const REACH: f64 = 7.0 / 8.0;

impl<T: Terrain> DualQueue<T> {
    /// Splits and merges until the mesh is the required posts with the longest prefix of the order that is allowed, or
    /// the cap on operations is reached. The required posts alone must fit.
    pub(in crate::roam) fn refine(&mut self, allowed: Allowance) -> Result<(), ReadError> {
        let max = u64::from(allowed.max);
        self.drop_stale();
        if self.merge_guard.value < allowed.threshold {
            self.approach(Side::Merge, allowed.threshold * (1.0 + GAP));
        }
        while self.triangles > max {
            let Some(least) = self.least_active(f64::INFINITY) else { break };
            self.merge(least.slot);
        }
        while self.operations_left > 0 {
            if let Some(least) = self.least_active(allowed.threshold)
                && least.priority() <= allowed.threshold
            {
                self.merge(least.slot);
                self.operations_left -= 1;
                continue;
            }
            let Some(first) = self.first_ready() else { return Ok(()) };
            if first.priority() <= allowed.threshold {
                return Ok(());
            }
            if self.triangles + u64::from(self.nodes.get(first.slot).cost) <= max {
                self.split(first.slot)?;
            } else {
                // The last one must give way to one that comes before it.
                match self.least_active(first.priority()) {
                    Some(least) if least < first => self.merge(least.slot),
                    _ => return Ok(()),
                }
            }
            self.operations_left -= 1;
        }
        Ok(())
    }

    /// The greatest ready post.
    pub(super) fn first_ready(&mut self) -> Option<Place> {
        let mut step = GAP;
        loop {
            let first = self.first_hot();
            let guard = self.split_guard.value;
            let lower = match first {
                // Nothing that is put off comes before it.
                Some(place) if place.priority() >= guard => return first,
                _ if guard == 0.0 => return first,
                Some(place) => place.priority() * (1.0 - GAP),
                None if step < 1.0 && guard.is_finite() => guard * (1.0 - step),
                None => 0.0,
            };
            step *= 2.0;
            self.approach(Side::Split, lower);
        }
    }

    /// The greatest hot ready post.
    fn first_hot(&mut self) -> Option<Place> {
        loop {
            let reach = match self.split_queue.reach {
                Some(reach) => {
                    while self.split_queue.heap.peek().is_some_and(|&place| !self.holds(place, Side::Split)) {
                        self.split_queue.heap.pop();
                    }
                    let first = self.split_queue.heap.peek().copied();
                    if first.is_some() || reach == 0.0 {
                        return first;
                    }
                    0.0
                }
                None => self.cut * REACH,
            };
            let near = self.nodes.of(List::hot(Side::Split)).map(|slot| self.place(slot));
            let near: Vec<_> = near.filter(|place| place.priority() >= reach).collect();
            self.split_queue.build(reach, near.into_iter());
        }
    }

    /// The least hot active post, if it has a priority of at most `most`; it may also be another one above that, or
    /// none.
    fn least_hot(&mut self, most: f64) -> Option<Place> {
        loop {
            let reach = match self.merge_queue.reach {
                Some(reach) => {
                    while self.merge_queue.heap.peek().is_some_and(|&Reverse(place)| !self.holds(place, Side::Merge)) {
                        self.merge_queue.heap.pop();
                    }
                    let least = self.merge_queue.heap.peek().map(|&Reverse(place)| place);
                    if least.is_some() || reach >= most {
                        return least;
                    }
                    f64::INFINITY
                }
                None => self.cut / REACH,
            };
            let near = self.nodes.of(List::hot(Side::Merge)).map(|slot| self.place(slot));
            let near: Vec<_> = near.filter(|place| place.priority() <= reach).map(Reverse).collect();
            self.merge_queue.build(reach, near.into_iter());
        }
    }

    /// The least post that may be merged, if it has a priority of at most `most`; it may also be another one above
    /// that, or none.
    fn least_active(&mut self, most: f64) -> Option<Place> {
        let mut step = GAP;
        loop {
            let least = self.least_hot(most);
            let guard = self.merge_guard.value;
            let higher = match least {
                // All that is put off comes before it.
                Some(place) if place.priority() <= guard => return least,
                _ if guard >= most => return least,
                Some(place) => place.priority() * (1.0 + GAP),
                None if step < 4.0 && guard > 0.0 => guard * (1.0 + step),
                None => f64::INFINITY,
            };
            step *= 2.0;
            self.approach(Side::Merge, higher);
        }
    }

    pub(super) fn make_hot(&mut self, slot: u32, side: Side) {
        self.nodes.put(slot, List::hot(side));
        let place = self.place(slot);
        match side {
            Side::Split if self.split_queue.reach.is_some_and(|least| place.priority() >= least) => {
                self.split_queue.heap.push(place);
            }
            Side::Merge if self.merge_queue.reach.is_some_and(|most| place.priority() <= most) => {
                self.merge_queue.heap.push(Reverse(place));
            }
            Side::Split | Side::Merge => {}
        }
    }

    fn place(&self, slot: u32) -> Place {
        let node = self.nodes.get(slot);
        Place { priority: node.priority.to_bits(), key: node.post.key(), slot, level: node.level }
    }

    /// Forgets queues that hold more stale places than others.
    fn drop_stale(&mut self) {
        if self.split_queue.heap.len() > 2 * self.nodes.hot(Side::Split) + 64 {
            self.split_queue.forget();
        }
        if self.merge_queue.heap.len() > 2 * self.nodes.hot(Side::Merge) + 64 {
            self.merge_queue.forget();
        }
    }

    fn holds(&self, place: Place, side: Side) -> bool {
        let node = self.nodes.at(place.slot, place.key);
        node.is_some_and(|node| node.list() == List::hot(side) && node.priority.to_bits() == place.priority)
    }
}
