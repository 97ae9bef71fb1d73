//! What a client can tell of a sight line on its own mesh, beside its verdict.
//!
//! The verdict and the detail of fidelity PROFILE are told exactly. OBSTRUCTION is told by rounded numbers: the true place
//! comes rounded from the server, and the place on the mesh is computed here in f64; where the two are as far apart as
//! is allowed, to within that rounding, nothing is told. WEDGIE is about the thickness of triangles, which stays with the
//! server, so only a wrong verdict shows here: a mesh on which no wedgie is met has the right one.

use std::ops::ControlFlow;

use sightline_proto::{
    mesh::Mesh,
    v1,
    verdict::{MeshVerdict, for_each_triangle_above, for_each_triangle_met, verdict_on_mesh},
};

use crate::scene::StatedLine;

/// What a client can say of what a line asks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Judgement {
    /// It is so on this mesh.
    Holds,
    /// It is not.
    Fails,
    /// The verdict is right; the rest is not to be told from here.
    Untold,
}

/// Parts of a line that rounding may move a place by. A guess: a clearance is off by some 2^-50 of the heights, and that
/// moves the place by as much divided by the slope at which line and ground part; a line that parts from the ground at
/// less than a millionth would need more.
const ROUNDING: f64 = 1e-6;

/// Judges a line on a mesh whose grid has so many metres per post east and north and per height unit.
pub fn judge(mesh: &impl Mesh, metres: [f64; 3], line: &StatedLine) -> Judgement {
    let wanted = match line.verdict {
        v1::Verdict::Visible => MeshVerdict::Visible,
        v1::Verdict::Blocked => MeshVerdict::Blocked,
        v1::Verdict::Unknown | v1::Verdict::Unspecified => return Judgement::Holds,
    };
    let Some([a, b]) = line.ends else { return Judgement::Untold };
    let told = |holds: bool| if holds { Judgement::Holds } else { Judgement::Fails };
    if line.fidelity == v1::Fidelity::Profile {
        return told(!meets_coarse_triangle(mesh, a, b));
    }
    if verdict_on_mesh(mesh, a, b) != wanted {
        return Judgement::Fails;
    }
    match (line.fidelity, line.obstruction) {
        (v1::Fidelity::Obstruction, Some(wanted)) if line.verdict == v1::Verdict::Blocked => {
            let Some(found) = first_below(mesh, a, b) else { return Judgement::Fails };
            let part = |k: usize| (b[k] - a[k]) * metres[k];
            let length_m = (part(0) * part(0) + part(1) * part(1) + part(2) * part(2)).sqrt();
            let off_m = (found - wanted.first).abs() * length_m;
            let rounding_m = ROUNDING * length_m;
            match (off_m + rounding_m <= wanted.distance_m, off_m - rounding_m > wanted.distance_m) {
                (true, _) => Judgement::Holds,
                (_, true) => Judgement::Fails,
                _ => Judgement::Untold,
            }
        }
        (v1::Fidelity::Wedgie, _) => Judgement::Untold,
        _ => Judgement::Holds,
    }
}

/// Where the points of AB strictly below the mesh begin, as a part of AB, rounded; `None` exactly when there are none.
pub fn first_below(mesh: &impl Mesh, a: [f64; 3], b: [f64; 3]) -> Option<f64> {
    let mut first: Option<f64> = None;
    let _: ControlFlow<()> = for_each_triangle_above(mesh, &mesh.root().roots(), [a, b], |triangle| {
        let corners = triangle.corners().map(|p| [f64::from(p.i), f64::from(p.j), mesh.height(p).unwrap_or(0.0)]);
        let t = below_triangle(a, b, corners, mesh.grid_size());
        first = Some(first.map_or(t, |first| first.min(t)));
        ControlFlow::Continue(())
    });
    first
}

/// The same for one triangle, counter-clockwise, that AB passes strictly below over the grid.
fn below_triangle(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], grid: (u32, u32)) -> f64 {
    let [p, q, r] = corners;
    let side = |u: [f64; 3], v: [f64; 3], x: [f64; 3]| (v[0] - u[0]) * (x[1] - u[1]) - (v[1] - u[1]) * (x[0] - u[0]);
    let last = [f64::from(grid.0 - 1), f64::from(grid.1 - 1)];
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    // Keeps where a linear function with these values at A and B is not negative.
    let mut keep = |at_a: f64, at_b: f64| {
        if at_a < 0.0 && at_b > at_a {
            from = from.max(at_a / (at_a - at_b));
        } else if at_b < 0.0 && at_a > at_b {
            to = to.min(at_a / (at_a - at_b));
        }
    };
    for (u, v) in [(p, q), (q, r), (r, p)] {
        keep(side(u, v, a), side(u, v, b));
    }
    for k in 0..2 {
        keep(a[k], b[k]);
        keep(last[k] - a[k], last[k] - b[k]);
    }
    let to = to.max(from);
    // Height over the plane times the triangle's area twice, which is positive.
    let over = |x: [f64; 3]| side(p, q, r) * x[2] - side(q, r, x) * p[2] - side(r, p, x) * q[2] - side(p, q, x) * r[2];
    let (at_a, at_b) = (over(a), over(b));
    let (first, last) = (at_a + from * (at_b - at_a), at_a + to * (at_b - at_a));
    if first < 0.0 || first <= last { from } else { from + (to - from) * (first / (first - last)).clamp(0.0, 1.0) }
}

