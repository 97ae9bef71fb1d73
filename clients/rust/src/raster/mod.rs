//! A software rasteriser for pictures of a replica: no graphics card, the same pixels on every machine.
//!
//! Triangles are filled by homogeneous edge functions (Olano and Greer, "Triangle scan conversion using 2D
//! homogeneous coordinates", 1997): a triangle that passes behind the eye needs no clipping, the near plane is a test
//! per sample. Departures: f64 throughout, spans solved per row, a depth buffer of distances along the view axis.
//! Frame: the scene frame, metres east, north and up of post (0, 0).
//!
//! Colours follow height (hypsometric tints) and a light from the north-west, as on printed maps; distance adds haze.
//! Ground without data is blue.

mod fill;
mod font;
mod marks;
mod palette;
mod picture;
mod surface;
mod voids;

use glam::{DQuat, DVec3};

pub use palette::NO_DATA;
pub use picture::{EncodeError, Picture};
pub use surface::Surface;
pub use voids::Voids;

use fill::Target;

/// Greatest width or height of a picture in pixels.
pub const MAX_SIDE_PX: u32 = 8192;
/// Samples along each side of a pixel; their mean is the pixel.
const SAMPLES: u32 = 2;

/// How the scene is projected.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Projection {
    /// A pinhole camera.
    Perspective {
        /// Tangent of half the vertical field of view.
        tan_half_fov: f64,
        /// Distance of the near plane in metres.
        near_m: f64,
    },
    /// A parallel projection.
    Orthographic {
        /// Half the height of the picture in metres.
        half_height_m: f64,
        /// Distance of the near plane in metres.
        near_m: f64,
    },
}

/// Where a picture is taken from. Camera frame: x right, y up, looking along -z.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Camera {
    /// The eye in the scene frame.
    pub eye: [f64; 3],
    /// Rotation from the camera frame to the scene frame: unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
    /// How the scene is projected.
    pub projection: Projection,
    /// Width of the picture, at most [`MAX_SIDE_PX`].
    pub width_px: u32,
    /// Height of the picture, at most [`MAX_SIDE_PX`].
    pub height_px: u32,
}

/// What a line drawn over the terrain stands for; decides its colour.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MarkKind {
    /// A sight line that is visible: green.
    Visible,
    /// A sight line that is blocked: red.
    Blocked,
    /// A sight line whose verdict is unknown: grey.
    Unknown,
    /// A sight line that comes out differently on a plain mesh: magenta, on a map twice as wide.
    Wrong,
    /// A viewer and the edges of what it sees: white.
    Viewer,
    /// A post that was split: a small blue dot at each end.
    Split,
    /// A place where something is wrong: a magenta ring around each end.
    Mistake,
}

/// A segment drawn over the terrain, in the scene frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Mark {
    /// First end.
    pub a: [f64; 3],
    /// Second end.
    pub b: [f64; 3],
    /// What it stands for.
    pub kind: MarkKind,
}

/// What is drawn beside the terrain.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Style {
    /// Whether the edges of triangles are drawn.
    pub wireframe: bool,
    /// Heights in metres at the ends of the colour scale; `None` takes the surface's own.
    pub height_range_m: Option<[f64; 2]>,
    /// Whether the terrain is drawn in greys, so that marks stand out.
    pub muted: bool,
    /// Lines of text printed in the upper left corner: count, epoch, hash.
    pub caption: Vec<String>,
    /// What marks stand for, printed below the caption, each behind its own.
    pub legend: Vec<(MarkKind, String)>,
}

/// Draws the surface as the camera sees it. Parts of marks behind terrain are faint.
pub fn draw_view(surface: &Surface, camera: &Camera, marks: &[Mark], style: &Style) -> Picture {
    let view = View::new(camera);
    let mut target = Target::new(view.width, view.height);
    let paint = Paint::new(surface, style, &view, true);
    fill::fill_surface(&mut target, surface, &view, &paint);
    fill::fill_sky(&mut target, &view);
    marks::draw_marks(&mut target, &view, marks, marks::Depth::Tested);
    finish(&target, surface, style)
}

