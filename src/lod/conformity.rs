//! Whether a mesh covers each plan point of its rectangle once, and where it cracks.
//!
//! The check is exact, in integers. When every triangle turns counter-clockwise, the number of triangles over a point is
//! the winding number around it of all their borders together. So the mesh covers its rectangle once, and nothing else,
//! exactly when those borders cancel except along the border of the rectangle. Edges are grouped by the line on which
//! they lie and swept along it; they need not have equal ends to cancel, so T-junctions do not disturb the proof.
//!
//! A *T-junction* is a vertex strictly inside another triangle's edge. Where its height is not that of the edge there,
//! the surface is torn: a crack, of that gap.

use std::fmt;

use super::mesh::{IndexedMesh, Vertex};

/// What a check found in a mesh that covers its rectangle once.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Conformity {
    /// Vertices strictly inside the edge of a triangle.
    pub t_junctions: usize,
    /// The greatest height of a crack at one of them, in height units.
    pub gap_max: f64,
}

/// Why a mesh is none.
#[derive(Clone, PartialEq, Debug)]
pub enum NotOnce {
    /// A triangle turns clockwise or has no area.
    Turned([Vertex; 3]),
    /// Along a line through `from` towards `to`, borders do not cancel: more or fewer triangles than one lie beside it.
    Uncovered {
        /// One end of the part where they do not.
        from: [i64; 2],
        /// The other.
        to: [i64; 2],
    },
}

impl fmt::Display for NotOnce {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Turned(t) => write!(f, "the triangle {t:?} does not turn counter-clockwise"),
            Self::Uncovered { from, to } => write!(f, "from {from:?} to {to:?} the borders of triangles do not cancel"),
        }
    }
}

/// A line in plan: its direction in lowest terms, the first coordinate that is not zero positive, and its offset.
type Line = ([i64; 2], i64);

/// A directed edge on a line, as the interval of positions that it covers.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Stretch {
    line: Line,
    /// Along the line, in units of its direction.
    from: i64,
    to: i64,
    /// 1 when the edge runs along the direction of the line, else -1.
    turn: i32,
    /// Heights at `from` and `to`; none for the border of the rectangle.
    z: Option<[f64; 2]>,
}

/// Checks that `mesh` covers its rectangle once.
pub fn check(mesh: &IndexedMesh) -> Result<Conformity, NotOnce> {
    let mut stretches = Vec::with_capacity(3 * mesh.len() + 4);
    for t in mesh.iter() {
        let [a, b, c] = t.map(|v| [i64::from(v.post.i), i64::from(v.post.j)]);
        if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0 {
            return Err(NotOnce::Turned(t));
        }
        for (p, q, zp, zq) in [(a, b, t[0].z, t[1].z), (b, c, t[1].z, t[2].z), (c, a, t[2].z, t[0].z)] {
            stretches.push(stretch(p, q, Some([zp, zq])));
        }
    }
    let [w, h] = mesh.extent.map(i64::from);
    // The border against the turn of the triangles, so that all of it cancels.
    for (p, q) in [([0, 0], [0, h]), ([0, h], [w, h]), ([w, h], [w, 0]), ([w, 0], [0, 0])] {
        stretches.push(stretch(p, q, None));
    }
    stretches.sort_by_key(|s| (s.line, s.from, s.to, s.turn));
    let mut found = Conformity::default();
    for group in stretches.chunk_by(|a, b| a.line == b.line) {
        cancel(group)?;
        junctions(group, &mut found);
    }
    Ok(found)
}

fn stretch(p: [i64; 2], q: [i64; 2], z: Option<[f64; 2]>) -> Stretch {
    let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
    let unit = gcd(dx.abs(), dy.abs());
    let sign = if dx > 0 || (dx == 0 && dy > 0) { 1 } else { -1 };
    let d = [sign * dx / unit, sign * dy / unit];
    let along = |v: [i64; 2]| if d[0] != 0 { v[0].div_euclid(d[0]) } else { v[1] };
    let line = (d, d[0] * p[1] - d[1] * p[0]);
    let (from, to, z) = if sign > 0 { (p, q, z) } else { (q, p, z.map(|[a, b]| [b, a])) };
    Stretch { line, from: along(from), to: along(to), turn: sign as i32, z }
}

fn gcd(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Whether the stretches of one line, sorted by their start, cancel everywhere.
fn cancel(group: &[Stretch]) -> Result<(), NotOnce> {
    let mut events: Vec<(i64, i32)> = group.iter().flat_map(|s| [(s.from, s.turn), (s.to, -s.turn)]).collect();
    events.sort_unstable();
    let mut level = 0;
    for (n, &(at, change)) in events.iter().enumerate() {
        level += change;
        let next = events.get(n + 1).map_or(at, |e| e.0);
        if level != 0 && next != at {
            let (d, offset) = group[0].line;
            return Err(NotOnce::Uncovered { from: place(d, offset, at), to: place(d, offset, next) });
        }
    }
    Ok(())
}

/// The point of a line at a position.
fn place(d: [i64; 2], offset: i64, at: i64) -> [i64; 2] {
    if d[0] == 0 {
        return [-offset, at];
    }
    // The post with x = at * dx + rest, 0 <= rest < dx, for which dx * y - dy * x is the offset.
    let x = (0..d[0]).map(|rest| at * d[0] + rest).find(|x| (offset + d[1] * x) % d[0] == 0).unwrap_or(at * d[0]);
    [x, (offset + d[1] * x).div_euclid(d[0])]
}

/// Counts the ends of stretches that lie strictly inside others of the same line.
fn junctions(group: &[Stretch], found: &mut Conformity) {
    let mut ends: Vec<(i64, f64)> =
        group.iter().filter_map(|s| s.z.map(|z| [(s.from, z[0]), (s.to, z[1])])).flatten().collect();
    ends.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    ends.dedup_by_key(|e| e.0);
    let mut inside = vec![false; ends.len()];
    for s in group {
        let Some([z0, z1]) = s.z else { continue };
        let first = ends.partition_point(|e| e.0 <= s.from);
        for (n, &(at, z)) in ends.iter().enumerate().skip(first).take_while(|(_, e)| e.0 < s.to) {
            inside[n] = true;
            let part = (at - s.from) as f64 / (s.to - s.from) as f64;
            found.gap_max = found.gap_max.max((z - (z0 + part * (z1 - z0))).abs());
        }
    }
    found.t_junctions += inside.iter().filter(|&&i| i).count();
}
