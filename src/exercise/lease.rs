//! Leases: for how long what a client has put stays although nothing is heard of it.
//!
//! Here is only what belongs to whom, and what goes when a lease has run out. When that is, is told from outside: an
//! exercise has no clock. A lease has the number of the epoch that first granted it, which no other lease of the exercise
//! has, since a change grants one at most.

use std::{collections::BTreeMap, sync::Arc};

use thiserror::Error;

use super::{ChangeError, Exercise, MAX_NAME_LENGTH, Thing, change::limit, is_name};

/// Shortest and longest term in seconds.
pub const TERMS_S: std::ops::RangeInclusive<u32> = 1..=604_800;
/// Greatest number of leases of an exercise.
pub const MAX_LEASES: usize = 1_000;
/// Expirations that an exercise remembers.
pub const MAX_EXPIRATIONS: usize = 16;

/// What a change, or the making of an exercise, is under.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Lease {
    owner: Arc<str>,
    term_s: u32,
}

/// Why something is no lease.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum LeaseError {
    /// The owner's name.
    #[error("'{0}' cannot own a lease: 1 to {MAX_NAME_LENGTH} letters, digits, '-', '_' or '.'")]
    Owner(
        /// The beginning of the name.
        String,
    ),
    /// The term.
    #[error("a lease of {0} s: it must be from {least} to {most}", least = TERMS_S.start(), most = TERMS_S.end())]
    Term(
        /// The term in seconds.
        u32,
    ),
}

impl Lease {
    /// The lease of an owner with a term in seconds.
    pub fn new(owner: &str, term_s: u32) -> Result<Self, LeaseError> {
        if !is_name(owner) {
            return Err(LeaseError::Owner(owner.chars().take(MAX_NAME_LENGTH).collect()));
        }
        if !TERMS_S.contains(&term_s) {
            return Err(LeaseError::Term(term_s));
        }
        Ok(Self { owner: owner.into(), term_s })
    }

    /// Whose it is.
    pub fn owner(&self) -> &Arc<str> {
        &self.owner
    }

    /// How long it lasts, in seconds.
    pub fn term_s(&self) -> u32 {
        self.term_s
    }
}

/// A lease of an exercise.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Granted {
    /// Owner and term.
    pub lease: Lease,
    /// Whether the exercise itself is under it.
    pub holds_exercise: bool,
    /// Entities under it.
    pub entities: u32,
    /// Sight lines under it.
    pub sight_lines: u32,
}

/// A lease that ran out.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Expiration {
    /// The epoch that it made.
    pub epoch: u64,
    /// Whose lease it was.
    pub owner: Arc<str>,
}

/// The leases of an exercise, and what is under them. None is without anything.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(super) struct Leases {
    granted: BTreeMap<u64, Granted>,
    /// Numbers of the leases of things that are under one.
    entities: BTreeMap<u64, u64>,
    sight_lines: BTreeMap<u64, u64>,
}

impl Leases {
    fn numbers(&mut self, thing: Thing) -> &mut BTreeMap<u64, u64> {
        match thing {
            Thing::Entity => &mut self.entities,
            Thing::SightLine => &mut self.sight_lines,
        }
    }

    fn number(&self, owner: &str) -> Option<u64> {
        self.granted.iter().find(|(_, granted)| &*granted.lease.owner == owner).map(|(number, _)| *number)
    }

    fn count(&mut self, thing: Thing, number: u64, by: i32) {
        if let Some(granted) = self.granted.get_mut(&number) {
            let count = match thing {
                Thing::Entity => &mut granted.entities,
                Thing::SightLine => &mut granted.sight_lines,
            };
            *count = count.saturating_add_signed(by);
        }
    }

    /// Gives the owner's lease its new term, or grants it with the number `epoch`; returns its number.
    pub(super) fn grant(&mut self, lease: &Lease, epoch: u64) -> u64 {
        let number = self.number(&lease.owner).unwrap_or(epoch);
        let new = || Granted { lease: lease.clone(), holds_exercise: false, entities: 0, sight_lines: 0 };
        self.granted.entry(number).or_insert_with(new).lease.term_s = lease.term_s;
        number
    }

