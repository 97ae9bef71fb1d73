//! Priorities under the camera, and the guards beyond which they are put off.
//!
//! A post that is hot has its priority of the present camera; any other is known to be beyond the guard of its side (see
//! [`super::pace`]). Whatever moves a guard or the camera keeps that true.

use glam::DVec3;

use super::{
    DualQueue, Place, Terrain,
    nodes::{List, Node, Side},
    pace::{GAP, Guard},
};
use crate::{
    terrain::ReadError,
    view::{Camera, Planes},
};

/// How many active posts are asked, about, before a mesh is given up.
const SAMPLES: usize = 64;

impl<T: Terrain> DualQueue<T> {
    /// Looks through another camera: computes the priorities of all posts that may now lie on the other side of a
    /// guard. Starts from nothing where little of the mesh would be left.
    pub(in crate::roam) fn look(&mut self, camera: &Camera) -> Result<(), ReadError> {
        if self.camera == *camera {
            return Ok(());
        }
        let motion = camera.motion_from(&self.camera);
        self.camera = *camera;
        self.look = self.look.wrapping_add(1);
        let ticks = self.pace.ticks(motion, self.cut);
        for side in [Side::Split, Side::Merge] {
            for list in self.guard(side).advance(ticks) {
                self.move_all(list, List::hot(side));
            }
        }
        let due = self.nodes.hot(Side::Split) + self.nodes.hot(Side::Merge);
        // With a cap there may be no work left for a mesh as good as the one given up.
        let may_restart = self.options.max_operations.is_none() && 3 * due > self.nodes.len();
        if !self.options.incremental || (may_restart && self.little_is_left()) {
            // After a failed read the old mesh stays, and its priorities must be of this camera.
            return self.restart().inspect_err(|_| self.all_hot());
        }
        self.split_queue.forget();
        self.merge_queue.forget();
        self.sort_out(Side::Split);
        self.sort_out(Side::Merge);
        Ok(())
    }

    /// Puts nothing off any more.
    pub(super) fn all_hot(&mut self) {
        for side in [Side::Split, Side::Merge] {
            for tick in 0..List::BUCKETS.into() {
                self.move_all(List::due(side, tick), List::hot(side));
            }
            *self.guard(side) = Guard::new(side);
        }
        // Their priorities may be of earlier cameras.
        self.split_queue.forget();
        self.merge_queue.forget();
        for side in [Side::Split, Side::Merge] {
            let mut next = self.nodes.first(List::hot(side));
            while let Some(slot) = next {
                next = self.nodes.after(slot);
                self.bring_up_to_date(slot);
            }
        }
    }

    /// Whether a camera far from the last one leaves little of the mesh: asked of every so many active posts.
    fn little_is_left(&self) -> bool {
        let step = (self.nodes.len() / SAMPLES).max(1);
        let (mut asked, mut left) = (0, 0);
        for node in self.nodes.active().filter(|node| !node.required).step_by(step) {
            asked += 1;
            left += usize::from(self.priority(node, Planes::default()).0 > 0.5 * self.cut);
        }
        asked > SAMPLES / 8 && left * 2 < asked
    }

    fn guard(&mut self, side: Side) -> &mut Guard {
        match side {
            Side::Split => &mut self.split_guard,
            Side::Merge => &mut self.merge_guard,
        }
    }

    fn move_all(&mut self, from: List, to: List) {
        while let Some(slot) = self.nodes.first(from) {
            self.nodes.put(slot, to);
        }
    }

    /// Computes the hot posts of a side and puts off those that are beyond its guard for a while.
    fn sort_out(&mut self, side: Side) {
        let guard = *self.guard(side);
        let puts_off = self.options.deferral && !self.pace.turns_fast();
        let mut next = self.nodes.first(List::hot(side));
        while let Some(slot) = next {
            next = self.nodes.after(slot);
            let list = if puts_off { self.appraise(slot, &guard) } else { self.evaluate(slot) };
            if list != List::hot(side) {
                self.nodes.put(slot, list);
            }
        }
    }

