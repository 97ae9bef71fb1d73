//! Turns at the cores: work off the network threads, first come first served.
//!
//! A view has at most one piece of work here, so views take turns whatever each of them costs, and none starves another.
//! One thread a core takes what waits, piece after piece: a pool that grows and rests wakes another of its threads for
//! each single question, and all of them are cold.

use std::{
    collections::BTreeMap,
    fmt, io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use tonic::Status;

use super::DEFECT;

/// The cores, and what waits for them. When it is dropped, the threads end.
#[derive(Debug)]
pub(super) struct Turns(Arc<Desk>);

/// Where work is left and taken.
#[derive(Default)]
struct Desk {
    queue: Mutex<Queue>,
    /// Told when there is work, or no more will come.
    news: Condvar,
}

#[derive(Default)]
struct Queue {
    next: u64,
    /// What waits, in the order in which it came.
    waiting: BTreeMap<u64, Waiting>,
    is_closed: bool,
}

struct Waiting {
    since: Instant,
    work: Box<dyn FnOnce() + Send>,
}

impl fmt::Debug for Desk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} waiting", self.queue().waiting.len())
    }
}

impl Desk {
    // Each change of it is complete before anything can panic.
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The oldest work, when there is some; `None` when no more will come.
    fn take(&self) -> Option<Box<dyn FnOnce() + Send>> {
        let mut queue = self.queue();
        loop {
            if let Some((_, oldest)) = queue.waiting.pop_first() {
                return Some(oldest.work);
            }
            if queue.is_closed {
                return None;
            }
            queue = self.news.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// The place of a piece of work; when it is dropped, work that still waits is not done.
struct Place<'a> {
    desk: &'a Desk,
    number: u64,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        // Dropped when the queue is free again.
        let _left = self.desk.queue().waiting.remove(&self.number);
    }
}

impl Drop for Turns {
    fn drop(&mut self) {
        self.0.queue().is_closed = true;
        self.0.news.notify_all();
    }
}

impl Turns {
    pub(super) fn new(cores: usize) -> io::Result<Self> {
        let turns = Self(Arc::default());
        for _ in 0..cores {
            let desk = Arc::clone(&turns.0);
            let work = move || {
                while let Some(work) = desk.take() {
                    // Who waits for it learns of a panic by the end of its channel.
                    let _ = catch_unwind(AssertUnwindSafe(work));
                }
            };
            thread::Builder::new().name("compute".into()).spawn(work)?;
        }
        Ok(turns)
    }

    /// How long the oldest work has waited, and how much waits.
    pub(super) fn queue(&self) -> (Duration, usize) {
        let queue = self.0.queue();
        let oldest = queue.waiting.values().next().map(|oldest| oldest.since.elapsed());
        (oldest.unwrap_or_default(), queue.waiting.len())
    }

    /// Tells whether work waits.
    pub(super) fn watch(&self) -> impl Fn() -> bool + Send + use<> {
        let desk = Arc::clone(&self.0);
        move || !desk.queue().waiting.is_empty()
    }

    fn wait(&self, work: Box<dyn FnOnce() + Send>) -> Place<'_> {
        let mut queue = self.0.queue();
        let number = queue.next;
        queue.next += 1;
        queue.waiting.insert(number, Waiting { since: Instant::now(), work });
        drop(queue);
        self.0.news.notify_one();
        Place { desk: &self.0, number }
    }

    /// Runs `work` off the network threads, when its turn comes.
    pub(super) async fn run<R: Send + 'static>(&self, work: impl FnOnce() -> R + Send + 'static) -> Result<R, Status> {
        let (teller, told) = oneshot::channel();
        let span = tracing::Span::current();
        let _place = self.wait(Box::new(move || {
            // Nobody may wait for it any more.
            let _ = teller.send(span.in_scope(work));
        }));
        told.await.map_err(|_| Status::internal(DEFECT))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn work_that_waits_is_seen_and_taken_in_order() {
        let turns = Arc::new(Turns::new(1).unwrap());
        let (free, held) = std::sync::mpsc::channel::<()>();
        let (start, mut started) = tokio::sync::mpsc::unbounded_channel();
        let holder = Arc::clone(&turns);
        let work = move || {
            start.send(()).unwrap();
            held.recv()
        };
        let first = tokio::spawn(async move { holder.run(work).await });
        started.recv().await.unwrap();
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

    #[tokio::test]
    async fn work_that_panics_is_told_and_keeps_no_core() {
        let turns = Turns::new(1).unwrap();
        for _ in 0..3 {
            let told = turns.run(|| -> u32 { panic!("a defect, on purpose") }).await;
            assert_eq!(told.unwrap_err().code(), tonic::Code::Internal);
            assert_eq!(turns.run(|| 7).await.unwrap(), 7);
        }
    }

    #[tokio::test]
    async fn all_cores_work_and_no_more() {
        let turns = Arc::new(Turns::new(3).unwrap());
        let (free, held) = std::sync::mpsc::channel::<()>();
        let held = Arc::new(Mutex::new(held));
        let at_work = Arc::new(std::sync::atomic::AtomicUsize::new(0));
        let tasks: Vec<_> = (0..5)
            .map(|_| {
                let (turns, held, at_work) = (Arc::clone(&turns), Arc::clone(&held), Arc::clone(&at_work));
                tokio::spawn(async move {
                    let work = move || {
                        at_work.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
                        held.lock().unwrap().recv()
                    };
                    turns.run(work).await
                })
            })
            .collect();
        while at_work.load(std::sync::atomic::Ordering::SeqCst) < 3 || turns.queue().1 != 2 {
            tokio::task::yield_now().await;
        }
        (0..5).for_each(|_| free.send(()).unwrap());
        for task in tasks {
            task.await.unwrap().unwrap().unwrap();
        }
        assert_eq!(turns.queue().1, 0);
    }
}
