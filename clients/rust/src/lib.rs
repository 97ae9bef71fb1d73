//! Rust client of a Sightline server.

pub mod raster;
pub mod scene;
