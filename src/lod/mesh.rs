//! A mesh that any system can give: indexed triangles whose vertices lie over posts.
//!
//! The plan position of a vertex is a post of the root square; its height is any number, since systems that morph
//! draw vertices between the levels of detail. Triangles turn counter-clockwise seen from above. A mesh states the
//! rectangle that it covers; whether it does is checked in `conformity`.

use std::collections::BTreeMap;

use sightline_proto::{diamond::Post, mesh::Mesh};

use super::{Ground, LodView};

/// A vertex over a post.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Vertex {
    /// The post below.
    pub post: Post,
    /// Height in height units.
    pub z: f64,
}

impl Vertex {
    /// The vertex in the grid frame.
    pub fn point(&self) -> [f64; 3] {
        [f64::from(self.post.i), f64::from(self.post.j), self.z]
    }
}

/// Indexed triangles over posts.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct IndexedMesh {
    /// Cells east and north that the mesh covers, from post (0, 0).
    pub extent: [u32; 2],
    /// The vertices: one for each post that a triangle uses, in order of first use.
    pub vertices: Vec<Vertex>,
    /// Three vertices each, counter-clockwise.
    pub triangles: Vec<[u32; 3]>,
}

impl IndexedMesh {
    /// A mesh of the bintree hierarchy as indexed triangles, so that it is measured as the others are. Triangles with a
    /// corner that is not active are left out: a mesh keeps its promise not to have any.
    pub fn of(mesh: &impl Mesh) -> Self {
        let mut indexed = Self { extent: [mesh.root().side(); 2], ..Self::default() };
        let mut known = BTreeMap::new();
        mesh.for_each_triangle(|t| {
            let [Some(a), Some(b), Some(c)] = t.corners().map(|p| {
                let z = mesh.height(p)?;
                Some(*known.entry(p).or_insert_with(|| {
                    indexed.vertices.push(Vertex { post: p, z });
                    indexed.vertices.len() as u32 - 1
                }))
            }) else {
                return;
            };
            indexed.triangles.push([a, b, c]);
        });
        indexed
    }

    /// The corners of a triangle.
    pub fn corners(&self, triangle: [u32; 3]) -> [Vertex; 3] {
        triangle.map(|n| self.vertices[n as usize])
    }

    /// All triangles by their corners, in order.
    pub fn iter(&self) -> impl Iterator<Item = [Vertex; 3]> {
        self.triangles.iter().map(|&t| self.corners(t))
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Number of triangles that a renderer would draw after culling against the frustum: those whose bounding ball
    /// meets it. Systems place their detail all around the eye, so this is often a quarter of the whole.
    pub fn drawn(&self, ground: &Ground, view: &LodView) -> usize {
        let scale = ground.scale();
        let seen = |corners: &[Vertex; 3]| {
            let [a, b, c] = corners.map(|v| scale.scene_from_grid(v.point().into()));
            let centre = (a + b + c) / 3.0;
            let radius = [a, b, c].map(|p| (p - centre).length_squared()).into_iter().fold(0.0, f64::max).sqrt();
            view.sees(centre, radius)
        };
        self.iter().filter(seen).count()
    }

    /// The triangles by their posts, each starting at its least post, sorted: equal for equal meshes, however made.
    /// Heights do not count: a vertex that morphs is not another triangle.
    pub fn plan(&self) -> Vec<[u64; 3]> {
        let mut all: Vec<_> = self.iter().map(|t| rotated(t.map(|v| v.post.key()))).collect();
        all.sort_unstable();
        all
    }
}

fn rotated([a, b, c]: [u64; 3]) -> [u64; 3] {
    if a < b && a < c {
        [a, b, c]
    } else if b < c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// Triangles of `next` that are not in `last`; both as [`IndexedMesh::plan`] gives them.
pub fn changed(last: &[[u64; 3]], next: &[[u64; 3]]) -> usize {
    next.iter().filter(|t| last.binary_search(t).is_err()).count()
}

/// Collects triangles and gives each post one vertex. Kept from frame to frame for its table of vertices.
#[derive(Clone, Debug)]
pub(super) struct MeshBuilder {
    width: usize,
    /// For each post of the root square: the frame in which it last got a vertex, and which.
    slots: Vec<(u32, u32)>,
    frame: u32,
}

impl MeshBuilder {
    pub(super) fn new(side: u32) -> Self {
        let width = side as usize + 1;
        Self { width, slots: vec![(0, 0); width * width], frame: 0 }
    }

    /// A mesh of `triangles` with the heights that `height` gives, asked once a post.
    pub(super) fn build(
        &mut self,
        extent: [u32; 2],
        triangles: &[[Post; 3]],
        mut height: impl FnMut(Post) -> f64,
    ) -> IndexedMesh {
        self.frame += 1;
        let mut vertices = Vec::with_capacity(triangles.len() / 2 + 8);
        let mut index = |p: Post| {
            let slot = &mut self.slots[p.j as usize * self.width + p.i as usize];
            if slot.0 != self.frame {
                *slot = (self.frame, vertices.len() as u32);
                vertices.push(Vertex { post: p, z: height(p) });
            }
            slot.1
        };
        let triangles = triangles.iter().map(|t| t.map(&mut index)).collect();
        IndexedMesh { extent, vertices, triangles }
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.slots.as_slice())
    }
}
