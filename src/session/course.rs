//! Where a view that moves will be: its last poses drawn on in a straight line and a steady turn. Time is an argument, in
//! milliseconds from any moment that stays the same.
//!
//! A guess, for reading ahead: nothing that a client is told depends on it.

use super::Pose;

/// The motion is taken over about so much time: from one pose to the next it would be that of the network.
const BASE_MS: f64 = 50.0;

/// The last poses of a view.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Course {
    /// From this pose the motion counts. Once there are enough, it is one to two times [`BASE_MS`] older than the last.
    from: (f64, Pose),
    /// The next one that it will count from.
    next: (f64, Pose),
    last: (f64, Pose),
}

impl Course {
    /// A view that is there and rests.
    pub fn new(now_ms: f64, pose: Pose) -> Self {
        Self { from: (now_ms, pose), next: (now_ms, pose), last: (now_ms, pose) }
    }

    /// Takes the pose that the view has now.
    pub fn steer(&mut self, now_ms: f64, pose: Pose) {
        self.last = (now_ms, pose);
        if now_ms - self.next.0 >= BASE_MS {
            (self.from, self.next) = (self.next, self.last);
        }
    }

    /// The pose so many milliseconds after the last one if it goes on as it did; `None` while it rests.
    pub fn ahead(&self, ms: f64) -> Option<Pose> {
        let ((from_ms, from), (last_ms, last)) = (self.from, self.last);
        if from == last || last_ms <= from_ms {
            return None;
        }
        let times = ms / (last_ms - from_ms);
        let turn = last.rotation * from.rotation.conjugate();
        // Either of two quaternions is the same turn: the one of less than half a turn. More than half a turn ahead is as
        // good as any.
        let turn = (if turn.w < 0.0 { -turn } else { turn }).normalize().to_scaled_axis() * times;
        let rotation = glam::DQuat::from_scaled_axis(turn.clamp_length_max(std::f64::consts::PI)) * last.rotation;
        Some(Pose { eye_m: last.eye_m + (last.eye_m - from.eye_m) * times, rotation: rotation.normalize() })
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    fn pose(at: f64, heading: f64) -> Pose {
        Pose { eye_m: DVec3::new(100.0 * at, 5.0, 7.0), rotation: DQuat::from_rotation_z(heading) }
    }

    fn near(found: Pose, expected: Pose) {
        assert!(found.eye_m.distance(expected.eye_m) < 1e-6, "{found:?}, {expected:?}");
        assert!(found.rotation.dot(expected.rotation).abs() > 1.0 - 1e-9, "{found:?}, {expected:?}");
    }

    #[test]
    fn a_steady_motion_goes_on() {
        // 60 Hz with a network that shifts times by up to 4 ms; headings across the place where a quaternion's sign turns.
        let mut course = Course::new(0.0, pose(0.0, 3.0));
        for n in 1..200_i32 {
            let t = f64::from(n) / 60.0;
            course.steer(1e3 * t + f64::from(n % 3) * 2.0, pose(t, 3.0 + 0.7 * t));
        }
        let t = 199.0 / 60.0;
        let found = course.ahead(250.0).unwrap();
        assert!((found.eye_m.x - 100.0 * (t + 0.25)).abs() < 100.0 * 0.25 * 0.1, "{found:?}");
        // Without the network it is exact.
        let mut course = Course::new(0.0, pose(0.0, 3.0));
        for n in 1..=200_i32 {
            let t = f64::from(n) / 60.0;
            course.steer(1e3 * t, pose(t, 3.0 + 0.7 * t));
        }
        near(course.ahead(250.0).unwrap(), pose(200.0 / 60.0 + 0.25, 3.0 + 0.7 * (200.0 / 60.0 + 0.25)));
    }

    #[test]
    fn what_rests_has_no_course_and_what_stops_loses_it() {
        let mut course = Course::new(0.0, pose(0.0, 1.0));
        assert_eq!(course.ahead(250.0), None);
        course.steer(0.0, pose(1.0, 1.0));
        assert_eq!(course.ahead(250.0), None, "no time has passed");
        course.steer(16.0, pose(1.0, 1.0));
        assert!(course.ahead(250.0).is_some());
        for n in 2..12 {
            course.steer(16.0 * f64::from(n), pose(1.0, 1.0));
        }
        assert_eq!(course.ahead(250.0), None);
    }

    #[test]
    fn a_jump_gives_a_pose_all_the_same() {
        let mut course = Course::new(0.0, pose(0.0, 0.0));
        course.steer(1e-3, pose(1e6, 3.1));
        let found = course.ahead(1e6).unwrap();
        assert!(found.eye_m.is_finite() && found.rotation.is_normalized(), "{found:?}");
    }
}
