//! The priority is a bound, and monotone; bad cameras are refused.

use glam::{DQuat, DVec3};

use super::*;
use crate::terrain::synthetic::mix;

/// A number in [0, 1) that depends on `seed` and `n` only.
fn unit(seed: u64, n: u64) -> f64 {
    (mix(seed ^ mix(n)) >> 11) as f64 / (1_u64 << 53) as f64
}

fn quaternion(seed: u64) -> DQuat {
    let part = |n| unit(seed, n) - 0.5;
    DQuat::from_xyzw(part(1), part(2), part(3), part(4)).normalize()
}

fn camera(seed: u64) -> Camera {
    let eye = DVec3::new(unit(seed, 10), unit(seed, 11), unit(seed, 12)) * 1000.0;
    let near_m = 0.1 + unit(seed, 13) * 10.0;
    let projection = if seed.is_multiple_of(4) {
        Projection::Orthographic { half_height_m: 1.0 + 400.0 * unit(seed, 14), near_m }
    } else {
        Projection::Perspective { tan_half_fov: 0.05 + 2.0 * unit(seed, 14), near_m }
    };
    Camera::new(eye, quaternion(seed), projection, [640 + (seed % 700) as u32, 480]).unwrap()
}

#[test]
fn no_segment_in_the_ball_is_distorted_more_than_the_priority() {
    let (mut finite, mut infinite) = (0, 0);
    for seed in 0..4000 {
        let camera = camera(seed);
        let centre = DVec3::new(unit(seed, 20), unit(seed, 21), unit(seed, 22)) * 1000.0;
        let radius = 200.0 * unit(seed, 23) * unit(seed, 24);
        let thickness = radius * unit(seed, 25);
        let bound = camera.priority(thickness, centre, radius);
        for n in 0..40 {
            let p = centre + DVec3::new(unit(seed, 100 + n), unit(seed, 200 + n), unit(seed, 300 + n)) * (2.0 * radius)
                - DVec3::splat(radius);
            let q = p + DVec3::Z * thickness * (2.0 * unit(seed, 400 + n) - 1.0);
            if (p - centre).length() > radius || (q - centre).length() > radius {
                continue;
            }
            if let Some(distortion) = camera.distortion(p, q) {
                assert!(distortion <= bound, "seed {seed}: {distortion} above {bound}");
                if bound.is_finite() { finite += 1 } else { infinite += 1 }
            }
        }
    }
    assert!(finite > 1000 && infinite > 100, "{finite} {infinite}");
}

#[test]
fn a_ball_within_a_ball_never_has_a_higher_priority() {
    for seed in 0..20_000 {
        let camera = camera(seed);
        let centre = DVec3::new(unit(seed, 20), unit(seed, 21), unit(seed, 22)) * 1000.0;
        let radius = 300.0 * unit(seed, 23) * unit(seed, 24) + 0.01;
        let shift = quaternion(seed + 7) * DVec3::X * (0.3 * radius * unit(seed, 25));
        let inner_radius = (radius / (1.0 + 1.0 / 65_536.0) - shift.length()) * if seed % 2 == 0 { 1.0 } else { 0.5 };
        let thickness = unit(seed, 26) * radius;
        let outer = camera.priority(thickness, centre, radius);
        let inner = camera.priority(thickness * unit(seed, 27).sqrt(), centre + shift, inner_radius);
        assert!(inner <= outer, "seed {seed}: {inner} above {outer}");
    }
}

#[test]
fn priority_is_zero_without_thickness_or_out_of_sight_and_infinite_at_the_near_plane() {
    let projection = Projection::Perspective { tan_half_fov: 0.5, near_m: 1.0 };
    // Looking along -z, which is down: the camera frame is the scene frame.
    let camera = Camera::new(DVec3::ZERO, DQuat::IDENTITY, projection, [200, 100]).unwrap();
    assert_eq!(camera.priority(0.0, DVec3::new(0.0, 0.0, -10.0), 1.0), 0.0);
    assert_eq!(camera.priority(1.0, DVec3::new(0.0, 0.0, 10.0), 1.0), 0.0, "behind");
    assert_eq!(camera.priority(1.0, DVec3::new(30.0, 0.0, -10.0), 1.0), 0.0, "to the right");
    assert_eq!(camera.priority(1.0, DVec3::new(0.0, 0.0, -1.5), 1.0), f64::INFINITY);
    assert_eq!(camera.priority(f64::INFINITY, DVec3::new(0.0, 0.0, -10.0), f64::INFINITY), f64::INFINITY);
    let ahead = camera.priority(1.0, DVec3::new(0.0, 0.0, -11.0), 1.0);
    assert!(ahead > 0.0 && ahead < 2.0, "straight below, a vertical segment is seen end on: {ahead}");
}

