//! Pages of other origins that may call: what browsers call CORS. None may unless the operator names them.
//!
//! The viewer at `/` is of the server's own origin and needs none of this. Whoever is no browser is not stopped by it: it
//! protects people whose browser shows somebody else's page, not the server.

use std::time::Duration;

use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use tower_http::cors::{AllowOrigin, CorsLayer};

use super::admission::REQUEST_ID;

/// Stands for every origin.
const ALL: &str = "*";
/// How long a browser may remember what is allowed.
const MAX_AGE: Duration = Duration::from_secs(3_600);
/// What gRPC-Web sends and receives beside what browsers allow anyway.
const ASKED: [HeaderName; 6] = [
    header::CONTENT_TYPE,
    header::AUTHORIZATION,
    HeaderName::from_static("x-grpc-web"),
    HeaderName::from_static("x-user-agent"),
    HeaderName::from_static("grpc-timeout"),
    REQUEST_ID,
];
const ANSWERED: [HeaderName; 3] =
    [HeaderName::from_static("grpc-status"), HeaderName::from_static("grpc-message"), REQUEST_ID];

/// Says which of the origins is none.
pub(super) fn check(origins: &[String]) -> Result<(), String> {
    let is_origin = |text: &str| {
        let uri = text.parse::<Uri>().ok();
        let plain = uri.and_then(|uri| Some(format!("{}://{}", uri.scheme_str()?, uri.authority()?)));
        text == ALL || plain.is_some_and(|plain| plain == text)
    };
    match origins.iter().find(|origin| !is_origin(origin)) {
        Some(bad) => {
            Err(format!("access.origins: '{bad}' is no origin such as https://viewer.example:8443, nor '{ALL}'"))
        }
        None => Ok(()),
    }
}

/// The layer that answers browsers, if there is any origin to allow.
pub(super) fn layer(origins: &[String]) -> Result<Option<CorsLayer>, String> {
    check(origins)?;
    if origins.is_empty() {
        return Ok(None);
    }
    let allowed = match origins.iter().any(|origin| origin == ALL) {
        true => AllowOrigin::any(),
        false => AllowOrigin::list(origins.iter().filter_map(|origin| HeaderValue::from_str(origin).ok())),
    };
    let layer = CorsLayer::new().allow_origin(allowed).allow_methods([Method::POST]).allow_headers(ASKED);
    Ok(Some(layer.expose_headers(ANSWERED).max_age(MAX_AGE)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_scheme_and_host_alone() {
        let list = |text: &str| vec!["https://good.example".to_owned(), text.to_owned()];
        for good in ["http://127.0.0.1:8080", "https://viewer.example", "*"] {
            assert_eq!(check(&list(good)), Ok(()), "{good}");
        }
        for bad in ["", "viewer.example", "https://viewer.example/", "https://viewer.example/page", "https://", "a b"] {
            assert!(check(&list(bad)).is_err_and(|why| why.contains(&format!("'{bad}'"))), "{bad}");
        }
    }
}
