//! What refinement would read for another camera, without refining: for reading ahead of a view that moves.
//!
//! A [`Preview`] goes down the hierarchy from the centre of the root square, coarse diamonds first, and looks at the bounds
//! and the height of every post that the mesh of that camera would ask for if it ended at the same priority as the mesh that
//! the preview was taken from. It keeps no mesh, so it costs a fraction of one; what it leaves behind is what its terrain
//! keeps of what was read.

use std::{collections::VecDeque, sync::Arc};

use sightline_proto::diamond::Post;

use super::{Regions, Terrain, reader::Reader};
use crate::{
    terrain::{ReadError, SceneScale},
    view::{Camera, Planes},
};

/// A look at what a mesh for a camera would need.
#[derive(Debug)]
pub struct Preview<T> {
    reader: Reader<T>,
    camera: Camera,
    regions: Regions,
    /// The priority from which on a diamond is opened.
    cut: f64,
    /// How many more posts it looks at.
    posts_left: usize,
    /// The posts to look at, and the planes that the ball of the parent is clear of.
    waiting: VecDeque<(Post, Planes)>,
}

impl<T: Terrain> Preview<T> {
    /// A preview for `camera` of all that has at least the priority `cut`, and of at most so many posts.
    pub(super) fn new(
        terrain: Arc<T>,
        scale: SceneScale,
        camera: Camera,
        regions: Regions,
        cut: f64,
        posts: usize,
    ) -> Self {
        let side = terrain.grid().root().side();
        let centre = (side > 1).then(|| (Post::new(side / 2, side / 2), Planes::default()));
        Self {
            reader: Reader::new(terrain, scale),
            camera,
            regions,
            cut,
            posts_left: posts,
            waiting: centre.into_iter().collect(),
        }
    }

    /// Looks at some more posts; whether there are others.
    pub fn step(&mut self, posts: usize) -> Result<bool, ReadError> {
        let root = self.reader.grid().root();
        for _ in 0..posts.min(self.posts_left) {
            let Some((post, planes)) = self.waiting.pop_front() else { break };
            self.posts_left -= 1;
            let (priority, planes) = self.look(post, planes)?;
            if priority > 0.0 && priority >= self.cut {
                // From the first of its parents: the other one has no lower priority than the child, so where the child is
                // opened it is, too.
                let children = root.children(post).filter(|&child| root.parents(child).next() == Some(post));
                self.waiting.extend(children.map(|child| (child, planes)));
            }
        }
        Ok(self.posts_left > 0 && !self.waiting.is_empty())
    }

    /// The priority of a post's diamond, as the queues of a mesh compute it.
    fn look(&mut self, post: Post, planes: Planes) -> Result<(f64, Planes), ReadError> {
        let (z, bounds) = self.reader.read(post)?;
        let (thickness_m, centre, radius_m) = self.reader.ball(post, z, bounds.nested, bounds.radius_m);
        let (priority, planes) = self.camera.priority_within(planes, thickness_m, centre, radius_m);
        Ok((priority * self.regions.weight(centre, radius_m), planes))
    }
}

#[cfg(test)]
mod tests {
    use std::{
        collections::BTreeSet,
        sync::{Mutex, PoisonError},
    };

    use super::*;
    use crate::{
        roam::{Target, ViewMesh, tests},
        terrain::{Grid, HeightField, HeightPage, PageId},
        wedgie::{DiamondBounds, ErrorBounds, MemoryTerrain},
    };

    /// What was asked of a terrain: posts for their bounds, and pages of heights.
    type Asked = (BTreeSet<Post>, BTreeSet<PageId>);

    #[derive(Debug)]
    struct Watched {
        memory: Arc<MemoryTerrain>,
        asked: Mutex<Asked>,
    }

    impl Watched {
        fn of(memory: &Arc<MemoryTerrain>) -> Arc<Self> {
            Arc::new(Self { memory: Arc::clone(memory), asked: Mutex::default() })
        }

        fn take(&self) -> Asked {
            std::mem::take(&mut *self.asked.lock().unwrap_or_else(PoisonError::into_inner))
        }
    }

    impl HeightField for Watched {
        fn grid(&self) -> Grid {
            self.memory.grid()
        }

        fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
            self.asked.lock().unwrap_or_else(PoisonError::into_inner).1.insert(id);
            self.memory.page(id)
        }
    }

    impl ErrorBounds for Watched {
        fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError> {
            self.asked.lock().unwrap_or_else(PoisonError::into_inner).0.insert(p);
            self.memory.bounds(p)
        }
    }

    #[test]
    fn it_reads_all_that_a_mesh_of_its_camera_reads() {
        let memory = tests::terrain(300, 270, 5);
        let mut ended = 0;
        for seed in 0..24 {
            let (camera, budget) = (tests::camera(&memory, seed), 100 + 97 * seed as u32);
            let watched = Watched::of(&memory);
            let mut mesh = ViewMesh::new(Arc::clone(&watched), tests::SCALE).unwrap();
            // Beyond the corners, which a mesh reads when it is made.
            let (_, corners) = watched.take();
            mesh.update(&camera, Target::TriangleBudget(budget), &[]).unwrap();
            let needed = watched.take();
            let mut preview = mesh.preview(camera);
            let mut steps = 0;
            while preview.step(1).unwrap() {
                steps += 1;
            }
            ended += u32::from(preview.posts_left > 0);
            assert!(steps < 3 * budget, "it is bounded by the mesh");
            let read = watched.take();
            let left: Vec<_> = needed.0.difference(&read.0).collect();
            assert!(left.is_empty(), "{seed}: {left:?}");
            assert!(needed.1.difference(&read.1).all(|id| corners.contains(id)), "{seed}");
        }
        assert!(ended > 12, "most end by themselves: {ended}");
    }

    #[test]
    fn what_it_looks_at_is_bounded_wherever_it_looks() {
        let memory = tests::terrain(300, 270, 5);
        let mut mesh = ViewMesh::new(Arc::clone(&memory), tests::SCALE).unwrap();
        // All detail lies where the first camera does not look: from everywhere there is far more of it.
        mesh.update(&tests::camera(&memory, 1), Target::TriangleBudget(200), &[]).unwrap();
        let mut preview = mesh.preview(Camera::everywhere());
        let mut looked = 1;
        while preview.step(1).unwrap() {
            looked += 1;
            assert!(preview.waiting.len() <= 4 * looked);
        }
        assert!(looked <= 600, "{looked}");
        assert!(!preview.step(usize::MAX).unwrap());
    }
}
