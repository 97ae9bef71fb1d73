//! What a view holds of each active and ready post, and the lists that say when to look at it again.
//!
//! Everything read about a post is kept with it, in 48 bytes. A post is in at most one list, doubly linked through the nodes
//! themselves: lists take no memory of their own, and a post that goes leaves nothing behind.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

use sightline_proto::diamond::Post;

use crate::view::Planes;

/// Mixes the bits of a post's key by one multiplication (Fibonacci hashing, Knuth 6.4). Deterministic; no result
/// depends on the order of such a map.
#[derive(Clone, Copy, Default, Debug)]
pub(in crate::roam) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_u64(&mut self, key: u64) {
        // A table takes its low bits for the bucket and its high ones for the tag: turn the product's best bits down.
        self.0 = ((self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15)).rotate_left(26);
    }
}

pub(in crate::roam) type KeyMap<V> = HashMap<u64, V, BuildHasherDefault<KeyHasher>>;

/// No slot.
const NONE: u32 = u32::MAX;

/// Which list a post is in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct List(u16);

impl List {
    /// In none: inactive diamonds' ancestors, required posts.
    pub(super) const NONE: Self = Self(u16::MAX);
    /// How many lists there are.
    pub(super) const COUNT: usize = 2 * (Self::BUCKETS as usize + 1);
    /// How many lists a side has for posts whose priority need not be computed for a while.
    pub(super) const BUCKETS: u16 = 256;

    /// Posts of a side whose priority is computed whenever the view moves.
    pub(super) const fn hot(side: Side) -> Self {
        Self(side as u16 * (Self::BUCKETS + 1) + Self::BUCKETS)
    }

    /// Posts of a side that are due at `tick`.
    pub(super) const fn due(side: Side, tick: u64) -> Self {
        Self(side as u16 * (Self::BUCKETS + 1) + (tick % Self::BUCKETS as u64) as u16)
    }
}

/// The two queues.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Side {
    /// Ready posts, to be split.
    Split = 0,
    /// Active posts without active children that are not required, to be merged.
    Merge = 1,
}

/// An active or ready post.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) post: Post,
    pub(super) z: f64,
    /// The priority under the camera number `look`; not decreased by regions.
    pub(super) priority: f64,
    /// Nested thickness in height units, and radius of the ball.
    pub(super) nested: f32,
    pub(super) radius_m: f32,
    pub(super) tight: f32,
    pub(super) look: u32,
    prev: u32,
    next: u32,
    list: List,
    pub(super) level: u8,
    /// Planes that had the ball on their inner side when the priority was computed.
    pub(super) inside: Planes,
    pub(super) active: bool,
    pub(super) required: bool,
    /// Triangles that splitting adds: 2, or 1 on the border.
    pub(super) cost: u8,
    pub(super) active_children: u8,
}

impl Node {
    /// A ready post in no list, whose priority is not known.
    pub(super) fn new(post: Post, level: u8, cost: u8, z: f64, [nested, radius_m, tight]: [f32; 3]) -> Self {
        Self {
            post,
            z,
            priority: 0.0,
            nested,
            radius_m,
            tight,
            look: 0,
            prev: NONE,
            next: NONE,
            list: List::NONE,
            level,
            inside: Planes::default(),
            active: false,
            required: false,
            cost,
            active_children: 0,
        }
    }

    pub(super) fn list(&self) -> List {
        self.list
    }
}

/// All nodes of a view.
#[derive(Debug)]
pub(super) struct Nodes {
    nodes: Vec<Node>,
    free: Vec<u32>,
    slots: KeyMap<u32>,
    heads: Box<[u32; List::COUNT]>,
    hot: [usize; 2],
}

impl Nodes {
    pub(super) fn new() -> Self {
        let heads = Box::new([NONE; List::COUNT]);
        Self { nodes: Vec::new(), free: Vec::new(), slots: KeyMap::default(), heads, hot: [0; 2] }
    }

    /// Forgets all posts.
    pub(super) fn clear(&mut self) {
        self.nodes.clear();
        self.free.clear();
        self.slots.clear();
        self.heads.fill(NONE);
        self.hot = [0; 2];
    }

    #[inline]
    pub(super) fn slot(&self, p: Post) -> Option<u32> {
        self.slots.get(&p.key()).copied()
    }

    pub(super) fn get(&self, slot: u32) -> &Node {
        &self.nodes[slot as usize]
    }

    pub(super) fn get_mut(&mut self, slot: u32) -> &mut Node {
        &mut self.nodes[slot as usize]
    }

    /// The node in a slot that may have been freed since.
    pub(super) fn at(&self, slot: u32, p: u64) -> Option<&Node> {
        self.nodes.get(slot as usize).filter(|node| node.post.key() == p)
    }

