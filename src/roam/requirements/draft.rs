//! A mesh as it would be, and the fewest splits that make a line right on it.
//!
//! *Splits that must be.* A triangle goes only when its own diamond is split. So where triangles are wrong for a line, the
//! least mesh above this one on which none is follows by itself: split them, and whatever becomes wrong by it. (Of two
//! meshes above this one without a wrong triangle, the posts that both have make a third: each of its triangles is one
//! of theirs.) There is nothing to choose, for any number of such lines together.
//!
//! *Splits of which one will do.* A blocked line needs a single triangle above it. Triangles of the hierarchy under the
//! line are tried in the order of how many triangles it takes to have them, shared ancestors counted once and what is
//! there for nothing: the first that rises above the line is the cheapest that there is.

use std::{cmp::Reverse, collections::BinaryHeap, ops::ControlFlow};

use sightline_proto::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
    predicates::Sign,
    verdict::{for_each_triangle_above, for_each_triangle_met, passes_below},
};

use super::{
    RequiredLine,
    ground::{Ground, moved},
    ledger::Ledger,
    rule::{Rule, thickness},
    stable::path,
    witness::Witness,
};
use crate::{
    roam::{
        Terrain,
        queues::{DualQueue, KeyMap},
    },
    terrain::ReadError,
};

/// Triangles that a search for the cheapest block looks at before it takes the cheapest witness instead. A guess.
const MAX_SEARCHED: usize = 600;

/// Posts by key.
pub(super) type PostSet = KeyMap<()>;

/// The mesh of the queue with what is required beside it, without some posts.
pub(super) struct Draft<'a, 'g, T: Terrain> {
    pub(super) queue: &'a DualQueue<T>,
    pub(super) ground: &'a Ground<'g, T>,
    pub(super) ledger: &'a Ledger,
    /// Active posts that will go unless something requires them.
    pub(super) less: &'a PostSet,
    /// Posts split here.
    more: PostSet,
}

impl<T: Terrain> Mesh for Draft<'_, '_, T> {
    fn root(&self) -> RootSquare {
        self.queue.root()
    }

    fn grid_size(&self) -> (u32, u32) {
        self.queue.grid_posts()
    }

    fn height(&self, p: Post) -> Option<f64> {
        let is_required = || self.more.contains_key(&p.key()) || self.ledger.contains(p);
        if !self.less.is_empty() && self.less.contains_key(&p.key()) && !is_required() {
            return None;
        }
        match self.queue.height_of(p) {
            None if is_required() => self.ground.height(p),
            height => height,
        }
    }
}

impl<'a, 'g, T: Terrain> Draft<'a, 'g, T> {
    pub(super) fn new(
        queue: &'a DualQueue<T>,
        ground: &'a Ground<'g, T>,
        ledger: &'a Ledger,
        less: &'a PostSet,
    ) -> Self {
        Self { queue, ground, ledger, less, more: PostSet::default() }
    }

    /// Splits that make the line hold, without their ancestors: the fewest, or those that its stable set allows if
    /// `witness` is the one that the set stands on. None when nothing needs to be done, or nothing can.
    pub(super) fn needs(
        &mut self,
        line: &RequiredLine,
        rule: &Rule,
        witness: Option<&Witness>,
        fallback: impl FnOnce() -> Result<Vec<Witness>, ReadError>,
    ) -> Result<Vec<Post>, ReadError> {
        let mut own = if *rule == Rule::Blocked { Vec::new() } else { self.splits_that_must_be(line, rule)? };
        match rule {
            Rule::Blocked if !self.is_blocked(line, rule)? => match witness {
                Some(witness) => own.extend(self.splits_to_block(line, witness)?),
                None => own.extend(self.cheapest_block(line, rule, fallback)?),
            },
            Rule::Obstruction(aim) if !self.is_blocked(line, rule)? => {
                let found = if witness.is_some() { None } else { self.search(line, rule)? };
                own.extend(found.map_or_else(|| self.splits_to_face(line, rule, &aim.face), Ok)?);
            }
            _ => {}
        }
        self.ground.checked(own)
    }

    /// The splits that no mesh above this one can do without.
    fn splits_that_must_be(&mut self, line: &RequiredLine, rule: &Rule) -> Result<Vec<Post>, ReadError> {
        let mut open = Vec::new();
        match rule {
            Rule::Clear | Rule::Obstruction(_) => {
                let _ = for_each_triangle_above(self, &self.root().roots(), [line.a, line.b], |triangle| {
                    open.push(triangle);
                    ControlFlow::Continue(())
                });
            }
            _ => {
                let _ = for_each_triangle_met(self, line.a, line.b, |triangle| {
                    open.push(triangle);
                    ControlFlow::Continue(())
                });
            }
        }
        let mut own = Vec::new();
        while let Some(triangle) = open.pop() {
            let Some(middle) = triangle.base_midpoint().filter(|&m| self.height(m).is_none()) else { continue };
            if !self.breaks(&triangle, line, rule)? {
                continue;
            }
            own.push(middle);
            for post in self.split(middle) {
                let children = self.root().triangles(post).flat_map(|t| t.children(post));
                open.extend(children.filter(|child| rule != &Rule::Profile || self.meets(child, line)));
            }
        }
        Ok(own)
    }

    /// Whether the line meets a triangle in plan over the grid.
    fn meets(&self, triangle: &Triangle, line: &RequiredLine) -> bool {
        let flat = |z| triangle.corners().map(|p| [f64::from(p.i), f64::from(p.j), z]);
        let low = |[x, y, _]: [f64; 3]| [x, y, 0.0];
        passes_below(low(line.a), low(line.b), flat(1.0), self.grid_size())
    }

