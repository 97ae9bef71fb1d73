//! The rows of the file that keeps exercises, and what makes no sense in them. Each stands in an envelope of its own
//! ([`crate::database::envelope`]).

use serde::{Deserialize, Serialize};

use crate::{
    database::envelope::Sealed,
    exercise::{Anchor, Entity, Lease, SightLine},
    roam::Fidelity,
};

/// Version of all rows.
pub(super) const FORMAT: u32 = 1;

/// What is kept of an exercise beside its entities and sight lines.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub(super) struct Head {
    pub(super) created: u64,
    pub(super) revision: u64,
    pub(super) epoch: u64,
}

/// What is kept of a lease beside its number.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub(super) struct LeaseRow {
    pub(super) owner: String,
    pub(super) term_s: u32,
    pub(super) holds_exercise: bool,
}

/// The number of the lease that a thing is under.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub(super) struct Under(pub(super) u64);

impl Sealed for Head {
    const MAGIC: [u8; 8] = *b"SLxExerc";
    const VERSION: u32 = FORMAT;

    fn check(&self) -> Result<(), String> {
        if self.created <= self.revision { Ok(()) } else { Err("it was made after its last change".into()) }
    }
}

impl Sealed for LeaseRow {
    const MAGIC: [u8; 8] = *b"SLxLease";
    const VERSION: u32 = FORMAT;

    fn check(&self) -> Result<(), String> {
        Lease::new(&self.owner, self.term_s).map(|_| ()).map_err(|error| error.to_string())
    }
}

impl Sealed for Under {
    const MAGIC: [u8; 8] = *b"SLxUnder";
    const VERSION: u32 = FORMAT;

    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}

impl Sealed for Entity {
    const MAGIC: [u8; 8] = *b"SLxEntit";
    const VERSION: u32 = FORMAT;

    fn check(&self) -> Result<(), String> {
        check_numbers(self.place.position.into_iter().chain(self.ground_m))?;
        if self.ground_m.is_none_or(|ground_m| ground_m > 0.0) { Ok(()) } else { Err("ground_m is not above 0".into()) }
    }
}

impl Sealed for SightLine {
    const MAGIC: [u8; 8] = *b"SLxLine_";
    const VERSION: u32 = FORMAT;

    fn check(&self) -> Result<(), String> {
        for anchor in [self.a, self.b] {
            match anchor {
                Anchor::Point(place) => check_numbers(place.position)?,
                Anchor::Entity { offset_m, .. } => check_numbers([offset_m])?,
            }
        }
        let distance_m = if let Fidelity::Obstruction { distance_m } = self.fidelity { distance_m } else { 0.0 };
        let sizes = [Some(distance_m), self.range_m, self.region.map(|region| region.radius_m)];
        check_numbers(self.region.into_iter().flat_map(|region| region.centre).chain(sizes.into_iter().flatten()))?;
        if sizes.into_iter().flatten().any(|size| size < 0.0) || self.fidelity == Fidelity::Ground {
            return Err("a distance is negative, or the fidelity is no line's".into());
        }
        Ok(())
    }
}

fn check_numbers(numbers: impl IntoIterator<Item = f64>) -> Result<(), String> {
    if numbers.into_iter().all(f64::is_finite) { Ok(()) } else { Err("a number is not finite".into()) }
}
