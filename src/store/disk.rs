//! Keeps exercises in a file, so that a server that is started anew has them again.
//!
//! A change is on disk before it is answered: each is one transaction of redb, an embedded store of copy-on-write
//! B-trees, synced when it commits. After a kill or a loss of power the file holds the exercises as they were after the
//! last answered change, or after one more. Whoever asks is served from memory; the file is read once, when it is
//! opened, all pages and rows of it checked. Kept is what was registered, under which lease, and the epoch, never a verdict
//! or a resolved end: these are computed again, exactly. Nor is it kept how long leases still run: nobody could renew one
//! while there was no server.
//!
//! Leases came later and have tables of their own, so files without them are read, and older servers read new files as if
//! there were none.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use redb::{Database, ReadableDatabase, ReadableTable, TableDefinition, WriteTransaction};

use super::{
    ExerciseStore, MAX_EXERCISES, MemoryStore, State, StoreError, Stored,
    rows::{FORMAT, Head, LeaseRow, Under},
};
use crate::{
    database::envelope::{self, Sealed},
    exercise::{
        Entity, Exercise, Granted, KeptLease, Lease, MAX_ENTITIES, MAX_LEASES, MAX_SIGHT_LINES, SightLine, Site, Thing,
    },
    terrain::HeightField,
};

/// Of all exercises, by name.
const HEADS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("exercises");
/// By `created` of the exercise and their own ids.
const ENTITIES: Things = TableDefinition::new("entities");
const SIGHT_LINES: Things = TableDefinition::new("sight_lines");
/// By `created` of the exercise and their own numbers.
const LEASES: Things = TableDefinition::new("leases");
/// The leases of entities and sight lines that are under one, by the same keys as these.
const LEASED_ENTITIES: Things = TableDefinition::new("leased_entities");
const LEASED_SIGHT_LINES: Things = TableDefinition::new("leased_sight_lines");
/// The format, the terrain, and the last revision.
const FILE: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("file");

type Things = TableDefinition<'static, (u64, u64), &'static [u8]>;

/// Greatest size of one row.
const MAX_ROW_BYTES: usize = 1_024;

/// Keeps exercises in a file and in memory.
#[derive(Debug)]
pub struct DiskStore {
    file: Database,
    /// Held by whoever changes something.
    writing: Mutex<()>,
    memory: MemoryStore,
}

impl DiskStore {
    /// The store in the file at `path`, which is made when there is none. Its exercises are of the terrain with content
    /// hash `terrain` only, whose place and heights are `site` and `field`.
    ///
    /// Errors: a file of something else or of another terrain, one in use by another server, a damaged one.
    pub fn open(path: &Path, terrain: &[u8], site: &Site, field: &impl HeightField) -> Result<Self, StoreError> {
        let named = |error: StoreError| match error {
            StoreError::Failed(why) => StoreError::Failed(format!("{}: {why}", path.display())),
            other => other,
        };
        Self::open_unnamed(path, terrain, site, field).map_err(named)
    }

    fn open_unnamed(path: &Path, terrain: &[u8], site: &Site, field: &impl HeightField) -> Result<Self, StoreError> {
        let file = Database::builder().set_check_integrity_on_open(true).create(path).map_err(|error| match error {
            redb::DatabaseError::DatabaseAlreadyOpen => {
                StoreError::Failed("another server has it open: give each its own file".into())
            }
            error => failed(error),
        })?;
        let change = file.begin_write().map_err(failed)?;
        prepare(&change, terrain)?;
        change.commit().map_err(failed)?;
        let memory = MemoryStore { state: read(&file, site, field)?.into() };
        Ok(Self { file, writing: Mutex::default(), memory })
    }

    fn turn(&self) -> MutexGuard<'_, ()> {
        // What a panic may have left half done was a transaction, and is gone.
        self.writing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes what `change` does, all of it or nothing, and the revision after it.
    fn commit(
        &self,
        revision: u64,
        change: impl FnOnce(&WriteTransaction) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let transaction = self.file.begin_write().map_err(failed)?;
        change(&transaction)?;
        put_last_revision(&transaction, revision)?;
        transaction.commit().map_err(failed)
    }

    fn last_revision(&self) -> u64 {
        self.memory.read().last_revision
    }
}

