//! Why a database could not be opened or written.

use std::{io, path::PathBuf};

use thiserror::Error;

use super::envelope::EnvelopeError;
use crate::terrain::{GridError, ReadError};

/// Why a file could not be opened as a database.
#[derive(Debug, Error)]
pub enum OpenError {
    /// The system refused: no such file, no permission.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// It is another kind of file.
    #[error(
        "it is not a Sightline database: its first bytes are not the magic number; make one with `sightline ingest`"
    )]
    NotADatabase,
    /// It needs a newer program.
    #[error("it needs {0}, which this version of sightline does not know; use a newer sightline or ingest it again")]
    Unsupported(String),
    /// It is shorter or longer than it says.
    #[error("it is damaged: it has {found} bytes and states {expected} ({where_cut}); copy or ingest it again")]
    Length {
        /// Bytes stated in the header.
        expected: u64,
        /// Bytes there.
        found: u64,
        /// What the end of the file falls into.
        where_cut: String,
    },
    /// Its header, table or manifest does not hold what was written to it.
    #[error("its {what} is damaged: {detail}; copy or ingest it again")]
    Damaged {
        /// Which part.
        what: &'static str,
        /// What is wrong with it.
        detail: String,
    },
}

impl OpenError {
    pub(super) fn damaged(what: &'static str, detail: impl Into<String>) -> Self {
        Self::Damaged { what, detail: detail.into() }
    }

    /// Whether the file is, or was, a database.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Length { .. } | Self::Damaged { .. })
    }
}

/// Why a database could not be written. What was there before is still there.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The memory that was allowed is too little for a grid of this size.
    #[error(
        "a grid of {nx} x {ny} posts takes {} MiB of memory to ingest, more than the {} MiB allowed; give more with --memory",
        .needed.div_ceil(1 << 20),
        .given >> 20
    )]
    Memory {
        /// Bytes that are needed.
        needed: usize,
        /// Bytes that were allowed.
        given: usize,
        /// Posts from west to east.
        nx: u32,
        /// Posts from south to north.
        ny: u32,
    },
    /// The output exists and replacing it was not asked for.
    #[error("{} exists; give --force to replace it", .0.display())]
    Exists(PathBuf),
    /// The system refused.
    #[error("writing {}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        error: io::Error,
    },
    /// No post has a height.
    #[error("all {posts} posts are void: there is no terrain in this input; if NODATA was misread, give --nodata V")]
    AllVoid {
        /// Posts of the grid.
        posts: u64,
    },
    /// A height that a database cannot hold.
    #[error("the height {z} of post ({i}, {j}) is not a 32-bit integer of height units; choose another --unit")]
    Height {
        /// Column.
        i: u32,
        /// Row.
        j: u32,
        /// The height in height units.
        z: f64,
    },
    /// A number of the description that a database cannot hold.
    #[error("{0}")]
    Description(String),
    /// The terrain could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The size is not a grid's.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// The manifest could not be encoded.
    #[error("encoding the manifest: {0}")]
    Manifest(#[from] EnvelopeError),
}
