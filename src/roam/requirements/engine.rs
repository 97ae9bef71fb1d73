//! The procedure that keeps the lines right: needed-only refinement from update to update, in the order of the lines
//! where a budget is short.
//!
//! What is required is kept. In each update:
//!
//! 1. Lines that are gone give up what they own. The mesh is refined under what the others own, and those lines are
//!    checked whose ends, or near which triangles, changed.
//! 2. Each one that fails takes the fewest splits that it needs on this mesh with all that is already required
//!    ([`super::draft`]); the mesh is refined again, and lines near which anything changed are checked again. Required
//!    splits only accumulate in this, so it ends.
//! 3. Lines that chose in this update, and in turn all others, choose again, as if they owned nothing: what they need no
//!    more they give up. So nothing creeps. Then step 2 again.
//! 4. Where that overflows the budget, a line for which there is no room displaces the last ones in order that own
//!    anything, or is dropped itself ([`super::room`]). What is dropped does not return within the update, and later in
//!    its turn. Should that name a line which may not be named, all is given up, and lines take *no more than their
//!    stable sets allow* ([`super::stable`]): then a line is dropped only if those up to it need, together, more than
//!    the budget, and what they need is part of their joint stable set.
//!
//! Either way every line is checked, exactly, on the mesh that is delivered.

use std::sync::Arc;

use sightline_proto::diamond::Post;

use super::{
    Fidelity, RequiredLine,
    aim::Aim,
    draft::{Draft, PostSet},
    entry::{Entry, Standing},
    ground::Ground,
    ledger::Ledger,
    near::{Near, may_touch},
    room::Overflow,
    rule::Rule,
    witness::find,
};
use crate::{
    roam::{
        Terrain,
        queues::{Allowance, DualQueue},
    },
    terrain::{Grid, ReadError},
};

/// Rounds of needed-only refinement before lines are held to their stable sets. A guess; a dozen is much.
const MAX_ROUNDS: usize = 48;
/// In how many updates each line gets its turn to choose again, and one that was dropped to be served again.
pub(super) const TURNS: u64 = 8;

/// What came of it.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub(in crate::roam) struct Outcome {
    /// Ids of the lines that do not hold, ascending, each with the triangles that it lacked.
    pub(in crate::roam) unsatisfied: Vec<(u64, u32)>,
    /// Ids of the lines of fidelity GROUND that do not, ascending.
    pub(in crate::roam) off_ground: Vec<u64>,
    /// Triangles of the required posts.
    pub(in crate::roam) required: u32,
}

/// The requirements of a view.
#[derive(Debug)]
pub(in crate::roam) struct Requirements {
    /// In order of priority, then id.
    pub(super) entries: Vec<Entry>,
    pub(super) ledger: Ledger,
    near: Near,
    /// Where the joint stable set of lines in order is known to overflow; while the lines are the same.
    pub(super) overflow: Option<Overflow>,
    /// After a failure nothing is relied on.
    is_broken: bool,
    /// Counts updates.
    pub(super) turn: u64,
}

/// One update.
pub(super) struct Run<'a, 'g, T: Terrain> {
    queue: &'a mut DualQueue<T>,
    pub(super) ground: &'a Ground<'g, T>,
    pub(super) allowed: Allowance,
    pub(super) state: &'a mut Requirements,
    /// Whether lines are held to their stable sets.
    is_strict: bool,
    /// How many toggles of the queue the lines have been checked against.
    seen: usize,
}

impl Requirements {
    pub(in crate::roam) fn new(grid: Grid) -> Self {
        let (ledger, near) = (Ledger::new(grid.root()), Near::new(grid));
        Self { entries: Vec::new(), ledger, near, overflow: None, is_broken: false, turn: 0 }
    }

    /// Refines `queue`, which looks through the camera already, so that it makes `lines` right as far as they fit.
    pub(in crate::roam) fn satisfy<T: Terrain>(
        &mut self,
        queue: &mut DualQueue<T>,
        allowed: Allowance,
        lines: &[RequiredLine],
    ) -> Result<Outcome, ReadError> {
        if self.is_broken || queue.work.from_scratch {
            queue.release_all();
            *self = Self { turn: self.turn, ..Self::new(queue.grid()) };
        }
        self.is_broken = true;
        let terrain = Arc::clone(queue.terrain());
        let ground = Ground::new(&*terrain);
        self.turn += 1;
        self.take(queue, &ground, lines)?;
        let mut run = Run { queue, ground: &ground, allowed, state: self, is_strict: false, seen: 0 };
        run.run()?;
        debug_assert!(run.flags_are_true()?);
        let outcome = run.outcome();
        self.is_broken = false;
        Ok(outcome)
    }

