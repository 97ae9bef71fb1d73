//! Where a blocked line is below known ground: the places at which a mesh may block it.

use sightline_proto::{
    diamond::{Post, Triangle},
    verdict::LinePoint,
};

use super::{RequiredLine, ground::Ground};
use crate::{
    los::{self, LosError},
    roam::Terrain,
    terrain::ReadError,
};

/// At most so many witnesses are tried of a line, the deepest. A guess; more find cheaper splits and cost time.
const MAX_TRIED: usize = 12;

/// A point of a line strictly below known ground.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Witness {
    pub(super) point: LinePoint,
    /// A finest triangle that the point lies over.
    pub(super) face: Triangle,
}

/// Witnesses of a line, deepest first; none when it is not blocked.
pub(super) fn witnesses<T: Terrain>(ground: &Ground<'_, T>, line: &RequiredLine) -> Result<Vec<Witness>, ReadError> {
    let found = match los::witnesses(ground.terrain(), line.a, line.b) {
        Ok(found) => found,
        Err(LosError::Read(error)) => return Err(error),
        // Ends that are no numbers have no witnesses: the line is never satisfied, and so named.
        Err(_) => Vec::new(),
    };
    let point = found.into_iter().map(|witness| witness.point).take(MAX_TRIED);
    Ok(point.filter_map(|point| Some(Witness { point, face: face_of(ground, line, point)? })).collect())
}

/// The same, looked up in `known` if they were found before, and kept there.
pub(super) fn find<T: Terrain>(
    ground: &Ground<'_, T>,
    line: &RequiredLine,
    known: &mut Option<Vec<Witness>>,
) -> Result<Vec<Witness>, ReadError> {
    let found = match known.take() {
        Some(found) => found,
        None => witnesses(ground, line)?,
    };
    Ok(known.insert(found).clone())
}

/// A finest triangle that holds `point`, found from the roots down.
fn face_of<T: Terrain>(ground: &Ground<'_, T>, line: &RequiredLine, point: LinePoint) -> Option<Triangle> {
    let holds = |t: &Triangle| match point {
        LinePoint::A | LinePoint::B => point.in_triangle(line.a, line.b, t),
        // The point is on the edge between the two, which is one of the finest triangulation: the triangle holds both.
        LinePoint::Crossing(p, q) => contains(t, p) && contains(t, q),
    };
    let mut triangle = ground.grid().root().roots().into_iter().find(holds)?;
    while let Some(middle) = triangle.base_midpoint() {
        triangle = triangle.children(middle).into_iter().find(holds)?;
    }
    Some(triangle)
}

/// Whether post `p` lies in the closed triangle.
fn contains(t: &Triangle, p: Post) -> bool {
    let at = |p: Post| (i64::from(p.i), i64::from(p.j));
    let [a, b, c] = t.corners().map(at);
    [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| {
        // Sides are along an axis or a diagonal: their directions may be taken as signs.
        let (dx, dy) = ((v.0 - u.0).signum(), (v.1 - u.1).signum());
        dx * (at(p).1 - u.1) - dy * (at(p).0 - u.0) >= 0
    })
}
