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
    /// The vertex `k` steps from the back or the front.
    fn vertex_at(&self, back: bool, k: usize) -> u64 {
        self.vertices[if back { self.vertices.len() - 1 - k } else { k }]
    }

    /// Adds the triangles of `short` at one end, where the two share an edge: the last vertex of this strip is the last
    /// but one of the other, and the other way round.
    fn attach(&mut self, back: bool, short: &Self, short_back: bool) {
        for k in 0..short.triangles.len() {
            let vertex = short.vertex_at(short_back, k + 2);
            let triangle = short.triangles[if short_back { short.triangles.len() - 1 - k } else { k }];
            if back {
                self.vertices.push_back(vertex);
                self.triangles.push_back(triangle);
            } else {
                self.vertices.push_front(vertex);
                self.triangles.push_front(triangle);
            }
        }
    }

    /// Turns a strip of one triangle so that it continues another strip beyond one of its ends, if it can.
    fn turn_towards(&mut self, other: &Self, other_back: bool) {
        let (outer, inner) = (other.vertex_at(other_back, 0), other.vertex_at(other_back, 1));
        let thirds: Vec<u64> = self.vertices.iter().copied().filter(|&v| v != outer && v != inner).collect();
        if let (3, &[third]) = (self.vertices.len(), thirds.as_slice()) {
            self.vertices = [inner, outer, third].into();
        }
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
        let Some(id) = self.of.remove(&triangle) else { return };
        let Some(mut before) = self.strips.remove(&id) else { return };
        let Some(at) = before.triangles.iter().position(|&t| t == triangle) else { return };
        let mut after =
            Strip { vertices: before.vertices.split_off(at + 1), triangles: before.triangles.split_off(at) };
        after.triangles.pop_front();
        before.vertices.push_back(after.vertices[0]);
        // The longer part keeps its number.
        let (long, short) =
            if before.triangles.len() >= after.triangles.len() { (before, after) } else { (after, before) };
        if !short.triangles.is_empty() {
            self.written += short.triangles.len() as u64 + 2;
            self.insert(short);
        }
        if !long.triangles.is_empty() {
            self.strips.insert(id, long);
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

    /// Joins two strips where an end of the one continues an end of the other: the shorter goes to the longer.
    fn join_strips(&mut self, a: u32, b: u32) {
        let (Some(first), Some(second)) = (self.strips.remove(&a), self.strips.remove(&b)) else { return };
        let (long_id, mut long, short_id, mut short) =
            if first.triangles.len() >= second.triangles.len() { (a, first, b, second) } else { (b, second, a, first) };
        if let Some((back, short_back)) = meeting_ends(&mut long, &mut short) {
            long.attach(back, &short, short_back);
            self.written += short.triangles.len() as u64;
            for &t in &short.triangles {
                self.of.insert(t, long_id);
            }
        } else {
            self.strips.insert(short_id, short);
        }
        self.strips.insert(long_id, long);
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

/// The ends (whether they are the backs) at which two strips share an edge in the order that both need; strips of one
/// triangle are turned for it.
fn meeting_ends(long: &mut Strip, short: &mut Strip) -> Option<(bool, bool)> {
    if let (3, 3) = (long.vertices.len(), short.vertices.len()) {
        let common = |v: &u64| short.vertices.contains(v);
        if let Some(third) = long.vertices.iter().position(|v| !common(v)) {
            long.vertices.swap(0, third);
        }
    }
    for back in [true, false] {
        short.turn_towards(long, back);
        for short_back in [false, true] {
            if long.vertex_at(back, 0) == short.vertex_at(short_back, 1)
                && long.vertex_at(back, 1) == short.vertex_at(short_back, 0)
            {
                return Some((back, short_back));
            }
        }
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
