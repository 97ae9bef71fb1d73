//! Improved GeoMipMap, after Ye and Wang, "View-dependent Real-time Terrain Rendering Using Static LOD", section 3.
//!
//! Three changes to GeoMipMap. A level is taken when its deviation is at most
//! delta = (2 |t| tau / (n v))^2 d^2, d being the distance of the tile's centre in the ground plane: distances count more and roughness
//! less than in the original, tau and the zoom may change at any time, and the error on the screen is no longer bounded
//! by tau. The *coarser* tile connects to its finer neighbours, by fans in a strip along each edge, on all four sides at
//! once; its body stays as it is. And vertices morph with f = (delta - delta_m) / (delta_{m+1} - delta_m).
//!
//! ```text
//!   ┌───┬───┬───┬───┐      A tile of 4 x 4 cells with a finer neighbour in the south: its body are the
//!   │ ╲ │   │   │ ╱ │      2 x 2 cells in the middle; along each edge the edge's vertices and the body's
//!   ├───┌───┬───┐───┤      make fans.
//!   │   │  body │   │
//!   ├───├───┼───┤───┤
//!   │   │   │   │   │
//!   ├───└───┴───┘───┤
//!   │ ╱ ╱│╲ │ ╱│╲ ╲ │
//!   └─┴─┴─┴─┴─┴─┴─┴─┘
//! ```
//!
//! Where it departs: the coarsest level is one cell and has no body; beside a finer tile it becomes a fan around the
//! tile's middle post. The paper compares delta, which it calls the square of an error, with the deviation itself: a
//! square of metres with metres. That is kept, since its results rest on it. Edges do not morph (the paper's "simplest
//! way").

use std::sync::Arc;

use sightline_proto::diamond::Post;

use super::{
    Frame, Ground, LevelOfDetail, LodError, LodView, SettingRange, Statistics, Target,
    mesh::MeshBuilder,
    tiles::{Choice, Tiles},
};

/// The range of tau in pixels.
pub(super) const RANGE: SettingRange = SettingRange { coarse: 1e9, fine: 1e-9 };

/// A prepared improved GeoMipMap.
#[derive(Debug)]
pub struct ImprovedGeoMipMap {
    ground: Arc<Ground>,
    builder: MeshBuilder,
    tiles: Tiles,
    morph: bool,
}

impl ImprovedGeoMipMap {
    /// Measures the levels of all tiles.
    pub fn new(ground: Arc<Ground>) -> Self {
        let (builder, tiles) = (MeshBuilder::new(ground.side()), Tiles::new(&ground));
        Self { ground, builder, tiles, morph: false }
    }

    fn choose(&self, view: &LodView, tau_px: f64) -> Choice {
        let mut choice = Choice { levels: Vec::new(), parts: Vec::new() };
        for n in 0..self.tiles.len() {
            let to_tile = self.tiles.centre(&self.ground, n) - view.eye();
            let allowed = allowed_deviation(tau_px / view.pixels(), to_tile.x * to_tile.x + to_tile.y * to_tile.y);
            let level = self.tiles.level(n, |delta| delta <= allowed);
            choice.levels.push(level);
            let from = self.tiles.deviation_m(n, level);
            let to = self.tiles.deviation_m(n, (level + 1).min(self.tiles.coarsest));
            let part = if to > from { ((allowed - from) / (to - from)).clamp(0.0, 1.0) } else { 0.0 };
            choice.parts.push(if self.morph { part } else { 0.0 });
        }
        choice
    }

    fn triangles(&self, levels: &[u32]) -> Vec<[Post; 3]> {
        let mut out = Vec::new();
        for (n, &level) in levels.iter().enumerate() {
            let steps = self.tiles.neighbours(n).map(|m| 1_u32 << m.map_or(level, |m| levels[m].min(level)));
            tile(self.tiles.origin(n), self.tiles.cells, 1 << level, steps, &mut out);
        }
        out
    }
}

/// delta of the paper, for 2 |t| tau / (n v) and the square of the distance in the ground plane.
fn allowed_deviation(slope: f64, square: f64) -> f64 {
    slope * slope * square
}

