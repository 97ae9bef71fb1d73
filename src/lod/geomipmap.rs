//! GeoMipMap, after de Boer, "Fast Terrain Rendering Using Geometrical MipMapping", 2000, as Ye and Wang, "View-dependent
//! Real-time Terrain Rendering Using Static LOD", sections 2 and 3, and Inam's thesis (2005), section 2.2.3, restate it.
//!
//! The terrain is cut into tiles of 2^n + 1 posts a side. For each level of a tile the greatest deviation delta is
//! measured beforehand. Level m may be used from the distance D_m = |delta_m| n v / (|t| 2 tau) on (near plane n, its top t,
//! v pixels high, tau pixels of error), compared in squares with the distance of the tile's centre. Where a neighbour is
//! coarser, the finer tile leaves out the vertices of that edge which the neighbour lacks. Vertices may morph with
//! the distance, f = (d - D_m) / (D_{m+1} - D_m).
//!
//! "Leaving out" is read here as drawing the last kept vertex before it instead; triangles that lose their area are
//! not drawn. Along a western edge, the neighbour four times as coarse:
//!
//! ```text
//!    ├──┬──┬─        4 ──┬─        Each vertex of the tile's next column joins the fan of the kept vertex
//!    ├──┼──┼─        │╲ ─┼─        below it. So read, the stitching also does tiles all of whose four
//!    ├──┼──┼─        │ ╲╲┼─        neighbours are coarser. Ye and Wang find that the original cannot: there each edge
//!    ├──┼──┼─        │──╲┼─        is a row of cells from corner to corner that is stitched by itself, and two rows
//!    └──┴──┴─        0──╱┴─        meet in a corner where each needs a vertex that the other left out.
//! ```
//!
//! The test `four_coarser_neighbours_defeat_stitching_by_rows` shows both.
//!
//! It departs further in keeping delta from falling with the level (a chosen level is then right at all distances
//! beyond), in measuring delta against the level's triangles at every post, and in fixing edges while vertices morph.

use std::sync::Arc;

use sightline_proto::diamond::Post;

use super::{
    Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target,
    mesh::MeshBuilder,
    tiles::{Choice, Tiles},
};

/// The range of tau in pixels.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1e6, fine: 1e-6 };

/// A prepared GeoMipMap.
#[derive(Debug)]
pub struct GeoMipMap {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    tiles: Tiles,
    morph: bool,
}

impl GeoMipMap {
    /// Measures the levels of all tiles.
    pub fn new(ground: Arc<Ground>) -> Self {
        let (builder, tiles) = (MeshBuilder::new(ground.side()), Tiles::new(&ground));
        Self { ground, builder, tiles, morph: false }
    }

    fn choose(&self, view: &LodView, tau_px: f64) -> Choice {
        let c = view.pixels() / tau_px;
        let mut choice = Choice { levels: Vec::new(), parts: Vec::new() };
        for n in 0..self.tiles.len() {
            let square = (self.tiles.centre(&self.ground, n) - view.eye()).length_squared();
            // Never nearer than the near plane, or a flat tile at the eye would be at distance 0 = D_m of all levels.
            let square = square.max(view.near_m() * view.near_m());
            let level = self.tiles.level(n, |delta| delta * delta * (c * c) <= square);
            choice.levels.push(level);
            let next = self.tiles.deviation_m(n, (level + 1).min(self.tiles.coarsest));
            let (from, to) = (least_distance(self.tiles.deviation_m(n, level), c), least_distance(next, c));
            let part = if to > from { ((square.sqrt() - from) / (to - from)).clamp(0.0, 1.0) } else { 0.0 };
            choice.parts.push(if self.morph { part } else { 0.0 });
        }
        choice
    }

    fn triangles(&self, levels: &[u32]) -> Vec<[Post; 3]> {
        let mut out = Vec::new();
        for (n, &level) in levels.iter().enumerate() {
            let strides = self.tiles.neighbours(n).map(|m| 1_u32 << m.map_or(level, |m| levels[m].max(level)));
            stitched(self.tiles.origin(n), self.tiles.cells, 1 << level, strides, &mut out);
        }
        out
    }
}

/// D_m: the least distance at which a level with deviation `delta_m` may be used, for C = n v / (|t| 2 tau).
fn least_distance(delta_m: f64, c: f64) -> f64 {
    delta_m.abs() * c
}

