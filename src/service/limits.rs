//! What a server allows: all its clients together, and each of them. Every refusal names the limit, its value and
//! where it is raised.
//!
//! A client is the holder of a token, or without tokens whoever calls from one network address. [`Accounts`] keeps what
//! each has in use; [`Seat`] gives a view's share back when it goes.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use serde::{Deserialize, Serialize};
use tonic::Status;

use super::{MAX_BATCH_LINES, MAX_REQUEST_BYTES, MAX_VIEWS};
use crate::session::MAX_TRIANGLES;

/// Clients that are remembered at the same time, those with nothing in use included.
const MAX_CLIENTS: usize = 10_000;

/// What a server allows.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Connections at the same time; one more waits to be accepted.
    pub connections: usize,
    /// Views at the same time.
    pub views: usize,
    /// Views of one client.
    pub views_per_client: usize,
    /// Watches of verdicts at the same time.
    pub verdict_watches: usize,
    /// Watches of verdicts of one client.
    pub verdict_watches_per_client: usize,
    /// Sum of the triangle budgets of all views.
    pub triangles: u64,
    /// Sum of the budgets of one client's views.
    pub triangles_per_client: u64,
    /// Budget of one view; at most 4,000,000.
    pub triangles_per_view: u32,
    /// Entities and sight lines that an exercise may hold together.
    pub things_per_exercise: usize,
    /// Bytes of one request.
    pub request_bytes: usize,
    /// Bytes of requests that are received or wait to be answered.
    pub bytes_under_way: u64,
    /// Such bytes of one client.
    pub bytes_under_way_per_client: u64,
    /// Seconds within which a request must arrive whole, from 0.1 to 86,400.
    pub receiving_s: f64,
    /// Lines of one batch; at most 250,000.
    pub batch_lines: usize,
    /// Seconds for which a connection may say nothing before its first call, from 0.1 to 86,400; then it is ended.
    pub silence_s: f64,
    /// Calls in a second, streams counted once.
    pub calls_per_s: u32,
    /// Calls of one client in a second.
    pub calls_per_s_per_client: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 1_000,
            views: MAX_VIEWS,
            views_per_client: MAX_VIEWS,
            verdict_watches: 1_000,
            verdict_watches_per_client: 1_000,
            triangles: 40_000_000,
            triangles_per_client: 40_000_000,
            triangles_per_view: MAX_TRIANGLES,
            things_per_exercise: 120_000,
            request_bytes: MAX_REQUEST_BYTES,
            bytes_under_way: 512 << 20,
            bytes_under_way_per_client: 256 << 20,
            receiving_s: 60.0,
            batch_lines: MAX_BATCH_LINES,
            silence_s: 30.0,
            calls_per_s: 50_000,
            calls_per_s_per_client: 20_000,
        }
    }
}

impl Limits {
    /// Says what makes no sense, by its name in the configuration.
    pub fn check(&self) -> Result<(), String> {
        let least = [
            ("connections", self.connections as u64),
            ("views", self.views as u64),
            ("views_per_client", self.views_per_client as u64),
            ("verdict_watches", self.verdict_watches as u64),
            ("verdict_watches_per_client", self.verdict_watches_per_client as u64),
            ("triangles", self.triangles),
            ("triangles_per_client", self.triangles_per_client),
            ("triangles_per_view", self.triangles_per_view.into()),
            ("things_per_exercise", self.things_per_exercise as u64),
            ("request_bytes", self.request_bytes as u64),
            ("batch_lines", self.batch_lines as u64),
            ("calls_per_s", self.calls_per_s.into()),
            ("calls_per_s_per_client", self.calls_per_s_per_client.into()),
        ];
        if let Some((name, _)) = least.iter().find(|(_, value)| *value == 0) {
            return Err(format!("limits.{name} is 0: nothing could be served"));
        }
        for (name, seconds) in [("silence_s", self.silence_s), ("receiving_s", self.receiving_s)] {
            if !(0.1..=86_400.0).contains(&seconds) {
                return Err(format!("limits.{name} is {seconds}; it must be from 0.1 to 86400"));
            }
        }
        let under_way = [
            ("bytes_under_way", self.bytes_under_way),
            ("bytes_under_way_per_client", self.bytes_under_way_per_client),
        ];
        if let Some((name, most)) = under_way.iter().find(|(_, most)| *most < self.request_bytes as u64) {
            let bytes = self.request_bytes;
            return Err(format!("limits.{name} is {most}: no request of limits.request_bytes, {bytes}, could arrive"));
        }
        let most = [
            ("triangles_per_view", u64::from(self.triangles_per_view), u64::from(MAX_TRIANGLES)),
            ("batch_lines", self.batch_lines as u64, MAX_BATCH_LINES as u64),
            ("request_bytes", self.request_bytes as u64, 1 << 30),
        ];
        match most.iter().find(|(_, value, most)| value > most) {
            Some((name, value, most)) => Err(format!("limits.{name} is {value}; no server takes more than {most}")),
            None => Ok(()),
        }
    }
}

