//! One split, one merge: what changes of lists and counts with the state of a post.

use sightline_proto::diamond::Post;

use super::{
    DualQueue, Terrain,
    nodes::{List, Node, Side},
    pace::Guard,
};
use crate::{terrain::ReadError, view::Planes};

impl<T: Terrain> DualQueue<T> {
    /// Makes a ready post active, and its children ready where it was the last parent that they waited for.
    pub(super) fn split(&mut self, slot: u32) -> Result<(), ReadError> {
        let Node { post, inside, look, .. } = *self.nodes.get(slot);
        let inside = if look == self.look && self.options.inherited_culling { inside } else { Planes::default() };
        // All reads come first, so that a failed one changes nothing.
        let mut ready: [Option<Node>; 4] = [const { None }; 4];
        for (place, child) in ready.iter_mut().zip(self.root.children(post)) {
            if self.root.parents(child).all(|parent| parent == post || self.height_of(parent).is_some()) {
                *place = Some(self.read(child, inside)?);
            }
        }
        for parent in self.root.parents(post) {
            if let Some(parent) = self.nodes.slot(parent) {
                self.nodes.get_mut(parent).active_children += 1;
                self.nodes.put(parent, List::NONE);
            }
        }
        let node = self.nodes.get_mut(slot);
        node.active = true;
        self.triangles += u64::from(node.cost);
        self.toggled.push(post);
        self.work.splits += 1;
        self.nodes.put(slot, List::NONE);
        self.offer_to_merge(slot);
        for node in ready.into_iter().flatten() {
            let slot = self.nodes.insert(node);
            self.make_hot(slot, Side::Split);
        }
        Ok(())
    }

    /// Makes an active post without active children ready; its children wait again.
    pub(super) fn merge(&mut self, slot: u32) {
        let node = self.nodes.get_mut(slot);
        node.active = false;
        self.triangles -= u64::from(node.cost);
        let post = node.post;
        self.make_hot(slot, Side::Split);
        for child in self.root.children(post) {
            self.nodes.remove(child);
        }
        for parent in self.root.parents(post) {
            if let Some(parent) = self.nodes.slot(parent) {
                self.nodes.get_mut(parent).active_children -= 1;
                self.offer_to_merge(parent);
            }
        }
        self.toggled.push(post);
        self.work.merges += 1;
    }

    /// Puts an active post into the merge queue if it may be merged.
    pub(super) fn offer_to_merge(&mut self, slot: u32) {
        let node = self.nodes.get(slot);
        if node.active_children == 0 && !node.required {
            self.bring_up_to_date(slot);
            self.make_hot(slot, Side::Merge);
        }
    }

    /// Goes back to the mesh of two triangles, with the centre ready.
    pub(super) fn restart(&mut self) -> Result<(), ReadError> {
        let centre = Post::new(self.root.side() / 2, self.root.side() / 2);
        let centre = if self.root.side() > 1 { Some(self.read(centre, Planes::default())?) } else { None };
        let active = self.nodes.active().map(|node| node.post);
        self.toggled.extend(active);
        self.nodes.clear();
        self.split_queue.forget();
        self.merge_queue.forget();
        (self.split_guard, self.merge_guard) = (Guard::new(Side::Split), Guard::new(Side::Merge));
        self.triangles = 2;
        self.work.from_scratch = true;
        if let Some(node) = centre {
            let slot = self.nodes.insert(node);
            self.make_hot(slot, Side::Split);
        }
        Ok(())
    }

    fn read(&mut self, post: Post, inside: Planes) -> Result<Node, ReadError> {
        let (z, bounds) = self.reader.read(post)?;
        let level = self.root.level(post).expect("no corner is ever ready");
        let cost = self.root.triangles(post).count() as u8;
        let mut node = Node::new(post, level, cost, z, [bounds.nested, bounds.radius_m, bounds.tight]);
        (node.priority, node.inside) = self.priority(&node, inside);
        node.look = self.look;
        self.work.priorities += 1;
        Ok(node)
    }
}