    /// How many posts are held.
    pub(super) fn len(&self) -> usize {
        self.nodes.len() - self.free.len()
    }

    /// Bytes of memory held.
    pub(super) fn bytes(&self) -> usize {
        // A hash table has a byte of tag beside each entry and is at most seven eighths full.
        let table = self.slots.capacity() * 8 / 7 * (size_of::<(u64, u32)>() + 1);
        self.nodes.capacity() * size_of::<Node>() + self.free.capacity() * 4 + table + size_of_val(&*self.heads)
    }

    /// The active posts that are no corners, in no particular order.
    pub(super) fn active(&self) -> impl Iterator<Item = &Node> {
        // Freed nodes are not active.
        self.nodes.iter().filter(|node| node.active)
    }

    /// All posts held.
    #[cfg(test)]
    pub(super) fn all(&self) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(|node| node.cost != 0)
    }

    pub(super) fn insert(&mut self, node: Node) -> u32 {
        let key = node.post.key();
        let slot = match self.free.pop() {
            Some(slot) => {
                self.nodes[slot as usize] = node;
                slot
            }
            None => {
                // A view's memory is promised per triangle: grow by a quarter, not to the double.
                if self.nodes.len() == self.nodes.capacity() {
                    self.nodes.reserve_exact(self.nodes.len() / 4 + 64);
                }
                self.nodes.push(node);
                (self.nodes.len() - 1) as u32
            }
        };
        self.slots.insert(key, slot);
        slot
    }

    /// Forgets a post that is not active, if it is held.
    pub(super) fn remove(&mut self, p: Post) {
        if let Some(slot) = self.slots.remove(&p.key()) {
            self.put(slot, List::NONE);
            let node = &mut self.nodes[slot as usize];
            (node.cost, node.post) = (0, Post::new(u32::MAX, u32::MAX));
            self.free.push(slot);
        }
    }

    /// Moves a post to a list.
    pub(super) fn put(&mut self, slot: u32, list: List) {
        let Node { prev, next, list: old, .. } = self.nodes[slot as usize];
        if old != List::NONE {
            match prev {
                NONE => self.heads[old.0 as usize] = next,
                prev => self.nodes[prev as usize].next = next,
            }
            if next != NONE {
                self.nodes[next as usize].prev = prev;
            }
            self.count(old, false);
        }
        let head = if list == List::NONE { NONE } else { std::mem::replace(&mut self.heads[list.0 as usize], slot) };
        if head != NONE {
            self.nodes[head as usize].prev = slot;
        }
        let node = &mut self.nodes[slot as usize];
        (node.prev, node.next, node.list) = (NONE, head, list);
        if list != List::NONE {
            self.count(list, true);
        }
    }

    fn count(&mut self, list: List, more: bool) {
        for side in [Side::Split, Side::Merge] {
            if list == List::hot(side) {
                let count = &mut self.hot[side as usize];
                *count = if more { *count + 1 } else { *count - 1 };
            }
        }
    }

    /// How many posts of a side are computed whenever the view moves.
    pub(super) fn hot(&self, side: Side) -> usize {
        self.hot[side as usize]
    }

    /// The first post of a list.
    pub(super) fn first(&self, list: List) -> Option<u32> {
        Some(self.heads[list.0 as usize]).filter(|&slot| slot != NONE)
    }

    /// The posts of a list; the list must not change meanwhile.
    pub(super) fn of(&self, list: List) -> impl Iterator<Item = u32> {
        let next = |&slot: &u32| Some(self.nodes[slot as usize].next).filter(|&slot| slot != NONE);
        std::iter::successors(self.first(list), next)
    }

    /// The post after this one in its list.
    pub(super) fn after(&self, slot: u32) -> Option<u32> {
        Some(self.nodes[slot as usize].next).filter(|&slot| slot != NONE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_small() {
        assert_eq!(size_of::<Node>(), 56);
    }

    #[test]
    fn a_post_is_in_one_list_and_leaves_it_whole() {
        let mut nodes = Nodes::new();
        let slots: Vec<_> = (0..6).map(|i| nodes.insert(Node::new(Post::new(i, 1), 0, 2, 0.0, [0.0; 3]))).collect();
        let (hot, due) = (List::hot(Side::Split), List::due(Side::Merge, 300));
        for &slot in &slots {
            nodes.put(slot, hot);
        }
        nodes.put(slots[2], due);
        nodes.put(slots[5], due);
        nodes.put(slots[0], List::NONE);
        nodes.remove(Post::new(3, 1));
        assert_eq!(nodes.of(hot).collect::<Vec<_>>(), [slots[4], slots[1]]);
        assert_eq!(nodes.of(due).collect::<Vec<_>>(), [slots[5], slots[2]]);
        assert_eq!((nodes.hot(Side::Split), nodes.hot(Side::Merge), nodes.len()), (2, 0, 5));
    }
}
