//! What must hold of a view: whatever happens, a client that applies its frames holds its mesh.

use proptest::prelude::*;
use sightline_client::scene::{self, SceneState};
use sightline_proto::{
    mesh::Mesh,
    verdict::{MeshVerdict, for_each_triangle_met, passes_above, verdict_on_mesh},
};

use super::*;
use crate::{
    database::{self, Database, OpenOptions, Provenance},
    exercise::{Altitude, Anchor, Change, Entity, Frame, Place, SightLine, Site},
    roam::MAX_REGIONS,
    terrain::{MemoryField, synthetic},
    wedgie::MemoryTerrain,
};

const SCALE: SceneScale = SceneScale { east_m: 30.0, north_m: 25.0, up_m: 1.0 };
const SITE: Site = Site { scale: SCALE, georeference: None };

fn terrain() -> Arc<MemoryTerrain> {
    Arc::new(MemoryTerrain::new(synthetic::fractal(60, 45, 3, 900).unwrap(), SCALE).unwrap())
}

fn wire_settings(triangles: u32, subscription: Option<v1::subscription::Lines>) -> v1::ViewSettings {
    v1::ViewSettings {
        projection: Some(v1::view_settings::Projection::Perspective(v1::Perspective {
            tan_half_fov: 0.6,
            near_m: 1.0,
        })),
        viewport_width_px: 800,
        viewport_height_px: 600,
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles })),
        subscription: Some(v1::Subscription { lines: subscription }),
        regions: Vec::new(),
    }
}

/// A pose above the ground that looks down to one side.
fn wire_pose(x: f64, y: f64, turn: f64) -> v1::Pose {
    // A rotation about the east axis by 60 degrees from straight down, then about the up axis.
    let (half, tilt) = (turn * 0.5, (0.5, 3_f64.sqrt() * 0.5));
    let (c, s) = ((1.0 - half * half) / (1.0 + half * half), 2.0 * half / (1.0 + half * half));
    v1::Pose {
        eye: Some(v1::Position { x, y, z: 700.0 }),
        rotation: Some(v1::Quaternion { x: c * tilt.0, y: s * tilt.0, z: s * tilt.1, w: c * tilt.1 }),
    }
}

fn exercise(terrain: &MemoryTerrain, lines: u64) -> Exercise {
    let place = |n: u64| Place {
        position: [(n * 37 % 590) as f64 * 0.1, (n * 53 % 440) as f64 * 0.1, 3.0],
        frame: Frame::Grid,
        altitude: Altitude::AboveGround,
    };
    let end = |id| Anchor::Entity { id, offset_m: 0.0 };
    let line = |id| SightLine {
        id,
        a: end(2 * id),
        b: end(2 * id + 1),
        fidelity: Fidelity::Verdict,
        priority: 0,
        range_m: None,
        region: None,
    };
    let change = Change {
        put_entities: (0..2 * lines).map(|id| Entity { id, place: place(id), ground_m: None }).collect(),
        put_sight_lines: (0..lines).map(line).collect(),
        ..Change::default()
    };
    Exercise::new("test").unwrap().changed(&change, &SITE, terrain).unwrap()
}

fn moved(exercise: &Exercise, terrain: &MemoryTerrain, id: u64, x: f64) -> Exercise {
    let mut entity = *exercise.entities().find(|entity| entity.id == id).unwrap();
    entity.place.position[0] = x;
    exercise.changed(&Change { put_entities: vec![entity], ..Change::default() }, &SITE, terrain).unwrap()
}

fn opened<T: Terrain>(
    terrain: &Arc<T>,
    settings: &v1::ViewSettings,
    exercise: Option<Arc<Exercise>>,
) -> (View<T>, SceneState) {
    let description = describe(&**terrain, &SITE, &Details::default()).unwrap();
    let client = v1::ViewOpened { terrain: Some(description.clone()) };
    let client = SceneState::new(&client, MAX_TRIANGLES, exercise.is_some()).unwrap();
    let (settings, pose) = (Settings::from_wire(settings).unwrap(), wire_pose(800.0, 500.0, 0.3));
    let pose = Pose::from_wire(&pose).unwrap();
    (View::open(Arc::clone(terrain), SCALE, &description, settings, pose, exercise).unwrap(), client)
}

