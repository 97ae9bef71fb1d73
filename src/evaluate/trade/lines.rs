//! The sight lines that are asked, with their exact verdicts: from a viewer, between others, and grazing ones.

use rayon::prelude::*;

use super::{TradeError, world::World};
use crate::{
    evaluate::dice::Dice,
    lod::{IndexedMesh, LodView, sight::SightIndex},
    los::{self, Lines, Options, Verdict},
    roam::{Fidelity, RequiredLine},
    terrain::HeightField,
};

/// How far above ground ends are, in metres.
const END_M: f64 = 2.0;
/// Greatest range of lines between others, in metres.
const RANGE_M: f64 = 10_000.0;
/// Tries to find a place in the picture, for each that is wanted.
const TRIES: usize = 1_000;

/// A sight line in the grid frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Line {
    pub(super) ends: [[f64; 3]; 2],
    /// The exact verdict on the finest surface.
    pub(super) verdict: Verdict,
}

/// Lines with their exact verdicts.
fn with_verdicts(world: &World, ends: Vec<[[f64; 3]; 2]>) -> Result<Vec<Line>, TradeError> {
    let mut asked = Lines::new(&*world.terrain);
    let line = |ends: [[f64; 3]; 2]| {
        let verdict = asked.ask(ends[0], ends[1], Options::default())?.verdict;
        Ok(Line { ends, verdict })
    };
    ends.into_iter().map(line).collect()
}

/// A place somewhere on the terrain, a little above ground.
fn place(world: &World, dice: &mut Dice) -> Result<Option<[f64; 3]>, TradeError> {
    let [x, y] = dice.place([[0.0; 2], world.cells()], 0.0);
    on_ground(world, [x, y])
}

fn on_ground(world: &World, [x, y]: [f64; 2]) -> Result<Option<[f64; 3]>, TradeError> {
    let z = los::on_ground(&*world.terrain, x, y, END_M / world.scale().up_m)?;
    Ok(z.map(|z| [x, y, z]))
}

/// Lines between others, up to `range_m` long.
pub(super) fn between(world: &World, count: usize, range_m: f64, seed: u64) -> Result<Vec<Line>, TradeError> {
    let mut dice = Dice::new(seed);
    let (scale, cells) = (world.scale(), world.cells());
    let mut ends = Vec::new();
    while ends.len() < count {
        let Some(a) = place(world, &mut dice)? else { continue };
        let (way, heading) = (range_m * dice.fraction(), dice.heading());
        let b = [a[0] + way * heading[0] / scale.east_m, a[1] + way * heading[1] / scale.north_m];
        if (0..2).any(|k| b[k] < 0.0 || b[k] > cells[k]) {
            continue;
        }
        ends.extend(on_ground(world, b)?.map(|b| [a, b]));
    }
    with_verdicts(world, ends)
}

/// The usual lines between others.
pub(super) fn third_party(world: &World, count: usize, seed: u64) -> Result<Vec<Line>, TradeError> {
    between(world, count, RANGE_M.min(0.5 * world.shorter_side_m()), seed)
}

/// Lines from the eye of a view to places in its picture, hidden ones included; fewer where few can be found.
pub(super) fn from_eye(world: &World, view: &LodView, count: usize, seed: u64) -> Result<Vec<Line>, TradeError> {
    let mut dice = Dice::new(seed);
    let eye = world.scale().grid_from_scene(view.eye()).to_array();
    let mut ends = Vec::new();
    for _ in 0..count * TRIES {
        if ends.len() == count {
            break;
        }
        let Some(target) = place(world, &mut dice)? else { continue };
        let seen = world.scale().scene_from_grid(target.into());
        if view.camera().distortion(seen, seen).is_some() {
            ends.push([eye, target]);
        }
    }
    with_verdicts(world, ends)
}

/// The lines as our refinement takes them.
pub(super) fn required(lines: &[Line], fidelity: Fidelity) -> Vec<RequiredLine> {
    let required = |(id, line): (usize, &Line)| {
        let [a, b] = line.ends;
        RequiredLine { id: id as u64, a, b, verdict: line.verdict.on_mesh(), fidelity, priority: 0 }
    };
    lines.iter().enumerate().map(required).collect()
}

/// Which of the lines come out wrong on a mesh, by number.
pub(super) fn wrong(world: &World, mesh: &IndexedMesh, lines: &[Line]) -> Vec<usize> {
    let index = SightIndex::new(mesh, HeightField::grid(&*world.terrain));
    let is_wrong = |line: &Line| {
        let [a, b] = line.ends;
        line.verdict.on_mesh().is_some_and(|right| index.verdict(a, b) != right)
    };
    (0..lines.len()).into_par_iter().filter(|&n| is_wrong(&lines[n])).collect()
}

/// Lines between posts, with ends whole height units above them: so some touch the ground exactly.
pub(super) fn post_to_post(world: &World, count: usize, seed: u64) -> Result<Vec<Line>, TradeError> {
    let mut dice = Dice::new(seed);
    let above = (END_M / world.scale().up_m).round();
    let ends = (0..count).map(|_| [post(world, &mut dice, above), post(world, &mut dice, above)]).collect();
    with_verdicts(world, ends)
}

fn post(world: &World, dice: &mut Dice, above: f64) -> [f64; 3] {
    let [i, j] = world.cells().map(|last| dice.below(last as usize + 1) as u32);
    [f64::from(i), f64::from(j), world.ground.z(i, j) + above]
}

/// Lines between posts that are visible by the least f64: each at the least height of its far end from which it is, and
/// at the number below that.
pub(super) fn grazing(world: &World, count: usize, seed: u64) -> Result<Vec<Line>, TradeError> {
    let mut dice = Dice::new(seed);
    let range = GRAZING_POSTS.min(0.5 * world.cells()[0].min(world.cells()[1]));
    let mut ends = Vec::new();
    for _ in 0..count * TRIES {
        if ends.len() >= count {
            break;
        }
        let a = post(world, &mut dice, END_M / world.scale().up_m);
        let b = [0, 1].map(|k| (a[k] + range * (2.0 * dice.fraction() - 1.0)).round().clamp(0.0, world.cells()[k]));
        let least = los::least_target_height(&*world.terrain, a, b, Options::default())?;
        if let Some(z) = least.filter(|_| [a[0], a[1]] != b) {
            ends.extend([z, z.next_down()].map(|z| [a, [b[0], b[1], z]]));
        }
    }
    with_verdicts(world, ends)
}

/// Greatest range of grazing lines in each direction, in posts.
const GRAZING_POSTS: f64 = 200.0;
