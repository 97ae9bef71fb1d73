//! What makes a triangle wrong for a line, on the mesh and anywhere in the hierarchy.

use std::ops::ControlFlow;

use sightline_proto::{
    diamond::{Post, Triangle},
    verdict::{MeshVerdict, for_each_triangle_met, passes_above, passes_below, verdict_on_mesh},
};

use super::{
    Fidelity, RequiredLine,
    ground::{Ground, moved},
};
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
    pub(super) fn holds<T: Terrain>(self, mesh: &DualQueue<T>, line: &RequiredLine) -> Result<bool, ReadError> {
        match self {
            Self::Clear => Ok(verdict_on_mesh(mesh, line.a, line.b) == MeshVerdict::Visible),
            Self::Blocked => Ok(verdict_on_mesh(mesh, line.a, line.b) == MeshVerdict::Blocked),
            Self::Wedgie | Self::Profile => Ok(self.offenders(mesh, line, 1)?.is_empty()),
        }
    }

    /// The first triangles of the mesh, at most `limit`, that break the rule, which is not [`Rule::Blocked`].
    pub(super) fn offenders<T: Terrain>(
        self,
        mesh: &DualQueue<T>,
        line: &RequiredLine,
        limit: usize,
    ) -> Result<Vec<Triangle>, ReadError> {
        let (mut found, mut failure) = (Vec::new(), None);
        let _ = for_each_triangle_met(mesh, line.a, line.b, |triangle| {
            let tight = |p| mesh.tight(p);
            match self.breaks(&triangle, mesh.corners_in_space(&triangle), tight, line, mesh.grid_posts()) {
                Ok(false) => return ControlFlow::Continue(()),
                Ok(true) => found.push(triangle),
                Err(error) => failure = Some(error),
            }
            if failure.is_some() || found.len() >= limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        failure.map_or(Ok(found), Err)
    }

    /// Whether a triangle breaks the rule if it is one of the mesh, given, for [`Rule::Profile`], that the line meets it
    /// in plan. `corners` are its own, in space; `tight` gives the thickness of a diamond. Not for [`Rule::Blocked`].
    fn breaks(
        self,
        triangle: &Triangle,
        corners: [[f64; 3]; 3],
        tight: impl FnOnce(Post) -> Result<f32, ReadError>,
        line: &RequiredLine,
        grid: (u32, u32),
    ) -> Result<bool, ReadError> {
        Ok(match (self, triangle.base_midpoint()) {
            (Self::Clear, _) => passes_below(line.a, line.b, corners, grid),
            (Self::Wedgie, Some(middle)) => meets_wedgie(line.a, line.b, corners, tight(middle)?, grid),
            (Self::Profile, Some(_)) => true,
            (Self::Wedgie | Self::Profile, None) => false,
            (Self::Blocked, _) => unreachable!("a blocked line has no offending triangles"),
        })
    }

    /// The splits that an offending triangle needs, from itself downwards until no part of it breaks the rule. For
    /// [`Rule::Clear`] and [`Rule::Wedgie`].
    pub(super) fn splits_below<T: Terrain>(
        self,
        ground: &Ground<'_, T>,
        line: &RequiredLine,
        offender: Triangle,
    ) -> Result<Vec<Post>, ReadError> {
        let grid = (ground.grid().nx(), ground.grid().ny());
        let (mut splits, mut open) = (Vec::new(), vec![offender]);
        while let Some(triangle) = open.pop() {
            let Some(middle) = triangle.base_midpoint() else { continue };
            splits.push(middle);
            for child in triangle.children(middle) {
                let corners = ground.in_space(&child)?;
                if self.breaks(&child, corners, |p| Ok(ground.bounds(p)?.tight), line, grid)? {
                    open.push(child);
                }
            }
        }
        Ok(splits)
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
    let thickness = f64::from(thickness);
    let outward = |by: f64, step: fn(f64) -> f64| {
        moved(corners, by)
            .map(|plane| plane.map(|[x, y, z]| [x, y, step(z)]))
            .filter(|p| p.iter().all(|c| c[2].is_finite()))
    };
    match (outward(thickness, f64::next_up), outward(-thickness, f64::next_down)) {
        (Some(top), Some(bottom)) => passes_below(a, b, top, grid) && passes_above(a, b, bottom, grid),
        _ => true,
    }
}
