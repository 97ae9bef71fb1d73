//! The viewer at `/`: three files that are part of the program, built from `clients/web`, so that a machine with Rust alone
//! serves it.
//!
//! Their names never change, and browsers ask each time whether theirs is still right: the entity tag is a hash of the
//! content, so after an upgrade nobody keeps an old one, and else nothing is sent twice. What the page may do is said to the
//! browser by a policy: scripts, styles and calls from this server only, and no frame around it.
//!
//! A browser cannot send a token with an address that somebody types, so the files are for everyone; the calls that the page
//! makes pass the admission of all calls, and it asks for a token when they are refused. Files count as calls against the
//! rates of a network address.

use std::{
    io::Write,
    sync::{Arc, OnceLock},
    time::Instant,
};

use axum::{
    Router,
    body::Bytes,
    extract::{Request, State},
    http::{HeaderMap, HeaderName, StatusCode, header},
    response::{IntoResponse, Response},
    routing::get,
};
use flate2::{Compression, write::GzEncoder};
use xxhash_rust::xxh3::xxh3_64;

use super::{ServedTerrain, Shared, admission};

/// What the browser is to allow the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// A file of the viewer.
struct File {
    path: &'static str,
    media_type: &'static str,
    content: &'static [u8],
    packed: OnceLock<Packed>,
}

/// What is found out of a file when it is first asked for.
#[derive(Clone)]
struct Packed {
    tag: String,
    gzip: Bytes,
}

static FILES: [File; 3] = [
    File::new("/", "text/html; charset=utf-8", include_bytes!("../../clients/web/dist/index.html")),
    File::new("/app.js", "text/javascript; charset=utf-8", include_bytes!("../../clients/web/dist/app.js")),
    File::new("/app.css", "text/css; charset=utf-8", include_bytes!("../../clients/web/dist/app.css")),
];

impl File {
    const fn new(path: &'static str, media_type: &'static str, content: &'static [u8]) -> Self {
        Self { path, media_type, content, packed: OnceLock::new() }
    }

    fn packed(&self) -> &Packed {
        self.packed.get_or_init(|| {
            let mut packer = GzEncoder::new(Vec::new(), Compression::default());
            // Memory takes whatever is written; an empty packing is sent to nobody.
            let gzip = packer.write_all(self.content).and_then(|()| packer.finish()).unwrap_or_default();
            // Weak: the same whether packed or not.
            Packed { tag: format!("W/\"{:016x}\"", xxh3_64(self.content)), gzip: gzip.into() }
        })
    }

    fn answer(&self, asked: &HeaderMap) -> Response {
        let Packed { tag, gzip } = self.packed();
        let common = [
            (header::ETAG, tag.as_str()),
            (header::CACHE_CONTROL, "no-cache"),
            (header::VARY, "accept-encoding"),
            (header::CONTENT_SECURITY_POLICY, POLICY),
            (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
            (header::REFERRER_POLICY, "no-referrer"),
        ];
        if parts(asked, header::IF_NONE_MATCH).any(|part| part == tag) {
            return (StatusCode::NOT_MODIFIED, common).into_response();
        }
        let kind = [(header::CONTENT_TYPE, self.media_type)];
        if takes_gzip(asked) && !gzip.is_empty() {
            return (common, kind, [(header::CONTENT_ENCODING, "gzip")], gzip.clone()).into_response();
        }
        (common, kind, self.content).into_response()
    }
}

/// The parts of a header that is a list.
fn parts(asked: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let values = asked.get_all(name).into_iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',').map(str::trim))
}

/// Whether the browser takes gzip: it names it, or everything, and not with a weight of 0 (RFC 9110, section 12.5.3).
fn takes_gzip(asked: &HeaderMap) -> bool {
    let weight = |coding: &str| {
        parts(asked, header::ACCEPT_ENCODING).find_map(|part| {
            let (name, parameters) = part.split_once(';').unwrap_or((part, ""));
            let weight = parameters.trim().strip_prefix("q=").map_or(Ok(1.0), str::parse::<f32>);
            name.trim().eq_ignore_ascii_case(coding).then(|| weight.unwrap_or(0.0))
        })
    };
    weight("gzip").or_else(|| weight("*")).is_some_and(|weight| weight > 0.0)
}

/// Adds the viewer to the pages.
pub(super) fn add_to<T: ServedTerrain>(router: Router, shared: &Arc<Shared<T>>) -> Router {
    FILES.iter().fold(router, |router, file| {
        let serve = move |State(shared): State<Arc<Shared<T>>>, request: Request| async move {
            let visitor = admission::visitor(&request);
            if let Err(status) = shared.accounts.call(&visitor.name, Instant::now()) {
                return (StatusCode::TOO_MANY_REQUESTS, format!("{}\n", status.message())).into_response();
            }
            let headers = request.headers().clone();
            // The first answer packs the file, which takes some hundredths of a second.
            let answered = tokio::task::spawn_blocking(move || file.answer(&headers)).await;
            answered.unwrap_or_else(|_| StatusCode::INTERNAL_SERVER_ERROR.into_response())
        };
        router.route(file.path, get(serve).with_state(Arc::clone(shared)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_sent_to_those_who_take_it() {
        for (encodings, takes) in [
            (&["gzip"][..], true),
            (&["br, gzip;q=0.5"], true),
            (&["br", "GZip"], true),
            (&["*"], true),
            (&["identity;q=1, *;q=0.1"], true),
            (&["gzip;q=0"], false),
            (&["gzip; q=0.0, *"], false),
            (&["*;q=0"], false),
            (&["br, zstd"], false),
            (&["gzip;q=much"], false),
            (&[], false),
        ] {
            let mut asked = HeaderMap::new();
            for encoding in encodings {
                asked.append(header::ACCEPT_ENCODING, encoding.parse().unwrap());
            }
            assert_eq!(takes_gzip(&asked), takes, "{encodings:?}");
        }
    }
}
