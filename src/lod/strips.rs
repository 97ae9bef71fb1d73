//! Triangle strips and fans: how few vertices a mesh can be sent with.
//!
//! Follows Duchaineau et al., "Good terrain geometry, cheap!", section 8.1, for both ways: [`greedy`] starts at a triangle and
//! grows a strip at both of its ends as long as it can, for a whole mesh at once; [`StripSet`] keeps strips while triangles come
//! and go. A strip of n triangles has n + 2 vertices, each three in a row being a triangle, of turning sense; no
//! vertex is ever repeated, so a strip ends where the next triangle would need a swap. [`fans`] covers a mesh with fans around
//! vertices, as Roettger's quadtree is drawn.
//!
//! It departs in starting triangles, which the paper picks at random: here in the order of the mesh.

use std::collections::{BTreeMap, VecDeque};

use super::IndexedMesh;

/// Bytes of an index into vertices.
pub const INDEX_BYTES: usize = 4;
/// Bytes that end a strip or fan: one index that restarts.
pub const RESTART_BYTES: usize = 4;

/// What a way of sending a mesh needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Output {
    /// Strips or fans; 0 for a list.
    pub pieces: usize,
    /// Triangles.
    pub triangles: usize,
    /// Bytes of indices.
    pub bytes: usize,
}

impl Output {
    fn of(lengths: impl Iterator<Item = usize>) -> Self {
        let mut output = Self::default();
        for triangles in lengths {
            output.pieces += 1;
            output.triangles += triangles;
            output.bytes += (triangles + 2) * INDEX_BYTES + RESTART_BYTES;
        }
        output
    }

    /// Average number of triangles in a piece.
    pub fn average(&self) -> f64 {
        self.triangles as f64 / self.pieces.max(1) as f64
    }
}

/// A mesh sent as separate triangles.
pub fn list(mesh: &IndexedMesh) -> Output {
    Output { pieces: 0, triangles: mesh.len(), bytes: 3 * mesh.len() * INDEX_BYTES }
}

/// A mesh sent as strips grown greedily.
pub fn greedy(mesh: &IndexedMesh) -> Output {
    Output::of(greedy_strips(mesh).iter().map(|strip| strip.len() - 2))
}

/// The vertices of each strip.
pub fn greedy_strips(mesh: &IndexedMesh) -> Vec<VecDeque<u32>> {
    let edges = Edges::new(mesh);
    let mut used = vec![false; mesh.len()];
    let mut strips = Vec::new();
    for n in 0..mesh.len() {
        if used[n] {
            continue;
        }
        used[n] = true;
        // Each corner may be the middle one of the first triangle: take the turn that grows longest.
        let [a, b, c] = mesh.triangles[n];
        let grown = [[a, b, c], [b, c, a], [c, a, b]].map(|start| grow(mesh, &edges, &used, VecDeque::from(start)));
        let (strip, taken) = grown.into_iter().max_by_key(|g| g.1.len()).unwrap_or_default();
        for t in taken {
            used[t as usize] = true;
        }
        strips.push(strip);
    }
    strips
}

/// A strip grown at both ends over triangles that are not used, and those that it took.
fn grow(mesh: &IndexedMesh, edges: &Edges, used: &[bool], mut strip: VecDeque<u32>) -> (VecDeque<u32>, Vec<u32>) {
    let mut taken: Vec<u32> = Vec::new();
    for front in [false, true] {
        loop {
            let n = strip.len();
            let (outer, inner, before) =
                if front { (strip[0], strip[1], strip[2]) } else { (strip[n - 1], strip[n - 2], strip[n - 3]) };
            let next =
                edges.across(mesh, outer, inner, before).filter(|(t, _)| !used[*t as usize] && !taken.contains(t));
            let Some((t, vertex)) = next else { break };
            taken.push(t);
            if front { strip.push_front(vertex) } else { strip.push_back(vertex) }
        }
    }
    (strip, taken)
}

/// The triangles at every edge, sorted.
struct Edges(Vec<([u32; 2], u32)>);