fn steer(pose: Option<v1::Pose>, pose_sequence: u64, applied_sequence: u64) -> Event {
    Event::Steer(v1::SteerView { pose, pose_sequence, applied_sequence, ..Default::default() })
}

/// Frames of a list of messages.
fn frames(messages: &[Response]) -> Vec<&v1::Frame> {
    fn frame(message: &Response) -> Option<&v1::Frame> {
        match message {
            Response::Frame(frame) => Some(frame),
            _ => None,
        }
    }
    messages.iter().filter_map(frame).collect()
}

fn message(response: &Response) -> v1::StreamSceneResponse {
    v1::StreamSceneResponse { response: Some(response.clone()) }
}

#[test]
fn at_most_three_frames_are_unacknowledged_and_the_newest_pose_wins() {
    let terrain = terrain();
    let (mut view, _) = opened(&terrain, &wire_settings(300, None), None);
    assert_eq!(frames(&view.produce().unwrap())[0].sequence, 1);
    assert!(view.produce().unwrap().is_empty(), "nothing has changed");
    for n in 1..=6 {
        view.handle(steer(Some(wire_pose(100.0 * n as f64, 500.0, 0.1)), n, 0)).unwrap();
        assert_eq!(view.is_due(), n <= 2, "pose {n}");
        view.produce().unwrap();
    }
    view.handle(steer(None, 0, 1)).unwrap();
    let messages = view.produce().unwrap();
    let frame = frames(&messages)[0];
    assert_eq!((frame.sequence, frame.base_sequence, frame.pose_sequence), (4, 3, 6));
    view.handle(steer(None, 0, 4)).unwrap();
    assert!(!view.is_due(), "an acknowledgement alone asks for nothing");
}

#[test]
fn a_client_that_lost_its_place_gets_a_snapshot_even_when_its_window_is_full() {
    let terrain = terrain();
    let (mut view, mut client) = opened(&terrain, &wire_settings(300, None), None);
    for n in 1..=3 {
        let messages = view.produce().unwrap();
        if n == 1 {
            client.apply(&message(&messages[0])).unwrap();
        }
        if n == 3 {
            assert!(client.apply(&message(&messages[0])).is_err(), "its base was lost");
        }
        view.handle(steer(Some(wire_pose(300.0 * n as f64, 500.0, 0.1)), n, 0)).unwrap();
    }
    assert!(!view.is_due());
    view.handle(Event::Snapshot(v1::RequestSnapshot { received_sequence: 3 })).unwrap();
    let messages = view.produce().unwrap();
    assert_eq!((frames(&messages)[0].sequence, frames(&messages)[0].base_sequence), (4, 0));
    client.apply(&message(&messages[0])).unwrap();
    assert_eq!(client.replica().hash(), view.sent().hash());
}

#[test]
fn unchanged_inputs_make_empty_deltas() {
    let terrain = terrain();
    let exercise = Arc::new(exercise(&terrain, 8));
    let (mut view, _) = opened(&terrain, &wire_settings(400, None), Some(exercise));
    let first = view.produce().unwrap();
    assert_eq!(first.len(), 2, "the exercise, then the frame");
    for n in 1..4 {
        view.handle(steer(Some(wire_pose(800.0, 500.0, 0.3)), n, n)).unwrap();
        let messages = view.produce().unwrap();
        let [Response::Frame(frame)] = &messages[..] else { panic!("an update without a change") };
        assert_eq!(frame.mesh, view.sent().encode(Some(view.sent())), "an empty delta");
        assert!(frame.now_unsatisfied.is_empty() && frame.no_longer_unsatisfied.is_empty());
    }
}

