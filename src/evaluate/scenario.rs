//! Worlds for a consistency test: moving and fixed entities, and sight lines that are hard to get right.
//!
//! All of it follows from a seed and the terrain. Everything lies in one *theatre*, the roughest of some windows tried,
//! so that clients look at the ground over which the lines run. Lines are drawn at random, 2 m above ground and up to
//! 10 km long, and kept by quota: so many visible, so many that a plain mesh gets wrong. Which are which is asked of
//! the finest terrain at three times of the run.

use sightline_client::scene::{StatedLine, StatedObstruction, digest_of_lines};
use sightline_proto::{
    mesh::Mesh,
    v1,
    verdict::{MeshVerdict, verdict_on_mesh},
};
use std::collections::BTreeMap;

use super::{
    dice::Dice,
    oracle::{Ends, Oracle, OracleError},
};
use crate::{roam::Fidelity, session::fidelity_to_wire, terrain::SceneScale};

/// Side of the theatre in metres, where the terrain is that large.
pub const THEATRE_SIDE_M: f64 = 24_000.0;
/// Longest sight line at the start, in metres.
pub const LONGEST_M: f64 = 10_000.0;
/// Shortest sight line at the start, in metres.
const SHORTEST_M: f64 = 300.0;
/// Height of ends above ground in metres.
pub const ABOVE_GROUND_M: f64 = 2.0;
/// Time that passes in the world from one tick to the next.
const TICK_S: f64 = 0.2;
/// Ticks that a line which comes and goes stays, and stays away.
const STAY_TICKS: u64 = 8;
/// Windows tried for the theatre.
const WINDOWS: usize = 24;
/// Share of lines that shall be visible.
const VISIBLE_SHARE: f64 = 0.35;
/// Share of lines, among the visible and among the others, that shall be wrong on a plain mesh.
const WRONG_SHARE: f64 = 0.3;
/// Candidates drawn for each line wanted, before the quotas are let go.
const CANDIDATES_PER_LINE: usize = 40;
/// Greatest number of sight lines of a scenario.
pub const MAX_LINES: usize = 100_000;

/// One end of a line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Anchor {
    /// The entity with this index.
    Entity(usize),
    /// A fixed place: x and y of the grid frame.
    Point([f64; 2]),
}

/// A thing that stands or moves to and fro between the borders of the theatre.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Entity {
    /// Plan position at tick 0, grid frame.
    pub start: [f64; 2],
    /// Posts a tick; 0 for one that stands.
    pub step: [f64; 2],
}

/// A registered line; its id is its index + 1.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Line {
    /// The observer's end.
    pub a: Anchor,
    /// The target's end.
    pub b: Anchor,
}

/// A world.
#[derive(Clone, PartialEq, Debug)]
pub struct Scenario {
    /// South-west and north-east corner of the theatre, grid frame.
    pub theatre: [[f64; 2]; 2],
    /// The entities; ids are indices + 1.
    pub entities: Vec<Entity>,
    /// The lines; ids are indices + 1.
    pub lines: Vec<Line>,
    /// Height of all ends above ground, in height units.
    pub above: f64,
    /// What every line asks of meshes.
    pub fidelity: Fidelity,
    /// Whether a quarter of the lines come and go.
    pub comings: bool,
}

/// The exercise at one tick, as the finest terrain has it.
#[derive(Clone, PartialEq, Debug)]
pub struct Truth {
    /// Ends and exact verdicts by line id.
    pub lines: BTreeMap<u64, StatedLine>,
    /// Digest of `lines`, to compare with what a client holds.
    pub digest: u64,
}

impl Entity {
    /// Plan position at a tick: back and forth between the borders of the theatre.
    pub fn at(&self, tick: u64, theatre: [[f64; 2]; 2]) -> [f64; 2] {
        [0, 1].map(|k| {
            let (low, side) = (theatre[0][k], theatre[1][k] - theatre[0][k]);
            let way = (self.start[k] - low + self.step[k] * tick as f64).rem_euclid(2.0 * side);
            low + if way <= side { way } else { 2.0 * side - way }
        })
    }
}