impl Edges {
    fn new(mesh: &IndexedMesh) -> Self {
        let mut edges = Vec::with_capacity(3 * mesh.len());
        for (n, &[a, b, c]) in mesh.triangles.iter().enumerate() {
            edges.extend([(a, b), (b, c), (c, a)].map(|(p, q)| ([p.min(q), p.max(q)], n as u32)));
        }
        edges.sort_unstable();
        Self(edges)
    }

    /// The triangle across edge pq from the one with the third corner `from`, and its own third corner.
    fn across(&self, mesh: &IndexedMesh, p: u32, q: u32, from: u32) -> Option<(u32, u32)> {
        let key = [p.min(q), p.max(q)];
        let first = self.0.partition_point(|e| e.0 < key);
        self.0[first..].iter().take_while(|e| e.0 == key).find_map(|&(_, t)| {
            let third = mesh.triangles[t as usize].into_iter().find(|&v| v != p && v != q)?;
            (third != from).then_some((t, third))
        })
    }
}

/// A mesh sent as fans: around each vertex in turn, those with most triangles left first, as many runs of triangles as
/// it has.
pub fn fans(mesh: &IndexedMesh) -> Output {
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); mesh.vertices.len()];
    for (n, t) in mesh.triangles.iter().enumerate() {
        for &v in t {
            around[v as usize].push(n as u32);
        }
    }
    let mut order: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    order.sort_by_key(|&v| (usize::MAX - around[v as usize].len(), v));
    let mut used = vec![false; mesh.len()];
    let mut lengths = Vec::new();
    for v in order {
        // From each free triangle's second corner to its third, seen from v: a run follows those.
        let mut next: BTreeMap<u32, (u32, u32)> = BTreeMap::new();
        for &t in around[v as usize].iter().filter(|&&t| !used[t as usize]) {
            let corners = mesh.triangles[t as usize];
            let k = corners.iter().position(|&c| c == v).unwrap_or(0);
            next.insert(corners[(k + 1) % 3], (corners[(k + 2) % 3], t));
        }
        while let Some(start) = first_of_a_run(&next) {
            let (mut at, mut length) = (start, 0);
            while let Some((to, t)) = next.remove(&at) {
                used[t as usize] = true;
                length += 1;
                at = to;
            }
            lengths.push(length);
        }
    }
    Output::of(lengths.into_iter())
}

/// A corner that no other triangle of the fan leads to; any, when they close a circle.
fn first_of_a_run(next: &BTreeMap<u32, (u32, u32)>) -> Option<u32> {
    let led_to = |v: &u32| next.values().any(|(to, _)| to == v);
    next.keys().find(|v| !led_to(v)).or_else(|| next.keys().next()).copied()
}

/// A strip of a [`StripSet`]: its vertices, and its triangles in order.
#[derive(Clone, Debug, Default)]
struct Strip {
    vertices: VecDeque<u64>,
    triangles: VecDeque<u32>,
}

impl Strip {
    fn reverse(&mut self) {
        self.vertices.make_contiguous().reverse();
        self.triangles.make_contiguous().reverse();
    }

    /// Turns a strip of one triangle so that edge pq is its last; says whether the last edge is pq.
    fn ends_with(&mut self, edge: [u64; 2]) -> bool {
        let n = self.vertices.len();
        if n == 3
            && let Some(k) = self.vertices.iter().position(|v| !edge.contains(v))
        {
            self.vertices.swap(0, k);
        }
        edge.contains(&self.vertices[n - 1]) && edge.contains(&self.vertices[n - 2])
    }
}

/// Strips that are kept while triangles come and go.
///
/// Triangles have numbers and three vertices, which are numbers too; a number may be used again after its triangle was
/// removed. All results depend on the order of calls only.
#[derive(Clone, Debug, Default)]
pub struct StripSet {
    strips: BTreeMap<u32, Strip>,
    /// The strip of each triangle.
    of: BTreeMap<u32, u32>,
    next: u32,
    /// Vertices written since the last [`StripSet::take_written`].
    written: u64,
}