#[test]
fn what_makes_no_sense_is_refused_and_changes_nothing() {
    let terrain = terrain();
    let (mut view, _) = opened(&terrain, &wire_settings(300, None), None);
    view.produce().unwrap();
    let refused = |view: &mut View<_>, event| {
        view.handle(event).unwrap_err();
        assert!(!view.is_due());
    };
    refused(&mut view, steer(None, 0, 2));
    refused(&mut view, Event::Snapshot(v1::RequestSnapshot { received_sequence: 2 }));
    refused(&mut view, steer(Some(wire_pose(0.0, 0.0, 0.0)), 0, 0));
    let good = wire_pose(0.0, 0.0, 0.0);
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        let eye = Some(v1::Position { x: bad, y: 0.0, z: 0.0 });
        refused(&mut view, steer(Some(v1::Pose { eye, ..good }), 1, 0));
        let rotation = Some(v1::Quaternion { x: bad, y: 0.0, z: 0.0, w: 1.0 });
        refused(&mut view, steer(Some(v1::Pose { rotation, ..good }), 1, 0));
    }
    let rotation = Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.001 });
    refused(&mut view, steer(Some(v1::Pose { rotation, ..good }), 1, 0));
    refused(&mut view, steer(Some(v1::Pose { rotation: None, ..good }), 1, 0));
    refused(&mut view, steer(Some(v1::Pose { eye: None, ..good }), 1, 0));
    for triangles in [0, 1, 1_000_000_000, MAX_TRIANGLES + 1, u32::MAX] {
        let settings = Some(wire_settings(triangles, None));
        let event = v1::SteerView { settings, ..Default::default() };
        let error = view.handle(Event::Steer(event)).unwrap_err();
        assert!(error.to_string().contains("4000000"), "{error}");
        assert!(!view.is_due());
    }
}

#[test]
fn a_slow_client_that_asked_for_a_frame_time_gets_fewer_triangles() {
    let terrain = terrain();
    let time = v1::FrameTime { milliseconds: 10.0, max_triangles: 2500 };
    let settings =
        v1::ViewSettings { target: Some(v1::view_settings::Target::FrameTime(time)), ..wire_settings(2, None) };
    let (mut view, _) = opened(&terrain, &settings, None);
    let mut counts = Vec::new();
    for n in 1..=30_u64 {
        let messages = view.produce().unwrap();
        counts.push(frames(&messages)[0].triangle_count);
        let frame_time_ms = f64::from(counts[counts.len() - 1]) * 0.02;
        let pose = Some(wire_pose(800.0, 500.0, 0.3));
        let steer = v1::SteerView { pose, pose_sequence: n, applied_sequence: n, frame_time_ms, ..Default::default() };
        view.handle(Event::Steer(steer)).unwrap();
    }
    assert!(counts[0] > 1000 && (350..=525).contains(&counts[29]), "{counts:?}");
    let bad = v1::SteerView { frame_time_ms: f64::NAN, ..Default::default() };
    assert!(view.handle(Event::Steer(bad)).is_err());
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let refused = |change: &dyn Fn(&mut v1::ViewSettings)| {
        let mut settings = wire_settings(100, None);
        change(&mut settings);
        let pose = Pose::from_wire(&wire_pose(0.0, 0.0, 0.0)).unwrap();
        Settings::from_wire(&settings).and_then(|settings| settings.camera(&pose)).unwrap_err();
    };
    refused(&|s| s.projection = None);
    refused(&|s| s.target = None);
    refused(&|s| s.viewport_width_px = 0);
    refused(&|s| s.viewport_height_px = u32::MAX);
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        use v1::view_settings::{Projection, Target};
        let near_m = 1.0;
        refused(&|s| s.projection = Some(Projection::Perspective(v1::Perspective { tan_half_fov: bad, near_m })));
        refused(&|s| s.projection = Some(Projection::Perspective(v1::Perspective { tan_half_fov: 1.0, near_m: bad })));
        refused(&|s| s.projection = Some(Projection::Orthographic(v1::Orthographic { half_height_m: bad, near_m })));
        let time = v1::FrameTime { milliseconds: bad, max_triangles: 10 };
        refused(&|s| s.target = Some(Target::FrameTime(time)));
        refused(&|s| s.target = Some(Target::ScreenError(v1::ScreenError { pixels: bad, max_triangles: 10 })));
    }
    let region = v1::RegionOfInterest { east_m: 1.0, north_m: 1.0, radius_m: 1.0, weight: 2.0 };
    for bad in [-1.1e8, 1.1e8, f64::NAN, f64::INFINITY] {
        refused(&|s| s.regions = vec![region, v1::RegionOfInterest { east_m: bad, ..region }]);
        refused(&|s| s.regions = vec![v1::RegionOfInterest { north_m: bad, ..region }]);
        refused(&|s| s.regions = vec![v1::RegionOfInterest { radius_m: bad, ..region }]);
        refused(&|s| s.regions = vec![v1::RegionOfInterest { weight: bad, ..region }]);
    }
    refused(&|s| s.regions = vec![v1::RegionOfInterest { weight: 0.5, ..region }]);
    refused(&|s| s.regions = vec![region; MAX_REGIONS + 1]);
    let ids = vec![1; MAX_SUBSCRIBED_IDS + 1];
    refused(&|s| {
        let lines = Some(v1::subscription::Lines::List(v1::LineList { ids: ids.clone() }));
        s.subscription = Some(v1::Subscription { lines });
    });
}