    /// Takes the lines of this update, in order, with what is known of those that were there before.
    fn take<T: Terrain>(
        &mut self,
        queue: &DualQueue<T>,
        ground: &Ground<'_, T>,
        lines: &[RequiredLine],
    ) -> Result<(), ReadError> {
        let mut lines: Vec<_> = lines.iter().collect();
        if !lines.is_sorted_by_key(|line| line.place()) {
            lines.sort_by_key(|line| line.place());
        }
        let mut before = std::mem::take(&mut self.entries).into_iter().peekable();
        let mut anything_moved = false;
        for line in lines {
            while let Some(gone) = before.next_if(|entry| entry.line.place() < line.place()) {
                gone.own.iter().for_each(|&p| self.ledger.remove(p));
                anything_moved = true;
            }
            let known = before.next_if(|entry| entry.line.place() == line.place());
            if let Some(mut entry) = known {
                entry.is_fresh = false;
                if entry.line == *line {
                    self.entries.push(entry);
                    continue;
                }
                anything_moved = true;
                let rule = rule_of(queue, ground, line)?;
                let may_keep = rule.as_ref().is_some_and(|rule| entry.replace(*line, rule.clone()));
                if !may_keep {
                    entry.own.drain(..).for_each(|p| self.ledger.remove(p));
                }
                entry.is_fresh = !may_keep;
                self.entries.extend(rule.map(|_| entry));
            } else {
                anything_moved = true;
                self.entries.extend(rule_of(queue, ground, line)?.map(|rule| Entry::new(*line, rule)));
            }
        }
        for gone in before {
            gone.own.iter().for_each(|&p| self.ledger.remove(p));
            anything_moved = true;
        }
        if anything_moved {
            self.overflow = None;
            self.near.fill(self.entries.iter().map(|entry| &entry.line));
        }
        Ok(())
    }
}

fn rule_of<T: Terrain>(
    queue: &DualQueue<T>,
    ground: &Ground<'_, T>,
    line: &RequiredLine,
) -> Result<Option<Rule>, ReadError> {
    Rule::of(line, |distance_m| Aim::of(ground, queue.scale(), line, distance_m))
}

impl<T: Terrain> Run<'_, '_, T> {
    fn run(&mut self) -> Result<(), ReadError> {
        self.serve_again();
        self.make_room(0);
        self.apply()?;
        self.settle()?;
        if self.choose_again()? {
            self.apply()?;
            self.settle()?;
        }
        Ok(())
    }

    /// Tells the queue what is required, lets it refine, and checks the lines that this may have changed.
    fn apply(&mut self) -> Result<(), ReadError> {
        let touched = self.state.ledger.take_touched();
        let (joined, left): (Vec<Post>, Vec<Post>) = touched.into_iter().partition(|&p| self.state.ledger.contains(p));
        self.queue.release(&left);
        self.queue.require(&joined)?;
        self.queue.refine(self.allowed)?;
        self.check_changed()
    }

    /// Checks the lines that changed, or near which the mesh did since they were last checked.
    fn check_changed(&mut self) -> Result<(), ReadError> {
        let mut changed = self.queue.toggles()[self.seen..].to_vec();
        self.seen = self.queue.toggles().len();
        changed.sort_unstable();
        let changed: Vec<_> = changed.chunk_by(|p, q| p == q).filter(|c| c.len() % 2 == 1).map(|c| c[0]).collect();
        let entries = &mut self.state.entries;
        let mut met: Vec<(u32, Post)> = Vec::new();
        for &p in &changed {
            self.state.near.for_each(p, |n| {
                let entry = &entries[n as usize];
                if !entry.is_new && may_touch(&entry.line, p) {
                    met.push((n, p));
                }
            });
        }
        for entry in entries.iter_mut().filter(|entry| entry.is_new) {
            entry.check(self.queue)?;
        }
        met.sort_unstable();
        met.dedup();
        let mut posts = Vec::new();
        for of_line in met.chunk_by(|x, y| x.0 == y.0) {
            posts.clear();
            posts.extend(of_line.iter().map(|&(_, p)| p));
            entries[of_line[0].0 as usize].check_near(self.queue, &posts)?;
        }
        Ok(())
    }

    /// Makes all lines hold that are served.
    fn settle(&mut self) -> Result<(), ReadError> {
        if !self.is_strict && (!self.needed_only(MAX_ROUNDS)? || self.names_what_must_fit()?) {
            self.start_over();
            self.apply()?;
        }
        if self.is_strict {
            // Ends without a limit: each round requires a post more, or drops a line.
            self.needed_only(usize::MAX)?;
        }
        Ok(())
    }

