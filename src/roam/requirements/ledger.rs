//! Which posts are required: those that lines own, counted, and their ancestors. A post goes when the last that needs it
//! does.

use sightline_proto::diamond::{Post, RootSquare};

use crate::roam::queues::KeyMap;

/// How often a post is needed.
#[derive(Clone, Copy, Default, Debug)]
struct Count {
    owners: u32,
    /// Required posts of which this is a parent.
    children: u32,
}

/// A closed set of posts with owners. Corners are members of every mesh and left out.
#[derive(Clone, Debug)]
pub(in crate::roam) struct Ledger {
    root: RootSquare,
    counts: KeyMap<Count>,
    triangles: u64,
    /// Posts that joined or left, as often as they did, since this was last taken.
    touched: Vec<Post>,
}

impl Ledger {
    /// Nothing required: the mesh of two triangles.
    pub(in crate::roam) fn new(root: RootSquare) -> Self {
        Self { root, counts: KeyMap::default(), triangles: 2, touched: Vec::new() }
    }

    pub(in crate::roam) fn contains(&self, p: Post) -> bool {
        self.counts.contains_key(&p.key())
    }

    /// Triangles of the mesh of just this set.
    pub(in crate::roam) fn triangles(&self) -> u64 {
        self.triangles
    }

    /// Gives `p` one more owner; its missing ancestors join with it.
    pub(in crate::roam) fn add(&mut self, p: Post) {
        if self.root.is_corner(p) {
            return;
        }
        if self.join(p) {
            let (root, mut open) = (self.root, vec![p]);
            while let Some(p) = open.pop() {
                for parent in root.parents(p).filter(|&q| !root.is_corner(q)) {
                    if self.join(parent) {
                        open.push(parent);
                    }
                    self.count(parent).children += 1;
                }
            }
        }
        self.count(p).owners += 1;
    }

    /// Takes an owner from `p`, which has one; it and its ancestors leave where nothing needs them any more.
    pub(in crate::roam) fn remove(&mut self, p: Post) {
        if self.root.is_corner(p) {
            return;
        }
        self.count(p).owners -= 1;
        let (root, mut open) = (self.root, vec![p]);
        while let Some(p) = open.pop() {
            let Count { owners, children } = *self.count(p);
            if owners + children > 0 {
                continue;
            }
            self.counts.remove(&p.key());
            self.triangles -= self.cost(p);
            self.touched.push(p);
            for parent in root.parents(p).filter(|&q| !root.is_corner(q)) {
                self.count(parent).children -= 1;
                open.push(parent);
            }
        }
    }

    /// The posts that joined or left since this was last asked, each once, coarse ones first.
    pub(in crate::roam) fn take_touched(&mut self) -> Vec<Post> {
        let mut touched = std::mem::take(&mut self.touched);
        touched.sort_unstable_by_key(|&p| (self.root.level(p), p));
        touched.dedup();
        touched
    }

    /// How many joined or left since then.
    pub(in crate::roam) fn touched(&self) -> &[Post] {
        &self.touched
    }

    /// Triangles that the split at `p` adds.
    pub(in crate::roam) fn cost(&self, p: Post) -> u64 {
        self.root.triangles(p).count() as u64
    }

    fn join(&mut self, p: Post) -> bool {
        let is_new = !self.counts.contains_key(&p.key());
        if is_new {
            self.counts.insert(p.key(), Count::default());
            self.triangles += self.cost(p);
            self.touched.push(p);
        }
        is_new
    }

    fn count(&mut self, p: Post) -> &mut Count {
        self.counts.get_mut(&p.key()).expect("required posts are counted, and so are their parents")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::synthetic;
    use sightline_proto::mesh::{closure, triangle_count};

    #[test]
    fn what_is_left_is_the_closure_of_what_is_owned() {
        let root = RootSquare::new(5).unwrap();
        let mut ledger = Ledger::new(root);
        let mut owned: Vec<Post> = Vec::new();
        for n in 0..2000_u64 {
            let roll = synthetic::mix(n);
            if roll.is_multiple_of(2) || owned.is_empty() {
                let p = Post::new((roll >> 8) as u32 % 33, (roll >> 20) as u32 % 33);
                ledger.add(p);
                owned.push(p);
            } else {
                ledger.remove(owned.swap_remove((roll >> 8) as usize % owned.len()));
            }
            if n % 50 == 0 || owned.is_empty() {
                let expected = closure(root, owned.iter().copied());
                assert_eq!(ledger.triangles(), triangle_count(root, &expected));
                assert!(expected.iter().all(|&p| root.is_corner(p) || ledger.contains(p)));
            }
        }
        owned.drain(..).for_each(|p| ledger.remove(p));
        assert_eq!((ledger.triangles(), ledger.counts.len()), (2, 0));
    }
}
