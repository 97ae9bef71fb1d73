//! The journal of a server's views: everything that their frames follow from, in order, and the frames as they were made.
//!
//! A journal is a row of envelopes (`database::envelope`), one a [`Record`], numbered from 0; the layout stands in
//! `src/database/FORMAT.md`. It is only ever appended to, and each record is handed to the sink whole, so whatever ends a
//! server leaves whole records and at most a part of one behind them, which a reader tells from damage. Changes of
//! exercises are kept in the order in which views can see them ([`Journal::order`]); what a client says is kept with the
//! frame that follows from it, so that a view writes one record a frame.

use std::{
    io::{self, Read, Write},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use prost::Message;
use serde::{Deserialize, Serialize};
use sightline_proto::v1;
use thiserror::Error;

use crate::{
    database::envelope::{self, EnvelopeError, HEADER_BYTES, Sealed},
    exercise::{Change, Entity, Exercise, SightLine},
};

/// Greatest size of a record's value in bytes: an exercise with all the entities and sight lines that it may have fits.
pub const RECORD_LIMIT: usize = 64 << 20;
/// Least limit of a journal in bytes.
pub const MIN_JOURNAL_BYTES: u64 = 4_096;
/// Messages of a client that are kept for the frame after them; beyond it they get a record of their own.
const MAX_HEARD: usize = 256;
/// Room that is left for the record of the end.
const END_BYTES: u64 = 64;

/// What happened.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub enum Entry {
    /// The server began. Comes first and once.
    Began {
        /// Content hash of the terrain.
        terrain: Vec<u8>,
        /// The version of the program.
        program: String,
    },
    /// An exercise was there from the beginning.
    Restored {
        /// Its name.
        name: String,
        /// Its epoch.
        epoch: u64,
        /// Its entities.
        entities: Vec<Entity>,
        /// Its sight lines.
        sight_lines: Vec<SightLine>,
    },
    /// An exercise was made.
    Created {
        /// Its name.
        name: String,
    },
    /// An exercise moved on to its next epoch.
    Changed {
        /// Its name.
        name: String,
        /// The change.
        change: Change,
    },
    /// An exercise ended.
    Deleted {
        /// Its name.
        name: String,
    },
    /// Things of an exercise went with their lease: its next epoch.
    Expired {
        /// Its name.
        name: String,
        /// The entities.
        entities: Vec<u64>,
        /// The sight lines.
        sight_lines: Vec<u64>,
    },
    /// A view was opened, with the exercise that it names as it was then.
    Opened {
        /// Its number, never used again.
        view: u64,
        /// The `OpenView` message.
        open: Vec<u8>,
    },
    /// A view heard these `StreamSceneRequest` messages; no frame came between.
    Heard {
        /// The view.
        view: u64,
        /// The messages.
        heard: Vec<Vec<u8>>,
    },
    /// A view heard these messages, and then took its exercise as it was then.
    Followed {
        /// The view.
        view: u64,
        /// The messages.
        heard: Vec<Vec<u8>>,
    },
    /// A view heard these messages, and then made a frame.
    Made {
        /// The view.
        view: u64,
        /// The messages.
        heard: Vec<Vec<u8>>,
        /// The `StreamSceneResponse` messages of the frame, as they were sent.
        said: Vec<Vec<u8>>,
    },
    /// A view is gone.
    Closed {
        /// The view.
        view: u64,
    },
    /// The journal ends here.
    Ended {
        /// Whether its limit was reached; the server went on.
        is_full: bool,
    },
}

/// One record of a journal.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Counts records from 0, so that one that is missing or twice there is seen.
    pub number: u64,
    /// What happened.
    pub entry: Entry,
}

impl Sealed for Record {
    const MAGIC: [u8; 8] = *b"SLjrn\r\n\x1a";
    const VERSION: u32 = 1;

    fn check(&self) -> Result<(), String> {
        match (self.number, &self.entry) {
            (0, Entry::Began { .. }) => Ok(()),
            (0, _) => Err("the first record does not say on what terrain".into()),
            (_, Entry::Began { .. }) => Err("a second beginning".into()),
            _ => Ok(()),
        }
    }
}

/// Why a journal ended before its server.
#[derive(Debug, Error)]
pub enum JournalEnd {
    /// It has the greatest size that it may have.
    #[error("the recording has reached its limit of {0} bytes and ends here; the server goes on without")]
    Full(u64),
    /// It could not be written, or a record is larger than any may be.
    #[error("the recording cannot be written and ends here ({0}); the server goes on without")]
    Failed(String),
}

