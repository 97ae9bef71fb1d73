//! How long the leases of a server still run, and what happens when one has run out.
//!
//! What is under a lease stands in its exercise, and with it in the store; here are only times. Every [`LOOKING_TIME`] the
//! two are compared: a lease that is not known yet, after a start for example, gets its full term, and one whose time is
//! over and that no stream holds is executed. It is looked at once more when no change is under way, so a renewal that was
//! answered counts.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::time::interval;

use super::{ServedTerrain, Shared, clock::Clock, health::LOOKING_TIME};
use crate::{
    session::journal,
    store::{StoreError, Stored},
};

/// Exercises that ended with a lease and are remembered, to say so to whoever watched them.
const MAX_ENDED: usize = 256;

/// The exercise, by its `created`, and the owner.
type Key = (u64, Arc<str>);

#[derive(Debug, Default)]
struct Entry {
    /// `None` while streams hold what is no lease yet.
    lease: Option<Running>,
    streams: u32,
}

#[derive(Clone, Copy, Debug)]
struct Running {
    term: Duration,
    ends: Instant,
}

#[derive(Debug, Default)]
struct Book {
    entries: BTreeMap<Key, Entry>,
    ended: VecDeque<(u64, Arc<str>)>,
}

/// The times of all leases.
#[derive(Debug)]
pub(super) struct Leases {
    clock: Clock,
    book: Mutex<Book>,
}

/// A stream that holds a lease; when it is dropped, the full term begins.
#[derive(Debug)]
pub(super) struct Hold {
    leases: Arc<Leases>,
    key: Key,
}

impl Drop for Hold {
    fn drop(&mut self) {
        let now = self.leases.clock.now();
        let mut book = self.leases.book();
        let Some(entry) = book.entries.get_mut(&self.key) else { return };
        entry.streams -= 1;
        entry.lease = entry.lease.map(|Running { term, .. }| Running { term, ends: now + term });
        if entry.streams == 0 && entry.lease.is_none() {
            book.entries.remove(&self.key);
        }
    }
}

impl Leases {
    pub(super) fn new(clock: Clock) -> Arc<Self> {
        Arc::new(Self { clock, book: Mutex::default() })
    }

    // Each change of it is one insertion or removal.
    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins the full term of a lease.
    pub(super) fn renew(&self, created: u64, owner: &Arc<str>, term_s: u32) {
        let term = Duration::from_secs(term_s.into());
        let running = Running { term, ends: self.clock.now() + term };
        self.book().entries.entry((created, Arc::clone(owner))).or_default().lease = Some(running);
    }

    /// Holds the lease of an owner, now or as soon as there is one.
    pub(super) fn hold(self: &Arc<Self>, created: u64, owner: &str) -> Hold {
        let key = (created, Arc::from(owner));
        self.book().entries.entry(Key::clone(&key)).or_default().streams += 1;
        Hold { leases: Arc::clone(self), key }
    }

    /// How long a lease still runs, its full term while streams hold it, and how many do; zero of one that is not known yet.
    pub(super) fn state(&self, created: u64, owner: &Arc<str>) -> (Duration, u32) {
        let now = self.clock.now();
        let book = self.book();
        let Some(entry) = book.entries.get(&(created, Arc::clone(owner))) else { return Default::default() };
        let left = |running: Running| match entry.streams {
            0 => running.ends.saturating_duration_since(now),
            _ => running.term,
        };
        (entry.lease.map(left).unwrap_or_default(), entry.streams)
    }

    /// Which owner's lease ended an exercise, if one did.
    pub(super) fn ended(&self, created: u64) -> Option<Arc<str>> {
        let book = self.book();
        book.ended.iter().find(|(ended, _)| *ended == created).map(|(_, owner)| Arc::clone(owner))
    }

    fn end(&self, (created, owner): &Key) {
        let mut book = self.book();
        if book.ended.len() >= MAX_ENDED {
            book.ended.pop_front();
        }
        book.ended.push_back((*created, Arc::clone(owner)));
    }

    fn is_over(&self, key: &Key) -> bool {
        let now = self.clock.now();
        let book = self.book();
        book.entries.get(key).is_some_and(|entry| entry.is_over(now))
    }

    /// Compares the times with the leases that there are, and returns those that are over.
    fn compare(&self, there: &BTreeMap<Key, u32>) -> Vec<Key> {
        let now = self.clock.now();
        let mut book = self.book();
        for (key, &term_s) in there {
            let term = Duration::from_secs(term_s.into());
            let entry = book.entries.entry(Key::clone(key)).or_default();
            entry.lease.get_or_insert(Running { term, ends: now + term });
        }
        book.entries.retain(|key, entry| {
            if !there.contains_key(key) {
                entry.lease = None;
            }
            entry.lease.is_some() || entry.streams > 0
        });
        book.entries.iter().filter(|(_, entry)| entry.is_over(now)).map(|(key, _)| Key::clone(key)).collect()
    }
}

impl Entry {
    fn is_over(&self, now: Instant) -> bool {
        self.streams == 0 && self.lease.is_some_and(|running| running.ends <= now)
    }
}

