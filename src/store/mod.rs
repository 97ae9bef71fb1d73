//! Where exercises are kept.
