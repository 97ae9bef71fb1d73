//! What makes a mesh triangle wrong for a line.

use std::ops::ControlFlow;

use sightline_proto::verdict::{MeshVerdict, for_each_triangle_met, passes_above, passes_below, verdict_on_mesh};

use super::{Fidelity, RequiredLine};
use crate::{
    roam::{Terrain, queues::DualQueue},
    terrain::ReadError,
};

/// What a line asks, told apart by how it is checked and satisfied.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::roam) enum Rule {
    /// A visible line: no met triangle rises above it.
    Clear,
    /// A blocked line: some met triangle rises above it.
    Blocked,
    /// No met triangle that can be split has the line in its wedgie.
    Wedgie,
    /// No met triangle can be split.
    Profile,
}

impl Rule {
    /// The rule of a line; `None` when it holds on every mesh.
    pub(in crate::roam) fn of(line: &RequiredLine) -> Option<Self> {
        let verdict = line.verdict?;
        Some(match (line.fidelity, verdict) {
            (Fidelity::Verdict, MeshVerdict::Visible) => Self::Clear,
            (Fidelity::Verdict, MeshVerdict::Blocked) => Self::Blocked,
            (Fidelity::Wedgie, _) => Self::Wedgie,
            (Fidelity::Profile, _) => Self::Profile,
        })
    }

    /// Whether the line AB holds on the mesh. Exact.
    pub(in crate::roam) fn holds<T: Terrain>(
        self,
        mesh: &DualQueue<T>,
        a: [f64; 3],
        b: [f64; 3],
    ) -> Result<bool, ReadError> {
        match self {
            Self::Clear => return Ok(verdict_on_mesh(mesh, a, b) == MeshVerdict::Visible),
            Self::Blocked => return Ok(verdict_on_mesh(mesh, a, b) == MeshVerdict::Blocked),
            Self::Wedgie | Self::Profile => {}
        }
        let mut failure = None;
        let flow = for_each_triangle_met(mesh, a, b, |triangle| {
            let Some(middle) = triangle.base_midpoint() else { return ControlFlow::Continue(()) };
            if self == Self::Profile {
                return ControlFlow::Break(());
            }
            let met = mesh
                .tight(middle)
                .map(|thickness| meets_wedgie(a, b, mesh.corners_in_space(&triangle), thickness, mesh.grid_posts()));
            match met {
                Ok(false) => ControlFlow::Continue(()),
                Ok(true) => ControlFlow::Break(()),
                Err(error) => {
                    failure = Some(error);
                    ControlFlow::Break(())
                }
            }
        });
        match failure {
            Some(error) => Err(error),
            None => Ok(flow.is_continue()),
        }
    }
}

/// Whether AB, over the closed triangle and the grid, comes within `thickness` of its plane.
///
/// The wedgie is taken with its top and bottom moved outward to the next f64, so that strict comparisons include
/// contact. What is linear over a chord and lies below the top somewhere and above the bottom somewhere is between them
/// somewhere.
pub(super) fn meets_wedgie(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], thickness: f32, grid: (u32, u32)) -> bool {
    if thickness <= 0.0 {
        return false;
    }
    let top = corners.map(|[x, y, z]| [x, y, (z + f64::from(thickness)).next_up()]);
    let bottom = corners.map(|[x, y, z]| [x, y, (z - f64::from(thickness)).next_down()]);
    if !top.iter().chain(&bottom).all(|corner| corner[2].is_finite()) {
        return true;
    }
    passes_below(a, b, top, grid) && passes_above(a, b, bottom, grid)
}
