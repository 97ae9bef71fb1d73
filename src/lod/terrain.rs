//! What all systems of this module start from: the posts of one terrain in one array, and a view of it.
//!
//! The published systems hold their height map as one array, so this module does too; it is the only place in the
//! project that does. Beyond the grid the array repeats the border, as padding does everywhere (see `terrain`).

use std::sync::Arc;

use glam::{DQuat, DVec3};
use sightline_proto::diamond::Post;

use super::LodError;
use crate::{
    terrain::{Grid, HeightField, Posts, SceneScale},
    view::{Camera, CameraError, Projection},
};

/// Greatest side of a root square that is held as one array: 8193 x 8193 posts, half a gigabyte.
pub const MAX_SIDE: u32 = 8192;

/// The heights of a root square, padding included, and the scale of its axes.
#[derive(Clone, Debug)]
pub struct Ground {
    grid: Grid,
    side: u32,
    z: Vec<f64>,
    scale: SceneScale,
}

impl Ground {
    /// Reads all posts of `field`.
    pub fn read<H: HeightField + ?Sized>(field: &H, scale: SceneScale) -> Result<Arc<Self>, LodError> {
        let grid = field.grid();
        let side = grid.root().side();
        if side > MAX_SIDE {
            return Err(LodError::TooLarge { side });
        }
        let mut posts = Posts::new(field);
        let mut z = Vec::with_capacity((side as usize + 1).pow(2));
        for j in 0..=side {
            for i in 0..=side {
                z.push(posts.at(Post::new(i, j))?.z);
            }
        }
        Ok(Arc::new(Self { grid, side, z, scale }))
    }

    /// The extent of the terrain proper.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Cells along a side of the root square, 2^m.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// Metres per post and per height unit.
    pub fn scale(&self) -> SceneScale {
        self.scale
    }

    /// Where a post is in the array.
    pub(super) fn index(&self, i: u32, j: u32) -> usize {
        j as usize * (self.side as usize + 1) + i as usize
    }

    /// The height of a post of the root square, in height units.
    pub fn z(&self, i: u32, j: u32) -> f64 {
        self.z[self.index(i, j)]
    }

    /// Changes the height of a post of the root square: for systems that allow it without preparation.
    pub fn set_z(&mut self, i: u32, j: u32, z: f64) {
        let n = self.index(i, j);
        self.z[n] = z;
    }

    /// A post in the scene frame.
    pub fn scene(&self, i: u32, j: u32) -> DVec3 {
        self.scale.scene_from_grid(DVec3::new(f64::from(i), f64::from(j), self.z(i, j)))
    }

    /// Height in metres of the terrain under a point of the scene frame: that of the nearest post.
    pub(super) fn ground_m(&self, p: DVec3) -> f64 {
        let g = self.scale.grid_from_scene(p);
        let nearest = |v: f64| (v + 0.5).clamp(0.0, f64::from(self.side)) as u32;
        self.z(nearest(g.x), nearest(g.y)) * self.scale.up_m
    }

    /// Bytes of the array of heights.
    pub fn bytes(&self) -> usize {
        size_of_val(self.z.as_slice())
    }
}

/// Where a ball lies against the frustum.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Place {
    /// Outside at least one plane.
    Out,
    /// Neither.
    Partly,
    /// Inside all planes.
    In,
}

/// A perspective view: what every paper here assumes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LodView {
    eye: DVec3,
    pixels: f64,
    near_m: f64,
    camera: Camera,
    /// To the right, up and forward, of length 1.
    axes: [DVec3; 3],
    /// Tangents of half the angles across and up.
    half: [f64; 2],
}

impl LodView {
    /// A view from `eye` in metres in the scene frame; the arguments are those of [`Camera::new`].
    pub fn new(
        eye: DVec3,
        rotation: DQuat,
        tan_half_fov: f64,
        near_m: f64,
        viewport_px: [u32; 2],
    ) -> Result<Self, CameraError> {
        let camera = Camera::new(eye, rotation, Projection::Perspective { tan_half_fov, near_m }, viewport_px)?;
        let pixels = f64::from(viewport_px[1]) / (2.0 * tan_half_fov);
        let half = [tan_half_fov * f64::from(viewport_px[0]) / f64::from(viewport_px[1]), tan_half_fov];
        let unit = rotation.normalize();
        let axes = [unit * DVec3::X, unit * DVec3::Y, unit * DVec3::NEG_Z];
        Ok(Self { eye, pixels, near_m, camera, axes, half })
    }

    /// The eye in metres in the scene frame.
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// Pixels that a metre across the view covers at a distance of one metre: v / (2 tan(fov / 2)). With the near plane
    /// n and its top t of the papers, tan(fov / 2) = |t| / n, so this is n v / (2 |t|).
    pub fn pixels(&self) -> f64 {
        self.pixels
    }

    /// Distance of the near plane in metres.
    pub fn near_m(&self) -> f64 {
        self.near_m
    }

    /// The corners of the picture at a depth in front of the eye, in the scene frame, around the axis.
    pub(super) fn corners(&self, depth_m: f64) -> [DVec3; 4] {
        let [right, up, forward] = self.axes;
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| self.eye + (forward + right * (x * self.half[0]) + up * (y * self.half[1])) * depth_m)
    }

    /// The camera, for measures of distortion.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Where a ball lies: outside one plane of the frustum, inside all, or neither.
    pub(super) fn classify(&self, centre: DVec3, radius_m: f64) -> Place {
        let [right, up, forward] = self.axes;
        let offset = centre - self.eye;
        let [x, y, depth] = [right, up, forward].map(|axis| offset.dot(axis));
        let mut least = depth - self.near_m;
        for (across, half) in [(x, self.half[0]), (y, self.half[1])] {
            least = least.min((depth * half - across.abs()) / (1.0 + half * half).sqrt());
        }
        match least {
            _ if least < -radius_m => Place::Out,
            _ if least >= radius_m => Place::In,
            _ => Place::Partly,
        }
    }

    /// Where a point appears, in pixels from the middle of the picture; `None` nearer than the near plane.
    pub fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        let [x, y, depth] = self.axes.map(|axis| (p - self.eye).dot(axis));
        (depth >= self.near_m).then(|| [x / depth * self.pixels, y / depth * self.pixels])
    }

    /// Whether two views differ in the place of the eye only.
    pub(super) fn same_picture(&self, other: &Self) -> bool {
        self.axes == other.axes && self.half == other.half && self.pixels == other.pixels
    }

    /// Whether a ball meets the frustum (more exactly: no plane of the frustum has the whole ball outside).
    pub fn sees(&self, centre: DVec3, radius_m: f64) -> bool {
        self.camera.priority(1.0, centre, radius_m) > 0.0
    }
}