/// The refusal of what would pass a limit.
pub(super) fn limited(name: &str, what: &str, wanted: u64, limit: u64) -> Status {
    Status::resource_exhausted(format!(
        "{wanted} {what}: the limit is {limit} (the server's operator may raise limits.{name})"
    ))
}

/// What one client has in use.
#[derive(Clone, Copy, Debug, Default)]
struct Account {
    views: u64,
    watches: u64,
    triangles: u64,
    /// Of requests under way.
    bytes: u64,
    calls: Option<Bucket>,
}

impl Account {
    /// Whether nothing of it is in use.
    fn is_idle(&self, now: Instant) -> bool {
        self.views + self.watches + self.bytes == 0 && self.calls.is_none_or(|calls| calls.is_full(now))
    }
}

/// Calls that may still be made now: a second's worth at most.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    left: f64,
    at: Instant,
}

impl Bucket {
    /// Takes one call, if there is one.
    fn take(bucket: &mut Option<Self>, per_s: u32, now: Instant) -> bool {
        let full = f64::from(per_s);
        let mut filled = bucket.unwrap_or(Self { left: full, at: now });
        filled.left = (filled.left + now.saturating_duration_since(filled.at).as_secs_f64() * full).min(full);
        filled.at = now;
        let taken = filled.left >= 1.0;
        filled.left -= f64::from(u8::from(taken));
        *bucket = Some(filled);
        taken
    }

    /// Whether it is as good as new.
    fn is_full(self, now: Instant) -> bool {
        now.saturating_duration_since(self.at).as_secs_f64() >= 1.0
    }
}

#[derive(Debug, Default)]
struct Books {
    all: Account,
    clients: BTreeMap<Arc<str>, Account>,
}

/// What is in use.
#[derive(Debug)]
pub(super) struct Accounts {
    limits: Limits,
    books: Mutex<Books>,
}

impl Accounts {
    pub(super) fn new(limits: Limits) -> Arc<Self> {
        Arc::new(Self { limits, books: Mutex::default() })
    }

    // A panic while the lock is held leaves numbers that are off by one view at most.
    fn books(&self) -> MutexGuard<'_, Books> {
        self.books.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a place for a watch of verdicts of `client`.
    pub(super) fn watch_seat(self: &Arc<Self>, client: &Arc<str>) -> Result<WatchSeat, Status> {
        let limits = &self.limits;
        let mut books = self.books();
        let all = books.all.watches + 1;
        let own = books.account(client, Instant::now())?.watches + 1;
        let (most, most_own) = (limits.verdict_watches as u64, limits.verdict_watches_per_client as u64);
        if all > most {
            return Err(limited("verdict_watches", "watches of verdicts", all, most));
        }
        if own > most_own {
            return Err(limited("verdict_watches_per_client", "watches of verdicts of this client", own, most_own));
        }
        books.all.watches = all;
        books.account(client, Instant::now())?.watches = own;
        drop(books);
        Ok(WatchSeat { accounts: Arc::clone(self), client: Arc::clone(client) })
    }

    /// Watches of verdicts in use.
    pub(super) fn watches(&self) -> u64 {
        self.books().all.watches
    }

    /// Takes a place for the bytes of a request of `client`; it has none yet.
    pub(super) fn bytes_seat(self: &Arc<Self>, client: &Arc<str>) -> BytesSeat {
        BytesSeat { accounts: Arc::clone(self), client: Arc::clone(client), bytes: 0 }
    }

    /// Bytes of requests under way.
    pub(super) fn bytes(&self) -> u64 {
        self.books().all.bytes
    }

    /// Views and their triangles in use.
    pub(super) fn used(&self) -> (u64, u64) {
        let all = self.books().all;
        (all.views, all.triangles)
    }

    /// Lets a call of `client` begin.
    pub(super) fn call(&self, client: &Arc<str>, now: Instant) -> Result<(), Status> {
        let limits = &self.limits;
        let mut books = self.books();
        let account = books.account(client, now)?;
        if !Bucket::take(&mut account.calls, limits.calls_per_s_per_client, now) {
            let limit = limits.calls_per_s_per_client.into();
            return Err(limited("calls_per_s_per_client", "calls of this client in a second and more", limit, limit));
        }
        if !Bucket::take(&mut books.all.calls, limits.calls_per_s, now) {
            let limit = limits.calls_per_s.into();
            return Err(limited("calls_per_s", "calls in a second and more", limit, limit));
        }
        Ok(())
    }

