//! What must hold of exercises: whole steps or none, exact verdicts, and only what moved is new.

use proptest::prelude::*;

use super::*;
use crate::{
    los::{self, Options},
    terrain::{Georeference, MemoryField, SceneScale, synthetic},
};

const SITE: Site = Site { scale: SceneScale { east_m: 10.0, north_m: 10.0, up_m: 1.0 }, georeference: None };

fn grid(x: f64, y: f64, z: f64, altitude: Altitude) -> Place {
    Place { position: [x, y, z], frame: Frame::Grid, altitude }
}

fn entity(id: u64, x: f64, y: f64) -> Entity {
    Entity { id, place: grid(x, y, 2.0, Altitude::AboveGround), ground_m: None }
}

fn between(id: u64, a: u64, b: u64) -> SightLine {
    let end = |id| Anchor::Entity { id, offset_m: 1.0 };
    SightLine { id, a: end(a), b: end(b), fidelity: Fidelity::Verdict, priority: 0, range_m: None, region: None }
}

fn put(entities: Vec<Entity>, lines: Vec<SightLine>) -> Change {
    Change { put_entities: entities, put_sight_lines: lines, ..Change::default() }
}

fn field() -> MemoryField {
    synthetic::fractal(70, 50, 7, 400).unwrap()
}

fn started(field: &MemoryField) -> Exercise {
    let entities = vec![entity(1, 5.0, 5.0), entity(2, 60.25, 40.5), entity(3, 30.0, 8.0)];
    let change = put(entities, vec![between(10, 1, 2), between(11, 2, 3)]);
    Exercise::new("test").unwrap().changed(&change, &SITE, field).unwrap()
}

#[test]
fn names_are_short_and_plain() {
    for good in ["a", "A-1_b.c", &"x".repeat(MAX_NAME_LENGTH)] {
        assert_eq!(Exercise::new(good).unwrap().name(), good);
    }
    for bad in ["", "a b", "ü", "a/b", &"x".repeat(MAX_NAME_LENGTH + 1)] {
        Exercise::new(bad).unwrap_err();
    }
}

#[test]
fn one_accepted_change_is_one_epoch_and_only_what_moved_is_new() {
    let field = field();
    let first = started(&field);
    assert_eq!(first.epoch(), 1);
    let second = first.changed(&put(vec![entity(3, 31.0, 8.0)], vec![]), &SITE, &field).unwrap();
    assert_eq!(second.epoch(), 2);
    assert_eq!(second.sight_line(10), first.sight_line(10));
    assert_eq!(second.sight_line(11).unwrap().since_epoch, 2);
    // The same place again is an epoch, but nothing is new.
    let third = second.changed(&put(vec![entity(3, 31.0, 8.0)], vec![]), &SITE, &field).unwrap();
    assert_eq!(third.epoch(), 3);
    assert_eq!(third.sight_line(11).unwrap().since_epoch, 2);
    // Another fidelity with the same ends is new.
    let wedgie = SightLine { fidelity: Fidelity::Wedgie, ..between(10, 1, 2) };
    let fourth = third.changed(&put(vec![], vec![wedgie]), &SITE, &field).unwrap();
    assert_eq!(fourth.sight_line(10).unwrap().since_epoch, 4);
}

#[test]
fn what_is_wrong_is_refused_by_name() {
    let field = field();
    let exercise = started(&field);
    let refused = |change: &Change| exercise.changed(change, &SITE, &field).unwrap_err();
    let remove = |entities: &[u64], lines: &[u64]| Change {
        remove_entities: entities.to_vec(),
        remove_sight_lines: lines.to_vec(),
        ..Change::default()
    };
    assert_eq!(refused(&remove(&[9], &[])), ChangeError::Missing { thing: Thing::Entity, id: 9 });
    assert_eq!(refused(&remove(&[], &[9])), ChangeError::Missing { thing: Thing::SightLine, id: 9 });
    assert_eq!(refused(&remove(&[3], &[])), ChangeError::Anchoring { entity: 3, line: 11 });
    assert_eq!(refused(&remove(&[], &[10, 10])), ChangeError::Duplicate { thing: Thing::SightLine, id: 10 });
    let twice = put(vec![entity(4, 1.0, 1.0), entity(4, 2.0, 2.0)], vec![]);
    assert_eq!(refused(&twice), ChangeError::Duplicate { thing: Thing::Entity, id: 4 });
    assert_eq!(refused(&put(vec![], vec![between(12, 1, 7)])), ChangeError::UnknownEntity { line: 12, entity: 7 });
    assert_eq!(refused(&put(vec![], vec![between(EYE_LINE_ID, 1, 2)])), ChangeError::ReservedId);
    let gone = Change { remove_entities: vec![3], ..put(vec![], vec![between(11, 1, 3)]) };
    assert_eq!(refused(&gone), ChangeError::UnknownEntity { line: 11, entity: 3 });
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let error = refused(&put(vec![entity(4, bad, 1.0)], vec![]));
        assert!(matches!(error, ChangeError::Place { thing: Thing::Entity, id: 4, .. }), "{error}");
        let far = SightLine { b: Anchor::Entity { id: 2, offset_m: bad }, ..between(12, 1, 2) };
        let error = refused(&put(vec![], vec![far]));
        assert!(matches!(error, ChangeError::Place { thing: Thing::SightLine, id: 12, .. }), "{error}");
    }
    let many = remove(&(0..=MAX_CHANGES as u64).collect::<Vec<_>>(), &[]);
    assert!(matches!(refused(&many), ChangeError::Limit { limit: MAX_CHANGES, .. }));
    let lines = (0..=MAX_SIGHT_LINES as u64).map(|id| between(id, 1, 1)).collect();
    assert!(matches!(refused(&put(vec![], lines)), ChangeError::Limit { limit: MAX_SIGHT_LINES, .. }));
    let map = Place { frame: Frame::Map, ..grid(1.0, 1.0, 1.0, Altitude::Absolute) };
    let error = refused(&put(vec![Entity { id: 4, place: map, ground_m: None }], vec![]));
    assert!(error.to_string().contains("no georeference"), "{error}");
    // A removal together with what follows is accepted.
    let both = exercise.changed(&remove(&[3], &[11]), &SITE, &field).unwrap();
    assert_eq!((both.entities().len(), both.sight_lines().len()), (2, 1));
}

