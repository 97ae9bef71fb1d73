//! How far a mesh is from the finest surface, vertically, over the grid.
//!
//! On the overlap of a mesh triangle and a finest triangle both surfaces are linear, so the greatest deviation is
//! attained where such an overlap has a corner: at a post, or where an edge of the mesh crosses an edge of the finest
//! triangulation (x, y, x - y or x + y an integer, the last two even). Meshes of the bintree hierarchy have no such crossings that
//! count, but a mesh whose cells are cut along other diagonals strays from the surface between posts even where it
//! uses every post. Mean and root mean square are over the posts of the grid.

use sightline_proto::diamond::{Post, diagonal_rises};

use super::{
    Ground,
    mesh::{IndexedMesh, Vertex},
};

/// Vertical distances in height units between a mesh and the finest surface.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct VerticalError {
    /// The greatest anywhere over the grid.
    pub max: f64,
    /// The greatest at a post.
    pub max_at_posts: f64,
    /// Root of the mean square over the posts.
    pub rms: f64,
    /// Mean over the posts.
    pub mean: f64,
    /// Posts of the grid over which there is no triangle: 0 for a mesh that covers the grid.
    pub uncovered: u64,
}

/// The vertical error of `mesh`. At a crack the worse of its two sides counts.
pub fn vertical_error(mesh: &IndexedMesh, ground: &Ground) -> VerticalError {
    let grid = ground.grid();
    let mut deviation = vec![-1.0_f64; grid.posts() as usize];
    let mut max = 0.0_f64;
    for t in mesh.iter() {
        for_each_post(&t, |p, z| {
            if grid.contains(p) {
                let slot = &mut deviation[p.j as usize * grid.nx() as usize + p.i as usize];
                *slot = slot.max((z - ground.z(p.i, p.j)).abs());
            }
        });
        for k in 0..3 {
            max = max.max(deviation_of_edge(&t[k], &t[(k + 1) % 3], ground));
        }
    }
    let (mut sum, mut squares, mut at_posts, mut uncovered) = (0.0, 0.0, 0.0_f64, 0);
    for &d in &deviation {
        if d < 0.0 {
            uncovered += 1;
            continue;
        }
        sum += d;
        squares += d * d;
        at_posts = at_posts.max(d);
    }
    let posts = (grid.posts() - uncovered).max(1) as f64;
    VerticalError {
        max: max.max(at_posts),
        max_at_posts: at_posts,
        rms: (squares / posts).sqrt(),
        mean: sum / posts,
        uncovered,
    }
}

/// The height of the mesh at each post of the grid, row by row from the south; NaN where it has none. What popping and
/// screen distortion are measured from.
pub fn heights_at_posts(mesh: &IndexedMesh, ground: &Ground) -> Vec<f64> {
    let grid = ground.grid();
    let mut heights = vec![f64::NAN; grid.posts() as usize];
    for t in mesh.iter() {
        for_each_post(&t, |p, z| {
            if grid.contains(p) {
                heights[p.j as usize * grid.nx() as usize + p.i as usize] = z;
            }
        });
    }
    heights
}

/// Calls `visit` with each post of the closed triangle and the triangle's height there.
fn for_each_post(t: &[Vertex; 3], mut visit: impl FnMut(Post, f64)) {
    let [a, b, c] = t.map(|v| [i64::from(v.post.i), i64::from(v.post.j)]);
    let turn = |p: [i64; 2], q: [i64; 2], x: [i64; 2]| (q[0] - p[0]) * (x[1] - p[1]) - (q[1] - p[1]) * (x[0] - p[0]);
    let area = turn(a, b, c);
    let (south, north) = (a[1].min(b[1]).min(c[1]), a[1].max(b[1]).max(c[1]));
    for y in south..=north {
        // Each edge p q asks turn(p, q, x) >= 0, that is dx (y - py) - dy (x - px) >= 0: a bound on x, or on y alone.
        let (mut west, mut east) = (a[0].min(b[0]).min(c[0]), a[0].max(b[0]).max(c[0]));
        for (p, q) in [(a, b), (b, c), (c, a)] {
            let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
            let reach = dx * (y - p[1]);
            match dy {
                1.. => east = east.min(p[0] + reach.div_euclid(dy)),
                0 => {}
                _ => west = west.max(p[0] - reach.div_euclid(-dy)),
            }
        }
        for x in west..=east {
            let weights = [turn(b, c, [x, y]), turn(c, a, [x, y]), turn(a, b, [x, y])];
            let z = (0..3).map(|k| weights[k] as f64 * t[k].z).sum::<f64>() / area as f64;
            visit(Post::new(x as u32, y as u32), z);
        }
    }
}

/// The greatest deviation where an edge crosses edges of the finest triangulation within the grid.
fn deviation_of_edge(p: &Vertex, q: &Vertex, ground: &Ground) -> f64 {
    let ([px, py, pz], [qx, qy, qz]) = (p.point(), q.point());
    let (dx, dy) = (qx - px, qy - py);
    let grid = ground.grid();
    let (east, north) = (f64::from(grid.nx() - 1), f64::from(grid.ny() - 1));
    let mut worst = 0.0_f64;
    let mut cross = |part: f64| {
        let (x, y) = (px + part * dx, py + part * dy);
        if x >= 0.0 && x <= east && y >= 0.0 && y <= north {
            worst = worst.max((pz + part * (qz - pz) - surface(ground, x, y)).abs());
        }
    };
    for (from, delta, step) in [(px, dx, 1.0), (py, dy, 1.0), (px - py, dx - dy, 2.0), (px + py, dx + dy, 2.0)] {
        let (low, high) = (from.min(from + delta), from.max(from + delta));
        let mut at = (low / step).floor() * step + step;
        while delta != 0.0 && at < high {
            cross((at - from) / delta);
            at += step;
        }
    }
    worst
}

/// The height of the finest surface at a point of the grid, in f64: for measures, never for verdicts.
pub fn surface(ground: &Ground, x: f64, y: f64) -> f64 {
    let side = f64::from(ground.side());
    let (i, j) = (x.floor().min(side - 1.0) as u32, y.floor().min(side - 1.0) as u32);
    let (u, v) = (x - f64::from(i), y - f64::from(j));
    let [sw, se, nw, ne] = [ground.z(i, j), ground.z(i + 1, j), ground.z(i, j + 1), ground.z(i + 1, j + 1)];
    if diagonal_rises(Post::new(i, j)) {
        if u >= v { sw + u * (se - sw) + v * (ne - se) } else { sw + v * (nw - sw) + u * (ne - nw) }
    } else if u + v <= 1.0 {
        sw + u * (se - sw) + v * (nw - sw)
    } else {
        ne + (1.0 - u) * (nw - ne) + (1.0 - v) * (se - ne)
    }
}
