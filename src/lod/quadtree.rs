//! Quadtree with continuous level of detail, after Roettger, Heidrich, Slusallek and Seidel, "Real-Time Generation of
//! Continuous Levels of Detail for Height Fields", 1998, as Inam's thesis (2005), section 2.2.2, restates it.
//!
//! A block of edge length d is refined when f = l / (d C max(c d2, 1)) < 1, l being the distance of the eye, C the
//! minimum and c the desired global resolution, and d2 the block's roughness: the greatest of six height differences (its four
//! edge midpoints and both diagonals at the centre), over d. A refined block is a fan around its centre; an edge
//! midpoint that the neighbour lacks is skipped; quadrants that are refined themselves are left out of the fan. Heights
//! are blended with b = 2 (1 - f), clamped, the lesser one of the two blocks on a shared edge, kept in one byte.
//!
//! ```text
//!   ┌─────┬─────┐     A refined block, its south-west quadrant refined in turn, with a coarser
//!   │ ╲   │   ╱ │     neighbour in the east: that edge midpoint is skipped.
//!   │   ╲ │ ╱   │
//!   ├──┬──c     │
//!   ├──┼──┤ ╲   │
//!   └──┴──┴───╲─┘
//! ```
//!
//! Where it departs:
//! - The neighbours of a refined block must exist, so d2 grows up the tree: a block's is at least K times that of the
//!   blocks of half its size within and beside it. The paper's K is C / (2 (C - 1)); that holds only for blocks whose
//!   centres are at most d apart. [`Quadtree::spread`] derives the constant used here. It costs triangles;
//!   the shared tests find no mesh that the paper's constant tears.
//! - l is the paper's sum of absolute differences, but its height term is that of the eye over the ground beneath it,
//!   the same for all blocks: with each block's own height the derivation would not hold.
//! - d is in metres, the longer of a block's sides where posts are not square.
//! - Blending starts from the heights as drawn on the level above, so blends of several levels agree.

use std::sync::Arc;

use glam::DVec3;
use sightline_proto::diamond::Post;

use super::{Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target, mesh::MeshBuilder};

/// The C of the paper: with 8 it found the picture good. At least 2.
pub(super) const MINIMUM_RESOLUTION: f64 = 8.0;
/// The range of c.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1e-3, fine: 1e6 };

/// A prepared quadtree.
#[derive(Debug)]
pub struct Quadtree {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    minimum_resolution: f64,
    morph: bool,
    /// d2 of the block with its centre at each post, spread; 0 where there is none.
    roughness: Vec<f32>,
    /// One byte a vertex: the blend of the refined block with its centre there, 1 to 255; 0 where no block is refined.
    blend: Vec<u8>,
    /// Drawn heights, as far as blending changed them.
    drawn: Vec<f64>,
}

/// A block: its centre and half its edge length, in posts.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Block {
    i: u32,
    j: u32,
    half: u32,
}

impl Block {
    fn quadrants(self) -> [Self; 4] {
        let h = self.half / 2;
        [(-1, -1), (1, -1), (1, 1), (-1, 1)].map(|(di, dj): (i32, i32)| Self {
            i: self.i.wrapping_add_signed(di * h as i32),
            j: self.j.wrapping_add_signed(dj * h as i32),
            half: h,
        })
    }

    /// Corners counter-clockwise from the south-west.
    fn corners(self) -> [Post; 4] {
        let Self { i, j, half: h } = self;
        [Post::new(i - h, j - h), Post::new(i + h, j - h), Post::new(i + h, j + h), Post::new(i - h, j + h)]
    }

    /// Midpoints of the edges: south, east, north, west.
    fn midpoints(self) -> [Post; 4] {
        let Self { i, j, half: h } = self;
        [Post::new(i, j - h), Post::new(i + h, j), Post::new(i, j + h), Post::new(i - h, j)]
    }

    /// The blocks of the same size beyond those edges; `None` outside the square.
    fn neighbours(self, side: u32) -> [Option<Self>; 4] {
        let d = 2 * self.half;
        let at = |i: Option<u32>, j: Option<u32>| {
            let (i, j) = (i.filter(|&v| v < side)?, j.filter(|&v| v < side)?);
            Some(Self { i, j, half: self.half })
        };
        let (i, j) = (self.i, self.j);
        [
            at(Some(i), j.checked_sub(d)),
            at(Some(i + d), Some(j)),
            at(Some(i), Some(j + d)),
            at(i.checked_sub(d), Some(j)),
        ]
    }
}