/// The triangles of a tile with vertices every `step` posts, along its edges every `steps`: south, east, north, west.
fn tile(origin: Post, cells: u32, step: u32, steps: [u32; 4], out: &mut Vec<[Post; 3]>) {
    let post = |u: u32, v: u32| Post::new(origin.i + u, origin.j + v);
    if steps == [step; 4] {
        for v in (0..cells).step_by(step as usize) {
            for u in (0..cells).step_by(step as usize) {
                let (sw, ne) = (post(u, v), post(u + step, v + step));
                out.extend([[sw, post(u + step, v), ne], [sw, ne, post(u, v + step)]]);
            }
        }
        return;
    }
    // The body, or the middle post where there is no room for one.
    let (low, high) = if cells / step >= 2 { (step, cells - step) } else { (cells / 2, cells / 2) };
    for v in (low..high).step_by(step as usize) {
        for u in (low..high).step_by(step as usize) {
            let (sw, ne) = (post(u, v), post(u + step, v + step));
            out.extend([[sw, post(u + step, v), ne], [sw, ne, post(u, v + step)]]);
        }
    }
    for (side, edge_step) in steps.into_iter().enumerate() {
        // (along, inwards), each edge counter-clockwise around the tile.
        let at = |u: u32, v: u32| match side {
            0 => post(u, v),
            1 => post(cells - v, u),
            2 => post(cells - u, cells - v),
            _ => post(v, cells - u),
        };
        border(cells, edge_step, [low, high], step, at, out);
    }
}

/// The fans between an edge of a tile (0 to `cells`, every `edge_step`) and the body's edge (`body`, every `step`).
fn border(
    cells: u32,
    edge_step: u32,
    body: [u32; 2],
    step: u32,
    at: impl Fn(u32, u32) -> Post,
    out: &mut Vec<[Post; 3]>,
) {
    let [low, high] = body;
    let (mut u, mut w) = (0, low);
    while u < cells || w < high {
        // The edge goes on while its next piece lies before the body's, so that triangles stay upright.
        if w == high || (u < cells && 2 * u + edge_step <= 2 * w + step) {
            out.push([at(u, 0), at(u + edge_step, 0), at(w, low)]);
            u += edge_step;
        } else {
            out.push([at(u, 0), at(w + step, low), at(w, low)]);
            w += step;
        }
    }
}

impl LevelOfDetail for ImprovedGeoMipMap {
    /// The setting is tau; no error is promised.
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
        let strips = choice.levels.iter().map(|&level| u64::from(tiles.cells >> level)).sum();
        let decisions = tiles.len() as u64;
        let statistics = Statistics { setting: tau, decisions, strips, ..Statistics::default() };
        Ok(Frame { mesh, bound_px: None, statistics })
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
    fn the_allowed_deviation_by_hand() {
        // tan(fov / 2) = 0.5, v = 768, tau = 3: 2 |t| tau / (n v) = 3 / 768. At 1024 m: (3 / 768 * 1024)^2 = 16.
        let camera = LodView::new(glam::DVec3::ZERO, glam::DQuat::IDENTITY, 0.5, 1.0, [1024, 768]).unwrap();
        assert_eq!(allowed_deviation(3.0 / camera.pixels(), 1024.0 * 1024.0), 16.0);
        // Twice the distance allows four times the deviation: the error on the screen doubles.
        assert_eq!(allowed_deviation(3.0 / camera.pixels(), 2048.0 * 2048.0), 64.0);
    }

    #[test]
    fn a_tile_connects_to_finer_neighbours_on_all_sides_at_once() {
        for step in [8, 4, 2, 1] {
            for code in 0..256_u32 {
                let steps = [0, 2, 4, 6].map(|shift| (step >> (code >> shift & 3)).max(1));
                let mut out = Vec::new();
                tile(Post::new(0, 0), 8, step, steps, &mut out);
                let vertices = out.iter().flatten().map(|&post| Vertex { post, z: 0.0 }).collect();
                let triangles = (0..out.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
                let mesh = IndexedMesh { extent: [8; 2], vertices, triangles };
                let found = conformity::check(&mesh).unwrap_or_else(|e| panic!("{step} {steps:?}: {e}"));
                assert_eq!(found.t_junctions, 0, "{step} {steps:?}");
            }
        }
    }
}
