//! The procedure that makes the lines right: needed-only refinement, with stable sets to fall back on.
//!
//! 1. All lines are checked on the plain mesh. Each one that fails adds the splits that it needs to what is required,
//!    the mesh is refined again under the same budget, and the lines near which anything changed are checked again.
//!    Required splits only accumulate, so this ends.
//! 2. Where that overflows the budget, takes too many rounds or makes no progress: the stable sets of the longest run of
//!    lines that fit together are required. Those lines hold whatever else happens. The remaining ones are then taken
//!    in order, each with the splits that it needs on top; a line that does not fit is dropped and does not return.
//!
//! Either way every line is checked, exactly, on the mesh that is delivered.

use std::sync::Arc;

use sightline_proto::{diamond::Post, predicates::Sign};

use super::{
    RequiredLine,
    closure::Closure,
    ground::Ground,
    rule::Rule,
    stable::{path, profile_set, stable_set},
    witness::{Witness, witnesses},
};
use crate::{
    roam::{
        Terrain,
        queues::{Allowance, DualQueue, KeyMap},
    },
    terrain::ReadError,
    view::Camera,
};

/// Rounds of needed-only refinement of all lines together before the stable sets are taken instead.
const MAX_ROUNDS: usize = 24;
/// Rounds for one line on top of the stable sets before it is dropped.
const MAX_ROUNDS_ALONE: usize = 12;

/// What refinement is to keep to.
#[derive(Clone, Copy, Debug)]
pub(in crate::roam) struct Limits<'a> {
    pub(in crate::roam) camera: &'a Camera,
    pub(in crate::roam) allowed: Allowance,
}

/// What came of it.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub(in crate::roam) struct Outcome {
    /// Ids of the lines that do not hold, ascending.
    pub(in crate::roam) unsatisfied: Vec<u64>,
    /// Triangles of the required posts that the plain mesh lacks.
    pub(in crate::roam) stolen: u32,
}

/// What depends on a line and the terrain alone.
#[derive(Debug, Default)]
struct Known {
    witnesses: Option<Vec<Witness>>,
    stable: Option<Vec<Post>>,
}

/// What is remembered of the lines from update to update: nothing that changes a result.
#[derive(Debug, Default)]
pub(in crate::roam) struct Requirements {
    known: KeyMap<(RequiredLine, Known)>,
}

/// A line with its place in the procedure.
struct Entry {
    line: RequiredLine,
    rule: Rule,
    holds: bool,
    dropped: bool,
    known: Known,
}

/// One run of the procedure.
struct Run<'a, T: Terrain> {
    queue: &'a mut DualQueue<T>,
    ground: &'a Ground<'a, T>,
    limits: Limits<'a>,
    required: Closure,
    /// How many posts of `required` the queue has been told.
    told: usize,
    /// How many toggles of the queue the lines have been checked against.
    seen: usize,
    /// In order of priority, then id.
    entries: Vec<Entry>,
}

impl Requirements {
    /// Makes `lines` right on `queue`, which holds the plain mesh of `limits`.
    pub(in crate::roam) fn satisfy<T: Terrain>(
        &mut self,
        queue: &mut DualQueue<T>,
        limits: Limits<'_>,
        lines: &[RequiredLine],
    ) -> Result<Outcome, ReadError> {
        let terrain = Arc::clone(queue.terrain());
        let ground = Ground::new(&*terrain);
        let entries = self.entries(lines);
        let required = Closure::new(ground.grid().root());
        let seen = queue.toggles().len();
        let mut run = Run { queue, ground: &ground, limits, required, told: 0, seen, entries };
        run.check_all()?;
        let plain = run.seen;
        if !run.needed_only(run.entries.len(), MAX_ROUNDS)? {
            run.fall_back()?;
        }
        debug_assert!(run.flags_are_true()?);
        let outcome = run.outcome(plain);
        self.known = run.entries.into_iter().map(|entry| (entry.line.id, (entry.line, entry.known))).collect();
        Ok(outcome)
    }

    /// The lines that ask for something, in order, with what is known of them.
    fn entries(&mut self, lines: &[RequiredLine]) -> Vec<Entry> {
        let mut lines = lines.to_vec();
        lines.sort_by_key(|line| (line.priority, line.id));
        let mut known = std::mem::take(&mut self.known);
        let mut entry = |line: RequiredLine| {
            let rule = Rule::of(&line)?;
            let remembered = known.remove(&line.id).filter(|(l, _)| *l == line);
            let known = remembered.map_or(Known::default(), |(_, known)| known);
            Some(Entry { line, rule, holds: false, dropped: false, known })
        };
        lines.into_iter().filter_map(&mut entry).collect()
    }
}

