//! Segments drawn over the terrain.

use glam::DVec3;

use super::{Mark, MarkKind, SAMPLES, View, fill::Target};

/// Whether terrain hides marks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Depth {
    /// Parts behind terrain are faint.
    Tested,
    /// All of a mark is drawn in full.
    OnTop,
}

/// Greatest number of samples that one mark is drawn with: the diagonal of the largest picture, four times over.
const MAX_STEPS: f64 = 4.0 * 1.5 * (super::MAX_SIDE_PX * SAMPLES) as f64;

/// Draws all marks, later ones over earlier ones.
pub(super) fn draw_marks(target: &mut Target, view: &View, marks: &[Mark], depth: Depth) {
    for mark in marks {
        let [a, b] = [mark.a, mark.b].map(|p| view.camera_from_scene(DVec3::from_array(p)));
        let is_segment = !matches!(mark.kind, MarkKind::Split | MarkKind::Mistake);
        if let Some((a, b)) = in_front(a, b, view.near_m.max(1e-3)).filter(|_| is_segment) {
            draw_segment(target, view, mark.kind, depth, a, b);
        }
        let ends = if mark.a == mark.b { &[a][..] } else { &[a, b] };
        for &end in ends {
            draw_end(target, view, mark.kind, depth, end);
        }
    }
}

pub(super) fn colour(kind: MarkKind) -> [f32; 3] {
    match kind {
        MarkKind::Visible => [0.10, 0.95, 0.30],
        MarkKind::Blocked => [0.95, 0.12, 0.10],
        MarkKind::Unknown => [0.55, 0.55, 0.58],
        MarkKind::Wrong | MarkKind::Mistake => [1.00, 0.10, 0.95],
        MarkKind::Viewer => [1.00, 1.00, 1.00],
        MarkKind::Split => [0.10, 0.25, 0.95],
    }
}

/// Half the width of a mark in samples.
fn half_width(kind: MarkKind) -> i64 {
    let s = i64::from(SAMPLES);
    if kind == MarkKind::Wrong { s } else { s / 2 }
}

/// The part of a segment of the camera frame beyond the near plane.
fn in_front(a: DVec3, b: DVec3, near_m: f64) -> Option<(DVec3, DVec3)> {
    let (da, db) = (-a.z - near_m, -b.z - near_m);
    match (da >= 0.0, db >= 0.0) {
        (true, true) => Some((a, b)),
        (false, false) => None,
        (true, false) => Some((a, a + (b - a) * (da / (da - db)))),
        (false, true) => Some((b + (a - b) * (db / (db - da)), b)),
    }
}

/// The part of the parameter interval [0, 1] in which a screen segment lies within `margin` of the picture.
fn on_screen(p: [f64; 2], q: [f64; 2], size: [f64; 2], margin: f64) -> Option<(f64, f64)> {
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for k in 0..2 {
        let d = q[k] - p[k];
        let (to_low, to_high) = (-margin - p[k], size[k] + margin - p[k]);
        if d == 0.0 {
            if to_low > 0.0 || to_high < 0.0 {
                return None;
            }
            continue;
        }
        let (s, t) = (to_low / d, to_high / d);
        first = first.max(s.min(t));
        last = last.min(s.max(t));
    }
    (first <= last).then_some((first, last))
}

fn draw_segment(target: &mut Target, view: &View, kind: MarkKind, depth: Depth, a: DVec3, b: DVec3) {
    let (pa, pb) = (view.project(a), view.project(b));
    let (p, q) = ([pa.x / pa.z, pa.y / pa.z], [pb.x / pb.z, pb.y / pb.z]);
    let size = [target.width as f64, target.height as f64];
    let Some((first, last)) = on_screen(p, q, size, 8.0) else { return };
    let length = (q[0] - p[0]).abs().max((q[1] - p[1]).abs()) * (last - first);
    let steps = length.clamp(1.0, MAX_STEPS) as u32;
    for step in 0..=steps {
        let s = first + (last - first) * f64::from(step) / f64::from(steps);
        let (x, y) = (p[0] + (q[0] - p[0]) * s, p[1] + (q[1] - p[1]) * s);
        // 1/w is linear on the screen; depth along the axis is linear in space.
        let t = if view.perspective { s * pa.z / (s * pa.z + (1.0 - s) * pb.z) } else { s };
        let at_depth = -(a.z + (b.z - a.z) * t);
        dab(target, kind, depth, [x, y], at_depth, half_width(kind));
    }
}

/// Inner and outer radius of what is drawn at the ends of a mark, in samples.
fn end_radii(kind: MarkKind) -> [i64; 2] {
    let s = i64::from(SAMPLES);
    match kind {
        MarkKind::Split => [0, s + s / 2],
        MarkKind::Mistake => [4 * s, 6 * s],
        _ => [0, 2 * s + half_width(kind)],
    }
}

/// A small disc or ring at an end.
fn draw_end(target: &mut Target, view: &View, kind: MarkKind, depth: Depth, p: DVec3) {
    if -p.z < view.near_m.max(1e-3) {
        return;
    }
    let at = view.project(p);
    let [inner, radius] = end_radii(kind);
    let (cx, cy) = (at.x / at.z, at.y / at.z);
    for dy in -radius..=radius {
        for dx in -radius..=radius {
            if (inner * inner..=radius * radius).contains(&(dx * dx + dy * dy)) {
                dab(target, kind, depth, [cx + dx as f64, cy + dy as f64], -p.z, 0);
            }
        }
    }
}

/// A square of samples. Marks carry no depth of their own, so that later ones cover earlier ones.
fn dab(target: &mut Target, kind: MarkKind, depth: Depth, at: [f64; 2], at_depth: f64, half: i64) {
    let (cx, cy) = (at[0].floor() as i64, at[1].floor() as i64);
    for y in (cy - half).max(0)..=(cy + half).min(target.height as i64 - 1) {
        for x in (cx - half).max(0)..=(cx + half).min(target.width as i64 - 1) {
            let n = y as usize * target.width + x as usize;
            // A thousandth in front, or a line along the ground would come and go with the rounding.
            let hidden = depth == Depth::Tested && at_depth * 0.999 > target.depth[n];
            target.blend(n, colour(kind), if hidden { 0.10 } else { 0.85 });
        }
    }
}