    /// Computes the priority of a post; the list that it belongs to.
    pub(super) fn appraise(&mut self, slot: u32, guard: &Guard) -> List {
        let node = self.nodes.get(slot);
        let (thickness_m, centre, radius_m) = self.ball(node);
        let appraisal = self.camera.appraise(thickness_m, centre, radius_m);
        let weight = self.options.regions.weight(centre, radius_m);
        let priority = appraisal.priority * weight;
        let beyond = match guard.side {
            Side::Split => priority < guard.value || priority == 0.0,
            Side::Merge => priority > guard.value,
        };
        let list = if beyond { guard.list_for(&appraisal, weight, self.pace.rate) } else { List::hot(guard.side) };
        self.work.priorities += 1;
        let look = self.look;
        let node = self.nodes.get_mut(slot);
        (node.priority, node.look, node.inside) = (priority, look, Planes::default());
        list
    }

    /// Computes the priority of a post, which stays in its list.
    fn evaluate(&mut self, slot: u32) -> List {
        let (thickness_m, centre, radius_m) = self.ball(self.nodes.get(slot));
        let priority = self.camera.priority(thickness_m, centre, radius_m);
        let priority = priority * self.options.regions.weight(centre, radius_m);
        let look = self.look;
        let node = self.nodes.get_mut(slot);
        (node.priority, node.inside, node.look) = (priority, Planes::default(), look);
        let list = node.list();
        self.work.priorities += 1;
        list
    }

    pub(super) fn bring_up_to_date(&mut self, slot: u32) {
        if self.nodes.get(slot).look != self.look {
            self.evaluate(slot);
        }
    }

    /// Thickness, centre and radius of a post's ball in metres in the scene frame.
    fn ball(&self, node: &Node) -> (f64, DVec3, f64) {
        self.reader.ball(node.post, node.z, node.nested, node.radius_m)
    }

    pub(super) fn priority(&self, node: &Node, inside: Planes) -> (f64, Planes) {
        let (thickness_m, centre, radius_m) = self.ball(node);
        let (priority, inside) = self.camera.priority_within(inside, thickness_m, centre, radius_m);
        (priority * self.options.regions.weight(centre, radius_m), inside)
    }

    /// The priority at which the mesh of the last update ends: what is ready has no higher one.
    pub(in crate::roam) fn end(&self) -> f64 {
        self.cut
    }

    /// Ends an update: draws the guards up to where the mesh ends, for the next one.
    pub(in crate::roam) fn settle(&mut self, threshold: f64) {
        let first = self.first_ready().map_or(0.0, Place::priority);
        self.cut = first.max(threshold);
        if !self.options.deferral {
            return;
        }
        // Moving away costs nothing. Not too often, though: each way back does.
        if self.split_guard.value < first * (1.0 - 4.0 * GAP) {
            self.split_guard.value = first * (1.0 - 2.0 * GAP);
        }
        if self.merge_guard.value > self.cut * (1.0 + 4.0 * GAP) {
            self.merge_guard.value = self.cut * (1.0 + 2.0 * GAP);
        }
    }

    /// Brings a guard nearer to what it guards, and what is due then into its queue.
    pub(super) fn approach(&mut self, side: Side, value: f64) {
        let rate = self.pace.rate;
        for list in self.guard(side).approach(value, rate) {
            while let Some(slot) = self.nodes.first(list) {
                self.bring_up_to_date(slot);
                self.make_hot(slot, side);
            }
        }
    }

    /// The greatest priority, without the weights of regions, among unsplit diamonds that have a triangle in the mesh.
    ///
    /// Those whose parents are not all active need not be asked: across the base of such a triangle lies a coarser
    /// one, whose diamond is a parent and has no lower priority.
    pub(in crate::roam) fn bound(&mut self) -> f64 {
        let first = self.first_ready().map_or(0.0, Place::priority);
        if self.options.regions.is_empty() {
            return first;
        }
        // Weights are at least 1: what is put off lies below the guard without its weight, too.
        loop {
            let (mut greatest, hot) = (0.0_f64, List::hot(Side::Split));
            for slot in self.nodes.of(hot) {
                let (thickness_m, centre, radius_m) = self.ball(self.nodes.get(slot));
                greatest = greatest.max(self.camera.priority(thickness_m, centre, radius_m));
            }
            if greatest >= self.split_guard.value {
                return greatest;
            }
            self.approach(Side::Split, if self.split_guard.value.is_finite() { greatest * (1.0 - GAP) } else { 0.0 });
        }
    }
}
