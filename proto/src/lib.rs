//! What a Sightline server and its clients share, so that a client can check itself.
//!
//! Imports nothing else of this project. Contents, in the order of data flow:
//! [`diamond`] (topology of the bisection hierarchy, by arithmetic), [`predicates`] (exact signs, with
//! [`number`], the arithmetic under them), [`mesh`] (a set of
//! active posts with heights, and its triangles), [`verdict`] (the line of sight on a mesh), [`codec`] (a mesh as
//! bytes, see `WIRE.md`), [`replica`] (a mesh kept up to date by frames) and [`v1`] (the generated messages and services).

pub mod codec;
mod context;
pub mod diamond;
mod heights;
pub mod mesh;
pub mod number;
pub mod predicates;
#[cfg(test)]
mod predicates_tests;
mod range_coder;
pub mod replica;
mod sides;
pub mod verdict;
#[cfg(test)]
mod verdict_tests;
mod walk;

/// The id that no sight line may have: frames use it for the requirement that the eye is not under its own mesh.
pub const EYE_LINE_ID: u64 = u64::MAX;

/// Messages and services of package `sightline.v1`, generated from `sightline/v1/*.proto`.
#[allow(missing_docs, unreachable_pub, clippy::all)]
pub mod v1 {
    tonic::include_proto!("sightline.v1");

    /// The encoded descriptors of this package, for server reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
}