impl Scenario {
    /// Plan position of an anchor at a tick.
    pub fn place(&self, anchor: Anchor, tick: u64) -> [f64; 2] {
        match anchor {
            Anchor::Entity(n) => self.entities[n].at(tick, self.theatre),
            Anchor::Point(at) => at,
        }
    }

    /// The ends of a line at a tick, resolved; `None` over unknown ground.
    pub fn ends(&self, line: Line, tick: u64, oracle: &mut impl Oracle) -> Result<Option<Ends>, OracleError> {
        let mut ends = [[0.0; 3]; 2];
        for (end, anchor) in ends.iter_mut().zip([line.a, line.b]) {
            let [x, y] = self.place(anchor, tick);
            match oracle.above_ground(x, y, self.above)? {
                Some(z) => *end = [x, y, z],
                None => return Ok(None),
            }
        }
        Ok(Some(ends))
    }

    /// Whether the line with this index is registered at a tick.
    pub fn is_registered(&self, line: usize, tick: u64) -> bool {
        !self.comings || line % 4 != 3 || ((tick + line as u64) / STAY_TICKS).is_multiple_of(2)
    }

    /// Whether a line has the same ends at all ticks.
    pub fn is_fixed(&self, line: Line) -> bool {
        [line.a, line.b].iter().all(|&anchor| match anchor {
            Anchor::Entity(n) => self.entities[n].step == [0.0; 2],
            Anchor::Point(_) => true,
        })
    }

    /// Where a line is obstructed, if it asks for that.
    fn obstruction(
        &self,
        ends: Option<Ends>,
        verdict: v1::Verdict,
        oracle: &mut impl Oracle,
    ) -> Result<Option<StatedObstruction>, OracleError> {
        let (Fidelity::Obstruction { distance_m }, Some(ends), v1::Verdict::Blocked) = (self.fidelity, ends, verdict)
        else {
            return Ok(None);
        };
        Ok(oracle.first_obstruction(ends)?.map(|first| StatedObstruction { first, distance_m }))
    }

    /// The exercise at a tick. `before`, the truth at any other tick, spares the work for lines that stand still.
    pub fn truth(&self, tick: u64, before: Option<&Truth>, oracle: &mut impl Oracle) -> Result<Truth, OracleError> {
        let mut lines = BTreeMap::new();
        let registered = (1..).zip(&self.lines).enumerate().filter(|&(n, _)| self.is_registered(n, tick));
        for (_, (id, &line)) in registered {
            let known = before.filter(|_| self.is_fixed(line)).and_then(|truth| truth.lines.get(&id));
            let state = match known {
                Some(&state) => state,
                None => {
                    let ends = self.ends(line, tick, oracle)?;
                    let verdict = ends.map_or(Ok(v1::Verdict::Unknown), |ends| oracle.verdict(ends))?;
                    let obstruction = self.obstruction(ends, verdict, oracle)?;
                    StatedLine { ends, verdict, fidelity: fidelity_to_wire(self.fidelity).0, obstruction }
                }
            };
            lines.insert(id, state);
        }
        let digest = digest_of_lines(lines.iter().map(|(&id, line)| (id, line)));
        Ok(Truth { lines, digest })
    }
}

/// What is wanted of a world.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Wish {
    /// How many sight lines.
    pub lines: usize,
    /// Ticks that the run will last.
    pub ticks: u64,
    /// What every line asks of meshes.
    pub fidelity: Fidelity,
    /// Whether a quarter of the lines come and go.
    pub comings: bool,
    /// Everything follows from it.
    pub seed: u64,
}

