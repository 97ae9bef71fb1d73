//! The pages beside the services and the viewer, on the same port: health, and metrics.

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use tonic::{Code, Status, body::Body};

use super::{ServedTerrain, Shared, admission};

/// What Prometheus expects.
const METRICS_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// `ok`, or what is wrong with status 503.
pub(super) async fn healthz<T: ServedTerrain>(State(shared): State<Arc<Shared<T>>>) -> Response {
    let troubles = shared.troubles();
    if troubles.is_empty() {
        return "ok\n".into_response();
    }
    (StatusCode::SERVICE_UNAVAILABLE, troubles.join("\n") + "\n").into_response()
}

/// The metrics, for whoever may see them.
pub(super) async fn metrics<T: ServedTerrain>(State(shared): State<Arc<Shared<T>>>, request: Request) -> Response {
    if let Err(status) = admission::caller(&shared, &request) {
        let code =
            if status.code() == Code::Unauthenticated { StatusCode::UNAUTHORIZED } else { StatusCode::FORBIDDEN };
        return (code, format!("{}\n", status.message())).into_response();
    }
    // Exercises are counted in the store, which may have to be read.
    let inner = Arc::clone(&shared);
    let page = tokio::task::spawn_blocking(move || inner.metrics.page(&inner.moment())).await;
    match page {
        Ok(page) => ([(header::CONTENT_TYPE, METRICS_TYPE)], page).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// Whatever else is asked for.
pub(super) async fn unknown(request: Request) -> Response {
    let kind = request.headers().get(header::CONTENT_TYPE).map_or(&[][..], |value| value.as_bytes());
    if kind.starts_with(b"application/grpc") {
        let status = Status::unimplemented(format!("{} is no method of this server", request.uri().path()));
        return status.into_http::<Body>().map(axum::body::Body::new);
    }
    (StatusCode::NOT_FOUND, "there is no such page; see /\n").into_response()
}