#[test]
fn an_end_without_ground_is_unknown_and_one_beyond_the_grid_too() {
    let holes = MemoryField::from_fn(9, 9, |i, j| ((i, j) != (4, 4)).then_some(0.0)).unwrap();
    let change = put(vec![entity(1, 1.0, 1.0), entity(2, 4.0, 4.0), entity(3, 20.0, 1.0)], vec![between(1, 1, 2)]);
    let exercise = Exercise::new("holes").unwrap().changed(&change, &SITE, &holes).unwrap();
    let state = exercise.sight_line(1).unwrap();
    assert_eq!((state.verdict, state.resolved), (los::Verdict::Unknown, None));
    let absolute = |x| Anchor::Point(grid(x, 1.0, 50.0, Altitude::Absolute));
    let out = SightLine { a: absolute(1.0), b: absolute(20.0), ..between(2, 1, 1) };
    let exercise = exercise.changed(&put(vec![], vec![out]), &SITE, &holes).unwrap();
    let state = exercise.sight_line(2).unwrap();
    assert_eq!((state.verdict, state.resolved.is_some()), (los::Verdict::Unknown, true));
}

#[test]
fn an_entity_on_the_ground_is_never_below_it() {
    let field = field();
    let standing = |id, x, y| Entity { id, place: grid(x, y, 0.0, Altitude::AboveGround), ground_m: None };
    let foot = |id| Anchor::Entity { id, offset_m: 0.0 };
    for (x, y) in [(0.1, 0.7), (33.3, 21.7), (12.0, 12.5), (69.0, 49.0)] {
        let line = SightLine { a: foot(1), b: foot(1), ..between(1, 1, 1) };
        let change = put(vec![standing(1, x, y)], vec![line]);
        let exercise = Exercise::new("feet").unwrap().changed(&change, &SITE, &field).unwrap();
        assert_eq!(exercise.sight_line(1).unwrap().verdict, los::Verdict::Visible, "({x}, {y})");
    }
}