fn meets_coarse_triangle(mesh: &impl Mesh, a: [f64; 3], b: [f64; 3]) -> bool {
    let met = for_each_triangle_met(mesh, a, b, |triangle| match triangle.base_midpoint() {
        Some(_) => ControlFlow::Break(()),
        None => ControlFlow::Continue(()),
    });
    met.is_break()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{StatedObstruction, tests::flat};
    use sightline_proto::{diamond::Post, replica::Replica};

    /// Flat ground of 9 x 9 posts, 10 m apart, with some posts raised.
    fn mesh(raised: &[(u32, u32, i32)]) -> Replica {
        let replica = Replica::new(&flat()).unwrap();
        let posts = sightline_proto::mesh::closure(replica.root(), raised.iter().map(|&(i, j, _)| Post::new(i, j)));
        let height = |p: Post| raised.iter().find(|r| (r.0, r.1) == (p.i, p.j)).map_or(0, |r| r.2);
        let posts = posts.into_iter().filter(|&p| !replica.root().is_corner(p)).map(|p| (p, height(p)));
        replica.with_posts(posts, 1).unwrap()
    }

    const METRES: [f64; 3] = [10.0, 10.0, 1.0];

    fn line(fidelity: v1::Fidelity, verdict: v1::Verdict, obstruction: Option<(f64, f64)>) -> StatedLine {
        let obstruction = obstruction.map(|(first, distance_m)| StatedObstruction { first, distance_m });
        StatedLine { ends: Some([[0.0, 4.0, 5.0], [8.0, 4.0, 5.0]]), verdict, fidelity, obstruction }
    }

    #[test]
    fn an_obstruction_is_told_near_or_far_but_not_on_the_border() {
        use v1::{Fidelity::Obstruction, Verdict::Blocked};
        // A ridge 10 units high at x = 4: from x = 2 at height 0, so the line at 5 goes under at x = 3, three eighths.
        let mesh = mesh(&[(4, 4, 10), (2, 4, 0), (6, 4, 0)]);
        assert_eq!(first_below(&mesh, [0.0, 4.0, 5.0], [8.0, 4.0, 5.0]), Some(0.375));
        let judged = |first, distance_m| judge(&mesh, METRES, &line(Obstruction, Blocked, Some((first, distance_m))));
        // The line is 80 m long.
        assert_eq!(judged(0.375, 0.5), Judgement::Holds);
        assert_eq!(judged(0.25, 10.5), Judgement::Holds);
        assert_eq!(judged(0.25, 9.5), Judgement::Fails);
        assert_eq!(judged(0.25, 10.0), Judgement::Untold);
        // Where the line passes unknown ground first, its verdict is all.
        assert_eq!(judge(&mesh, METRES, &line(Obstruction, Blocked, None)), Judgement::Holds);
        assert_eq!(judge(&mesh, METRES, &line(Obstruction, v1::Verdict::Visible, None)), Judgement::Fails);
    }

    #[test]
    fn of_a_wedgie_only_a_wrong_verdict_is_told() {
        use v1::{Fidelity::Wedgie, Verdict};
        let mesh = mesh(&[(4, 4, 10)]);
        assert_eq!(judge(&mesh, METRES, &line(Wedgie, Verdict::Blocked, None)), Judgement::Untold);
        assert_eq!(judge(&mesh, METRES, &line(Wedgie, Verdict::Visible, None)), Judgement::Fails);
        assert_eq!(judge(&mesh, METRES, &line(Wedgie, Verdict::Unknown, None)), Judgement::Holds);
    }

    #[test]
    fn a_profile_is_told_by_its_triangles() {
        use v1::{Fidelity::Profile, Verdict::Blocked};
        let coarse = mesh(&[(4, 4, 10)]);
        assert_eq!(judge(&coarse, METRES, &line(Profile, Blocked, None)), Judgement::Fails);
        let all: Vec<_> = (0..9).flat_map(|i| (0..9).map(move |j| (i, j, i32::from(i == 4) * 9))).collect();
        let all: Vec<_> = all.into_iter().filter(|&(i, j, _)| (i != 0 && i != 8) || (j != 0 && j != 8)).collect();
        assert_eq!(judge(&mesh(&all), METRES, &line(Profile, Blocked, None)), Judgement::Holds);
    }
}
