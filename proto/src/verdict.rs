//! The line of sight on a mesh, exactly, and the questions about single triangles from which it is made.
//!
//! The verdict on a mesh is BLOCKED when some point of the closed segment AB over the grid rectangle
//! [0, nx-1] x [0, ny-1] lies strictly below the mesh, else VISIBLE. It is written against a walk over the triangles
//! that a plan line meets ([`for_each_triangle_met`]). On one triangle both the line and the mesh are linear, so the
//! ends of the chord decide. A chord's ends are ends of AB or crossings of AB with edges; nothing is ever computed
//! *at* a crossing in rounded numbers: its height over a plane is the sign of a determinant ([`crate::predicates`]).
//!
//! Triangles that reach into the padding are cut at the border of the grid. Their edges run along x, y or a diagonal
//! between posts, so the cut polygon has posts as corners too, and the cut is exact in integers.

use std::ops::ControlFlow;

use crate::{
    diamond::{Post, Triangle},
    mesh::Mesh,
    predicates::{
        Exact, Kernel, Sign, compare, height_of_crossing, orient2d_with, orient3d, orient3d_with, plan,
        side_of_crossing,
    },
};

/// The verdict on a mesh: it has no unknown points.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum MeshVerdict {
    /// No point of the line over the grid is strictly below the mesh.
    Visible,
    /// Some point is.
    Blocked,
}

/// The verdict of AB on `mesh`. Ends are finite, in the grid frame. Exact and symmetric in A and B.
pub fn verdict_on_mesh(mesh: &impl Mesh, a: [f64; 3], b: [f64; 3]) -> MeshVerdict {
    verdict_on_mesh_with::<Exact, _>(mesh, a, b)
}

/// [`verdict_on_mesh`] with the rungs of `K`.
pub fn verdict_on_mesh_with<K: Kernel, M: Mesh>(mesh: &M, a: [f64; 3], b: [f64; 3]) -> MeshVerdict {
    let blocked = for_each_triangle_above_with::<K>(mesh, &mesh.root().roots(), [a, b], |_| ControlFlow::Break(()));
    if blocked.is_break() { MeshVerdict::Blocked } else { MeshVerdict::Visible }
}

/// Calls `visit` with each triangle of `mesh` that AB passes strictly below over the grid, among the parts of the
/// triangles `from`, which are of the mesh or above it in the hierarchy: in depth-first order from each, until `visit`
/// breaks. Exact.
pub fn for_each_triangle_above(
    mesh: &impl Mesh,
    from: &[Triangle],
    [a, b]: [[f64; 3]; 2],
    visit: impl FnMut(Triangle) -> ControlFlow<()>,
) -> ControlFlow<()> {
    for_each_triangle_above_with::<Exact>(mesh, from, [a, b], visit)
}

fn for_each_triangle_above_with<K: Kernel>(
    mesh: &impl Mesh,
    from: &[Triangle],
    line: [[f64; 3]; 2],
    mut visit: impl FnMut(Triangle) -> ControlFlow<()>,
) -> ControlFlow<()> {
    let walk = Walk { mesh, line, grid: mesh.grid_size() };
    walk.candidates::<K>(from, &mut |triangle, sides| {
        let passes = corners(mesh, triangle).is_some_and(|c| passes::<K>(Sign::Negative, line, c, sides, walk.grid));
        if passes { visit(triangle) } else { ControlFlow::Continue(()) }
    })
}

/// Calls `visit` with each triangle of `mesh` whose closed plan area, within the grid rectangle, AB meets; in the
/// mesh's depth-first order, until `visit` breaks. Exact.
pub fn for_each_triangle_met(
    mesh: &impl Mesh,
    a: [f64; 3],
    b: [f64; 3],
    mut visit: impl FnMut(Triangle) -> ControlFlow<()>,
) -> ControlFlow<()> {
    let walk = Walk { mesh, line: [a, b], grid: mesh.grid_size() };
    walk.candidates::<Exact>(&mesh.root().roots(), &mut |triangle, sides| {
        let met = Area::new(triangle.corners(), walk.grid).chord_ends::<Exact>([plan(a), plan(b)], sides, |_| true);
        if met { visit(triangle) } else { ControlFlow::Continue(()) }
    })
}

/// Whether some point of AB over a closed bintree triangle and the grid rectangle (`grid` posts east and north) lies
/// strictly below the plane of `corners`. Exact.
///
/// `corners` turn counter-clockwise; x and y are those of the triangle's posts, z any finite numbers.
pub fn passes_below(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], grid: (u32, u32)) -> bool {
    let sides = corners.map(|c| orient2d_with::<Exact>(plan(a), plan(b), plan(c)));
    passes::<Exact>(Sign::Negative, [a, b], corners, sides, grid)
}