impl<T: Terrain> Run<'_, T> {
    fn check(&mut self, n: usize) -> Result<(), ReadError> {
        self.entries[n].holds = self.entries[n].rule.holds(self.queue, &self.entries[n].line)?;
        Ok(())
    }

    fn check_all(&mut self) -> Result<(), ReadError> {
        self.seen = self.queue.toggles().len();
        (0..self.entries.len()).try_for_each(|n| self.check(n))
    }

    /// Checks the lines near which the mesh changed since they were last checked.
    fn check_changed(&mut self) -> Result<(), ReadError> {
        let mut changed = self.queue.toggles()[self.seen..].to_vec();
        self.seen = self.queue.toggles().len();
        changed.sort_unstable();
        let changed: Vec<_> = changed.chunk_by(|p, q| p == q).filter(|c| c.len() % 2 == 1).map(|c| c[0]).collect();
        for n in 0..self.entries.len() {
            if changed.iter().any(|&p| may_touch(&self.entries[n].line, p)) {
                self.check(n)?;
            }
        }
        Ok(())
    }

    /// Tells the queue what is required, lets it refine, and checks the lines that this may have changed.
    fn apply(&mut self) -> Result<(), ReadError> {
        self.queue.require(&self.required.since(self.told))?;
        self.told = self.required.len();
        self.queue.refine(self.limits.allowed)?;
        self.check_changed()
    }

    /// Goes back to the first `len` required posts.
    fn retract(&mut self, len: usize) -> Result<(), ReadError> {
        self.required.shrink(len);
        self.queue.release();
        self.told = 0;
        self.apply()
    }

    fn fits(&self) -> bool {
        self.required.triangles() <= u64::from(self.limits.allowed.max)
    }

    /// Adds what the first `count` lines need, round by round, until those not dropped all hold: `true`. `false` when
    /// that overflows the budget, or goes on for more than `rounds`, or a line cannot be helped.
    fn needed_only(&mut self, count: usize, rounds: usize) -> Result<bool, ReadError> {
        for _ in 0..rounds {
            let before = self.required.len();
            let mut failing = false;
            for n in 0..count {
                if !self.entries[n].holds && !self.entries[n].dropped {
                    failing = true;
                    self.add_needed(n)?;
                    if !self.fits() {
                        return Ok(false);
                    }
                }
            }
            if !failing {
                return Ok(true);
            }
            if self.required.len() == before {
                return Ok(false);
            }
            self.apply()?;
        }
        Ok(false)
    }

    /// Requires the stable sets of the longest run that fits, then what the rest need as far as it fits.
    fn fall_back(&mut self) -> Result<(), ReadError> {
        self.required.shrink(0);
        let mut run = 0;
        while run < self.entries.len() {
            let before = self.required.len();
            let stable = self.stable(run)?;
            stable.iter().for_each(|&p| self.required.add(p));
            if !self.fits() {
                self.required.shrink(before);
                break;
            }
            run += 1;
        }
        self.queue.release();
        self.told = 0;
        self.apply()?;
        for n in run..self.entries.len() {
            let before = self.required.len();
            if !self.needed_only(n + 1, MAX_ROUNDS_ALONE)? {
                self.entries[n].dropped = true;
                self.retract(before)?;
            }
        }
        Ok(())
    }

    /// Adds to what is required the splits that a failing line needs on the mesh as it stands.
    fn add_needed(&mut self, n: usize) -> Result<(), ReadError> {
        let (line, rule) = (self.entries[n].line, self.entries[n].rule);
        let splits = match rule {
            Rule::Blocked => self.cheapest_block(n)?,
            Rule::Profile => profile_set(self.ground, &line)?,
            Rule::Clear | Rule::Wedgie => {
                let mut splits = Vec::new();
                for offender in rule.offenders(self.queue, &line, usize::MAX)? {
                    splits.extend(rule.splits_below(self.ground, &line, offender)?);
                }
                splits
            }
        };
        splits.into_iter().for_each(|p| self.required.add(p));
        Ok(())
    }

    /// The splits that make the mesh block the line at the witness where that takes the fewest triangles.
    fn cheapest_block(&mut self, n: usize) -> Result<Vec<Post>, ReadError> {
        let Entry { line, known, .. } = &mut self.entries[n];
        let candidates = match &mut known.witnesses {
            Some(witnesses) => witnesses,
            none => none.insert(witnesses(self.ground, line)?),
        };
        let mut least: Option<(u64, Vec<Post>)> = None;
        for witness in candidates.iter() {
            let splits = self.queue.splits_to_block(self.ground, line, witness)?;
            let mark = self.required.len();
            splits.iter().for_each(|&p| self.required.add(p));
            let new = self.required.since(mark);
            self.required.shrink(mark);
            let lacking = new.iter().filter(|&&p| self.queue.height_of(p).is_none());
            let cost = lacking.map(|&p| self.ground.grid().root().triangles(p).count() as u64).sum();
            if least.as_ref().is_none_or(|(triangles, _)| cost < *triangles) {
                least = Some((cost, splits));
            }
        }
        Ok(least.map_or(Vec::new(), |(_, splits)| splits))
    }

    fn stable(&mut self, n: usize) -> Result<Vec<Post>, ReadError> {
        let Entry { line, rule, known, .. } = &mut self.entries[n];
        if known.witnesses.is_none() && *rule == Rule::Blocked {
            known.witnesses = Some(witnesses(self.ground, line)?);
        }
        if known.stable.is_none() {
            known.stable = Some(stable_set(self.ground, line, *rule, known.witnesses.as_deref().unwrap_or(&[]))?);
        }
        Ok(known.stable.clone().unwrap_or_default())
    }

    /// Whether each flag is what an exact check says; for debug builds.
    fn flags_are_true(&self) -> Result<bool, ReadError> {
        for entry in &self.entries {
            if entry.holds != entry.rule.holds(self.queue, &entry.line)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn outcome(&self, plain: usize) -> Outcome {
        let failing = self.entries.iter().filter(|entry| !entry.holds);
        let mut unsatisfied: Vec<_> = failing.map(|entry| entry.line.id).collect();
        unsatisfied.sort_unstable();
        // Active in the mesh now and toggled an odd number of times since the plain mesh: the plain mesh lacked it.
        let mut changed = self.queue.toggles()[plain..].to_vec();
        changed.sort_unstable();
        let lacked = changed.chunk_by(|p, q| p == q).filter(|c| c.len() % 2 == 1).map(|c| c[0]);
        let stolen = lacked.filter(|&p| self.required.contains(p));
        let triangles: usize = stolen.map(|p| self.ground.grid().root().triangles(p).count()).sum();
        let stolen = u32::try_from(triangles).unwrap_or(u32::MAX);
        Outcome { unsatisfied, stolen }
    }
}

impl<T: Terrain> DualQueue<T> {
    /// The splits after which the mesh triangle over a witness is above the line there.
    fn splits_to_block(
        &self,
        ground: &Ground<'_, T>,
        line: &RequiredLine,
        witness: &Witness,
    ) -> Result<Vec<Post>, ReadError> {
        let mut splits = Vec::new();
        for triangle in path(ground.grid().root().roots(), &witness.face) {
            let Some(middle) = triangle.base_midpoint() else { break };
            if splits.is_empty() && self.height_of(middle).is_some() {
                continue;
            }
            let corners = ground.in_space(&triangle)?;
            if witness.point.height_against_plane(line.a, line.b, corners) == Sign::Negative {
                break;
            }
            splits.push(middle);
        }
        Ok(splits)
    }
}

/// Whether the line may meet the closed area of the diamond at `p` in plan; `true` when in doubt.
///
/// The area lies within b posts of p in each direction, b being the lowest bit of its coordinates. So the line through A
/// and B misses it when the vector product of B - A and p - A exceeds b (|dx| + |dy|) in magnitude. Its two products and
/// six differences round by less than 2^-50 of the magnitudes summed in `slack`. What is not a number misses nothing.
fn may_touch(line: &RequiredLine, p: Post) -> bool {
    let reach = f64::from(1_u32 << (p.i | p.j).trailing_zeros().min(31));
    let (x, y) = (f64::from(p.i), f64::from(p.j));
    let ([ax, ay, _], [bx, by, _]) = (line.a, line.b);
    if ax.min(bx) > x + reach || ax.max(bx) < x - reach || ay.min(by) > y + reach || ay.max(by) < y - reach {
        return false;
    }
    let (dx, dy) = (bx - ax, by - ay);
    let product = dx * (y - ay) - dy * (x - ax);
    let spread = reach * (dx.abs() + dy.abs());
    let magnitude = (ax.abs() + bx.abs()) * (y + ay.abs()) + (ay.abs() + by.abs()) * (x + ax.abs()) + spread;
    let slack = magnitude * 1e-14;
    let misses = product.abs() > spread + slack;
    !misses
}
