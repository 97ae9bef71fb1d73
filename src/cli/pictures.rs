//! Pictures of what a scene generator sees: its mesh, the sight lines, and the numbers that identify both.

use glam::{DQuat, DVec3};
use sightline_client::{
    raster::{self, Camera, Mark, MarkKind, Picture, Projection, Style, Surface},
    scene::SceneState,
};
use sightline_proto::{
    v1,
    verdict::{MeshVerdict, verdict_on_mesh},
};

use crate::evaluate::flight::Viewpoint;

/// Width of a picture from above in pixels.
const MAP_WIDTH_PX: u32 = 1000;
/// How far the edges of the viewer's picture are drawn on a map, in metres.
const VIEWER_EDGE_M: f64 = 4_000.0;

/// What is to be drawn.
pub(super) struct Scene<'a> {
    pub(super) name: &'a str,
    pub(super) state: &'a SceneState,
    /// What is drawn: the mesh, or the mesh on its way to it.
    pub(super) surface: Surface,
    /// Triangles that are drawn, where that may be more than the mesh has.
    pub(super) triangles_drawn: Option<u64>,
    pub(super) viewpoint: &'a Viewpoint,
    pub(super) projection: Projection,
    pub(super) viewport_px: [u32; 2],
    /// Plan rectangle of the picture from above; the whole terrain when absent.
    pub(super) window_m: Option<[[f64; 2]; 2]>,
}

impl Scene<'_> {
    /// What the viewer sees.
    pub(super) fn eye_picture(&self) -> Picture {
        let camera = Camera {
            eye: self.viewpoint.eye.to_array(),
            rotation: self.viewpoint.rotation,
            projection: self.projection,
            width_px: self.viewport_px[0],
            height_px: self.viewport_px[1],
        };
        raster::draw_view(&self.surface, &camera, &self.marks(), &self.style())
    }

    /// The same mesh from above, with the viewer on it.
    pub(super) fn map_picture(&self) -> Picture {
        let mut marks = self.marks();
        marks.extend(self.viewer());
        raster::draw_map(&self.surface, self.window_m, MAP_WIDTH_PX, &marks, &self.style())
    }

    fn style(&self) -> Style {
        let terrain = self.state.terrain();
        let unit_m = terrain.metres_per_height_unit;
        let (frame, replica) = (self.state.last_frame(), self.state.replica());
        let (lines, named) = (self.state.lines().len(), self.state.unsatisfied().len());
        let drawn = self.triangles_drawn.map_or(String::new(), |n| format!("{n} drawn, "));
        Style {
            wireframe: true,
            height_range_m: Some([terrain.min_height * unit_m, terrain.max_height * unit_m]),
            caption: vec![
                format!("{}: {drawn}{} triangles, bound {:.2} px", self.name, replica.triangle_count(), frame.bound_px),
                format!("epoch {}, frame {}, hash {:016x}", frame.epoch, frame.sequence, replica.hash()),
                format!("{lines} sight lines, {named} named unsatisfied"),
            ],
            ..Style::default()
        }
    }

    /// The sight lines as this mesh has them.
    fn marks(&self) -> Vec<Mark> {
        let scale = DVec3::from_array(self.state.replica().scale_m());
        let scene = |p: [f64; 3]| (DVec3::from_array(p) * scale).to_array();
        let mark = |line: &sightline_client::scene::StatedLine| {
            let [a, b] = line.ends?;
            let kind = match (line.verdict, verdict_on_mesh(self.state.replica(), a, b)) {
                (v1::Verdict::Unknown | v1::Verdict::Unspecified, _) => MarkKind::Unknown,
                (v1::Verdict::Visible, MeshVerdict::Visible) => MarkKind::Visible,
                (v1::Verdict::Blocked, MeshVerdict::Blocked) => MarkKind::Blocked,
                _ => MarkKind::Wrong,
            };
            Some(Mark { a: scene(a), b: scene(b), kind })
        };
        self.state.lines().values().filter_map(mark).collect()
    }

    /// The viewer and the left and right edge of its picture; of a parallel projection, the sides of its middle.
    fn viewer(&self) -> [Mark; 2] {
        let [x, y, z, w] = self.viewpoint.rotation;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let aspect = f64::from(self.viewport_px[0]) / f64::from(self.viewport_px[1].max(1));
        let (beside, side) = match self.projection {
            Projection::Perspective { tan_half_fov, .. } => (0.0, tan_half_fov * aspect),
            Projection::Orthographic { half_height_m, .. } => (half_height_m * aspect, 0.0),
        };
        [-1.0, 1.0].map(|sign| {
            let a = self.viewpoint.eye + rotation * DVec3::X * (sign * beside);
            let edge = rotation * DVec3::new(sign * side, 0.0, -1.0);
            let b = a + edge * (VIEWER_EDGE_M / edge.length());
            Mark { a: a.to_array(), b: b.to_array(), kind: MarkKind::Viewer }
        })
    }
}