/// As [`passes_below`], strictly above the plane.
pub fn passes_above(a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3], grid: (u32, u32)) -> bool {
    let sides = corners.map(|c| orient2d_with::<Exact>(plan(a), plan(b), plan(c)));
    passes::<Exact>(Sign::Positive, [a, b], corners, sides, grid)
}

/// A point of a segment AB, named exactly.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum LinePoint {
    /// The end A.
    A,
    /// The end B.
    B,
    /// Where AB crosses the line through two posts in plan. A and B lie on different sides of it, one of them at most
    /// on it.
    Crossing(Post, Post),
}

impl LinePoint {
    /// Whether the point lies over the closed `triangle`. Exact.
    pub fn in_triangle(&self, a: [f64; 3], b: [f64; 3], triangle: &Triangle) -> bool {
        let [p, q, r] = triangle.corners().map(plan_of_post);
        [[p, q], [q, r], [r, p]].iter().all(|&[u, v]| match *self {
            Self::A => orient2d_with::<Exact>(u, v, plan(a)) >= Sign::Zero,
            Self::B => orient2d_with::<Exact>(u, v, plan(b)) >= Sign::Zero,
            Self::Crossing(s, t) => {
                let edge = [plan_of_post(s), plan_of_post(t)];
                side_of_crossing::<Exact>([plan(a), plan(b)], edge, [u, v]) >= Sign::Zero
            }
        })
    }

    /// The sign of the line's height at the point less that of the plane through `corners`, which turn
    /// counter-clockwise. Exact.
    pub fn height_against_plane(&self, a: [f64; 3], b: [f64; 3], corners: [[f64; 3]; 3]) -> Sign {
        let [p, q, r] = corners;
        match *self {
            Self::A => orient3d(p, q, r, a),
            Self::B => orient3d(p, q, r, b),
            Self::Crossing(s, t) => height_of_crossing::<Exact>([a, b], [plan_of_post(s), plan_of_post(t)], corners),
        }
    }
}

/// The plan position of a post.
fn plan_of_post(p: Post) -> [f64; 2] {
    [f64::from(p.i), f64::from(p.j)]
}

/// The corners of a mesh triangle in space, counter-clockwise; `None` when the mesh lacks one, which breaks its
/// promise that ancestors of active posts are active.
fn corners(mesh: &impl Mesh, triangle: Triangle) -> Option<[[f64; 3]; 3]> {
    let at = |p: Post| Some([f64::from(p.i), f64::from(p.j), mesh.height(p)?]);
    let [p, q, r] = triangle.corners();
    Some([at(p)?, at(q)?, at(r)?])
}

/// A walk over the triangles of a mesh near a line.
struct Walk<'a, M> {
    mesh: &'a M,
    line: [[f64; 3]; 2],
    grid: (u32, u32),
}

/// A triangle of the descent with the sides of line AB on which its corners (apex, e1, e0) lie.
type Sided = (Triangle, [Sign; 3]);

impl<M: Mesh> Walk<'_, M> {
    /// Calls `visit` with every triangle of the mesh, among the parts of the triangles `from`, that AB may meet within
    /// the grid: whose bounding box the line's meets there, and whose corners do not all lie strictly on one side of
    /// line AB. Both tests are exact, and what they discard is not met.
    fn candidates<K: Kernel>(
        &self,
        from: &[Triangle],
        visit: &mut impl FnMut(Triangle, [Sign; 3]) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let Some(window) = self.window() else { return ControlFlow::Continue(()) };
        let [a, b] = self.line.map(plan);
        let side = |p: Post| orient2d_with::<K>(a, b, plan_of_post(p));
        let mut stack: Vec<Sided> = Vec::with_capacity(64);
        for &triangle in from.iter().rev() {
            stack.push((triangle, triangle.corners().map(side)));
        }
        while let Some((triangle, sides)) = stack.pop() {
            if one_sided(&sides) || !window.meets(&triangle) {
                continue;
            }
            let Some(m) = triangle.base_midpoint().filter(|&m| self.mesh.height(m).is_some()) else {
                visit(triangle, sides)?;
                continue;
            };
            let [apex, e1, e0] = sides;
            let middle = side(m);
            // Children are (m, apex, e0) and (m, e1, apex); sides are kept in the order apex, e1, e0.
            let [first, second] = triangle.children(m);
            stack.extend([(second, [middle, apex, e1]), (first, [middle, e0, apex])]);
        }
        ControlFlow::Continue(())
    }

    /// The bounding box of AB within the grid rectangle; `None` when they do not meet.
    fn window(&self) -> Option<Window> {
        let [a, b] = self.line;
        let range = |axis: usize, posts: u32| {
            let low = a[axis].min(b[axis]).max(0.0);
            let high = a[axis].max(b[axis]).min(f64::from(posts - 1));
            (low <= high).then_some((low, high))
        };
        Some(Window { x: range(0, self.grid.0)?, y: range(1, self.grid.1)? })
    }
}

