//! The dual queue: splits and merges that lead from any mesh to the one that the order asks for.
//!
//! Held are the *active* posts and the *ready* ones: inactive, but with all parents active. Posts are in order (priority
//! descending, level coarse first, j, i), which puts every post after its parents; so the first inactive post of all is a
//! ready one, and the last active post that is not required has no active child. When the last active one comes before
//! the first ready one, the mesh is a prefix of the order.
//!
//! Priorities are computed for posts near the cut only. All others are put off (see [`super::pace`]): known to be beyond the
//! guard of their queue, so that whatever is nearest to the cut on the near side of the guard is the first, or last, of
//! all. When a queue runs out there, its guard moves and brings in more. So the mesh never depends on what was put off.

use std::{
    cmp::{Ordering, Reverse},
    collections::BinaryHeap,
    sync::Arc,
};

use glam::DVec3;
use sightline_proto::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
};

pub(super) use super::nodes::{KeyHasher, KeyMap};
use super::{
    Options, Terrain,
    nodes::{List, Node, Nodes, Side},
    pace::{GAP, Guard, Pace},
    reader::Reader,
};
use crate::{
    terrain::{Grid, ReadError, SceneScale},
    view::{Camera, Planes},
};

/// What an update did, counted.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct Work {
    /// Posts made active.
    pub splits: u64,
    /// Posts made inactive.
    pub merges: u64,
    /// Priorities computed.
    pub priorities: u64,
    /// Whether the mesh was built from nothing.
    pub from_scratch: bool,
}

/// A place in the order: the greater one is split first.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Place {
    /// Bits of the priority, which is not negative: bits order as values.
    priority: u64,
    key: u64,
    slot: u32,
    level: u8,
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

/// How many active posts are asked, about, before a mesh is given up.
const SAMPLES: usize = 64;

/// What a refinement may do.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Allowance {
    /// Greatest number of triangles.
    pub(super) max: u32,
    /// Priority above which a diamond is split.
    pub(super) threshold: f64,
}

/// The mesh of one view with its two queues.
#[derive(Debug)]
pub(super) struct DualQueue<T> {
    reader: Reader<T>,
    root: RootSquare,
    corner_heights: [f64; 4],
    camera: Camera,
    options: Options,
    nodes: Nodes,
    /// Counts cameras, so that it is known which priorities are of the present one.
    look: u32,
    pace: Pace,
    split_guard: Guard,
    merge_guard: Guard,
    /// The hot posts of each side by place, least first for merging; may hold stale entries. `None` until needed.
    split_queue: Heap<Place>,
    merge_queue: Heap<Reverse<Place>>,
    required: Vec<Post>,
    triangles: u64,
    /// The priority at which the mesh ends.
    cut: f64,
    /// Voluntary splits and merges that are left in this update.
    operations_left: u64,
    /// Every post whose state changed, as often as it did.
    toggled: Vec<Post>,
    pub(super) work: Work,
}

/// A heap that is built when it is first asked.
#[derive(Debug)]
struct Heap<P> {
    heap: BinaryHeap<P>,
    built: bool,
}

impl<P: Ord> Heap<P> {
    fn new() -> Self {
        Self { heap: BinaryHeap::new(), built: false }
    }

    fn forget(&mut self) {
        self.heap.clear();
        self.built = false;
    }

    fn build(&mut self, places: impl Iterator<Item = P>) {
        let mut vec = std::mem::take(&mut self.heap).into_vec();
        vec.clear();
        vec.extend(places);
        (self.heap, self.built) = (vec.into(), true);
    }

    fn push(&mut self, place: P) {
        if self.built {
            self.heap.push(place);
        }
    }
}