/// Executes leases that have run out, for ever.
pub(super) async fn look_after<T: ServedTerrain>(shared: Arc<Shared<T>>) {
    let mut looking = interval(LOOKING_TIME);
    let mut moves = shared.leases.clock.moves();
    loop {
        let moved = async {
            match &mut moves {
                Some(moves) => moves.changed().await.is_ok(),
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = looking.tick() => {}
            true = moved => {}
        }
        // A store that cannot be written is tried by whoever looks after health.
        if !shared.health.is_store_in_doubt() {
            look(&shared).await;
        }
    }
}

async fn look<T: ServedTerrain>(shared: &Arc<Shared<T>>) {
    // A change that is under way could put things under a lease between the two.
    let turn = shared.changing.lock().await;
    let inner = Arc::clone(shared);
    let over = tokio::task::spawn_blocking(move || over(&inner)).await.unwrap_or_default();
    drop(turn);
    for (key, name) in over {
        let _turn = shared.changing.lock().await;
        if !shared.leases.is_over(&key) {
            continue;
        }
        let (inner, which, what) = (Arc::clone(shared), Key::clone(&key), name.clone());
        match tokio::task::spawn_blocking(move || inner.written(execute(&inner, &which, &what))).await {
            Ok(Ok(())) => {
                tracing::info!(exercise = name, owner = &*key.1, "a lease has run out");
                shared.metrics.leases_expired.inc();
                shared.changes.send_modify(|n| *n += 1);
            }
            Ok(Err(error)) => tracing::warn!(exercise = name, owner = &*key.1, %error, "a lease could not be executed"),
            Err(_) => {}
        }
    }
}

/// The leases that are over, and the names of their exercises.
fn over<T: ServedTerrain>(shared: &Shared<T>) -> Vec<(Key, String)> {
    let Ok(stored) = shared.store.list() else { return Vec::new() };
    let there = stored.iter().flat_map(|stored| {
        let leases = stored.exercise.leases();
        leases.map(|(_, granted)| ((stored.created, Arc::clone(granted.lease.owner())), granted.lease.term_s()))
    });
    let over = shared.leases.compare(&there.collect());
    let name = |created| stored.iter().find(|s| s.created == created).map(|s| s.exercise.name().to_owned());
    over.into_iter().filter_map(|key| name(key.0).map(|name| (key, name))).collect()
}

/// Removes what is under a lease.
fn execute<T: ServedTerrain>(shared: &Shared<T>, key: &Key, name: &str) -> Result<(), StoreError> {
    let Stored { revision, created, exercise } = shared.store.get(name)?;
    let granted = if created == key.0 { exercise.lease(&key.1) } else { None };
    match granted {
        None => Ok(()),
        Some(granted) if granted.holds_exercise => {
            let deleted = || journal::Entry::Deleted { name: name.to_owned() };
            shared.keep(deleted, || shared.store.delete(name))?;
            shared.leases.end(key);
            Ok(())
        }
        Some(_) => match exercise.expired(&key.1) {
            Some(after) => {
                let (entities, sight_lines) = exercise.lost_in(&after);
                let expired = || journal::Entry::Expired { name: name.to_owned(), entities, sight_lines };
                shared.keep(expired, || shared.store.replace(revision, after)).map(|_| ())
            }
            None => Ok(()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn key(created: u64, owner: &str) -> Key {
        (created, owner.into())
    }

    #[test]
    fn terms_run_from_the_last_sign_of_life() {
        let clock = Clock::standing();
        let leases = Leases::new(clock.clone());
        let there: BTreeMap<Key, u32> = [(key(1, "a"), 10), (key(1, "b"), 20), (key(2, "a"), 30)].into();
        // What is found, after a start for example, has its full term.
        assert_eq!(leases.compare(&there), []);
        clock.advance(9 * SECOND);
        assert_eq!(leases.state(1, &"a".into()), (SECOND, 0));
        leases.renew(1, &"a".into(), 10);
        clock.advance(9 * SECOND);
        assert_eq!(leases.compare(&there), []);
        clock.advance(SECOND);
        assert_eq!(leases.compare(&there), [key(1, "a")]);
        assert!(leases.is_over(&key(1, "a")) && !leases.is_over(&key(1, "b")));
        leases.renew(1, &"a".into(), 10);
        assert!(!leases.is_over(&key(1, "a")), "a renewal in the last moment counts");
        clock.advance(SECOND);
        assert_eq!(leases.compare(&there), [key(1, "b")]);
        // One that is no more is forgotten; when it comes back, it is a new one.
        let rest: BTreeMap<Key, u32> = [(key(2, "a"), 30)].into();
        assert_eq!(leases.compare(&rest), []);
        assert_eq!(leases.compare(&there), []);
        assert_eq!(leases.state(1, &"b".into()).0, 20 * SECOND);
    }

    #[test]
    fn no_lease_runs_out_while_a_stream_holds_it() {
        let clock = Clock::standing();
        let leases = Leases::new(clock.clone());
        let there: BTreeMap<Key, u32> = [(key(1, "a"), 10)].into();
        // Held before it is granted.
        let (first, second) = (leases.hold(1, "a"), leases.hold(1, "a"));
        assert_eq!(leases.compare(&BTreeMap::new()), []);
        leases.renew(1, &"a".into(), 10);
        clock.advance(100 * SECOND);
        assert_eq!((leases.compare(&there), leases.state(1, &"a".into())), (vec![], (10 * SECOND, 2)));
        drop(first);
        clock.advance(100 * SECOND);
        assert_eq!(leases.compare(&there), []);
        drop(second);
        clock.advance(9 * SECOND);
        assert_eq!((leases.compare(&there), leases.state(1, &"a".into())), (vec![], (SECOND, 0)));
        clock.advance(SECOND);
        assert_eq!(leases.compare(&there), [key(1, "a")]);
        // Another exercise of the same name has another key.
        drop(leases.hold(2, "a"));
        assert_eq!(leases.book().entries.len(), 1);
    }
}
