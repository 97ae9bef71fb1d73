//! `sightline serve`: the server on a database.

use std::{
    io::{ErrorKind, IsTerminal, stderr},
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
    time::{SystemTime, UNIX_EPOCH},
};

use serde_json::json;
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

use super::{Context, Failure, info};
use crate::{
    database::{Database, OpenOptions},
    service::{
        self, Options, Recording, ServedTerrain, Tls, Tokens,
        config::{Config, LogLayout},
    },
    store::{DiskStore, ExerciseStore},
};

/// Serve a database: lines of sight, exercises and scene streams over gRPC, gRPC-Web and pages on one port.
///
/// A setting is taken from its flag, else from the environment (SIGHTLINE__LIMITS__VIEWS for `limits.views`), else from
/// the file of --config, else it has its default; --print-config shows the outcome. Ctrl-C or SIGTERM stops the server:
/// health says NOT_SERVING, views are closed, calls under way get some seconds to end.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB", required_unless_present = "print_config")]
    database: Option<PathBuf>,
    /// The address to listen on; port 0 takes any free one [default: 127.0.0.1:7410].
    #[arg(long, value_name = "ADDR")]
    listen: Option<String>,
    /// A file of settings, TOML.
    #[arg(long, value_name = "F")]
    config: Option<PathBuf>,
    /// Keep exercises in this file, so that they are there when the server is started anew; made when there is none.
    #[arg(long, value_name = "F")]
    state: Option<String>,
    /// Record all that happens to views in this new file, so that `sightline replay` can make every frame anew; in a
    /// folder, each start makes a file of its own, named by the time.
    #[arg(long, value_name = "F")]
    record: Option<String>,
    /// Greatest size of that file in MiB; then the recording ends, and the server goes on [default: 1024].
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(1..))]
    record_limit: Option<u32>,
    /// Memory for pages of the database in MiB; what does not fit is read again when it is needed [default: 256].
    #[arg(long, value_name = "MIB")]
    page_cache: Option<u32>,
    /// Read pages ahead of views that move, for where they will be in so many seconds; 0 does not [default: 0.25].
    #[arg(long, value_name = "S")]
    read_ahead: Option<f64>,
    /// Print all settings as they are, in the form of such a file, and stop.
    #[arg(long)]
    print_config: bool,
}

impl Args {
    fn settings(&self) -> Result<Config, Failure> {
        let read =
            |path: &PathBuf| std::fs::read_to_string(path).map_err(|error| Failure::input(path.display(), error));
        let text = self.config.as_ref().map(read).transpose()?;
        let environment = std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value)));
        let environment = environment.map(|(name, value)| (name, value.to_string_lossy().into_owned()));
        let source = self.config.as_ref().map_or("settings".into(), |path| path.display().to_string());
        let mut config = Config::read(text.as_deref(), environment).map_err(|error| Failure::input(source, error))?;
        if let Some(listen) = &self.listen {
            config.listen.clone_from(listen);
        }
        if let Some(state) = &self.state {
            config.state.clone_from(state);
        }
        if let Some(record) = &self.record {
            config.record.clone_from(record);
        }
        config.record_limit_mib = self.record_limit.unwrap_or(config.record_limit_mib);
        config.page_cache_mib = self.page_cache.unwrap_or(config.page_cache_mib);
        if let Some(seconds) = self.read_ahead {
            config.read_ahead_s = seconds;
            config.check().map_err(|error| Failure::Usage(format!("--read-ahead: {error}")))?;
        }
        Ok(config)
    }

    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let config = self.settings()?;
        if self.print_config {
            out!("{}", config.print().map_err(Failure::Input)?);
            return Ok(());
        }
        let path = self.database.as_ref().ok_or_else(|| Failure::Usage("a database is needed".into()))?;
        start_log(context, config.log);
        let mut options = options(&config)?;
        let is_secured = options.tls.is_some();
        let pages = OpenOptions { cache_bytes: (config.page_cache_mib as usize) << 20 };
        let opened = Database::open(path, pages).map_err(|error| info::open_failure(path, error));
        let database = Arc::new(opened?);
        if !config.state.is_empty() {
            options.store = Box::new(store(Path::new(&config.state), &database)?);
        }
        if !config.record.is_empty() {
            options.recording = Some(recording(Path::new(&config.record), config.record_limit_mib)?);
        }
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
        let runtime = runtime.map_err(|error| Failure::environment("starting threads", error))?;
        runtime.block_on(async {
            let (listener, address) = bind(&config.listen).await?;
            if !address.ip().is_loopback() && (!is_secured || options.tokens.is_none()) {
                tracing::warn!(%address, "others reach this server, and it has no certificate or no tokens");
            }
            let stop = stop_signal()?;
            if context.json {
                outln!("{}", json!({ "address": address.to_string() }));
            } else {
                outln!("serving {} on {address}", path.display());
            }
            let served = service::serve_with(listener, database, options, stop).await;
            served.map_err(|error| Failure::environment("serving", error))
        })
    }
}