/// A camera near `camera(seed)`: no further off than `motion` allows, as far as it goes.
fn moved(seed: u64, scale: f64) -> Camera {
    let eye = DVec3::new(unit(seed, 10), unit(seed, 11), unit(seed, 12)) * 1000.0;
    let step = DVec3::new(unit(seed, 30) - 0.5, unit(seed, 31) - 0.5, unit(seed, 32) - 0.5) * (200.0 * scale);
    let near_m = 0.1 + unit(seed, 13) * 10.0;
    let projection = if seed.is_multiple_of(4) {
        Projection::Orthographic { half_height_m: 1.0 + 400.0 * unit(seed, 14), near_m }
    } else {
        Projection::Perspective { tan_half_fov: 0.05 + 2.0 * unit(seed, 14), near_m }
    };
    let q = quaternion(seed);
    let part = |n| (unit(seed, n) - 0.5) * scale;
    let turned =
        if seed.is_multiple_of(3) { q } else { (q * DQuat::from_xyzw(part(33), part(34), part(35), 1.0)).normalize() };
    Camera::new(eye + step, turned, projection, [640 + (seed % 700) as u32, 480]).unwrap()
}

#[test]
fn what_is_sure_of_a_priority_stays_true_while_the_camera_moves() {
    let (mut above, mut below, mut unsure) = (0, 0, 0);
    for seed in 0..40_000 {
        let (from, to) = (camera(seed), moved(seed, unit(seed, 40) * unit(seed, 41)));
        let Some(motion) = to.motion_from(&from) else {
            assert!(seed.is_multiple_of(4), "only parallel cameras may refuse");
            continue;
        };
        let centre = DVec3::new(unit(seed, 20), unit(seed, 21), unit(seed, 22)) * 1000.0;
        let radius = 200.0 * unit(seed, 23) * unit(seed, 24);
        let thickness = radius * unit(seed, 25) * unit(seed, 26);
        let appraisal = from.appraise(thickness, centre, radius);
        let (before, after) = (from.priority(thickness, centre, radius), to.priority(thickness, centre, radius));
        assert_eq!(appraisal.priority.to_bits(), before.to_bits(), "seed {seed}");
        let floor = if before.is_finite() { before * unit(seed, 50) } else { 100.0 * unit(seed, 50) };
        let ceiling = if before > 0.0 { before / unit(seed, 51).max(1e-9) } else { 100.0 * unit(seed, 51) };
        match (appraisal.stays_above(floor, motion), appraisal.stays_below(ceiling, motion)) {
            (true, _) => {
                assert!(after > floor, "seed {seed}: {after} not above {floor}");
                above += 1;
            }
            (_, true) => {
                assert!(after < ceiling || after == 0.0, "seed {seed}: {after} not below {ceiling}");
                below += 1;
            }
            _ => unsure += 1,
        }
    }
    assert!(above > 500 && below > 5000 && unsure > 500, "{above} above, {below} below, {unsure} unsure");
}

#[test]
fn planes_of_a_ball_around_spare_tests_and_change_nothing() {
    let mut spared = 0;
    for seed in 0..20_000 {
        let camera = camera(seed);
        let centre = DVec3::new(unit(seed, 20), unit(seed, 21), unit(seed, 22)) * 1000.0;
        let radius = 200.0 * unit(seed, 23) * unit(seed, 24);
        let (_, planes) = camera.priority_within(Planes::default(), 1.0, centre, radius);
        let (share, away) = (0.9 * unit(seed, 25), DVec3::new(unit(seed, 27), unit(seed, 28), unit(seed, 29)));
        let inner = centre + (away - 0.5) * (radius * (1.0 - share));
        let (is, _) = camera.priority_within(planes, 1.0, inner, radius * share * 0.99);
        assert_eq!(is.to_bits(), camera.priority(1.0, inner, radius * share * 0.99).to_bits(), "seed {seed}");
        spared += u32::from(planes != Planes::default());
    }
    assert!(spared > 1000, "{spared}");
}

#[test]
fn cameras_that_make_no_sense_are_refused() {
    let projection = Projection::Perspective { tan_half_fov: 0.5, near_m: 1.0 };
    let make = |eye, q, projection, viewport| Camera::new(eye, q, projection, viewport).map(|_| ()).unwrap_err();
    let nan = f64::NAN;
    let (zero, one) = (DVec3::ZERO, DQuat::IDENTITY);
    assert!(matches!(make(DVec3::new(nan, 0.0, 0.0), one, projection, [1, 1]), CameraError::Eye { .. }));
    assert!(matches!(make(DVec3::new(0.0, 2e8, 0.0), one, projection, [1, 1]), CameraError::Eye { .. }));
    for q in [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.1), (nan, 0.0, 0.0, 1.0), (f64::INFINITY, 0.0, 0.0, 1.0)] {
        let q = DQuat::from_xyzw(q.0, q.1, q.2, q.3);
        assert!(matches!(make(zero, q, projection, [1, 1]), CameraError::Rotation { .. }));
    }
    assert!(matches!(make(zero, one, projection, [0, 1]), CameraError::Viewport { .. }));
    for bad in [0.0, -1.0, nan, f64::INFINITY] {
        let wide = Projection::Perspective { tan_half_fov: bad, near_m: 1.0 };
        let near = Projection::Perspective { tan_half_fov: 1.0, near_m: bad };
        let flat = Projection::Orthographic { half_height_m: bad, near_m: 1.0 };
        for projection in [wide, near, flat] {
            assert!(matches!(make(zero, one, projection, [1, 1]), CameraError::Projection { .. }));
        }
    }
}
