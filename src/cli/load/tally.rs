//! What a load counts: latencies in histograms, errors by themselves.

use std::{
    fmt,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use hdrhistogram::Histogram;
use serde::Serialize;

/// Errors that are told in words; beyond it they are counted.
const MAX_TOLD: usize = 10;
/// Longest latency that is told apart, in microseconds.
const MAX_US: u64 = 600_000_000;
/// Most bytes of a frame that are told apart.
const MAX_BYTES: u64 = 1 << 30;
/// Digits of a value that a histogram keeps.
const DIGITS: u8 = 3;

/// What was counted.
#[derive(Clone, Debug)]
pub(super) struct Counted {
    /// Poses that were due.
    pub(super) poses: u64,
    /// Frames that were decoded and whose hash fits.
    pub(super) frames: u64,
    /// Poses whose first frame was that of a newer pose.
    pub(super) overtaken: u64,
    /// Of each pose, from when it was due.
    pub(super) frame_us: Histogram<u64>,
    /// Bytes of messages of frames.
    pub(super) bytes: u64,
    /// Of the message of each frame.
    pub(super) frame_bytes: Histogram<u64>,
    /// Lines answered.
    pub(super) queries: u64,
    /// Of each question that was answered, from when it was due.
    pub(super) query_us: Histogram<u64>,
    /// Changes of the exercise.
    pub(super) changes: u64,
    /// Verdicts on clients' meshes that were compared with the stated ones.
    pub(super) comparisons: u64,
    /// Times that a line was named as unsatisfied.
    pub(super) named: u64,
    /// Lines whose verdict differs without being named.
    pub(super) silent_disagreements: u64,
    /// All that went wrong.
    pub(super) errors: u64,
    /// The first of it in words.
    pub(super) first_errors: Vec<String>,
}

impl Default for Counted {
    fn default() -> Self {
        let histogram = |high| Histogram::new_with_max(high, DIGITS).expect("these bounds and digits are allowed");
        Self {
            poses: 0,
            frames: 0,
            overtaken: 0,
            frame_us: histogram(MAX_US),
            bytes: 0,
            frame_bytes: histogram(MAX_BYTES),
            queries: 0,
            query_us: histogram(MAX_US),
            changes: 0,
            comparisons: 0,
            named: 0,
            silent_disagreements: 0,
            errors: 0,
            first_errors: Vec::new(),
        }
    }
}

impl Counted {
    /// Something went wrong.
    pub(super) fn error(&mut self, what: impl fmt::Display) {
        self.errors += 1;
        if self.first_errors.len() < MAX_TOLD {
            self.first_errors.push(what.to_string());
        }
    }
}

/// What all clients of a load count into.
#[derive(Debug, Default)]
pub(super) struct Tally(Mutex<Counted>);

impl Tally {
    /// For as little time as it takes to count. A panic while it is held leaves counts that are right.
    pub(super) fn count(&self) -> MutexGuard<'_, Counted> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn poses(&self) -> u64 {
        self.count().poses
    }

    pub(super) fn take(&self) -> Counted {
        std::mem::take(&mut self.count())
    }
}

/// Microseconds since `due`.
pub(super) fn since_us(due: Instant) -> u64 {
    u64::try_from(due.elapsed().as_micros()).unwrap_or(MAX_US)
}

/// The times at which things are due: one every period from a beginning to an end. Being late changes none of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Schedule {
    begin: Instant,
    period_s: f64,
    end: Instant,
    next: u64,
}

impl Schedule {
    pub(super) fn new(begin: Instant, hz: f64, end: Instant) -> Self {
        Self { begin, period_s: 1.0 / hz, end, next: 0 }
    }

    /// When the next is due; `None` when there is no more.
    pub(super) fn due(&self) -> Option<Instant> {
        let due = self.begin + Duration::from_secs_f64(self.next as f64 * self.period_s);
        (due < self.end).then_some(due)
    }

    /// The number of the next, which is now taken.
    pub(super) fn take(&mut self) -> u64 {
        self.next += 1;
        self.next - 1
    }
}

/// Latencies in milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Spread {
    count: u64,
    p50: f64,
    p90: f64,
    p99: f64,
    p999: f64,
    max: f64,
}

impl Spread {
    pub(super) fn of(us: &Histogram<u64>) -> Self {
        let at = |quantile| us.value_at_quantile(quantile) as f64 * 1e-3;
        let max = if us.is_empty() { 0.0 } else { us.max() as f64 * 1e-3 };
        Self { count: us.len(), p50: at(0.5), p90: at(0.9), p99: at(0.99), p999: at(0.999), max }
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { p50, p90, p99, p999, max, .. } = self;
        write!(f, "{p50:>8.3} {p90:>8.3} {p99:>8.3} {p999:>8.3} {max:>8.3}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_due_does_not_wait_for_what_was_late() {
        let begin = Instant::now();
        let mut schedule = Schedule::new(begin, 10.0, begin + Duration::from_millis(350));
        let mut due = Vec::new();
        while let Some(next) = schedule.due() {
            due.push((next - begin).as_millis());
            assert_eq!(schedule.take() + 1, due.len() as u64);
        }
        assert_eq!(due, [0, 100, 200, 300]);
    }

    #[test]
    fn errors_are_counted_and_the_first_are_told() {
        let tally = Tally::default();
        for n in 0..MAX_TOLD + 5 {
            tally.count().error(n);
        }
        let counted = tally.take();
        assert_eq!((counted.errors, counted.first_errors.len()), (MAX_TOLD as u64 + 5, MAX_TOLD));
        assert_eq!((counted.frames, Spread::of(&counted.frame_us).max), (0, 0.0));
    }
}
