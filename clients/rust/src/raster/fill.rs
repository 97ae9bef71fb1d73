//! Filling triangles, sky and paper into a buffer of samples.

use glam::DVec3;

use super::{NO_DATA, Paint, Picture, Surface, View, palette};

/// Colours and depths of all samples. Colours are 0 to 1.
pub(super) struct Target {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) colour: Vec<[f32; 3]>,
    /// Distance along the view axis in metres; infinite where nothing is drawn.
    pub(super) depth: Vec<f64>,
}

impl Target {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, colour: vec![[0.0; 3]; width * height], depth: vec![f64::INFINITY; width * height] }
    }

    /// Mixes `colour` over the sample at `n`.
    pub(super) fn blend(&mut self, n: usize, colour: [f32; 3], opacity: f32) {
        self.colour[n] = mix(self.colour[n], colour, opacity);
    }

    /// The mean of each block of samples as a pixel.
    pub(super) fn resolve(&self, samples: u32) -> Picture {
        let s = samples as usize;
        let (width, height) = (self.width / s, self.height / s);
        let mut rgb = Vec::with_capacity(3 * width * height);
        let scale = 255.0 / (s * s) as f32;
        for y in 0..height {
            for x in 0..width {
                for channel in 0..3 {
                    let mut sum = 0.0;
                    for row in s * y..s * y + s {
                        for column in s * x..s * x + s {
                            sum += self.colour[row * self.width + column][channel];
                        }
                    }
                    rgb.push((sum * scale + 0.5) as u8);
                }
            }
        }
        Picture { width_px: width as u32, height_px: height as u32, rgb }
    }
}

/// `a` with `opacity` of `b` over it.
pub(super) fn mix(a: [f32; 3], b: [f32; 3], opacity: f32) -> [f32; 3] {
    [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * opacity)
}

/// Draws all triangles of the surface.
pub(super) fn fill_surface(target: &mut Target, surface: &Surface, view: &View, paint: &Paint) {
    let normals = surface.normals(paint.relief);
    let camera: Vec<DVec3> = surface.vertices.iter().map(|&v| view.camera_from_scene(DVec3::from_array(v))).collect();
    for t in &surface.triangles {
        let corners = t.map(|v| v as usize);
        let at = corners.map(|v| camera[v]);
        if at.iter().all(|p| -p.z < view.near_m) {
            continue;
        }
        let face = surface.face_normal(t, paint.relief).normalize_or(DVec3::Z);
        let Some(setup) = Setup::new(view, at) else { continue };
        let scene = corners.map(|v| DVec3::from_array(surface.vertices[v]));
        // Half the face's own normal keeps the facets of the mesh in sight, half the smooth one pleases the eye.
        let shade = corners.map(|v| palette::light((normals[v] + face).normalize_or(DVec3::Z)));
        let hidden = surface.face_normal(t, 1.0).dot(scene[0] - view.eye) > 0.0 && view.perspective;
        fill_triangle(target, view, paint, surface, &setup, &Corners { scene, shade, below: hidden });
    }
}

/// What is interpolated over a triangle.
struct Corners {
    scene: [DVec3; 3],
    shade: [f64; 3],
    /// Whether the triangle is seen from below: the eye is under the mesh.
    below: bool,
}

/// The homogeneous edge functions of a triangle: weight k of the sample (x, y) is `edge[k] . (x, y, 1)`. A point of
/// the triangle in front of the eye has no negative weight; the weights, divided by their sum, interpolate corners.
struct Setup {
    edge: [DVec3; 3],
    depth: [f64; 3],
    /// Length of the gradient of each weight per sample, for the width of wires.
    slope: [f64; 3],
}

impl Setup {
    fn new(view: &View, camera: [DVec3; 3]) -> Option<Self> {
        let [a, b, c] = camera.map(|p| view.project(p));
        let determinant = a.dot(b.cross(c));
        if determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let edge = [b.cross(c), c.cross(a), a.cross(b)].map(|e| e / determinant);
        Some(Self { edge, depth: camera.map(|p| -p.z), slope: edge.map(|e| (e.x * e.x + e.y * e.y).sqrt()) })
    }

    fn weights(&self, x: f64, y: f64) -> [f64; 3] {
        self.edge.map(|e| e.x * x + e.y * y + e.z)
    }

    /// The columns of a row whose samples may lie in the triangle, one too many on either side for rounding.
    fn span(&self, y: f64, width: usize) -> Option<(usize, usize)> {
        let (mut first, mut last) = (0.0, width as f64 - 1.0);
        for e in self.edge {
            let rest = e.y * y + e.z;
            if e.x > 0.0 {
                first = f64::max(first, -rest / e.x - 1.5);
            } else if e.x < 0.0 {
                last = f64::min(last, -rest / e.x + 0.5);
            } else if rest < 0.0 {
                return None;
            }
        }
        (first <= last).then_some((first as usize, last as usize))
    }

