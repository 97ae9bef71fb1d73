//! What can be measured of a server: counters and gauges in the format of Prometheus, and the essentials as a message.
//!
//! Each server has its own, so that several in one process do not mix; only the exact signs are the process's.

use std::{
    collections::BTreeSet,
    fmt,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicI64, AtomicU64, Ordering},
    },
    time::Duration,
};

use prometheus_client::{
    encoding::{EncodeLabelSet, text::encode},
    metrics::{counter::Counter, family::Family, gauge::Gauge, histogram::Histogram},
    registry::{Registry, Unit},
};
use sightline_proto::{predicates::exact_signs, v1};

use super::Ahead;
use crate::session::journal::JournalState;

/// Upper ends of the classes of times in seconds: a third of a decade each.
const SECONDS: [f64; 16] = [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 2.0];

/// The method of a call; those that no service has are one.
#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
pub(super) struct CallLabels {
    method: String,
    code: u32,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct VerdictLabels {
    verdict: &'static str,
}

/// Counts of times by class, to tell quantiles without asking the registry.
#[derive(Debug, Default)]
struct Classes([AtomicU64; SECONDS.len() + 1]);

impl Classes {
    fn observe(&self, seconds: f64) {
        let class = SECONDS.partition_point(|end| *end < seconds);
        self.0[class].fetch_add(1, Ordering::Relaxed);
    }

    /// The upper end of the class in which the quantile lies; 0 when nothing was observed.
    fn quantile(&self, q: f64) -> f64 {
        let counts: Vec<u64> = self.0.iter().map(|count| count.load(Ordering::Relaxed)).collect();
        let total: u64 = counts.iter().sum();
        let wanted = (q * total as f64).ceil() as u64;
        let mut seen = 0;
        for (class, count) in counts.iter().enumerate() {
            seen += count;
            if seen >= wanted && seen > 0 {
                return SECONDS.get(class).copied().unwrap_or(10.0);
            }
        }
        0.0
    }
}

/// What a server measures.
pub(super) struct Metrics {
    registry: Registry,
    calls: Family<CallLabels, Counter>,
    verdicts: Family<VerdictLabels, Counter>,
    exact_lines: Counter,
    call_seconds: Histogram,
    frame_seconds: Histogram,
    frame_classes: Classes,
    /// Frames sent.
    pub(super) frames: Counter,
    frame_bytes: Counter,
    held_back: Counter,
    splits: Counter,
    merges: Counter,
    /// Connections that were ended because they said nothing.
    pub(super) silent_connections: Counter,
    /// Sight lines that do not hold on the last frame of their view.
    pub(super) unsatisfied: Gauge,
    /// Leases that ran out.
    pub(super) leases_expired: Counter,
    views: Gauge,
    verdict_watches: Gauge,
    triangles: Gauge,
    exercises: Gauge,
    queue_age: Gauge<f64, AtomicU64>,
    queue_length: Gauge,
    exact: Gauge<u64, AtomicU64>,
    serving: Gauge,
    recording: Gauge,
    recorded: Gauge,
    under_way: Gauge,
    pages_read: Counter,
    looks: Counter,
    looks_dropped: Counter,
    looking: Counter<f64, AtomicU64>,
    /// Connections now.
    pub(super) connections: Gauge<i64, AtomicI64>,
    /// Bytes over all connections.
    pub(super) received: Counter,
    /// Bytes over all connections.
    pub(super) sent: Counter,
    /// All calls, and those refused.
    totals: [AtomicU64; 2],
    /// Methods that exist: something has answered them.
    methods: Mutex<BTreeSet<String>>,
}

impl fmt::Debug for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Metrics")
    }
}

