//! The dual queue: splits and merges that lead from any mesh to the one that the order asks for.
//!
//! Held are the *active* posts and the *ready* ones: inactive, but with all parents active. Posts are in order (priority
//! descending, level coarse first, j, i), which puts every post after its parents; so the first inactive post of all is a
//! ready one, and the last active post that is not required has no active child. When the last active one comes before
//! the first ready one, the mesh is a prefix of the order.
//!
//! Priorities are computed for posts near the cut only. All others are put off (see [`pace`]): known to be beyond the
//! guard of their queue, so that whatever is nearest to the cut on the near side of the guard is the first, or last, of
//! all. When a queue runs out there, its guard moves and brings in more. So the mesh never depends on what was put off.

#[cfg(test)]
mod check;
mod cut;
mod nodes;
mod operations;
mod order;
mod pace;
mod place;

use std::{cmp::Reverse, sync::Arc};

use sightline_proto::{
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
};

pub(super) use nodes::KeyMap;
use nodes::{List, Nodes, Side};
use pace::{Guard, Pace};
use place::{Heap, Place};

use super::{Options, Terrain, reader::Reader};
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
    /// The hot posts of each side by place, least first for merging; may hold stale entries.
    split_queue: Heap<Place>,
    merge_queue: Heap<Reverse<Place>>,
    triangles: u64,
    /// The priority at which the mesh ends.
    cut: f64,
    /// Voluntary splits and merges that are left in this update.
    operations_left: u64,
    /// Every post whose state changed, as often as it did.
    toggled: Vec<Post>,
    pub(super) work: Work,
}

impl<T: Terrain> DualQueue<T> {
    /// The mesh of two triangles, with the centre ready.
    pub(super) fn new(terrain: Arc<T>, scale: SceneScale) -> Result<Self, ReadError> {
        let mut reader = Reader::new(terrain, scale);
        let (grid, root) = (reader.grid(), reader.grid().root());
        let mut corner_heights = [0.0; 4];
        match reader.terrain().corner_heights()? {
            Some(known) => corner_heights = known,
            None => {
                for (slot, corner) in corner_heights.iter_mut().zip(root.corners()) {
                    *slot = reader.height(grid.clamp(corner))?;
                }
            }
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
        let posts = self.toggled.capacity() * size_of::<Post>();
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

    /// Makes `posts` required beside those that already are. With its parents required, too, before it, where they are
    /// not.
    pub(super) fn require(&mut self, posts: &[Post]) -> Result<(), ReadError> {
        for &post in posts {
            let slot = self.nodes.slot(post).expect("required posts come after their parents");
            if !self.nodes.get(slot).active {
                self.split(slot)?;
            }
            self.nodes.get_mut(slot).required = true;
            self.nodes.put(slot, List::NONE);
        }
        Ok(())
    }

    /// Requires `posts` no longer.
    pub(super) fn release(&mut self, posts: &[Post]) {
        for &post in posts {
            if let Some(slot) = self.nodes.slot(post).filter(|&slot| self.nodes.get(slot).required) {
                self.nodes.get_mut(slot).required = false;
                self.offer_to_merge(slot);
            }
        }
    }

    /// Requires nothing any more.
    pub(super) fn release_all(&mut self) {
        let required: Vec<_> = self.nodes.active().filter(|node| node.required).map(|node| node.post).collect();
        self.release(&required);
    }

    /// Whether a triangle of the hierarchy is one of the mesh.
    pub(super) fn has(&self, triangle: &Triangle) -> bool {
        let is_active = |p: Post| self.height_of(p).is_some();
        is_active(triangle.apex) && !triangle.base_midpoint().is_some_and(is_active)
    }

    /// A test for whether an active post would be in the mesh as it stands if nothing required it: it comes before the
    /// first ready one. Conservative for posts of equal priority.
    pub(super) fn comes_before_the_cut(&mut self, threshold: f64) -> impl Fn(&Self, Post) -> bool + use<T> {
        let cut = self.first_ready().map_or(0.0, |place| place.priority()).max(threshold);
        move |queue, post| {
            queue.nodes.slot(post).is_some_and(|slot| {
                let (priority, _) = queue.priority(queue.nodes.get(slot), Planes::default());
                priority > 0.0 && priority >= cut
            })
        }
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
