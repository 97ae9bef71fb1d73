//! The wedgie bound of Duchaineau et al., "Good terrain geometry, cheap!", section 5: taken at a triangle's vertices only, and
//! said to be generally monotone. How low the first is, and how often the second does not hold.

use std::sync::Arc;

use sightline_proto::{
    diamond::{Post, Triangle},
    mesh::Mesh,
};

use super::{
    TradeError, quantile,
    world::{World, view},
};
use crate::{
    evaluate::flight::Preset,
    lod::LodView,
    roam::{self, ViewMesh},
    terrain::synthetic,
    wedgie::ErrorBounds,
};

/// Points along each side of a triangle at which its bound is sampled.
const SAMPLES: u32 = 8;
/// One in so many diamonds is looked at.
const DIAMONDS: u64 = 7;

/// The bound that the paper takes at vertices only.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Bounds {
    /// The greatest length anywhere along a triangle's sides over that at its vertices: the greatest, and the share of
    /// triangles above 1.01.
    pub(super) low_by: f64,
    pub(super) low_share: f64,
    /// Share of pairs of a diamond and a child in which the child has the greater thickness, and the greater bound.
    pub(super) thicker: f64,
    pub(super) greater: f64,
}

/// Looks at the triangles of a mesh in one view, and at diamonds all over the terrain.
pub(super) fn measure(world: &World) -> Result<Bounds, TradeError> {
    let view = view(&world.flight(Preset::Straight, 1, 1)?[0])?;
    let up_m = world.scale().up_m;
    let tight_m = |p: Post| -> Result<f64, TradeError> { Ok(f64::from(world.terrain.bounds(p)?.tight) * up_m) };
    let mut mesh = ViewMesh::new(Arc::clone(&world.terrain), world.scale())?;
    mesh.update(view.camera(), roam::Target::TriangleBudget(10_000), &[])?;
    let mut triangles = Vec::new();
    mesh.for_each_triangle(|t| triangles.push(t));
    let mut ratios = Vec::new();
    for t in triangles {
        let Some(m) = t.base_midpoint() else { continue };
        if let Some([corners, sides]) = lengths_px(world, &view, t, tight_m(m)?).filter(|l| l[0] > 0.0) {
            ratios.push(sides / corners);
        }
    }
    let [thicker, greater] = not_monotone(world, &view)?;
    let low = ratios.iter().filter(|&&ratio| ratio > 1.01).count();
    let low_by = quantile(&ratios, 1.0);
    Ok(Bounds { low_by, low_share: low as f64 / ratios.len().max(1) as f64, thicker, greater })
}

/// The greatest length in pixels of a thickness up or down from a point; nothing nearer than the near plane.
fn length_px(view: &LodView, p: glam::DVec3, thickness_m: f64) -> Option<f64> {
    let middle = view.project(p)?;
    let mut worst = 0.0_f64;
    for end in [p - glam::DVec3::Z * thickness_m, p + glam::DVec3::Z * thickness_m] {
        let end = view.project(end)?;
        let (dx, dy) = (end[0] - middle[0], end[1] - middle[1]);
        worst = worst.max((dx * dx + dy * dy).sqrt());
    }
    Some(worst)
}

/// The greatest such length at a triangle's corners, and along its sides.
fn lengths_px(world: &World, view: &LodView, t: Triangle, thickness_m: f64) -> Option<[f64; 2]> {
    let corners = t.corners().map(|p| world.ground.scene(p.i, p.j));
    let mut found = [0.0_f64; 2];
    for k in 0..3 {
        let (from, to) = (corners[k], corners[(k + 1) % 3]);
        found[0] = found[0].max(length_px(view, from, thickness_m)?);
        for n in 0..SAMPLES {
            let p = from + (to - from) * (f64::from(n) / f64::from(SAMPLES));
            found[1] = found[1].max(length_px(view, p, thickness_m)?);
        }
    }
    Some(found)
}

/// The shares of pairs of a diamond and its child in which the child exceeds its parent: in thickness, and in the bound
/// at vertices.
fn not_monotone(world: &World, view: &LodView) -> Result<[f64; 2], TradeError> {
    let (root, up_m) = (world.ground.grid().root(), world.scale().up_m);
    let look = |p: Post| -> Result<(f64, Option<f64>), TradeError> {
        let thickness = f64::from(world.terrain.bounds(p)?.tight);
        let mut bound = Some(0.0_f64);
        for t in root.triangles(p) {
            let of_triangle = t.corners().map(|p| length_px(view, world.ground.scene(p.i, p.j), thickness * up_m));
            bound = of_triangle.into_iter().fold(bound, |worst, length| Some(worst?.max(length?)));
        }
        Ok((thickness, bound))
    };
    let (mut pairs, mut more) = ([0.0; 2], [0.0; 2]);
    let grid = world.ground.grid();
    for j in (0..grid.ny()).step_by(2) {
        for i in (0..grid.nx()).step_by(2) {
            let p = Post::new(i, j);
            let is_corner = root.corners().contains(&p);
            if is_corner || !synthetic::mix(p.key()).is_multiple_of(DIAMONDS) {
                continue;
            }
            let (thickness, bound) = look(p)?;
            for child in root.children(p) {
                let (inner, inner_bound) = look(child)?;
                pairs[0] += 1.0;
                more[0] += f64::from(u8::from(inner > thickness));
                if let (Some(outer), Some(inner)) = (bound, inner_bound) {
                    pairs[1] += 1.0;
                    more[1] += f64::from(u8::from(inner > outer));
                }
            }
        }
    }
    Ok([0, 1].map(|n| more[n] / f64::max(pairs[n], 1.0)))
}
