//! Where the comparison gets the truth from: the finest terrain, asked by the instrument itself and by nobody else.

use sightline_proto::v1;
use thiserror::Error;

use crate::terrain::Grid;

/// Why the truth could not be had. Never a verdict.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
#[error("the finest terrain does not answer: {0}")]
pub struct OracleError(pub String);

/// A sight line's ends in the grid frame, or places above ground still to be resolved.
pub type Ends = [[f64; 3]; 2];

/// Exact answers on the finest terrain.
pub trait Oracle {
    /// The extent of the terrain.
    fn grid(&self) -> Grid;

    /// The height, in height units, of an end `above` units over the surface at (x, y) of the grid frame: the least
    /// f64 not below exact surface + height. `None` over unknown ground.
    fn above_ground(&mut self, x: f64, y: f64, above: f64) -> Result<Option<f64>, OracleError>;

    /// The exact verdict: VISIBLE, UNKNOWN or BLOCKED.
    fn verdict(&mut self, ends: Ends) -> Result<v1::Verdict, OracleError>;

    /// The same by the naive rational reference.
    fn naive_verdict(&mut self, ends: Ends) -> Result<v1::Verdict, OracleError>;
}
