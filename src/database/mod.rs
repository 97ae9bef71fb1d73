//! The terrain database: its format (see `FORMAT.md`), writer, reader with a bounded page cache, verification, ingest.
//!
//! One immutable file, paged, versioned by a hash of its content. It is opened by reading its first few kilobytes,
//! whatever its size; pages are read when they are asked for, and each is checked against its checksum then. Damage is
//! an error for the query that meets it, never a wrong height and never a panic. There is no memory mapping, so a file
//! that shrinks while it is open is an error and not a signal; `PageSource` is where a mapping would go.

mod budget;
mod cache;
mod coarse;
mod crown;
mod curve;
#[cfg(test)]
mod damage_tests;
mod directory;
mod draft;
pub mod envelope;
mod error;
mod fill;
mod format;
#[cfg(test)]
mod hostile_tests;
mod ingest;
mod layout;
mod manifest;
mod pages;
mod reader;
mod scratch;
mod source;
mod statistics;
#[cfg(test)]
mod tests;
mod verify;
mod writer;

pub use budget::DEFAULT_MEMORY_BYTES;
pub use error::{OpenError, WriteError};
pub use ingest::{IngestError, IngestOptions, IngestProgress, Ingested, Stage, VoidPolicy, ingest};
pub use manifest::{Provenance, TerrainManifest, version_digits};
pub use reader::{Database, OpenOptions, Reads, SectionInfo};
pub use statistics::{
    DEVIATION_PERCENTS, HEIGHT_BANDS, HEIGHT_PERCENTS, HeightStatistics, LevelStatistics, Statistics, statistics,
};
pub use verify::{Verification, verify};
pub use writer::{Description, Written, write};
