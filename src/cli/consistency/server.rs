//! A server of this process's own, on loopback, for a run or a demonstration.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
};

use tokio::{net::TcpListener, runtime::Runtime, sync::oneshot, task::JoinHandle};

use super::super::Failure;
use crate::{
    database::Database,
    service::{self, ServeError},
};

/// A server in the background. It goes when it is told to, or with the runtime.
pub(in super::super) struct LocalServer {
    /// Where it listens.
    pub(in super::super) at: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<Result<(), ServeError>>,
}

impl LocalServer {
    /// Serves `database` at `wanted`, or where the system chooses.
    pub(in super::super) fn start(
        runtime: &Runtime,
        database: Arc<Database>,
        wanted: Option<SocketAddr>,
    ) -> io::Result<Self> {
        let wanted = wanted.unwrap_or(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)));
        let listener = runtime.block_on(TcpListener::bind(wanted))?;
        let at = listener.local_addr()?;
        let (stop, stopped) = oneshot::channel();
        let shutdown = async {
            let _ = stopped.await;
        };
        let task = runtime.spawn(service::serve(listener, database, shutdown));
        Ok(Self { at, stop, task })
    }

    /// Its address for clients.
    pub(in super::super) fn address(&self) -> String {
        format!("http://{}", self.at)
    }

    /// Stops it and waits for its end.
    pub(in super::super) fn stop(self, runtime: &Runtime) -> Result<(), Failure> {
        // The receiver is gone only when the server has ended by itself.
        let _ = self.stop.send(());
        match runtime.block_on(self.task) {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(Failure::environment("the server", error)),
            Err(error) => Err(Failure::environment("the server", error)),
        }
    }
}
