//! T-Strip LOD, after Szoka, "Triangle Strip preserving LOD", 2002.
//!
//! Not triangles are subdivided but lines: rows of square blocks. A line looks for the first and the last of its blocks
//! that are near enough to be split, and everything between the two goes to two lines of half the height. What remains
//! is drawn as triangle strips along the line. A block of size s is split nearer than an interval that is the sum of
//! the rings of the smaller sizes, each as wide as its size times the LOD ratio, that of the smallest doubled: so
//! ratio times s. A block with a split neighbour becomes a *transition block*, a fan around its middle with an additional
//! vertex on each such side (top, bottom, left, right). New vertices rise over the outer half of a block's range.
//!
//! ```text
//!   line of size 4  │       ╲       │╲ │ ╱│        The eye is to the right: block 2 was split, so block 1, its left
//!                   │         ╲     │──┼──│        neighbour, is a transition block.
//! ```
//!
//! There is no preparation: an edit of heights is done when the heights are ([`TStrip::edit`]). Sight lines by the
//! paper's walk are in [`super::tstrip_walk`], culling by polygon fill in [`super::tstrip_fill`].
//!
//! Where it departs: the distance takes the eye's height over the ground beneath it, the same for all blocks, so that
//! with a ratio of at least 1.6 neighbours provably differ by one size at most (a split block of size s is nearer than
//! ratio s; the middle of a neighbour twice its size is at most sqrt(5/2) s further away, which is nearer than 2 ratio s).
//! Lines are not pruned to the frustum before they are split: the mesh is whole, and culling is counted. The paper's
//! trial of a metric of topology is [`Metric::Topology`]; its cracks are documented by the conformity check.

use std::sync::Arc;

use sightline_proto::diamond::Post;

use super::{
    Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target, mesh::MeshBuilder,
    tstrip_walk::SectorMaxima,
};

/// The range of the LOD ratio; the paper shows 4 and 18.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1.6, fine: 1e6 };

/// What decides whether a block is split.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Metric {
    /// Distance alone.
    Distance,
    /// Distance times a factor from 1/4 to 4 that grows with the height of the vertices that a split would add. The
    /// paper does not give its formula: this one is a guess.
    Topology,
}

/// A prepared T-Strip terrain.
#[derive(Debug)]
pub struct TStrip {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    metric: Metric,
    morph: bool,
    sectors: SectorMaxima,
    /// Whether the block with its middle at each post is split.
    split: Vec<bool>,
}

/// A row of blocks: its size, its southern row of posts, and its first block and the one after its last.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Line {
    size: u32,
    south: u32,
    start: u32,
    end: u32,
}

/// A drawn block.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Block {
    pub(super) west: u32,
    pub(super) south: u32,
    pub(super) size: u32,
}

/// Where the eye is, in the ground plane and above the ground, in metres.
#[derive(Clone, Copy, Debug)]
struct Eye {
    east: f64,
    north: f64,
    above: f64,
}

/// The result of a subdivision.
#[derive(Default)]
struct Subdivision {
    blocks: Vec<Block>,
    triangles: Vec<[Post; 3]>,
    /// Blocks on which the metric was evaluated.
    steps: u64,
    strips: u64,
    transitions: u64,
    /// Blocks that were split, with the share to which their new vertices have risen.
    split: Vec<(Block, f64)>,
}

impl TStrip {
    /// Computes the highest post of each cell, for sight lines; the meshes need nothing.
    pub fn new(ground: Arc<Ground>, metric: Metric) -> Self {
        let builder = MeshBuilder::new(ground.side());
        let split = vec![false; (ground.side() as usize + 1).pow(2)];
        let sectors = SectorMaxima::new(&ground);
        Self { ground, builder, metric, morph: false, sectors, split }
    }

    /// Sets the heights of a rectangle of posts, in place, with no other preparation than the sectors that it touches. When
    /// the height map is shared with others it is copied first.
    pub fn edit(&mut self, west: u32, south: u32, columns: u32, rows: u32, mut height: impl FnMut(u32, u32) -> f64) {
        let ground = Arc::make_mut(&mut self.ground);
        let (east, north) = ((west + columns).min(ground.side() + 1), (south + rows).min(ground.side() + 1));
        for j in south..north {
            for i in west..east {
                ground.set_z(i, j, height(i, j));
            }
        }
        self.sectors.update(ground, [west.saturating_sub(1), south.saturating_sub(1)], [east, north]);
    }

    /// The terrain as edited.
    pub fn ground(&self) -> &Ground {
        &self.ground
    }

    /// The walk for sight lines on the terrain and on the mesh of the last update.
    pub fn sectors(&self) -> &SectorMaxima {
        &self.sectors
    }

