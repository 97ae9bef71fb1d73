//! Error bounds over the hierarchy: how far the finest surface strays from each diamond's triangles.
//!
//! The papers' *wedgie* is the solid between a bintree triangle raised and lowered by its thickness. Two thicknesses
//! are kept for each diamond: *tight*, the true maximum deviation rounded up, which proofs about sight lines use and
//! reports state; and *nested*, never less than any descendant's, which alone orders refinement.

use sightline_proto::diamond::Post;

use crate::terrain::ReadError;

/// What is known of the surface over one diamond. Thicknesses in height units, rounded up to f32.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct DiamondBounds {
    /// Greatest vertical distance between the drawn finest surface over the grid and the diamond's triangles.
    pub tight: f32,
    /// The greatest `tight` of this diamond and all its descendants.
    pub nested: f32,
    /// Radius in metres of a ball around the diamond's post, at its drawn height in the scene frame, that contains
    /// the drawn surface over the diamond, its triangles, and the balls of all its children.
    pub radius_m: f32,
}

/// A source of bounds for every diamond of a root square.
pub trait ErrorBounds: Send + Sync {
    /// The bounds of the diamond at `p`, which must be a post of the root square but not a corner.
    fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError>;
}
