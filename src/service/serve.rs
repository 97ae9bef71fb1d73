//! One server on one port: gRPC, gRPC-Web, the viewer and pages; its start, its health and its end.

use std::{future::Future, io, sync::Arc, time::Duration};

use axum::{middleware, routing::get};
use sightline_proto::v1::{
    self, exercise_service_server::ExerciseServiceServer, line_of_sight_service_server::LineOfSightServiceServer,
    operation_service_server::OperationServiceServer, scene_service_server::SceneServiceServer,
    terrain_service_server::TerrainServiceServer,
};
use thiserror::Error;
use tokio::{
    net::TcpListener,
    sync::watch,
    time::{interval, timeout},
};
use tonic::{
    service::Routes,
    transport::{Certificate, Identity, Server, ServerTlsConfig},
};
use tonic_health::{ServingStatus, server::HealthReporter};
use tonic_web::GrpcWebLayer;

use super::{
    Clock, DRAINING_TIME, KEEPALIVE_TIME, Limits, READ_AHEAD_TIME, SERVICE_NAMES, ServedTerrain, Service, Shared,
    Tokens, admission, connections, health::LOOKING_TIME, leases, origins, pages, stopped, viewer,
};
use crate::{
    session::journal::{Journal, JournalEnd},
    store::{ExerciseStore, MemoryStore},
    terrain::ReadError,
};

/// How long a handshake of TLS may take.
const HANDSHAKE_TIME: Duration = Duration::from_secs(10);
/// Streams of one connection at the same time.
const MAX_STREAMS: u32 = 1_000;
/// Bytes of headers of one request.
const MAX_HEADER_BYTES: u32 = 16 << 10;

/// Certificates, as PEM.
#[derive(Clone)]
pub struct Tls {
    /// The server's certificate and those between it and an authority.
    pub certificate: Vec<u8>,
    /// Its key.
    pub key: Vec<u8>,
    /// The authorities one of which must have signed a client's certificate; without them none is asked for.
    pub client_authorities: Option<Vec<u8>>,
}

/// Where and how far what happens is recorded, so that it can be replayed.
pub struct Recording {
    /// Gets the journal (`session::journal`), one record at a time.
    pub sink: Box<dyn io::Write + Send>,
    /// Greatest number of its bytes. When it is reached the recording ends, and the server goes on.
    pub limit_bytes: u64,
}

impl Recording {
    /// The journal, with the exercises that are there already.
    pub(super) fn begin(self, terrain: &[u8], store: &dyn ExerciseStore) -> Journal {
        let end = Box::new(|why: &JournalEnd| match why {
            JournalEnd::Full(_) => tracing::warn!("{why}"),
            JournalEnd::Failed(_) => tracing::error!("{why}"),
        });
        let journal = Journal::begin(self.sink, self.limit_bytes, terrain, end);
        for stored in store.list().unwrap_or_default() {
            journal.restored(&stored.exercise);
        }
        journal
    }
}

/// How a server is run.
pub struct Options {
    /// What it allows.
    pub limits: Limits,
    /// Who may call; without tokens everyone.
    pub tokens: Option<Tokens>,
    /// Certificates; without them it speaks in the clear.
    pub tls: Option<Tls>,
    /// Where exercises are kept.
    pub store: Box<dyn ExerciseStore>,
    /// Whether what happens is recorded.
    pub recording: Option<Recording>,
    /// How long calls under way may take to end once the server is told to stop.
    pub draining_time: Duration,
    /// By how much pages are read ahead of views that move; not at all if it is nothing.
    pub read_ahead: Duration,
    /// By which leases run out.
    pub clock: Clock,
    /// Other origins whose pages may call, such as `https://viewer.example`; `*`: all.
    pub origins: Vec<String>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            tokens: None,
            tls: None,
            store: Box::<MemoryStore>::default(),
            recording: None,
            draining_time: DRAINING_TIME,
            read_ahead: READ_AHEAD_TIME,
            clock: Clock::default(),
            origins: Vec::new(),
        }
    }
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
    /// The threads that compute.
    #[error("starting a thread that computes or reads: {0}; the system's limit of threads or memory may be reached")]
    Threads(io::Error),
    /// The transport.
    #[error("the server's transport: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// Certificates or keys.
    #[error("the certificate, its key or the clients' authorities: {0}")]
    Tls(String),
    /// An origin that is none.
    #[error("{0}")]
    Origin(String),
    /// The reflection service.
    #[error("the reflection service: {0}")]
    Reflection(String),
}

/// [`serve_with`] the default options.
pub async fn serve<T: ServedTerrain>(
    listener: TcpListener,
    terrain: Arc<T>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    serve_with(listener, terrain, Options::default(), shutdown).await
}

