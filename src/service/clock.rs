//! The clock by which leases run out: the system's, or one that a test moves.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::watch;

/// What time it is.
#[derive(Clone, Debug, Default)]
pub struct Clock(Option<Arc<Moved>>);

#[derive(Debug)]
struct Moved {
    start: Instant,
    since: watch::Sender<Duration>,
}

impl Clock {
    /// A clock that stands until it is moved.
    pub fn standing() -> Self {
        Self(Some(Arc::new(Moved { start: Instant::now(), since: watch::Sender::new(Duration::ZERO) })))
    }

    /// Moves a standing clock; that of the system goes as it goes.
    pub fn advance(&self, by: Duration) {
        if let Some(moved) = &self.0 {
            moved.since.send_modify(|since| *since += by);
        }
    }

    pub(super) fn now(&self) -> Instant {
        match &self.0 {
            Some(moved) => moved.start + *moved.since.borrow(),
            None => Instant::now(),
        }
    }

    /// Tells when a standing clock is moved.
    pub(super) fn moves(&self) -> Option<watch::Receiver<Duration>> {
        self.0.as_ref().map(|moved| moved.since.subscribe())
    }
}
