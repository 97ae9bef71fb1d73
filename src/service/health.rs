//! Whether the server is healthy, and why not: what the health service, `/healthz` and `sightline status` say.
//!
//! It is not while it drains, after a page of the terrain failed its checksum (that does not heal: another page would
//! have to be trusted), while the store cannot be written, and while work has waited for a core for more than a second.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use tonic::{Code, Status};

/// Work that waits longer makes the server unhealthy.
pub const MAX_QUEUE_AGE: Duration = Duration::from_secs(1);
/// How often health is looked at.
pub(super) const LOOKING_TIME: Duration = Duration::from_millis(200);

/// What makes a server unhealthy.
#[derive(Debug, Default)]
pub(super) struct Health {
    draining: AtomicBool,
    damaged: AtomicBool,
    unwritable: AtomicBool,
}

impl Health {
    /// The server is to stop.
    pub(super) fn drain(&self) {
        self.draining.store(true, Ordering::Relaxed);
    }

    /// Whether the store took the last thing that was written.
    pub(super) fn store(&self, is_writable: bool) {
        self.unwritable.store(!is_writable, Ordering::Relaxed);
    }

    /// Whether the store has to be tried again.
    pub(super) fn is_store_in_doubt(&self) -> bool {
        self.unwritable.load(Ordering::Relaxed)
    }

    /// Looks at how something ended.
    pub(super) fn observe(&self, code: Code) {
        if code == Code::DataLoss {
            self.damaged.store(true, Ordering::Relaxed);
        }
    }

    /// [`Health::observe`] of an error on its way.
    pub(super) fn seen(&self, status: Status) -> Status {
        self.observe(status.code());
        status
    }

    /// What is wrong, one sentence each.
    pub(super) fn troubles(&self, queue_age: Duration) -> Vec<String> {
        let mut troubles = Vec::new();
        if self.draining.load(Ordering::Relaxed) {
            troubles.push("the server is stopping".to_owned());
        }
        if self.damaged.load(Ordering::Relaxed) {
            troubles
                .push("a page of the database is damaged: run `sightline verify`, and serve a sound copy".to_owned());
        }
        if self.unwritable.load(Ordering::Relaxed) {
            troubles.push("the store of exercises cannot be written: see the log, free space, permissions".to_owned());
        }
        if queue_age > MAX_QUEUE_AGE {
            troubles.push(format!("work has waited {:.1} s for a core: too many views", queue_age.as_secs_f64()));
        }
        troubles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_trouble_is_told_and_only_some_pass() {
        let health = Health::default();
        let calm = Duration::from_millis(900);
        health.observe(Code::Unavailable);
        assert!(health.troubles(calm).is_empty());
        assert!(health.troubles(Duration::from_millis(1_100))[0].contains("waited 1.1 s"));
        health.store(false);
        assert!(health.is_store_in_doubt() && health.troubles(calm)[0].contains("store"));
        health.store(true);
        assert!(health.troubles(calm).is_empty());
        health.observe(Code::DataLoss);
        health.observe(Code::Ok);
        assert!(health.troubles(calm)[0].contains("verify"));
        health.drain();
        assert_eq!(health.troubles(calm).len(), 2);
    }
}