/// The roughest of some windows of the terrain, grid frame.
pub fn choose_theatre(scale: SceneScale, seed: u64, oracle: &mut impl Oracle) -> Result<[[f64; 2]; 2], OracleError> {
    const SAMPLES: usize = 12;
    let grid = oracle.grid();
    let extent = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
    let metres = [scale.east_m, scale.north_m];
    let side = [0, 1].map(|k| (THEATRE_SIDE_M / metres[k]).min(extent[k]));
    let mut dice = Dice::new(seed ^ 0x7468_6561_7472_6521);
    let mut best: Option<(f64, [[f64; 2]; 2])> = None;
    for _ in 0..WINDOWS {
        let low = [0, 1].map(|k| (dice.fraction() * (extent[k] - side[k])).floor());
        let high = [0, 1].map(|k| low[k] + side[k]);
        // Roughness: the sum of height steps between neighbouring samples; unknown ground counts as the flattest.
        let mut roughness = 0.0;
        for row in 0..SAMPLES {
            let mut last = None;
            for column in 0..SAMPLES {
                let at = |k: usize, n: usize| low[k] + side[k] * n as f64 / SAMPLES as f64;
                let z = oracle.above_ground(at(0, column), at(1, row), 0.0)?;
                roughness += last.zip(z).map_or(0.0, |(a, b): (f64, f64)| (a - b).abs());
                last = z;
            }
        }
        if best.is_none_or(|(most, _)| roughness > most) {
            best = Some((roughness, [low, high]));
        }
    }
    Ok(best.map_or([[0.0; 2], extent], |(_, window)| window))
}

/// Makes a world in a theatre. `plain` are meshes without sight lines, as the clients would get them: lines that one of
/// them gets wrong are preferred up to a quota.
pub fn choose(
    wish: Wish,
    theatre: [[f64; 2]; 2],
    scale: SceneScale,
    plain: &[impl Mesh],
    oracle: &mut impl Oracle,
) -> Result<Scenario, OracleError> {
    let mut dice = Dice::new(wish.seed);
    let mut world = Scenario {
        theatre,
        entities: entities(wish.lines, theatre, scale, &mut dice),
        lines: Vec::new(),
        above: ABOVE_GROUND_M / scale.up_m,
        fidelity: wish.fidelity,
        comings: wish.comings,
    };
    let mut quotas = Quotas::new(wish.lines);
    for _ in 0..wish.lines * CANDIDATES_PER_LINE {
        if quotas.are_full() {
            break;
        }
        let Some(line) = candidate(&world, scale, &mut dice) else { continue };
        let class = classify(&world, line, wish.ticks, plain, oracle)?;
        quotas.offer(class, line);
    }
    world.lines = quotas.chosen(wish.lines);
    Ok(world)
}

fn entities(lines: usize, theatre: [[f64; 2]; 2], scale: SceneScale, dice: &mut Dice) -> Vec<Entity> {
    (0..(lines / 2).clamp(8, 400))
        .map(|n| {
            let place = dice.place(theatre, 0.1);
            if n % 2 == 0 {
                // Those that stand do so on posts: ties with the surface are wanted.
                return Entity { start: place.map(f64::round), step: [0.0; 2] };
            }
            let [east, north] = dice.heading();
            let way_m = (5.0 + 55.0 * dice.fraction()) * TICK_S;
            Entity { start: place, step: [east * way_m / scale.east_m, north * way_m / scale.north_m] }
        })
        .collect()
}