impl Quadtree {
    /// Computes and spreads the roughness of all blocks.
    pub fn new(ground: Arc<Ground>, minimum_resolution: f64) -> Self {
        let posts = (ground.side() as usize + 1).pow(2);
        let builder = MeshBuilder::new(ground.side());
        let mut tree = Self {
            ground,
            builder,
            minimum_resolution: minimum_resolution.max(2.0),
            morph: false,
            roughness: vec![0.0; posts],
            blend: vec![0; posts],
            drawn: Vec::new(),
        };
        tree.measure();
        tree
    }

    fn root(&self) -> Block {
        let half = self.ground.side() / 2;
        Block { i: half, j: half, half }
    }

    fn at(&self, block: Block) -> usize {
        self.ground.index(block.i, block.j)
    }

    /// The edge length of a block in metres.
    fn edge_m(&self, block: Block) -> f64 {
        let scale = self.ground.scale();
        f64::from(2 * block.half) * scale.east_m.max(scale.north_m)
    }

    /// d2 of a block alone: the greatest of the six differences, over the edge length.
    fn roughness(&self, block: Block) -> f64 {
        let z = |p: Post| self.ground.z(p.i, p.j);
        let (corner, middle) = (block.corners().map(z), block.midpoints().map(z));
        let centre = self.ground.z(block.i, block.j);
        let mut worst = 0.0_f64;
        for k in 0..4 {
            worst = worst.max((middle[k] - 0.5 * (corner[k] + corner[(k + 1) % 4])).abs());
        }
        for k in 0..2 {
            worst = worst.max((centre - 0.5 * (corner[k] + corner[k + 2])).abs());
        }
        worst * self.ground.scale().up_m / self.edge_m(block)
    }

    /// The constant K with which roughness spreads.
    ///
    /// Let a block of edge d be refined: l < d C D with D = max(c d2, 1). The block of edge 2d beside it is refined when
    /// l' < 2 d C D'. The sum of absolute differences of their centres is at most 3/2 d + 1/2 d = 2d, so l' < d C D + 2d,
    /// and D' >= D (C + 2) / (2 C) is enough, since D >= 1. Where c d2 <= 1 that is D' >= 1, for C >= 2: given. Else
    /// D' >= c K d2 with K = (C + 2) / (2 C).
    fn spread(&self) -> f64 {
        (self.minimum_resolution + 2.0) / (2.0 * self.minimum_resolution)
    }

    fn measure(&mut self) {
        let side = self.ground.side();
        let spread = self.spread();
        let mut half = 1;
        while half <= side / 2 {
            for j in (half..side).step_by(2 * half as usize) {
                for i in (half..side).step_by(2 * half as usize) {
                    let block = Block { i, j, half };
                    let mut d2 = self.roughness(block);
                    for smaller in self.smaller(block) {
                        d2 = d2.max(spread * f64::from(self.roughness[self.at(smaller)]));
                    }
                    let n = self.at(block);
                    // Rounded up, so that rounding does not undo the spread.
                    self.roughness[n] = (d2 as f32).next_up();
                }
            }
            half *= 2;
        }
    }

    /// The blocks of half the size that lie within a block or touch it with an edge.
    fn smaller(&self, block: Block) -> impl Iterator<Item = Block> + use<> {
        let h = block.half / 2;
        let side = i64::from(self.ground.side());
        let steps: &[(i64, i64)] = if h == 0 {
            &[]
        } else {
            &[
                (-1, -1),
                (1, -1),
                (1, 1),
                (-1, 1),
                (-3, -1),
                (-3, 1),
                (3, -1),
                (3, 1),
                (-1, -3),
                (1, -3),
                (-1, 3),
                (1, 3),
            ]
        };
        steps.iter().filter_map(move |(a, b)| {
            let (i, j) = (i64::from(block.i) + a * i64::from(h), i64::from(block.j) + b * i64::from(h));
            ((0..side).contains(&i) && (0..side).contains(&j)).then_some(Block { i: i as u32, j: j as u32, half: h })
        })
    }

    /// f of a block for an eye.
    fn f(&self, block: Block, eye: &Eye, c: f64) -> f64 {
        let scale = self.ground.scale();
        let l = (f64::from(block.i) * scale.east_m - eye.position.x).abs()
            + (f64::from(block.j) * scale.north_m - eye.position.y).abs()
            + eye.height_m;
        let d2 = f64::from(self.roughness[self.at(block)]);
        l / (self.edge_m(block) * self.minimum_resolution * (c * d2).max(1.0))
    }