impl ExerciseStore for DiskStore {
    fn create(&self, exercise: Exercise) -> Result<Stored, StoreError> {
        let _turn = self.turn();
        self.memory.read().room_for(exercise.name())?;
        let revision = self.last_revision() + 1;
        let empty = Exercise::new(exercise.name()).map_err(failed)?;
        self.commit(revision, |change| put(change, revision, revision, &empty, &exercise))?;
        self.memory.create(exercise)
    }

    fn list(&self) -> Result<Vec<Stored>, StoreError> {
        self.memory.list()
    }

    fn get(&self, name: &str) -> Result<Stored, StoreError> {
        self.memory.get(name)
    }

    fn replace(&self, revision: u64, exercise: Exercise) -> Result<Stored, StoreError> {
        let _turn = self.turn();
        let before = self.memory.get(exercise.name())?;
        if before.revision != revision {
            return Err(StoreError::Conflict(exercise.name().to_owned()));
        }
        let next = self.last_revision() + 1;
        self.commit(next, |change| put(change, before.created, next, &before.exercise, &exercise))?;
        self.memory.replace(revision, exercise)
    }

    fn delete(&self, name: &str) -> Result<(), StoreError> {
        let _turn = self.turn();
        let created = self.memory.get(name)?.created;
        self.commit(self.last_revision(), |change| {
            change.open_table(HEADS).map_err(failed)?.remove(name).map_err(failed)?;
            for things in [ENTITIES, SIGHT_LINES, LEASES, LEASED_ENTITIES, LEASED_SIGHT_LINES] {
                let mut table = change.open_table(things).map_err(failed)?;
                table.retain_in((created, 0)..=(created, u64::MAX), |_, _| false).map_err(failed)?;
            }
            Ok(())
        })?;
        self.memory.delete(name)
    }

    fn probe(&self) -> Result<(), StoreError> {
        let _turn = self.turn();
        self.commit(self.last_revision(), |_| Ok(()))
    }
}

fn failed(error: impl std::fmt::Display) -> StoreError {
    StoreError::Failed(error.to_string())
}

/// Makes the tables, and looks whether the file is one of this format and terrain.
fn prepare(change: &WriteTransaction, terrain: &[u8]) -> Result<(), StoreError> {
    change.open_table(HEADS).map_err(failed)?;
    for things in [ENTITIES, SIGHT_LINES, LEASES, LEASED_ENTITIES, LEASED_SIGHT_LINES] {
        change.open_table(things).map_err(failed)?;
    }
    let mut file = change.open_table(FILE).map_err(failed)?;
    let mut expect = |what: &str, expected: &[u8], otherwise: &str| {
        let found = file.get(what).map_err(failed)?.map(|found| found.value().to_vec());
        match found {
            None => file.insert(what, expected).map(|_| ()).map_err(failed),
            Some(found) if found == expected => Ok(()),
            Some(_) => Err(StoreError::Failed(otherwise.to_owned())),
        }
    };
    expect("format", &FORMAT.to_le_bytes(), "it is of a format that this version does not know")?;
    expect("terrain", terrain, "its exercises are of another terrain: give this one a file of its own")
}

fn put_last_revision(change: &WriteTransaction, revision: u64) -> Result<(), StoreError> {
    let mut file = change.open_table(FILE).map_err(failed)?;
    file.insert("last_revision", &revision.to_le_bytes()[..]).map_err(failed)?;
    Ok(())
}

/// Writes the head of `after`, and what differs in it from `before`.
fn put(
    change: &WriteTransaction,
    created: u64,
    revision: u64,
    before: &Exercise,
    after: &Exercise,
) -> Result<(), StoreError> {
    let head = encode(&Head { created, revision, epoch: after.epoch() })?;
    change.open_table(HEADS).map_err(failed)?.insert(after.name(), &head[..]).map_err(failed)?;
    let entities = [before, after].map(|exercise| exercise.entities().map(|entity| (entity.id, *entity)));
    put_things(change, ENTITIES, created, entities)?;
    let lines = [before, after].map(|exercise| exercise.sight_lines().map(|state| (state.line.id, state.line)));
    put_things(change, SIGHT_LINES, created, lines)?;
    put_things(change, LEASES, created, [before, after].map(|exercise| exercise.leases().map(lease_row)))?;
    for (table, thing) in [(LEASED_ENTITIES, Thing::Entity), (LEASED_SIGHT_LINES, Thing::SightLine)] {
        let leased = [before, after].map(|exercise| exercise.leased(thing).map(|(id, number)| (id, Under(number))));
        put_things(change, table, created, leased)?;
    }
    Ok(())
}

