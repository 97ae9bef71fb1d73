//! The mesh of one view: a pure function of terrain, camera and target without sight lines; with them, of all updates since
//! the view was opened.

use std::sync::Arc;

use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
};

use super::{
    MeshError, Options, Preview, RequiredLine, Target, Terrain, Work,
    queues::{Allowance, DualQueue},
    requirements::{Outcome, Requirements},
};
use crate::{
    terrain::{ReadError, SceneScale},
    view::Camera,
};

/// What one update delivered.
#[derive(Clone, PartialEq, Default, Debug)]
pub struct MeshReport {
    /// Triangles of the mesh, never more than the target allows.
    pub triangles: u32,
    /// No point of the finest surface in the picture is drawn further off than this, in pixels (metres for a camera
    /// without an eye); may be infinite.
    pub bound_px: f64,
    /// Posts that became active with this update, in order.
    pub added: Vec<Post>,
    /// Posts that ceased to be, in order.
    pub removed: Vec<Post>,
    /// Ids of the lines that do not hold on this mesh, ascending: exactly those.
    pub unsatisfied: Vec<u64>,
    /// For each of them, the triangles that it asked for in addition to those of the lines before it, when it was given
    /// up. 0 for a line that no mesh can help.
    pub lacking: Vec<u32>,
    /// Ids of the lines of fidelity GROUND that do not hold on this mesh, ascending: exactly those. They are not among
    /// `unsatisfied`.
    pub off_ground: Vec<u64>,
    /// Triangles of the posts that the lines require; the plain mesh may have some of them, too.
    pub required: u32,
    /// What it took.
    pub work: Work,
}

/// The mesh of one view. Memory is proportional to the mesh, never to the terrain.
#[derive(Debug)]
pub struct ViewMesh<T> {
    queue: DualQueue<T>,
    options: Options,
    requirements: Requirements,
    /// What the mesh was made for; `None` before the first update and after a failed one.
    made_for: Option<(Camera, Target, Vec<RequiredLine>)>,
    report: MeshReport,
}

impl<T: Terrain> ViewMesh<T> {
    /// A mesh of two triangles over `terrain`, whose grid has the `scale`.
    pub fn new(terrain: Arc<T>, scale: SceneScale) -> Result<Self, ReadError> {
        let queue = DualQueue::new(terrain, scale)?;
        let (requirements, report) = (Requirements::new(queue.grid()), MeshReport::default());
        Ok(Self { queue, options: Options::default(), requirements, made_for: None, report })
    }

    /// The terrain.
    pub fn terrain(&self) -> &Arc<T> {
        self.queue.terrain()
    }

    /// Metres per post and per height unit.
    pub fn scale(&self) -> SceneScale {
        self.queue.scale()
    }

    /// How the mesh is refined from the next update on.
    pub fn set_options(&mut self, options: Options) {
        if options != self.options {
            (self.options, self.made_for) = (options, None);
        }
    }

    /// Makes the mesh what `camera`, `target` and `lines` ask for. Ids are unique; the order of the lines is their
    /// own.
    ///
    /// Without lines the result depends on the arguments and the terrain alone, not on earlier updates, whether they
    /// succeeded or not; only the cost does. What lines require is kept from update to update, so with lines the same
    /// sequence of updates gives the same meshes, and the same update twice changes nothing.
    pub fn update(&mut self, camera: &Camera, target: Target, lines: &[RequiredLine]) -> Result<MeshReport, MeshError> {
        let (max, threshold) = target.limits()?;
        self.queue.begin(&self.options);
        let unchanged = matches!(&self.made_for, Some((c, t, l)) if c == camera && *t == target && l == lines);
        if !unchanged {
            self.made_for = None;
            let limits = Allowance { max, threshold };
            self.queue.look(camera)?;
            let Outcome { unsatisfied, off_ground, required } =
                self.requirements.satisfy(&mut self.queue, limits, lines)?;
            (self.report.unsatisfied, self.report.lacking) = unsatisfied.into_iter().unzip();
            (self.report.off_ground, self.report.required) = (off_ground, required);
            self.report.bound_px = self.queue.bound();
            self.queue.settle(threshold);
            // Cut short, the mesh is not yet what was asked for.
            self.made_for = (!self.queue.is_cut_short()).then(|| (*camera, target, lines.to_vec()));
        }
        self.report.triangles = u32::try_from(self.queue.triangles()).unwrap_or(u32::MAX);
        (self.report.added, self.report.removed) = self.queue.take_changes();
        self.report.work = self.queue.work;
        Ok(self.report.clone())
    }

    /// A look at what another camera would need, with this mesh's options, down to the priority at which this mesh ends.
    pub fn preview(&self, camera: Camera) -> Preview<T> {
        let (terrain, regions) = (Arc::clone(self.terrain()), self.options.regions.clone());
        // A mesh looks at one and a half posts for each of its triangles. For another camera it may be more: let it be twice
        // that.
        let posts = 3 * self.queue.triangles() as usize;
        Preview::new(terrain, self.scale(), camera, regions, self.queue.end(), posts)
    }

    /// How many posts are held in memory: the active ones and those that could be split next.
    pub fn posts_held(&self) -> usize {
        self.queue.posts_held()
    }

    /// Triangles of the posts that this mesh has and `plain` lacks: stolen by lines, if that is the mesh of the same
    /// view and budget without any.
    pub fn stolen_from(&self, plain: &Self) -> u64 {
        let root = self.root();
        let lacked = self.queue.active().filter(|&(p, _)| plain.height(p).is_none());
        lacked.map(|(p, _)| root.triangles(p).count() as u64).sum()
    }

    /// Checks what the queues take for granted.
    #[cfg(test)]
    pub(super) fn check(&self) {
        self.queue.check();
    }

    /// Bytes of memory held for the mesh and its queues, without what is known of lines.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + self.queue.bytes()
    }

    /// The active posts that are no corners, with their heights, by row and column.
    pub fn active_posts(&self) -> Vec<(Post, f64)> {
        let mut posts: Vec<_> = self.queue.active().collect();
        posts.sort_unstable_by_key(|&(p, _)| p);
        posts
    }
}

impl<T: Terrain> Mesh for ViewMesh<T> {
    fn root(&self) -> RootSquare {
        self.queue.grid().root()
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.queue.grid().nx(), self.queue.grid().ny())
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.queue.height_of(p)
    }
}
