//! Sight lines as requirements on a mesh: the splits that make them right, and a name for each that is not.
//!
//! Follows Duchaineau et al., "Good terrain geometry, cheap!", section 8.5, in lifting the priority of triangles that
//! matter to a line. It departs in lifting as few as it can: a visible line needs a split only where a mesh triangle's
//! chord rises above it, a blocked one a single place where the mesh still blocks it; the paper refines fully wherever
//! a line meets a wedgie, which is the fidelity [`Fidelity::Wedgie`] here.
//!
//! Every question about a line is put to exact predicates; a verdict is never decided by a rounded sum. What is
//! required is state of the view: kept from update to update, checked again where lines or triangles changed, and given
//! up where it is no longer needed. The same sequence of updates gives the same meshes, bit for bit.

mod aim;
mod draft;
mod engine;
mod entry;
mod ground;
mod ledger;
mod near;
mod room;
mod rule;
mod stable;
mod witness;

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use sightline_proto::verdict::MeshVerdict;

use crate::{
    los::{self, LosError},
    terrain::HeightField,
};

pub(super) use engine::{Outcome, Requirements};

/// How much of the terrain's truth a sight line asks of a mesh.
#[derive(Clone, Copy, PartialEq, Default, Debug, Serialize, Deserialize)]
pub enum Fidelity {
    /// The verdict on the mesh equals the verdict on the finest surface.
    #[default]
    Verdict,
    /// Also, for a blocked line, the first obstruction from A on the mesh lies near the true one. Where AB passes an
    /// unknown point before it is blocked, and for a visible line, the same as [`Fidelity::Verdict`].
    Obstruction {
        /// How far off it may be along AB, in metres in the scene frame: finite and not negative.
        distance_m: f64,
    },
    /// No unsplit triangle's wedgie is met by the line in space (Duchaineau et al., "Good terrain geometry, cheap!",
    /// section 8.5). A triangle without thickness has no wedgie: it is the surface.
    Wedgie,
    /// Every mesh triangle that the line meets in plan over the grid is at the finest level.
    Profile,
    /// For a vertical line with A on top: the mesh passes neither above A nor below B. So an entity is not buried and does
    /// not float. The verdict does not count, but that there is one.
    Ground,
}

/// A sight line that a mesh must honour.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct RequiredLine {
    /// Names the line in reports; unique in a list among those of fidelity GROUND, and among all others.
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

impl RequiredLine {
    /// What an entity asks: that the mesh pass between two points above each other. It comes after all lines of other
    /// priorities.
    pub fn of_ground(id: u64, [upper, lower]: [[f64; 3]; 2]) -> Self {
        let (verdict, fidelity) = (Some(MeshVerdict::Visible), Fidelity::Ground);
        Self { id, a: upper, b: lower, verdict, fidelity, priority: u32::MAX }
    }

    /// The place in the order in which lines are satisfied.
    fn place(&self) -> (u32, bool, u64) {
        (self.priority, self.fidelity == Fidelity::Ground, self.id)
    }

    /// What a view asks for itself: that an eye in the open, in the grid frame, be not under its own mesh. It comes
    /// after all lines of other priorities, so that it takes no triangles from them. `None` for an eye that is below
    /// the finest surface or over unknown ground.
    pub fn of_eye<H>(field: &H, id: u64, eye: [f64; 3]) -> Result<Option<Self>, LosError>
    where
        H: HeightField + ?Sized,
    {
        let verdict = los::line_of_sight(field, eye, eye, los::Options::default())?.verdict;
        let line =
            Self { id, a: eye, b: eye, verdict: verdict.on_mesh(), fidelity: Fidelity::Verdict, priority: u32::MAX };
        Ok((verdict == los::Verdict::Visible).then_some(line))
    }
}