    /// Takes a place for a view of `client` with a budget of `triangles`.
    pub(super) fn seat(self: &Arc<Self>, client: &Arc<str>, triangles: u32) -> Result<Seat, Status> {
        let limits = &self.limits;
        {
            let mut books = self.books();
            let all = books.all.views + 1;
            let own = books.account(client, Instant::now())?.views + 1;
            if all > limits.views as u64 {
                return Err(limited("views", "views", all, limits.views as u64));
            }
            if own > limits.views_per_client as u64 {
                return Err(limited("views_per_client", "views of this client", own, limits.views_per_client as u64));
            }
            books.all.views = all;
            books.account(client, Instant::now())?.views = own;
        }
        let mut seat = Seat { accounts: Arc::clone(self), client: Arc::clone(client), triangles: 0 };
        seat.resize(triangles)?;
        Ok(seat)
    }
}

impl Books {
    fn account(&mut self, client: &Arc<str>, now: Instant) -> Result<&mut Account, Status> {
        if !self.clients.contains_key(client) && self.clients.len() >= MAX_CLIENTS {
            self.clients.retain(|_, account| !account.is_idle(now));
            if self.clients.len() >= MAX_CLIENTS {
                return Err(Status::resource_exhausted(format!("more than {MAX_CLIENTS} clients at the same time")));
            }
        }
        Ok(self.clients.entry(Arc::clone(client)).or_default())
    }
}

/// The bytes that a request holds. Dropping it gives them back.
#[derive(Debug)]
pub(super) struct BytesSeat {
    accounts: Arc<Accounts>,
    client: Arc<str>,
    bytes: u64,
}

impl BytesSeat {
    /// Holds so many more, or says which limit is in the way.
    pub(super) fn add(&mut self, bytes: u64) -> Result<(), Status> {
        let limits = &self.accounts.limits;
        let mut books = self.accounts.books();
        let all = books.all.bytes + bytes;
        let own = books.account(&self.client, Instant::now())?.bytes + bytes;
        let (most, most_own) = (limits.bytes_under_way, limits.bytes_under_way_per_client);
        if all > most {
            return Err(limited("bytes_under_way", "bytes of requests under way", all, most));
        }
        if own > most_own {
            let what = "bytes of this client's requests under way";
            return Err(limited("bytes_under_way_per_client", what, own, most_own));
        }
        books.all.bytes = all;
        books.account(&self.client, Instant::now())?.bytes = own;
        self.bytes += bytes;
        Ok(())
    }

    /// Holds no more than so many.
    pub(super) fn keep(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.bytes -= less;
        let mut books = self.accounts.books();
        books.all.bytes -= less;
        if let Some(account) = books.clients.get_mut(&self.client) {
            account.bytes -= less;
        }
    }
}

impl Drop for BytesSeat {
    fn drop(&mut self) {
        self.keep(0);
    }
}

/// The place of a watch of verdicts. Dropping it gives the place back.
#[derive(Debug)]
pub(super) struct WatchSeat {
    accounts: Arc<Accounts>,
    client: Arc<str>,
}

impl Drop for WatchSeat {
    fn drop(&mut self) {
        let mut books = self.accounts.books();
        books.all.watches -= 1;
        if let Some(account) = books.clients.get_mut(&self.client) {
            account.watches -= 1;
        }
    }
}

/// The place of a view. Dropping it gives the place back.
#[derive(Debug)]
pub(super) struct Seat {
    accounts: Arc<Accounts>,
    client: Arc<str>,
    triangles: u32,
}