/// A closed rectangle in plan.
struct Window {
    x: (f64, f64),
    y: (f64, f64),
}

impl Window {
    /// Whether it meets the closed bounding box of `triangle`.
    fn meets(&self, triangle: &Triangle) -> bool {
        let [p, q, r] = triangle.corners();
        let overlap = |(low, high): (f64, f64), [u, v, w]: [u32; 3]| {
            f64::from(u.min(v).min(w)) <= high && f64::from(u.max(v).max(w)) >= low
        };
        overlap(self.x, [p.i, q.i, r.i]) && overlap(self.y, [p.j, q.j, r.j])
    }
}

/// Whether all of `sides` are the same and not zero.
fn one_sided(sides: &[Sign; 3]) -> bool {
    sides[0] != Sign::Zero && sides[1] == sides[0] && sides[2] == sides[0]
}

/// Whether some point of AB over the triangle and the grid has height sign `want` against the plane of `corners`,
/// whose corners lie on `sides` of line AB.
fn passes<K: Kernel>(
    want: Sign,
    line: [[f64; 3]; 2],
    corners: [[f64; 3]; 3],
    sides: [Sign; 3],
    grid: (u32, u32),
) -> bool {
    if one_sided(&sides) {
        return false;
    }
    let [p, q, r] = corners;
    let ends = line.map(|x| orient3d_with::<K>(p, q, r, x));
    if ends[0] != want && ends[1] != want {
        return false;
    }
    let posts = corners.map(|[x, y, _]| Post::new(x as u32, y as u32));
    let area = Area::new(posts, grid);
    area.chord_ends::<K>(line.map(plan), sides, |end| {
        let height = match end {
            ChordEnd::A => ends[0],
            ChordEnd::B => ends[1],
            // The plane holds the edge, so the edge's own heights will do.
            ChordEnd::Edge { from, direction } => {
                let (s, t) = (corners[from], corners[(from + 1) % 3]);
                orient3d_with::<K>(line[0], line[1], s, t).times(direction)
            }
            ChordEnd::Cut { from, to } => height_of_crossing::<K>(line, [from, to], corners),
        };
        height == want
    })
}

/// An end of the part of AB over a triangle.
#[derive(Clone, Copy, Debug)]
enum ChordEnd {
    A,
    B,
    /// Where AB crosses the triangle's edge from corner `from` to the next; `direction` is the sign of
    /// side(next) - side(from), which normalises an orientation of the four points.
    Edge {
        from: usize,
        direction: Sign,
    },
    /// Where AB crosses the line through two points of the cut triangle's border.
    Cut {
        from: [f64; 2],
        to: [f64; 2],
    },
}

/// The closed plan area of a triangle within the grid rectangle.
enum Area {
    /// A triangle that lies within the grid.
    Whole([[f64; 2]; 3]),
    /// A convex polygon with posts as corners, counter-clockwise; it may be a segment, a point or empty.
    Cut(Vec<Post>),
}

impl Area {
    fn new(corners: [Post; 3], (nx, ny): (u32, u32)) -> Self {
        if corners.iter().all(|p| p.i < nx && p.j < ny) {
            return Self::Whole(corners.map(plan_of_post));
        }
        let east = cut(&corners, |p| p.i, nx - 1, |p, over| Post::new(nx - 1, slide(p.0.j, p.1.j, over)));
        Self::Cut(cut(&east, |p| p.j, ny - 1, |p, over| Post::new(slide(p.0.i, p.1.i, over), ny - 1)))
    }

