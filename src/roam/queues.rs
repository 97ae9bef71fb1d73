//! The dual queue: splits and merges that lead from any mesh to the one that the order asks for.
//!
//! Held are the *active* posts and the *ready* ones: inactive, but with all parents active. Everything read or computed
//! about a post is kept with it, so memory is proportional to the mesh. Posts are in order (priority descending, level
//! coarse first, j, i), which puts every post after its parents; so the first inactive post of all is a ready one, and
//! the last active post that is not required has no active child. When the last active one comes before the first
//! ready one, the mesh is a prefix of the order.

use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashMap},
    hash::{BuildHasherDefault, Hasher},
    sync::Arc,
};

use glam::DVec3;
use sightline_proto::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
};

use super::Terrain;
use crate::{
    terrain::{Grid, Posts, ReadError, SceneScale},
    view::Camera,
};

/// Mixes the bits of a post's key by one multiplication (Fibonacci hashing, Knuth 6.4). Deterministic; no result
/// depends on the order of such a map.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct KeyHasher(u64);

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

pub(super) type KeyMap<V> = HashMap<u64, V, BuildHasherDefault<KeyHasher>>;

/// What an update did, counted.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct Work {
    /// Posts made active.
    pub splits: u64,
    /// Posts made inactive.
    pub merges: u64,
    /// Priorities computed.
    pub priorities: u64,
}

/// A place in the order: the greater one is split first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) struct Rank {
    /// Bits of the priority, which is not negative: bits order as values.
    priority: u64,
    level: Reverse<u8>,
    key: Reverse<u64>,
}

impl Rank {
    fn priority(self) -> f64 {
        f64::from_bits(self.priority)
    }
}

/// The cost of a place that holds no post.
const FREE: u8 = 0;

/// An active or ready post.
#[derive(Clone, Debug)]
struct Node {
    post: Post,
    z: f64,
    centre: DVec3,
    thickness_m: f64,
    radius_m: f64,
    tight: f32,
    rank: Rank,
    active: bool,
    required: bool,
    /// Triangles that splitting adds: 2, or 1 on the border.
    cost: u8,
    active_children: u8,
}

/// The mesh of one view with its two queues.
#[derive(Debug)]
pub(super) struct DualQueue<T> {
    terrain: Arc<T>,
    grid: Grid,
    root: RootSquare,
    scale: SceneScale,
    corner_heights: [f64; 4],
    nodes: Vec<Node>,
    free: Vec<u32>,
    slots: KeyMap<u32>,
    /// Ready posts by rank, greatest first; holds stale entries, too.
    split_queue: BinaryHeap<(Rank, u32)>,
    /// Active posts that are not required and without active children, least first; holds stale entries, too.
    merge_queue: BinaryHeap<Reverse<(Rank, u32)>>,
    required: Vec<Post>,
    triangles: u64,
    /// Every post whose state changed, as often as it did.
    toggled: Vec<Post>,
    pub(super) work: Work,
}

impl<T: Terrain> DualQueue<T> {
    /// The mesh of two triangles, with the centre ready.
    pub(super) fn new(terrain: Arc<T>, scale: SceneScale, camera: &Camera) -> Result<Self, ReadError> {
        let grid = terrain.grid();
        let root = grid.root();
        let mut corner_heights = [0.0; 4];
        {
            let mut posts = Posts::new(&*terrain);
            for (slot, corner) in corner_heights.iter_mut().zip(root.corners()) {
                *slot = posts.at(corner)?.z;
            }
        }
        let mut queue = Self {
            terrain,
            grid,
            root,
            scale,
            corner_heights,
            nodes: Vec::new(),
            free: Vec::new(),
            slots: KeyMap::default(),
            split_queue: BinaryHeap::new(),
            merge_queue: BinaryHeap::new(),
            required: Vec::new(),
            triangles: 2,
            toggled: Vec::new(),
            work: Work::default(),
        };
        if root.side() > 1 {
            let node = queue.read(Post::new(root.side() / 2, root.side() / 2), camera)?;
            queue.add_ready(node);
        }
        Ok(queue)
    }

    pub(super) fn terrain(&self) -> &Arc<T> {
        &self.terrain
    }

    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    pub(super) fn scale(&self) -> SceneScale {
        self.scale
    }

    pub(super) fn triangles(&self) -> u64 {
        self.triangles
    }

