//! Sight lines as requirements on a mesh: what they ask, and whether a mesh gives it.
//!
//! Every question is put to exact predicates; a verdict is never decided by a rounded sum.

mod rule;

use sightline_proto::{mesh::Mesh, verdict::MeshVerdict};

use super::{Terrain, queues::DualQueue};
use crate::terrain::ReadError;

pub(super) use rule::Rule;

/// How much of the terrain's truth a sight line asks of a mesh.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Debug)]
pub enum Fidelity {
    /// The verdict on the mesh equals the verdict on the finest surface.
    #[default]
    Verdict,
    /// No unsplit triangle's wedgie is met by the line in space (Duchaineau et al., "Good terrain geometry, cheap!",
    /// section 8.5). A triangle without thickness has no wedgie: it is the surface.
    Wedgie,
    /// Every mesh triangle that the line meets in plan over the grid is at the finest level.
    Profile,
}

/// A sight line that a mesh must honour.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct RequiredLine {
    /// Names the line in reports; unique in a list.
    pub id: u64,
    /// The observer's end in the grid frame; finite.
    pub a: [f64; 3],
    /// The target's end in the grid frame; finite.
    pub b: [f64; 3],
    /// The verdict on the finest surface; `None` when it is unknown: then the line holds on every mesh.
    pub verdict: Option<MeshVerdict>,
    /// What is asked.
    pub fidelity: Fidelity,
    /// Lines are satisfied in order of priority, least first, then id.
    pub priority: u32,
}

/// Whether `line` holds on the mesh as it stands.
pub(super) fn holds<T: Terrain>(mesh: &DualQueue<T>, line: &RequiredLine) -> Result<bool, ReadError> {
    match Rule::of(line) {
        None => Ok(true),
        Some(rule) => rule.holds(mesh, line.a, line.b),
    }
}

impl<T: Terrain> Mesh for DualQueue<T> {
    fn root(&self) -> sightline_proto::diamond::RootSquare {
        self.grid().root()
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.grid().nx(), self.grid().ny())
    }

    fn height(&self, p: sightline_proto::diamond::Post) -> Option<f64> {
        self.height_of(p)
    }
}
