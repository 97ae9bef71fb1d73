//! The terrain database: its format (see `FORMAT.md`), writer, reader with a bounded page cache, verification, ingest.
