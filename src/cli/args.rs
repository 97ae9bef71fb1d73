//! Parsing and output conventions that verbs share.

use std::{path::Path, str::FromStr};

use super::Failure;

/// `X,Y,Z` on the command line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Point(
    /// The three numbers.
    pub [f64; 3],
);

impl FromStr for Point {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<_> = text.split(',').collect();
        let [x, y, z] = parts[..] else {
            return Err(format!("'{text}' is not X,Y,Z: three numbers with commas between them"));
        };
        let number = |part: &str| match part.trim().parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(format!("'{part}' in '{text}' is not a finite number")),
        };
        Ok(Self([number(x)?, number(y)?, number(z)?]))
    }
}

/// Refuses to write over a file that exists, unless `force`.
pub fn refuse_existing(path: &Path, force: bool) -> Result<(), Failure> {
    if !force && path.exists() {
        return Err(Failure::Environment(format!("{} exists; give --force to replace it", path.display())));
    }
    Ok(())
}
