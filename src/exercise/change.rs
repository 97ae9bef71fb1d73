//! The step from one epoch to the next: checked whole, then resolved, then answered; only lines whose ends moved are
//! answered again.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    sync::Arc,
};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    Anchor, EYE_LINE_ID, Entity, Exercise, GroundState, Lease, LineState, MAX_CHANGES, MAX_ENTITIES, MAX_SIGHT_LINES,
    NameError, PlaceError, SightLine, Site,
};
use crate::{
    los::{self, LosError, Verdict},
    roam::Fidelity,
    terrain::HeightField,
};

/// What is to change. Removals are done first; then entities, then sight lines are added or replaced.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Change {
    /// Entities to remove.
    pub remove_entities: Vec<u64>,
    /// Sight lines to remove.
    pub remove_sight_lines: Vec<u64>,
    /// Entities to add, move or replace.
    pub put_entities: Vec<Entity>,
    /// Sight lines to add or replace.
    pub put_sight_lines: Vec<SightLine>,
    /// What is put is under this lease from now on, or under none. A record of a change does without: nothing in a frame
    /// follows from it.
    #[serde(skip)]
    pub lease: Option<Lease>,
}

/// The kinds of things of an exercise.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Thing {
    /// An entity.
    Entity,
    /// A sight line.
    SightLine,
}

impl fmt::Display for Thing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Entity => "entity",
            Self::SightLine => "sight line",
        })
    }
}

/// Why a change was refused. The exercise is as it was.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum ChangeError {
    /// The removal of what is not there.
    #[error("there is no {thing} {id} to remove")]
    Missing {
        /// What.
        thing: Thing,
        /// Its id.
        id: u64,
    },
    /// An id twice in one list of the request.
    #[error("{thing} {id} is in one list of the change twice")]
    Duplicate {
        /// What.
        thing: Thing,
        /// Its id.
        id: u64,
    },
    /// The removal of an entity that a sight line follows.
    #[error("entity {entity} cannot be removed: sight line {line} follows it; remove that too")]
    Anchoring {
        /// The entity.
        entity: u64,
        /// The first such sight line.
        line: u64,
    },
    /// A sight line that follows an entity that is not there.
    #[error("sight line {line} follows entity {entity}, which does not exist")]
    UnknownEntity {
        /// The sight line.
        line: u64,
        /// The entity.
        entity: u64,
    },
    /// The id that is kept for the eye.
    #[error("no sight line may have id {EYE_LINE_ID}: frames use it for the viewer's eye")]
    ReservedId,
    /// An end of a sight line or an entity that cannot be resolved.
    #[error("{thing} {id}: {error}")]
    Place {
        /// What.
        thing: Thing,
        /// Its id.
        id: u64,
        /// Why.
        error: PlaceError,
    },
    /// More than a limit.
    #[error("{found} {what}: the limit is {limit}")]
    Limit {
        /// Of what.
        what: &'static str,
        /// The limit.
        limit: usize,
        /// How many there would be.
        found: usize,
    },
    /// The terrain could not answer a line.
    #[error("the verdict of sight line {line}: {error}")]
    Verdict {
        /// The sight line.
        line: u64,
        /// Why.
        error: LosError,
    },
}

/// Why what was kept of an exercise makes none.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum RestoreError {
    /// Its name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// An entity or a sight line.
    #[error(transparent)]
    Change(#[from] ChangeError),
}

impl Exercise {
    /// The exercise after `change`, one epoch on, with exact verdicts on `field`.
    pub fn changed(&self, change: &Change, site: &Site, field: &impl HeightField) -> Result<Self, ChangeError> {
        check_size(change)?;
        check_duplicates(change)?;
        let mut next = self.clone();
        next.epoch += 1;
        next.remove(change)?;
        let moved = next.put(change, site, field)?;
        next.check_anchors(change)?;
        limit("entities", MAX_ENTITIES, next.entities.len())?;
        next.answer(&moved, site, field)?;
        next.lease_out(change)?;
        Ok(next)
    }

