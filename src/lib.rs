//! Sightline: a server for multi-client terrain simulation with exact, consistent lines of sight.
//!
//! It holds one finest-resolution terrain, answers lines of sight on it exactly, and streams to each scene generator
//! a mesh of the triangle count that it asked for, refined so that every registered sight line has the same answer on
//! that mesh as on the finest terrain (Duchaineau et al., "Good terrain geometry, cheap!").
//!
//! Data flows down this list; imports point up it, which `tests/architecture.rs` enforces:
//!
//! [`terrain`] (the finest surface), [`wedgie`] (error bounds), [`view`] (cameras and screen distortion), [`dem`]
//! (elevation files), [`database`] (one immutable file), [`los`] (exact lines of sight), [`roam`] (refinement and
//! sight-line requirements), [`lod`] (other systems, for comparison), [`exercise`] (entities, sight lines, epochs),
//! [`session`] (a view's life), [`evaluate`] (flights, consistency), [`store`] (where exercises are kept), [`service`]
//! (gRPC), [`cli`] (the verbs).

pub mod cli;
pub mod database;
pub mod dem;
pub mod evaluate;
pub mod exercise;
pub mod lod;
pub mod los;
pub mod roam;
pub mod service;
pub mod session;
pub mod store;
pub mod terrain;
pub mod view;
pub mod wedgie;
