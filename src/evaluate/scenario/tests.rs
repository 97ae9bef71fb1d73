use super::*;
use crate::{
    evaluate::oracle::FieldOracle,
    terrain::{MemoryField, synthetic::fractal_height},
};
use sightline_proto::replica::Replica;

const SCALE: SceneScale = SceneScale { east_m: 30.0, north_m: 25.0, up_m: 0.5 };

/// Rough ground with a hole.
fn field() -> MemoryField {
    let hole = |i, j| (20..30).contains(&i) && (20..30).contains(&j);
    let height = |i, j| (!hole(i, j)).then(|| f64::from(fractal_height(i, j, 3, 400)));
    MemoryField::from_fn(129, 97, height).unwrap()
}

fn world(seed: u64) -> Scenario {
    let (field, none) = (field(), Vec::<Replica>::new());
    let mut oracle = FieldOracle(&field);
    let theatre = choose_theatre(SCALE, seed, &mut oracle).unwrap();
    let wish = Wish { lines: 40, ticks: 30, fidelity: Fidelity::Verdict, comings: false, seed };
    choose(wish, theatre, SCALE, &none, &mut oracle).unwrap()
}

#[test]
fn a_seed_makes_one_world_and_another_seed_another() {
    assert_eq!(world(5), world(5));
    assert_ne!(world(5).lines, world(6).lines);
}

#[test]
fn lines_are_as_many_as_wished_and_the_wished_share_is_visible() {
    let field = field();
    for seed in 0..4 {
        let world = world(seed);
        assert_eq!(world.lines.len(), 40, "seed {seed}");
        let truth = world.truth(0, None, &mut FieldOracle(&field)).unwrap();
        let count = |v| truth.lines.values().filter(|line| line.verdict == v).count();
        let (visible, blocked) = (count(v1::Verdict::Visible), count(v1::Verdict::Blocked));
        let share = visible as f64 / (visible + blocked) as f64;
        assert!((0.2..=0.5).contains(&share), "seed {seed}: {visible} visible, {blocked} blocked");
    }
}

#[test]
fn entities_stay_in_the_theatre_and_truth_does_not_depend_on_what_is_reused() {
    let (field, world) = (field(), world(9));
    let mut oracle = FieldOracle(&field);
    let before = world.truth(3, None, &mut oracle).unwrap();
    for tick in [0, 1, 17, 100_000] {
        for entity in &world.entities {
            let at = entity.at(tick, world.theatre);
            assert!((0..2).all(|k| at[k] >= world.theatre[0][k] && at[k] <= world.theatre[1][k]), "{at:?}");
        }
        let fresh = world.truth(tick, None, &mut oracle).unwrap();
        assert_eq!(world.truth(tick, Some(&before), &mut oracle).unwrap(), fresh);
    }
    assert_ne!(world.truth(0, None, &mut oracle).unwrap().digest, before.digest);
}

#[test]
fn lines_that_come_and_go_are_a_quarter_and_each_is_there_half_the_time() {
    let world = Scenario { comings: true, ..world(9) };
    let field = field();
    let mut oracle = FieldOracle(&field);
    let mut there = vec![0; world.lines.len()];
    let ticks = 4 * STAY_TICKS;
    for tick in 0..ticks {
        let truth = world.truth(tick, None, &mut oracle).unwrap();
        truth.lines.keys().for_each(|&id| there[id as usize - 1] += 1);
    }
    for (line, &ticks_there) in there.iter().enumerate() {
        assert_eq!(ticks_there, if line % 4 == 3 { ticks / 2 } else { ticks }, "line {line}");
    }
}
