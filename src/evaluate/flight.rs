//! Flights: deterministic sequences of viewpoints over a terrain's scene frame (metres east, north, up of post (0, 0)).
//!
//! A preset is a path in plan with heights above ground; a listed flight has absolute positions. The ground is asked
//! for once, as one list of plan points, so that heights may come from a database or over a network. Only + - x / and
//! square roots are used: circles turn by rational rotations. The same flight is the same bits on every machine.

use std::{fmt, str::FromStr};

use glam::DVec3;
use thiserror::Error;

use super::dice::Dice;

/// Greatest number of frames of a flight.
pub const MAX_FRAMES: usize = 1_000_000;
/// Frames on either side over which the ground under a flying eye is averaged, about half a second.
const SMOOTH_FRAMES: usize = 15;
/// Speed of the straight flight and of the turn.
const FAST_M_S: f64 = 250.0;
/// Steepest climb and dive of terrain avoidance, in metres up per metre flown.
const STEEPEST: f64 = 0.2;
/// Height above ground that terrain avoidance keeps.
const AVOIDANCE_M: f64 = 60.0;
/// Speed of the helicopter and of the orbit along its circle.
const SLOW_M_S: f64 = 40.0;

/// A path that exists for every terrain.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Preset {
    /// Straight and level over the ground at 250 m/s, 150 m up, looking ahead.
    Straight,
    /// 40 m/s, 40 m up, weaving, looking at the ground ahead.
    Helicopter,
    /// A circle of 3 km around a point of the ground, 400 m up, looking at the point.
    Orbit,
    /// 250 m/s with a turn of 180 degrees in the middle third.
    Turn,
    /// Another place every tenth frame.
    Teleport,
    /// Low over the terrain at 250 m/s in wide curves, 60 m above the ground or more: on the lowest path that climbs and
    /// dives no steeper than 1 in 5.
    TerrainAvoidance,
}

/// The presets, in the order in which clients of a test take them.
pub const PRESETS: [Preset; 6] =
    [Preset::Straight, Preset::Orbit, Preset::Helicopter, Preset::Turn, Preset::Teleport, Preset::TerrainAvoidance];

impl Preset {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::Helicopter => "helicopter",
            Self::Orbit => "orbit",
            Self::Turn => "turn",
            Self::Teleport => "teleport",
            Self::TerrainAvoidance => "terrain-avoidance",
        }
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Preset {
    type Err = FlightError;

    fn from_str(name: &str) -> Result<Self, FlightError> {
        PRESETS.into_iter().find(|p| p.name() == name).ok_or_else(|| FlightError::NoSuchPreset(name.into()))
    }
}

/// Why there is no such flight.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum FlightError {
    /// The name is no preset's.
    #[error(
        "'{0}' is no flight: use terrain-avoidance, straight, helicopter, orbit, turn, teleport, or a file of viewpoints"
    )]
    NoSuchPreset(String),
    /// A row of a listed flight is not six finite numbers.
    #[error("line {line}: {detail}; wanted eye_x_m,eye_y_m,eye_z_m,look_x_m,look_y_m,look_z_m")]
    BadRow {
        /// Line of the file, from 1.
        line: usize,
        /// What is wrong with it.
        detail: String,
    },
    /// A listed flight without rows.
    #[error("the flight has no viewpoints")]
    Empty,
    /// More frames than the limit.
    #[error("{0} frames: at most {MAX_FRAMES}")]
    TooLong(usize),
    /// The eye is where it looks, or not finite.
    #[error("the eye at {eye:?} cannot look at {look:?}")]
    NoDirection {
        /// The eye.
        eye: [f64; 3],
        /// The point looked at.
        look: [f64; 3],
    },
    /// The answer to [`Plan::ground_points`] has another length than the question.
    #[error("{got} ground heights for {wanted} points")]
    GroundCount {
        /// Heights given.
        got: usize,
        /// Heights wanted.
        wanted: usize,
    },
}

/// A viewpoint in the scene frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Viewpoint {
    /// The eye.
    pub eye: DVec3,
    /// Rotation from the camera frame (x right, y up, looking along -z) to the scene frame: unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
}

/// One end of a frame's line of view: plan position in metres, and height above ground or absolute.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Waypoint {
    x_m: f64,
    y_m: f64,
    z_m: f64,
}

/// A flight whose heights are still to be resolved against the ground.
#[derive(Clone, PartialEq, Debug)]
pub struct Plan {
    eyes: Vec<Waypoint>,
    looks: Vec<Waypoint>,
    ground: Ground,
}

