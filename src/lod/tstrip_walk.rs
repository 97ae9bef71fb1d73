//! Sight lines by the walk of Szoka, "Triangle Strip preserving LOD", 2002, section "Collision Detection".
//!
//! The line is drawn over the map cell by cell (the "line-to" path). A cell whose highest post lies below the line is
//! passed by; in others the line is tested against their triangles. On the mesh the path goes from block to block. The
//! arithmetic is rounded f64, as in an engine: near ties it is wrong now and then, which is what the trade report
//! wants to know. It decides nothing elsewhere.
//!
//! It departs in keeping maxima as f64, not as bytes, and in cutting cells along the diagonals of the finest surface.

use sightline_proto::diamond::{Post, diagonal_rises};

use super::{Ground, tstrip::TStrip};

/// The greatest height of each cell's posts, row by row.
#[derive(Clone, PartialEq, Debug)]
pub struct SectorMaxima {
    side: u32,
    maxima: Vec<f64>,
}

impl SectorMaxima {
    pub(super) fn new(ground: &Ground) -> Self {
        let side = ground.side();
        let mut sectors = Self { side, maxima: vec![0.0; (side as usize).pow(2)] };
        sectors.update(ground, [0, 0], [side, side]);
        sectors
    }

    /// Takes the cells from `low` up to, not including, `high` from the ground again.
    pub(super) fn update(&mut self, ground: &Ground, low: [u32; 2], high: [u32; 2]) {
        for j in low[1]..high[1].min(self.side) {
            for i in low[0]..high[0].min(self.side) {
                let posts = [ground.z(i, j), ground.z(i + 1, j), ground.z(i, j + 1), ground.z(i + 1, j + 1)];
                self.maxima[j as usize * self.side as usize + i as usize] =
                    posts.into_iter().fold(f64::NEG_INFINITY, f64::max);
            }
        }
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.maxima.as_slice())
    }

    /// Whether AB passes below the finest surface, in rounded arithmetic. Ends in the grid frame.
    pub fn blocked_by_terrain(&self, ground: &Ground, a: [f64; 3], b: [f64; 3]) -> bool {
        let lowest = |from: f64, to: f64| {
            let z = |t: f64| a[2] + t * (b[2] - a[2]);
            z(from).min(z(to))
        };
        self.cells(ground, a, b).any(|(i, j, [from, to])| {
            if lowest(from, to) >= self.maxima[j as usize * self.side as usize + i as usize] {
                return false;
            }
            let p = |di: u32, dj: u32| Post::new(i + di, j + dj);
            let halves = if diagonal_rises(p(0, 0)) {
                [[p(0, 0), p(1, 0), p(1, 1)], [p(0, 0), p(1, 1), p(0, 1)]]
            } else {
                [[p(0, 0), p(1, 0), p(0, 1)], [p(1, 0), p(1, 1), p(0, 1)]]
            };
            halves.iter().any(|t| hits(ground, *t, a, b))
        })
    }

    /// The cells of the grid over which AB passes, each with the part of AB there.
    fn cells(&self, ground: &Ground, a: [f64; 3], b: [f64; 3]) -> impl Iterator<Item = (u32, u32, [f64; 2])> + use<> {
        let cells = [ground.grid().nx() - 1, ground.grid().ny() - 1];
        let d = [b[0] - a[0], b[1] - a[1]];
        // The parameters at which AB crosses columns and rows of posts, in order.
        let crossings = |axis: usize| {
            let (low, high) =
                (a[axis].min(b[axis]).ceil().max(0.0), a[axis].max(b[axis]).floor().min(f64::from(cells[axis])));
            let count = if d[axis] != 0.0 && low <= high { (high - low) as u32 + 1 } else { 0 };
            (0..count).map(move |n| (low + f64::from(n) - a[axis]) / d[axis])
        };
        let mut at: Vec<f64> = [0.0, 1.0].into_iter().chain(crossings(0)).chain(crossings(1)).collect();
        at.sort_by(f64::total_cmp);
        let pieces: Vec<_> = at.windows(2).map(|w| [w[0], w[1]]).collect();
        pieces.into_iter().filter_map(move |[from, to]| {
            let t = 0.5 * (from + to);
            let cell = |axis: usize| {
                let v = a[axis] + t * d[axis];
                (v >= 0.0 && v <= f64::from(cells[axis])).then(|| (v.floor() as u32).min(cells[axis] - 1))
            };
            Some((cell(0)?, cell(1)?, [from, to]))
        })
    }
}