    /// Puts a thing under a lease, or under none.
    pub(super) fn put(&mut self, thing: Thing, id: u64, number: Option<u64>) {
        let before = match number {
            Some(number) => self.numbers(thing).insert(id, number),
            None => self.numbers(thing).remove(&id),
        };
        for (number, by) in before.map(|before| (before, -1)).into_iter().chain(number.map(|number| (number, 1))) {
            self.count(thing, number, by);
        }
    }

    /// Forgets leases that nothing is under.
    pub(super) fn settle(&mut self) -> Result<(), ChangeError> {
        self.granted.retain(|_, granted| granted.holds_exercise || granted.entities + granted.sight_lines > 0);
        limit("leases", MAX_LEASES, self.granted.len())
    }
}

/// A lease as it is kept: its number, owner and term, and whether it holds the exercise.
pub type KeptLease = (u64, Lease, bool);

impl Exercise {
    /// The exercise under a lease, as soon as it is made.
    pub fn under(mut self, lease: &Lease) -> Self {
        let number = self.leases.grant(lease, self.epoch);
        self.leases.granted.entry(number).and_modify(|granted| granted.holds_exercise = true);
        self
    }

    /// Its leases by number, in the order in which they were granted.
    pub fn leases(&self) -> impl ExactSizeIterator<Item = (u64, &Granted)> {
        self.leases.granted.iter().map(|(number, granted)| (*number, granted))
    }

    /// The lease of an owner.
    pub fn lease(&self, owner: &str) -> Option<&Granted> {
        self.leases.number(owner).and_then(|number| self.leases.granted.get(&number))
    }

    /// The things of a kind that are under a lease, by id, and the numbers of their leases.
    pub fn leased(&self, thing: Thing) -> impl Iterator<Item = (u64, u64)> {
        let numbers = match thing {
            Thing::Entity => &self.leases.entities,
            Thing::SightLine => &self.leases.sight_lines,
        };
        numbers.iter().map(|(id, number)| (*id, *number))
    }

    /// The leases that ran out last, oldest first, at most [`MAX_EXPIRATIONS`].
    pub fn expirations(&self) -> &[Expiration] {
        &self.expirations
    }

    /// The exercise with leases as they were kept, and what was under them. Things that are not there are passed over;
    /// `None` when a thing is under a lease that is not.
    pub fn with_leases(
        mut self,
        leases: impl IntoIterator<Item = KeptLease>,
        entities: impl IntoIterator<Item = (u64, u64)>,
        sight_lines: impl IntoIterator<Item = (u64, u64)>,
    ) -> Option<Self> {
        for (number, lease, holds_exercise) in leases {
            let granted = Granted { lease, holds_exercise, entities: 0, sight_lines: 0 };
            self.leases.granted.insert(number, granted);
        }
        let things = entities.into_iter().map(|(id, number)| (Thing::Entity, id, number));
        for (thing, id, number) in things.chain(sight_lines.into_iter().map(|(id, n)| (Thing::SightLine, id, n))) {
            if !self.leases.granted.contains_key(&number) {
                return None;
            }
            let is_there = match thing {
                Thing::Entity => self.entities.contains_key(&id),
                Thing::SightLine => self.lines.contains_key(&id),
            };
            if is_there {
                self.leases.put(thing, id, Some(number));
            }
        }
        self.leases.settle().ok()?;
        Some(self)
    }

    /// The exercise without these things, one epoch on. No sight line that stays follows an entity that goes. Ids that are
    /// not there, or there twice, are no matter.
    pub fn without(&self, entities: &[u64], sight_lines: &[u64]) -> Self {
        let mut next = self.clone();
        next.epoch += 1;
        for &id in sight_lines {
            if let Some(gone) = next.lines.remove(&id) {
                next.release(&gone.line);
                next.leases.put(Thing::SightLine, id, None);
            }
        }
        for &id in entities {
            next.entities.remove(&id);
            next.grounds.remove(&id);
            next.leases.put(Thing::Entity, id, None);
        }
        next
    }

