//! How far a diamond's priority may stray while the camera moves: what lets refinement put off computing it again.
//!
//! Follows the deferred priorities of Duchaineau et al., "ROAMing Terrain", section 6, where a triangle is left alone for
//! as many frames as its priority provably cannot reach the threshold. It departs in bounding the true motion of the
//! camera, rotation and the planes of the frustum included, instead of assuming a greatest speed: a camera that moves
//! faster than was thought uses up the time sooner, so the answer is never wrong, only more or less early.
//!
//! *Derivation.* Between two poses the eye moves by at most a, and each of the five unit normals (the axis, the sides of
//! the frustum) by at most t (the length of the difference). Let o be the offset of a ball's centre from the eye at the first
//! pose and n a normal there, o' and n' those at the second. Then |o'.n' - o.n| = |(o' - o).n' + o.(n' - n)| <= a + |o| t. So
//! the depth of the ball and its distance from each plane change by at most that; its horizontal distance from the eye
//! changes by at most a. Both motions add up over any number of poses (the triangle inequality), and the priority, a
//! known function of depth and horizontal distance, lies between its values at their extremes.

use glam::DVec3;

use super::{Camera, Eye, Projection, dot};

/// A motion of a camera, or a bound on one.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub struct Motion {
    /// How far the eye moves, in metres.
    pub shift_m: f64,
    /// The greatest length of the difference of a unit normal of the frustum: about the angle turned, in radians.
    pub turn: f64,
}

/// A diamond's priority with what bounds its changes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Appraisal {
    /// What [`Camera::priority`] gives.
    pub priority: f64,
    thickness_m: f64,
    /// Least depth of the ball, greatest horizontal distance from the eye, distance of the centre from the eye.
    nearest_m: f64,
    horizontal_m: f64,
    distance_m: f64,
    /// How far the ball is from being wholly outside of some plane; negative when it is outside, by so much.
    inside_m: f64,
    /// What rounding may have added to any of these.
    slack_m: f64,
    /// As in the camera; a secant of 0 says that the priority does not depend on the distance.
    weight: f64,
    secant: f64,
    near_m: f64,
}

/// Share by which a bound on a priority is widened over the rounding of the priority and of the bound.
const MARGIN: f64 = 1.0 / 1_048_576.0;
/// Share of the lengths involved by which lengths are widened over their rounding, which is below 2^-48 of them.
const SLACK: f64 = 1.0 / 1_099_511_627_776.0;

impl Camera {
    /// The motion from `before` to this camera; `None` when more than the pose differs, so that priorities are not
    /// bounded by motion.
    pub fn motion_from(&self, before: &Self) -> Option<Motion> {
        match (&self.eye, &before.eye) {
            (None, None) => Some(Motion::default()),
            (Some(eye), Some(before)) => eye.motion_from(before),
            _ => None,
        }
    }

    /// [`Camera::priority`] with what bounds its changes.
    pub fn appraise(&self, thickness_m: f64, centre: DVec3, radius_m: f64) -> Appraisal {
        match &self.eye {
            Some(eye) => eye.appraise(thickness_m, centre, radius_m),
            None => Appraisal {
                priority: self.priority(thickness_m, centre, radius_m),
                thickness_m,
                nearest_m: f64::INFINITY,
                horizontal_m: 0.0,
                distance_m: 0.0,
                inside_m: f64::INFINITY,
                slack_m: 0.0,
                weight: 1.0,
                secant: 0.0,
                near_m: 0.0,
            },
        }
    }
}

impl Eye {
    fn motion_from(&self, before: &Self) -> Option<Motion> {
        let same = self.projection == before.projection && self.half == before.half && self.pixels == before.pixels;
        if !same {
            return None;
        }
        let length = |d: DVec3| dot(d, d).sqrt();
        let mut turn = length(self.forward - before.forward);
        for (side, old) in self.sides.iter().zip(&before.sides) {
            turn = turn.max(length(*side - *old));
        }
        // A parallel projection shows thicknesses in another proportion when it turns.
        if matches!(self.projection, Projection::Orthographic { .. }) && self.weight != before.weight {
            return None;
        }
        Some(Motion { shift_m: length(self.eye - before.eye), turn })
    }

    /// The numbers of [`Eye::priority`], all of them.
    fn appraise(&self, thickness_m: f64, centre: DVec3, radius_m: f64) -> Appraisal {
        let offset = centre - self.eye;
        let depth = dot(offset, self.forward);
        let horizontal_square = offset.x * offset.x + offset.y * offset.y;
        let distance_m = (horizontal_square + offset.z * offset.z).sqrt();
        let is_perspective = matches!(self.projection, Projection::Perspective { .. });
        let margin = if is_perspective { [radius_m; 2] } else { [radius_m + self.half[0], radius_m + self.half[1]] };
        let behind = depth + radius_m;
        let (mut inside_m, mut culled) = (behind - self.near_m, behind < self.near_m);
        for (n, side) in self.sides.iter().enumerate() {
            let distance = dot(offset, *side);
            culled |= distance < -margin[n / 2];
            inside_m = inside_m.min(distance + margin[n / 2]);
        }
        let horizontal_m = horizontal_square.sqrt() + radius_m;
        let priority = if culled || thickness_m <= 0.0 {
            0.0
        } else {
            self.distortion_bound(thickness_m, depth - radius_m, || horizontal_m)
        };
        Appraisal {
            priority,
            thickness_m,
            nearest_m: depth - radius_m,
            horizontal_m,
            distance_m,
            inside_m,
            slack_m: SLACK * (distance_m + self.eye.x.abs() + self.eye.y.abs() + self.eye.z.abs()),
            weight: self.weight,
            secant: if is_perspective { self.secant } else { 0.0 },
            near_m: self.near_m,
        }
    }
}

impl Appraisal {
    /// Whether the priority is sure to stay above `floor` while the camera moves by no more than `motion`.
    pub fn stays_above(&self, floor: f64, motion: Motion) -> bool {
        let travel = self.travel(motion);
        if !(self.thickness_m > 0.0 && self.inside_m > travel) {
            return false;
        }
        let furthest = self.nearest_m + travel;
        if furthest <= self.near_m && floor.is_finite() {
            return true;
        }
        let (strength, floor) = (self.weight * self.thickness_m, floor * (1.0 + MARGIN));
        if self.secant == 0.0 {
            return strength > floor;
        }
        let horizontal = self.horizontal_m - motion.shift_m - self.slack_m;
        strength * self.secant > floor * furthest && strength * horizontal > floor * (furthest * furthest)
    }

    /// Whether the priority is sure to stay below `ceiling`, or zero, while the camera moves by no more than `motion`.
    pub fn stays_below(&self, ceiling: f64, motion: Motion) -> bool {
        let travel = self.travel(motion);
        if self.thickness_m <= 0.0 || -self.inside_m > travel {
            return true;
        }
        let closest = self.nearest_m - travel;
        // Not `closest <= near`: what is not a number is not sure.
        if !(closest > self.near_m && ceiling > 0.0) {
            return false;
        }
        let (strength, ceiling) = (self.weight * self.thickness_m, ceiling * (1.0 - MARGIN));
        if self.secant == 0.0 {
            return strength < ceiling;
        }
        let horizontal = self.horizontal_m + motion.shift_m + self.slack_m;
        strength * self.secant < ceiling * closest || strength * horizontal < ceiling * (closest * closest)
    }

    /// How far depth and distance from a plane may change.
    fn travel(&self, motion: Motion) -> f64 {
        (motion.shift_m + motion.turn * self.distance_m) * (1.0 + MARGIN) + self.slack_m
    }
}
