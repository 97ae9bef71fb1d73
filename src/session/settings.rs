//! What a client may ask of a view, checked: camera, target, subscription and regions, and the pose.

use std::collections::BTreeSet;

use glam::{DQuat, DVec2, DVec3};
use sightline_proto::v1;
use thiserror::Error;

use super::{FrameTime, MAX_RATE_HZ, MIN_BYTES_PER_S};
use crate::{
    roam::{Options, Region, Regions, RegionsError, Target},
    view::{Camera, CameraError, Projection},
};

/// Greatest triangle budget of a view.
pub const MAX_TRIANGLES: u32 = 4_000_000;
/// Least triangle budget: the two triangles of the root square.
pub const MIN_TRIANGLES: u32 = 2;
/// Greatest number of sight lines in a subscription's list.
pub const MAX_SUBSCRIBED_IDS: usize = 20_000;
/// Why the settings or the pose of a view were refused.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum SettingsError {
    /// Something that must be there is not.
    #[error("{0} is missing")]
    Missing(&'static str),
    /// A triangle count out of range.
    #[error("{what} is {found}; it must be from {MIN_TRIANGLES} to {MAX_TRIANGLES}")]
    Triangles {
        /// Which count.
        what: &'static str,
        /// The count.
        found: u32,
    },
    /// A distortion that cannot be aimed for.
    #[error("screen_error.pixels is {0}; it must be finite and above 0")]
    Pixels(f64),
    /// A time that no frame takes.
    #[error("{0} is {1} ms; it must be finite and above 0 (a report of 0 says nothing)")]
    Milliseconds(&'static str, f64),
    /// A rate of frames that no view has.
    #[error("pace.max_rate_hz is {0}; it must be from 0 (on every change) to {MAX_RATE_HZ}")]
    Rate(f64),
    /// A bandwidth in which no frame would ever come.
    #[error("pace.max_bytes_per_s is {0}; it must be 0 (no limit) or at least {MIN_BYTES_PER_S}")]
    Bandwidth(u64),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The regions of interest.
    #[error("regions: {0}")]
    Regions(#[from] RegionsError),
    /// A subscription to too many lines.
    #[error("a subscription to {0} sight lines; the limit is {MAX_SUBSCRIBED_IDS} ids, or subscribe to all")]
    TooManyIds(usize),
}

/// The sight lines that a view honours.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Subscription {
    /// All, also those that are added later.
    All,
    /// None, and not the eye either: the plain mesh of the viewpoint.
    None,
    /// Those of a list.
    List(BTreeSet<u64>),
}

impl Subscription {
    /// Whether the line is among them.
    pub fn contains(&self, id: u64) -> bool {
        match self {
            Self::All => true,
            Self::None => false,
            Self::List(ids) => ids.contains(&id),
        }
    }
}

/// Camera, target, subscription and regions of a view.
#[derive(Clone, PartialEq, Debug)]
pub struct Settings {
    /// The projection.
    pub projection: Projection,
    /// Width and height of the picture in pixels.
    pub viewport_px: [u32; 2],
    /// The target. For a frame time it states the greatest number of triangles.
    pub target: Target,
    /// Milliseconds that a client's frame should take, where that steers the number of triangles.
    pub frame_time_ms: Option<f64>,
    /// The sight lines.
    pub subscription: Subscription,
    /// Where distortion counts for more.
    pub regions: Regions,
}

/// Place and orientation of a camera.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Pose {
    /// The eye in the scene frame.
    pub eye_m: DVec3,
    /// From the camera frame (x right, y up, looking along -z) to the scene frame.
    pub rotation: DQuat,
}

impl Settings {
    /// The settings of a message.
    pub fn from_wire(settings: &v1::ViewSettings) -> Result<Self, SettingsError> {
        Ok(Self {
            projection: projection(settings)?,
            viewport_px: [settings.viewport_width_px, settings.viewport_height_px],
            target: target(settings)?,
            frame_time_ms: frame_time_ms(settings)?,
            subscription: subscription(settings)?,
            regions: regions(settings)?,
        })
    }

    /// How the view is refined.
    pub(super) fn options(&self) -> Options {
        Options { regions: self.regions.clone(), ..Options::default() }
    }

