//! The connections of a server: counted, limited in number, their bytes counted, and those that are dead or say nothing
//! ended.
//!
//! Beyond the limit none is accepted until one goes: the system's queue of connections holds the others back. So a
//! connection that nobody is behind must give its place back. One over HTTP/2 is asked for a sign of life, one over HTTP/1.1
//! has half a minute for the head of its next request; a machine that vanished while an answer is sent to it over HTTP/1.1
//! is found by TCP's keepalive; and one that has not said anything that is a call is ended here after some silence.

use std::{
    io,
    net::{IpAddr, SocketAddr},
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};

use socket2::{SockRef, TcpKeepalive};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore, mpsc},
    time::{Instant, Sleep, sleep},
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;

use super::{KEEPALIVE_TIME, telemetry::Metrics};

/// How long accepting waits after the system refused, for example for want of file descriptors.
const PAUSE_AFTER_REFUSAL: Duration = Duration::from_millis(100);
/// Questions of TCP's keepalive that may stay without an answer.
#[cfg(not(windows))]
const KEEPALIVE_RETRIES: u32 = 3;

/// One connection.
#[derive(Debug)]
pub(super) struct Connection {
    stream: TcpStream,
    peer: Peer,
    silence: Silence,
    metrics: Arc<Metrics>,
    _place: OwnedSemaphorePermit,
}

/// Who is at the other end.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    address: SocketAddr,
    /// Whether it has ever called.
    has_called: Arc<AtomicBool>,
}

impl Peer {
    pub(super) fn ip(&self) -> IpAddr {
        self.address.ip()
    }

    /// It has called: from now on its protocol tells when it is dead.
    pub(super) fn called(&self) {
        self.has_called.store(true, Ordering::Relaxed);
    }
}

/// How long nothing has been heard.
#[derive(Debug)]
struct Silence {
    limit: Duration,
    heard: Instant,
    alarm: Pin<Box<Sleep>>,
}

impl Silence {
    fn new(limit: Duration) -> Self {
        Self { limit, heard: Instant::now(), alarm: Box::pin(sleep(limit)) }
    }

    /// Whether it has lasted too long; else wakes the task when it may have.
    fn is_too_long(&mut self, cx: &mut Context<'_>) -> bool {
        while self.alarm.as_mut().poll(cx).is_ready() {
            let end = self.heard + self.limit;
            if end <= Instant::now() {
                return true;
            }
            self.alarm.as_mut().reset(end);
        }
        false
    }
}

/// Accepts connections, at most `limit` at the same time, until what it returns is dropped. One that says nothing for
/// `silence` before its first call is ended.
pub(super) fn accept(
    listener: TcpListener,
    limit: usize,
    silence: Duration,
    metrics: Arc<Metrics>,
) -> ReceiverStream<io::Result<Connection>> {
    let places = Arc::new(Semaphore::new(limit.min(Semaphore::MAX_PERMITS)));
    let (sender, receiver) = mpsc::channel(1);
    tokio::spawn(async move {
        loop {
            let next = async {
                let place = Arc::clone(&places).acquire_owned().await.map_err(io::Error::other)?;
                let (stream, peer) = listener.accept().await?;
                stream.set_nodelay(true)?;
                SockRef::from(&stream).set_tcp_keepalive(&keepalive())?;
                Ok((place, stream, peer))
            };
            let accepted: io::Result<_> = tokio::select! {
                accepted = next => accepted,
                () = sender.closed() => return,
            };
            match accepted {
                Ok((place, stream, address)) => {
                    metrics.connections.inc();
                    let peer = Peer { address, has_called: Arc::default() };
                    let (metrics, silence) = (Arc::clone(&metrics), Silence::new(silence));
                    let connection = Connection { stream, peer, silence, metrics, _place: place };
                    if sender.send(Ok(connection)).await.is_err() {
                        return;
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    tokio::time::sleep(PAUSE_AFTER_REFUSAL).await;
                }
            }
        }
    });
    ReceiverStream::new(receiver)
}

fn keepalive() -> TcpKeepalive {
    let keepalive = TcpKeepalive::new().with_time(KEEPALIVE_TIME).with_interval(KEEPALIVE_TIME);
    #[cfg(not(windows))]
    let keepalive = keepalive.with_retries(KEEPALIVE_RETRIES);
    keepalive
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.metrics.connections.dec();
    }
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let polled = Pin::new(&mut self.stream).poll_read(cx, buf);
        self.metrics.received.inc_by((buf.filled().len() - before) as u64);
        if polled.is_ready() {
            self.silence.heard = Instant::now();
        } else if !self.peer.has_called.load(Ordering::Relaxed) && self.silence.is_too_long(cx) {
            self.metrics.silent_connections.inc();
            return Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "nothing was said")));
        }
        polled
    }
}
impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(cx, buf);
        self.count(&polled);
        polled
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(cx, bufs);
        self.count(&polled);
        polled
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

impl Connection {
    fn count(&self, written: &Poll<io::Result<usize>>) {
        if let Poll::Ready(Ok(bytes)) = written {
            self.metrics.sent.inc_by(*bytes as u64);
        }
    }
}