impl Seat {
    /// Changes the budget, or leaves it as it is and says which limit is in the way.
    pub(super) fn resize(&mut self, triangles: u32) -> Result<(), Status> {
        let limits = self.accounts.limits;
        if triangles > limits.triangles_per_view {
            let (wanted, limit) = (triangles.into(), limits.triangles_per_view.into());
            return Err(limited("triangles_per_view", "triangles for one view", wanted, limit));
        }
        let mut books = self.accounts.books();
        let changed = |before: u64| before - u64::from(self.triangles) + u64::from(triangles);
        let all = changed(books.all.triangles);
        let own = changed(books.clients.get(&self.client).map_or(self.triangles.into(), |account| account.triangles));
        // Less is always allowed.
        if triangles > self.triangles {
            if all > limits.triangles {
                return Err(limited("triangles", "triangles for all views", all, limits.triangles));
            }
            if own > limits.triangles_per_client {
                let limit = limits.triangles_per_client;
                return Err(limited("triangles_per_client", "triangles for this client's views", own, limit));
            }
        }
        books.all.triangles = all;
        books.clients.entry(Arc::clone(&self.client)).or_default().triangles = own;
        drop(books);
        self.triangles = triangles;
        Ok(())
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut books = self.accounts.books();
        books.all.views -= 1;
        books.all.triangles -= u64::from(self.triangles);
        if let Some(account) = books.clients.get_mut(&self.client) {
            account.views -= 1;
            account.triangles -= u64::from(self.triangles);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn accounts() -> (Arc<Accounts>, Arc<str>, Arc<str>) {
        let limits = Limits {
            views: 3,
            views_per_client: 2,
            triangles: 1_000,
            triangles_per_client: 700,
            triangles_per_view: 600,
            calls_per_s: 5,
            calls_per_s_per_client: 3,
            ..Limits::default()
        };
        (Accounts::new(limits), "a".into(), "b".into())
    }

    #[track_caller]
    fn refused<T: std::fmt::Debug>(result: Result<T, Status>, name: &str) {
        let status = result.unwrap_err();
        assert_eq!(status.code(), tonic::Code::ResourceExhausted);
        assert!(status.message().contains(&format!("limits.{name})")), "{status}");
    }

    #[test]
    fn each_limit_is_named_and_what_is_given_back_is_free_again() {
        let (accounts, a, b) = accounts();
        refused(accounts.seat(&a, 601), "triangles_per_view");
        assert_eq!(accounts.used(), (0, 0), "a refused view leaves nothing");
        let mut first = accounts.seat(&a, 400).unwrap();
        refused(accounts.seat(&a, 301), "triangles_per_client");
        let second = accounts.seat(&a, 300).unwrap();
        refused(accounts.seat(&a, 2), "views_per_client");
        refused(first.resize(401), "triangles_per_client");
        refused(accounts.seat(&b, 301), "triangles");
        let third = accounts.seat(&b, 300).unwrap();
        refused(accounts.seat(&b, 2), "views");
        refused(first.resize(401), "triangles");
        first.resize(100).unwrap();
        assert_eq!(accounts.used(), (3, 700));
        drop((first, second, third));
        assert_eq!(accounts.used(), (0, 0));
    }

    #[test]
    fn watches_of_verdicts_have_their_own_limits() {
        let limits = Limits { verdict_watches: 3, verdict_watches_per_client: 2, ..Limits::default() };
        let (accounts, a, b) = (Accounts::new(limits), "a".into(), "b".into());
        let (first, _second) = (accounts.watch_seat(&a).unwrap(), accounts.watch_seat(&a).unwrap());
        refused(accounts.watch_seat(&a), "verdict_watches_per_client");
        let _third = accounts.watch_seat(&b).unwrap();
        refused(accounts.watch_seat(&b), "verdict_watches");
        drop(first);
        assert_eq!(accounts.watches(), 2);
        accounts.watch_seat(&a).unwrap();
    }

    #[test]
    fn bytes_under_way_are_counted_by_client_and_in_all() {
        let limits =
            Limits { request_bytes: 60, bytes_under_way: 100, bytes_under_way_per_client: 60, ..Limits::default() };
        let (accounts, a, b) = (Accounts::new(limits), "a".into(), "b".into());
        let [mut first, mut second, mut third] = [&a, &a, &b].map(|client| accounts.bytes_seat(client));
        first.add(40).unwrap();
        refused(second.add(21), "bytes_under_way_per_client");
        second.add(20).unwrap();
        refused(third.add(41), "bytes_under_way");
        first.keep(5);
        third.add(41).unwrap();
        assert_eq!(accounts.bytes(), 66);
        drop((first, second, third));
        assert_eq!(accounts.bytes(), 0);
    }

    #[test]
    fn calls_are_counted_by_client_and_in_all() {
        let (accounts, a, b) = accounts();
        let start = Instant::now();
        (0..3).for_each(|_| accounts.call(&a, start).unwrap());
        refused(accounts.call(&a, start), "calls_per_s_per_client");
        (0..2).for_each(|_| accounts.call(&b, start).unwrap());
        refused(accounts.call(&b, start), "calls_per_s");
        accounts.call(&a, start + Duration::from_millis(400)).unwrap();
        refused(accounts.call(&a, start + Duration::from_millis(400)), "calls_per_s_per_client");
    }

    #[test]
    fn limits_that_make_no_sense_are_named() {
        assert_eq!(Limits::default().check(), Ok(()));
        assert!(Limits { views: 0, ..Limits::default() }.check().unwrap_err().contains("limits.views is 0"));
        let vast = Limits { batch_lines: MAX_BATCH_LINES + 1, ..Limits::default() };
        assert!(vast.check().unwrap_err().contains("limits.batch_lines"));
        for silence_s in [0.0, f64::NAN, 1e9] {
            let limits = Limits { silence_s, ..Limits::default() };
            assert!(limits.check().unwrap_err().contains("limits.silence_s"));
        }
        let narrow = Limits { bytes_under_way: 1 << 20, ..Limits::default() };
        assert!(narrow.check().unwrap_err().contains("limits.bytes_under_way is 1048576"));
    }
}
