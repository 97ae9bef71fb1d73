//! Exercises: entities, sight lines and epochs. A state machine without I/O.
//!
//! An [`Exercise`] is a value. [`Exercise::changed`] makes the next one from a [`Change`], whole or not at all: one
//! accepted change is one epoch. A sight line carries its resolved ends and the exact verdict on the finest terrain, and
//! the epoch since which it has them, so that whoever knows an earlier epoch can tell what is new.

mod change;
mod lease;
mod place;
#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use change::{Change, ChangeError, RestoreError, Thing};
pub use lease::{Expiration, Granted, KeptLease, Lease, LeaseError, MAX_EXPIRATIONS, MAX_LEASES, TERMS_S};
pub use place::{Altitude, Frame, Place, PlaceError, Site};
pub use sightline_proto::EYE_LINE_ID;

use crate::{los::Verdict, roam::Fidelity};

/// Greatest length of an exercise's name.
pub const MAX_NAME_LENGTH: usize = 64;
/// Greatest number of entities of an exercise.
pub const MAX_ENTITIES: usize = 100_000;
/// Greatest number of sight lines of an exercise.
pub const MAX_SIGHT_LINES: usize = 20_000;
/// Greatest number of removals and additions of one change.
pub const MAX_CHANGES: usize = 50_000;

/// A thing that has a place and may move.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Entity {
    /// Unique among the entities of the exercise.
    pub id: u64,
    /// Where it is.
    pub place: Place,
    /// Each mesh is to be within so many metres of the finest surface at its place; above 0 and finite.
    pub ground_m: Option<f64>,
}

/// One end of a registered sight line.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub enum Anchor {
    /// It follows an entity.
    Entity {
        /// The entity.
        id: u64,
        /// Height of the end above the entity, in metres.
        offset_m: f64,
    },
    /// It stays where it is.
    Point(Place),
}

/// A sight line as it was registered.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct SightLine {
    /// Unique among the sight lines of the exercise; not [`EYE_LINE_ID`].
    pub id: u64,
    /// The observer's end.
    pub a: Anchor,
    /// The target's end.
    pub b: Anchor,
    /// What the line asks of each mesh.
    pub fidelity: Fidelity,
    /// Lines are satisfied in order of priority, least first, then id.
    pub priority: u32,
    /// Beyond this length in the scene frame, in metres, the line is inactive. Not negative.
    pub range_m: Option<f64>,
    /// With an end outside, the line is inactive, too.
    pub region: Option<Disc>,
}

impl SightLine {
    /// The entities that the line follows.
    pub fn entities(&self) -> impl Iterator<Item = u64> + use<> {
        [self.a, self.b].into_iter().filter_map(|anchor| match anchor {
            Anchor::Entity { id, .. } => Some(id),
            Anchor::Point(_) => None,
        })
    }
}

/// A disc in plan.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Disc {
    /// East and north of its middle in `frame`.
    pub centre: [f64; 2],
    /// The frame.
    pub frame: Frame,
    /// Its radius in metres in the scene frame: finite and not negative.
    pub radius_m: f64,
}

/// What an entity asks of each mesh at one epoch.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct GroundState {
    /// The entity.
    pub entity: u64,
    /// The points between which the mesh must pass, in the grid frame: upper, lower.
    pub band: [[f64; 3]; 2],
}

/// A sight line as it stands at one epoch.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LineState {
    /// As it was registered.
    pub line: SightLine,
    /// Its ends in the grid frame; `None` when an end has no ground below it.
    pub resolved: Option<[[f64; 3]; 2]>,
    /// Whether the line is within its range and region.
    pub active: bool,
    /// The exact verdict on the finest terrain. UNKNOWN where there are no ends, and of an inactive line.
    pub verdict: Verdict,
    /// Of fidelity OBSTRUCTION and a blocked line that passes no unknown point before: where it is first obstructed, from
    /// A, as a part of AB, rounded.
    pub first_obstruction: Option<f64>,
    /// The epoch since which ends, verdict, fidelity, priority and activity are these.
    pub since_epoch: u64,
}

/// Why a name is not an exercise's.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
#[error("'{0}' cannot name an exercise: 1 to {MAX_NAME_LENGTH} letters, digits, '-', '_' or '.'")]
pub struct NameError(
    /// The beginning of the name.
    pub String,
);

/// One running simulation at one epoch.
#[derive(Clone, PartialEq, Debug)]
pub struct Exercise {
    name: String,
    epoch: u64,
    entities: BTreeMap<u64, Entity>,
    lines: BTreeMap<u64, Arc<LineState>>,
    /// Of the entities that ask for ground and have any.
    grounds: BTreeMap<u64, GroundState>,
    /// (entity, sight line) for each end that follows an entity.
    anchored: BTreeSet<(u64, u64)>,
    leases: lease::Leases,
    expirations: Vec<Expiration>,
}

fn is_name(name: &str) -> bool {
    let letter = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    !name.is_empty() && name.len() <= MAX_NAME_LENGTH && name.chars().all(letter)
}

impl Exercise {
    /// An exercise with nothing in it, at epoch 0.
    pub fn new(name: &str) -> Result<Self, NameError> {
        if !is_name(name) {
            return Err(NameError(name.chars().take(MAX_NAME_LENGTH).collect()));
        }
        Ok(Self {
            name: name.to_owned(),
            epoch: 0,
            entities: BTreeMap::new(),
            lines: BTreeMap::new(),
            grounds: BTreeMap::new(),
            anchored: BTreeSet::new(),
            leases: lease::Leases::default(),
            expirations: Vec::new(),
        })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How many changes it has accepted.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Its entities, by id.
    pub fn entities(&self) -> impl ExactSizeIterator<Item = &Entity> {
        self.entities.values()
    }

    /// Its sight lines at this epoch, by id.
    pub fn sight_lines(&self) -> impl ExactSizeIterator<Item = &LineState> {
        self.lines.values().map(|line| &**line)
    }

    /// What entities ask of each mesh, by entity.
    pub fn grounds(&self) -> impl ExactSizeIterator<Item = &GroundState> {
        self.grounds.values()
    }

    /// One sight line.
    pub fn sight_line(&self, id: u64) -> Option<&LineState> {
        self.lines.get(&id).map(|line| &**line)
    }
}
