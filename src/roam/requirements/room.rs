//! Short budgets: who makes room for whom, who is tried again when, and who may be named.
//!
//! Lines keep what they own while they move, so a full budget costs no more than a large one; but then what they own is
//! not part of their stable sets, which is what [`super::engine`]'s guarantee stands on. So before a line is named, it is
//! made sure that it may be: that the joint stable set of the lines up to it does not fit. Stable sets are several times
//! what lines need, so this is known after the first few of many; only if it is not do lines start over.

use super::{
    engine::{Run, TURNS},
    entry::Standing,
    ledger::Ledger,
    rule::Rule,
    stable::{part_of_clear_set, way_set, witness_set},
};
use crate::{roam::Terrain, terrain::ReadError};

/// Dropped lines that moved and are served again at once, the first in order; others wait for their turn.
const MAX_MOVED: usize = 8;

/// That the joint stable set of the first lines in order overflows a budget.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Overflow {
    /// The budget.
    max: u32,
    /// How many lines.
    lines: usize,
}

impl<T: Terrain> Run<'_, '_, T> {
    pub(super) fn fits(&self) -> bool {
        self.state.ledger.triangles() <= u64::from(self.allowed.max)
    }

    /// Serves dropped lines again: those whose turn it is, those that may fit, and the first few that moved.
    pub(super) fn serve_again(&mut self) {
        let room = u64::from(self.allowed.max).saturating_sub(self.state.ledger.triangles());
        let (turn, mut moved) = (self.state.turn, 0);
        for (n, entry) in (0_u64..).zip(&mut self.state.entries) {
            if entry.standing == Standing::Dropped {
                moved += usize::from(entry.is_new);
                let is_due = (n + turn).is_multiple_of(TURNS) || entry.lacked <= room;
                if is_due || (entry.is_new && moved <= MAX_MOVED) {
                    entry.standing = Standing::Served;
                }
            }
        }
    }

    /// Drops lines, the last in order first, until what is required fits; none before line `n`. Those that fit beside
    /// the others after all are let stay.
    pub(super) fn make_room(&mut self, n: usize) {
        let mut without = Vec::new();
        for last in (n..self.state.entries.len()).rev() {
            if self.fits() {
                break;
            }
            let (entry, ledger) = (&self.state.entries[last], &mut self.state.ledger);
            if !entry.own.is_empty() {
                entry.own.iter().for_each(|&p| ledger.remove(p));
                without.push(last);
            }
        }
        for &dropped in without.iter().rev() {
            let (entry, ledger) = (&mut self.state.entries[dropped], &mut self.state.ledger);
            let before = ledger.triangles();
            entry.own.iter().for_each(|&p| ledger.add(p));
            if ledger.triangles() > u64::from(self.allowed.max) {
                entry.lacked = ledger.triangles() - before;
                entry.own.drain(..).for_each(|p| ledger.remove(p));
                entry.standing = Standing::Dropped;
            }
        }
    }

    /// Whether a line is to be named of which it is not certain that those up to it have a joint stable set beyond the
    /// budget.
    pub(super) fn names_what_must_fit(&mut self) -> Result<bool, ReadError> {
        let Some(first) = self.state.entries.iter().position(|entry| entry.is_short()) else { return Ok(false) };
        Ok(!self.overflows(first + 1)?)
    }

    /// Whether the joint stable set of the first `count` lines is known to overflow the budget. Of what keeps anything
    /// from being wrong for a line, a part is looked at.
    fn overflows(&mut self, count: usize) -> Result<bool, ReadError> {
        let (ground, max) = (self.ground, self.allowed.max);
        if self.state.overflow.is_some_and(|found| found.max == max && found.lines <= count) {
            return Ok(true);
        }
        let mut joint = Ledger::new(ground.grid().root());
        for (n, entry) in self.state.entries[..count].iter().enumerate() {
            part_of_clear_set(ground, &entry.line, &entry.rule)?.into_iter().for_each(|p| joint.add(p));
            if joint.triangles() > u64::from(max) {
                self.state.overflow = Some(Overflow { max, lines: n + 1 });
                return Ok(true);
            }
        }
        for entry in &mut self.state.entries[..count] {
            let set = match &entry.rule {
                Rule::Obstruction(aim) => way_set(ground, &entry.line, &entry.rule, &aim.face)?,
                Rule::Blocked => {
                    entry.find_steadiest(ground)?;
                    let Some(witness) = &entry.steadiest else { continue };
                    witness_set(ground, &entry.line, witness)?
                }
                Rule::Clear | Rule::Wedgie | Rule::Profile | Rule::Ground => continue,
            };
            set.into_iter().for_each(|p| joint.add(p));
            if joint.triangles() > u64::from(max) {
                self.state.overflow = Some(Overflow { max, lines: count });
                return Ok(true);
            }
        }
        Ok(false)
    }
}