impl StripSet {
    /// Removes a triangle, cutting its strip in two where it was in the middle.
    pub fn remove(&mut self, triangle: u32) {
        let Some(strip) = self.of.remove(&triangle).and_then(|id| self.strips.remove(&id)) else { return };
        let Some(at) = strip.triangles.iter().position(|&t| t == triangle) else { return };
        let (vertices, triangles) = (strip.vertices, strip.triangles);
        let before = Strip {
            vertices: vertices.iter().copied().take(at + 2).collect(),
            triangles: triangles.iter().copied().take(at).collect(),
        };
        let after = Strip {
            vertices: vertices.iter().copied().skip(at + 1).collect(),
            triangles: triangles.iter().copied().skip(at + 1).collect(),
        };
        for part in [before, after] {
            if !part.triangles.is_empty() {
                self.written += 1;
                self.insert(part);
            }
        }
    }

    /// Adds a triangle whose neighbours across its edges are `neighbours`: to the strip of one, or between those of two.
    pub fn add(&mut self, triangle: u32, vertices: [u64; 3], neighbours: &[u32]) {
        self.insert(Strip { vertices: vertices.into(), triangles: [triangle].into() });
        self.written += 3;
        self.join(triangle, neighbours);
    }

    /// Tries to join the strip of a triangle with those of its neighbours.
    pub fn join(&mut self, triangle: u32, neighbours: &[u32]) {
        for &n in neighbours {
            if let (Some(&a), Some(&b)) = (self.of.get(&triangle), self.of.get(&n))
                && a != b
            {
                self.join_strips(a, b);
            }
        }
    }

    fn insert(&mut self, strip: Strip) {
        let id = self.next;
        self.next += 1;
        for &t in &strip.triangles {
            self.of.insert(t, id);
        }
        self.strips.insert(id, strip);
    }

    /// Joins two strips where the last edge of the one, as it turns, is the first of the other.
    fn join_strips(&mut self, a: u32, b: u32) {
        let (Some(mut first), Some(mut second)) = (self.strips.remove(&a), self.strips.remove(&b)) else { return };
        if let Some(joined) = joined(&mut first, &mut second) {
            self.written += 2 + second.triangles.len() as u64;
            self.insert(joined);
        } else {
            self.strips.insert(a, first);
            self.strips.insert(b, second);
        }
    }

    /// What sending the strips takes.
    pub fn output(&self) -> Output {
        Output::of(self.strips.values().map(|strip| strip.triangles.len()))
    }

    /// The vertices of all strips.
    pub fn vertices(&self) -> impl Iterator<Item = Vec<u64>> {
        self.strips.values().map(|strip| strip.vertices.iter().copied().collect())
    }

    /// Vertices written or moved since this was last asked: the cost of keeping the strips.
    pub fn take_written(&mut self) -> u64 {
        std::mem::take(&mut self.written)
    }
}

