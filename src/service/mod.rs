//! The gRPC services: conversion, limits, status codes. The only module with sockets beside `cli`.
//!
//! Network threads only pass messages on: what computes or reads runs on blocking threads, at most
//! `Shared::compute` at a time, and many lines at once on rayon's pool. A view is one task that owns one
//! [`crate::session::View`] and hands frames over one at a time, so a slow client holds one frame and no queue.
//! Nothing here decides anything about terrain, exercises or meshes.

mod convert;
mod exercises;
mod lines_of_sight;
mod scenes;
mod status;
mod terrains;
mod wanted;

use std::{future::Future, io, sync::Arc, thread, time::Duration};

use sightline_proto::v1::{
    self, exercise_service_server::ExerciseServiceServer, line_of_sight_service_server::LineOfSightServiceServer,
    scene_service_server::SceneServiceServer, terrain_service_server::TerrainServiceServer,
};
use thiserror::Error;
use tokio::{
    net::TcpListener,
    sync::{Mutex, Semaphore, watch},
    time::timeout,
};
use tonic::{
    Status,
    transport::{Server, server::TcpIncoming},
};

use crate::{
    database::Database,
    exercise::Site,
    roam::Terrain,
    session::{Details, describe},
    store::{ExerciseStore, MemoryStore},
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
/// A connection without a sign of life is asked for one after this time, and closed after as long again.
const KEEPALIVE_TIME: Duration = Duration::from_secs(15);

/// A terrain that can be served.
pub trait ServedTerrain: Terrain + 'static {
    /// Its scale and place.
    fn site(&self) -> Site;

    /// What clients are told of it beside that.
    fn details(&self) -> Result<Details, ReadError>;
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

/// Why a server could not be run.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The terrain cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The listener.
    #[error("the listening socket: {0}")]
    Listener(#[from] io::Error),
    /// The transport.
    #[error("the server's transport: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// The reflection service.
    #[error("the reflection service: {0}")]
    Reflection(String),
}

/// What the services of one server share.
struct Shared<T> {
    terrain: Arc<T>,
    site: Site,
    description: v1::TerrainDescription,
    store: Box<dyn ExerciseStore>,
    /// Held while an exercise changes, so that verdicts are computed once and epochs follow each other.
    changing: Mutex<()>,
    /// Counts changes of exercises: views look again when it moves.
    changes: watch::Sender<u64>,
    /// Permits for work off the network threads.
    compute: Arc<Semaphore>,
    /// Permits for streams of answers.
    answering: Arc<Semaphore>,
    limits: Limits,
    /// Permits for views.
    views: Arc<Semaphore>,
    /// Becomes true when the server is to stop.
    stopping: watch::Receiver<bool>,
}

impl<T: ServedTerrain> Shared<T> {
    fn new(terrain: Arc<T>, limits: Limits, stopping: watch::Receiver<bool>) -> Result<Self, ReadError> {
        let (site, details) = (terrain.site(), terrain.details()?);
        let description = describe(&*terrain, &site, &details)?;
        let threads = thread::available_parallelism().map_or(2, usize::from);
        Ok(Self {
            terrain,
            site,
            description,
            store: Box::new(MemoryStore::default()),
            changing: Mutex::new(()),
            changes: watch::Sender::new(0),
            compute: Arc::new(Semaphore::new(threads)),
            answering: Arc::new(Semaphore::new(MAX_ANSWERING)),
            limits,
            views: Arc::new(Semaphore::new(limits.views)),
            stopping,
        })
    }

    /// Runs `work` off the network threads, when its turn comes.
    async fn run<R: Send + 'static>(&self, work: impl FnOnce() -> R + Send + 'static) -> Result<R, Status> {
        let turn = Arc::clone(&self.compute).acquire_owned().await;
        let turn = turn.map_err(|_| Status::unavailable("the server is stopping"))?;
        let done = tokio::task::spawn_blocking(move || {
            let result = work();
            drop(turn);
            result
        });
        done.await.map_err(|_| Status::internal(DEFECT))
    }
}

/// One of the services: a handle on what they share.
struct Service<T>(Arc<Shared<T>>);

impl<T> Clone for Service<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

/// What a server allows all its clients together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Views at the same time.
    pub views: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { views: MAX_VIEWS }
    }
}

/// [`serve_with`] the default limits.
pub async fn serve<T: ServedTerrain>(
    listener: TcpListener,
    terrain: Arc<T>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    serve_with(listener, terrain, Limits::default(), shutdown).await
}

/// Serves `terrain` on `listener` until `shutdown` comes; then health says NOT_SERVING, views are told to go, calls
/// under way get some seconds to end, and the function returns.
pub async fn serve_with<T: ServedTerrain>(
    listener: TcpListener,
    terrain: Arc<T>,
    limits: Limits,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let (stop, stopping) = watch::channel(false);
    let shared = tokio::task::spawn_blocking({
        let stopping = stopping.clone();
        move || Shared::new(terrain, limits, stopping)
    });
    let shared = shared.await.map_err(|error| io::Error::other(error.to_string()))??;
    let service = Service(Arc::new(shared));
    let (health, health_service) = tonic_health::server::health_reporter();
    for name in SERVICE_NAMES {
        health.set_service_status(name, tonic_health::ServingStatus::Serving).await;
    }
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(v1::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        .map_err(|error| ServeError::Reflection(error.to_string()))?;
    let limit = MAX_REQUEST_BYTES;
    let router = Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE_TIME))
        .http2_keepalive_timeout(Some(KEEPALIVE_TIME))
        .add_service(health_service)
        .add_service(reflection)
        .add_service(TerrainServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(LineOfSightServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(ExerciseServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(SceneServiceServer::new(service).max_decoding_message_size(limit));
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    let told = async move {
        shutdown.await;
        tracing::info!("stopping");
        for name in SERVICE_NAMES {
            health.set_service_status(name, tonic_health::ServingStatus::NotServing).await;
        }
        let _ = stop.send(true);
    };
    let served = router.serve_with_incoming_shutdown(incoming, told);
    tokio::pin!(served);
    let mut stopping = stopping;
    tokio::select! {
        result = &mut served => result?,
        () = stopped(&mut stopping) => {
            // A client that holds its connection open may not keep the server.
            if let Ok(result) = timeout(DRAINING_TIME, served).await {
                result?;
            }
        }
    }
    Ok(())
}

/// The services whose health is told, and the empty name that stands for the server.
const SERVICE_NAMES: [&str; 5] = [
    "",
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
