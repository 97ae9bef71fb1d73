//! Error bounds over the hierarchy: how far the finest surface strays from each diamond's triangles.
//!
//! The papers' *wedgie* (Duchaineau et al., "Good terrain geometry, cheap!", sections 5 and 6.2) is the solid between a
//! bintree triangle raised and lowered by its thickness. Two thicknesses are kept for each diamond: *tight*, the true
//! maximum deviation rounded up, which proofs about sight lines use and reports state; and *nested*, never less than
//! any descendant's, which alone orders refinement. The paper takes one thickness, built up from the children's; here
//! the true deviation is measured, and the order is made monotone ("refinable") by the nested thickness and ball.
//!
//! Deviations are counted at the posts of the grid (filled voids included): padding adds none of its own. They are
//! attained at posts, since every bintree triangle is a union of finest triangles and so is the grid rectangle.

mod abreast;
mod band;
mod deviation;
mod finest;
mod finest_rows;
mod inner;
mod memory;
mod pyramid;
mod store;
#[cfg(test)]
mod tests;

use sightline_proto::diamond::Post;

use crate::terrain::ReadError;

pub use finest::{finest_bounds, finest_bounds_with};
pub use memory::MemoryTerrain;
pub use pyramid::{BAND_BYTES, BoundsPyramid, Lattice, ROW_BYTES, compute_bounds};
pub use store::{BoundsStore, Effort, LatticeSize, TightReader};

/// What is known of the surface over one diamond. Thicknesses in height units, rounded up to f32.
///
/// Never NaN; +infinity where the heights are so great that nothing less is sure. All zero for diamonds beyond the
/// grid that no descendant's deviation reaches.
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

    /// The same, and the drawn height of `p` where it is had with them. `None` tells nothing: then the height is where all
    /// heights are.
    fn bounds_and_height(&self, p: Post) -> Result<(DiamondBounds, Option<f64>), ReadError> {
        Ok((self.bounds(p)?, None))
    }
}

/// Each ball is widened by this factor over what f64 arithmetic gives for it. Rounding in distances is below 2^-48 of
/// the coordinates involved; so a child's ball lies within its parent's, with room to spare for the rounding of those
/// who compare the two, as long as coordinates stay below 2^30 times the radius.
const BALL_MARGIN: f64 = 1.0 + 1.0 / 65_536.0;

/// Bits that a bound, rounded up, leaves free at the low end of an f32: so a database keeps it in three bytes.
const FREE_BITS: u32 = 7;

/// The least f32 not below `x`, which is not negative, whose last [`FREE_BITS`] bits are 0; +infinity for NaN, which
/// stands for "nothing is sure".
#[inline]
fn round_up(x: f64) -> f32 {
    if x.is_nan() {
        return f32::INFINITY;
    }
    let nearest = x as f32;
    // For floats that are not negative, bits order as values, and infinity follows the greatest.
    let bits = nearest.to_bits() + u32::from(f64::from(nearest) < x);
    let free = (1 << FREE_BITS) - 1;
    f32::from_bits((bits + free) & !free)
}
