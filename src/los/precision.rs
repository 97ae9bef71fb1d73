//! The precision of a query: speed for certainty, as the caller chooses.

use std::{fmt, str::FromStr};

use thiserror::Error;

/// How certain an answer has to be.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub enum Precision {
    /// f32 at its word where a line lies within 2 x 2 pages: wrong wherever the clearance is lost in rounding, some 1e-5
    /// of the steps and heights there. Longer lines are asked as with [`Precision::F64`].
    Fast,
    /// f64 at its word, without the exact rung: wrong near ties.
    F64,
    /// Always right.
    #[default]
    Exact,
    /// From the hierarchy as soon as the answer cannot be wrong by more than so many height units: it is the exact one
    /// wherever the terrain raised and lowered by as much has the same verdict. Not below 0.
    Tolerance(f64),
}

/// Why a text is not a precision.
#[derive(Clone, PartialEq, Debug, Error)]
#[error("'{0}' is not a precision: it is exact, f64, fast, or tolerance:H with H height units, such as tolerance:0.5")]
pub struct NotAPrecision(String);

impl FromStr for Precision {
    type Err = NotAPrecision;

    fn from_str(text: &str) -> Result<Self, NotAPrecision> {
        let tolerance = || text.strip_prefix("tolerance:")?.parse().ok().filter(|h: &f64| h.is_finite() && *h >= 0.0);
        match text {
            "exact" => Ok(Self::Exact),
            "f64" => Ok(Self::F64),
            "fast" => Ok(Self::Fast),
            _ => tolerance().map(Self::Tolerance).ok_or_else(|| NotAPrecision(text.into())),
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fast => f.write_str("fast"),
            Self::F64 => f.write_str("f64"),
            Self::Exact => f.write_str("exact"),
            Self::Tolerance(h) => write!(f, "tolerance:{h}"),
        }
    }
}