/// What the heights of a plan mean.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Ground {
    /// They are absolute.
    Absolute,
    /// Above ground, and the eye's ground is averaged over neighbouring frames.
    Smoothed,
    /// Above ground, each frame by itself.
    EachFrame,
    /// Above ground, on the lowest path that rises and falls by no more than this in a frame.
    Avoided {
        /// The greatest rise of a frame in metres.
        rise_m: f64,
    },
}

impl Plan {
    /// A preset over the plan rectangle `area_m` (south-west and north-east corner in metres), `frames` viewpoints at
    /// `rate_hz`; the seed picks where it starts and where it heads.
    pub fn preset(
        preset: Preset,
        area_m: [[f64; 2]; 2],
        frames: usize,
        rate_hz: f64,
        seed: u64,
    ) -> Result<Self, FlightError> {
        if frames > MAX_FRAMES {
            return Err(FlightError::TooLong(frames));
        }
        let mut dice = Dice::new(seed);
        let path =
            Path { area_m, frames, step_s: 1.0 / rate_hz, heading: dice.heading(), start: dice.place(area_m, 0.2) };
        let ground = match preset {
            Preset::Teleport => Ground::EachFrame,
            Preset::TerrainAvoidance => Ground::Avoided { rise_m: STEEPEST * FAST_M_S * path.step_s },
            _ => Ground::Smoothed,
        };
        let (eyes, looks) = match preset {
            Preset::Straight => path.ahead(FAST_M_S, 150.0, 3_000.0, |_| 0.0),
            // Full circles of weaving left and right, 6 s each way.
            Preset::Helicopter => path.ahead(SLOW_M_S, 40.0, 400.0, |t_s| if t_s % 12.0 < 6.0 { 0.12 } else { -0.12 }),
            Preset::Turn => {
                let (first, last) = (path.duration_s() / 3.0, path.duration_s() * 2.0 / 3.0);
                let rate = std::f64::consts::PI / (last - first).max(path.step_s);
                path.ahead(FAST_M_S, 200.0, 3_000.0, move |t_s| if t_s >= first && t_s < last { rate } else { 0.0 })
            }
            Preset::TerrainAvoidance => {
                // Twice the weight in the curves, 8 s each way.
                path.ahead(FAST_M_S, AVOIDANCE_M, 3_000.0, |t_s| if t_s % 16.0 < 8.0 { 0.08 } else { -0.08 })
            }
            Preset::Orbit => path.orbit(3_000.0, 400.0),
            Preset::Teleport => path.teleport(&mut dice, 10),
        };
        Ok(Self { eyes, looks, ground })
    }

    /// A flight listed as CSV: a line a frame, `eye_x_m,eye_y_m,eye_z_m,look_x_m,look_y_m,look_z_m` in the scene
    /// frame, absolute. A first line of names, empty lines and lines that start with '#' are passed over.
    pub fn listed(text: &str) -> Result<Self, FlightError> {
        let mut plan = Self { eyes: Vec::new(), looks: Vec::new(), ground: Ground::Absolute };
        for (n, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') || (n == 0 && line.starts_with("eye_x_m")) {
                continue;
            }
            let [a, b, c, d, e, f] = row(line).map_err(|detail| FlightError::BadRow { line: n + 1, detail })?;
            plan.eyes.push(Waypoint { x_m: a, y_m: b, z_m: c });
            plan.looks.push(Waypoint { x_m: d, y_m: e, z_m: f });
        }
        match plan.eyes.len() {
            0 => Err(FlightError::Empty),
            n if n > MAX_FRAMES => Err(FlightError::TooLong(n)),
            _ => Ok(plan),
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.eyes.len()
    }

    /// The plan points (metres east, north) whose ground heights [`Plan::fly`] needs, in its order; none for a
    /// listed flight.
    pub fn ground_points(&self) -> Vec<[f64; 2]> {
        if self.ground == Ground::Absolute {
            return Vec::new();
        }
        self.eyes.iter().chain(&self.looks).map(|w| [w.x_m, w.y_m]).collect()
    }