/// Serves `terrain` on `listener` until `shutdown` comes; then health says NOT_SERVING, views are told to go, calls
/// under way get some seconds to end, and the function returns.
pub async fn serve_with<T: ServedTerrain>(
    listener: TcpListener,
    terrain: Arc<T>,
    mut options: Options,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let (tls, origins) = (options.tls.take(), std::mem::take(&mut options.origins));
    let (limits, draining_time) = (options.limits, options.draining_time);
    let (stop, stopping) = watch::channel(false);
    let heard = stopping.clone();
    let shared = tokio::task::spawn_blocking(move || Shared::new(terrain, options, heard));
    let shared = Arc::new(shared.await.map_err(|error| io::Error::other(error.to_string()))??);
    let (reporter, routes) = routes(&shared, &origins)?;
    // Told before anybody can ask.
    report(&reporter, true).await;
    let looking = tokio::spawn(look_after(Arc::clone(&shared), reporter.clone()));
    let leasing = tokio::spawn(leases::look_after(Arc::clone(&shared)));
    let mut server = Server::builder();
    if let Some(tls) = tls {
        server = server.tls_config(tls.config()).map_err(|error| ServeError::Tls(root_cause(&error)))?;
    }
    let router = server
        .accept_http1(true)
        .http2_keepalive_interval(Some(KEEPALIVE_TIME))
        .http2_keepalive_timeout(Some(KEEPALIVE_TIME))
        .max_concurrent_streams(MAX_STREAMS)
        .http2_max_header_list_size(MAX_HEADER_BYTES)
        .add_routes(routes);
    let incoming = connections::accept(
        listener,
        limits.connections,
        Duration::from_secs_f64(limits.silence_s),
        Arc::clone(&shared.metrics),
    );
    let told = {
        let shared = Arc::clone(&shared);
        async move {
            shutdown.await;
            tracing::info!("stopping");
            shared.health.drain();
            report(&reporter, false).await;
            let _ = stop.send(true);
        }
    };
    let served = router.serve_with_incoming_shutdown(incoming, told);
    tokio::pin!(served);
    let mut stopping = stopping;
    let result = tokio::select! {
        result = &mut served => result,
        // A client that holds its connection open may not keep the server.
        () = stopped(&mut stopping) => timeout(draining_time, served).await.unwrap_or(Ok(())),
    };
    looking.abort();
    leasing.abort();
    if let Some(journal) = &shared.journal {
        journal.finish();
    }
    Ok(result?)
}

impl Tls {
    fn config(self) -> ServerTlsConfig {
        let identity = Identity::from_pem(self.certificate, self.key);
        let config = ServerTlsConfig::new().identity(identity).timeout(HANDSHAKE_TIME);
        match self.client_authorities {
            Some(authorities) => config.client_ca_root(Certificate::from_pem(authorities)),
            None => config,
        }
    }
}

fn root_cause(error: &dyn std::error::Error) -> String {
    let mut last = error;
    while let Some(source) = last.source() {
        last = source;
    }
    last.to_string()
}

/// Everything that is served, the health service with its reporter included.
fn routes<T: ServedTerrain>(
    shared: &Arc<Shared<T>>,
    origins: &[String],
) -> Result<(HealthReporter, Routes), ServeError> {
    let service = Service(Arc::clone(shared));
    let (reporter, health) = tonic_health::server::health_reporter();
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(v1::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        .map_err(|error| ServeError::Reflection(error.to_string()))?;
    let limit = shared.limits.request_bytes;
    let grpc = Routes::new(health)
        .add_service(reflection)
        .add_service(TerrainServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(LineOfSightServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(ExerciseServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(SceneServiceServer::new(service.clone()).max_decoding_message_size(limit))
        .add_service(OperationServiceServer::new(service).max_decoding_message_size(limit));
    let grpc = grpc
        .into_axum_router()
        .layer(middleware::from_fn_with_state(Arc::clone(shared), admission::admit::<T>))
        .layer(GrpcWebLayer::new());
    let grpc = match origins::layer(origins).map_err(ServeError::Origin)? {
        Some(layer) => grpc.layer(layer),
        None => grpc,
    };
    // What comes after the layers is outside of them.
    let router = grpc
        .route("/healthz", get(pages::healthz::<T>).with_state(Arc::clone(shared)))
        .route("/metrics", get(pages::metrics::<T>).with_state(Arc::clone(shared)))
        .fallback(pages::unknown);
    let router = viewer::add_to(router, shared).layer(middleware::from_fn(admission::hear));
    Ok((reporter, router.into()))
}

async fn report(reporter: &HealthReporter, is_serving: bool) {
    let status = if is_serving { ServingStatus::Serving } else { ServingStatus::NotServing };
    for name in SERVICE_NAMES {
        reporter.set_service_status(name, status).await;
    }
}

/// Looks at the health of the server now and again, and tries a store that could not be written.
async fn look_after<T: ServedTerrain>(shared: Arc<Shared<T>>, reporter: HealthReporter) {
    let mut was_serving = true;
    let mut clock = interval(LOOKING_TIME);
    loop {
        clock.tick().await;
        if shared.health.is_store_in_doubt() {
            let store = Arc::clone(&shared);
            let is_writable = tokio::task::spawn_blocking(move || store.store.probe().is_ok()).await;
            shared.health.store(is_writable.unwrap_or(false));
        }
        let troubles = shared.troubles();
        let is_serving = troubles.is_empty();
        if was_serving != is_serving {
            was_serving = is_serving;
            report(&reporter, is_serving).await;
            if !is_serving {
                tracing::warn!(?troubles, "not serving");
            }
        }
    }
}
