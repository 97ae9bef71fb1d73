//! ROAM as published: Duchaineau, Wolinsky, Sigeti, Miller, Aldrich and Mineev-Weinstein, "Good terrain geometry, cheap!",
//! sections 4 to 8, and "ROAMing Terrain", 1997.
//!
//! A bintree of triangles with neighbour links, a split queue and a merge queue, kept from frame to frame. A triangle's
//! wedgie thickness is summed up the tree: the greater one of its children's, plus the distance of its base's midpoint from the
//! terrain. Its priority is the greatest length on the screen of its half-thickness at its three vertices (the *vertex
//! bound*); triangles out of the frustum have none. Priorities are deferred (section 8.2): one that could not cross the
//! thresholds within ten frames, if its triangle came straight at the eye, is recomputed every tenth frame only. Labels
//! of triangles in and out of the frustum are kept and renewed from the root (8.3).
//!
//! Where it departs:
//! - A budget is never exceeded in what is delivered ("if the constraint is regarded as inviolate", section 6.3): after
//!   the greedy loop the cheapest diamonds are merged until the count fits. How far cascades overran it is counted.
//! - The summed wedgie and the vertex bound are not monotone, so the two queues can split and merge the same diamonds for
//!   ever; the paper does not say how its loop ends. Here a frame has [`STEPS_PER_TRIANGLE`] steps for each triangle of
//!   its budget.
//! - Bounding balls are classified instead of the extents of triangles.

use std::{collections::BTreeSet, sync::Arc};

use glam::DVec3;

use super::{
    Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target,
    bintree::{Bintree, Change, ImplicitTree, NONE, Tri},
    mesh::MeshBuilder,
    strips::StripSet,
    terrain::Place,
};

/// The range of the triangle budget.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 2.0, fine: 1e9 };
/// Steps of the greedy loop in a frame, for each triangle of the smaller of budget and terrain.
const STEPS_PER_TRIANGLE: usize = 2;
/// Frames within which every deferred priority is recomputed.
const DEFERRAL_FRAMES: u64 = 10;
/// One in so many queued triangles lies beyond the threshold of deferral: the paper's 5 percent.
const BEYOND_THRESHOLD: usize = 20;

/// What is kept of each slot of the tree.
#[derive(Clone, Copy, Debug)]
struct Item {
    priority: f64,
    /// The key under which the slot is in a queue.
    queued: Option<Queue>,
    place: Place,
    /// Whether the priority is recomputed every frame.
    immediate: bool,
}

/// Which queue holds a slot, and with which priority.
#[derive(Clone, Copy, Debug)]
enum Queue {
    Split(u64),
    Merge(u64),
}

const NEW: Item = Item { priority: 0.0, queued: None, place: Place::Partly, immediate: true };

/// A terrain prepared for ROAM as published. Keeps its mesh from frame to frame.
#[derive(Debug)]
pub struct Published {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    /// Summed wedgie thickness in metres.
    wedgie_m: ImplicitTree,
    tree: Bintree,
    items: Vec<Item>,
    /// Leaves that can be split, by the bits of their priority.
    splits: BTreeSet<(u64, u32)>,
    /// Split triangles whose diamond can be merged, by the greater priority of the diamond's two.
    merges: BTreeSet<(u64, u32)>,
    frame: u64,
    last: Option<LodView>,
    decisions: u64,
    /// The strips of section 8.1, when they are kept.
    strips: Option<StripSet>,
}

impl Published {
    /// Sums the wedgies of all triangles.
    pub fn new(ground: Arc<Ground>) -> Self {
        let wedgie_m = wedgies(&ground);
        let (builder, tree) = (MeshBuilder::new(ground.side()), Bintree::new(ground.side()));
        let mut system = Self {
            ground,
            builder,
            wedgie_m,
            tree,
            items: vec![NEW; 2],
            splits: BTreeSet::new(),
            merges: BTreeSet::new(),
            frame: 0,
            last: None,
            decisions: 0,
            strips: None,
        };
        system.requeue(0);
        system.requeue(1);
        system
    }