    /// The ids of the entities and of the sight lines that are here and not in `later`.
    pub fn lost_in(&self, later: &Self) -> (Vec<u64>, Vec<u64>) {
        let entities = self.entities.keys().filter(|id| !later.entities.contains_key(id));
        let sight_lines = self.lines.keys().filter(|id| !later.lines.contains_key(id));
        (entities.copied().collect(), sight_lines.copied().collect())
    }

    /// The exercise without what was under the lease of `owner`, one epoch on: its sight lines, its entities, and the sight
    /// lines of others that follow these. `None` when the owner has no lease.
    pub fn expired(&self, owner: &str) -> Option<Self> {
        let number = self.leases.number(owner)?;
        let under = |things: &BTreeMap<u64, u64>| -> Vec<u64> {
            things.iter().filter(|(_, of)| **of == number).map(|(id, _)| *id).collect()
        };
        let (entities, mut lines) = (under(&self.leases.entities), under(&self.leases.sight_lines));
        for &entity in &entities {
            lines.extend(self.anchored.range((entity, 0)..=(entity, u64::MAX)).map(|(_, line)| *line));
        }
        let mut next = self.without(&entities, &lines);
        next.leases.granted.remove(&number);
        next.leases.settle().ok()?;
        let forgotten = (next.expirations.len() + 1).saturating_sub(MAX_EXPIRATIONS);
        next.expirations.drain(..forgotten);
        next.expirations.push(Expiration { epoch: next.epoch, owner: owner.into() });
        Some(next)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::{
        exercise::{Altitude, Anchor, Change, Entity, Frame, Place, SightLine, Site},
        roam::Fidelity,
        terrain::{SceneScale, synthetic},
    };

    const SITE: Site = Site { scale: SceneScale { east_m: 10.0, north_m: 10.0, up_m: 1.0 }, georeference: None };

    fn entity(id: u64) -> Entity {
        let position = [3.0 + id as f64, 7.0, 2.0];
        Entity { id, place: Place { position, frame: Frame::Grid, altitude: Altitude::AboveGround }, ground_m: None }
    }

    fn line(id: u64, a: u64, b: u64) -> SightLine {
        let end = |id| Anchor::Entity { id, offset_m: 1.0 };
        SightLine { id, a: end(a), b: end(b), fidelity: Fidelity::Verdict, priority: 0, range_m: None, region: None }
    }

    fn ids(exercise: &Exercise) -> (BTreeSet<u64>, BTreeSet<u64>) {
        (exercise.entities().map(|e| e.id).collect(), exercise.sight_lines().map(|l| l.line.id).collect())
    }

    #[test]
    fn owners_and_terms_that_make_no_sense_are_refused() {
        let lease = Lease::new("host-1.a_B", 604_800).unwrap();
        assert_eq!((&**lease.owner(), lease.term_s()), ("host-1.a_B", 604_800));
        assert_eq!(Lease::new("", 5), Err(LeaseError::Owner(String::new())));
        assert!(matches!(Lease::new(&"a b".repeat(40), 5), Err(LeaseError::Owner(start)) if start.len() == 64));
        for term_s in [0, 604_801] {
            assert_eq!(Lease::new("a", term_s), Err(LeaseError::Term(term_s)));
        }
    }

    /// Random changes of three owners and of nobody, beside a list of who put what last.
    #[test]
    fn what_was_put_last_under_a_lease_goes_with_it_and_nothing_else() {
        let field = synthetic::fractal(40, 20, 5, 100).unwrap();
        let mut exercise = Exercise::new("test").unwrap();
        let mut whose: BTreeMap<(u64, u64), &str> = BTreeMap::new();
        let mut expired = 0;
        for n in 0..400_u64 {
            let draw = |k: u64, of: u64| synthetic::mix(1_000 * n + k) % of;
            let owner = ["a", "b", "c", ""][draw(0, 4) as usize];
            if draw(1, 8) == 0 {
                let gone: BTreeSet<_> = whose.iter().filter(|(_, o)| **o == owner).map(|(thing, _)| *thing).collect();
                let before = ids(&exercise);
                let lines: BTreeSet<u64> = exercise
                    .sight_lines()
                    .filter(|l| gone.contains(&(1, l.line.id)) || l.line.entities().any(|e| gone.contains(&(0, e))))
                    .map(|l| l.line.id)
                    .collect();
                let Some(after) = exercise.expired(owner) else {
                    assert!(owner.is_empty() || gone.is_empty(), "step {n}: '{owner}' has things, but no lease");
                    continue;
                };
                assert_eq!(after.epoch(), exercise.epoch() + 1);
                let left = |kind: u64, all: &BTreeSet<u64>, lines: &BTreeSet<u64>| -> BTreeSet<u64> {
                    all.iter().copied().filter(|id| !gone.contains(&(kind, *id)) && !lines.contains(id)).collect()
                };
                assert_eq!(ids(&after), (left(0, &before.0, &BTreeSet::new()), left(1, &before.1, &lines)), "step {n}");
                let last = after.expirations().last().unwrap();
                assert_eq!((last.epoch, &*last.owner), (after.epoch(), owner));
                whose.retain(|thing, _| !(gone.contains(thing) || thing.0 == 1 && lines.contains(&thing.1)));
                exercise = after;
                expired += 1;
            } else {
                let mut entities: Vec<_> = (0..3).map(|k| draw(10 + k, 20)).collect();
                entities.sort_unstable();
                entities.dedup();
                let ends = [entities[0], *entities.last().unwrap()];
                let id = 100 + draw(20, 20);
                let change = Change {
                    remove_sight_lines: exercise.sight_lines().map(|l| l.line.id).filter(|l| l % 5 == n % 5).collect(),
                    put_entities: entities.iter().copied().map(entity).collect(),
                    put_sight_lines: vec![line(id, ends[0], ends[1])],
                    lease: (!owner.is_empty()).then(|| Lease::new(owner, 1 + n as u32).unwrap()),
                    ..Change::default()
                };
                exercise = exercise.changed(&change, &SITE, &field).unwrap();
                whose.retain(|thing, _| !(thing.0 == 1 && thing.1 % 5 == n % 5));
                whose.extend(entities.into_iter().map(|id| ((0, id), owner)).chain([((1, id), owner)]));
                if !owner.is_empty() {
                    assert_eq!(exercise.lease(owner).unwrap().lease.term_s(), 1 + n as u32);
                }
            }
            for (_, granted) in exercise.leases() {
                let count = |kind| whose.iter().filter(|(t, o)| t.0 == kind && ***o == *granted.lease.owner).count();
                assert_eq!((granted.entities as usize, granted.sight_lines as usize), (count(0), count(1)), "step {n}");
                assert!(count(0) + count(1) > 0, "step {n}: nothing is under the lease of {}", granted.lease.owner);
            }
            // What is kept makes the same leases.
            let kept = exercise.leases().map(|(number, granted)| (number, granted.lease.clone(), false));
            let bare = Exercise { leases: Leases::default(), ..exercise.clone() };
            let things = [Thing::Entity, Thing::SightLine].map(|thing| exercise.leased(thing).collect::<Vec<_>>());
            let [entities, lines] = things;
            assert_eq!(bare.with_leases(kept.collect::<Vec<_>>(), entities, lines).unwrap(), exercise);
        }
        assert!(expired > 20, "{expired}");
        assert_eq!(exercise.expirations().len(), MAX_EXPIRATIONS);
    }

    #[test]
    fn a_lease_may_hold_the_exercise_and_stays_without_things() {
        let lease = Lease::new("page", 60).unwrap();
        let exercise = Exercise::new("test").unwrap().under(&lease);
        let held: Vec<_> = exercise.leases().map(|(number, granted)| (number, granted.holds_exercise)).collect();
        assert_eq!(held, [(0, true)]);
        let field = synthetic::fractal(40, 20, 5, 100).unwrap();
        let change = Change { put_entities: vec![entity(1)], lease: Some(lease), ..Change::default() };
        let put = exercise.changed(&change, &SITE, &field).unwrap();
        let removed = put.changed(&Change { remove_entities: vec![1], ..Change::default() }, &SITE, &field).unwrap();
        assert!(removed.lease("page").is_some_and(|granted| granted.holds_exercise && granted.entities == 0));
    }
}
