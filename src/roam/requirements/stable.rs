//! Stable sets: splits after which a line is right on the mesh, whatever else is split.
//!
//! *Visible line.* Every post with a triangle T such that plane_T + thickness_T exceeds the line somewhere over T. The
//! unsplit triangles of a mesh that holds them do not, so neither do their planes. *Wedgie, profile*: every post with a
//! triangle that breaks the rule. *Blocked line.* For one point p of it below known ground, every post with a triangle T
//! over p with plane_T(p) - thickness_T <= z(p): the unsplit triangle over p is then above the line. Where p lies on an
//! edge, one finest triangle beside it is chosen, and only the triangles that contain that one count: the unsplit one
//! over p is among them, and the set is smaller.

use std::ops::ControlFlow;

use sightline_proto::{
    diamond::{Post, Triangle},
    predicates::Sign,
    verdict::{for_each_triangle_met, passes_above, passes_below},
};

use super::{
    RequiredLine,
    closure::Closure,
    ground::{Ground, moved},
    rule::{Rule, meets_wedgie},
    witness::Witness,
};
use crate::{roam::Terrain, terrain::ReadError};

/// The stable set of a line without ancestors. `witnesses` are those of a blocked line: the one is taken whose set,
/// closed, has the fewest triangles.
pub(super) fn stable_set<T: Terrain>(
    ground: &Ground<'_, T>,
    line: &RequiredLine,
    rule: Rule,
    witnesses: &[Witness],
) -> Result<Vec<Post>, ReadError> {
    match rule {
        Rule::Profile => profile_set(ground, line),
        Rule::Clear | Rule::Wedgie => band_set(ground, line, rule),
        Rule::Blocked => {
            let mut least: Option<(u64, Vec<Post>)> = None;
            for witness in witnesses {
                let posts = witness_set(ground, line, witness)?;
                let mut closure = Closure::new(ground.grid().root());
                posts.iter().for_each(|&p| closure.add(p));
                if least.as_ref().is_none_or(|(triangles, _)| closure.triangles() < *triangles) {
                    least = Some((closure.triangles(), posts));
                }
            }
            Ok(least.map_or(Vec::new(), |(_, posts)| posts))
        }
    }
}

/// The apexes of the finest triangles that the line meets: each is there when its parent is split.
pub(super) fn profile_set<T: Terrain>(ground: &Ground<'_, T>, line: &RequiredLine) -> Result<Vec<Post>, ReadError> {
    let mut posts = Vec::new();
    let _ = for_each_triangle_met(ground, line.a, line.b, |t| {
        posts.push(t.apex);
        ControlFlow::Continue(())
    });
    posts.sort_unstable();
    posts.dedup();
    ground.checked(posts)
}

/// Descends where the line may come near enough. Let t be the thickness and n the nested thickness of T. Over T the
/// surface lies within t of the plane, and a descendant's plane within n of the surface, its thickness being n at most:
/// where the line keeps t + 2n away from the plane on one side, no descendant counts.
fn band_set<T: Terrain>(ground: &Ground<'_, T>, line: &RequiredLine, rule: Rule) -> Result<Vec<Post>, ReadError> {
    let grid = (ground.grid().nx(), ground.grid().ny());
    let below = |corners, by| moved(corners, by).is_none_or(|plane| passes_below(line.a, line.b, plane, grid));
    let above = |corners, by: f64| moved(corners, -by).is_none_or(|plane| passes_above(line.a, line.b, plane, grid));
    let (mut posts, mut open) = (Vec::new(), ground.grid().root().roots().to_vec());
    while let Some(triangle) = open.pop() {
        let Some(middle) = triangle.base_midpoint() else { continue };
        let bounds = ground.bounds(middle)?;
        let corners = ground.in_space(&triangle)?;
        let tight = f64::from(bounds.tight);
        // A hair more than t + 2n, so that rounding and contact are on the safe side.
        let far = (tight + 2.0 * f64::from(bounds.nested)) * 1.000_001 + 1e-300;
        if !below(corners, far) || (rule == Rule::Wedgie && !above(corners, far)) {
            continue;
        }
        let counts = match rule {
            Rule::Wedgie => meets_wedgie(line.a, line.b, corners, bounds.tight, grid),
            _ => below(corners, tight),
        };
        if counts {
            posts.push(middle);
        }
        open.extend(triangle.children(middle));
    }
    posts.sort_unstable();
    posts.dedup();
    Ok(posts)
}

fn witness_set<T: Terrain>(
    ground: &Ground<'_, T>,
    line: &RequiredLine,
    witness: &Witness,
) -> Result<Vec<Post>, ReadError> {
    let mut posts = Vec::new();
    for triangle in path(ground.grid().root().roots(), &witness.face) {
        let Some(middle) = triangle.base_midpoint() else { break };
        let bottom = moved(ground.in_space(&triangle)?, -f64::from(ground.bounds(middle)?.tight));
        let near =
            bottom.is_none_or(|corners| witness.point.height_against_plane(line.a, line.b, corners) != Sign::Negative);
        if near {
            posts.push(middle);
        }
    }
    Ok(posts)
}

/// The triangles of the hierarchy that contain the finest triangle `face`, from its root to itself.
pub(super) fn path(roots: [Triangle; 2], face: &Triangle) -> impl Iterator<Item = Triangle> {
    // Three times the centre of gravity, which lies on no edge.
    let sum = face.corners().iter().fold((0, 0), |s, p| (s.0 + i64::from(p.i), s.1 + i64::from(p.j)));
    let contains = move |t: &Triangle| {
        let [p, q, r] = t.corners().map(|p| (i64::from(p.i), i64::from(p.j)));
        [(p, q), (q, r), (r, p)].iter().all(|&(u, v)| {
            let (x, y) = (sum.0 - 3 * u.0, sum.1 - 3 * u.1);
            // Sides are along an axis or a diagonal: their directions may be taken as signs.
            let (dx, dy) = ((v.0 - u.0).signum(), (v.1 - u.1).signum());
            dx * y - dy * x > 0
        })
    };
    std::iter::successors(roots.into_iter().find(contains), move |t| {
        let middle = t.base_midpoint()?;
        t.children(middle).into_iter().find(contains)
    })
}