    /// Keeps triangle strips from now on, changed as triangles are.
    pub fn keep_strips(&mut self) {
        let mut strips = StripSet::default();
        let tree = &self.tree;
        tree.for_each_leaf(|t, tri| strips.add(t, tri.corners.map(|p| p.key()), &tree.neighbours(t)));
        self.strips = Some(strips);
    }

    /// The strips, when they are kept. Their vertices are the keys of posts.
    pub fn strips(&mut self) -> Option<&mut StripSet> {
        self.strips.as_mut()
    }

    /// Takes changes up in the strips: first the triangles that went, then those that came, then their neighbours.
    fn restrip(&mut self, changes: &[Change]) {
        let Some(strips) = &mut self.strips else { return };
        let mut came = Vec::new();
        for change in changes {
            match *change {
                Change::Split(parent) => {
                    strips.remove(parent);
                    let child = self.tree.get(parent).child;
                    if child != NONE {
                        came.extend([child, child + 1]);
                    }
                }
                Change::Merge { parent, child } => {
                    strips.remove(child);
                    strips.remove(child + 1);
                    came.push(parent);
                }
            }
        }
        came.retain(|&t| self.tree.is_leaf(t));
        came.sort_unstable();
        came.dedup();
        for &t in &came {
            let corners = self.tree.get(t).corners.map(|p| p.key());
            strips.add(t, corners, &self.tree.neighbours(t));
        }
        for n in came.iter().flat_map(|&t| self.tree.neighbours(t)).filter(|&n| n != NONE) {
            strips.join(n, &self.tree.neighbours(n));
        }
    }

    /// A triangle's corners, their mean, and the radius of a ball around it that holds the wedgie.
    fn ball(&self, tri: &Tri) -> ([DVec3; 3], DVec3, f64) {
        let corners = tri.corners.map(|p| self.ground.scene(p.i, p.j));
        let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
        let reach = corners.map(|c| (c - centre).length()).into_iter().fold(0.0, f64::max);
        (corners, centre, reach + f64::from(self.wedgie_m.get(tri)))
    }

    /// The vertex bound in pixels.
    fn priority(&self, t: u32, view: &LodView) -> f64 {
        let tri = self.tree.get(t);
        let thickness = f64::from(self.wedgie_m.get(tri));
        if self.items[t as usize].place == Place::Out || thickness == 0.0 {
            return 0.0;
        }
        let corners = tri.corners.map(|p| self.ground.scene(p.i, p.j));
        vertex_bound(corners, thickness, view)
    }

    /// Puts a slot in the queue in which it belongs, with its present priority.
    fn requeue(&mut self, t: u32) {
        self.unqueue(t);
        // Bits of floats that are not negative order as the floats.
        let own = self.items[t as usize].priority;
        if self.tree.can_split(t) {
            self.splits.insert((own.to_bits(), t));
            self.items[t as usize].queued = Some(Queue::Split(own.to_bits()));
        } else if self.tree.can_merge(t) {
            let base = self.tree.get(t).base;
            let both = if base == NONE { own } else { own.max(self.items[base as usize].priority) };
            self.merges.insert((both.to_bits(), t));
            self.items[t as usize].queued = Some(Queue::Merge(both.to_bits()));
        }
    }

    /// Takes up the changes of the tree: new triangles get priorities, and all that border the changes their queue.
    fn settle(&mut self, from: usize, view: &LodView) {
        let changes = self.tree.changes[from..].to_vec();
        self.restrip(&changes);
        let mut touched = Vec::new();
        for change in changes {
            let parent = match change {
                Change::Split(parent) => {
                    let child = self.tree.get(parent).child;
                    // A slot split and merged again within the batch has no children now.
                    if child != NONE {
                        for t in [child, child + 1] {
                            self.renew_place(t, self.items[parent as usize].place, view);
                            touched.push(t);
                        }
                    }
                    parent
                }
                Change::Merge { parent, child } => {
                    for t in [child, child + 1] {
                        self.unqueue(t);
                    }
                    parent
                }
            };
            let above = self.tree.get(parent).parent;
            touched.push(parent);
            for t in [parent, above] {
                if t != NONE {
                    touched.extend([t, self.tree.get(t).base].into_iter().filter(|&t| t != NONE));
                }
            }
        }
        touched.sort_unstable();
        touched.dedup();
        for t in touched {
            self.requeue(t);
        }
    }