    /// The metres per post that sizes are measured in.
    fn step_m(&self) -> f64 {
        let scale = self.ground.scale();
        scale.east_m.max(scale.north_m)
    }

    /// The distance of a block's middle from the eye over the interval of its size.
    fn part_of_interval(&self, block: Block, eye: Eye, ratio: f64) -> f64 {
        let scale = self.ground.scale();
        let half = 0.5 * f64::from(block.size);
        let dx = (f64::from(block.west) + half) * scale.east_m - eye.east;
        let dy = (f64::from(block.south) + half) * scale.north_m - eye.north;
        let distance = (dx * dx + dy * dy + eye.above * eye.above).sqrt();
        let factor = match self.metric {
            Metric::Distance => 1.0,
            Metric::Topology => (8.0 * self.roughness(block)).clamp(0.25, 4.0),
        };
        distance / (interval(block.size, ratio) * self.step_m() * factor)
    }

    /// The greatest change of height when a block is split, over its size.
    fn roughness(&self, block: Block) -> f64 {
        let new = new_vertices(block);
        let worst = new.iter().map(|&(p, [a, b])| {
            let z = |p: Post| self.ground.z(p.i, p.j);
            (z(p) - 0.5 * (z(a) + z(b))).abs()
        });
        worst.fold(0.0, f64::max) * self.ground.scale().up_m / (f64::from(block.size) * self.step_m())
    }

    fn subdivide(&mut self, eye: Eye, ratio: f64) -> Subdivision {
        self.split.fill(false);
        let mut result = Subdivision::default();
        let mut lines = vec![Line { size: self.ground.side(), south: 0, start: 0, end: 1 }];
        let mut drawn = Vec::new();
        while let Some(line) = lines.pop() {
            let Some((first, last)) = self.split_line(line, eye, ratio, &mut result) else {
                drawn.push((line, line.start..line.end));
                continue;
            };
            drawn.push((line, line.start..first));
            drawn.push((line, last..line.end));
            let half = line.size / 2;
            lines.push(Line { size: half, south: line.south + half, start: 2 * first, end: 2 * last });
            lines.push(Line { size: half, south: line.south, start: 2 * first, end: 2 * last });
        }
        for (line, blocks) in drawn {
            self.draw(line, blocks, &mut result);
        }
        result
    }

    /// The blocks of a line that are split: from the first to the last that is near enough, found from both ends.
    fn split_line(&mut self, line: Line, eye: Eye, ratio: f64, result: &mut Subdivision) -> Option<(u32, u32)> {
        if line.size == 1 {
            return None;
        }
        let block = |n: u32| Block { west: n * line.size, south: line.south, size: line.size };
        let parts: Vec<f64> = (line.start..line.end).map(|n| self.part_of_interval(block(n), eye, ratio)).collect();
        // Each block is evaluated once: those within are, too, for their morph.
        result.steps += parts.len() as u64;
        let first = line.start + parts.iter().position(|&p| p < 1.0)? as u32;
        let last = line.start + parts.iter().rposition(|&p| p < 1.0)? as u32 + 1;
        for n in first..last {
            let b = block(n);
            let middle = self.ground.index(b.west + b.size / 2, b.south + b.size / 2);
            self.split[middle] = true;
            // The range of the split block's parts is from half its interval to all of it; they rise in the outer half.
            let risen = ((1.0 - parts[(n - line.start) as usize]) * 4.0).clamp(0.0, 1.0);
            result.split.push((b, risen));
        }
        Some((first, last))
    }

    /// Whether a block of the square is split.
    fn is_split(&self, west: Option<u32>, south: Option<u32>, size: u32) -> bool {
        let (Some(west), Some(south)) = (west, south) else { return false };
        let side = self.ground.side();
        west < side && south < side && self.split[self.ground.index(west + size / 2, south + size / 2)]
    }

    /// Which sides of a drawn block are transitions: bottom, right, top, left.
    fn transitions(&self, block: Block) -> [bool; 4] {
        let Block { west, south, size } = block;
        if size == 1 {
            return [false; 4];
        }
        [
            self.is_split(Some(west), south.checked_sub(size), size),
            self.is_split(Some(west + size), Some(south), size),
            self.is_split(Some(west), Some(south + size), size),
            self.is_split(west.checked_sub(size), Some(south), size),
        ]
    }

    fn draw(&self, line: Line, blocks: std::ops::Range<u32>, result: &mut Subdivision) {
        let mut in_strip = false;
        for n in blocks {
            let block = Block { west: n * line.size, south: line.south, size: line.size };
            let transition = self.transitions(block) != [false; 4];
            result.transitions += u64::from(transition);
            result.strips += u64::from(!transition && !in_strip);
            in_strip = !transition;
            result.triangles.extend(self.block_triangles(block));
            result.blocks.push(block);
        }
    }