#[test]
fn a_region_of_interest_makes_the_mesh_finer_inside_and_the_bound_stays_true() {
    let terrain = terrain();
    let region = v1::RegionOfInterest { east_m: 700.0, north_m: 950.0, radius_m: 150.0, weight: 1000.0 };
    let with = v1::ViewSettings { regions: vec![region], ..wire_settings(400, None) };
    let inside = |client: &SceneState| {
        let near = |p: &Post| libm::hypot(f64::from(p.i) * 30.0 - 700.0, f64::from(p.j) * 25.0 - 950.0) < 150.0;
        client.replica().posts().into_iter().filter(|(p, _)| near(p)).count()
    };
    let (mut view, mut client) = opened(&terrain, &wire_settings(400, None), None);
    let (mut opened_with, mut other) = opened(&terrain, &with, None);
    let deliver = |view: &mut View<_>, client: &mut SceneState| {
        for response in view.produce().unwrap() {
            client.apply(&message(&response)).unwrap();
        }
        (inside(client), client.last_frame().bound_px, client.replica().hash())
    };
    let (plain, plain_bound_px, _) = deliver(&mut view, &mut client);
    let (wanted, bound_px, hash) = deliver(&mut opened_with, &mut other);
    assert!(wanted > 2 * plain, "{plain} posts, then {wanted}");
    assert!(bound_px > plain_bound_px, "the triangles are missing elsewhere: {plain_bound_px}, then {bound_px}");
    let applied_sequence = client.replica().sequence();
    view.handle(Event::Steer(v1::SteerView { settings: Some(with), applied_sequence, ..Default::default() })).unwrap();
    assert_eq!(deliver(&mut view, &mut client), (wanted, bound_px, hash), "opened with a region, or given it later");
}

#[test]
fn a_new_subscription_brings_and_takes_lines_at_the_same_epoch() {
    use v1::subscription::Lines;
    let terrain = terrain();
    let exercise = Arc::new(exercise(&terrain, 5));
    let list = |ids: &[u64]| Some(Lines::List(v1::LineList { ids: ids.to_vec() }));
    let (mut view, mut client) = opened(&terrain, &wire_settings(400, list(&[1, 3, 99])), Some(exercise));
    let deliver = |view: &mut View<_>, client: &mut SceneState| {
        for response in view.produce().unwrap() {
            client.apply(&message(&response)).unwrap();
        }
        client.lines().keys().copied().collect::<Vec<_>>()
    };
    assert_eq!(deliver(&mut view, &mut client), [1, 3]);
    for (subscription, expected) in [(None, vec![0, 1, 2, 3, 4]), (Some(Lines::None(v1::NoLines {})), vec![])] {
        let settings = Some(wire_settings(400, subscription));
        let applied_sequence = client.replica().sequence();
        view.handle(Event::Steer(v1::SteerView { settings, applied_sequence, ..Default::default() })).unwrap();
        assert_eq!(deliver(&mut view, &mut client), expected);
    }
}