#[test]
fn frames_meet_at_the_same_post() {
    let field = field();
    let georeference = Georeference { epsg: Some(4326), geographic: true, origin: [10.0, 50.0], step: [0.25, 0.5] };
    let scale = SceneScale { east_m: 16.0, north_m: 8.0, up_m: 0.5 };
    let site = Site { scale, georeference: Some(georeference) };
    let place = |frame, position| Place { position, frame, altitude: Altitude::Absolute };
    let same = [
        place(Frame::Grid, [4.0, 6.0, 100.0]),
        place(Frame::Scene, [64.0, 48.0, 50.0]),
        place(Frame::Map, [11.0, 53.0, 50.0]),
        place(Frame::Geographic, [11.0, 53.0, 50.0]),
    ];
    for place in same {
        assert_eq!(site.grid_from_place(&field, &place, 2.0).unwrap(), Some([4.0, 6.0, 104.0]), "{place:?}");
    }
    let plane = Site { georeference: Some(Georeference { geographic: false, ..georeference }), ..site };
    assert_eq!(plane.grid_from_plan(Frame::Geographic, 11.0, 53.0), Err(PlaceError::NotGeographic));
    let zone =
        Georeference { epsg: Some(32611), geographic: false, origin: [384_000.0, 4_048_000.0], step: [30.0, 30.0] };
    let zone = Site { georeference: Some(zone), ..site };
    // Mount Whitney, where PROJ puts it: 384381.795 m east, 4048892.755 m north.
    let [x, y] = zone.grid_from_plan(Frame::Geographic, -118.2923, 36.5785).unwrap();
    assert!((x - 381.795_377_352 / 30.0).abs() < 1e-5 && (y - 892.754_522_422 / 30.0).abs() < 1e-5, "{x} {y}");
    let swapped = zone.grid_from_plan(Frame::Geographic, 36.5785, -118.2923);
    assert_eq!(swapped, Err(PlaceError::BeyondProjection([36.5785, -118.2923])));
    assert!(matches!(site.grid_from_plan(Frame::Map, 1e308, 1e308), Ok([_, _]) | Err(PlaceError::NotFinite(_))));
    let high = Place { position: [4.0, 6.0, f64::MAX], ..same[1] };
    assert!(matches!(site.grid_from_place(&field, &high, 2.0), Err(PlaceError::NotFinite(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn after_any_changes_all_verdicts_are_exact_and_refusals_change_nothing(
        steps in prop::collection::vec(
            prop::collection::vec((0..4_u8, 0..6_u64, 0..6_u64, 0.0..75.0_f64, -3.0..52.0_f64), 1..5), 1..8),
    ) {
        let field = field();
        let mut exercise = Exercise::new("any").unwrap();
        for step in steps {
            let mut change = Change::default();
            for (what, id, other, x, y) in step {
                match what {
                    0 => change.remove_entities.push(id),
                    1 => change.remove_sight_lines.push(id),
                    2 => change.put_entities.push(entity(id, x, y)),
                    _ => change.put_sight_lines.push(between(id, id, other)),
                }
            }
            let before = exercise.clone();
            match exercise.changed(&change, &SITE, &field) {
                Ok(next) => exercise = next,
                Err(_) => prop_assert_eq!(&before, &exercise),
            }
            for state in exercise.sight_lines() {
                prop_assert!(state.since_epoch <= exercise.epoch());
                let ids = [state.line.a, state.line.b].map(|anchor| match anchor {
                    Anchor::Entity { id, .. } => id,
                    Anchor::Point(_) => 0,
                });
                let place = |id| exercise.entities().find(|e| e.id == id).map(|e| e.place);
                let end = |id| SITE.grid_from_place(&field, &place(id).unwrap(), 1.0).unwrap();
                let ends = end(ids[0]).zip(end(ids[1])).map(|(a, b)| [a, b]);
                prop_assert_eq!(ends, state.resolved);
                let exact = ends.map_or(los::Verdict::Unknown, |[a, b]| {
                    los::line_of_sight(&field, a, b, Options::default()).unwrap().verdict
                });
                prop_assert_eq!(exact, state.verdict);
            }
        }
    }
}

#[test]
fn a_line_out_of_its_range_or_region_is_inactive_until_it_is_back() {
    let field = field();
    let first = started(&field);
    let asked = first.sight_line(11).unwrap();
    let [a, b] = asked.resolved.unwrap().map(|end| SITE.scale.scene_from_grid(glam::DVec3::from_array(end)));
    let length_m = a.distance(b);
    let disc = |radius_m| Some(Disc { centre: [30.0, 8.0], frame: Frame::Grid, radius_m });
    let put_line = |line: SightLine| first.changed(&put(vec![], vec![line]), &SITE, &field).unwrap();
    for (range_m, region, active) in [
        (Some(length_m + 1.0), None, true),
        (Some(length_m - 1.0), None, false),
        (None, disc(500.0), true),
        (None, disc(100.0), false),
        (Some(length_m + 1.0), disc(100.0), false),
    ] {
        let next = put_line(SightLine { range_m, region, ..asked.line });
        let state = next.sight_line(11).unwrap();
        assert_eq!((state.active, state.resolved), (active, asked.resolved));
        let expected = if active { (asked.verdict, 1) } else { (los::Verdict::Unknown, 2) };
        assert_eq!((state.verdict, state.since_epoch), expected);
        let back = next.changed(&put(vec![], vec![asked.line]), &SITE, &field).unwrap();
        assert_eq!(back.sight_line(11).unwrap().verdict, asked.verdict);
    }
    // By its own motion, too.
    let near = put_line(SightLine { range_m: Some(300.0), ..asked.line });
    assert!(!near.sight_line(11).unwrap().active);
    let near = near.changed(&put(vec![entity(2, 40.0, 10.0)], vec![]), &SITE, &field).unwrap();
    let state = near.sight_line(11).unwrap();
    let [a, b] = state.resolved.unwrap();
    assert!(state.active);
    assert_eq!(state.verdict, los::line_of_sight(&field, a, b, Options::default()).unwrap().verdict);
}

#[test]
fn the_band_of_an_entity_holds_what_it_asks_for_and_hardly_more() {
    let field = field();
    let change = put(vec![Entity { ground_m: Some(0.75), ..entity(9, 12.3, 45.6) }], vec![]);
    let asking = Exercise::new("test").unwrap().changed(&change, &SITE, &field).unwrap();
    let ground = *asking.grounds().next().unwrap();
    let [[x, y, above], [_, _, below]] = ground.band;
    let surface = los::surface_height(&field, x, y).unwrap().unwrap();
    assert_eq!((ground.entity, x, y), (9, 12.3, 45.6));
    assert!(above >= surface + 0.75 - 1e-9 && below <= surface - 0.75 + 1e-9 && above - below < 1.5 + 1e-9);
    let gone = asking.changed(&put(vec![entity(9, 12.3, 45.6)], vec![]), &SITE, &field).unwrap();
    assert_eq!(gone.grounds().len(), 0);
}
