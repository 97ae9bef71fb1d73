use super::*;
use glam::DQuat;

fn turned(v: Viewpoint, p: DVec3) -> DVec3 {
    let [x, y, z, w] = v.rotation;
    DQuat::from_xyzw(x, y, z, w) * p
}

#[test]
fn a_viewpoint_looks_where_it_should_with_up_upward() {
    for seed in 0..2_000 {
        let mut dice = Dice::new(seed);
        let mut v = || DVec3::new(dice.fraction(), dice.fraction(), dice.fraction()) * 2.0 - DVec3::ONE;
        let (eye, look) = (v() * 1e4, v() * 1e4);
        let view = viewpoint(eye, look).unwrap();
        let forward = turned(view, DVec3::NEG_Z);
        assert!((forward - (look - eye).normalize()).length() < 1e-12, "seed {seed}");
        assert!(turned(view, DVec3::X).z.abs() < 1e-12, "seed {seed}: the horizon tilts");
        assert!(turned(view, DVec3::Y).z > 0.0, "seed {seed}: upside down");
        let square: f64 = view.rotation.iter().map(|c| c * c).sum();
        assert!((square - 1.0).abs() < 1e-15, "seed {seed}");
    }
}

#[test]
fn straight_down_has_north_above_and_no_direction_is_an_error() {
    let down = viewpoint(DVec3::new(5.0, 6.0, 700.0), DVec3::new(5.0, 6.0, 0.0)).unwrap();
    assert!((turned(down, DVec3::Y) - DVec3::Y).length() < 1e-12);
    assert!((turned(down, DVec3::X) - DVec3::X).length() < 1e-12);
    for (eye, look) in [(DVec3::ONE, DVec3::ONE), (DVec3::NAN, DVec3::ONE), (DVec3::ONE, DVec3::INFINITY)] {
        assert!(matches!(viewpoint(eye, look), Err(FlightError::NoDirection { .. })));
    }
}

fn fly(preset: Preset, seed: u64) -> Vec<Viewpoint> {
    let plan = Plan::preset(preset, [[0.0; 2], [40_000.0, 30_000.0]], 300, 30.0, seed).unwrap();
    let ground: Vec<f64> = plan.ground_points().iter().map(|p| 100.0 + 0.1 * p[0] - 0.05 * p[1]).collect();
    plan.fly(&ground).unwrap()
}

#[test]
fn presets_are_deterministic_stay_over_the_terrain_and_above_ground() {
    for preset in PRESETS {
        for seed in 0..20 {
            let views = fly(preset, seed);
            assert_eq!(views, fly(preset, seed));
            assert_eq!(views.len(), 300);
            for v in &views {
                assert!(v.eye.x > 0.0 && v.eye.x < 40_000.0 && v.eye.y > 0.0 && v.eye.y < 30_000.0, "{preset} {seed}");
                let ground = 100.0 + 0.1 * v.eye.x - 0.05 * v.eye.y;
                assert!(v.eye.z > ground + 15.0, "{preset} {seed}: {} over {ground}", v.eye.z);
            }
            assert_ne!(views[0], fly(preset, seed + 1_000)[0], "{preset} {seed}: the seed moves nothing");
        }
    }
}

#[test]
fn the_straight_flight_keeps_its_speed_and_the_turn_comes_back() {
    let plan = |v: &Viewpoint| v.eye.with_z(0.0);
    let views = fly(Preset::Straight, 7);
    let step_m = (plan(&views[1]) - plan(&views[0])).length();
    assert!((step_m - 250.0 / 30.0).abs() < 1e-9);
    let views = fly(Preset::Turn, 3);
    let direction = |k: usize| (plan(&views[k + 1]) - plan(&views[k])).normalize();
    assert!(direction(0).dot(direction(298)) < -0.99, "{:?} {:?}", direction(0), direction(298));
}

#[test]
fn terrain_avoidance_keeps_its_height_and_climbs_before_the_ridge() {
    let plan = Plan::preset(Preset::TerrainAvoidance, [[0.0; 2], [40_000.0; 2]], 620, 30.0, 5).unwrap();
    let n = plan.frames();
    // A ridge of 500 m across the path, at frames 300 to 309.
    let ground: Vec<_> = (0..2 * n).map(|k| if (300..310).contains(&(k % n)) { 500.0 } else { 0.0 }).collect();
    let views = plan.fly(&ground).unwrap();
    let step_m = 250.0 / 30.0;
    for (k, pair) in views.windows(2).enumerate() {
        let (rise_m, above_m) = ((pair[1].eye.z - pair[0].eye.z).abs(), pair[0].eye.z - ground[k]);
        assert!(rise_m <= step_m * 0.2 * (1.0 + 1e-9) && above_m >= 60.0 - 1e-9, "frame {k}: {rise_m}, {above_m}");
    }
    assert_eq!((views[0].eye.z, views[305].eye.z, views[n - 1].eye.z), (60.0, 560.0, 60.0));
    assert!((views[150].eye.z - 310.0).abs() < 1e-6, "half way up 150 frames before");
}

#[test]
fn a_listed_flight_is_taken_as_it_stands_and_a_bad_row_names_its_line() {
    let text = "eye_x_m,eye_y_m,eye_z_m,look_x_m,look_y_m,look_z_m\n# a comment\n1,2,3, 4,5,6\n\n7,8,9,1,2,3\n";
    let plan = Plan::listed(text).unwrap();
    assert!(plan.ground_points().is_empty());
    let views = plan.fly(&[]).unwrap();
    assert_eq!(views.iter().map(|v| v.eye).collect::<Vec<_>>(), [DVec3::new(1.0, 2.0, 3.0), DVec3::new(7.0, 8.0, 9.0)]);
    assert!(matches!(Plan::listed("1,2,3,4,5,6\n1,2,3,4,5\n"), Err(FlightError::BadRow { line: 2, .. })));
    assert!(matches!(Plan::listed("1,2,nan,4,5,6"), Err(FlightError::BadRow { line: 1, .. })));
    assert_eq!(Plan::listed("\n"), Err(FlightError::Empty));
    assert!("orbits".parse::<Preset>().is_err());
    assert_eq!("orbit".parse(), Ok(Preset::Orbit));
}

#[test]
fn heights_for_other_points_are_refused() {
    let plan = Plan::preset(Preset::Orbit, [[0.0; 2], [1e4; 2]], 10, 30.0, 1).unwrap();
    assert_eq!(plan.fly(&[0.0; 19]), Err(FlightError::GroundCount { got: 19, wanted: 20 }));
    assert!(Plan::preset(Preset::Orbit, [[0.0; 2], [1e4; 2]], MAX_FRAMES + 1, 30.0, 1).is_err());
}

#[test]
fn a_jumping_flight_has_the_same_viewpoints_in_pieces() {
    let flown = fly(Preset::Straight, 3);
    let jumped = jumping(&flown, 40, 9);
    assert_eq!(jumped, jumping(&flown, 40, 9));
    let place = |v: &Viewpoint| flown.iter().position(|w| w == v).unwrap();
    let mut places: Vec<_> = jumped.iter().map(place).collect();
    let jumps = places.windows(2).filter(|pair| pair[1] != pair[0] + 1).count();
    assert!((2..=7).contains(&jumps), "{jumps} jumps in 8 pieces");
    places.sort_unstable();
    assert_eq!(places, (0..flown.len()).collect::<Vec<_>>());
}
