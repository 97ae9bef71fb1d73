//! A set of posts that holds the ancestors of its members, with the triangles that its mesh has.

use std::collections::HashSet;
use std::hash::BuildHasherDefault;

use sightline_proto::diamond::{Post, RootSquare};

use crate::roam::queues::KeyHasher;

/// A closed set of posts. Corners are members of every mesh and left out.
#[derive(Clone, Debug)]
pub(in crate::roam) struct Closure {
    root: RootSquare,
    keys: HashSet<u64, BuildHasherDefault<KeyHasher>>,
    /// In the order of joining; never by the order of `keys`.
    posts: Vec<Post>,
    triangles: u64,
}

impl Closure {
    /// The mesh of two triangles.
    pub(in crate::roam) fn new(root: RootSquare) -> Self {
        Self { root, keys: HashSet::default(), posts: Vec::new(), triangles: 2 }
    }

    pub(in crate::roam) fn contains(&self, p: Post) -> bool {
        self.keys.contains(&p.key())
    }

    /// Triangles of the mesh of just this set.
    pub(in crate::roam) fn triangles(&self) -> u64 {
        self.triangles
    }

    /// Adds `p` and its missing ancestors.
    pub(in crate::roam) fn add(&mut self, p: Post) {
        let mut open = vec![p];
        while let Some(p) = open.pop() {
            if !self.root.is_corner(p) && self.keys.insert(p.key()) {
                self.posts.push(p);
                self.triangles += self.root.triangles(p).count() as u64;
                open.extend(self.root.parents(p));
            }
        }
    }

    /// How many posts there are: a mark for [`Closure::shrink`].
    pub(in crate::roam) fn len(&self) -> usize {
        self.posts.len()
    }

    /// Goes back to the first `len` posts, a size that the set had between additions.
    pub(in crate::roam) fn shrink(&mut self, len: usize) {
        for p in self.posts.drain(len..) {
            self.keys.remove(&p.key());
            self.triangles -= self.root.triangles(p).count() as u64;
        }
    }

    /// The posts that joined after the mark `len`, coarse ones first.
    pub(in crate::roam) fn since(&self, len: usize) -> Vec<Post> {
        let mut posts = self.posts[len..].to_vec();
        posts.sort_unstable_by_key(|&p| (self.root.level(p), p));
        posts
    }
}