/// Where a server writes what happens. What it says in the end is for the log.
pub struct Journal {
    /// Held while exercises change in the store and while a view looks at them.
    order: Mutex<()>,
    log: Mutex<Log>,
    views: AtomicU64,
    end: Box<dyn Fn(&JournalEnd) + Send + Sync>,
}

/// How a journal is.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct JournalState {
    /// Its bytes.
    pub bytes: u64,
    /// The most that it may have.
    pub limit_bytes: u64,
    /// Why it ended before its server, if it did.
    pub ended: Option<String>,
}

struct Log {
    /// Absent once the journal has ended.
    sink: Option<Box<dyn Write + Send>>,
    number: u64,
    state: JournalState,
}

impl Journal {
    /// A journal in `sink` of at most `limit_bytes`, about a terrain of that version. `end` is told, once, when it ends
    /// too soon.
    pub fn begin(
        sink: Box<dyn Write + Send>,
        limit_bytes: u64,
        terrain: &[u8],
        end: Box<dyn Fn(&JournalEnd) + Send + Sync>,
    ) -> Self {
        let state = JournalState { bytes: 0, limit_bytes: limit_bytes.max(MIN_JOURNAL_BYTES), ended: None };
        let log = Log { sink: Some(sink), number: 0, state };
        let journal = Self { order: Mutex::default(), log: Mutex::new(log), views: AtomicU64::new(0), end };
        let program = env!("CARGO_PKG_VERSION").to_owned();
        journal.append(Entry::Began { terrain: terrain.to_vec(), program });
        journal
    }

    /// While it is held, exercises stand still for views. Whoever changes one holds it over the change in the store and
    /// the record of it; a view, over its look and the record of that.
    pub fn order(&self) -> MutexGuard<'_, ()> {
        self.order.lock().unwrap_or_else(PoisonError::into_inner)
    }

    // Each change of it is complete.
    fn log(&self) -> MutexGuard<'_, Log> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How it is.
    pub fn state(&self) -> JournalState {
        self.log().state.clone()
    }

    /// Writes down what happened.
    pub fn append(&self, entry: Entry) {
        let ended = self.log().append(entry);
        if let Some(why) = ended {
            (self.end)(&why);
        }
    }

    /// Writes down an exercise that is there from the beginning.
    pub fn restored(&self, exercise: &Exercise) {
        self.append(Entry::Restored {
            name: exercise.name().to_owned(),
            epoch: exercise.epoch(),
            entities: exercise.entities().copied().collect(),
            sight_lines: exercise.sight_lines().map(|state| state.line).collect(),
        });
    }

    /// Begins the record of a view that was opened so.
    pub fn open(self: &Arc<Self>, open: &v1::OpenView) -> Tape {
        let view = self.views.fetch_add(1, Ordering::Relaxed);
        self.append(Entry::Opened { view, open: open.encode_to_vec() });
        Tape { journal: Arc::clone(self), view, heard: Vec::new() }
    }

    /// Ends it. What happens after is not kept.
    pub fn finish(&self) {
        self.append(Entry::Ended { is_full: false });
    }
}

impl Log {
    /// Why the journal ended with this entry, if it did so before its time.
    fn append(&mut self, entry: Entry) -> Option<JournalEnd> {
        let is_end = matches!(entry, Entry::Ended { .. });
        let (sink, state) = (self.sink.as_mut()?, &mut self.state);
        let failed = |why: String| Some(JournalEnd::Failed(why));
        let written = match seal(self.number, entry) {
            Ok(bytes) if is_end || state.bytes + bytes.len() as u64 + END_BYTES <= state.limit_bytes => {
                state.bytes += bytes.len() as u64;
                self.number += 1;
                sink.write_all(&bytes).and_then(|()| sink.flush()).map_or_else(|e| failed(e.to_string()), |()| None)
            }
            Ok(_) => {
                let end = seal(self.number, Entry::Ended { is_full: true }).map_err(io::Error::other);
                let _ = end.and_then(|end| sink.write_all(&end)).and_then(|()| sink.flush());
                Some(JournalEnd::Full(state.limit_bytes))
            }
            Err(error) => failed(error.to_string()),
        };
        state.ended = written.as_ref().map(JournalEnd::to_string);
        if is_end || written.is_some() {
            self.sink = None;
        }
        written
    }
}

fn seal(number: u64, entry: Entry) -> Result<Vec<u8>, EnvelopeError> {
    let bytes = envelope::seal(&Record { number, entry })?;
    let length = bytes.len() as u64;
    if bytes.len() > RECORD_LIMIT {
        Err(EnvelopeError::TooLong { length, limit: RECORD_LIMIT as u64 })
    } else {
        Ok(bytes)
    }
}