    fn unqueue(&mut self, t: u32) {
        match self.items[t as usize].queued.take() {
            Some(Queue::Split(key)) => self.splits.remove(&(key, t)),
            Some(Queue::Merge(key)) => self.merges.remove(&(key, t)),
            None => false,
        };
    }

    /// Classifies a triangle against the frustum and computes its priority.
    fn renew_place(&mut self, t: u32, above: Place, view: &LodView) {
        if self.items.len() <= t as usize + 1 {
            self.items.resize(t as usize + 2, NEW);
        }
        let (_, centre, radius) = self.ball(self.tree.get(t));
        let place = if above == Place::Partly { view.classify(centre, radius) } else { above };
        self.unqueue(t);
        self.items[t as usize] = NEW;
        self.items[t as usize].place = place;
        self.items[t as usize].priority = self.priority(t, view);
        self.decisions += 1;
    }

    /// Renews the labels from the roots; below a triangle that stays wholly in or out nothing changes. Returns those whose
    /// visibility changed.
    fn relabel(&mut self, view: &LodView) -> Vec<u32> {
        let mut changed = Vec::new();
        let mut stack = vec![(1, Place::Partly), (0, Place::Partly)];
        while let Some((t, above)) = stack.pop() {
            let (_, centre, radius) = self.ball(self.tree.get(t));
            let place = if above == Place::Partly { view.classify(centre, radius) } else { above };
            let last = std::mem::replace(&mut self.items[t as usize].place, place);
            if (last == Place::Out) != (place == Place::Out) {
                changed.push(t);
            }
            let child = self.tree.get(t).child;
            if child != NONE && !(place == last && place != Place::Partly) {
                stack.extend([(child + 1, place), (child, place)]);
            }
        }
        changed
    }

    /// Recomputes the priorities that may matter within the next frames, and those whose turn it is.
    fn reprioritise(&mut self, view: &LodView) {
        let velocity_m = self.last.map_or(f64::INFINITY, |last| {
            // A turn or a zoom changes lengths on the screen without moving the eye: then all are recomputed.
            if last.same_picture(view) { (view.eye() - last.eye()).length() } else { f64::INFINITY }
        });
        let changed = self.relabel(view);
        let beyond = |queue: usize| queue.div_ceil(BEYOND_THRESHOLD);
        let split_from = self.splits.iter().rev().nth(beyond(self.splits.len())).map_or(0, |e| e.0);
        let merge_to = self.merges.iter().nth(beyond(self.merges.len())).map_or(u64::MAX, |e| e.0);
        let ahead_m = velocity_m * DEFERRAL_FRAMES as f64;
        let queued: Vec<u32> = self.splits.iter().chain(&self.merges).map(|e| e.1).collect();
        let turn = |t: u32| u64::from(t) % DEFERRAL_FRAMES == self.frame % DEFERRAL_FRAMES;
        let due: Vec<u32> = queued
            .into_iter()
            .filter(|&t| self.items[t as usize].immediate || turn(t) || !ahead_m.is_finite())
            .chain(changed)
            .collect();
        for &t in &due {
            self.decisions += 1;
            let priority = self.priority(t, view);
            let (_, centre, radius) = self.ball(self.tree.get(t));
            let distance = (centre - view.eye()).length() - radius;
            let (soon, late) = if distance > ahead_m {
                (priority * distance / (distance - ahead_m), priority * distance / (distance + ahead_m))
            } else {
                (f64::INFINITY, 0.0)
            };
            let item = &mut self.items[t as usize];
            item.priority = priority;
            item.immediate = match item.queued {
                Some(Queue::Merge(_)) => late.to_bits() <= merge_to,
                _ => soon.to_bits() >= split_from,
            };
        }
        for t in due {
            // A diamond's key is that of both its triangles.
            let base = self.tree.get(t).base;
            for t in [t, base].into_iter().filter(|&t| t != NONE) {
                self.requeue(t);
            }
        }
    }

