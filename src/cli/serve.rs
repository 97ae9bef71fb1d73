//! `sightline serve`: the server on a database.

use std::{
    io::{ErrorKind, IsTerminal, stderr},
    net::SocketAddr,
    path::PathBuf,
    sync::Arc,
};

use serde_json::json;
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

use super::{Context, Failure, info};
use crate::service;

/// Serve a database: lines of sight, exercises and scene streams over gRPC.
///
/// Ctrl-C or SIGTERM stops it: health says NOT_SERVING, views are closed, calls under way get some seconds to end.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// The address to listen on; port 0 takes any free one.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7410")]
    listen: String,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        start_log(context);
        let database = Arc::new(info::open(&self.database)?);
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
        let runtime = runtime.map_err(|error| Failure::environment("starting threads", error))?;
        runtime.block_on(async {
            let (listener, address) = bind(&self.listen).await?;
            let stop = stop_signal()?;
            if context.json {
                outln!("{}", json!({ "address": address.to_string() }));
            } else {
                outln!("serving {} on {address}", self.database.display());
            }
            let served = service::serve(listener, database, stop).await;
            served.map_err(|error| Failure::environment("serving", error))
        })
    }
}

/// Opens the listening socket, and says what address it has.
pub(super) async fn bind(listen: &str) -> Result<(TcpListener, SocketAddr), Failure> {
    let refused = |error: std::io::Error| match error.kind() {
        ErrorKind::InvalidInput => Failure::Usage(format!("--listen {listen}: not an address with a port")),
        ErrorKind::AddrInUse => Failure::Environment(format!(
            "{listen} is taken: another server may be running there; stop it or give another --listen"
        )),
        _ => Failure::environment(format_args!("listening on {listen}"), error),
    };
    let listener = TcpListener::bind(listen).await.map_err(refused)?;
    let address = listener.local_addr().map_err(refused)?;
    Ok((listener, address))
}

/// Ends at Ctrl-C or SIGTERM. Both are caught from the moment that this returns, before anything is awaited: whoever
/// reads the address may send one at once.
pub(super) fn stop_signal() -> Result<impl Future<Output = ()> + Send + 'static, Failure> {
    #[cfg(unix)]
    let mut signals = {
        use tokio::signal::unix::{SignalKind, signal};
        let caught = |kind| signal(kind).map_err(|error| Failure::environment("listening for signals", error));
        [caught(SignalKind::interrupt())?, caught(SignalKind::terminate())?]
    };
    Ok(async move {
        #[cfg(unix)]
        {
            let [interrupted, terminated] = &mut signals;
            tokio::select! {
                _ = interrupted.recv() => {}
                _ = terminated.recv() => {}
            }
        }
        #[cfg(not(unix))]
        let _ = tokio::signal::ctrl_c().await;
    })
}

/// Sends the log to standard error; `RUST_LOG` chooses what is in it.
pub(super) fn start_log(context: &Context) {
    let default = if context.quiet { "warn" } else { "info" };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(stderr).with_ansi(stderr().is_terminal());
    // Only one log a process: a second is the first one's.
    let _ = log.try_init();
}