    /// Requires nothing, and holds lines to their stable sets from here on in this update.
    fn start_over(&mut self) {
        self.queue.release_all();
        self.state.ledger = Ledger::new(self.ground.grid().root());
        self.is_strict = true;
        for entry in &mut self.state.entries {
            entry.own.clear();
            entry.is_fresh = true;
            if entry.standing == Standing::Dropped {
                entry.standing = Standing::Served;
            }
        }
    }

    /// Adds what lines need, round by round, until those served all hold: `true`. `false` when that takes more than
    /// `rounds`.
    fn needed_only(&mut self, rounds: usize) -> Result<bool, ReadError> {
        for _ in 0..rounds {
            let mut is_done = true;
            for n in 0..self.state.entries.len() {
                let entry = &self.state.entries[n];
                if entry.holds || entry.standing != Standing::Served {
                    continue;
                }
                is_done = false;
                self.help(n)?;
                self.make_room(n);
            }
            if is_done {
                return Ok(true);
            }
            self.apply()?;
        }
        Ok(false)
    }

    /// Gives a failing line what it needs.
    fn help(&mut self, n: usize) -> Result<(), ReadError> {
        let posts = self.needs(n, &PostSet::default())?;
        let Requirements { entries, ledger, .. } = &mut *self.state;
        let entry = &mut entries[n];
        if posts.is_empty() && ledger.touched().is_empty() {
            (entry.standing, entry.lacked) = (Standing::Hopeless, 0);
        }
        posts.iter().for_each(|&p| ledger.add(p));
        entry.own.extend(posts);
        entry.is_fresh = true;
        Ok(())
    }

    /// What a line needs on the mesh with all that is required, `less` left out.
    fn needs(&mut self, n: usize, less: &PostSet) -> Result<Vec<Post>, ReadError> {
        let (ground, is_strict) = (self.ground, self.is_strict);
        let Requirements { entries, ledger, .. } = &mut *self.state;
        let entry = &mut entries[n];
        if is_strict {
            entry.find_steadiest(ground)?;
        }
        let Entry { line, rule, witnesses, steadiest, .. } = entry;
        let witness = steadiest.as_ref().filter(|_| is_strict);
        Draft::new(self.queue, ground, ledger, less).needs(line, rule, witness, || find(ground, line, witnesses))
    }

    /// Lets lines choose anew, as if they owned nothing; whether any did.
    fn choose_again(&mut self) -> Result<bool, ReadError> {
        let turn = self.state.turn;
        let is_due = |n: usize, entry: &Entry| {
            !entry.own.is_empty() && (entry.is_fresh || (n as u64 + turn).is_multiple_of(TURNS))
        };
        let due: Vec<_> = (0..self.state.entries.len()).filter(|&n| is_due(n, &self.state.entries[n])).collect();
        if due.is_empty() {
            return Ok(false);
        }
        let stays = self.queue.comes_before_the_cut(self.allowed.threshold);
        let mut less = PostSet::default();
        for &n in &due {
            let Requirements { entries, ledger, .. } = &mut *self.state;
            let mark = ledger.touched().len();
            let before = std::mem::take(&mut entries[n].own);
            let triangles = ledger.triangles();
            before.iter().for_each(|&p| ledger.remove(p));
            let gone = ledger.touched()[mark..].iter().filter(|&&p| !stays(self.queue, p));
            less.extend(gone.map(|p| (p.key(), ())));
            let mut own = self.needs(n, &less)?;
            let Requirements { entries, ledger, .. } = &mut *self.state;
            own.iter().for_each(|&p| ledger.add(p));
            if ledger.triangles() > triangles {
                own.iter().for_each(|&p| ledger.remove(p));
                before.iter().for_each(|&p| ledger.add(p));
                own = before;
            }
            entries[n].own = own;
        }
        Ok(true)
    }

    /// Whether each flag is what an exact check says; for debug builds.
    fn flags_are_true(&self) -> Result<bool, ReadError> {
        for entry in &self.state.entries {
            if entry.holds != entry.rule.holds(self.queue, &entry.line)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn outcome(&self) -> Outcome {
        let failing = self.state.entries.iter().filter(|entry| !entry.holds);
        let (grounds, failing): (Vec<_>, Vec<_>) = failing.partition(|entry| entry.line.fidelity == Fidelity::Ground);
        let mut off_ground: Vec<_> = grounds.into_iter().map(|entry| entry.line.id).collect();
        off_ground.sort_unstable();
        let narrow = |triangles: u64| u32::try_from(triangles).unwrap_or(u32::MAX);
        let mut unsatisfied: Vec<_> = failing.into_iter().map(|e| (e.line.id, narrow(e.lacked))).collect();
        unsatisfied.sort_unstable();
        Outcome { unsatisfied, off_ground, required: narrow(self.state.ledger.triangles() - 2) }
    }
}