    /// The exercise of a name at an epoch, from what was registered in it; ends and verdicts are computed anew.
    pub fn restored(
        name: &str,
        epoch: u64,
        entities: &[Entity],
        sight_lines: &[SightLine],
        site: &Site,
        field: &impl HeightField,
    ) -> Result<Self, RestoreError> {
        let mut exercise = Self::new(name)?;
        for entities in entities.chunks(MAX_CHANGES) {
            let change = Change { put_entities: entities.to_vec(), ..Change::default() };
            exercise = exercise.changed(&change, site, field)?;
        }
        for lines in sight_lines.chunks(MAX_CHANGES) {
            let change = Change { put_sight_lines: lines.to_vec(), ..Change::default() };
            exercise = exercise.changed(&change, site, field)?;
        }
        exercise.epoch = epoch;
        for line in exercise.lines.values_mut() {
            Arc::make_mut(line).since_epoch = epoch;
        }
        Ok(exercise)
    }

    fn remove(&mut self, change: &Change) -> Result<(), ChangeError> {
        for &id in &change.remove_sight_lines {
            let gone = self.lines.remove(&id);
            let gone = gone.ok_or(ChangeError::Missing { thing: Thing::SightLine, id })?;
            self.release(&gone.line);
            self.leases.put(Thing::SightLine, id, None);
        }
        for &id in &change.remove_entities {
            self.entities.remove(&id).ok_or(ChangeError::Missing { thing: Thing::Entity, id })?;
            self.grounds.remove(&id);
            self.leases.put(Thing::Entity, id, None);
        }
        Ok(())
    }

    /// Puts what was put under the lease of the change, or under none.
    fn lease_out(&mut self, change: &Change) -> Result<(), ChangeError> {
        let number = change.lease.as_ref().map(|lease| self.leases.grant(lease, self.epoch));
        for entity in &change.put_entities {
            self.leases.put(Thing::Entity, entity.id, number);
        }
        for line in &change.put_sight_lines {
            self.leases.put(Thing::SightLine, line.id, number);
        }
        self.leases.settle()
    }

    /// Puts entities and lines, and returns the lines whose ends have to be resolved again.
    fn put(
        &mut self,
        change: &Change,
        site: &Site,
        field: &impl HeightField,
    ) -> Result<BTreeMap<u64, SightLine>, ChangeError> {
        for entity in &change.put_entities {
            let (thing, id) = (Thing::Entity, entity.id);
            site.grid_from_place(field, &entity.place, 0.0).map_err(|error| ChangeError::Place { thing, id, error })?;
            self.entities.insert(id, *entity);
            let failed = |error| ChangeError::Place { thing, id, error };
            match site.ground_band(field, entity).map_err(failed)? {
                Some(band) => self.grounds.insert(id, GroundState { entity: id, band }),
                None => self.grounds.remove(&id),
            };
        }
        let mut moved = BTreeMap::new();
        for line in &change.put_sight_lines {
            if line.id == EYE_LINE_ID {
                return Err(ChangeError::ReservedId);
            }
            if let Some(before) = self.lines.get(&line.id).cloned() {
                self.release(&before.line);
            }
            self.anchored.extend(line.entities().map(|entity| (entity, line.id)));
            moved.insert(line.id, *line);
        }
        for entity in &change.put_entities {
            for &(_, id) in self.anchored.range((entity.id, 0)..=(entity.id, u64::MAX)) {
                if let Some(state) = self.lines.get(&id) {
                    moved.entry(id).or_insert(state.line);
                }
            }
        }
        Ok(moved)
    }

    pub(super) fn release(&mut self, line: &SightLine) {
        for entity in line.entities() {
            self.anchored.remove(&(entity, line.id));
        }
    }

    fn check_anchors(&self, change: &Change) -> Result<(), ChangeError> {
        for line in &change.put_sight_lines {
            if let Some(entity) = line.entities().find(|id| !self.entities.contains_key(id)) {
                return Err(ChangeError::UnknownEntity { line: line.id, entity });
            }
        }
        for &entity in change.remove_entities.iter().filter(|id| !self.entities.contains_key(id)) {
            if let Some(&(_, line)) = self.anchored.range((entity, 0)..=(entity, u64::MAX)).next() {
                return Err(ChangeError::Anchoring { entity, line });
            }
        }
        Ok(())
    }

    /// Resolves and answers `moved`, and keeps what came out as it was before.
    fn answer(
        &mut self,
        moved: &BTreeMap<u64, SightLine>,
        site: &Site,
        field: &impl HeightField,
    ) -> Result<(), ChangeError> {
        let added = moved.keys().filter(|id| !self.lines.contains_key(id)).count();
        limit("sight lines", MAX_SIGHT_LINES, self.lines.len() + added)?;
        let lines: Vec<_> = moved.values().collect();
        let this = &*self;
        let states: Vec<LineState> =
            lines.par_iter().map(|line| this.state(line, site, field)).collect::<Result<_, _>>()?;
        for state in states {
            self.lines.insert(state.line.id, Arc::new(state));
        }
        Ok(())
    }

