//! The bytes of requests under way, counted for each client and in all, and ended where they drip.
//!
//! A message of gRPC is held in memory from its first byte until its call begins to be answered, or until it is whole where
//! that comes later, as in streams. A limit for one message bounds none of this: a client may begin as many as it has
//! streams, and end none.

use std::{
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

use axum::body::{Body, Bytes};
use http_body::{Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep_until};
use tonic::Status;

use super::limits::BytesSeat;

/// What gRPC puts before a message: a flag, and its length in four bytes.
const PREFIX_BYTES: usize = 5;

/// Where in its messages a body is.
#[derive(Debug, Default)]
struct Framing {
    prefix: [u8; PREFIX_BYTES],
    /// Bytes of the prefix that are there.
    begun: usize,
    /// Bytes of the message that are to come, once the prefix is whole.
    left: u64,
    /// Whether a message has come whole.
    has_any: bool,
}

impl Framing {
    /// Whether nothing of the next message is there.
    fn is_between(&self) -> bool {
        self.begun == 0
    }

    /// Passes `bytes`; if a message ended among them, tells how many came after the last one that did.
    fn pass(&mut self, mut bytes: &[u8]) -> Option<usize> {
        let mut after = None;
        while !bytes.is_empty() {
            if self.begun < PREFIX_BYTES {
                let taken = bytes.len().min(PREFIX_BYTES - self.begun);
                self.prefix[self.begun..self.begun + taken].copy_from_slice(&bytes[..taken]);
                (self.begun, bytes) = (self.begun + taken, &bytes[taken..]);
                if self.begun == PREFIX_BYTES {
                    let [_, length @ ..] = self.prefix;
                    self.left = u32::from_be_bytes(length).into();
                }
            } else {
                let taken = bytes.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
                (self.left, bytes) = (self.left - taken as u64, &bytes[taken..]);
            }
            if self.begun == PREFIX_BYTES && self.left == 0 {
                (self.begun, self.has_any) = (0, true);
                after = Some(bytes.len());
            }
        }
        after
    }
}

/// What a call holds.
#[derive(Debug)]
struct Held {
    seat: BytesSeat,
    framing: Framing,
    is_answered: bool,
}

impl Held {
    fn take(&mut self, bytes: &[u8]) -> Result<(), Status> {
        self.seat.add(bytes.len() as u64)?;
        match self.framing.pass(bytes) {
            // What is whole is handed on at once where the call has begun to be answered.
            Some(after) if self.is_answered => self.seat.keep(after as u64),
            _ => {}
        }
        Ok(())
    }

    /// Whether a message is to come or to go on.
    fn is_due(&self) -> bool {
        !self.framing.is_between() || !(self.framing.has_any || self.is_answered)
    }
}

/// The share of one call, for whoever answers it.
#[derive(Clone, Debug)]
pub(super) struct Hold(Arc<Mutex<Held>>);

impl Hold {
    pub(super) fn new(seat: BytesSeat) -> Self {
        Self(Arc::new(Mutex::new(Held { seat, framing: Framing::default(), is_answered: false })))
    }

    // Numbers only; each change of them is complete.
    fn held(&self) -> MutexGuard<'_, Held> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The call has begun to be answered: what is whole is held no more.
    pub(super) fn answered(&self) {
        let mut held = self.held();
        held.is_answered = true;
        if held.framing.is_between() {
            held.seat.keep(0);
        }
    }

    /// `body`, counted. A message that has not arrived `limit` after it began, or the first after the call did, ends it.
    pub(super) fn count(&self, body: Body, limit: Duration) -> Body {
        Body::new(Counted { body, hold: self.clone(), limit, began: Instant::now(), alarm: None })
    }
}

/// A body that is counted.
struct Counted {
    body: Body,
    hold: Hold,
    limit: Duration,
    /// When the message that is due began.
    began: Instant,
    /// Set while the rest of a message is waited for.
    alarm: Option<Pin<Box<Sleep>>>,
}

impl http_body::Body for Counted {
    type Data = Bytes;
    type Error = axum::BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        match Pin::new(&mut self.body).poll_frame(cx) {
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(bytes) = frame.data_ref() {
                    let mut held = self.hold.held();
                    let was_between = held.framing.is_between() && held.framing.has_any;
                    if let Err(status) = held.take(bytes) {
                        return Poll::Ready(Some(Err(status.into())));
                    }
                    let is_between = held.framing.is_between();
                    drop(held);
                    if was_between || is_between {
                        (self.began, self.alarm) = (Instant::now(), None);
                    }
                }
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Ready(other) => Poll::Ready(other.map(|end| end.map_err(Into::into))),
            Poll::Pending if self.hold.held().is_due() => {
                let end = self.began + self.limit;
                let alarm = self.alarm.get_or_insert_with(|| Box::pin(sleep_until(end)));
                alarm.as_mut().poll(cx).map(|()| Some(Err(late(self.limit).into())))
            }
            Poll::Pending => Poll::Pending,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

fn late(limit: Duration) -> Status {
    let s = limit.as_secs_f64();
    Status::deadline_exceeded(format!(
        "a request did not arrive whole within {s} s (the server's operator may raise limits.receiving_s)"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn borders_of_messages_are_found_however_they_are_cut(
            lengths in prop::collection::vec(0..300_u32, 1..6),
            cuts in prop::collection::vec(1..64_usize, 1..200),
        ) {
            let message = |n: &u32| [&[0][..], &n.to_be_bytes(), &vec![7; *n as usize]].concat();
            let all: Vec<u8> = lengths.iter().flat_map(message).collect();
            let borders: Vec<usize> = lengths.iter().scan(0, |at, n| {
                *at += PREFIX_BYTES + *n as usize;
                Some(*at)
            }).collect();
            let (mut framing, mut at) = (Framing::default(), 0);
            for cut in cuts.iter().cycle() {
                let next = (at + cut).min(all.len());
                let after = framing.pass(&all[at..next]);
                let last = borders.iter().rfind(|border| (at + 1..=next).contains(border));
                prop_assert_eq!(after, last.map(|border| next - border));
                prop_assert_eq!(framing.is_between(), borders.contains(&next));
                at = next;
                if at == all.len() {
                    break;
                }
            }
        }
    }
}
