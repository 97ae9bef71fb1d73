//! Cameras: pose, projection, frustum, and the bound on screen-space distortion that orders refinement.
//!
//! Follows Duchaineau et al., "Good terrain geometry, cheap!", section 5, in asking for the extreme, over all vertical
//! segments of a wedgie, of their length on the screen. It departs where the paper evaluates the corners only and
//! argues that the difference can be neglected: here the bound is proven, over a ball that holds the wedgie, and it is
//! monotone under nesting, so that greedy refinement is optimal.
//!
//! Arithmetic is f64 with + - * / and square root only, in a written order: the same bits on every machine.

mod appraisal;
#[cfg(test)]
mod tests;

use glam::{DQuat, DVec3};
use thiserror::Error;

pub use appraisal::{Appraisal, Motion};

/// Furthest that an eye may be from post (0, 0) in any direction, in metres. The margin of the bounding balls
/// (see `wedgie`) dominates rounding up to here, for posts 4 mm apart and wider.
pub const MAX_EYE_M: f64 = 1e8;
/// Range of the tangent of half the vertical field of view.
pub const TAN_HALF_FOV_RANGE: (f64, f64) = (1e-6, 1e6);
/// Range of the near distance and of an orthographic half height, in metres.
pub const LENGTH_RANGE_M: (f64, f64) = (1e-6, 1e9);
/// Greatest width and height of a viewport.
pub const MAX_VIEWPORT_PX: u32 = 1 << 20;
/// How far the length of a quaternion may be from 1.
pub const UNIT_TOLERANCE: f64 = 1e-6;

/// Why a camera makes no sense.
#[derive(Clone, Copy, PartialEq, Debug, Error)]
pub enum CameraError {
    /// The eye is not a usable place.
    #[error("the eye ({x}, {y}, {z}) must be finite and within {MAX_EYE_M} m of post (0, 0) in each direction")]
    Eye {
        /// East.
        x: f64,
        /// North.
        y: f64,
        /// Up.
        z: f64,
    },
    /// The orientation is not a rotation.
    #[error("the orientation's quaternion has length {length}; it must be 1 within {UNIT_TOLERANCE}")]
    Rotation {
        /// Its length, NaN when a component is not finite.
        length: f64,
    },
    /// A parameter of the projection is out of range.
    #[error("{what} is {value}; it must be from {least} to {greatest}")]
    Projection {
        /// Which one.
        what: &'static str,
        /// What was given.
        value: f64,
        /// The least that is accepted.
        least: f64,
        /// The greatest that is accepted.
        greatest: f64,
    },
    /// The picture has no pixels, or too many.
    #[error("a viewport of {width} x {height} pixels; each must be from 1 to {MAX_VIEWPORT_PX}")]
    Viewport {
        /// Pixels from left to right.
        width: u32,
        /// Pixels from top to bottom.
        height: u32,
    },
}

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

/// A pose and a projection: what a view sees. Two equal cameras see the same, bit for bit.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Camera {
    /// `None`: from everywhere at once; distortion is the vertical error in metres.
    eye: Option<Eye>,
}

#[derive(Clone, Copy, PartialEq, Debug)]
struct Eye {
    eye: DVec3,
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    projection: Projection,
    /// Half the width and half the height of the picture: tangents, or metres for a parallel projection.
    half: [f64; 2],
    /// Normals of the four side planes, pointing inwards, of length 1.
    sides: [DVec3; 4],
    near_m: f64,
    /// Pixels per unit of `half`.
    pixels: f64,
    /// What multiplies a thickness in metres; see [`Eye::priority`].
    weight: f64,
    /// Secant of the angle between the axis and a corner of the picture.
    secant: f64,
}

/// Planes of the frustum on whose inner side a ball wholly lies: the near plane, then the four sides.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct Planes(u8);

impl Planes {
    const ALL: u8 = 0b1_1111;
}

/// Widens a bound over the rounding of the few operations that make it.
const BOUND_MARGIN: f64 = 1.0 + 1.0 / 1_099_511_627_776.0;

/// Least share of a vertical segment's length that a parallel projection is taken to show: seen from straight above it
/// shows nothing, but then the order of refinement should still be that of thickness.
const LEAST_FORESHORTENING: f64 = 1.0 / 1_048_576.0;