    /// The controller of the budget where the target is a frame time: `before` if that aims for the same.
    pub(super) fn controller(&self, before: Option<FrameTime>) -> Option<FrameTime> {
        let (Some(wanted_ms), Target::TriangleBudget(max)) = (self.frame_time_ms, self.target) else { return None };
        let before = before.filter(|control| control.aims_for(wanted_ms, max));
        Some(before.unwrap_or_else(|| FrameTime::new(wanted_ms, max)))
    }

    /// The camera of a pose.
    pub fn camera(&self, pose: &Pose) -> Result<Camera, SettingsError> {
        Ok(Camera::new(pose.eye_m, pose.rotation, self.projection, self.viewport_px)?)
    }
}

fn projection(settings: &v1::ViewSettings) -> Result<Projection, SettingsError> {
    use v1::view_settings::Projection as Wire;
    Ok(match settings.projection.as_ref().ok_or(SettingsError::Missing("projection"))? {
        Wire::Perspective(p) => Projection::Perspective { tan_half_fov: p.tan_half_fov, near_m: p.near_m },
        Wire::Orthographic(o) => Projection::Orthographic { half_height_m: o.half_height_m, near_m: o.near_m },
    })
}

fn target(settings: &v1::ViewSettings) -> Result<Target, SettingsError> {
    use v1::view_settings::Target as Wire;
    Ok(match settings.target.as_ref().ok_or(SettingsError::Missing("target"))? {
        Wire::TriangleBudget(budget) => Target::TriangleBudget(triangles("triangle_budget", budget.triangles)?),
        Wire::FrameTime(time) => Target::TriangleBudget(triangles("frame_time.max_triangles", time.max_triangles)?),
        Wire::ScreenError(error) if !(error.pixels.is_finite() && error.pixels > 0.0) => {
            return Err(SettingsError::Pixels(error.pixels));
        }
        Wire::ScreenError(error) => {
            Target::ScreenError { px: error.pixels, max: triangles("screen_error.max_triangles", error.max_triangles)? }
        }
    })
}

fn frame_time_ms(settings: &v1::ViewSettings) -> Result<Option<f64>, SettingsError> {
    match settings.target {
        Some(v1::view_settings::Target::FrameTime(v1::FrameTime { milliseconds, .. })) => {
            let sound = milliseconds.is_finite() && milliseconds > 0.0;
            if sound { Ok(Some(milliseconds)) } else { Err(SettingsError::Milliseconds("frame_time", milliseconds)) }
        }
        _ => Ok(None),
    }
}

fn triangles(what: &'static str, found: u32) -> Result<u32, SettingsError> {
    if (MIN_TRIANGLES..=MAX_TRIANGLES).contains(&found) {
        Ok(found)
    } else {
        Err(SettingsError::Triangles { what, found })
    }
}

fn subscription(settings: &v1::ViewSettings) -> Result<Subscription, SettingsError> {
    use v1::subscription::Lines;
    match settings.subscription.as_ref().and_then(|subscription| subscription.lines.as_ref()) {
        None | Some(Lines::All(_)) => Ok(Subscription::All),
        Some(Lines::None(_)) => Ok(Subscription::None),
        Some(Lines::List(list)) if list.ids.len() > MAX_SUBSCRIBED_IDS => {
            Err(SettingsError::TooManyIds(list.ids.len()))
        }
        Some(Lines::List(list)) => Ok(Subscription::List(list.ids.iter().copied().collect())),
    }
}

fn regions(settings: &v1::ViewSettings) -> Result<Regions, RegionsError> {
    let region = |r: &v1::RegionOfInterest| Region {
        centre_m: DVec2::new(r.east_m, r.north_m),
        radius_m: r.radius_m,
        weight: r.weight,
    };
    Regions::new(settings.regions.iter().map(region).collect())
}

impl Pose {
    /// The pose of a message; what its numbers may be, [`Settings::camera`] checks.
    pub fn from_wire(pose: &v1::Pose) -> Result<Self, SettingsError> {
        let eye = pose.eye.ok_or(SettingsError::Missing("eye"))?;
        let q = pose.rotation.ok_or(SettingsError::Missing("rotation"))?;
        Ok(Self { eye_m: DVec3::new(eye.x, eye.y, eye.z), rotation: DQuat::from_xyzw(q.x, q.y, q.z, q.w) })
    }
}