    /// The viewpoints, given the ground heights in metres at [`Plan::ground_points`].
    pub fn fly(&self, ground_m: &[f64]) -> Result<Vec<Viewpoint>, FlightError> {
        let n = self.eyes.len();
        let lowest = match self.ground {
            Ground::Avoided { rise_m } => lowest_path(&ground_m[..n.min(ground_m.len())], rise_m),
            _ => Vec::new(),
        };
        let wanted = if self.ground == Ground::Absolute { 0 } else { 2 * n };
        if ground_m.len() != wanted {
            return Err(FlightError::GroundCount { got: ground_m.len(), wanted });
        }
        (0..n)
            .map(|k| {
                let (eye, look) = (self.eyes[k], self.looks[k]);
                let [eye_ground, look_ground] = match self.ground {
                    Ground::Absolute => [0.0; 2],
                    Ground::EachFrame => [ground_m[k], ground_m[n + k]],
                    Ground::Avoided { .. } => [lowest[k], ground_m[n + k]],
                    Ground::Smoothed => [smoothed(&ground_m[..n], k, 0.5 * eye.z_m), ground_m[n + k]],
                };
                viewpoint(
                    DVec3::new(eye.x_m, eye.y_m, eye_ground + eye.z_m),
                    DVec3::new(look.x_m, look.y_m, look_ground + look.z_m),
                )
            })
            .collect()
    }
}

/// The mean ground around frame `k`, but not so low that less than `least_m` of clearance is lost there.
fn smoothed(ground_m: &[f64], k: usize, least_m: f64) -> f64 {
    let window = &ground_m[k.saturating_sub(SMOOTH_FRAMES)..(k + SMOOTH_FRAMES + 1).min(ground_m.len())];
    let mean = window.iter().sum::<f64>() / window.len() as f64;
    mean.max(ground_m[k] - least_m)
}

/// The lowest heights from frame to frame that are nowhere under the ground and differ by at most `rise_m` from one to
/// the next.
fn lowest_path(ground_m: &[f64], rise_m: f64) -> Vec<f64> {
    let mut path = ground_m.to_vec();
    for k in 1..path.len() {
        path[k] = path[k].max(path[k - 1] - rise_m);
    }
    for k in (1..path.len()).rev() {
        path[k - 1] = path[k - 1].max(path[k] - rise_m);
    }
    path
}

fn row(line: &str) -> Result<[f64; 6], String> {
    let parts: Vec<&str> = line.split(',').collect();
    let parts: [&str; 6] = parts.try_into().map_err(|p: Vec<_>| format!("{} columns", p.len()))?;
    let mut out = [0.0; 6];
    for (value, part) in out.iter_mut().zip(parts) {
        *value = match part.trim().parse() {
            Ok(v) if f64::is_finite(v) => v,
            _ => return Err(format!("'{part}' is not a finite number")),
        };
    }
    Ok(out)
}

/// A viewpoint at `eye` that looks at `look`, its picture's up as near to the scene's up as can be (north where the
/// view is straight up or down).
pub fn viewpoint(eye: DVec3, look: DVec3) -> Result<Viewpoint, FlightError> {
    let error = FlightError::NoDirection { eye: eye.to_array(), look: look.to_array() };
    let forward = match unit(look - eye) {
        Some(forward) if eye.is_finite() => forward,
        _ => return Err(error),
    };
    let level = unit(forward.cross(DVec3::Z));
    let Some(right) = level.or_else(|| unit(forward.cross(DVec3::Y))) else { return Err(error) };
    let up = right.cross(forward);
    Ok(Viewpoint { eye, rotation: quaternion([right, up, -forward]) })
}

/// A flight in which the view jumps: pieces of `stay` viewpoints, in an order that follows from a seed.
pub fn jumping(viewpoints: &[Viewpoint], stay: usize, seed: u64) -> Vec<Viewpoint> {
    let mut pieces: Vec<_> = viewpoints.chunks(stay.max(1)).collect();
    let mut dice = Dice::new(seed);
    for n in (1..pieces.len()).rev() {
        pieces.swap(n, dice.below(n + 1));
    }
    pieces.concat()
}

/// `v` scaled to length 1; `None` where it has no direction. Vertical to within 1e-9 counts as vertical: nearer than
/// that the picture's up would be noise.
fn unit(v: DVec3) -> Option<DVec3> {
    let length = v.dot(v).sqrt();
    (length > 1e-9 && length.is_finite()).then(|| v / length)
}

/// The unit quaternion of the rotation with these orthonormal columns (Shepperd, "Quaternion from rotation matrix",
/// 1978: the largest of the four squares is taken, so no small number divides).
fn quaternion([x, y, z]: [DVec3; 3]) -> [f64; 4] {
    let squares = [1.0 + x.x - y.y - z.z, 1.0 - x.x + y.y - z.z, 1.0 - x.x - y.y + z.z, 1.0 + x.x + y.y + z.z];
    let mut best = 3;
    for k in 0..3 {
        if squares[k] > squares[best] {
            best = k;
        }
    }
    let (yz, zx, xy) = ([y.z, z.y], [z.x, x.z], [x.y, y.x]);
    let raw = match best {
        0 => [squares[0], xy[0] + xy[1], zx[0] + zx[1], yz[0] - yz[1]],
        1 => [xy[0] + xy[1], squares[1], yz[0] + yz[1], zx[0] - zx[1]],
        2 => [zx[0] + zx[1], yz[0] + yz[1], squares[2], xy[0] - xy[1]],
        _ => [yz[0] - yz[1], zx[0] - zx[1], xy[0] - xy[1], squares[3]],
    };
    let length = (raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3]).sqrt();
    raw.map(|c| c / length)
}