impl<T: Terrain> DualQueue<T> {
    /// The mesh of two triangles, with the centre ready.
    pub(super) fn new(terrain: Arc<T>, scale: SceneScale) -> Result<Self, ReadError> {
        let mut reader = Reader::new(terrain, scale);
        let (grid, root) = (reader.grid(), reader.grid().root());
        let mut corner_heights = [0.0; 4];
        for (slot, corner) in corner_heights.iter_mut().zip(root.corners()) {
            *slot = reader.height(grid.clamp(corner))?;
        }
        let mut queue = Self {
            reader,
            root,
            corner_heights,
            camera: Camera::everywhere(),
            options: Options::default(),
            nodes: Nodes::new(),
            look: 1,
            pace: Pace::new(),
            split_guard: Guard::new(Side::Split),
            merge_guard: Guard::new(Side::Merge),
            split_queue: Heap::new(),
            merge_queue: Heap::new(),
            required: Vec::new(),
            triangles: 2,
            cut: 0.0,
            operations_left: u64::MAX,
            toggled: Vec::new(),
            work: Work::default(),
        };
        queue.restart()?;
        Ok(queue)
    }

    pub(super) fn terrain(&self) -> &Arc<T> {
        self.reader.terrain()
    }

    pub(super) fn grid(&self) -> Grid {
        self.reader.grid()
    }

    pub(super) fn scale(&self) -> SceneScale {
        self.reader.scale()
    }

    pub(super) fn triangles(&self) -> u64 {
        self.triangles
    }

    /// The height of an active post or corner.
    #[inline]
    pub(super) fn height_of(&self, p: Post) -> Option<f64> {
        match self.nodes.slot(p) {
            Some(slot) => Some(self.nodes.get(slot)).filter(|node| node.active).map(|node| node.z),
            None => self.root.corners().iter().position(|&c| c == p).map(|n| self.corner_heights[n]),
        }
    }

    /// The tight thickness of the diamond at `p`, from the mesh if it holds the post.
    pub(super) fn tight(&self, p: Post) -> Result<f32, ReadError> {
        match self.nodes.slot(p) {
            Some(slot) => Ok(self.nodes.get(slot).tight),
            None => Ok(self.reader.terrain().bounds(p)?.tight),
        }
    }

    /// Posts of the grid from west to east and from south to north.
    pub(super) fn grid_posts(&self) -> (u32, u32) {
        (self.grid().nx(), self.grid().ny())
    }

    /// The corners of a triangle of the mesh in the grid frame, counter-clockwise.
    ///
    /// # Panics
    /// When a corner is not active.
    pub(super) fn corners_in_space(&self, triangle: &Triangle) -> [[f64; 3]; 3] {
        triangle.corners().map(|p| {
            let z = self.height_of(p).expect("the corners of a mesh's triangles are active");
            [f64::from(p.i), f64::from(p.j), z]
        })
    }

    /// The active posts that are no corners, in no particular order.
    pub(super) fn active(&self) -> impl Iterator<Item = (Post, f64)> {
        self.nodes.active().map(|node| (node.post, node.z))
    }

    /// How many posts are held.
    pub(super) fn posts_held(&self) -> usize {
        self.nodes.len()
    }

    /// Bytes of memory held.
    pub(super) fn bytes(&self) -> usize {
        let heaps = (self.split_queue.heap.capacity() + self.merge_queue.heap.capacity()) * size_of::<Place>();
        let posts = (self.required.capacity() + self.toggled.capacity()) * size_of::<Post>();
        self.nodes.bytes() + heaps + posts
    }

    /// Every post whose state changed since the record was last cleared, as often as it did.
    pub(super) fn toggles(&self) -> &[Post] {
        &self.toggled
    }

    /// The posts whose state differs from when this was last asked, in order; clears the record.
    pub(super) fn take_changes(&mut self) -> (Vec<Post>, Vec<Post>) {
        let mut toggled = std::mem::take(&mut self.toggled);
        toggled.sort_unstable();
        let changed = toggled.chunk_by(|a, b| a == b).filter(|run| run.len() % 2 == 1).map(|run| run[0]);
        let changes = changed.partition(|&p| self.height_of(p).is_some());
        toggled.clear();
        // A rebuilt mesh leaves a long record; what a usual frame needs is far less.
        toggled.shrink_to(self.nodes.len() / 8);
        self.toggled = toggled;
        changes
    }

    /// Starts an update: counts its work, and allows it so many voluntary operations.
    pub(super) fn begin(&mut self, options: &Options) {
        self.work = Work::default();
        self.operations_left = options.max_operations.map_or(u64::MAX, u64::from);
        if options.deferral != self.options.deferral || options.regions != self.options.regions {
            let regions = options.regions != self.options.regions;
            self.options = options.clone();
            if regions {
                self.look = self.look.wrapping_add(1);
            }
            self.all_hot();
        } else if *options != self.options {
            self.options = options.clone();
        }
    }