/// What is looked up when somebody asks, in place of being counted.
#[derive(Clone, PartialEq, Debug, Default)]
pub(super) struct Moment {
    pub(super) views: u64,
    pub(super) verdict_watches: u64,
    pub(super) triangles: u64,
    pub(super) exercises: u64,
    pub(super) queue_age: Duration,
    pub(super) queue_length: usize,
    pub(super) is_serving: bool,
    /// The recording of what happens, if there is one.
    pub(super) recording: Option<JournalState>,
    /// Of requests.
    pub(super) bytes_under_way: u64,
    /// Of the terrain.
    pub(super) pages_read: u64,
    pub(super) ahead: Ahead,
}

impl Metrics {
    pub(super) fn new() -> Arc<Self> {
        let mut new = Self {
            registry: Registry::with_prefix("sightline"),
            calls: Family::default(),
            verdicts: Family::default(),
            exact_lines: Counter::default(),
            call_seconds: Histogram::new(SECONDS),
            frame_seconds: Histogram::new(SECONDS),
            frame_classes: Classes::default(),
            frames: Counter::default(),
            frame_bytes: Counter::default(),
            held_back: Counter::default(),
            splits: Counter::default(),
            merges: Counter::default(),
            silent_connections: Counter::default(),
            unsatisfied: Gauge::default(),
            leases_expired: Counter::default(),
            views: Gauge::default(),
            verdict_watches: Gauge::default(),
            triangles: Gauge::default(),
            exercises: Gauge::default(),
            queue_age: Gauge::default(),
            queue_length: Gauge::default(),
            exact: Gauge::default(),
            serving: Gauge::default(),
            recording: Gauge::default(),
            recorded: Gauge::default(),
            under_way: Gauge::default(),
            pages_read: Counter::default(),
            looks: Counter::default(),
            looks_dropped: Counter::default(),
            looking: Counter::default(),
            connections: Gauge::default(),
            received: Counter::default(),
            sent: Counter::default(),
            totals: Default::default(),
            methods: Mutex::default(),
        };
        new.register();
        Arc::new(new)
    }

    fn register(&mut self) {
        let r = &mut self.registry;
        r.register("calls", "Calls by method and gRPC code of their beginning", self.calls.clone());
        r.register_with_unit("call", "Time to the beginning of an answer", Unit::Seconds, self.call_seconds.clone());
        r.register("verdicts", "Lines of sight answered", self.verdicts.clone());
        r.register("exact_lines", "Lines of sight answered that took exact arithmetic", self.exact_lines.clone());
        r.register("exact_signs", "Signs told by exact arithmetic in this process", self.exact.clone());
        r.register("frames", "Frames sent", self.frames.clone());
        r.register_with_unit("frame", "Time to make a frame", Unit::Seconds, self.frame_seconds.clone());
        r.register_with_unit("frame", "Bytes of frames and updates", Unit::Bytes, self.frame_bytes.clone());
        r.register("frames_held_back", "Frames that a client's pace held back", self.held_back.clone());
        r.register(
            "splits",
            "Posts that refinement made active, those undone within a frame included",
            self.splits.clone(),
        );
        r.register("merges", "Posts that refinement made inactive, the same way", self.merges.clone());
        r.register("unsatisfied_lines", "Sight lines named by the last frame of a view", self.unsatisfied.clone());
        r.register("leases_expired", "Leases that ran out", self.leases_expired.clone());
        r.register("views", "Open views", self.views.clone());
        r.register("verdict_watches", "Watches of verdicts", self.verdict_watches.clone());
        r.register("view_triangles", "Sum of the budgets of the open views", self.triangles.clone());
        r.register("exercises", "Exercises", self.exercises.clone());
        r.register_with_unit("queue_age", "Wait of the oldest work", Unit::Seconds, self.queue_age.clone());
        r.register("queue_length", "Work that waits for a core", self.queue_length.clone());
        r.register("serving", "1 while the server is healthy", self.serving.clone());
        r.register("recording", "1 while what happens to views is recorded", self.recording.clone());
        r.register_with_unit("recorded", "Bytes recorded", Unit::Bytes, self.recorded.clone());
        r.register_with_unit("under_way", "Bytes of requests under way", Unit::Bytes, self.under_way.clone());
        r.register("pages_read", "Pages of the database read", self.pages_read.clone());
        r.register("looks_ahead", "Guesses of where a view will be that were read for", self.looks.clone());
        r.register(
            "looks_ahead_dropped",
            "Such guesses that became too old, or met what cannot be read",
            self.looks_dropped.clone(),
        );
        r.register_with_unit("looking_ahead", "Time that reading ahead took", Unit::Seconds, self.looking.clone());
        r.register("connections", "Open connections", self.connections.clone());
        r.register("silent_connections", "Connections ended for saying nothing", self.silent_connections.clone());
        r.register_with_unit("received", "Bytes received", Unit::Bytes, self.received.clone());
        r.register_with_unit("sent", "Bytes sent", Unit::Bytes, self.sent.clone());
    }

