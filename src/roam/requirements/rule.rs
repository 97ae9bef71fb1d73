//! What a line asks of a mesh: what makes a triangle wrong for it, on the mesh and anywhere in the hierarchy.

use std::ops::ControlFlow;

use num_rational::BigRational;
use sightline_proto::{
    diamond::Triangle,
    mesh::Mesh,
    verdict::{
        MeshVerdict, for_each_triangle_above, for_each_triangle_met, passes_above, passes_below, verdict_on_mesh,
    },
};

use super::{
    Fidelity, RequiredLine,
    aim::{Aim, first_below},
    ground::{Ground, moved},
};
use crate::{
    roam::{Terrain, queues::DualQueue},
    terrain::ReadError,
};

/// What a line asks, told apart by how it is checked and satisfied.
#[derive(Clone, PartialEq, Debug)]
pub(in crate::roam) enum Rule {
    /// A visible line: no met triangle rises above it.
    Clear,
    /// A blocked line: some met triangle rises above it.
    Blocked,
    /// A blocked line: the first met triangle that rises above it does so near the true place.
    Obstruction(Box<Aim>),
    /// No met triangle that can be split has the line in its wedgie.
    Wedgie,
    /// No met triangle can be split.
    Profile,
    /// A vertical line from above: no triangle over or under it misses it.
    Ground,
}

impl Rule {
    /// The rule of a line; `None` when it holds on every mesh. `aim` gives that of a line with an obstruction, if it
    /// has one.
    pub(in crate::roam) fn of(
        line: &RequiredLine,
        aim: impl FnOnce(f64) -> Result<Option<Aim>, ReadError>,
    ) -> Result<Option<Self>, ReadError> {
        let Some(verdict) = line.verdict else { return Ok(None) };
        Ok(Some(match (line.fidelity, verdict) {
            (Fidelity::Ground, _) => Self::Ground,
            (Fidelity::Verdict | Fidelity::Obstruction { .. }, MeshVerdict::Visible) => Self::Clear,
            (Fidelity::Verdict, MeshVerdict::Blocked) => Self::Blocked,
            (Fidelity::Obstruction { distance_m }, MeshVerdict::Blocked) => {
                aim(distance_m)?.map_or(Self::Blocked, |aim| Self::Obstruction(Box::new(aim)))
            }
            (Fidelity::Wedgie, _) => Self::Wedgie,
            (Fidelity::Profile, _) => Self::Profile,
        }))
    }

    /// Whether the line AB holds on the mesh. Exact.
    pub(super) fn holds<T: Terrain>(&self, mesh: &DualQueue<T>, line: &RequiredLine) -> Result<bool, ReadError> {
        match self {
            Self::Clear => Ok(verdict_on_mesh(mesh, line.a, line.b) == MeshVerdict::Visible),
            Self::Blocked => Ok(verdict_on_mesh(mesh, line.a, line.b) == MeshVerdict::Blocked),
            Self::Obstruction(aim) => Ok(first_on(mesh, line).is_some_and(|t| aim.is_near(&t))),
            Self::Wedgie | Self::Profile | Self::Ground => {
                let mut found = Ok(false);
                let _ = for_each_triangle_met(mesh, line.a, line.b, |triangle| {
                    let tight = || triangle.base_midpoint().map_or(Ok(0.0), |middle| mesh.tight(middle));
                    found = self.breaks(&triangle, mesh.corners_in_space(&triangle), tight, line, mesh.grid_posts());
                    if matches!(found, Ok(false)) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
                });
                found.map(|found| !found)
            }
        }
    }

    /// Whether a triangle breaks the rule if it is one of the mesh, given, for [`Rule::Profile`], that the line meets it
    /// in plan. `corners` are its own, in space; `tight` gives the thickness of its diamond. Never for [`Rule::Blocked`],
    /// for which no triangle is wrong.
    pub(super) fn breaks(
        &self,
        triangle: &Triangle,
        corners: [[f64; 3]; 3],
        tight: impl FnOnce() -> Result<f32, ReadError>,
        line: &RequiredLine,
        grid: (u32, u32),
    ) -> Result<bool, ReadError> {
        let can_be_split = triangle.base_midpoint().is_some();
        Ok(match self {
            Self::Clear => passes_below(line.a, line.b, corners, grid),
            Self::Blocked => false,
            Self::Obstruction(aim) => {
                passes_below(line.a, line.b, corners, grid)
                    && first_below(line.a, line.b, corners, grid).is_some_and(|t| aim.is_early(&t))
            }
            Self::Wedgie => can_be_split && meets_wedgie(line.a, line.b, corners, tight()?, grid),
            Self::Profile => can_be_split,
            Self::Ground => passes_below(line.a, line.a, corners, grid) || passes_above(line.b, line.b, corners, grid),
        })
    }

    /// Whether a triangle of the mesh makes the line hold: for [`Rule::Blocked`], and for [`Rule::Obstruction`] if none
    /// breaks it. Others hold where nothing is wrong.
    pub(super) fn is_helped_by(&self, corners: [[f64; 3]; 3], line: &RequiredLine, grid: (u32, u32)) -> bool {
        match self {
            Self::Blocked => passes_below(line.a, line.b, corners, grid),
            Self::Obstruction(aim) => {
                passes_below(line.a, line.b, corners, grid)
                    && first_below(line.a, line.b, corners, grid).is_some_and(|t| aim.is_near(&t))
            }
            Self::Clear | Self::Wedgie | Self::Profile | Self::Ground => true,
        }
    }
}

/// The infimum of the points of the line strictly below the mesh, as a part of AB.
pub(super) fn first_on(mesh: &impl Mesh, line: &RequiredLine) -> Option<BigRational> {
    let mut first: Option<BigRational> = None;
    let _ = for_each_triangle_above(mesh, &mesh.root().roots(), [line.a, line.b], |triangle| {
        let corners = triangle.corners().map(|p| [f64::from(p.i), f64::from(p.j), mesh.height(p).unwrap_or(0.0)]);
        let found = first_below(line.a, line.b, corners, mesh.grid_size());
        first = first.take().into_iter().chain(found).min();
        ControlFlow::Continue(())
    });
    first
}

/// The thickness of a triangle's diamond, if it has one.
pub(super) fn thickness<T: Terrain>(ground: &Ground<'_, T>, triangle: &Triangle) -> Result<f32, ReadError> {
    triangle.base_midpoint().map_or(Ok(0.0), |middle| Ok(ground.bounds(middle)?.tight))
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
