//! Vertex and index buffers that follow a view from frame to frame, and which parts of them each frame changed.
//!
//! A renderer uploads the whole of [`MeshBuffers`] once and then only the ranges that [`MeshBuffers::update`] returns; the
//! work is proportional to what changed. A vertex keeps its place as long as its post is active, and the places of posts
//! that went are used again; triangles lie without gaps: those that come take the places of those that went with the same
//! frame, and where more went, the last ones fill the places left.
//!
//! A triangle is in the mesh when its apex is active and the middle of its base is not. So a post that came or went
//! changes at most the two triangles that have it in the middle of their bases, and their children.

use std::{
    collections::{BTreeSet, HashMap, VecDeque},
    ops::Range,
};

use sightline_proto::{
    diamond::{Post, Triangle},
    mesh::Mesh,
    replica::Replica,
};

use crate::scene::SceneState;

/// Changed places with at most so many unchanged ones between them make one range, since an upload costs more than its
/// bytes. A guess, of 48 bytes an upload; a renderer that was measured would change it.
const GAP: usize = 4;

/// The places that a frame changed, in ascending order, without overlaps.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct ChangedRanges {
    /// Of [`MeshBuffers::vertices`].
    pub vertices: Vec<Range<usize>>,
    /// Of [`MeshBuffers::triangles`].
    pub triangles: Vec<Range<usize>>,
}

/// The mesh of one view for a renderer.
#[derive(Clone, Debug)]
pub struct MeshBuffers {
    origin_m: [f64; 3],
    /// Frames of the scene that have been followed.
    applied: u64,
    vertices: Vec<[f32; 3]>,
    places: HashMap<u64, u32>,
    free: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    /// The name of each triangle, and where it is.
    names: Vec<Name>,
    slots: HashMap<Name, usize>,
    changed_vertices: BTreeSet<usize>,
    changed_triangles: BTreeSet<usize>,
}

/// Keys of a triangle's apex and of the first end of its base: no two triangles of a hierarchy share both.
type Name = (u64, u64);

impl MeshBuffers {
    /// The mesh that `scene` holds now. Vertices are relative to `origin_m`, a point of the scene frame near the viewer, so
    /// that 32-bit numbers do.
    pub fn new(scene: &SceneState, origin_m: [f64; 3]) -> Self {
        let mut buffers = Self {
            origin_m,
            applied: 0,
            vertices: Vec::new(),
            places: HashMap::new(),
            free: Vec::new(),
            triangles: Vec::new(),
            names: Vec::new(),
            slots: HashMap::new(),
            changed_vertices: BTreeSet::new(),
            changed_triangles: BTreeSet::new(),
        };
        buffers.follow_all(scene);
        buffers.ranges();
        buffers
    }

    /// Metres east, north and up of the origin. Places of no active post hold what was there.
    pub fn vertices(&self) -> &[[f32; 3]] {
        &self.vertices
    }

    /// Places in [`MeshBuffers::vertices`], counter-clockwise seen from above; all triangles of the mesh, those beyond the
    /// grid included.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Follows the same `scene` to its last frame and tells what changed since the last call. Where a frame between them
    /// was passed over, everything is compared.
    pub fn update(&mut self, scene: &SceneState) -> ChangedRanges {
        let last = scene.last_frame();
        if last.applied == self.applied {
            return ChangedRanges::default();
        }
        if last.applied == self.applied + 1 {
            let changes = scene.last_changes();
            self.follow(scene.replica(), &changes.added, &changes.removed);
        } else {
            self.follow_all(scene);
        }
        self.applied = last.applied;
        self.ranges()
    }

    fn follow_all(&mut self, scene: &SceneState) {
        let replica = scene.replica();
        // Depth first, so that what is near on the ground is near in the buffers.
        let mut triangles = replica.triangles();
        let mut added = Vec::new();
        for p in triangles.iter().flat_map(Triangle::corners) {
            if !self.places.contains_key(&p.key()) {
                self.place(replica, p);
                added.push(p);
            }
        }
        let mut removed: Vec<_> = self.places.keys().map(|&k| Post::from_key(k)).collect();
        removed.retain(|&p| replica.integer_height(p).is_none());
        removed.sort_unstable();
        triangles.extend(around(replica, &removed));
        triangles.extend(around(replica, &added));
        self.settle(replica, &triangles, &removed);
        self.applied = scene.last_frame().applied;
    }

    fn follow(&mut self, replica: &Replica, added: &[Post], removed: &[Post]) {
        for &p in added {
            self.place(replica, p);
        }
        let triangles: Vec<_> = around(replica, removed).chain(around(replica, added)).collect();
        self.settle(replica, &triangles, removed);
    }