/// What all presets share.
struct Path {
    area_m: [[f64; 2]; 2],
    frames: usize,
    step_s: f64,
    /// Unit vector in plan.
    heading: [f64; 2],
    start: [f64; 2],
}

impl Path {
    fn duration_s(&self) -> f64 {
        self.frames as f64 * self.step_s
    }

    /// Flies ahead at a speed, `turn` radians per second to the left, mirrored back at the margins of the terrain;
    /// looks at the ground `look_m` ahead, a third of the flying height up.
    fn ahead(
        &self,
        speed_m_s: f64,
        above_m: f64,
        look_m: f64,
        turn: impl Fn(f64) -> f64,
    ) -> (Vec<Waypoint>, Vec<Waypoint>) {
        let (mut at, mut heading) = (self.start, self.heading);
        (0..self.frames)
            .map(|k| {
                let eye = Waypoint { x_m: at[0], y_m: at[1], z_m: above_m };
                let ahead = [at[0] + heading[0] * look_m, at[1] + heading[1] * look_m];
                // The point looked at keeps its direction at the margin: only its ground is that of the border.
                let look = Waypoint { x_m: ahead[0], y_m: ahead[1], z_m: above_m / 3.0 };
                heading = rotate(heading, turn(k as f64 * self.step_s) * self.step_s);
                for axis in 0..2 {
                    at[axis] += heading[axis] * speed_m_s * self.step_s;
                    let side = self.area_m[1][axis] - self.area_m[0][axis];
                    let (low, high) = (self.area_m[0][axis] + 0.05 * side, self.area_m[1][axis] - 0.05 * side);
                    if (at[axis] < low && heading[axis] < 0.0) || (at[axis] > high && heading[axis] > 0.0) {
                        heading[axis] = -heading[axis];
                    }
                }
                (eye, look)
            })
            .unzip()
    }

    /// Flies around the start, on a circle that fits the terrain.
    fn orbit(&self, radius_m: f64, above_m: f64) -> (Vec<Waypoint>, Vec<Waypoint>) {
        let [low, high] = self.area_m;
        let radius_m = radius_m.min(0.2 * (high[0] - low[0]).min(high[1] - low[1]));
        let angle = SLOW_M_S * self.step_s / radius_m;
        let mut out = self.heading;
        (0..self.frames)
            .map(|_| {
                let eye = [self.start[0] + out[0] * radius_m, self.start[1] + out[1] * radius_m];
                out = rotate(out, angle);
                (
                    Waypoint { x_m: eye[0], y_m: eye[1], z_m: above_m },
                    Waypoint { x_m: self.start[0], y_m: self.start[1], z_m: 0.0 },
                )
            })
            .unzip()
    }

    /// Stands at random places, `stay` frames each.
    fn teleport(&self, dice: &mut Dice, stay: usize) -> (Vec<Waypoint>, Vec<Waypoint>) {
        let (mut eyes, mut looks) = (Vec::new(), Vec::new());
        while eyes.len() < self.frames {
            let (at, heading) = (dice.place(self.area_m, 0.2), dice.heading());
            let eye = Waypoint { x_m: at[0], y_m: at[1], z_m: 60.0 };
            let look = Waypoint { x_m: at[0] + 2_000.0 * heading[0], y_m: at[1] + 2_000.0 * heading[1], z_m: 10.0 };
            for _ in 0..stay.min(self.frames - eyes.len()) {
                eyes.push(eye);
                looks.push(look);
            }
        }
        (eyes, looks)
    }
}

/// A unit vector turned left by about `angle` radians: the rational rotation with t = angle / 2, kept at length 1.
fn rotate(v: [f64; 2], angle: f64) -> [f64; 2] {
    let t = 0.5 * angle;
    let (cos, sin) = ((1.0 - t * t) / (1.0 + t * t), 2.0 * t / (1.0 + t * t));
    let turned = [v[0] * cos - v[1] * sin, v[0] * sin + v[1] * cos];
    let length = (turned[0] * turned[0] + turned[1] * turned[1]).sqrt();
    [turned[0] / length, turned[1] / length]
}

#[cfg(test)]
mod tests;