    /// A call that began to be answered after `took`. A refused one has its method's name only if that is known to
    /// exist, so that no client can make up names without end.
    pub(super) fn call(&self, method: &str, code: tonic::Code, took: Duration) {
        let method = self.name(method, code);
        let code = i32::from(code).unsigned_abs();
        self.totals[0].fetch_add(1, Ordering::Relaxed);
        self.totals[1].fetch_add(u64::from(code != 0), Ordering::Relaxed);
        self.calls.get_or_create(&CallLabels { method, code }).inc();
        self.call_seconds.observe(took.as_secs_f64());
    }

    fn name(&self, method: &str, code: tonic::Code) -> String {
        use tonic::Code::{PermissionDenied, ResourceExhausted, Unauthenticated, Unimplemented};
        let mut methods = self.methods.lock().unwrap_or_else(PoisonError::into_inner);
        let is_refused = matches!(code, Unimplemented | Unauthenticated | PermissionDenied | ResourceExhausted);
        if !is_refused && !methods.contains(method) {
            methods.insert(method.to_owned());
        }
        if methods.contains(method) { method.to_owned() } else { "unknown".to_owned() }
    }

    /// Lines answered: values of [`v1::Verdict`], and how many lines took exact arithmetic since the last time.
    pub(super) fn answered(&self, verdicts: &[i32], exact_lines: u64) {
        self.exact_lines.inc_by(exact_lines);
        let mut counts = [0_u64; 3];
        for verdict in verdicts {
            match v1::Verdict::try_from(*verdict) {
                Ok(v1::Verdict::Visible) => counts[0] += 1,
                Ok(v1::Verdict::Blocked) => counts[1] += 1,
                _ => counts[2] += 1,
            }
        }
        for (verdict, count) in ["visible", "blocked", "unknown"].into_iter().zip(counts) {
            self.verdicts.get_or_create(&VerdictLabels { verdict }).inc_by(count);
        }
    }

    /// A frame and its updates, `bytes` long, made in `took`.
    pub(super) fn frame(&self, bytes: usize, took: Duration, was_held_back: bool) {
        self.frames.inc();
        self.frame_bytes.inc_by(bytes as u64);
        self.held_back.inc_by(u64::from(was_held_back));
        self.frame_seconds.observe(took.as_secs_f64());
        self.frame_classes.observe(took.as_secs_f64());
    }

    /// What making a frame took.
    pub(super) fn refined(&self, splits: u64, merges: u64) {
        self.splits.inc_by(splits);
        self.merges.inc_by(merges);
    }