    /// Whether `is` holds for an end of the part of AB over the area. `sides` are those of the uncut corners.
    fn chord_ends<K: Kernel>(&self, ab: [[f64; 2]; 2], sides: [Sign; 3], mut is: impl FnMut(ChordEnd) -> bool) -> bool {
        let [a, b] = ab;
        let corners = match self {
            Self::Whole(corners) => corners,
            Self::Cut(polygon) => return cut_chord_ends::<K>(polygon, ab, is),
        };
        let edge = |k: usize| [corners[k], corners[(k + 1) % 3]];
        let inside = |x: [f64; 2]| [0, 1, 2].map(|k| orient2d_with::<K>(edge(k)[0], edge(k)[1], x));
        let (of_a, of_b) = (inside(a), inside(b));
        if of_a.iter().all(|&s| s >= Sign::Zero) && is(ChordEnd::A) {
            return true;
        }
        if of_b.iter().all(|&s| s >= Sign::Zero) && is(ChordEnd::B) {
            return true;
        }
        (0..3).any(|k| {
            let (s, t) = (sides[k], sides[(k + 1) % 3]);
            crosses(s, t) && meets(of_a[k], of_b[k]) && is(ChordEnd::Edge { from: k, direction: t.minus_opposite(s) })
        })
    }
}

/// Whether two signs are those of points on different sides of a line, one of them at most on it.
fn crosses(s: Sign, t: Sign) -> bool {
    // Signs differ also as (zero, positive): one end on the line. Equal signs are one side, or a line along the edge.
    s != t
}

/// Whether two signs are not both positive or both negative.
fn meets(s: Sign, t: Sign) -> bool {
    s != t || s == Sign::Zero
}

/// The part of a convex polygon of posts with `of(p) <= limit`; `at` gives the post where an edge, followed from its
/// first end by a number of steps, meets the limit.
fn cut(polygon: &[Post], of: fn(Post) -> u32, limit: u32, at: impl Fn((Post, Post), u32) -> Post) -> Vec<Post> {
    let mut kept: Vec<Post> = Vec::with_capacity(polygon.len() + 1);
    let mut keep = |p: Post| {
        if kept.last() != Some(&p) {
            kept.push(p);
        }
    };
    for (k, &p) in polygon.iter().enumerate() {
        let q = polygon[(k + 1) % polygon.len()];
        if of(p) <= limit {
            keep(p);
        }
        if (of(p) < limit && of(q) > limit) || (of(p) > limit && of(q) < limit) {
            keep(at((p, q), of(p).abs_diff(limit)));
        }
    }
    if kept.len() > 1 && kept.first() == kept.last() {
        kept.pop();
    }
    kept
}

/// The other coordinate after `steps` from `from` towards `to` along an axis-parallel or diagonal edge.
fn slide(from: u32, to: u32, steps: u32) -> u32 {
    match from.cmp(&to) {
        std::cmp::Ordering::Less => from + steps,
        std::cmp::Ordering::Equal => from,
        std::cmp::Ordering::Greater => from - steps,
    }
}

/// [`Area::chord_ends`] for a polygon that was cut at the border of the grid.
fn cut_chord_ends<K: Kernel>(polygon: &[Post], ab: [[f64; 2]; 2], mut is: impl FnMut(ChordEnd) -> bool) -> bool {
    let [a, b] = ab;
    let corners: Vec<[f64; 2]> = polygon.iter().map(|&p| plan_of_post(p)).collect();
    let edges = || corners.iter().enumerate().map(|(k, &p)| (p, corners[(k + 1) % corners.len()]));
    let inside = |x: [f64; 2]| {
        // A segment or point has no inside to turn around; the box holds for all shapes.
        within_box(&corners, x) && edges().all(|(p, q)| orient2d_with::<K>(p, q, x) >= Sign::Zero)
    };
    if (inside(a) && is(ChordEnd::A)) || (inside(b) && is(ChordEnd::B)) {
        return true;
    }
    let crossed = edges().any(|(p, q)| {
        let side = |c| orient2d_with::<K>(a, b, c);
        crosses(side(p), side(q))
            && meets(orient2d_with::<K>(p, q, a), orient2d_with::<K>(p, q, b))
            && is(ChordEnd::Cut { from: p, to: q })
    });
    // A line along a cut-down segment, or through a cut-down point, crosses none of the edges above.
    crossed
        || corners.len() <= 2
            && corners.iter().any(|&p| {
                let across = if a[1] == b[1] { [p[0], p[1] + 1.0] } else { [p[0] + 1.0, p[1]] };
                a != b
                    && within_box(&[a, b], p)
                    && orient2d_with::<K>(a, b, p) == Sign::Zero
                    && is(ChordEnd::Cut { from: p, to: across })
            })
}

/// Whether `x` lies in the closed bounding box of `points`; not for no points.
fn within_box(points: &[[f64; 2]], x: [f64; 2]) -> bool {
    !points.is_empty()
        && [0, 1].iter().all(|&k| {
            let is = |sign| points.iter().any(|p| compare(p[k], x[k]) != sign);
            is(Sign::Positive) && is(Sign::Negative)
        })
}