fn lease_row((number, granted): (u64, &Granted)) -> (u64, LeaseRow) {
    let (owner, term_s) = (granted.lease.owner().to_string(), granted.lease.term_s());
    (number, LeaseRow { owner, term_s, holds_exercise: granted.holds_exercise })
}

/// Writes what differs between two lists, both by ascending id.
fn put_things<T: PartialEq + Sealed>(
    change: &WriteTransaction,
    things: Things,
    created: u64,
    [before, after]: [impl Iterator<Item = (u64, T)>; 2],
) -> Result<(), StoreError> {
    let mut table = change.open_table(things).map_err(failed)?;
    let mut before = before.peekable();
    for (id, thing) in after {
        while let Some((gone, _)) = before.next_if(|(earlier, _)| *earlier < id) {
            table.remove((created, gone)).map_err(failed)?;
        }
        // What is not equal to itself is written again, which does no harm.
        if before.next_if(|(same, _)| *same == id).is_none_or(|(_, earlier)| earlier != thing) {
            table.insert((created, id), &encode(&thing)?[..]).map_err(failed)?;
        }
    }
    for (gone, _) in before {
        table.remove((created, gone)).map_err(failed)?;
    }
    Ok(())
}

/// All exercises of a file.
fn read(file: &Database, site: &Site, field: &impl HeightField) -> Result<State, StoreError> {
    let reading = file.begin_read().map_err(failed)?;
    let heads = reading.open_table(HEADS).map_err(failed)?;
    let table = |things: Things| reading.open_table(things).map_err(failed);
    let (entities, lines, leases) = (table(ENTITIES)?, table(SIGHT_LINES)?, table(LEASES)?);
    let leased = [table(LEASED_ENTITIES)?, table(LEASED_SIGHT_LINES)?];
    let last = reading.open_table(FILE).map_err(failed)?.get("last_revision").map_err(failed)?;
    let last = last.map(|bytes| bytes.value().try_into().map(u64::from_le_bytes)).transpose();
    let mut state =
        State { last_revision: last.map_err(|_| damaged("its last revision"))?.unwrap_or(0), ..State::default() };
    for row in heads.iter().map_err(failed)? {
        let (name, head) = row.map_err(failed)?;
        let (name, head): (String, Head) = (name.value().to_owned(), decode(head.value(), "an exercise")?);
        if state.exercises.len() >= MAX_EXERCISES || head.revision.max(head.created) > state.last_revision {
            return Err(damaged("its list of exercises"));
        }
        let entities: Vec<Entity> = read_things(&entities, head.created, MAX_ENTITIES)?.into_values().collect();
        let lines: Vec<SightLine> = read_things(&lines, head.created, MAX_SIGHT_LINES)?.into_values().collect();
        let exercise = Exercise::restored(&name, head.epoch, &entities, &lines, site, field)
            .map_err(|error| StoreError::Failed(format!("exercise '{name}': {error}")))?;
        let leases = read_things(&leases, head.created, MAX_LEASES)?;
        let leases: Vec<KeptLease> = leases.into_iter().map(kept_lease).collect::<Result<_, _>>()?;
        let under = |of: usize, limit| read_things::<Under>(&leased[of], head.created, limit);
        let [entities, lines] = [under(0, MAX_ENTITIES)?, under(1, MAX_SIGHT_LINES)?]
            .map(|things| things.into_iter().map(|(id, Under(number))| (id, number)));
        let exercise = exercise.with_leases(leases, entities, lines).ok_or_else(|| damaged("a lease"))?;
        let Head { created, revision, .. } = head;
        state.exercises.insert(name, Stored { revision, created, exercise: Arc::new(exercise) });
    }
    Ok(state)
}

fn read_things<T: Sealed>(
    table: &impl ReadableTable<(u64, u64), &'static [u8]>,
    created: u64,
    limit: usize,
) -> Result<BTreeMap<u64, T>, StoreError> {
    let mut things = BTreeMap::new();
    for row in table.range((created, 0)..=(created, u64::MAX)).map_err(failed)? {
        if things.len() >= limit {
            return Err(damaged("the number of things of an exercise"));
        }
        let (key, thing) = row.map_err(failed)?;
        things.insert(key.value().1, decode(thing.value(), "a thing of an exercise")?);
    }
    Ok(things)
}