    /// The greedy loop. Returns how far the count ever exceeded the budget.
    fn refine(&mut self, budget: usize, view: &LodView) -> usize {
        let whole = 2 * (self.ground.side() as usize).pow(2);
        let mut overrun = 0;
        // Once the budget is reached, only a split that is worth more than a merge goes on: else a split that overruns
        // and the merges that undo it would follow each other for ever.
        let mut full = false;
        for _ in 0..STEPS_PER_TRIANGLE * budget.min(whole) + 64 {
            let split = self.splits.last().copied().filter(|e| e.0 > 0);
            let merge = self.merges.first().copied();
            let leaves = self.tree.leaves();
            overrun = overrun.max(leaves.saturating_sub(budget));
            full |= leaves + 2 > budget;
            let crossed = matches!((split, merge), (Some(s), Some(m)) if s.0 > m.0);
            match (split, merge) {
                (_, Some((_, t))) if leaves > budget => self.apply(view, |tree| tree.merge(t)),
                (Some((_, t)), _) if !full || crossed => self.apply(view, |tree| tree.split(t)),
                _ => break,
            }
        }
        while self.tree.leaves() > budget {
            let Some(&(_, t)) = self.merges.first() else { break };
            self.apply(view, |tree| tree.merge(t));
        }
        overrun
    }

    fn apply(&mut self, view: &LodView, change: impl FnOnce(&mut Bintree)) {
        let from = self.tree.changes.len();
        change(&mut self.tree);
        self.settle(from, view);
    }
}

/// The summed thickness of every triangle in metres.
fn wedgies(ground: &Ground) -> ImplicitTree {
    ImplicitTree::new(ground.side(), |tri, m, children| {
        let [_, left, right] = tri.corners.map(|p| ground.z(p.i, p.j));
        let own = (ground.z(m.i, m.j) - 0.5 * (left + right)).abs() * ground.scale().up_m;
        own as f32 + children[0].max(children[1])
    })
}

/// The greatest length on the screen, in pixels, of a half-thickness up or down from the corners.
fn vertex_bound(corners: [DVec3; 3], thickness_m: f64, view: &LodView) -> f64 {
    let rise = DVec3::Z * thickness_m;
    let mut worst = 0.0_f64;
    for c in corners {
        let Some(middle) = view.project(c) else { return f64::INFINITY };
        for end in [c - rise, c + rise] {
            let Some(end) = view.project(end) else { return f64::INFINITY };
            let (dx, dy) = (end[0] - middle[0], end[1] - middle[1]);
            worst = worst.max((dx * dx + dy * dy).sqrt());
        }
    }
    worst
}