/// The two strips as one, if an end of the one continues an end of the other.
fn joined(first: &mut Strip, second: &mut Strip) -> Option<Strip> {
    for _ in 0..2 {
        for _ in 0..2 {
            let n = second.vertices.len();
            let edge = [second.vertices[0], second.vertices[1]];
            let common: Vec<u64> = second.vertices.iter().copied().filter(|v| first.vertices.contains(v)).collect();
            if let (1, 3, &[p, q]) = (first.triangles.len(), n, common.as_slice()) {
                first.ends_with([p, q]);
            }
            if n == 3 {
                // A single triangle turns so that it begins with the other's last edge, in the other's order.
                let m = first.vertices.len();
                let last = [first.vertices[m - 2], first.vertices[m - 1]];
                let others: Vec<u64> = second.vertices.iter().copied().filter(|v| !last.contains(v)).collect();
                if let &[third] = others.as_slice() {
                    second.vertices = [last[0], last[1], third].into();
                }
            } else {
                first.ends_with(edge);
            }
            let m = first.vertices.len();
            let single = first.triangles.len() == 1 && n > 3;
            if single && first.vertices[m - 2] == second.vertices[1] && first.vertices[m - 1] == second.vertices[0] {
                first.vertices.swap(m - 2, m - 1);
            }
            if [first.vertices[m - 2], first.vertices[m - 1]] == [second.vertices[0], second.vertices[1]] {
                let vertices = first.vertices.iter().chain(second.vertices.iter().skip(2)).copied().collect();
                let triangles = first.triangles.iter().chain(&second.triangles).copied().collect();
                return Some(Strip { vertices, triangles });
            }
            second.reverse();
        }
        first.reverse();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        lod::{Algorithm, Ground, LevelOfDetail, LodView, Target},
        terrain::{
            SceneScale,
            synthetic::{fractal, mix},
        },
    };

    fn mesh(triangles: u32) -> IndexedMesh {
        let ground = Ground::read(&fractal(65, 65, 6, 300).unwrap(), SceneScale::UNIT).unwrap();
        let view =
            LodView::new(glam::DVec3::new(30.0, 30.0, 300.0), glam::DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
        Algorithm::NestedSpheres.prepare(&ground).update(&view, Target::Triangles(triangles)).unwrap().mesh
    }

    fn sorted(mut t: [u64; 3]) -> [u64; 3] {
        t.sort_unstable();
        t
    }

    fn expected(mesh: &IndexedMesh) -> Vec<[u64; 3]> {
        let mut all: Vec<_> = mesh.triangles.iter().map(|t| sorted(t.map(u64::from))).collect();
        all.sort_unstable();
        all
    }

    fn of_strips(strips: impl Iterator<Item = Vec<u64>>) -> Vec<[u64; 3]> {
        let mut all: Vec<_> =
            strips.flat_map(|s| s.windows(3).map(|w| sorted([w[0], w[1], w[2]])).collect::<Vec<_>>()).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn greedy_strips_and_fans_hold_every_triangle_once() {
        let mesh = mesh(2000);
        let strips = greedy_strips(&mesh);
        let as_u64 = |s: VecDeque<u32>| s.into_iter().map(u64::from).collect::<Vec<_>>();
        assert_eq!(of_strips(strips.into_iter().map(as_u64)), expected(&mesh));
        let (strips, fans, list) = (greedy(&mesh), fans(&mesh), list(&mesh));
        assert_eq!([strips.triangles, fans.triangles], [mesh.len(); 2]);
        assert!(strips.average() > 2.5 && fans.average() > 2.5, "{strips:?} {fans:?}");
        assert!(strips.bytes < list.bytes && fans.bytes < list.bytes, "{strips:?} {fans:?} {list:?}");
    }

    #[test]
    fn strips_survive_triangles_that_come_and_go() {
        let mesh = mesh(600);
        let edges = Edges::new(&mesh);
        let neighbours = |n: usize| {
            let [a, b, c] = mesh.triangles[n];
            [(a, b, c), (b, c, a), (c, a, b)]
                .into_iter()
                .filter_map(|(p, q, r)| Some(edges.across(&mesh, p, q, r)?.0))
                .collect::<Vec<_>>()
        };
        for seed in 0..5 {
            let mut set = StripSet::default();
            let mut there = vec![false; mesh.len()];
            for step in 0..4000 {
                let n = mix(seed ^ mix(step)) as usize % mesh.len();
                if there[n] {
                    set.remove(n as u32);
                } else {
                    set.add(n as u32, mesh.triangles[n].map(u64::from), &neighbours(n));
                }
                there[n] = !there[n];
            }
            for (n, there) in there.into_iter().enumerate() {
                if !there {
                    set.add(n as u32, mesh.triangles[n].map(u64::from), &neighbours(n));
                }
            }
            assert_eq!(of_strips(set.vertices()), expected(&mesh), "seed {seed}");
            assert_eq!(set.output().triangles, mesh.len());
            assert!(set.output().average() > 2.0, "{:?}", set.output());
            assert!(set.take_written() > 0 && set.take_written() == 0);
        }
    }
}
