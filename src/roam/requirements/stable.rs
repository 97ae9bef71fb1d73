//! Stable sets: splits after which a line is right on the mesh, whatever else is split.
//!
//! *Visible line.* Every post with a triangle T such that plane_T + thickness_T exceeds the line somewhere over T. The
//! unsplit triangles of a mesh that holds them do not, so neither do their planes. *Wedgie, profile*: every post with a
//! triangle that breaks the rule. *Blocked line.* For one point p of it below known ground, every post with a triangle T
//! over p with plane_T(p) - thickness_T <= z(p): the unsplit triangle over p is then above the line. Where p lies on an
//! edge, one finest triangle beside it is chosen, and only the triangles that contain that one count: the unsplit one
//! over p is among them, and the set is smaller. *Obstruction*: every post with a triangle T that, raised by thickness_T,
//! would obstruct the line too early, and every one with a T over the finest triangle of the true place that, lowered by
//! thickness_T, would not obstruct it near enough. The unsplit triangle over that place then does, itself.
//!
//! What a visible line needs on any mesh is in its set, and so is what a blocked one needs for that point. So the sets
//! need not be made to be relied on: while lines take no more than they need in this sense, a run of lines whose joint
//! set fits in a budget fits, too.

use sightline_proto::{
    diamond::{Post, Triangle},
    predicates::Sign,
    verdict::passes_below,
};

use super::{
    RequiredLine,
    ground::{Ground, moved},
    ledger::Ledger,
    rule::{Rule, thickness},
    witness::Witness,
};
use crate::{roam::Terrain, terrain::ReadError};

/// How many witnesses of a line, the deepest, its stable set may stand on. More of them make smaller sets and cost time.
pub(super) const MAX_STEADY: usize = 3;

/// Of the deepest witnesses of a blocked line, the one whose stable set, closed, has the fewest triangles; the first of several.
pub(super) fn steadiest<T: Terrain>(
    ground: &Ground<'_, T>,
    line: &RequiredLine,
    witnesses: &[Witness],
) -> Result<Option<Witness>, ReadError> {
    let mut least: Option<(u64, Witness)> = None;
    for witness in witnesses.iter().take(MAX_STEADY) {
        let mut closure = Ledger::new(ground.grid().root());
        witness_set(ground, line, witness)?.into_iter().for_each(|p| closure.add(p));
        if least.is_none_or(|(triangles, _)| closure.triangles() < triangles) {
            least = Some((closure.triangles(), *witness));
        }
    }
    Ok(least.map(|(_, witness)| witness))
}

/// The stable set of a blocked line for one witness, without ancestors.
pub(super) fn witness_set<T: Terrain>(
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

/// Of the stable set of a line with an obstruction, the triangles over the finest one of the true place, without ancestors.
pub(super) fn way_set<T: Terrain>(
    ground: &Ground<'_, T>,
    line: &RequiredLine,
    rule: &Rule,
    face: &Triangle,
) -> Result<Vec<Post>, ReadError> {
    let grid = (ground.grid().nx(), ground.grid().ny());
    let mut posts = Vec::new();
    for triangle in path(ground.grid().root().roots(), face) {
        let Some(middle) = triangle.base_midpoint() else { break };
        let bottom = moved(ground.in_space(&triangle)?, -f64::from(ground.bounds(middle)?.tight));
        if bottom.is_none_or(|corners| !rule.is_helped_by(corners, line, grid)) {
            posts.push(middle);
        }
    }
    Ok(posts)
}

/// Of the part of a line's stable set after which nothing is wrong for it, the posts that are found from the roots down
/// through posts of that part alone. None of [`Rule::Blocked`].
pub(super) fn part_of_clear_set<T: Terrain>(
    ground: &Ground<'_, T>,
    line: &RequiredLine,
    rule: &Rule,
) -> Result<Vec<Post>, ReadError> {
    let grid = (ground.grid().nx(), ground.grid().ny());
    let exceeds = |triangle: &Triangle| -> Result<bool, ReadError> {
        let corners = ground.in_space(triangle)?;
        let tight = thickness(ground, triangle)?;
        Ok(match rule {
            Rule::Blocked => false,
            Rule::Clear => moved(corners, tight.into()).is_none_or(|top| passes_below(line.a, line.b, top, grid)),
            Rule::Obstruction(_) => match moved(corners, tight.into()) {
                Some(top) => rule.breaks(triangle, top, || Ok(tight), line, grid)?,
                None => true,
            },
            Rule::Wedgie => rule.breaks(triangle, corners, || Ok(tight), line, grid)?,
            Rule::Profile | Rule::Ground => {
                let flat = corners.map(|[x, y, _]| [x, y, 1.0]);
                let low = |[x, y, _]: [f64; 3]| [x, y, 0.0];
                passes_below(low(line.a), low(line.b), flat, grid)
                    && rule.breaks(triangle, corners, || Ok(tight), line, grid)?
            }
        })
    };
    let mut posts = Vec::new();
    let mut open = Vec::from(ground.grid().root().roots());
    while let Some(triangle) = open.pop() {
        let Some(middle) = triangle.base_midpoint() else { continue };
        if exceeds(&triangle)? {
            posts.push(middle);
            open.extend(triangle.children(middle));
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
