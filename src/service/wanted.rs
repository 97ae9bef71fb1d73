//! Whether a call is still wanted: long work asks between its shares, and stops once the client has gone, has cancelled,
//! or has let its deadline pass.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use tonic::{Request, Status};

/// The header in which gRPC sends how long a client waits.
const TIMEOUT_HEADER: &str = "grpc-timeout";

/// What work asks.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    dropped: Arc<AtomicBool>,
    deadline: Option<Instant>,
}

/// Held by the call: with it, the want ends.
#[derive(Debug)]
pub(super) struct Call(Arc<AtomicBool>);

impl Drop for Call {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Wanted {
    /// For a call that begins now.
    pub(super) fn of<R>(request: &Request<R>) -> (Self, Call) {
        let header = request.metadata().get(TIMEOUT_HEADER).and_then(|value| value.to_str().ok());
        let deadline = header.and_then(timeout_of).and_then(|timeout| Instant::now().checked_add(timeout));
        let dropped = Arc::new(AtomicBool::new(false));
        (Self { dropped: Arc::clone(&dropped), deadline }, Call(dropped))
    }

    /// An error once nobody waits any more.
    pub(super) fn check(&self) -> Result<(), Status> {
        if self.dropped.load(Ordering::Relaxed) {
            return Err(Status::cancelled("the client has gone"));
        }
        if self.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            return Err(deadline_exceeded());
        }
        Ok(())
    }

    /// Ends when the deadline has passed; never without one.
    pub(super) async fn expired(&self) {
        match self.deadline {
            Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
            None => std::future::pending().await,
        }
    }
}

pub(super) fn deadline_exceeded() -> Status {
    Status::deadline_exceeded("the deadline that the client set has passed")
}

/// Up to eight digits and a unit.
fn timeout_of(text: &str) -> Option<Duration> {
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    if digits.is_empty() || digits.len() > 8 || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let count: u64 = digits.parse().ok()?;
    Some(match unit {
        "H" => Duration::from_secs(count * 3_600),
        "M" => Duration::from_secs(count * 60),
        "S" => Duration::from_secs(count),
        "m" => Duration::from_millis(count),
        "u" => Duration::from_micros(count),
        "n" => Duration::from_nanos(count),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timeouts_are_read_as_grpc_writes_them() {
        assert_eq!(timeout_of("250m"), Some(Duration::from_millis(250)));
        assert_eq!(timeout_of("99999999H"), Some(Duration::from_secs(99_999_999 * 3_600)));
        for bad in ["", "m", "1", "1x", "-1S", "123456789n", "1é", "é"] {
            assert_eq!(timeout_of(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_call_that_is_dropped_or_late_is_not_wanted() {
        let mut request = Request::new(());
        let (wanted, call) = Wanted::of(&request);
        assert!(wanted.check().is_ok());
        drop(call);
        assert_eq!(wanted.check().unwrap_err().code(), tonic::Code::Cancelled);
        request.set_timeout(Duration::ZERO);
        let (wanted, _call) = Wanted::of(&request);
        assert_eq!(wanted.check().unwrap_err().code(), tonic::Code::DeadlineExceeded);
    }
}