    /// Gives a post that came a place.
    fn place(&mut self, replica: &Replica, p: Post) {
        let grid = [f64::from(p.i), f64::from(p.j), replica.height(p).unwrap_or(0.0)];
        let scale_m = replica.scale_m();
        let vertex = [0, 1, 2].map(|n| (grid[n] * scale_m[n] - self.origin_m[n]) as f32);
        let place = self.free.pop().unwrap_or(self.vertices.len() as u32);
        match self.vertices.get_mut(place as usize) {
            Some(slot) => *slot = vertex,
            None => self.vertices.push(vertex),
        }
        self.places.insert(p.key(), place);
        self.changed_vertices.insert(place as usize);
    }

    /// Adds each of these triangles or takes it out, as the mesh now has it, and gives the places of posts that went free.
    fn settle(&mut self, replica: &Replica, triangles: &[Triangle], removed: &[Post]) {
        let is_active = |p: Post| replica.integer_height(p).is_some();
        let wanted = |t: &&Triangle| is_active(t.apex) && !t.base_midpoint().is_some_and(is_active);
        let gone = triangles.iter().filter(|t| !wanted(t));
        let mut vacant: VecDeque<usize> = gone.filter_map(|t| self.slots.remove(&name(t))).collect();
        for triangle in triangles.iter().filter(wanted) {
            if self.slots.contains_key(&name(triangle)) {
                continue;
            }
            let places = triangle.corners().map(|p| self.places[&p.key()]);
            let slot = vacant.pop_front().unwrap_or(self.triangles.len());
            if slot == self.triangles.len() {
                self.triangles.push(places);
                self.names.push(name(triangle));
            } else {
                (self.triangles[slot], self.names[slot]) = (places, name(triangle));
            }
            self.slots.insert(name(triangle), slot);
            self.changed_triangles.insert(slot);
        }
        self.fill(vacant.into());
        self.free.extend(removed.iter().filter_map(|p| self.places.remove(&p.key())));
    }

    /// Fills slots of triangles that went with the last ones.
    fn fill(&mut self, mut vacant: Vec<usize>) {
        vacant.sort_unstable();
        // From the end, so that what moves is never a triangle that went.
        for slot in vacant.into_iter().rev() {
            self.triangles.swap_remove(slot);
            self.names.swap_remove(slot);
            if let Some(&moved) = self.names.get(slot) {
                self.slots.insert(moved, slot);
                self.changed_triangles.insert(slot);
            }
        }
    }

    /// The places noted since the last call.
    fn ranges(&mut self) -> ChangedRanges {
        let [vertices, triangles] = [&mut self.changed_vertices, &mut self.changed_triangles].map(std::mem::take);
        let held = self.triangles.len();
        ChangedRanges { vertices: joined(vertices), triangles: joined(triangles.into_iter().filter(|&n| n < held)) }
    }
}

fn name(triangle: &Triangle) -> Name {
    (triangle.apex.key(), triangle.e0.key())
}

/// The triangles with one of `posts` in the middle of their base, and their children.
fn around<'a>(replica: &'a Replica, posts: &'a [Post]) -> impl Iterator<Item = Triangle> + 'a {
    posts.iter().flat_map(|&p| replica.root().triangles(p).flat_map(move |t| [t].into_iter().chain(t.children(p))))
}

