//! GEOmancy, a tiled ROAM for games, after White, "GEOmancy" (International Journal of Computer Games Technology, 2008).
//!
//! The terrain is cut into tiles of 2^n + 1 posts, each a pair of *implicit bintrees*: fixed arrays in which node k has
//! the children 2k + 1 and 2k + 2. A node's variance is the distance of its base's midpoint from the terrain, or the
//! greater one of its children. Every tree has a split queue and a merge queue, fixed arrays in the order of
//! variance; since variance over the distance of the *tile* is compared with a threshold, that order never changes.
//! Splits are forced across trees through one neighbour map, which serves all trees ([`neighbours`]). The split queue
//! holds all visible triangles, so a tile's index buffer is read off it, and only buffers that changed are sent again.
//!
//! Tiles without a cell of the grid are void: not built and not drawn, and padding inside tiles is drawn.
//!
//! Where it departs:
//! - Merging takes both triangles of a diamond, when both are below the threshold. The paper's merge operation names
//!   one node only, which would tear the mesh.
//! - After merging until nothing more can be, and splitting after that, the mesh depends on the view alone: the
//!   least that holds every node above the threshold. The paper does not say in which order the two happen.
//! - The tile's distance is that of the middle of its bounding box; the paper does not say.

mod neighbours;
mod queue;
mod tree;

use std::sync::Arc;

use sightline_proto::diamond::Post;

use self::{
    neighbours::{Link, NeighbourMap},
    tree::{Shape, Tree, parent},
};
use super::{
    Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target, mesh::MeshBuilder, tiles::Tiles,
};

/// The range of the threshold in pixels; the paper tries 1 to 7.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1e6, fine: 1e-6 };

/// Bytes of one index: 33 x 33 vertices need two.
const INDEX_BYTES: u64 = 2;

/// A prepared GEOmancy terrain. Keeps its mesh from frame to frame.
#[derive(Debug)]
pub struct Geomancy {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    tiles: Tiles,
    map: NeighbourMap,
    /// The posts of every node, for the south-eastern and the north-western tree of a tile.
    shapes: [Shape; 2],
    /// Two for each tile: south-east, north-west.
    trees: Vec<Tree>,
    /// The index buffers as last sent.
    buffers: Vec<Vec<u16>>,
    splits: u64,
    merges: u64,
    decisions: u64,
}

impl Geomancy {
    /// Computes the variances of all trees, the neighbour map and the queues.
    pub fn new(ground: Arc<Ground>) -> Self {
        let tiles = Tiles::new(&ground);
        let n = tiles.cells;
        let shapes = [Shape::new(n, [[n, 0], [n, n], [0, 0]]), Shape::new(n, [[0, n], [0, 0], [n, n]])];
        let map = NeighbourMap::new(shapes[0].len());
        let trees = (0..2 * tiles.len())
            .map(|t| {
                Tree::new(&shapes[t % 2], |u, v| {
                    let origin = tiles.origin(t / 2);
                    ground.z(origin.i + u, origin.j + v) * ground.scale().up_m
                })
            })
            .collect();
        let (builder, buffers) = (MeshBuilder::new(ground.side()), vec![Vec::new(); tiles.len()]);
        Self { ground, builder, tiles, map, shapes, trees, buffers, splits: 0, merges: 0, decisions: 0 }
    }

    /// The tree that a link of a tree leads to; `None` at the edge of the terrain.
    fn linked(&self, tree: usize, link: Link) -> Option<usize> {
        let [south, east, north, west] = self.tiles.neighbours(tree / 2);
        let tile = match (link, tree % 2) {
            (Link::Same, _) => return Some(tree),
            (Link::Hypotenuse, _) => return Some(tree ^ 1),
            (Link::Left, 0) => east,
            (Link::Left, _) => west,
            (Link::Right, 0) => south,
            (Link::Right, _) => north,
        };
        // Across a tile's edge lies the other kind of tree.
        tile.map(|tile| 2 * tile + 1 - tree % 2)
    }

    /// The triangle that shares the base of a node: its tree and its node.
    fn partner(&self, tree: usize, node: u32) -> Option<(usize, u32)> {
        let (link, index) = self.map.base(node);
        Some((self.linked(tree, link)?, index))
    }

    /// Splits a node that is in the mesh, and its partner; forces coarser neighbours first.
    fn split(&mut self, tree: usize, node: u32) {
        if self.trees[tree].is_split(node) {
            return;
        }
        let partner = self.partner(tree, node);
        if let Some((other, index)) = partner {
            // Base to edge: the partner does not exist yet, but the node above it does.
            if index > 0 && !self.trees[other].is_split(parent(index)) {
                self.split(other, parent(index));
            }
            self.trees[other].split(index);
            self.splits += 1;
        }
        self.trees[tree].split(node);
        self.splits += 1;
    }

    /// Merges what the thresholds allow until nothing more can be. `most[t]` is the greatest variance that tree t may
    /// leave unsplit.
    fn merge_all(&mut self, most: &[f32]) {
        let mut again = true;
        while again {
            again = false;
            for (tree, &limit) in most.iter().enumerate() {
                for node in self.trees[tree].mergeable(limit) {
                    self.decisions += 1;
                    again |= self.merge(tree, node, most);
                }
            }
        }
    }

    fn merge(&mut self, tree: usize, node: u32, most: &[f32]) -> bool {
        if !self.trees[tree].can_merge(node) {
            return false;
        }
        if let Some((other, index)) = self.partner(tree, node) {
            if !self.trees[other].can_merge(index) || self.trees[other].variance(index) > most[other] {
                return false;
            }
            self.trees[other].merge(index);
            self.merges += 1;
        }
        self.trees[tree].merge(node);
        self.merges += 1;
        true
    }