/// The record of one view. Its end is written down when it is dropped.
pub struct Tape {
    journal: Arc<Journal>,
    view: u64,
    heard: Vec<Vec<u8>>,
}

impl Tape {
    /// The view has taken this message.
    pub fn hear(&mut self, message: &v1::StreamSceneRequest) {
        self.heard.push(message.encode_to_vec());
        if self.heard.len() >= MAX_HEARD {
            let (view, heard) = (self.view, std::mem::take(&mut self.heard));
            self.journal.append(Entry::Heard { view, heard });
        }
    }

    /// The view takes its exercise as it is now; [`Journal::order`] is held.
    pub fn follow(&mut self) {
        let (view, heard) = (self.view, std::mem::take(&mut self.heard));
        self.journal.append(Entry::Followed { view, heard });
    }

    /// The view has made these messages.
    pub fn make(&mut self, said: &[v1::StreamSceneResponse]) {
        let (view, heard) = (self.view, std::mem::take(&mut self.heard));
        self.journal.append(Entry::Made { view, heard, said: said.iter().map(Message::encode_to_vec).collect() });
    }
}

impl Drop for Tape {
    fn drop(&mut self) {
        self.journal.append(Entry::Closed { view: self.view });
    }
}

/// Why the next record cannot be had.
#[derive(Debug, Error)]
pub enum JournalError {
    /// The file could not be read.
    #[error("{0}")]
    Read(#[from] io::Error),
    /// It ends within a record, as when the server was killed while it wrote.
    #[error("it ends {left} bytes into record {number}, at byte {at}: its server did not come to write the rest")]
    Cut {
        /// The record.
        number: u64,
        /// Where it begins, in bytes.
        at: u64,
        /// Bytes of it that are there.
        left: u64,
    },
    /// The record is not what was written, or of another version of the program.
    #[error("record {number}, at byte {at}: {source}")]
    Damaged {
        /// The record.
        number: u64,
        /// Where it begins, in bytes.
        at: u64,
        /// What is wrong.
        source: EnvelopeError,
    },
    /// A record that does not follow the one before.
    #[error("record {number} is missing: at byte {at} stands record {found}")]
    Gap {
        /// The record.
        number: u64,
        /// Where it should begin, in bytes.
        at: u64,
        /// The record that is there.
        found: u64,
    },
}

/// Reads a journal record by record.
pub struct JournalReader<R> {
    input: R,
    number: u64,
    bytes: u64,
}

impl<R: Read> JournalReader<R> {
    /// A reader from the beginning.
    pub fn new(input: R) -> Self {
        Self { input, number: 0, bytes: 0 }
    }

    /// Bytes of the records read so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The next entry; `None` at the end. After an error there is no more.
    pub fn next_entry(&mut self) -> Result<Option<Entry>, JournalError> {
        let (number, at) = (self.number, self.bytes);
        let mut record = Vec::new();
        (&mut self.input).take(HEADER_BYTES as u64).read_to_end(&mut record)?;
        let Some(header) = record.first_chunk::<HEADER_BYTES>() else {
            let left = record.len() as u64;
            return if left == 0 { Ok(None) } else { Err(JournalError::Cut { number, at, left }) };
        };
        let stated = envelope::stated_length(header).min(RECORD_LIMIT as u64);
        (&mut self.input).take(stated).read_to_end(&mut record)?;
        let left = record.len() as u64;
        match envelope::open::<Record, RECORD_LIMIT>(&record) {
            Ok(found) if found.number != number => Err(JournalError::Gap { number, at, found: found.number }),
            Ok(found) => {
                (self.number, self.bytes) = (number + 1, at + left);
                Ok(Some(found.entry))
            }
            // A length that was turned may swallow the records after it: then it is not the end that is missing.
            Err(EnvelopeError::Length { expected, found }) if found < expected && !holds_a_record(&record) => {
                Err(JournalError::Cut { number, at, left })
            }
            Err(source) => Err(JournalError::Damaged { number, at, source }),
        }
    }
}

/// Whether a whole record stands somewhere after the first byte.
fn holds_a_record(bytes: &[u8]) -> bool {
    let starts = (1..bytes.len()).filter(|&at| bytes[at..].starts_with(&Record::MAGIC));
    starts.into_iter().any(|at| {
        let Some(header) = bytes[at..].first_chunk::<HEADER_BYTES>() else { return false };
        let end = envelope::stated_length(header).checked_add((at + HEADER_BYTES) as u64);
        let whole = end.and_then(|end| bytes.get(at..usize::try_from(end).ok()?));
        whole.is_some_and(|whole| envelope::open::<Record, RECORD_LIMIT>(whole).is_ok())
    })
}