fn kept_lease((number, row): (u64, LeaseRow)) -> Result<KeptLease, StoreError> {
    let lease = Lease::new(&row.owner, row.term_s).map_err(|_| damaged("a lease"))?;
    Ok((number, lease, row.holds_exercise))
}

fn damaged(what: &str) -> StoreError {
    StoreError::Failed(format!(
        "{what} makes no sense: the file is damaged; restore a copy, or start with another file"
    ))
}

fn encode<T: Sealed>(value: &T) -> Result<Vec<u8>, StoreError> {
    envelope::seal(value).map_err(failed)
}

fn decode<T: Sealed>(bytes: &[u8], what: &str) -> Result<T, StoreError> {
    envelope::open::<T, MAX_ROW_BYTES>(bytes).map_err(|_| damaged(what))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        exercise::{Altitude, Anchor, Change, Disc, Frame, Place},
        roam::Fidelity,
        terrain::{MemoryField, SceneScale, synthetic},
    };

    const SITE: Site = Site { scale: SceneScale { east_m: 10.0, north_m: 10.0, up_m: 1.0 }, georeference: None };
    const TERRAIN: &[u8] = b"a terrain";

    fn field() -> MemoryField {
        synthetic::fractal(70, 50, 7, 400).unwrap()
    }

    fn open(path: &Path) -> Result<DiskStore, StoreError> {
        DiskStore::open(path, TERRAIN, &SITE, &field())
    }

    fn place(n: u64) -> Place {
        let [x, y] = [7, 13].map(|k| (synthetic::mix(n * k) % 400) as f64 / 10.0);
        let frames = [Frame::Grid, Frame::Scene];
        Place { position: [x, y, 2.0], frame: frames[n as usize % 2], altitude: Altitude::AboveGround }
    }

    /// Entities and lines of every kind, some of them put, some removed again.
    fn change(n: u64) -> Change {
        let entities =
            (0..6).map(|k| Entity { id: k, place: place(n + k), ground_m: (k == 3).then_some(0.5) }).collect();
        let fidelities =
            [Fidelity::Verdict, Fidelity::Wedgie, Fidelity::Profile, Fidelity::Obstruction { distance_m: 3.5 }];
        let line = |k: u64| SightLine {
            id: 10 + (n + k) % 9,
            a: Anchor::Entity { id: k, offset_m: 1.5 },
            b: if k == 0 { Anchor::Point(place(n)) } else { Anchor::Entity { id: k - 1, offset_m: 0.0 } },
            fidelity: fidelities[k as usize % 4],
            priority: k as u32,
            range_m: (k == 2).then_some(200.0),
            region: (k == 4).then_some(Disc { centre: [200.0, 200.0], frame: Frame::Scene, radius_m: 90.0 }),
        };
        let lease = (!n.is_multiple_of(3)).then(|| Lease::new(&format!("owner-{}", n % 4), 60 + n as u32).unwrap());
        Change { put_entities: entities, put_sight_lines: (0..5).map(line).collect(), lease, ..Change::default() }
    }

    /// All that clients could see of a store.
    fn seen(store: &DiskStore) -> Vec<(u64, u64, Exercise)> {
        let settled = |exercise: &Exercise| {
            let lines: Vec<_> = exercise.sight_lines().map(|state| state.line).collect();
            let entities: Vec<_> = exercise.entities().copied().collect();
            let restored = Exercise::restored(exercise.name(), exercise.epoch(), &entities, &lines, &SITE, &field());
            let leases = exercise.leases().map(|(number, g)| (number, g.lease.clone(), g.holds_exercise));
            let [entities, lines] = [Thing::Entity, Thing::SightLine].map(|thing| exercise.leased(thing));
            restored.unwrap().with_leases(leases, entities, lines).unwrap()
        };
        store.list().unwrap().iter().map(|s| (s.created, s.revision, settled(&s.exercise))).collect()
    }

    #[test]
    fn a_store_that_is_opened_anew_holds_what_it_held() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state");
        let field = field();
        let mut store = open(&path).unwrap();
        for n in 0..40_u64 {
            let name = format!("exercise-{}", n % 3);
            match store.get(&name) {
                Err(_) => {
                    let lease = Lease::new("page", 30).unwrap();
                    drop(store.create(Exercise::new(&name).unwrap().under(&lease)).unwrap());
                }
                Ok(before) if n % 13 == 12 => {
                    let owner = before.exercise.leases().last().unwrap().1.lease.owner().to_string();
                    store.replace(before.revision, before.exercise.expired(&owner).unwrap()).unwrap();
                }
                Ok(_) if n % 11 == 10 => store.delete(&name).unwrap(),
                Ok(before) => {
                    let mut change = change(n);
                    if n % 4 == 3 {
                        let lines: Vec<u64> = before.exercise.sight_lines().map(|state| state.line.id).collect();
                        change = Change { remove_sight_lines: lines, remove_entities: vec![3], ..Change::default() };
                        change.remove_entities.retain(|id| before.exercise.entities().any(|entity| entity.id == *id));
                    }
                    let after = before.exercise.changed(&change, &SITE, &field).unwrap();
                    store.replace(before.revision, after).unwrap();
                }
            }
            let (held, last) = (seen(&store), store.last_revision());
            drop(store);
            store = open(&path).unwrap();
            assert_eq!(seen(&store), held, "after step {n}");
            assert_eq!(store.last_revision(), last);
        }
        assert!(store.list().unwrap().iter().any(|stored| stored.exercise.sight_lines().len() > 4));
        assert!(store.list().unwrap().iter().any(|stored| stored.exercise.leases().len() > 2));
        // What is answered after the restart is computed, not read.
        for stored in store.list().unwrap() {
            for state in stored.exercise.sight_lines().filter(|state| state.active) {
                let [a, b] = state.resolved.unwrap();
                assert_eq!(state.verdict, crate::los::line_of_sight(&field, a, b, Default::default()).unwrap().verdict);
            }
        }
        store.probe().unwrap();
    }

    #[test]
    fn refusals_change_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state");
        let store = open(&path).unwrap();
        let first = store.create(Exercise::new("one").unwrap()).unwrap();
        assert_eq!(store.create(Exercise::new("one").unwrap()).unwrap_err(), StoreError::Exists("one".into()));
        let second = store.replace(first.revision, Exercise::new("one").unwrap()).unwrap();
        let stale = store.replace(first.revision, Exercise::new("one").unwrap());
        assert_eq!(stale.unwrap_err(), StoreError::Conflict("one".into()));
        assert_eq!(store.delete("two").unwrap_err(), StoreError::NotFound("two".into()));
        assert_eq!(store.get("one").unwrap().revision, second.revision);
        assert!(open(&path).unwrap_err().to_string().contains("another server"));
        drop(store);
        let other = DiskStore::open(&path, b"another", &SITE, &field()).unwrap_err().to_string();
        assert!(other.contains("another terrain") && other.contains("state"), "{other}");
        // A file from before there were leases.
        let file = Database::create(&path).unwrap();
        let change = file.begin_write().unwrap();
        for table in [LEASES, LEASED_ENTITIES, LEASED_SIGHT_LINES] {
            assert!(change.delete_table(table).unwrap());
        }
        change.commit().unwrap();
        drop(file);
        // A name that is used again is another exercise.
        let store = open(&path).unwrap();
        store.delete("one").unwrap();
        let again = store.create(Exercise::new("one").unwrap()).unwrap();
        assert!(again.created > second.revision);
    }

    #[test]
    fn a_damaged_file_is_refused_or_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state");
        let store = open(&path).unwrap();
        let made = store.create(Exercise::new("one").unwrap()).unwrap();
        store.replace(made.revision, made.exercise.changed(&change(1), &SITE, &field()).unwrap()).unwrap();
        let held = seen(&store);
        drop(store);
        let bytes = std::fs::read(&path).unwrap();
        let mut refused = 0;
        for n in 0..60_u64 {
            let mut bytes = bytes.clone();
            let at = (synthetic::mix(n) % bytes.len() as u64) as usize;
            if n % 3 == 0 {
                bytes.truncate(at)
            } else {
                bytes[at] ^= 1 << (n % 8)
            }
            std::fs::write(&path, bytes).unwrap();
            match open(&path) {
                Ok(store) => assert_eq!(seen(&store), held, "case {n}"),
                Err(error) => {
                    refused += 1;
                    assert!(error.to_string().contains("state"), "{error}");
                }
            }
        }
        assert!(refused > 10, "{refused}");
        std::fs::write(&path, "not a store of exercises\n".repeat(400)).unwrap();
        open(&path).unwrap_err();
    }
}
