//! Where exercises are kept: one narrow interface, and the implementations that keep them in memory and in a file.
//!
//! What is stored is an exercise by its name with a revision; it is replaced only by someone who knows the revision, so
//! that many servers could share a store. Nothing here knows how an exercise changes.

mod disk;
mod rows;

use std::{
    collections::BTreeMap,
    sync::{Arc, PoisonError, RwLock},
};

use thiserror::Error;

pub use disk::DiskStore;

use crate::exercise::Exercise;

/// Greatest number of exercises of a store.
pub const MAX_EXERCISES: usize = 1_000;

/// An exercise as it is stored.
#[derive(Clone, Debug)]
pub struct Stored {
    /// Differs between any two things ever stored under the name.
    pub revision: u64,
    /// The revision at which the exercise was made: tells it from an earlier one of the same name.
    pub created: u64,
    /// The exercise.
    pub exercise: Arc<Exercise>,
}

/// Why a store refused.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum StoreError {
    /// The name is taken.
    #[error("exercise '{0}' exists")]
    Exists(String),
    /// There is no exercise of that name.
    #[error("there is no exercise '{0}'")]
    NotFound(String),
    /// Someone else replaced it in between: read it again.
    #[error("exercise '{0}' changed in between")]
    Conflict(String),
    /// There are too many.
    #[error("the store holds {MAX_EXERCISES} exercises, which is the limit; delete one")]
    Full,
    /// What lies under the store could not be written or read; nothing has changed.
    #[error("the store of exercises: {0}")]
    Failed(String),
}

/// Keeps exercises.
pub trait ExerciseStore: Send + Sync {
    /// Stores a new exercise under its name.
    fn create(&self, exercise: Exercise) -> Result<Stored, StoreError>;

    /// All exercises, by name.
    fn list(&self) -> Result<Vec<Stored>, StoreError>;

    /// The exercise of a name.
    fn get(&self, name: &str) -> Result<Stored, StoreError>;

    /// Stores `exercise` in the place of the one with `revision`.
    fn replace(&self, revision: u64, exercise: Exercise) -> Result<Stored, StoreError>;

    /// Forgets an exercise.
    fn delete(&self, name: &str) -> Result<(), StoreError>;

    /// Whether it could be written now.
    fn probe(&self) -> Result<(), StoreError> {
        Ok(())
    }
}

/// Keeps exercises in memory: they end with the process.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: RwLock<State>,
}

#[derive(Debug, Default)]
struct State {
    last_revision: u64,
    exercises: BTreeMap<String, Stored>,
}

impl MemoryStore {
    // A panic while the lock is held leaves the state whole: each change of it is one insertion or removal.
    fn read(&self) -> std::sync::RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> std::sync::RwLockWriteGuard<'_, State> {
        self.state.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Whether another exercise could have that name.
    fn room_for(&self, name: &str) -> Result<(), StoreError> {
        if self.exercises.contains_key(name) {
            Err(StoreError::Exists(name.to_owned()))
        } else if self.exercises.len() >= MAX_EXERCISES {
            Err(StoreError::Full)
        } else {
            Ok(())
        }
    }

    fn put(&mut self, exercise: Exercise, created: Option<u64>) -> Stored {
        self.last_revision += 1;
        let (revision, name) = (self.last_revision, exercise.name().to_owned());
        let stored = Stored { revision, created: created.unwrap_or(revision), exercise: Arc::new(exercise) };
        self.exercises.insert(name, stored.clone());
        stored
    }
}

impl ExerciseStore for MemoryStore {
    fn create(&self, exercise: Exercise) -> Result<Stored, StoreError> {
        let mut state = self.write();
        state.room_for(exercise.name())?;
        Ok(state.put(exercise, None))
    }

    fn list(&self) -> Result<Vec<Stored>, StoreError> {
        Ok(self.read().exercises.values().cloned().collect())
    }

    fn get(&self, name: &str) -> Result<Stored, StoreError> {
        self.read().exercises.get(name).cloned().ok_or_else(|| StoreError::NotFound(name.to_owned()))
    }

    fn replace(&self, revision: u64, exercise: Exercise) -> Result<Stored, StoreError> {
        let mut state = self.write();
        let name = exercise.name();
        let before = state.exercises.get(name).ok_or_else(|| StoreError::NotFound(name.to_owned()))?;
        if before.revision != revision {
            return Err(StoreError::Conflict(name.to_owned()));
        }
        let created = Some(before.created);
        Ok(state.put(exercise, created))
    }

    fn delete(&self, name: &str) -> Result<(), StoreError> {
        let gone = self.write().exercises.remove(name);
        gone.map(|_| ()).ok_or_else(|| StoreError::NotFound(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_known_revision_is_replaced() {
        let store = MemoryStore::default();
        let first = store.create(Exercise::new("one").unwrap()).unwrap();
        assert_eq!(store.create(Exercise::new("one").unwrap()).unwrap_err(), StoreError::Exists("one".into()));
        let second = store.replace(first.revision, Exercise::new("one").unwrap()).unwrap();
        let stale = store.replace(first.revision, Exercise::new("one").unwrap());
        assert_eq!(stale.unwrap_err(), StoreError::Conflict("one".into()));
        assert_eq!(second.created, first.created);
        store.delete("one").unwrap();
        assert_eq!(store.get("one").unwrap_err(), StoreError::NotFound("one".into()));
        assert_eq!(store.delete("one").unwrap_err(), StoreError::NotFound("one".into()));
        let again = store.create(Exercise::new("one").unwrap()).unwrap();
        assert_ne!(again.created, first.created);
    }

    #[test]
    fn the_number_of_exercises_is_limited() {
        let store = MemoryStore::default();
        for n in 0..MAX_EXERCISES {
            store.create(Exercise::new(&n.to_string()).unwrap()).unwrap();
        }
        assert_eq!(store.create(Exercise::new("more").unwrap()).unwrap_err(), StoreError::Full);
        assert_eq!(store.list().unwrap().len(), MAX_EXERCISES);
    }
}