#[test]
fn heights_that_no_frame_carries_are_an_error() {
    let halves = MemoryField::from_fn(9, 9, |i, j| Some(if (i, j) == (4, 4) { 100.5 } else { 0.0 })).unwrap();
    let terrain = Arc::new(MemoryTerrain::new(halves, SCALE).unwrap());
    let description = describe(&*terrain, &SITE, &Details::default()).unwrap();
    let settings = Settings::from_wire(&wire_settings(100, None)).unwrap();
    let pose = Pose::from_wire(&v1::Pose {
        eye: Some(v1::Position { x: 120.0, y: 100.0, z: 400.0 }),
        rotation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    });
    let mut view = View::open(terrain, SCALE, &description, settings, pose.unwrap(), None).unwrap();
    let error = view.produce().unwrap_err();
    assert_eq!(error, FrameError::Height { post: Post::new(4, 4), height: 100.5 });
}

/// Something that happens to a view or its client.
#[derive(Clone, Debug)]
enum Happening {
    Pose(f64, f64, f64),
    Budget(u32),
    Move(u64, f64),
    Acknowledge,
    /// The next frame does not arrive.
    Lose,
    Snapshot,
}

fn happenings() -> impl Strategy<Value = Happening> {
    prop_oneof![
        4 => (0.0..1800.0, 0.0..1100.0, -3.0..3.0).prop_map(|(x, y, turn)| Happening::Pose(x, y, turn)),
        1 => (2..1500_u32).prop_map(Happening::Budget),
        2 => (0..12_u64, 0.0..59.0).prop_map(|(id, x)| Happening::Move(id, x)),
        4 => Just(Happening::Acknowledge),
        1 => Just(Happening::Lose),
        1 => Just(Happening::Snapshot),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_replica_equals_the_views_mesh_after_any_events(events in prop::collection::vec(happenings(), 1..30)) {
        let terrain = terrain();
        let mut exercise = Arc::new(exercise(&terrain, 6));
        let (mut view, mut client) = opened(&terrain, &wire_settings(500, None), Some(Arc::clone(&exercise)));
        let (mut poses, mut received, mut losing, mut lost) = (0, 0, false, false);
        for event in events {
            let applied_sequence = client.replica().sequence();
            let steer = v1::SteerView { applied_sequence, ..Default::default() };
            match event {
                Happening::Pose(x, y, turn) => {
                    poses += 1;
                    let pose = Some(wire_pose(x, y, turn));
                    view.handle(Event::Steer(v1::SteerView { pose, pose_sequence: poses, ..steer })).unwrap();
                }
                Happening::Budget(triangles) => {
                    let settings = Some(wire_settings(triangles, None));
                    view.handle(Event::Steer(v1::SteerView { settings, ..steer })).unwrap();
                }
                Happening::Move(id, x) => {
                    exercise = Arc::new(moved(&exercise, &terrain, id, x));
                    view.handle(Event::Exercise(Arc::clone(&exercise))).unwrap();
                }
                Happening::Acknowledge => view.handle(Event::Steer(steer)).unwrap(),
                Happening::Lose => losing = true,
                Happening::Snapshot => {
                    let request = v1::RequestSnapshot { received_sequence: received };
                    view.handle(Event::Snapshot(request)).unwrap();
                }
            }
            for response in view.produce().unwrap() {
                let Response::Frame(frame) = &response else {
                    prop_assert_eq!(client.apply(&message(&response)).unwrap(), scene::Event::Exercise);
                    continue;
                };
                if std::mem::take(&mut losing) {
                    lost = true;
                    continue;
                }
                received = frame.sequence;
                lost &= frame.base_sequence != 0;
                if lost {
                    prop_assert!(client.apply(&message(&response)).is_err());
                    continue;
                }
                prop_assert_eq!(client.apply(&message(&response)).unwrap(), scene::Event::Frame);
                let root = view.mesh.root();
                let active: Vec<Post> = view.mesh.active_posts().into_iter().map(|(post, _)| post).collect();
                let mesh = integer_posts(&view.mesh, &[active, root.corners().to_vec()].concat());
                let mut expected: Vec<_> = mesh.unwrap();
                expected.sort_unstable();
                prop_assert_eq!(client.replica().posts(), expected);
                prop_assert_eq!(client.replica().hash(), view.sent().hash());
                prop_assert_eq!(client.epoch(), exercise.epoch());
                let named: Vec<_> = client.unsatisfied().keys().copied().collect();
                prop_assert_eq!(named, view.unsatisfied.iter().copied().collect::<Vec<_>>());
                prop_assert!(client.silent_disagreements().is_empty());
                for state in exercise.sight_lines() {
                    prop_assert_eq!(client.lines()[&state.line.id].ends, state.resolved);
                }
            }
        }
    }
}

#[test]
fn frames_name_entities_off_their_ground_and_say_what_lines_lack() {
    let terrain = terrain();
    let exercise = exercise(&terrain, 30);
    let asking = exercise.entities().map(|entity| Entity { ground_m: Some(0.5), ..*entity }).collect();
    let change = Change { put_entities: asking, ..Change::default() };
    let exercise = Arc::new(exercise.changed(&change, &SITE, &*terrain).unwrap());
    let (mut view, mut client) = opened(&terrain, &wire_settings(2, None), Some(Arc::clone(&exercise)));
    let (mut named, mut lacking) = (Vec::new(), 0);
    for (sequence, triangles) in [(1, 2), (2, 40), (3, 4000), (4, 60)] {
        let settings = Some(wire_settings(triangles, None));
        let steer = v1::SteerView { settings, applied_sequence: sequence - 1, ..Default::default() };
        view.handle(Event::Steer(steer)).unwrap();
        let messages = view.produce().unwrap();
        lacking += frames(&messages)[0].now_unsatisfied.iter().map(|line| line.lacking_triangles).sum::<u32>();
        for word in &messages {
            client.apply(&message(word)).unwrap();
        }
        assert_eq!(client.silent_disagreements(), [] as [u64; 0]);
        for ground in exercise.grounds() {
            let [upper, lower] = ground.band;
            let mesh = client.replica();
            let above = verdict_on_mesh(mesh, upper, upper) == MeshVerdict::Blocked;
            let mut below = false;
            let _ = for_each_triangle_met(mesh, lower, lower, |t| {
                let corners = t.corners().map(|p| [f64::from(p.i), f64::from(p.j), mesh.height(p).unwrap()]);
                below |= passes_above(lower, lower, corners, mesh.grid_size());
                std::ops::ControlFlow::Continue(())
            });
            assert_eq!(above || below, client.off_ground().contains(&ground.entity), "{triangles}: {ground:?}");
        }
        named.push(client.off_ground().len());
    }
    assert!(named[0] > 10 && named[2] == 0 && named[3] > 0 && lacking > 0, "{named:?}, {lacking}");
}

/// Frames follow from the terrain and what the view was told, not from where heights are read: from memory, from a file whose
/// heights stay once they were read, from one of which nothing stays.
#[test]
fn frames_are_the_same_from_memory_and_from_any_file() {
    fn all<T: Terrain>(terrain: T, exercise: &Arc<Exercise>) -> Vec<Response> {
        let (mut view, _) = opened(&Arc::new(terrain), &wire_settings(700, None), Some(Arc::clone(exercise)));
        let mut said = view.produce().unwrap();
        for n in 1..6 {
            view.handle(steer(Some(wire_pose(1500.0 * n as f64, 900.0 * n as f64, 0.2 * n as f64)), n, n)).unwrap();
            said.extend(view.produce().unwrap());
        }
        said
    }
    let field = synthetic::fractal(300, 260, 5, 900).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("it.sldb");
    let description = database::Description { scale: SCALE, georeference: None, provenance: Provenance::default() };
    database::write(&path, false, &field, &description, &mut |_| ()).unwrap();
    let terrain = MemoryTerrain::new(field, SCALE).unwrap();
    let exercise = Arc::new(exercise(&terrain, 8));
    let expected = all(terrain, &exercise);
    assert_eq!(frames(&expected).len(), 6);
    for cache_bytes in [0, 16 << 20] {
        let database = Database::open(&path, OpenOptions { cache_bytes }).unwrap();
        assert_eq!(all(database, &exercise), expected, "{cache_bytes} bytes");
    }
}
