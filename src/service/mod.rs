//! The server: gRPC, gRPC-Web and pages on one port; conversion, limits, status codes, health, metrics. The only module
//! with sockets beside `cli`.
//!
//! A call passes `connections` (counted), `admission` (its id, its caller's rights and rate), then its service.
//! Network threads only pass messages on: what computes or reads runs on threads of its own, in `turns`, many lines at
//! once on rayon's pool, and what views will need is read on one more, in `read_ahead`. A view is one task that owns one
//! [`crate::session::View`] and hands frames over one at a time, so a slow client holds one frame and no queue.
//! Nothing here decides anything about terrain, exercises or meshes.

mod access;
mod admission;
mod bodies;
mod clock;
pub mod config;
mod connections;
mod convert;
mod exercises;
mod followed;
mod health;
mod leases;
mod limits;
mod lines_of_sight;
mod operation;
mod origins;
mod pages;
mod read_ahead;
mod scenes;
mod serve;
mod status;
mod telemetry;
mod terrains;
mod turns;
mod verdicts;
mod viewer;
mod views;
mod wanted;
mod watches;

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use sightline_proto::v1;
use tokio::sync::{Mutex, Semaphore, watch};
use tonic::Status;

pub use access::{MAX_TOKENS, MIN_SECRET_BYTES, Role, Token, Tokens};
pub use clock::Clock;
pub use health::MAX_QUEUE_AGE;
pub use limits::Limits;
pub use read_ahead::{Ahead, Lookout, MAX_READ_AHEAD_S, ReadAhead};
pub use serve::{Options, Recording, ServeError, Tls, serve, serve_with};

use self::{
    health::Health,
    leases::Leases,
    limits::Accounts,
    telemetry::{Metrics, Moment},
    turns::Turns,
    watches::Watches,
};
use crate::{
    database::Database,
    exercise::Site,
    roam::Terrain,
    session::{
        Details, describe,
        journal::{Entry, Journal},
    },
    store::{ExerciseStore, StoreError},
    terrain::{HeightField, Posts, ReadError},
    wedgie::MemoryTerrain,
};

/// Greatest size of a request in bytes.
pub const MAX_REQUEST_BYTES: usize = 16 << 20;
/// Greatest number of lines of one batch.
pub const MAX_BATCH_LINES: usize = 250_000;
/// Greatest number of lines of one group in a stream of questions.
pub const MAX_STREAM_LINES: usize = 10_000;
/// Groups of one such stream that are computed or wait to be read.
pub const MAX_STREAM_GROUPS: usize = 8;
/// Greatest number of azimuths of one horizon.
pub const MAX_AZIMUTHS: usize = 3_600;
/// Greatest number of breaks of one profile.
pub const MAX_PROFILE_BREAKS: usize = 1_000_000;
/// Greatest number of stretches of one line, and of the ground under it.
pub const MAX_STRETCHES: usize = 100_000;
/// Greatest number of cells of one viewshed, counted in the square around a radius.
pub const MAX_VIEWSHED_CELLS: usize = 100_000_000;
/// Greatest number of points of one intervisibility matrix.
pub const MAX_MATRIX_POINTS: usize = 2_000;
/// Greatest number of positions of one request for heights.
pub const MAX_HEIGHTS: usize = 250_000;
/// Streams of answers under way at the same time: more would hold threads for clients that do not read.
pub const MAX_ANSWERING: usize = 64;
/// What a client is told when its call panicked.
const DEFECT: &str = "a defect of the server ended this call; its log tells more";
/// Greatest number of views of a server, unless it is told otherwise.
pub const MAX_VIEWS: usize = 1_000;
/// How long a client may take to say what view it wants.
const OPENING_TIME: Duration = Duration::from_secs(10);
/// How long calls under way may take to end once the server is told to stop.
const DRAINING_TIME: Duration = Duration::from_secs(5);
/// By how much pages are read ahead of views that move, unless a server is told otherwise.
const READ_AHEAD_TIME: Duration = Duration::from_millis(250);
/// A connection without a sign of life is asked for one after this time, and closed after as long again.
const KEEPALIVE_TIME: Duration = Duration::from_secs(15);

/// A terrain that can be served.
pub trait ServedTerrain: Terrain + 'static {
    /// Its scale and place.
    fn site(&self) -> Site;

    /// What clients are told of it beside that.
    fn details(&self) -> Result<Details, ReadError>;

    /// Pages read since it was opened; `None` where all of it is in memory, so that there is nothing to read ahead.
    fn pages_read(&self) -> Option<u64> {
        None
    }
}

impl ServedTerrain for Database {
    fn site(&self) -> Site {
        Site { scale: self.scale(), georeference: self.georeference() }
    }

    fn details(&self) -> Result<Details, ReadError> {
        let manifest = self.terrain();
        Ok(Details {
            version: self.version().to_vec(),
            height_range: [manifest.lowest, manifest.highest].map(f64::from),
            void_posts: manifest.void_posts,
        })
    }

    fn pages_read(&self) -> Option<u64> {
        Some(self.reads().pages)
    }
}

/// For tests: its version is empty.
impl ServedTerrain for MemoryTerrain {
    fn site(&self) -> Site {
        Site { scale: self.scale(), georeference: None }
    }

    fn details(&self) -> Result<Details, ReadError> {
        survey(self.field())
    }
}