impl LevelOfDetail for Published {
    /// The setting is the triangle budget. The bound is the priority of the first unsplit triangle, which the paper
    /// states as the accuracy attained; it rests on the vertex bound and on deferred priorities.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        let budget = match target {
            Target::Setting(budget) => RANGE.check(budget)? as usize,
            Target::Triangles(most) => most.max(2) as usize,
        };
        self.decisions = 0;
        self.tree.changes.clear();
        self.reprioritise(view);
        let overrun = self.refine(budget, view);
        self.frame += 1;
        self.last = Some(*view);
        let splits = self.tree.changes.iter().filter(|c| matches!(c, Change::Split(_))).count();
        let statistics = Statistics {
            setting: budget as f64,
            decisions: self.decisions,
            splits: splits as u64,
            merges: (self.tree.changes.len() - splits) as u64,
            overrun: overrun as u64,
            strips: self.strips.as_ref().map_or(0, |s| s.output().pieces as u64),
            ..Statistics::default()
        };
        let bound_px = self.splits.last().map_or(0.0, |e| f64::from_bits(e.0));
        let ground = &self.ground;
        let mesh = self.builder.build([ground.side(); 2], &self.tree.triangles(), |p| ground.z(p.i, p.j));
        Ok(Frame { mesh, bound_px: Some(bound_px), statistics })
    }

    fn memory_bytes(&self) -> usize {
        self.wedgie_m.bytes()
            + self.tree.bytes()
            + self.builder.bytes()
            + size_of_val(self.items.as_slice())
            + (self.splits.len() + self.merges.len()) * size_of::<(u64, u32)>()
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::terrain::{MemoryField, SceneScale, synthetic::fractal};

    #[test]
    fn wedgies_sum_up_the_tree_by_hand() {
        // North row first: 0 0 4 / 0 7 1 / 2 0 0, as in the test of split-only ROAM: 4 at the base of the south-eastern
        // root, 1 and 1 below it; 4, and 1 and 2, in the north-western one.
        let heights = [[2.0, 0.0, 0.0], [0.0, 7.0, 1.0], [0.0, 0.0, 4.0]];
        let field = MemoryField::from_fn(3, 3, |i, j| Some(heights[j as usize][i as usize])).unwrap();
        let system = Published::new(Ground::read(&field, SceneScale::UNIT).unwrap());
        assert_eq!([0, 1].map(|root| system.wedgie_m.get(system.tree.get(root))), [5.0, 6.0]);
    }

    #[test]
    fn the_vertex_bound_by_hand() {
        // Looking down from 10 m; 600 pixels for a tangent of 1: a vertex 3 m beside the axis at height 0 appears at
        // 600 * 3 / 10 = 180; 5 m higher at 600 * 3 / 5 = 360; 5 m lower at 600 * 3 / 15 = 120.
        let view = LodView::new(DVec3::new(0.0, 0.0, 10.0), DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
        let corner = DVec3::new(3.0, 0.0, 0.0);
        assert!((vertex_bound([corner, DVec3::ZERO, DVec3::ZERO], 5.0, &view) - 180.0).abs() < 1e-9);
        assert_eq!(vertex_bound([corner; 3], 9.5, &view), f64::INFINITY, "nearer than the near plane");
    }

    #[test]
    fn strips_hold_the_mesh_after_any_frames() {
        let ground = Ground::read(&fractal(65, 65, 7, 300).unwrap(), SceneScale::UNIT).unwrap();
        let mut system = Published::new(ground);
        system.keep_strips();
        for n in 0..9 {
            let eye = DVec3::new(5.0 * f64::from(n), 30.0, 300.0);
            let view = LodView::new(eye, DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
            let frame = system.update(&view, Target::Triangles([700, 900, 300][n as usize % 3])).unwrap();
            let turned = |mut t: [u64; 3]| {
                t.sort_unstable();
                t
            };
            let mut expected: Vec<_> = frame.mesh.plan().into_iter().map(turned).collect();
            expected.sort_unstable();
            let strips = system.strips().unwrap();
            let mut found: Vec<_> = strips
                .vertices()
                .flat_map(|s| s.windows(3).map(|w| turned([w[0], w[1], w[2]])).collect::<Vec<_>>())
                .collect();
            found.sort_unstable();
            assert_eq!(found, expected, "frame {n}");
            assert!(strips.output().average() > 2.0, "{:?}", strips.output());
        }
    }

    #[test]
    fn queues_hold_what_can_be_split_and_merged() {
        let ground = Ground::read(&fractal(65, 65, 7, 300).unwrap(), SceneScale::UNIT).unwrap();
        let mut system = Published::new(ground);
        for n in 0..12 {
            let eye = DVec3::new(3.0 * f64::from(n), 20.0, 400.0 + f64::from(n));
            let view = LodView::new(eye, DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
            let budget = [200, 900, 60][n as usize % 3];
            let frame = system.update(&view, Target::Triangles(budget)).unwrap();
            assert!(frame.mesh.len() <= budget as usize);
            let (mut split, mut merge) = (Vec::new(), Vec::new());
            let mut stack = vec![0, 1];
            while let Some(t) = stack.pop() {
                let child = system.tree.get(t).child;
                if child != NONE {
                    stack.extend([child, child + 1]);
                }
                if system.tree.can_split(t) {
                    split.push(t);
                }
                if system.tree.can_merge(t) {
                    merge.push(t);
                }
            }
            let ids = |queue: &BTreeSet<(u64, u32)>| {
                let mut ids: Vec<u32> = queue.iter().map(|e| e.1).collect();
                ids.sort_unstable();
                ids
            };
            split.sort_unstable();
            merge.sort_unstable();
            assert_eq!(ids(&system.splits), split, "frame {n}");
            assert_eq!(ids(&system.merges), merge, "frame {n}");
        }
    }
}