/// Ascending numbers as ranges.
fn joined(places: impl IntoIterator<Item = usize>) -> Vec<Range<usize>> {
    let mut ranges: Vec<Range<usize>> = Vec::new();
    for n in places {
        match ranges.last_mut() {
            Some(last) if n <= last.end + GAP => last.end = n + 1,
            _ => ranges.push(n..n + 1),
        }
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use sightline_proto::{mesh::closure, v1};
    use v1::stream_scene_response::Response;

    const SIDE: u32 = 16;

    fn scene() -> SceneState {
        let terrain = v1::TerrainDescription {
            nx: SIDE,
            ny: SIDE + 1,
            root_exponent: SIDE.trailing_zeros(),
            metres_per_post_east: 10.0,
            metres_per_post_north: 20.0,
            metres_per_height_unit: 0.5,
            corner_heights: vec![1, 2, 3, 4],
            ..Default::default()
        };
        SceneState::new(&v1::ViewOpened { terrain: Some(terrain) }, 1 << 20, false).unwrap()
    }

    /// Applies the frame that makes the mesh of these seeds of what `scene` holds.
    fn advance(scene: &mut SceneState, seeds: &[(u32, u32)], snapshot: bool) {
        let held = scene.replica();
        let sequence = held.sequence() + 1;
        let posts = closure(held.root(), seeds.iter().map(|&(i, j)| Post::new(i, j)));
        let inner = posts.into_iter().filter(|&p| !held.root().is_corner(p));
        let mesh = held.with_posts([], 0).unwrap().with_posts(inner.map(|p| (p, (p.i * 7 + p.j * 3) as i32)), sequence);
        let mesh = mesh.unwrap();
        let base = (!snapshot && held.sequence() > 0).then_some(held);
        let frame = v1::Frame {
            sequence,
            base_sequence: base.map_or(0, Replica::sequence),
            mesh: mesh.encode(base),
            triangle_count: mesh.triangle_count(),
            mesh_hash: mesh.hash(),
            ..Default::default()
        };
        scene.apply(&v1::StreamSceneResponse { response: Some(Response::Frame(frame)) }).unwrap();
    }

    /// What a renderer holds that uploads the changed ranges only.
    #[derive(Default)]
    struct Uploaded {
        vertices: Vec<[f32; 3]>,
        triangles: Vec<[u32; 3]>,
    }

    impl Uploaded {
        fn take(&mut self, buffers: &MeshBuffers, changed: &ChangedRanges) {
            self.vertices.resize(buffers.vertices().len(), [f32::NAN; 3]);
            self.triangles.resize(buffers.triangles().len(), [u32::MAX; 3]);
            for range in &changed.vertices {
                self.vertices[range.clone()].copy_from_slice(&buffers.vertices()[range.clone()]);
            }
            for range in &changed.triangles {
                self.triangles[range.clone()].copy_from_slice(&buffers.triangles()[range.clone()]);
            }
        }

        /// The positions of all triangles, in an order of its own.
        fn drawn(&self) -> Vec<[[u32; 3]; 3]> {
            let mut drawn: Vec<_> =
                self.triangles.iter().map(|t| t.map(|n| self.vertices[n as usize].map(f32::to_bits))).collect();
            drawn.sort_unstable();
            drawn
        }
    }

    /// The same of the replica, by its own walk.
    fn expected(scene: &SceneState, origin_m: [f64; 3]) -> Vec<[[u32; 3]; 3]> {
        let whole = scene.replica().buffers(origin_m);
        let triangles = whole.indices.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        Uploaded { vertices: whole.vertices, triangles }.drawn()
    }

    fn seeds() -> impl Strategy<Value = Vec<(u32, u32)>> {
        prop::collection::vec((0..=SIDE, 0..=SIDE), 0..8)
    }

    proptest! {
        #[test]
        fn changed_ranges_are_all_that_a_renderer_needs(
            frames in prop::collection::vec((seeds(), 0..8_u8), 1..12),
        ) {
            let origin_m = [35.0, -20.0, 7.5];
            let mut scene = scene();
            let mut buffers = MeshBuffers::new(&scene, origin_m);
            let mut renderer = Uploaded::default();
            renderer.vertices.extend(buffers.vertices());
            renderer.triangles.extend(buffers.triangles());
            prop_assert_eq!(renderer.drawn(), expected(&scene, origin_m));
            for (seeds, kind) in frames {
                if kind == 2 {
                    // The stream is lost and the view opened anew: sequences start again, so the same number may come twice.
                    let opened = v1::ViewOpened { terrain: Some(scene.terrain().clone()) };
                    scene.reopen(&opened, 1 << 20).unwrap();
                }
                advance(&mut scene, &seeds, kind == 0);
                if kind == 1 {
                    continue; // a frame that the renderer does not see
                }
                let changed = buffers.update(&scene);
                renderer.take(&buffers, &changed);
                prop_assert_eq!(renderer.drawn(), expected(&scene, origin_m));
                prop_assert_eq!(buffers.update(&scene), ChangedRanges::default());
            }
        }
    }

    #[test]
    fn a_small_change_is_a_small_upload() {
        let mut scene = scene();
        let all: Vec<_> = (0..=SIDE).flat_map(|i| (0..=SIDE).map(move |j| (i, j))).collect();
        advance(&mut scene, &all, true);
        let mut buffers = MeshBuffers::new(&scene, [0.0; 3]);
        let without: Vec<_> = all.into_iter().filter(|&p| p != (5, 8)).collect();
        advance(&mut scene, &without, false);
        let changed = buffers.update(&scene);
        let places: usize = changed.triangles.iter().map(Range::len).sum();
        assert!(changed.vertices.is_empty() && places <= 4 + 4 * GAP, "{changed:?}");
        assert_eq!(buffers.triangles().len(), (2 * SIDE * SIDE - 2) as usize);
    }

    #[test]
    fn places_near_each_other_are_one_range() {
        assert_eq!(joined([1, 2, 2 + GAP, 4 + 2 * GAP]), [1..3 + GAP, 4 + 2 * GAP..5 + 2 * GAP]);
        assert_eq!(joined([]), []);
    }
}