    /// Marks the refined blocks, coarse ones first.
    fn refine(&mut self, eye: &Eye, c: f64) -> Refined {
        self.blend.fill(0);
        let mut refined = Refined { blocks: Vec::new(), decisions: 0 };
        if self.root().half == 0 {
            return refined;
        }
        let root = self.root();
        let n = self.at(root);
        self.blend[n] = u8::MAX;
        refined.blocks.push(root);
        let mut next = 0;
        while next < refined.blocks.len() {
            let block = refined.blocks[next];
            next += 1;
            if block.half == 1 {
                continue;
            }
            for quadrant in block.quadrants() {
                refined.decisions += 1;
                let f = self.f(quadrant, eye, c);
                if f < 1.0 {
                    let n = self.at(quadrant);
                    let b = (2.0 * (1.0 - f)).clamp(0.0, 1.0);
                    self.blend[n] = 1 + (b * 254.0) as u8;
                    refined.blocks.push(quadrant);
                }
            }
        }
        refined
    }

    fn is_refined(&self, block: Block) -> bool {
        self.blend[self.at(block)] != 0
    }

    /// Which edge midpoints of a refined block are in the mesh: those that its neighbour has too, and the border's.
    fn has_midpoints(&self, block: Block) -> [bool; 4] {
        block.neighbours(self.ground.side()).map(|n| n.is_none_or(|n| self.is_refined(n)))
    }

    /// The fan of a refined block, without its refined quadrants.
    fn fan(&self, block: Block, out: &mut Vec<[Post; 3]>) {
        let centre = Post::new(block.i, block.j);
        let (corners, midpoints, has) = (block.corners(), block.midpoints(), self.has_midpoints(block));
        let open = if block.half == 1 { [true; 4] } else { block.quadrants().map(|q| !self.is_refined(q)) };
        // Edge k runs from corner k to corner k + 1, past midpoint k; its first half borders quadrant k.
        for k in 0..4 {
            let (from, to) = (corners[k], corners[(k + 1) % 4]);
            if !has[k] {
                debug_assert!(open[k] && open[(k + 1) % 4], "a refined quadrant has a neighbour");
                out.push([centre, from, to]);
                continue;
            }
            if open[k] {
                out.push([centre, from, midpoints[k]]);
            }
            if open[(k + 1) % 4] {
                out.push([centre, midpoints[k], to]);
            }
        }
    }

    fn triangles(&mut self, eye: &Eye, c: f64) -> (Vec<[Post; 3]>, Refined) {
        let refined = self.refine(eye, c);
        let mut out = Vec::new();
        for &block in &refined.blocks {
            self.fan(block, &mut out);
        }
        if refined.blocks.is_empty() {
            let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| Post::new(i, j));
            out.extend([[a, b, c], [a, c, d]]);
        }
        (out, refined)
    }

    /// Blends the heights of the vertices of refined blocks, coarse ones first.
    fn blend(&mut self, blocks: &[Block]) {
        let side = self.ground.side();
        let mut drawn = std::mem::take(&mut self.drawn);
        drawn.clear();
        drawn.extend((0..=side).flat_map(|j| (0..=side).map(move |i| (i, j))).map(|(i, j)| self.ground.z(i, j)));
        let own = |block: Block| f64::from(self.blend[self.at(block)] - 1) / 254.0;
        let index = |p: Post| self.ground.index(p.i, p.j);
        // The height of post p, blended from the middle of the edge between two vertices that are drawn already.
        let blended = |drawn: &[f64], p: Post, [from, to]: [Post; 2], b: f64| {
            let coarse = 0.5 * (drawn[index(from)] + drawn[index(to)]);
            coarse + b * (self.ground.z(p.i, p.j) - coarse)
        };
        for &block in blocks {
            let corners = block.corners();
            let has = self.has_midpoints(block);
            if block != self.root() {
                // The parent's fan has an edge from its centre, one of the corners, to the opposite one.
                let k = corners.iter().position(|p| is_centre_of_parent(block, *p)).unwrap_or(0);
                let centre = Post::new(block.i, block.j);
                drawn[index(centre)] = blended(&drawn, centre, [corners[k], corners[(k + 2) % 4]], own(block));
            }
            for k in (0..4).filter(|&k| has[k]) {
                let b = match block.neighbours(side)[k] {
                    Some(other) => own(block).min(own(other)),
                    None => own(block),
                };
                let p = block.midpoints()[k];
                drawn[index(p)] = blended(&drawn, p, [corners[k], corners[(k + 1) % 4]], b);
            }
        }
        self.drawn = drawn;
    }
}