impl Camera {
    /// A camera at `eye`, in metres in the scene frame. `rotation` turns the camera frame (x right, y up, looking along
    /// -z) to the scene frame (east, north, up). The picture is `viewport_px` wide and high.
    pub fn new(
        eye: DVec3,
        rotation: DQuat,
        projection: Projection,
        viewport_px: [u32; 2],
    ) -> Result<Self, CameraError> {
        if !(eye.x.abs() <= MAX_EYE_M && eye.y.abs() <= MAX_EYE_M && eye.z.abs() <= MAX_EYE_M) {
            return Err(CameraError::Eye { x: eye.x, y: eye.y, z: eye.z });
        }
        let [width, height] = viewport_px;
        if ![width, height].iter().all(|n| (1..=MAX_VIEWPORT_PX).contains(n)) {
            return Err(CameraError::Viewport { width, height });
        }
        projection.check()?;
        let [right, up, backward] = axes(rotation)?;
        let (tan_or_m, near_m) = match projection {
            Projection::Perspective { tan_half_fov, near_m } => (tan_half_fov, near_m),
            Projection::Orthographic { half_height_m, near_m } => (half_height_m, near_m),
        };
        let forward = -backward;
        let half = [tan_or_m * f64::from(width) / f64::from(height), tan_or_m];
        let pixels = f64::from(height) / (2.0 * tan_or_m);
        let side = |axis: DVec3, half: f64| match projection {
            Projection::Perspective { .. } => (forward * half + axis) / (1.0 + half * half).sqrt(),
            Projection::Orthographic { .. } => axis,
        };
        let sides = [side(right, half[0]), side(-right, half[0]), side(up, half[1]), side(-up, half[1])];
        let foreshortening = (right.z * right.z + up.z * up.z).sqrt().max(LEAST_FORESHORTENING);
        let weight = match projection {
            Projection::Perspective { .. } => pixels * BOUND_MARGIN,
            Projection::Orthographic { .. } => pixels * foreshortening * BOUND_MARGIN,
        };
        let secant = (1.0 + half[0] * half[0] + half[1] * half[1]).sqrt();
        let eye = Eye { eye, right, up, forward, projection, half, sides, near_m, pixels, weight, secant };
        Ok(Self { eye: Some(eye) })
    }

    /// No eye: everything is in the picture, and distortion is the vertical error in metres of the world.
    pub fn everywhere() -> Self {
        Self { eye: None }
    }

    /// The eye in metres in the scene frame, if there is one.
    pub fn eye(&self) -> Option<DVec3> {
        self.eye.as_ref().map(|eye| eye.eye)
    }

    /// A bound in pixels on the distortion of any vertical segment of length `thickness_m` that begins in the frustum
    /// and lies in the ball of `radius_m` around `centre`, all in metres in the scene frame.
    ///
    /// Not decreasing in the thickness, nor in the ball under containment, computed values included, when balls are
    /// nested with the margin of `wedgie`. Zero exactly when the thickness is 0 or one plane of the frustum has the
    /// whole ball on its outer side; +infinity when the ball reaches the near plane. Never NaN.
    pub fn priority(&self, thickness_m: f64, centre: DVec3, radius_m: f64) -> f64 {
        match &self.eye {
            _ if thickness_m <= 0.0 => 0.0,
            None => thickness_m,
            Some(eye) => eye.priority_alone(thickness_m, centre, radius_m),
        }
    }

    /// [`Camera::priority`] of a ball that lies in another one, which is wholly on the inner side of the planes
    /// `inside`; and the planes that this ball is wholly on the inner side of.
    ///
    /// The priority is the same, bit for bit: what lies in a ball on the inner side of a plane is not on the outer one.
    pub fn priority_within(&self, inside: Planes, thickness_m: f64, centre: DVec3, radius_m: f64) -> (f64, Planes) {
        match &self.eye {
            _ if thickness_m <= 0.0 => (0.0, inside),
            None => (thickness_m, inside),
            Some(eye) => eye.priority(inside, thickness_m, centre, radius_m),
        }
    }

    /// Distortion in pixels between two places of one plan point, in the scene frame: `None` when the finest one is
    /// not in the frustum, +infinity when the mesh's is nearer than the near plane. Without an eye: metres.
    pub fn distortion(&self, finest: DVec3, mesh: DVec3) -> Option<f64> {
        let Some(eye) = &self.eye else { return Some((finest.z - mesh.z).abs()) };
        let ([x, y], depth) = eye.project(finest);
        if depth < eye.near_m || x.abs() > eye.half[0] || y.abs() > eye.half[1] {
            return None;
        }
        let ([mesh_x, mesh_y], mesh_depth) = eye.project(mesh);
        if mesh_depth < eye.near_m {
            return Some(f64::INFINITY);
        }
        let (dx, dy) = (mesh_x - x, mesh_y - y);
        Some((dx * dx + dy * dy).sqrt() * eye.pixels)
    }
}

impl Eye {
    /// See [`Camera::priority`].
    ///
    /// *Perspective.* In the camera frame let P = (x, y, -w) be a point of the segment in the frustum and P + t u
    /// another one, u being the unit vector up, |t| <= thickness, both in front of the near plane: w, w' >= near. Their
    /// places in the picture differ by t N / (w w') with N = w (ux, uy) + uz (x, y). N is, turned by a quarter, part of
    /// the vector product of P and u, so |N| is at most the horizontal distance of P from the eye. By Cauchy's
    /// inequality it is also at most w times the secant D of the angle of P off the axis, which is no more than a
    /// corner's. With the least depth of the ball, zmin <= w, w', and the greatest horizontal distance h:
    ///
    /// pixels * thickness * min(D / zmin, h / zmin^2).
    ///
    /// zmin does not fall and h does not rise towards a contained ball; rounding is monotone.
    ///
    /// *Parallel.* The places differ by t (ux, uy), wherever P is.
    fn priority(&self, inside: Planes, thickness_m: f64, centre: DVec3, radius_m: f64) -> (f64, Planes) {
        let offset = centre - self.eye;
        let depth = dot(offset, self.forward);
        let Some(inside) = self.cull(inside, offset, depth, radius_m) else { return (0.0, inside) };
        let horizontal = || (offset.x * offset.x + offset.y * offset.y).sqrt() + radius_m;
        (self.distortion_bound(thickness_m, depth - radius_m, horizontal), inside)
    }

