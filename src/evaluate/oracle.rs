//! Where the comparison gets the truth from: the finest terrain, asked by the instrument itself and by nobody else.

use sightline_proto::v1;
use thiserror::Error;

use crate::{
    los::{self, LosError, Options, Verdict},
    terrain::{Grid, HeightField},
};

/// Why the truth could not be had. Never a verdict.
#[derive(Clone, PartialEq, Debug, Error)]
#[error("the finest terrain does not answer: {0}")]
pub struct OracleError(#[from] pub LosError);

/// A sight line's ends in the grid frame.
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

    /// Where a blocked line is first obstructed, seen from A, as a part of AB; `None` where it passes an unknown point
    /// before.
    fn first_obstruction(&mut self, ends: Ends) -> Result<Option<f64>, OracleError>;

    /// The same verdict by the naive rational reference.
    fn naive_verdict(&mut self, ends: Ends) -> Result<v1::Verdict, OracleError>;
}

/// The truth of a height field.
#[derive(Debug)]
pub struct FieldOracle<'a, H: HeightField + ?Sized>(pub &'a H);

impl<H: HeightField + ?Sized> Oracle for FieldOracle<'_, H> {
    fn grid(&self) -> Grid {
        self.0.grid()
    }

    fn above_ground(&mut self, x: f64, y: f64, above: f64) -> Result<Option<f64>, OracleError> {
        Ok(los::on_ground(self.0, x, y, above)?)
    }

    fn verdict(&mut self, [a, b]: Ends) -> Result<v1::Verdict, OracleError> {
        Ok(wire_verdict(los::line_of_sight(self.0, a, b, Options::default())?.verdict))
    }

    fn first_obstruction(&mut self, [a, b]: Ends) -> Result<Option<f64>, OracleError> {
        Ok(los::known_obstruction(self.0, a, b)?.map(|first| first.place.t))
    }

    fn naive_verdict(&mut self, [a, b]: Ends) -> Result<v1::Verdict, OracleError> {
        Ok(wire_verdict(los::naive::line_of_sight(self.0, a, b, Options::default())?.verdict))
    }
}

fn wire_verdict(verdict: Verdict) -> v1::Verdict {
    match verdict {
        Verdict::Visible => v1::Verdict::Visible,
        Verdict::Unknown => v1::Verdict::Unknown,
        Verdict::Blocked => v1::Verdict::Blocked,
    }
}
