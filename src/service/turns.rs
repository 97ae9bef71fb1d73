//! Turns at the cores: work off the network threads, first come first served.
//!
//! A view has at most one piece of work here, so views take turns whatever each of them costs, and none starves another.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::Semaphore;
use tonic::Status;

use super::DEFECT;

/// The cores, and what waits for them.
#[derive(Debug)]
pub(super) struct Turns {
    permits: Arc<Semaphore>,
    waiting: Mutex<Waiting>,
}

#[derive(Debug, Default)]
struct Waiting {
    next: u64,
    since: BTreeMap<u64, Instant>,
}

/// Something that waits; no longer when it is dropped.
struct Wait<'a> {
    turns: &'a Turns,
    number: u64,
}

impl Drop for Wait<'_> {
    fn drop(&mut self) {
        self.turns.waiting().since.remove(&self.number);
    }
}

impl Turns {
    pub(super) fn new(cores: usize) -> Self {
        Self { permits: Arc::new(Semaphore::new(cores)), waiting: Mutex::default() }
    }

    // Each change of it is one insertion or removal.
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait(&self) -> Wait<'_> {
        let mut waiting = self.waiting();
        let number = waiting.next;
        waiting.next += 1;
        waiting.since.insert(number, Instant::now());
        drop(waiting);
        Wait { turns: self, number }
    }

    /// How long the oldest work has waited, and how much waits.
    pub(super) fn queue(&self) -> (Duration, usize) {
        let waiting = self.waiting();
        let oldest = waiting.since.values().next().map(Instant::elapsed);
        (oldest.unwrap_or_default(), waiting.since.len())
    }

    /// Runs `work` off the network threads, when its turn comes.
    pub(super) async fn run<R: Send + 'static>(&self, work: impl FnOnce() -> R + Send + 'static) -> Result<R, Status> {
        let wait = self.wait();
        let turn = Arc::clone(&self.permits).acquire_owned().await;
        drop(wait);
        let turn = turn.map_err(|_| Status::unavailable("the server is stopping"))?;
        let span = tracing::Span::current();
        let done = tokio::task::spawn_blocking(move || {
            let result = span.in_scope(work);
            drop(turn);
            result
        });
        done.await.map_err(|_| Status::internal(DEFECT))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn work_that_waits_is_seen_and_taken_in_order() {
        let turns = Arc::new(Turns::new(1));
        let (free, held) = std::sync::mpsc::channel::<()>();
        let holder = Arc::clone(&turns);
        let first = tokio::spawn(async move { holder.run(move || held.recv()).await });
        while turns.permits.available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut waiting = Vec::new();
        for n in 0..3 {
            let (turns, seen) = (Arc::clone(&turns), Arc::clone(&order));
            let next = turns.queue().1 + 1;
            let task = Arc::clone(&turns);
            waiting.push(tokio::spawn(async move { task.run(move || seen.lock().unwrap().push(n)).await }));
            while turns.queue().1 < next {
                tokio::task::yield_now().await;
            }
        }
        // One that goes away waits no more.
        waiting.remove(1).abort();
        while turns.queue().1 > 2 {
            tokio::task::yield_now().await;
        }
        assert!(turns.queue().0 > Duration::ZERO);
        free.send(()).unwrap();
        first.await.unwrap().unwrap().unwrap();
        for task in waiting {
            task.await.unwrap().unwrap();
        }
        assert_eq!(*order.lock().unwrap(), [0, 2]);
        assert_eq!(turns.queue(), (Duration::ZERO, 0));
    }
}
