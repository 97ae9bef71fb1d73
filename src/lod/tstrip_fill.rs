//! Plan-view culling, after Szoka, "Triangle Strip preserving LOD", 2002, section "Frustum Culling Terrain".
//!
//! The frustum is cut by the planes of the terrain's lowest and highest post. The points of the cut, flattened, have a
//! convex hull; filled like a polygon it gives for each row of cells the first and last cell to draw. A constant
//! number of intersections, whatever the terrain.
//!
//! It departs in closing the frustum at the furthest corner of the terrain (the paper has a far plane), in Andrew's
//! monotone chain instead of Graham's scan, and in filling outwards: every cell that the hull touches is kept.

use glam::DVec3;

use super::{Ground, IndexedMesh, LodView};

/// The cells of each row that a view may see: `None`, or the first and the last.
pub type Spans = Vec<Option<[u32; 2]>>;

/// The cells of the root square that a view may see, row by row from the south.
pub fn fill(ground: &Ground, view: &LodView) -> Spans {
    let hull = convex_hull(footprint(ground, view));
    let last = f64::from(ground.side() - 1);
    (0..ground.side())
        .map(|row| {
            let [west, east] = extent_in_row(&hull, f64::from(row), f64::from(row + 1))?;
            let (west, east) = (west.floor().max(0.0), east.floor().min(last));
            (west <= east).then_some([west as u32, east as u32])
        })
        .collect()
}

/// Number of triangles of a mesh that touch the cells to draw.
pub fn drawn(mesh: &IndexedMesh, spans: &Spans) -> usize {
    let touches = |t: &[super::Vertex; 3]| {
        let [i, j] = [t.map(|v| v.post.i), t.map(|v| v.post.j)];
        let range = |v: [u32; 3]| (v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]));
        let ((west, east), (south, north)) = (range(i), range(j));
        (south..north).any(|row| spans[row as usize].is_some_and(|[first, last]| west <= last && east > first))
    };
    mesh.iter().filter(touches).count()
}

/// The points, in posts, in which the frustum's edges meet the slab between the lowest and the highest post.
fn footprint(ground: &Ground, view: &LodView) -> Vec<[f64; 2]> {
    let side = ground.side();
    let heights = (0..=side).flat_map(|j| (0..=side).map(move |i| (i, j))).map(|(i, j)| ground.z(i, j));
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
    let (low, high) = (low * ground.scale().up_m, high * ground.scale().up_m);
    let mut reach = 0.0_f64;
    for (i, j) in [(0, 0), (side, 0), (0, side), (side, side)] {
        for z in [low, high] {
            let mut corner = ground.scene(i, j);
            corner.z = z;
            reach = reach.max((corner - view.eye()).length());
        }
    }
    // The far plane is at that depth: what lies beyond it is beyond the terrain.
    let near = view.corners(view.near_m());
    let far = view.corners(reach.max(2.0 * view.near_m()));
    let mut points = Vec::new();
    let mut add = |p: DVec3| {
        let g = ground.scale().grid_from_scene(p);
        points.push([g.x, g.y]);
    };
    for k in 0..4 {
        let next = (k + 1) % 4;
        for (p, q) in [(near[k], far[k]), (near[k], near[next]), (far[k], far[next])] {
            for end in [p, q] {
                if (low..=high).contains(&end.z) {
                    add(end);
                }
            }
            for z in [low, high] {
                if (p.z - z) * (q.z - z) < 0.0 {
                    add(p + (q - p) * ((z - p.z) / (q.z - p.z)));
                }
            }
        }
    }
    points
}

/// The convex hull, counter-clockwise (Andrew's monotone chain).
fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let turn = |o: [f64; 2], a: [f64; 2], b: [f64; 2]| (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut hull: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while hull.len() >= 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0 {
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
        hull
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// The least and greatest x of a convex polygon between two values of y.
fn extent_in_row(hull: &[[f64; 2]], south: f64, north: f64) -> Option<[f64; 2]> {
    let mut found: Option<[f64; 2]> = None;
    let mut add = |x: f64| {
        let [west, east] = found.unwrap_or([x, x]);
        found = Some([west.min(x), east.max(x)]);
    };
    for (k, &p) in hull.iter().enumerate() {
        let q = hull[(k + 1) % hull.len()];
        if (south..=north).contains(&p[1]) {
            add(p[0]);
        }
        for y in [south, north] {
            if (p[1] - y) * (q[1] - y) < 0.0 {
                add(p[0] + (q[0] - p[0]) * ((y - p[1]) / (q[1] - p[1])));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::terrain::{
        SceneScale,
        synthetic::{fractal, mix},
    };

    #[test]
    fn no_triangle_in_the_frustum_is_culled() {
        let ground = Ground::read(&fractal(65, 65, 3, 100).unwrap(), SceneScale::UNIT).unwrap();
        let unit = |seed: u64, n: u64| (mix(seed ^ mix(n)) >> 11) as f64 / (1_u64 << 53) as f64;
        let (mut inside, mut outside) = (0, 0);
        for seed in 0..60 {
            let eye = DVec3::new(64.0 * unit(seed, 1), 64.0 * unit(seed, 2), 150.0 * unit(seed, 3));
            let part = |n: u64| unit(seed, n) - 0.5;
            let q = DQuat::from_xyzw(part(4), part(5), part(6), part(7)).normalize();
            let view = LodView::new(eye, q, 0.2 + unit(seed, 8), 0.5, [400, 300]).unwrap();
            let spans = fill(&ground, &view);
            for j in 0..64 {
                for i in 0..64 {
                    let kept = spans[j as usize].is_some_and(|[first, last]| (first..=last).contains(&i));
                    outside += u32::from(!kept);
                    for (a, b) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let p = ground.scene(i + a, j + b);
                        if view.camera().distortion(p, p).is_some() {
                            assert!(kept, "seed {seed}: post ({}, {}) is in the frustum", i + a, j + b);
                            inside += 1;
                        }
                    }
                }
            }
        }
        assert!(inside > 1000 && outside > 1000, "{inside} {outside}");
    }
}