/// Finds the range of heights and the number of voids by reading every post.
fn survey(field: &impl HeightField) -> Result<Details, ReadError> {
    let grid = field.grid();
    let mut posts = Posts::new(field);
    let mut details = Details { height_range: [f64::INFINITY, f64::NEG_INFINITY], ..Details::default() };
    for j in 0..grid.ny() {
        for i in 0..grid.nx() {
            let post = posts.at(sightline_proto::diamond::Post::new(i, j))?;
            if post.void {
                details.void_posts += 1;
            } else {
                details.height_range = [details.height_range[0].min(post.z), details.height_range[1].max(post.z)];
            }
        }
    }
    Ok(details)
}

/// What the services of one server share.
struct Shared<T> {
    terrain: Arc<T>,
    site: Site,
    description: v1::TerrainDescription,
    store: Box<dyn ExerciseStore>,
    /// Where what happens to views is written down, if it is.
    journal: Option<Arc<Journal>>,
    /// Held while an exercise changes, so that verdicts are computed once and epochs follow each other.
    changing: Mutex<()>,
    /// Counts changes of exercises: views look again when it moves.
    changes: watch::Sender<u64>,
    /// Work off the network threads.
    turns: Turns,
    /// Reads ahead of views that move, if somebody does.
    read_ahead: Option<ReadAhead<T>>,
    /// Permits for streams of answers.
    answering: Arc<Semaphore>,
    limits: Limits,
    accounts: Arc<Accounts>,
    tokens: Option<Tokens>,
    watches: Watches,
    leases: Arc<Leases>,
    metrics: Arc<Metrics>,
    health: Health,
    started: Instant,
    /// Calls so far, for their ids.
    calls: AtomicU64,
    /// Becomes true when the server is to stop.
    stopping: watch::Receiver<bool>,
}

impl<T: ServedTerrain> Shared<T> {
    fn new(terrain: Arc<T>, options: Options, stopping: watch::Receiver<bool>) -> Result<Self, ServeError> {
        let Options { limits, tokens, store, recording, read_ahead, clock, .. } = options;
        let (site, details) = (terrain.site(), terrain.details()?);
        let description = describe(&*terrain, &site, &details)?;
        let journal = recording.map(|recording| Arc::new(recording.begin(&details.version, &*store)));
        let turns = Turns::new(rayon::current_num_threads()).map_err(ServeError::Threads)?;
        let is_read_ahead = !read_ahead.is_zero() && terrain.pages_read().is_some();
        let read_ahead = is_read_ahead.then(|| ReadAhead::start(Arc::clone(&terrain), read_ahead, turns.watch()));
        Ok(Self {
            terrain,
            site,
            description,
            store,
            journal,
            changing: Mutex::new(()),
            changes: watch::Sender::new(0),
            turns,
            read_ahead: read_ahead.transpose().map_err(ServeError::Threads)?,
            answering: Arc::new(Semaphore::new(MAX_ANSWERING)),
            limits,
            accounts: Accounts::new(limits),
            tokens,
            watches: Watches::default(),
            leases: Leases::new(clock),
            metrics: Metrics::new(),
            health: Health::default(),
            started: Instant::now(),
            calls: AtomicU64::new(0),
            stopping,
        })
    }

    /// Runs `work` off the network threads, when its turn comes.
    async fn run<R: Send + 'static>(&self, work: impl FnOnce() -> R + Send + 'static) -> Result<R, Status> {
        self.turns.run(work).await
    }

    /// Takes notice of how something that was to be written ended.
    fn written<R>(&self, result: Result<R, StoreError>) -> Result<R, StoreError> {
        if let Err(error @ StoreError::Failed(_)) = &result {
            tracing::error!(%error, "an exercise could not be written");
            self.health.store(false);
        }
        result
    }

    /// Does something to an exercise of the store; if it went well, writes down what that was.
    fn keep<R, E>(&self, what: impl FnOnce() -> Entry, act: impl FnOnce() -> Result<R, E>) -> Result<R, E> {
        let Some(journal) = &self.journal else { return act() };
        let _order = journal.order();
        let done = act()?;
        journal.append(what());
        Ok(done)
    }

    /// What is wrong with the server.
    fn troubles(&self) -> Vec<String> {
        self.health.troubles(self.turns.queue().0)
    }

    /// What is there just now. Reads the store.
    fn moment(&self) -> Moment {
        let (views, triangles) = self.accounts.used();
        let (queue_age, queue_length) = self.turns.queue();
        Moment {
            views,
            verdict_watches: self.accounts.watches(),
            triangles,
            exercises: self.store.list().map_or(0, |exercises| exercises.len() as u64),
            queue_age,
            queue_length,
            is_serving: self.troubles().is_empty(),
            recording: self.journal.as_ref().map(|journal| journal.state()),
            bytes_under_way: self.accounts.bytes(),
            pages_read: self.terrain.pages_read().unwrap_or(0),
            ahead: self.read_ahead.as_ref().map(ReadAhead::done).unwrap_or_default(),
        }
    }
}

impl<T> Shared<T> {
    /// An id for a call that brought none.
    fn next_id(&self) -> String {
        format!("{:08x}", self.calls.fetch_add(1, Ordering::Relaxed))
    }
}

/// One of the services: a handle on what they share.
struct Service<T>(Arc<Shared<T>>);

impl<T> Clone for Service<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

/// The services whose health is told, and the empty name that stands for the server.
const SERVICE_NAMES: [&str; 6] = [
    "",
    "sightline.v1.OperationService",
    "sightline.v1.TerrainService",
    "sightline.v1.LineOfSightService",
    "sightline.v1.ExerciseService",
    "sightline.v1.SceneService",
];

/// Ends when the server is to stop.
async fn stopped(stopping: &mut watch::Receiver<bool>) {
    // An error means that the server is gone: the same.
    let _ = stopping.wait_for(|&stop| stop).await;
}
