//! Square tiles of 2^n + 1 posts with levels of detail 0 (every post) to n (two triangles), shared by both GeoMipMap
//! systems: how far each level strays, where tiles lie, and how vertices morph towards the next level.
//!
//! Level k uses every 2^k-th post; its cells are all cut from south-west to north-east, as a triangle strip cuts them.

use sightline_proto::diamond::Post;

use super::Ground;

/// Cells along a tile's side: the 33 x 33 posts of Ye and Wang.
pub const TILE_CELLS: u32 = 32;

/// The tiles of a terrain: those that have a cell of the grid. The rest of the root square is not drawn.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    /// Cells along a side, 2^levels.
    pub(super) cells: u32,
    pub(super) columns: u32,
    pub(super) rows: u32,
    /// The coarsest level.
    pub(super) coarsest: u32,
    /// For each tile, for each level, the greatest vertical deviation in metres; not decreasing with the level.
    deviation_m: Vec<f64>,
    /// For each tile, its lowest and highest post in height units.
    range: Vec<[f64; 2]>,
}

impl Tiles {
    /// Measures all levels of all tiles.
    pub(super) fn new(ground: &Ground) -> Self {
        let cells = TILE_CELLS.min(ground.side());
        let count = |posts: u32| (posts - 1).div_ceil(cells);
        let (columns, rows) = (count(ground.grid().nx()), count(ground.grid().ny()));
        let coarsest = cells.trailing_zeros();
        let mut tiles = Self { cells, columns, rows, coarsest, deviation_m: Vec::new(), range: Vec::new() };
        for n in 0..tiles.len() {
            let mut worst = 0.0_f64;
            for level in 0..=coarsest {
                worst = worst.max(tiles.deviation(ground, n, level) * ground.scale().up_m);
                tiles.deviation_m.push(worst);
            }
            let origin = tiles.origin(n);
            let heights = (0..=cells).flat_map(|v| (0..=cells).map(move |u| (u, v)));
            let range = heights
                .map(|(u, v)| ground.z(origin.i + u, origin.j + v))
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)]);
            tiles.range.push(range);
        }
        tiles
    }

    pub(super) fn len(&self) -> usize {
        (self.columns * self.rows) as usize
    }

    /// Cells that the tiles cover, east and north.
    pub(super) fn extent(&self) -> [u32; 2] {
        [self.columns * self.cells, self.rows * self.cells]
    }

    /// The south-west post of a tile.
    pub(super) fn origin(&self, n: usize) -> Post {
        Post::new(n as u32 % self.columns * self.cells, n as u32 / self.columns * self.cells)
    }

    /// The greatest deviation of a level in metres.
    pub(super) fn deviation_m(&self, n: usize, level: u32) -> f64 {
        self.deviation_m[n * (self.coarsest as usize + 1) + level as usize]
    }

    /// The middle of a tile's bounding box in the scene frame.
    pub(super) fn centre(&self, ground: &Ground, n: usize) -> glam::DVec3 {
        let origin = self.origin(n);
        let half = 0.5 * f64::from(self.cells);
        let z = 0.5 * (self.range[n][0] + self.range[n][1]);
        ground.scale().scene_from_grid(glam::DVec3::new(f64::from(origin.i) + half, f64::from(origin.j) + half, z))
    }

    /// The greatest height between a post of a tile and the tile's surface at a level.
    fn deviation(&self, ground: &Ground, n: usize, level: u32) -> f64 {
        let (origin, step) = (self.origin(n), 1_u32 << level);
        let mut worst = 0.0_f64;
        for v in 0..=self.cells {
            for u in 0..=self.cells {
                let z = ground.z(origin.i + u, origin.j + v);
                worst = worst.max((z - level_height(ground, origin, self.cells, step, u, v)).abs());
            }
        }
        worst
    }

    /// The tiles beyond the four sides: south, east, north, west.
    pub(super) fn neighbours(&self, n: usize) -> [Option<usize>; 4] {
        let (column, row, columns) = (n as u32 % self.columns, n as u32 / self.columns, self.columns as usize);
        [
            (row > 0).then(|| n - columns),
            (column + 1 < self.columns).then(|| n + 1),
            (row + 1 < self.rows).then(|| n + columns),
            (column > 0).then(|| n - 1),
        ]
    }

    /// The greatest level whose deviation `allowed` accepts, given in metres. Level 0 is always accepted.
    pub(super) fn level(&self, n: usize, mut allowed: impl FnMut(f64) -> bool) -> u32 {
        (1..=self.coarsest).take_while(|&level| allowed(self.deviation_m(n, level))).last().unwrap_or(0)
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.deviation_m.as_slice()) + size_of_val(self.range.as_slice())
    }
}

/// The height of a tile's surface with steps of `step` posts, `u` and `v` posts from its origin.
pub(super) fn level_height(ground: &Ground, origin: Post, cells: u32, step: u32, u: u32, v: u32) -> f64 {
    let cell = |w: u32| (w / step * step).min(cells - step);
    let (west, south) = (cell(u), cell(v));
    let z = |a: u32, b: u32| ground.z(origin.i + west + a * step, origin.j + south + b * step);
    let (x, y) = (f64::from(u - west) / f64::from(step), f64::from(v - south) / f64::from(step));
    let [sw, ne] = [z(0, 0), z(1, 1)];
    if x >= y {
        let se = z(1, 0);
        sw + x * (se - sw) + y * (ne - se)
    } else {
        let nw = z(0, 1);
        sw + y * (nw - sw) + x * (ne - nw)
    }
}

/// The drawn height of a post strictly inside a tile of level `level`, morphed by `part` towards the next level.
pub(super) fn morphed(ground: &Ground, tiles: &Tiles, n: usize, level: u32, part: f64, p: Post) -> f64 {
    let z = ground.z(p.i, p.j);
    if part <= 0.0 || level >= tiles.coarsest {
        return z;
    }
    let origin = tiles.origin(n);
    let coarse = level_height(ground, origin, tiles.cells, 2 << level, p.i - origin.i, p.j - origin.j);
    z + part * (coarse - z)
}

/// Chooses levels, and gives each post inside a tile its morphed height. Posts on the sides of tiles never morph: two
/// tiles share them.
pub(super) struct Choice {
    /// The level of each tile.
    pub(super) levels: Vec<u32>,
    /// How far the vertices of each tile have gone to the next level: 0 to 1.
    pub(super) parts: Vec<f64>,
}

impl Choice {
    /// The height at which a post is drawn.
    pub(super) fn height(&self, ground: &Ground, tiles: &Tiles, p: Post) -> f64 {
        if p.i.is_multiple_of(tiles.cells) || p.j.is_multiple_of(tiles.cells) {
            return ground.z(p.i, p.j);
        }
        let n = (p.j / tiles.cells * tiles.columns + p.i / tiles.cells) as usize;
        morphed(ground, tiles, n, self.levels[n], self.parts[n], p)
    }
}
