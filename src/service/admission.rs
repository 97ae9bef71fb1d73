//! What each call passes before its service sees it: it gets an id, its caller is found, its right and its rate are
//! checked, the bytes of its request are counted, and how it began to be answered is counted and logged.

use std::{
    net::IpAddr,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, header},
    middleware::Next,
    response::Response,
};
use tonic::{Code, Status, body::Body, transport::server::TlsConnectInfo};
use tracing::Instrument;

use super::{
    ServedTerrain, Shared,
    access::{self, Caller},
    bodies::Hold,
    connections::Peer,
    limits::limited,
};

/// Header with the id of a call: the client's, or one that the server gives. It stands in the log and in the answer.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Longer ids of clients are replaced.
const MAX_ID_LENGTH: usize = 64;

/// The layer around the gRPC services.
pub(super) async fn admit<T: ServedTerrain>(
    State(shared): State<Arc<Shared<T>>>,
    mut request: Request,
    next: Next,
) -> Response {
    let began = Instant::now();
    let path = request.uri().path().to_owned();
    let id = request_id(request.headers(), || shared.next_id());
    let caller = caller(&shared, &request);
    let client = caller.as_ref().map_or("", |caller| &caller.name);
    let span = tracing::info_span!("call", method = path, id = id.to_str().unwrap_or_default(), client);
    let admitted = caller.and_then(|caller| {
        shared.accounts.call(&caller.name, began)?;
        let hold = Hold::new(shared.accounts.bytes_seat(&caller.name));
        request.extensions_mut().insert(caller);
        let limit = Duration::from_secs_f64(shared.limits.receiving_s);
        Ok((request.map(|body| hold.count(body, limit)), hold))
    });
    let mut response = match admitted {
        Ok((request, hold)) => {
            let response = next.run(request).instrument(span.clone()).await;
            hold.answered();
            response
        }
        Err(status) => answer(&status),
    };
    let mut code = code_of(response.headers());
    if code == Code::OutOfRange && is_oversize(response.headers()) {
        response = answer(&oversize(shared.limits.request_bytes));
        code = Code::ResourceExhausted;
    }
    shared.health.observe(code);
    shared.metrics.call(&path, code, began.elapsed());
    span.in_scope(|| match code {
        Code::Ok => tracing::debug!(took_us = began.elapsed().as_micros() as u64, "answered"),
        code => tracing::info!(?code, "refused"),
    });
    response.headers_mut().insert(REQUEST_ID, id);
    response
}

/// Who calls, if they may.
pub(super) fn caller<T>(shared: &Shared<T>, request: &Request) -> Result<Caller, Status> {
    let authorization = request.headers().get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
    access::admit(shared.tokens.as_ref(), request.uri().path(), authorization, address(request))
}

/// Who asks for what is open to everyone: a network address.
pub(super) fn visitor(request: &Request) -> Caller {
    Caller::by_address(address(request))
}

/// The other end of the connection.
fn peer(request: &Request) -> Option<&Peer> {
    let extensions = request.extensions();
    let secured = || extensions.get::<TlsConnectInfo<Peer>>().map(TlsConnectInfo::get_ref);
    extensions.get::<Peer>().or_else(secured)
}

fn address(request: &Request) -> Option<IpAddr> {
    peer(request).map(Peer::ip)
}

/// The layer around everything: whatever is asked for, the connection is no silent one.
pub(super) async fn hear(request: Request, next: Next) -> Response {
    if let Some(peer) = peer(&request) {
        peer.called();
    }
    next.run(request).await
}

fn request_id(headers: &HeaderMap, new: impl FnOnce() -> String) -> HeaderValue {
    let sound = |value: &&HeaderValue| {
        value.len() <= MAX_ID_LENGTH && !value.is_empty() && value.as_bytes().iter().all(u8::is_ascii_graphic)
    };
    headers
        .get(REQUEST_ID)
        .filter(sound)
        .cloned()
        .unwrap_or_else(|| HeaderValue::from_str(&new()).unwrap_or_else(|_| HeaderValue::from_static("none")))
}

fn answer(status: &Status) -> Response {
    status.clone().into_http::<Body>().map(axum::body::Body::new)
}

/// The code with which a call was refused at once; OK for those that began to be answered.
fn code_of(headers: &HeaderMap) -> Code {
    headers.get("grpc-status").map_or(Code::Ok, |value| Code::from_bytes(value.as_bytes()))
}

/// Whether the transport refused a message for its length.
fn is_oversize(headers: &HeaderMap) -> bool {
    headers.get("grpc-message").is_some_and(|value| {
        let text = value.to_str().unwrap_or_default();
        text.contains("message%20length%20too%20large") || text.contains("message length too large")
    })
}

fn oversize(limit: usize) -> Status {
    let limit = limit as u64;
    limited("request_bytes", "bytes and more in one request", limit, limit)
}

/// [`oversize`] in the place of the transport's words about a message of a stream.
pub(super) fn explained(status: Status, limit: usize) -> Status {
    let is_oversize = status.code() == Code::OutOfRange && status.message().contains("message length too large");
    if is_oversize { oversize(limit) } else { status }
}