/// The exercises that are kept in a file.
fn store(path: &Path, database: &Database) -> Result<DiskStore, Failure> {
    let opened = DiskStore::open(path, &database.version(), &database.site(), database);
    let store = opened.map_err(|error| Failure::Input(error.to_string()))?;
    let kept = store.list().map_err(|error| Failure::Input(error.to_string()))?;
    tracing::info!(file = %path.display(), exercises = kept.len(), "exercises are kept");
    Ok(store)
}

/// A recording in a new file: one that exists is never written over, nor appended to. In a folder it is named by the
/// time, so that a server that is started again begins another.
fn recording(path: &Path, limit_mib: u32) -> Result<Recording, Failure> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis());
    let path = if path.is_dir() { path.join(format!("{now}.journal")) } else { path.to_owned() };
    let opened = std::fs::OpenOptions::new().write(true).create_new(true).open(&path);
    let sink = opened.map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => Failure::Environment(format!(
            "{} exists: record to a new file, or into a folder, where each start makes one",
            path.display()
        )),
        _ => Failure::environment(format_args!("recording to {}", path.display()), error),
    })?;
    tracing::info!(file = %path.display(), limit_mib, "recording");
    Ok(Recording { sink: Box::new(sink), limit_bytes: u64::from(limit_mib) << 20 })
}

/// What the files of the settings hold.
fn options(config: &Config) -> Result<Options, Failure> {
    let read = |path: &String| std::fs::read(path).map_err(|error| Failure::input(path, error));
    let some = |path: &String| if path.is_empty() { Ok(None) } else { read(path).map(Some) };
    let tls = match (some(&config.tls.certificate)?, some(&config.tls.key)?) {
        (Some(certificate), Some(key)) => {
            Some(Tls { certificate, key, client_authorities: some(&config.tls.client_authorities)? })
        }
        _ => None,
    };
    let tokens = match &config.access.tokens {
        path if path.is_empty() => None,
        path => {
            let text = std::fs::read_to_string(path).map_err(|error| Failure::input(path, error))?;
            // The parser's words would show the line, and with it a secret.
            let tokens: Tokens =
                toml::from_str(&text).map_err(|error: toml::de::Error| Failure::input(path, error.message()))?;
            tokens.check().map_err(|error| Failure::input(path, error))?;
            Some(tokens)
        }
    };
    let draining_time = std::time::Duration::from_secs_f64(config.draining_s);
    let (limits, origins) = (config.limits, config.access.origins.clone());
    let read_ahead = std::time::Duration::from_secs_f64(config.read_ahead_s);
    Ok(Options { limits, tokens, tls, draining_time, read_ahead, origins, ..Options::default() })
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
fn start_log(context: &Context, layout: LogLayout) {
    let default = if context.quiet { "warn" } else { "info" };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(stderr).with_ansi(stderr().is_terminal());
    // Only one log a process: a second is the first one's.
    let _ = match layout {
        LogLayout::Text => log.try_init(),
        LogLayout::Json => log.json().flatten_event(true).try_init(),
    };
}
