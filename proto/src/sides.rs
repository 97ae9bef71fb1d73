//! The three sides that take the walk: who encodes a mesh, who encodes a change, who decodes either.

use std::collections::HashSet;

use crate::{
    codec::DecodeError,
    diamond::{Post, RootSquare},
    replica::{MixHasher, PostMap},
    walk::State,
};

/// Posts by [`Post::key`].
pub(crate) type PostSet = HashSet<u64, MixHasher>;

/// What a payload changes.
#[derive(Default)]
pub(crate) struct Changes {
    /// Posts that were not active and now are. Of a snapshot, all but the corners.
    pub(crate) added: PostMap,
    /// Posts that were active and no longer are.
    pub(crate) removed: PostSet,
    /// Triangles that the added posts make, and that go with the removed ones.
    pub(crate) triangles: (u64, u64),
}

/// Encodes a mesh whole.
pub(crate) struct NewMesh<'a>(pub(crate) &'a PostMap);

impl State for NewMesh<'_> {
    fn corner(&self, p: Post) -> i32 {
        self.wanted(p).unwrap_or(0)
    }

    fn held(&self, _: Post) -> Option<i32> {
        None
    }

    fn now(&self, p: Post) -> Option<(i32, bool)> {
        Some((self.wanted(p)?, true))
    }

    fn wanted(&self, p: Post) -> Option<i32> {
        self.0.get(&p.key()).copied()
    }

    fn is_changed_below(&self, _: Post) -> bool {
        false
    }

    fn add(&mut self, _: Post, _: i32, _: u64) -> Result<(), DecodeError> {
        Ok(())
    }

    fn remove(&mut self, _: Post) {}
}

/// Encodes a change.
pub(crate) struct Change<'a> {
    base: &'a PostMap,
    removed: &'a PostSet,
    added: &'a PostMap,
    below: PostSet,
}

impl<'a> Change<'a> {
    pub(crate) fn new(root: RootSquare, base: &'a PostMap, removed: &'a PostSet, added: &'a PostMap) -> Self {
        Self { base, removed, added, below: changed_below(root, base, removed, added) }
    }
}

impl State for Change<'_> {
    fn corner(&self, p: Post) -> i32 {
        self.held(p).unwrap_or(0)
    }

    fn held(&self, p: Post) -> Option<i32> {
        self.base.get(&p.key()).copied()
    }

    fn now(&self, p: Post) -> Option<(i32, bool)> {
        let key = p.key();
        if let Some(&height) = self.added.get(&key) {
            return Some((height, true));
        }
        let height = *self.base.get(&key)?;
        (!self.removed.contains(&key)).then_some((height, false))
    }

    fn wanted(&self, p: Post) -> Option<i32> {
        Some(self.now(p)?.0)
    }

    fn is_changed_below(&self, p: Post) -> bool {
        self.below.contains(&p.key())
    }

    fn add(&mut self, _: Post, _: i32, _: u64) -> Result<(), DecodeError> {
        Ok(())
    }

    fn remove(&mut self, _: Post) {}
}

/// The posts on which, directly or further down, a change hangs that the walk names: a post added, or one removed whose
/// parents stay.
fn changed_below(root: RootSquare, base: &PostMap, removed: &PostSet, added: &PostMap) -> PostSet {
    let mut below = PostSet::default();
    let stays = |p: Post| base.contains_key(&p.key()) && !removed.contains(&p.key());
    let named = removed.iter().map(|&k| Post::from_key(k)).filter(|&p| root.parents(p).all(stays));
    for p in added.keys().map(|&k| Post::from_key(k)).chain(named) {
        let mut at = p;
        while let Some(on) = root.hangs_on(at).filter(|on| below.insert(on.key())) {
            at = on;
        }
    }
    below
}

/// Decodes.
pub(crate) struct Decoding<'a> {
    root: RootSquare,
    base: &'a PostMap,
    is_delta: bool,
    max_triangles: u32,
    changes: Changes,
}

impl<'a> Decoding<'a> {
    /// With more than `max_triangles` added, the walk ends in an error.
    pub(crate) fn new(root: RootSquare, base: &'a PostMap, is_delta: bool, max_triangles: u32) -> Self {
        Self { root, base, is_delta, max_triangles, changes: Changes::default() }
    }

    /// Makes room for so many posts.
    pub(crate) fn expect_posts(&mut self, posts: usize) {
        self.changes.added.reserve(posts.min(self.max_triangles as usize));
    }

    pub(crate) fn into_changes(self) -> Changes {
        self.changes
    }
}

impl State for Decoding<'_> {
    fn corner(&self, p: Post) -> i32 {
        self.base.get(&p.key()).copied().unwrap_or(0)
    }

    fn held(&self, p: Post) -> Option<i32> {
        if self.is_delta { self.base.get(&p.key()).copied() } else { None }
    }

    fn now(&self, p: Post) -> Option<(i32, bool)> {
        let key = p.key();
        if let Some(&height) = self.changes.added.get(&key) {
            return Some((height, true));
        }
        let height = self.held(p)?;
        (!self.changes.removed.contains(&key)).then_some((height, false))
    }

    fn wanted(&self, _: Post) -> Option<i32> {
        None
    }

    fn is_changed_below(&self, _: Post) -> bool {
        false
    }

    fn add(&mut self, p: Post, height: i32, triangles: u64) -> Result<(), DecodeError> {
        self.changes.added.insert(p.key(), height);
        self.changes.triangles.0 += triangles;
        if self.changes.triangles.0 > u64::from(self.max_triangles) {
            return Err(DecodeError::TooManyTriangles(self.max_triangles));
        }
        Ok(())
    }

    fn remove(&mut self, p: Post) {
        let mut open = vec![p];
        while let Some(p) = open.pop() {
            if self.held(p).is_some() && self.changes.removed.insert(p.key()) {
                self.changes.triangles.1 += self.root.parents(p).count() as u64;
                open.extend(self.root.children(p));
            }
        }
    }
}