    /// The page for Prometheus.
    pub(super) fn page(&self, now: &Moment) -> String {
        let gauge = |gauge: &Gauge, value: u64| gauge.set(i64::try_from(value).unwrap_or(i64::MAX));
        gauge(&self.views, now.views);
        gauge(&self.verdict_watches, now.verdict_watches);
        gauge(&self.triangles, now.triangles);
        gauge(&self.exercises, now.exercises);
        gauge(&self.queue_length, now.queue_length as u64);
        gauge(&self.serving, now.is_serving.into());
        let recording = now.recording.as_ref();
        gauge(&self.recording, recording.is_some_and(|state| state.ended.is_none()).into());
        gauge(&self.recorded, recording.map_or(0, |state| state.bytes));
        gauge(&self.under_way, now.bytes_under_way);
        self.pages_read.inner().store(now.pages_read, Ordering::Relaxed);
        self.looks.inner().store(now.ahead.looks, Ordering::Relaxed);
        self.looks_dropped.inner().store(now.ahead.dropped, Ordering::Relaxed);
        self.looking.inner().store(now.ahead.took.as_secs_f64().to_bits(), Ordering::Relaxed);
        self.queue_age.set(now.queue_age.as_secs_f64());
        self.exact.set(exact_signs());
        let mut page = String::new();
        match encode(&mut page, &self.registry) {
            Ok(()) => page,
            Err(error) => format!("# the metrics could not be written: {error}\n# EOF\n"),
        }
    }

    /// The essentials, as far as they are counted here.
    pub(super) fn fill(&self, status: &mut v1::GetStatusResponse, now: &Moment) {
        let verdicts = |verdict| self.verdicts.get_or_create(&VerdictLabels { verdict }).get();
        let count = |gauge: i64| u64::try_from(gauge).unwrap_or(0);
        status.connections = count(self.connections.get());
        status.exercises = now.exercises;
        [status.calls, status.refused_calls] = self.totals.each_ref().map(|total| total.load(Ordering::Relaxed));
        status.frames = self.frames.get();
        status.frame_median_ms = 1e3 * self.frame_classes.quantile(0.5);
        status.frame_p99_ms = 1e3 * self.frame_classes.quantile(0.99);
        status.queue_age_ms = 1e3 * now.queue_age.as_secs_f64();
        status.visible = verdicts("visible");
        status.blocked = verdicts("blocked");
        status.unknown = verdicts("unknown");
        status.exact_signs = exact_signs();
        status.unsatisfied_lines = count(self.unsatisfied.get());
        status.received_bytes = self.received.get();
        status.sent_bytes = self.sent.get();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_in_their_class() {
        let classes = Classes::default();
        assert_eq!(classes.quantile(0.5), 0.0);
        (0..90).for_each(|_| classes.observe(3e-4));
        (0..10).for_each(|_| classes.observe(0.03));
        assert_eq!((classes.quantile(0.5), classes.quantile(0.9), classes.quantile(0.99)), (5e-4, 5e-4, 0.05));
        let slow = Classes::default();
        slow.observe(60.0);
        assert_eq!(slow.quantile(0.5), 10.0);
    }

    #[test]
    fn the_page_has_what_was_counted() {
        let metrics = Metrics::new();
        metrics.answered(&[v1::Verdict::Visible.into(), v1::Verdict::Blocked.into(), v1::Verdict::Visible.into()], 1);
        metrics.call("/made/up", tonic::Code::Unauthenticated, Duration::ZERO);
        metrics.call("/a/B", tonic::Code::NotFound, Duration::from_millis(3));
        metrics.call("/a/B", tonic::Code::ResourceExhausted, Duration::ZERO);
        metrics.frame(100, Duration::from_micros(70), true);
        metrics.refined(5, 3);
        let page = metrics.page(&Moment { views: 7, queue_age: Duration::from_millis(250), ..Moment::default() });
        for line in [
            "sightline_verdicts_total{verdict=\"visible\"} 2",
            "sightline_exact_lines_total 1",
            "sightline_splits_total 5",
            "sightline_merges_total 3",
            "sightline_calls_total{method=\"/a/B\",code=\"5\"} 1",
            "sightline_calls_total{method=\"/a/B\",code=\"8\"} 1",
            "sightline_calls_total{method=\"unknown\",code=\"16\"} 1",
            "sightline_frames_total 1",
            "sightline_frame_bytes_total 100",
            "sightline_frames_held_back_total 1",
            "sightline_views 7",
            "sightline_queue_age_seconds 0.25",
            "sightline_frame_seconds_bucket{le=\"0.0001\"} 1",
        ] {
            assert!(page.lines().any(|found| found == line), "{line} in\n{page}");
        }
    }
}