    fn breaks(&self, triangle: &Triangle, line: &RequiredLine, rule: &Rule) -> Result<bool, ReadError> {
        let corners = self.ground.in_space(triangle)?;
        rule.breaks(triangle, corners, || thickness(self.ground, triangle), line, self.grid_size())
    }

    /// Whether some triangle helps a blocked line.
    fn is_blocked(&self, line: &RequiredLine, rule: &Rule) -> Result<bool, ReadError> {
        let mut found = Ok(false);
        let _ = for_each_triangle_above(self, &self.root().roots(), [line.a, line.b], |triangle| {
            found = self.ground.in_space(&triangle).map(|corners| rule.is_helped_by(corners, line, self.grid_size()));
            if matches!(found, Ok(false)) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        found
    }

    /// Makes `p` active, and its missing ancestors; all that became so.
    fn split(&mut self, p: Post) -> Vec<Post> {
        let added = self.missing(p);
        self.more.extend(added.iter().map(|p| (p.key(), ())));
        added
    }

    /// `p` and its ancestors, as far as they are not active.
    fn missing(&self, p: Post) -> Vec<Post> {
        let (mut missing, mut next) = (Vec::new(), 0);
        if self.height(p).is_none() {
            missing.push(p);
        }
        while let Some(&post) = missing.get(next) {
            next += 1;
            for parent in self.root().parents(post) {
                if !missing.contains(&parent) && self.height(parent).is_none() {
                    missing.push(parent);
                }
            }
        }
        missing
    }

    fn cost(&self, posts: &[Post]) -> u64 {
        posts.iter().map(|&p| self.ledger.cost(p)).sum()
    }

    /// The split that makes a triangle which blocks the line, where that takes the fewest triangles.
    fn cheapest_block(
        &self,
        line: &RequiredLine,
        rule: &Rule,
        fallback: impl FnOnce() -> Result<Vec<Witness>, ReadError>,
    ) -> Result<Vec<Post>, ReadError> {
        if let Some(found) = self.search(line, rule)? {
            return Ok(found);
        }
        let mut least: Option<(u64, Vec<Post>)> = None;
        for witness in fallback()? {
            let splits = self.splits_to_block(line, &witness)?;
            let cost = splits.last().map_or(0, |&last| self.cost(&self.missing(last)));
            if least.as_ref().is_none_or(|(triangles, _)| cost < *triangles) {
                least = Some((cost, splits));
            }
        }
        Ok(least.map_or(Vec::new(), |(_, splits)| splits))
    }

    /// Tries triangles under the line, those that take the fewest triangles first; `None` when that takes too long or
    /// there is none.
    fn search(&self, line: &RequiredLine, rule: &Rule) -> Result<Option<Vec<Post>>, ReadError> {
        let grid = self.grid_size();
        let mut found: Vec<Triangle> = Vec::new();
        let _ = for_each_triangle_met(self, line.a, line.b, |triangle| {
            found.push(triangle);
            ControlFlow::Continue(())
        });
        let mut open: BinaryHeap<_> = (0..found.len()).map(|n| Reverse((0_u64, n))).collect();
        while let Some(Reverse((cost, n))) = open.pop() {
            let triangle = found[n];
            let corners = self.ground.in_space(&triangle)?;
            if cost > 0 && rule.is_helped_by(corners, line, grid) {
                return Ok(Some(vec![triangle.apex]));
            }
            let Some(middle) = triangle.base_midpoint() else { continue };
            let bounds = self.ground.bounds(middle)?;
            // No descendant's plane is further above this one, by a hair.
            let above = (f64::from(bounds.tight) + 2.0 * f64::from(bounds.nested)) * 1.000_001 + 1e-300;
            if moved(corners, above).is_some_and(|plane| !passes_below(line.a, line.b, plane, grid)) {
                continue;
            }
            if found.len() > MAX_SEARCHED {
                return Ok(None);
            }
            let cost = self.cost(&self.missing(middle));
            for child in triangle.children(middle) {
                open.push(Reverse((cost, found.len())));
                found.push(child);
            }
        }
        Ok(None)
    }

    /// The splits after which the triangle over a witness is above the line there.
    fn splits_to_block(&self, line: &RequiredLine, witness: &Witness) -> Result<Vec<Post>, ReadError> {
        self.splits_on_the_way(&witness.face, |corners| {
            witness.point.height_against_plane(line.a, line.b, corners) == Sign::Negative
        })
    }

    /// The splits after which the triangle over a finest one obstructs the line as it is asked.
    fn splits_to_face(&self, line: &RequiredLine, rule: &Rule, face: &Triangle) -> Result<Vec<Post>, ReadError> {
        self.splits_on_the_way(face, |corners| rule.is_helped_by(corners, line, self.grid_size()))
    }

    fn splits_on_the_way(
        &self,
        face: &Triangle,
        will_do: impl Fn([[f64; 3]; 3]) -> bool,
    ) -> Result<Vec<Post>, ReadError> {
        let mut splits = Vec::new();
        for triangle in path(self.root().roots(), face) {
            let Some(middle) = triangle.base_midpoint() else { break };
            if splits.is_empty() && self.height(middle).is_some() {
                continue;
            }
            if will_do(self.ground.in_space(&triangle)?) {
                break;
            }
            splits.push(middle);
        }
        Ok(splits)
    }
}
