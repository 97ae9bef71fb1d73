//! What an operator asks.

use std::sync::Arc;

use sightline_proto::v1::{self, operation_service_server::OperationService};
use tonic::{Request, Response, Status};

use super::{ServedTerrain, Service, Shared};
use crate::session::journal::JournalState;

#[tonic::async_trait]
impl<T: ServedTerrain> OperationService for Service<T> {
    async fn get_status(&self, _: Request<v1::GetStatusRequest>) -> Result<Response<v1::GetStatusResponse>, Status> {
        let shared = Arc::clone(&self.0);
        // Not in turn: an operator asks when there are none left.
        let status = tokio::task::spawn_blocking(move || status(&shared)).await;
        status.map(Response::new).map_err(|_| Status::internal(super::DEFECT))
    }
}

fn status<T: ServedTerrain>(shared: &Shared<T>) -> v1::GetStatusResponse {
    let now = shared.moment();
    let limits = &shared.limits;
    let limit = |name: &str, used, limit| v1::LimitUse { name: name.into(), used, limit };
    let mut status = v1::GetStatusResponse {
        version: env!("CARGO_PKG_VERSION").into(),
        uptime_s: shared.started.elapsed().as_secs_f64(),
        serving: now.is_serving,
        troubles: shared.troubles(),
        ..Default::default()
    };
    shared.metrics.fill(&mut status, &now);
    status.limits = vec![
        limit("connections", status.connections, limits.connections as u64),
        limit("views", now.views, limits.views as u64),
        limit("verdict_watches", now.verdict_watches, limits.verdict_watches as u64),
        limit("triangles", now.triangles, limits.triangles),
        limit("bytes_under_way", now.bytes_under_way, limits.bytes_under_way),
        limit("exercises", now.exercises, crate::store::MAX_EXERCISES as u64),
    ];
    status.recording = now.recording.map(|JournalState { bytes, limit_bytes, ended }| v1::RecordingState {
        bytes,
        limit_bytes,
        ended: ended.unwrap_or_default(),
    });
    status
}