/// A random line: between two entities, or from an entity to a point.
fn candidate(world: &Scenario, scale: SceneScale, dice: &mut Dice) -> Option<Line> {
    let a = dice.below(world.entities.len());
    let from = world.place(Anchor::Entity(a), 0);
    let b = if dice.fraction() < 0.5 {
        Anchor::Entity(dice.below(world.entities.len()))
    } else {
        let [east, north] = dice.heading();
        let way_m = SHORTEST_M + (LONGEST_M - SHORTEST_M) * dice.fraction();
        Anchor::Point([from[0] + east * way_m / scale.east_m, from[1] + north * way_m / scale.north_m])
    };
    let to = world.place(b, 0);
    let metres = [(to[0] - from[0]) * scale.east_m, (to[1] - from[1]) * scale.north_m];
    let square = metres[0] * metres[0] + metres[1] * metres[1];
    let inside = (0..2).all(|k| to[k] >= world.theatre[0][k] && to[k] <= world.theatre[1][k]);
    let fits = (SHORTEST_M * SHORTEST_M..=LONGEST_M * LONGEST_M).contains(&square);
    (inside && fits).then_some(Line { a: Anchor::Entity(a), b })
}

/// What a candidate is good for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Class {
    visible: bool,
    wrong_on_plain: bool,
}

fn classify(
    world: &Scenario,
    line: Line,
    ticks: u64,
    plain: &[impl Mesh],
    oracle: &mut impl Oracle,
) -> Result<Class, OracleError> {
    let mut visible = 0;
    let mut wrong = 0;
    let times = [0, ticks / 2, ticks.saturating_sub(1)];
    for tick in times {
        let Some(ends) = world.ends(line, tick, oracle)? else { continue };
        let exact = match oracle.verdict(ends)? {
            v1::Verdict::Visible => MeshVerdict::Visible,
            v1::Verdict::Blocked => MeshVerdict::Blocked,
            v1::Verdict::Unknown | v1::Verdict::Unspecified => continue,
        };
        visible += usize::from(exact == MeshVerdict::Visible);
        wrong += plain.iter().filter(|mesh| verdict_on_mesh(*mesh, ends[0], ends[1]) != exact).count();
    }
    Ok(Class { visible: 2 * visible > times.len(), wrong_on_plain: wrong >= plain.len().max(1) })
}

/// Chosen lines by class, each up to a number.
struct Quotas {
    /// Indexed by visible, then wrong.
    kept: [[Vec<Line>; 2]; 2],
    wanted: [[usize; 2]; 2],
    /// Candidates beyond their quota, as many as lines are wanted at most.
    spare: Vec<Line>,
    spare_wanted: usize,
}

impl Quotas {
    fn new(lines: usize) -> Self {
        let share = |of: usize, share: f64| (of as f64 * share).round() as usize;
        let visible = share(lines, VISIBLE_SHARE);
        let split = |n: usize| [n - share(n, WRONG_SHARE), share(n, WRONG_SHARE)];
        Self {
            kept: Default::default(),
            wanted: [split(lines - visible), split(visible)],
            spare: Vec::new(),
            spare_wanted: lines,
        }
    }

    fn offer(&mut self, class: Class, line: Line) {
        let (visible, wrong) = (usize::from(class.visible), usize::from(class.wrong_on_plain));
        if self.kept[visible][wrong].len() < self.wanted[visible][wrong] {
            self.kept[visible][wrong].push(line);
        } else if self.spare.len() < self.spare_wanted {
            self.spare.push(line);
        }
    }

    fn are_full(&self) -> bool {
        self.kept.iter().flatten().zip(self.wanted.iter().flatten()).all(|(kept, wanted)| kept.len() == *wanted)
    }

    /// The chosen lines, the classes mixed so that no priority goes with a class; spare ones where a quota could not
    /// be met.
    fn chosen(self, lines: usize) -> Vec<Line> {
        let mut queues: Vec<_> = self.kept.into_iter().flatten().chain([self.spare]).map(Vec::into_iter).collect();
        let spare = queues.len() - 1;
        let mut out = Vec::with_capacity(lines);
        loop {
            let before = out.len();
            for queue in &mut queues[..spare] {
                out.extend(queue.next());
            }
            if out.len() == before {
                out.extend(queues[spare].by_ref().take(lines.saturating_sub(out.len())));
                return out;
            }
        }
    }
}

#[cfg(test)]
mod tests;