    /// Whether the cap on operations ended the last refinement.
    pub(super) fn is_cut_short(&self) -> bool {
        self.operations_left == 0
    }

    /// Looks through another camera: computes the priorities of all posts that may now lie on the other side of a
    /// guard. Starts from nothing where little of the mesh would be left.
    pub(super) fn look(&mut self, camera: &Camera) -> Result<(), ReadError> {
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

    /// Puts nothing off any more.
    fn all_hot(&mut self) {
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
    fn appraise(&mut self, slot: u32, guard: &Guard) -> List {
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
        let (priority, inside) = self.priority(self.nodes.get(slot), Planes::default());
        let look = self.look;
        let node = self.nodes.get_mut(slot);
        (node.priority, node.inside, node.look) = (priority, inside, look);
        let list = node.list();
        self.work.priorities += 1;
        list
    }

    fn bring_up_to_date(&mut self, slot: u32) {
        if self.nodes.get(slot).look != self.look {
            self.evaluate(slot);
        }
    }

    /// Thickness, centre and radius of a post's ball in metres in the scene frame.
    fn ball(&self, node: &Node) -> (f64, DVec3, f64) {
        let at = DVec3::new(f64::from(node.post.i), f64::from(node.post.j), node.z);
        (
            f64::from(node.nested) * self.reader.scale().up_m,
            self.reader.scale().scene_from_grid(at),
            f64::from(node.radius_m),
        )
    }

    fn priority(&self, node: &Node, inside: Planes) -> (f64, Planes) {
        let (thickness_m, centre, radius_m) = self.ball(node);
        let (priority, inside) = self.camera.priority_within(inside, thickness_m, centre, radius_m);
        (priority * self.options.regions.weight(centre, radius_m), inside)
    }

    /// Splits and merges until the mesh is the required posts with the longest prefix of the order that is allowed, or
    /// the cap on operations is reached. The required posts alone must fit.
    pub(super) fn refine(&mut self, allowed: Allowance) -> Result<(), ReadError> {
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

    /// The greatest priority, without the weights of regions, among unsplit diamonds that have a triangle in the mesh.
    ///
    /// Those whose parents are not all active need not be asked: across the base of such a triangle lies a coarser
    /// one, whose diamond is a parent and has no lower priority.
    pub(super) fn bound(&mut self) -> f64 {
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

    /// Ends an update: draws the guards up to where the mesh ends, for the next one.
    pub(super) fn settle(&mut self, threshold: f64) {
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

    /// Makes `posts`, a set that holds the parents of its members, required beside those that already are. Coarse
    /// posts come first.
    pub(super) fn require(&mut self, posts: &[Post]) -> Result<(), ReadError> {
        for &post in posts {
            let slot = self.nodes.slot(post).expect("required posts come after their parents");
            let node = self.nodes.get_mut(slot);
            if !node.required {
                node.required = true;
                self.required.push(post);
            }
            if node.active {
                self.nodes.put(slot, List::NONE);
            } else {
                self.split(slot)?;
            }
        }
        Ok(())
    }

    /// Requires nothing any more.
    pub(super) fn release(&mut self) {
        let mut required = std::mem::take(&mut self.required);
        for post in required.drain(..) {
            let slot = self.nodes.slot(post).expect("required posts are active");
            let node = self.nodes.get_mut(slot);
            node.required = false;
            if node.active {
                self.offer_to_merge(slot);
            }
        }
        self.required = required;
    }

    /// Brings a guard nearer to what it guards, and what is due then into its queue.
    fn approach(&mut self, side: Side, value: f64) {
        let rate = self.pace.rate;
        for list in self.guard(side).approach(value, rate) {
            while let Some(slot) = self.nodes.first(list) {
                self.bring_up_to_date(slot);
                self.make_hot(slot, side);
            }
        }
    }

    fn make_hot(&mut self, slot: u32, side: Side) {
        self.nodes.put(slot, List::hot(side));
        let place = self.place(slot);
        match side {
            Side::Split => self.split_queue.push(place),
            Side::Merge => self.merge_queue.push(Reverse(place)),
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

    /// The greatest ready post.
    fn first_ready(&mut self) -> Option<Place> {
        if !self.split_queue.built {
            let nodes = &self.nodes;
            let places: Vec<_> = nodes.of(List::hot(Side::Split)).map(|slot| self.place(slot)).collect();
            self.split_queue.build(places.into_iter());
        }
        let mut step = GAP;
        loop {
            while self.split_queue.heap.peek().is_some_and(|&place| !self.holds(place, Side::Split)) {
                self.split_queue.heap.pop();
            }
            let first = self.split_queue.heap.peek().copied();
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

    /// The least post that may be merged, if it has a priority of at most `most`; it may also be another one above
    /// that, or none.
    fn least_active(&mut self, most: f64) -> Option<Place> {
        if !self.merge_queue.built {
            let nodes = &self.nodes;
            let places: Vec<_> = nodes.of(List::hot(Side::Merge)).map(|slot| Reverse(self.place(slot))).collect();
            self.merge_queue.build(places.into_iter());
        }
        let mut step = GAP;
        loop {
            while self.merge_queue.heap.peek().is_some_and(|&Reverse(place)| !self.holds(place, Side::Merge)) {
                self.merge_queue.heap.pop();
            }
            let least = self.merge_queue.heap.peek().map(|&Reverse(place)| place);
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

    /// Makes a ready post active, and its children ready where it was the last parent that they waited for.
    fn split(&mut self, slot: u32) -> Result<(), ReadError> {
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
    fn merge(&mut self, slot: u32) {
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
    fn offer_to_merge(&mut self, slot: u32) {
        let node = self.nodes.get(slot);
        if node.active_children == 0 && !node.required {
            self.bring_up_to_date(slot);
            self.make_hot(slot, Side::Merge);
        }
    }

    /// Whether a camera far from the last one leaves little of the mesh: asked of every so many active posts.
    fn little_is_left(&self) -> bool {
        let step = (self.nodes.len() / SAMPLES).max(1);
        let (mut asked, mut left) = (0, 0);
        for node in self.nodes.active().step_by(step) {
            asked += 1;
            left += usize::from(self.priority(node, Planes::default()).0 > 0.5 * self.cut);
        }
        asked > SAMPLES / 8 && left * 2 < asked
    }

    /// Goes back to the mesh of two triangles, with the centre ready.
    fn restart(&mut self) -> Result<(), ReadError> {
        let centre = Post::new(self.root.side() / 2, self.root.side() / 2);
        let centre = if self.root.side() > 1 { Some(self.read(centre, Planes::default())?) } else { None };
        let active = self.nodes.active().map(|node| node.post);
        self.toggled.extend(active);
        self.nodes.clear();
        self.required.clear();
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

    /// Checks all that is taken for granted of lists, guards and priorities, by computing everything.
    #[cfg(test)]
    pub(super) fn check(&self) {
        for node in self.nodes.all() {
            let (is, _) = self.priority(node, Planes::default());
            let children = self.root.children(node.post).filter(|&c| self.height_of(c).is_some()).count();
            assert_eq!(usize::from(node.active_children), children);
            let side = if !node.active {
                Side::Split
            } else if node.required || children > 0 {
                assert_eq!(node.list(), List::NONE);
                continue;
            } else {
                Side::Merge
            };
            if node.list() == List::hot(side) {
                assert_eq!((node.look, node.priority.to_bits()), (self.look, is.to_bits()));
                continue;
            }
            let lists = (0..List::BUCKETS.into()).map(|tick| List::due(side, tick));
            assert!(lists.into_iter().any(|list| list == node.list()), "{node:?} is in no list");
            let beyond = match side {
                Side::Split => is == 0.0 || is < self.split_guard.value,
                Side::Merge => is > self.merge_guard.value,
            };
            assert!(beyond, "{is} of {node:?} is not beyond {:?}, {:?}", self.split_guard, self.merge_guard);
        }
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

impl<T: Terrain> Mesh for DualQueue<T> {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.grid().nx(), self.grid().ny())
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.height_of(p)
    }
}