    /// The height of an active post or corner.
    #[inline]
    pub(super) fn height_of(&self, p: Post) -> Option<f64> {
        match self.slots.get(&p.key()) {
            Some(&slot) => self.nodes[slot as usize].active.then_some(self.nodes[slot as usize].z),
            None => self.root.corners().iter().position(|&c| c == p).map(|n| self.corner_heights[n]),
        }
    }

    /// The tight thickness of the diamond at `p`, from the mesh if it holds the post.
    pub(super) fn tight(&self, p: Post) -> Result<f32, ReadError> {
        match self.slots.get(&p.key()) {
            Some(&slot) => Ok(self.nodes[slot as usize].tight),
            None => Ok(self.terrain.bounds(p)?.tight),
        }
    }

    /// Posts of the grid from west to east and from south to north.
    pub(super) fn grid_posts(&self) -> (u32, u32) {
        (self.grid.nx(), self.grid.ny())
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
        self.nodes.iter().filter(|node| node.active).map(|node| (node.post, node.z))
    }

    /// How many posts there is memory for.
    pub(super) fn posts_held(&self) -> usize {
        self.nodes.len()
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
        changed.partition(|&p| self.height_of(p).is_some())
    }

    /// Computes all priorities for a new camera.
    pub(super) fn look(&mut self, camera: &Camera) {
        for node in self.nodes.iter_mut().filter(|node| node.cost != FREE) {
            let priority = camera.priority(node.thickness_m, node.centre, node.radius_m);
            node.rank.priority = priority.to_bits();
            self.work.priorities += 1;
        }
    }

    /// Splits and merges until the mesh is the required posts with the longest prefix of the order that fits in
    /// `max` triangles and has priorities above `threshold`. The required posts alone must fit.
    pub(super) fn refine(&mut self, camera: &Camera, max: u32, threshold: f64) -> Result<(), ReadError> {
        let max = u64::from(max);
        loop {
            while let Some((rank, slot)) = self.last_active() {
                if self.triangles <= max && rank.priority() > threshold {
                    break;
                }
                self.merge(slot);
            }
            let Some((rank, slot)) = self.first_ready() else { return Ok(()) };
            if rank.priority() <= threshold {
                return Ok(());
            }
            let fits = self.triangles + u64::from(self.nodes[slot as usize].cost) <= max;
            match self.last_active() {
                _ if fits => self.split(slot, camera)?,
                // The last one must give way to one that comes before it.
                Some((last, last_slot)) if last < rank => self.merge(last_slot),
                _ => return Ok(()),
            }
        }
    }

    /// The greatest priority among unsplit diamonds that have a triangle in the mesh.
    ///
    /// Those whose parents are not all active need not be asked: across the base of such a triangle lies a coarser
    /// one, whose diamond is a parent and has no lower priority.
    pub(super) fn bound(&mut self) -> f64 {
        self.first_ready().map_or(0.0, |(rank, _)| rank.priority())
    }

    /// Fills both queues anew, after priorities changed.
    pub(super) fn requeue(&mut self) {
        let mut split = std::mem::take(&mut self.split_queue).into_vec();
        let mut merge = std::mem::take(&mut self.merge_queue).into_vec();
        split.clear();
        merge.clear();
        for (slot, node) in (0..).zip(&self.nodes).filter(|(_, node)| node.cost != FREE) {
            if !node.active {
                split.push((node.rank, slot));
            } else if node.active_children == 0 && !node.required {
                merge.push(Reverse((node.rank, slot)));
            }
        }
        self.split_queue = split.into();
        self.merge_queue = merge.into();
    }

    /// Makes `posts`, a set that holds the parents of its members, required beside those that already are. Coarse
    /// posts come first.
    pub(super) fn require(&mut self, posts: &[Post], camera: &Camera) -> Result<(), ReadError> {
        for &post in posts {
            let slot = self.slots[&post.key()];
            let node = &mut self.nodes[slot as usize];
            if !node.required {
                node.required = true;
                self.required.push(post);
            }
            if !node.active {
                self.split(slot, camera)?;
            }
        }
        Ok(())
    }

    /// Requires nothing any more.
    pub(super) fn release(&mut self) {
        for post in std::mem::take(&mut self.required) {
            let slot = self.slots[&post.key()];
            let node = &mut self.nodes[slot as usize];
            node.required = false;
            if node.active && node.active_children == 0 {
                self.merge_queue.push(Reverse((node.rank, slot)));
            }
        }
    }