    /// The triangles of a drawn block.
    pub(super) fn block_triangles(&self, block: Block) -> impl Iterator<Item = [Post; 3]> + use<> {
        let corners = corners(block);
        let [sw, se, ne, nw] = corners;
        let transitions = self.transitions(block);
        let mut out = Vec::with_capacity(8);
        if transitions == [false; 4] {
            out.extend([[sw, se, ne], [sw, ne, nw]]);
        } else {
            let half = block.size / 2;
            let middle = Post::new(block.west + half, block.south + half);
            for (k, transition) in transitions.into_iter().enumerate() {
                let (from, to) = (corners[k], corners[(k + 1) % 4]);
                if transition {
                    let between = Post::new(from.i.midpoint(to.i), from.j.midpoint(to.j));
                    out.extend([[middle, from, between], [middle, between, to]]);
                } else {
                    out.push([middle, from, to]);
                }
            }
        }
        out.into_iter()
    }

    /// The drawn block over a cell: a pass down the tree of lines.
    pub(super) fn block_over(&self, i: u32, j: u32) -> Block {
        let mut size = self.ground.side();
        loop {
            let (west, south) = (i / size * size, j / size * size);
            if size == 1 || !self.is_split(Some(west), Some(south), size) {
                return Block { west, south, size };
            }
            size /= 2;
        }
    }

    /// Heights of vertices that have not fully risen, by their place in the height map; where two blocks share one,
    /// the average of what they say.
    fn risen(&self, split: &[(Block, f64)]) -> std::collections::BTreeMap<usize, f64> {
        let mut sums = std::collections::BTreeMap::new();
        for &(block, part) in split {
            for (p, [a, b]) in new_vertices(block) {
                let z = |p: Post| self.ground.z(p.i, p.j);
                let coarse = 0.5 * (z(a) + z(b));
                let sum = sums.entry(self.ground.index(p.i, p.j)).or_insert((0.0, 0.0));
                *sum = (sum.0 + coarse + part * (z(p) - coarse), sum.1 + 1.0);
            }
        }
        sums.into_iter().map(|(n, (sum, count))| (n, sum / count)).collect()
    }
}

/// The distance within which a block of `size` posts is split, in posts: the rings of all smaller sizes.
fn interval(size: u32, ratio: f64) -> f64 {
    // The ring of blocks of 1 post, doubled, and those of 2, 4, ... up to size / 2.
    let mut sum = 2.0 * ratio;
    let mut ring = 2;
    while ring < size {
        sum += ratio * f64::from(ring);
        ring *= 2;
    }
    sum
}

/// Corners counter-clockwise from the south-west.
fn corners(Block { west, south, size }: Block) -> [Post; 4] {
    [
        Post::new(west, south),
        Post::new(west + size, south),
        Post::new(west + size, south + size),
        Post::new(west, south + size),
    ]
}

/// The vertices that splitting a block adds, each with the two between which it lies: the middle on the diagonal of
/// the strip, and the middles of the sides.
fn new_vertices(block: Block) -> [(Post, [Post; 2]); 5] {
    let c = corners(block);
    let between = |a: Post, b: Post| (Post::new(a.i.midpoint(b.i), a.j.midpoint(b.j)), [a, b]);
    [between(c[0], c[2]), between(c[0], c[1]), between(c[1], c[2]), between(c[2], c[3]), between(c[3], c[0])]
}

impl LevelOfDetail for TStrip {
    /// The setting is the LOD ratio; no error is promised.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        let position = view.eye();
        let above = (position.z - self.ground.ground_m(position)).max(0.0);
        let eye = Eye { east: position.x, north: position.y, above };
        let ratio = match target {
            Target::Setting(ratio) => RANGE.check(ratio)?,
            Target::Triangles(most) => RANGE.steer(most, |ratio| Ok(self.subdivide(eye, ratio).triangles.len()))?,
        };
        let result = self.subdivide(eye, ratio);
        let risen = if self.morph { self.risen(&result.split) } else { Default::default() };
        let ground = &self.ground;
        let height = |p: Post| risen.get(&ground.index(p.i, p.j)).copied().unwrap_or_else(|| ground.z(p.i, p.j));
        let mesh = self.builder.build([ground.side(); 2], &result.triangles, height);
        let statistics = Statistics {
            setting: ratio,
            decisions: result.steps,
            splits: result.split.len() as u64,
            strips: result.strips,
            fans: result.transitions,
            ..Statistics::default()
        };
        Ok(Frame { mesh, bound_px: None, statistics })
    }

    fn memory_bytes(&self) -> usize {
        self.split.len() + self.sectors.bytes() + self.builder.bytes()
    }

    fn set_morph(&mut self, morph: bool) {
        self.morph = morph;
    }
}

