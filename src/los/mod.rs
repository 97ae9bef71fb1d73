//! Exact lines of sight on the finest surface, and the naive reference that they are tested against.