    /// [`Eye::priority`] of a ball of which nothing is known, without telling its planes; the same bits.
    fn priority_alone(&self, thickness_m: f64, centre: DVec3, radius_m: f64) -> f64 {
        let offset = centre - self.eye;
        let depth = dot(offset, self.forward);
        let half = self.half_if_parallel();
        let distances = self.sides.map(|side| dot(offset, side));
        let outside = |n: usize| distances[n] < -(radius_m + half[n / 2]);
        // All of them: it is cheaper to ask than to choose whether to.
        if (depth + radius_m < self.near_m) | outside(0) | outside(1) | outside(2) | outside(3) {
            return 0.0;
        }
        let horizontal = || (offset.x * offset.x + offset.y * offset.y).sqrt() + radius_m;
        self.distortion_bound(thickness_m, depth - radius_m, horizontal)
    }

    /// How far the side planes are beyond the eye.
    fn half_if_parallel(&self) -> [f64; 2] {
        match self.projection {
            Projection::Perspective { .. } => [0.0; 2],
            Projection::Orthographic { .. } => self.half,
        }
    }

    /// The bound for a ball that is not outside of a plane, by its least depth and its greatest horizontal distance.
    fn distortion_bound(&self, thickness_m: f64, nearest: f64, horizontal: impl FnOnce() -> f64) -> f64 {
        // Not `nearest <= near`: a ball of infinite radius must not slip through as NaN either.
        if !(nearest > self.near_m && thickness_m.is_finite()) {
            return f64::INFINITY;
        }
        match self.projection {
            Projection::Perspective { .. } => {
                let spread = (self.secant / nearest).min(horizontal() / (nearest * nearest));
                self.weight * thickness_m * spread
            }
            Projection::Orthographic { .. } => self.weight * thickness_m,
        }
    }

    /// `None` when one of the planes that are not in `inside` has the whole ball on its outer side; else `inside` with
    /// the planes that have the whole ball on their inner side.
    fn cull(&self, inside: Planes, offset: DVec3, depth: f64, radius_m: f64) -> Option<Planes> {
        let mut now = inside;
        if inside.0 & 1 == 0 {
            if depth + radius_m < self.near_m {
                return None;
            }
            now.0 |= u8::from(depth - radius_m >= self.near_m);
        }
        if inside.0 | 1 == Planes::ALL {
            return Some(now);
        }
        let half = self.half_if_parallel();
        for (n, side) in self.sides.iter().enumerate() {
            if inside.0 >> (n + 1) & 1 == 0 {
                let distance = dot(offset, *side);
                if distance < -(radius_m + half[n / 2]) {
                    return None;
                }
                now.0 |= u8::from(distance >= radius_m) << (n + 1);
            }
        }
        Some(now)
    }

    /// Place in the picture, in the unit of `half`, and depth.
    fn project(&self, p: DVec3) -> ([f64; 2], f64) {
        let offset = p - self.eye;
        let (x, y, depth) = (dot(offset, self.right), dot(offset, self.up), dot(offset, self.forward));
        match self.projection {
            Projection::Perspective { .. } => ([x / depth, y / depth], depth),
            Projection::Orthographic { .. } => ([x, y], depth),
        }
    }
}

impl Projection {
    fn check(&self) -> Result<(), CameraError> {
        let within = |what, value: f64, (least, greatest): (f64, f64)| {
            if (least..=greatest).contains(&value) {
                return Ok(());
            }
            Err(CameraError::Projection { what, value, least, greatest })
        };
        match *self {
            Self::Perspective { tan_half_fov, near_m } => {
                within("the tangent of half the field of view", tan_half_fov, TAN_HALF_FOV_RANGE)?;
                within("the near distance in metres", near_m, LENGTH_RANGE_M)
            }
            Self::Orthographic { half_height_m, near_m } => {
                within("half the height of the picture in metres", half_height_m, LENGTH_RANGE_M)?;
                within("the near distance in metres", near_m, LENGTH_RANGE_M)
            }
        }
    }
}

/// The sum of products from left to right.
fn dot(a: DVec3, b: DVec3) -> f64 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

/// The images of the camera's x, y and z axes.
fn axes(q: DQuat) -> Result<[DVec3; 3], CameraError> {
    let length = (q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w).sqrt();
    if length.is_nan() || (length - 1.0).abs() > UNIT_TOLERANCE {
        return Err(CameraError::Rotation { length });
    }
    let (x, y, z, w) = (q.x / length, q.y / length, q.z / length, q.w / length);
    Ok([
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    ])
}