#[cfg(test)]
mod tests {
    use super::super::{conformity, measure::vertical_error};
    use super::*;
    use crate::terrain::{
        MemoryField, SceneScale,
        synthetic::{fractal, fractal_height},
    };

    fn ground(side: u32) -> Arc<Ground> {
        Ground::read(&fractal(side + 1, side + 1, 4, 300).unwrap(), SceneScale::UNIT).unwrap()
    }

    /// An eye in the ground, so at height 0 above it.
    fn view(x: f64, y: f64) -> LodView {
        LodView::new(glam::DVec3::new(x, y, -400.0), glam::DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap()
    }

    #[test]
    fn a_map_of_32_cells_takes_341_steps_where_a_binary_tree_takes_2046() {
        let mut strips = TStrip::new(ground(32), Metric::Distance);
        let frame = strips.update(&view(16.0, 16.0), Target::Setting(RANGE.fine)).unwrap();
        // 1 + 4 + 16 + 64 + 256 blocks of 32, 16, 8, 4 and 2 cells a side; single cells are not split.
        assert_eq!(frame.statistics.decisions, 341);
        assert_eq!((4_u32.pow(5) - 1) / 3, 341, "the paper's sum for N = 10");
        assert_eq!(frame.mesh.len(), 2 * 32 * 32);
        assert_eq!(frame.statistics.strips, 32, "each row is one strip");
        // A tree of two root triangles has 2 + 4 + ... + 2^10 triangles in ten levels, and the last are those of 32 x 32.
        assert_eq!((1..=10).map(|level| 1 << level).sum::<u32>(), 2046);
        assert_eq!(1 << 11, frame.mesh.len(), "one level more than the paper counts: half cells");
    }

    #[test]
    fn intervals_by_hand() {
        // Ratio 4: rings of 4 (doubled: 8), 8, 16, 32, ... posts.
        assert_eq!([2, 4, 8, 16].map(|size| interval(size, 4.0)), [8.0, 16.0, 32.0, 64.0]);
    }

    #[test]
    fn the_topology_metric_cracks_and_the_distance_metric_does_not() {
        // Flat in the west, rough in the east: there the factors differ sixteenfold.
        let height = |i: u32, j: u32| if i <= 64 { 0 } else { fractal_height(i, j, 4, 300) };
        let field = MemoryField::from_fn(129, 129, |i, j| Some(f64::from(height(i, j)))).unwrap();
        let ground = Ground::read(&field, SceneScale::UNIT).unwrap();
        let mut cracked = 0;
        for (metric, x) in
            [(Metric::Distance, 3.0), (Metric::Distance, 70.0), (Metric::Topology, 3.0), (Metric::Topology, 70.0)]
        {
            let mut strips = TStrip::new(Arc::clone(&ground), metric);
            let frame = strips.update(&view(x, 40.0), Target::Triangles(3000)).unwrap();
            let found = conformity::check(&frame.mesh).unwrap();
            match metric {
                Metric::Distance => assert_eq!(found.t_junctions, 0),
                Metric::Topology => cracked += found.t_junctions,
            }
        }
        assert!(cracked > 0);
    }

    #[test]
    fn vertices_rise_from_where_they_were_not() {
        let mut strips = TStrip::new(ground(64), Metric::Distance);
        strips.set_morph(true);
        let frame = strips.update(&view(20.0, 40.0), Target::Setting(4.0)).unwrap();
        let moved = frame.mesh.vertices.iter().filter(|v| v.z != strips.ground.z(v.post.i, v.post.j)).count();
        assert!(moved > 0 && moved < frame.mesh.vertices.len());
        assert_eq!(conformity::check(&frame.mesh).unwrap().t_junctions, 0);
    }

    #[test]
    fn an_edit_is_seen_at_once() {
        let mut strips = TStrip::new(ground(64), Metric::Distance);
        strips.edit(30, 30, 3, 3, |_, _| 5000.0);
        let fresh = TStrip::new(Arc::clone(&strips.ground), Metric::Distance);
        assert_eq!(strips.sectors, fresh.sectors);
        let frame = strips.update(&view(31.0, 31.0), Target::Setting(RANGE.fine)).unwrap();
        assert!(vertical_error(&frame.mesh, &strips.ground).max_at_posts < 1e-9);
        assert!(frame.mesh.vertices.iter().any(|v| v.z == 5000.0));
    }
}