    /// The greatest ready post; drops stale entries.
    fn first_ready(&mut self) -> Option<(Rank, u32)> {
        while let Some(&(rank, slot)) = self.split_queue.peek() {
            let node = &self.nodes[slot as usize];
            if node.rank == rank && !node.active && node.cost != FREE {
                return Some((rank, slot));
            }
            self.split_queue.pop();
        }
        None
    }

    /// The least post that may be merged; drops stale entries.
    fn last_active(&mut self) -> Option<(Rank, u32)> {
        while let Some(&Reverse((rank, slot))) = self.merge_queue.peek() {
            let node = &self.nodes[slot as usize];
            if node.rank == rank && node.active && !node.required && node.active_children == 0 {
                return Some((rank, slot));
            }
            self.merge_queue.pop();
        }
        None
    }

    /// Makes a ready post active, and its children ready where it was the last parent that they waited for.
    fn split(&mut self, slot: u32, camera: &Camera) -> Result<(), ReadError> {
        let post = self.nodes[slot as usize].post;
        // All reads come first, so that a failed one changes nothing.
        let mut ready: [Option<Node>; 4] = [const { None }; 4];
        for (place, child) in ready.iter_mut().zip(self.root.children(post)) {
            if self.root.parents(child).all(|parent| parent == post || self.height_of(parent).is_some()) {
                *place = Some(self.read(child, camera)?);
            }
        }
        for parent in self.root.parents(post) {
            if let Some(&slot) = self.slots.get(&parent.key()) {
                self.nodes[slot as usize].active_children += 1;
            }
        }
        let node = &mut self.nodes[slot as usize];
        node.active = true;
        self.triangles += u64::from(node.cost);
        if !node.required {
            self.merge_queue.push(Reverse((node.rank, slot)));
        }
        self.toggled.push(post);
        self.work.splits += 1;
        for node in ready.into_iter().flatten() {
            self.add_ready(node);
        }
        Ok(())
    }

    /// Makes an active post without active children ready; its children wait again.
    fn merge(&mut self, slot: u32) {
        let node = &mut self.nodes[slot as usize];
        node.active = false;
        self.triangles -= u64::from(node.cost);
        let post = node.post;
        self.split_queue.push((node.rank, slot));
        for child in self.root.children(post) {
            if let Some(slot) = self.slots.remove(&child.key()) {
                self.nodes[slot as usize].cost = FREE;
                self.free.push(slot);
            }
        }
        for parent in self.root.parents(post) {
            let Some(&slot) = self.slots.get(&parent.key()) else { continue };
            let node = &mut self.nodes[slot as usize];
            node.active_children -= 1;
            if node.active_children == 0 && !node.required {
                self.merge_queue.push(Reverse((node.rank, slot)));
            }
        }
        self.toggled.push(post);
        self.work.merges += 1;
    }

    fn add_ready(&mut self, node: Node) {
        let (rank, key) = (node.rank, node.post.key());
        let slot = match self.free.pop() {
            Some(slot) => {
                self.nodes[slot as usize] = node;
                slot
            }
            None => {
                self.nodes.push(node);
                (self.nodes.len() - 1) as u32
            }
        };
        self.slots.insert(key, slot);
        self.split_queue.push((rank, slot));
    }

    fn read(&mut self, post: Post, camera: &Camera) -> Result<Node, ReadError> {
        let inside = self.grid.clamp(post);
        let page = self.terrain.page(crate::terrain::PageId::of(inside))?;
        let side = crate::terrain::PAGE_SIDE;
        let z = page.at(inside.i % side, inside.j % side).z;
        let bounds = self.terrain.bounds(post)?;
        let centre = self.scale.scene_from_grid(DVec3::new(f64::from(post.i), f64::from(post.j), z));
        let (thickness_m, radius_m) = (f64::from(bounds.nested) * self.scale.up_m, f64::from(bounds.radius_m));
        let priority = camera.priority(thickness_m, centre, radius_m);
        self.work.priorities += 1;
        let level = self.root.level(post).expect("no corner is ever ready");
        Ok(Node {
            post,
            z,
            centre,
            thickness_m,
            radius_m,
            tight: bounds.tight,
            rank: Rank { priority: priority.to_bits(), level: Reverse(level), key: Reverse(post.key()) },
            active: false,
            required: false,
            cost: self.root.triangles(post).count() as u8,
            active_children: 0,
        })
    }
}

impl<T: Terrain> Mesh for DualQueue<T> {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.grid.nx(), self.grid.ny())
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.height_of(p)
    }
}