    /// The greatest variance that each tree may leave unsplit: threshold * distance / pixels, in metres.
    fn limits(&self, view: &LodView, threshold_px: f64) -> Vec<f32> {
        let of_tile = |tile: usize| {
            let distance = (self.tiles.centre(&self.ground, tile) - view.eye()).length().max(view.near_m());
            (threshold_px * distance / view.pixels()) as f32
        };
        (0..self.trees.len()).map(|tree| of_tile(tree / 2)).collect()
    }

    fn refine(&mut self, view: &LodView, threshold_px: f64) -> usize {
        let most = self.limits(view, threshold_px);
        self.merge_all(&most);
        for (tree, &limit) in most.iter().enumerate() {
            while let Some(node) = self.trees[tree].next_split(limit) {
                self.decisions += 1;
                self.split(tree, node);
            }
        }
        self.trees.iter().map(Tree::triangles).sum()
    }

    /// The index buffer of a tile: its vertices are numbered row by row.
    fn index_buffer(&self, tile: usize) -> Vec<u16> {
        let width = self.tiles.cells + 1;
        let mut buffer = Vec::new();
        for half in 0..2 {
            for node in self.trees[2 * tile + half].visible() {
                let [apex, left, right] = self.shapes[half].corners(node);
                buffer.extend([left, right, apex].map(|[u, v]| (v * width + u) as u16));
            }
        }
        buffer
    }

    /// Renews the index buffers; those that changed count as sent.
    fn send(&mut self, statistics: &mut Statistics) {
        for tile in 0..self.tiles.len() {
            let buffer = self.index_buffer(tile);
            if buffer != self.buffers[tile] {
                statistics.dirty_tiles += 1;
                statistics.index_bytes += INDEX_BYTES * buffer.len() as u64;
                self.buffers[tile] = buffer;
            }
        }
    }
}

impl LevelOfDetail for Geomancy {
    /// The setting is the threshold in pixels, which it also promises.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        (self.splits, self.merges, self.decisions) = (0, 0, 0);
        let threshold = match target {
            Target::Setting(threshold) => RANGE.check(threshold)?,
            Target::Triangles(most) => RANGE.steer(most, |threshold| Ok(self.refine(view, threshold)))?,
        };
        self.refine(view, threshold);
        let mut statistics = Statistics {
            setting: threshold,
            splits: self.splits,
            merges: self.merges,
            decisions: self.decisions,
            ..Statistics::default()
        };
        self.send(&mut statistics);
        let width = self.tiles.cells + 1;
        let mut triangles = Vec::new();
        for (tile, buffer) in self.buffers.iter().enumerate() {
            let origin = self.tiles.origin(tile);
            let post = |n: u16| Post::new(origin.i + u32::from(n) % width, origin.j + u32::from(n) / width);
            triangles.extend(buffer.chunks_exact(3).map(|t| [post(t[0]), post(t[1]), post(t[2])]));
        }
        let ground = &self.ground;
        let mesh = self.builder.build(self.tiles.extent(), &triangles, |p| ground.z(p.i, p.j));
        Ok(Frame { mesh, bound_px: Some(threshold), statistics })
    }

    fn memory_bytes(&self) -> usize {
        let buffers: usize = self.buffers.iter().map(|b| size_of_val(b.as_slice())).sum();
        let trees: usize = self.trees.iter().map(Tree::bytes).sum();
        trees + buffers + self.map.bytes() + 2 * self.shapes[0].bytes() + self.builder.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{SceneScale, synthetic::fractal};

    fn terrain(nx: u32, ny: u32) -> Geomancy {
        Geomancy::new(Ground::read(&fractal(nx, ny, 12, 400).unwrap(), SceneScale::UNIT).unwrap())
    }

    #[test]
    fn every_partner_shares_the_base_of_its_node() {
        let system = terrain(97, 70);
        let corners = |tree: usize, node: u32| {
            let origin = system.tiles.origin(tree / 2);
            system.shapes[tree % 2].corners(node).map(|[u, v]| (origin.i + u, origin.j + v))
        };
        let [width, height] = system.tiles.extent();
        for tree in 0..system.trees.len() {
            for node in 0..system.shapes[0].len() {
                let [_, left, right] = corners(tree, node);
                match system.partner(tree, node) {
                    Some((other, index)) => {
                        let [_, l, r] = corners(other, index);
                        assert_eq!((l, r), (right, left), "tree {tree}, node {node}");
                    }
                    None => assert!(
                        (left.0 == right.0 && (left.0 == 0 || left.0 == width))
                            || (left.1 == right.1 && (left.1 == 0 || left.1 == height)),
                        "tree {tree}, node {node} has no partner inside the terrain"
                    ),
                }
            }
        }
    }

    #[test]
    fn the_mesh_does_not_depend_on_the_frames_before() {
        let mut flown = terrain(97, 97);
        for n in 0..8 {
            let eye = glam::DVec3::new(12.0 * f64::from(n), 20.0 + 7.0 * f64::from(n), 300.0);
            let view = LodView::new(eye, glam::DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
            let threshold = [1.0, 40.0, 7.0, 200.0][n as usize % 4];
            let frame = flown.update(&view, Target::Setting(threshold)).unwrap();
            let mut fresh = terrain(97, 97);
            let from_scratch = fresh.update(&view, Target::Setting(threshold)).unwrap();
            assert_eq!(frame.mesh.plan(), from_scratch.mesh.plan(), "frame {n}");
            let still = flown.update(&view, Target::Setting(threshold)).unwrap();
            assert_eq!((still.statistics.dirty_tiles, still.statistics.index_bytes), (0, 0));
            assert_eq!((still.statistics.splits, still.statistics.merges), (0, 0));
        }
    }
}