/// The triangles of a tile with vertices every `step` posts; along its south, east, north and west edges only every
/// `strides` posts, each a multiple of the step.
fn stitched(origin: Post, cells: u32, step: u32, strides: [u32; 4], out: &mut Vec<[Post; 3]>) {
    let [south, east, north, west] = strides;
    let kept = |u: u32, v: u32| {
        let floor = |w: u32, stride: u32| w / stride * stride;
        let u = match v {
            0 => floor(u, south),
            _ if v == cells => floor(u, north),
            _ => u,
        };
        let v = match u {
            0 => floor(v, west),
            _ if u == cells => floor(v, east),
            _ => v,
        };
        Post::new(origin.i + u, origin.j + v)
    };
    for v in (0..cells).step_by(step as usize) {
        for u in (0..cells).step_by(step as usize) {
            let [sw, se] = [kept(u, v), kept(u + step, v)];
            let [nw, ne] = [kept(u, v + step), kept(u + step, v + step)];
            out.extend([[sw, se, ne], [sw, ne, nw]].into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
        }
    }
}

impl LevelOfDetail for GeoMipMap {
    /// The setting is tau, which it also promises.
    fn update(&mut self, view: &LodView, target: Target) -> Result<Frame, LodError> {
        let tau = match target {
            Target::Setting(tau) => RANGE.check(tau)?,
            Target::Triangles(most) => {
                RANGE.steer(most, |tau| Ok(self.triangles(&self.choose(view, tau).levels).len()))?
            }
        };
        let choice = self.choose(view, tau);
        let triangles = self.triangles(&choice.levels);
        let (ground, tiles) = (&self.ground, &self.tiles);
        let mesh = self.builder.build(tiles.extent(), &triangles, |p| choice.height(ground, tiles, p));
        // One strip for each row of a tile's cells.
        let strips = choice.levels.iter().map(|&level| u64::from(tiles.cells >> level)).sum();
        let decisions = tiles.len() as u64;
        let statistics = Statistics { setting: tau, decisions, strips, ..Statistics::default() };
        Ok(Frame { mesh, bound_px: Some(tau), statistics })
    }

    fn memory_bytes(&self) -> usize {
        self.tiles.bytes() + self.builder.bytes()
    }

    fn set_morph(&mut self, morph: bool) {
        self.morph = morph;
    }
}

#[cfg(test)]
mod tests {
    use super::super::{IndexedMesh, Vertex, conformity};
    use super::*;

    #[test]
    fn the_least_distance_of_a_level_by_hand() {
        // n = 1, |t| = 0.5 (so that tan(fov / 2) = 0.5), v = 768 pixels, tau = 4 pixels: C = 768 / (0.5 * 8) = 192.
        let camera = LodView::new(glam::DVec3::ZERO, glam::DQuat::IDENTITY, 0.5, 1.0, [1024, 768]).unwrap();
        let c = camera.pixels() / 4.0;
        assert_eq!(c, 192.0);
        // A deviation of 2.5 m either way: D_m = 480 m.
        assert_eq!(least_distance(2.5, c), 480.0);
        assert_eq!(least_distance(-2.5, c), 480.0);
    }

    fn mesh_of(cells: u32, triangles: &[[Post; 3]]) -> IndexedMesh {
        let vertices = triangles.iter().flatten().map(|&post| Vertex { post, z: 0.0 }).collect();
        let triangles = (0..triangles.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
        IndexedMesh { extent: [cells; 2], vertices, triangles }
    }

    /// A tile of 8 cells with its edges stitched one by one: the row of cells along an edge becomes fans between the
    /// edge's kept vertices and the next row of vertices, which runs from side to side of the tile.
    fn stitched_by_rows(strides: [u32; 4]) -> Vec<[Post; 3]> {
        let cells = 8;
        let mut out = Vec::new();
        for (side, stride) in strides.into_iter().enumerate() {
            // Turns (along, inwards) of an edge into the tile, so that each edge runs counter-clockwise.
            let at = |u: u32, v: u32| match side {
                0 => Post::new(u, v),
                1 => Post::new(cells - v, u),
                2 => Post::new(cells - u, cells - v),
                _ => Post::new(v, cells - u),
            };
            // Where two rows cross in a corner, the south and north ones have the cell.
            let along = if side % 2 == 0 { 0..cells } else { 1..cells - 1 };
            for u in along {
                let kept = |u: u32| u / stride * stride;
                let fan =
                    [[at(kept(u), 0), at(u + 1, 1), at(u, 1)], [at(kept(u), 0), at(kept(u + 1), 0), at(u + 1, 1)]];
                out.extend(fan.into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
            }
        }
        for v in 1..cells - 1 {
            for u in 1..cells - 1 {
                let p = |a: u32, b: u32| Post::new(u + a, v + b);
                out.extend([[p(0, 0), p(1, 0), p(1, 1)], [p(0, 0), p(1, 1), p(0, 1)]]);
            }
        }
        out
    }

    #[test]
    fn four_coarser_neighbours_defeat_stitching_by_rows() {
        let whole = |triangles: &[[Post; 3]]| conformity::check(&mesh_of(8, triangles));
        // One coarser neighbour: both ways are whole, and leave out the same vertices.
        assert_eq!(whole(&stitched_by_rows([4, 1, 1, 1])).unwrap().t_junctions, 0);
        // Four: rows collide in the corners. Each has a vertex on an edge whose own row left it out, or a gap.
        let rows = whole(&stitched_by_rows([4; 4]));
        assert!(rows.as_ref().map_or(true, |c| c.t_junctions > 0), "{rows:?}");
        for strides in [[4; 4], [8; 4], [2, 4, 8, 1], [1, 8, 8, 2]] {
            let mut out = Vec::new();
            stitched(Post::new(0, 0), 8, 1, strides, &mut out);
            assert_eq!(whole(&out).unwrap().t_junctions, 0, "{strides:?}");
            for p in out.iter().flatten() {
                let left_out = |on: bool, w: u32, stride: u32| on && !w.is_multiple_of(stride);
                assert!(!left_out(p.j == 0, p.i, strides[0]) && !left_out(p.i == 8, p.j, strides[1]));
                assert!(!left_out(p.j == 8, p.i, strides[2]) && !left_out(p.i == 0, p.j, strides[3]));
            }
        }
    }
}
