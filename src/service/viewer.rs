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
    http::{HeaderMap, StatusCode, header},
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
        let says = |name, what: &str| {
            let values = asked.get_all(name).iter().filter_map(|value| value.to_str().ok());
            values
                .flat_map(|value| value.split(','))
                .any(|part| part.split(';').next().is_some_and(|p| p.trim() == what))
        };
        if says(header::IF_NONE_MATCH, tag) {
            return (StatusCode::NOT_MODIFIED, common).into_response();
        }
        let kind = [(header::CONTENT_TYPE, self.media_type)];
        if says(header::ACCEPT_ENCODING, "gzip") && !gzip.is_empty() {
            return (common, kind, [(header::CONTENT_ENCODING, "gzip")], gzip.clone()).into_response();
        }
        (common, kind, self.content).into_response()
    }
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