    fn state(&self, line: &SightLine, site: &Site, field: &impl HeightField) -> Result<LineState, ChangeError> {
        let before = self.lines.get(&line.id);
        let (a, b) = (self.end(line, &line.a, site, field)?, self.end(line, &line.b, site, field)?);
        let resolved = a.zip(b).map(|(a, b)| [a, b]);
        let (thing, id) = (Thing::SightLine, line.id);
        let failed = |error| ChangeError::Place { thing, id, error };
        let active = resolved.map_or(Ok(true), |ends| site.is_active(line, ends)).map_err(failed)?;
        let known = before.filter(|before| same_bits(before.resolved, resolved) && before.active == active);
        let verdict = match (known, resolved) {
            (Some(before), _) => before.verdict,
            (None, None) => Verdict::Unknown,
            (None, Some(_)) if !active => Verdict::Unknown,
            (None, Some([a, b])) => {
                los::line_of_sight(field, a, b, los::Options::default())
                    .map_err(|error| ChangeError::Verdict { line: line.id, error })?
                    .verdict
            }
        };
        let failed = |error| ChangeError::Verdict { line: line.id, error };
        let first_obstruction = match (line.fidelity, resolved, verdict) {
            (Fidelity::Obstruction { .. }, Some([a, b]), Verdict::Blocked) => {
                los::known_obstruction(field, a, b).map_err(failed)?.map(|first| first.place.t)
            }
            _ => None,
        };
        let same = known
            .filter(|before| (before.line.fidelity, before.line.priority) == (line.fidelity, line.priority))
            .map(|before| before.since_epoch);
        let since_epoch = same.unwrap_or(self.epoch);
        Ok(LineState { line: *line, resolved, active, verdict, first_obstruction, since_epoch })
    }

    fn end(
        &self,
        line: &SightLine,
        anchor: &Anchor,
        site: &Site,
        field: &impl HeightField,
    ) -> Result<Option<[f64; 3]>, ChangeError> {
        let (place, offset_m) = match anchor {
            Anchor::Point(place) => (place, 0.0),
            Anchor::Entity { id, offset_m } => {
                let unknown = ChangeError::UnknownEntity { line: line.id, entity: *id };
                (&self.entities.get(id).ok_or(unknown)?.place, *offset_m)
            }
        };
        let (thing, id) = (Thing::SightLine, line.id);
        site.grid_from_place(field, place, offset_m).map_err(|error| ChangeError::Place { thing, id, error })
    }
}

fn same_bits(p: Option<[[f64; 3]; 2]>, q: Option<[[f64; 3]; 2]>) -> bool {
    p.map(|ends| ends.map(|end| end.map(f64::to_bits))) == q.map(|ends| ends.map(|end| end.map(f64::to_bits)))
}

fn check_size(change: &Change) -> Result<(), ChangeError> {
    let removals = change.remove_entities.len() + change.remove_sight_lines.len();
    limit("changes in one request", MAX_CHANGES, removals + change.put_entities.len() + change.put_sight_lines.len())
}

pub(super) fn limit(what: &'static str, limit: usize, found: usize) -> Result<(), ChangeError> {
    if found > limit { Err(ChangeError::Limit { what, limit, found }) } else { Ok(()) }
}

fn check_duplicates(change: &Change) -> Result<(), ChangeError> {
    let lists: [(Thing, &mut dyn Iterator<Item = u64>); 4] = [
        (Thing::Entity, &mut change.remove_entities.iter().copied()),
        (Thing::SightLine, &mut change.remove_sight_lines.iter().copied()),
        (Thing::Entity, &mut change.put_entities.iter().map(|entity| entity.id)),
        (Thing::SightLine, &mut change.put_sight_lines.iter().map(|line| line.id)),
    ];
    for (thing, ids) in lists {
        let mut seen = BTreeSet::new();
        for id in ids {
            if !seen.insert(id) {
                return Err(ChangeError::Duplicate { thing, id });
            }
        }
    }
    Ok(())
}