/// Draws the surface from above, north up: all of it, or the plan rectangle `window` (south-west and north-east
/// corner in metres). `width_px` is the width; the height follows from the window, within [`MAX_SIDE_PX`].
pub fn draw_map(
    surface: &Surface,
    window: Option<[[f64; 2]; 2]>,
    width_px: u32,
    marks: &[Mark],
    style: &Style,
) -> Picture {
    let [low, high] = window.unwrap_or(surface.extent);
    let (wide, tall) = ((high[0] - low[0]).max(1e-9), (high[1] - low[1]).max(1e-9));
    let height_px = (f64::from(width_px) * tall / wide).clamp(1.0, f64::from(MAX_SIDE_PX)) as u32;
    // Above everything that is drawn, or the near plane would cut viewers off.
    let top = marks.iter().fold(surface.height_range_m()[1], |top, m| top.max(m.a[2]).max(m.b[2])) + 1.0;
    let camera = Camera {
        eye: [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), top],
        rotation: [0.0, 0.0, 0.0, 1.0],
        projection: Projection::Orthographic { half_height_m: 0.5 * tall, near_m: 0.0 },
        width_px,
        height_px,
    };
    let view = View::new(&camera);
    let mut target = Target::new(view.width, view.height);
    let paint = Paint::new(surface, style, &view, false);
    fill::fill_surface(&mut target, surface, &view, &paint);
    fill::fill_paper(&mut target);
    marks::draw_marks(&mut target, &view, marks, marks::Depth::OnTop);
    finish(&target, surface, style)
}

fn finish(target: &Target, surface: &Surface, style: &Style) -> Picture {
    let mut picture = target.resolve(SAMPLES);
    let no_data = surface.voids.is_some().then(|| "blue: no data".to_owned());
    let caption: Vec<_> = style.caption.iter().cloned().chain(no_data).collect();
    let legend = style.legend.iter().map(|(kind, text)| (marks::colour(*kind).map(|c| (c * 255.0) as u8), &**text));
    font::print_panel(&mut picture, &caption, &legend.collect::<Vec<_>>());
    picture
}

/// A camera ready to project: everything in samples.
struct View {
    eye: DVec3,
    from_scene: DQuat,
    to_scene: DQuat,
    perspective: bool,
    near_m: f64,
    /// Samples per metre (orthographic), or per unit of slope (perspective).
    zoom: f64,
    width: usize,
    height: usize,
}

impl View {
    fn new(camera: &Camera) -> Self {
        let [x, y, z, w] = camera.rotation;
        let to_scene = DQuat::from_xyzw(x, y, z, w);
        let side = |px: u32| (px.clamp(1, MAX_SIDE_PX) * SAMPLES) as usize;
        let (width, height) = (side(camera.width_px), side(camera.height_px));
        let (perspective, half, near_m) = match camera.projection {
            Projection::Perspective { tan_half_fov, near_m } => (true, tan_half_fov, near_m),
            Projection::Orthographic { half_height_m, near_m } => (false, half_height_m, near_m),
        };
        Self {
            eye: DVec3::from_array(camera.eye),
            from_scene: to_scene.conjugate(),
            to_scene,
            perspective,
            near_m,
            zoom: 0.5 * height as f64 / half,
            width,
            height,
        }
    }

    /// A point of the scene frame in the camera frame.
    fn camera_from_scene(&self, p: DVec3) -> DVec3 {
        self.from_scene * (p - self.eye)
    }

    /// Homogeneous sample coordinates (x, y downward, w) of a point of the camera frame.
    fn project(&self, p: DVec3) -> DVec3 {
        let w = if self.perspective { -p.z } else { 1.0 };
        DVec3::new(p.x * self.zoom + 0.5 * self.width as f64 * w, -p.y * self.zoom + 0.5 * self.height as f64 * w, w)
    }

    /// Unit direction in the scene frame of the ray through the middle of a sample.
    fn ray(&self, x: usize, y: usize) -> DVec3 {
        let right = (x as f64 + 0.5 - 0.5 * self.width as f64) / self.zoom;
        let up = (0.5 * self.height as f64 - y as f64 - 0.5) / self.zoom;
        let d = if self.perspective { DVec3::new(right, up, -1.0) } else { -DVec3::Z };
        self.to_scene * (d / d.length())
    }
}

/// How surface samples get their colour.
struct Paint {
    low_m: f64,
    span_m: f64,
    wireframe: bool,
    muted: bool,
    /// Distance in metres at which haze hides half of a colour; infinite for a map.
    haze_m: f64,
    /// How much steeper slopes look to the light than they are.
    relief: f64,
}

impl Paint {
    fn new(surface: &Surface, style: &Style, view: &View, haze: bool) -> Self {
        let [low_m, high_m] = style.height_range_m.unwrap_or_else(|| surface.height_range_m());
        let [[west, south], [east, north]] = surface.extent;
        let extent_m = (east - west).max(north - south);
        Self {
            low_m,
            span_m: (high_m - low_m).max(1.0),
            wireframe: style.wireframe,
            muted: style.muted,
            haze_m: if haze && view.perspective { (0.6 * extent_m).clamp(2_000.0, 45_000.0) } else { f64::INFINITY },
            relief: if haze { 1.5 } else { 2.5 },
        }
    }
}

#[cfg(test)]
mod tests;