    /// Rows that the triangle may touch: all of them when it reaches behind the eye.
    fn rows(&self, view: &View, scene: [DVec3; 3]) -> (usize, usize) {
        let at = scene.map(|p| view.project(view.camera_from_scene(p)));
        if at.iter().any(|p| p.z <= 0.0) {
            return (0, view.height);
        }
        let y = at.map(|p| p.y / p.z);
        let low = y[0].min(y[1]).min(y[2]) - 1.0;
        let high = y[0].max(y[1]).max(y[2]) + 1.0;
        let clamp = |v: f64| v.clamp(0.0, view.height as f64) as usize;
        (clamp(low), clamp(high))
    }
}

fn fill_triangle(target: &mut Target, view: &View, paint: &Paint, surface: &Surface, setup: &Setup, corners: &Corners) {
    let [low, high] = surface.extent;
    let (first_row, end_row) = setup.rows(view, corners.scene);
    for row in first_row..end_row {
        let y = row as f64 + 0.5;
        let Some((first, last)) = setup.span(y, target.width) else { continue };
        for column in first..=last.min(target.width - 1) {
            let weights = setup.weights(column as f64 + 0.5, y);
            let sum = weights[0] + weights[1] + weights[2];
            if weights.iter().any(|&w| w < 0.0) || sum <= 0.0 {
                continue;
            }
            let bary = weights.map(|w| w / sum);
            let depth = blend3(bary, setup.depth);
            let n = row * target.width + column;
            if depth < view.near_m || depth >= target.depth[n] {
                continue;
            }
            let p = corners.scene[0] * bary[0] + corners.scene[1] * bary[1] + corners.scene[2] * bary[2];
            if p.x < low[0] || p.y < low[1] || p.x > high[0] || p.y > high[1] {
                continue;
            }
            target.depth[n] = depth;
            let is_void = surface.is_void(p.x, p.y);
            target.colour[n] = colour(view, paint, setup, corners, Sample { bary, weights, p, is_void });
        }
    }
}

fn blend3(bary: [f64; 3], of: [f64; 3]) -> f64 {
    bary[0] * of[0] + bary[1] * of[1] + bary[2] * of[2]
}

/// A sample of a triangle.
struct Sample {
    bary: [f64; 3],
    weights: [f64; 3],
    /// In the scene frame.
    p: DVec3,
    is_void: bool,
}

fn colour(view: &View, paint: &Paint, setup: &Setup, corners: &Corners, sample: Sample) -> [f32; 3] {
    let Sample { bary, weights, p, is_void } = sample;
    let light = blend3(bary, corners.shade);
    let tint = if is_void { NO_DATA } else { palette::hypsometric((p.z - paint.low_m) / paint.span_m) };
    let mut out = tint.map(|c| (f64::from(c) * light) as f32);
    if paint.muted && !is_void {
        let grey = 0.3 * out[0] + 0.55 * out[1] + 0.15 * out[2];
        out = mix([0.45 + 0.5 * grey; 3], out, 0.12);
    }
    if corners.below {
        out = mix(out, palette::UNDERSIDE, 0.7);
    }
    if paint.wireframe {
        out = mix(out, palette::WIRE, wire(setup, weights));
    }
    let range = (p - view.eye).length();
    let haze = range * range / (range * range + paint.haze_m * paint.haze_m);
    if haze > 0.0 { mix(out, palette::sky((p - view.eye) / range.max(1e-9)), haze as f32) } else { out }
}

/// Opacity of the triangle's edges at a sample: lines about a pixel wide, fading where triangles are only a few
/// pixels across and would turn black.
fn wire(setup: &Setup, weights: [f64; 3]) -> f32 {
    let sum = weights[0] + weights[1] + weights[2];
    let mut distance = f64::INFINITY;
    let mut height = f64::INFINITY;
    for (weight, slope) in weights.into_iter().zip(setup.slope) {
        if slope > 0.0 {
            distance = distance.min(weight / slope);
            height = height.min(sum / slope);
        }
    }
    let line = (1.5 - distance).clamp(0.0, 1.0);
    let fade = ((height - 5.0) / 20.0).clamp(0.0, 1.0);
    (0.55 * line * fade) as f32
}

/// Paints the sky where nothing was drawn.
pub(super) fn fill_sky(target: &mut Target, view: &View) {
    for y in 0..target.height {
        for x in 0..target.width {
            let n = y * target.width + x;
            if target.depth[n] == f64::INFINITY {
                target.colour[n] = palette::sky(view.ray(x, y));
            }
        }
    }
}

/// Paints plain paper where nothing was drawn.
pub(super) fn fill_paper(target: &mut Target) {
    for (colour, depth) in target.colour.iter_mut().zip(&target.depth) {
        if *depth == f64::INFINITY {
            *colour = palette::PAPER;
        }
    }
}