impl TStrip {
    /// Whether AB passes below the mesh of the last update (without morph), in rounded arithmetic.
    pub fn blocked_by_mesh(&self, a: [f64; 3], b: [f64; 3]) -> bool {
        let mut last = None;
        self.sectors().cells(self.ground(), a, b).any(|(i, j, _)| {
            let block = self.block_over(i, j);
            if last == Some(block) {
                return false;
            }
            last = Some(block);
            self.block_triangles(block).any(|t| hits(self.ground(), t, a, b))
        })
    }
}

/// Whether AB passes below a triangle of posts, in rounded arithmetic.
fn hits(ground: &Ground, triangle: [Post; 3], a: [f64; 3], b: [f64; 3]) -> bool {
    let corners = triangle.map(|p| [f64::from(p.i), f64::from(p.j), ground.z(p.i, p.j)]);
    let turn = |p: [f64; 3], q: [f64; 3], x: [f64; 3]| (q[0] - p[0]) * (x[1] - p[1]) - (q[1] - p[1]) * (x[0] - p[0]);
    let edges = [(corners[1], corners[2]), (corners[2], corners[0]), (corners[0], corners[1])];
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    for (p, q) in edges {
        let (ga, gb) = (turn(p, q, a), turn(p, q, b));
        if ga < 0.0 && gb < 0.0 {
            return false;
        }
        if ga < 0.0 {
            low = low.max(ga / (ga - gb));
        } else if gb < 0.0 {
            high = high.min(ga / (ga - gb));
        }
    }
    let below = |t: f64| {
        let x = [0, 1, 2].map(|k| a[k] + t * (b[k] - a[k]));
        let area = turn(corners[0], corners[1], corners[2]);
        let plane: f64 = (0..3).map(|k| turn(edges[k].0, edges[k].1, x) * corners[k][2]).sum::<f64>() / area;
        x[2] < plane
    };
    low <= high && (below(low) || below(high))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DQuat, DVec3};
    use sightline_proto::verdict::MeshVerdict;

    use super::super::{LevelOfDetail, LodView, Target, sight::SightIndex, tstrip::Metric};
    use super::*;
    use crate::terrain::{
        SceneScale,
        synthetic::{fractal, mix},
    };

    #[test]
    fn the_walk_agrees_with_the_exact_verdict_away_from_ties() {
        let field = fractal(60, 45, 8, 200).unwrap();
        let ground = Ground::read(&field, SceneScale::UNIT).unwrap();
        let mut strips = TStrip::new(Arc::clone(&ground), Metric::Distance);
        let view = LodView::new(DVec3::new(9.0, 9.0, 300.0), DQuat::IDENTITY, 0.5, 1.0, [800, 600]).unwrap();
        let mesh = strips.update(&view, Target::Triangles(1200)).unwrap().mesh;
        let index = SightIndex::new(&mesh, ground.grid());
        let unit = |seed: u64, n: u64| (mix(seed ^ mix(n)) >> 11) as f64 / (1_u64 << 53) as f64;
        let mut blocked = [0; 2];
        for seed in 0..1500 {
            // Ends off the lattice: exact ties have probability zero.
            let end = |n: u64| [59.0 * unit(seed, n), 44.0 * unit(seed, n + 1), 250.0 * unit(seed, n + 2) - 20.0];
            let (a, b) = (end(1), end(5));
            let exact = crate::los::line_of_sight(&field, a, b, crate::los::Options::default()).unwrap().verdict;
            let terrain = strips.sectors().blocked_by_terrain(&ground, a, b);
            assert_eq!(terrain, exact == crate::los::Verdict::Blocked, "seed {seed} on the terrain");
            let on_mesh = strips.blocked_by_mesh(a, b);
            assert_eq!(on_mesh, index.verdict(a, b) == MeshVerdict::Blocked, "seed {seed} on the mesh");
            blocked[0] += i32::from(terrain);
            blocked[1] += i32::from(on_mesh);
        }
        assert!(blocked.iter().all(|&n| n > 100 && n < 1300), "{blocked:?}");
    }
}