/// Whether a corner of a block is the centre of the block twice its size that contains it.
fn is_centre_of_parent(block: Block, corner: Post) -> bool {
    let h = 2 * block.half;
    corner.i % (2 * h) == h && corner.j % (2 * h) == h
}

/// Where the eye is: in the scene frame, and how far above the ground.
struct Eye {
    position: DVec3,
    height_m: f64,
}

/// The refined blocks, coarse ones first.
struct Refined {
    blocks: Vec<Block>,
    decisions: u64,
}

impl LevelOfDetail for Quadtree {
    /// The setting is c. It promises no error in pixels.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        let position = view.eye();
        let eye = Eye { position, height_m: (position.z - self.ground.ground_m(position)).max(0.0) };
        let c = match target {
            Target::Setting(c) => RANGE.check(c)?,
            Target::Triangles(most) => RANGE.steer(most, |c| Ok(self.triangles(&eye, c).0.len()))?,
        };
        let (triangles, refined) = self.triangles(&eye, c);
        if self.morph {
            self.blend(&refined.blocks);
        }
        let (ground, drawn, morph) = (&self.ground, &self.drawn, self.morph);
        let height = |p: Post| if morph { drawn[ground.index(p.i, p.j)] } else { ground.z(p.i, p.j) };
        let mesh = self.builder.build([ground.side(); 2], &triangles, height);
        let statistics = Statistics {
            setting: c,
            decisions: refined.decisions,
            fans: refined.blocks.len() as u64,
            ..Statistics::default()
        };
        Ok(Frame { mesh, bound_px: None, statistics })
    }

    fn memory_bytes(&self) -> usize {
        size_of_val(self.roughness.as_slice()) + self.blend.len() + self.builder.bytes()
    }

    fn set_morph(&mut self, morph: bool) {
        self.morph = morph;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{MemoryField, SceneScale};

    /// Heights of the 5 x 5 block, north row first.
    const BLOCK: [[f64; 5]; 5] = [
        [4.0, 0.0, 2.0, 0.0, 8.0],
        [0.0, 1.0, 0.0, 0.0, 0.0],
        [6.0, 0.0, 9.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, 3.0, 0.0],
        [2.0, 0.0, 5.0, 0.0, 4.0],
    ];

    fn five_by_five() -> Quadtree {
        let field = MemoryField::from_fn(5, 5, |i, j| Some(BLOCK[4 - j as usize][i as usize])).unwrap();
        Quadtree::new(Ground::read(&field, SceneScale::UNIT).unwrap(), MINIMUM_RESOLUTION)
    }

    #[test]
    fn d2_and_f_of_one_5_by_5_block_by_hand() {
        let tree = five_by_five();
        // Edges: south 5 - (2 + 4) / 2 = 2; east 1 - (4 + 8) / 2 = -5; north 2 - (8 + 4) / 2 = -4;
        // west 6 - (4 + 2) / 2 = 3. Diagonals: 9 - (2 + 8) / 2 = 4; 9 - (4 + 4) / 2 = 5. The greatest, 5, over d = 4.
        let root = tree.root();
        assert_eq!(tree.roughness(root), 1.25);
        // The smaller blocks are rougher: the one in the south-west has corners 2, 5, 9, 6 and nothing but 0 between
        // them. Its edges: 7/2, 7, 15/2, 4; diagonals 11/2, 11/2. So 7.5 over 2, which spreads with K = 10 / 16.
        let south_west = Block { i: 1, j: 1, half: 1 };
        assert_eq!(tree.roughness(south_west), 3.75);
        assert_eq!(tree.spread(), 0.625);
        let spread = f64::from(tree.roughness[tree.at(root)]);
        // The roughest small block is that in the north-east: 2, 8, 1, 9 around zeros: (8 + 2) / 2 = 5, 9/2, 5, 11/2,
        // centre (9 + 8) / 2 = 17/2: 8.5 over 2 is 4.25.
        assert_eq!(tree.roughness(Block { i: 3, j: 3, half: 1 }), 4.25);
        assert!((spread - 4.25 * 0.625).abs() < 1e-5, "more than the 1.25 of its own: {spread}");
        // An eye 12 posts east of the centre, 4 above the ground: l = 16. f = 16 / (4 * 8 * max(2 * 2.65625, 1)).
        let eye = Eye { position: DVec3::new(14.0, 2.0, 0.0), height_m: 4.0 };
        let f = tree.f(root, &eye, 2.0);
        assert!((f - 16.0 / (32.0 * 5.3125)).abs() < 1e-6, "{f}");
        // With a coarse c the minimum resolution decides: 16 / 32.
        assert_eq!(tree.f(root, &eye, 0.1), 0.5);
    }
}
