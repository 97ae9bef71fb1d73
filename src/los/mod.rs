//! Exact lines of sight on the finest surface, and what follows from them.
//!
//! AB is a closed segment with finite f64 ends in the grid frame, each number taken at its exact value. **Blocked**:
//! some point of AB over a known point of the plane lies strictly below the surface. **Unknown**: not blocked, and some
//! point of AB is over an unknown point (a point is known when all posts of the smallest face that contains it are in
//! the grid and not void). **Visible**: otherwise; contact does not block. So A sees B exactly when B sees A.
//!
//! On one triangle the line and the surface are linear, so the ends of each chord decide: the ends of AB (`surface`)
//! and the crossings of AB with the four families of edge lines (`sweep`, `walk`). Nothing here sees a database:
//! heights come through [`HeightField`], and what could not be read is an error, never a verdict.
//!
//! Which points obstruct, how deep and how near ([`witnesses`], [`derive()`]) is told by `derived`.
//! What one observer sees of a whole region is told by [`viewshed()`], whose cells are these verdicts.
//!
//! Short lines are mostly settled by one look with bounds of its errors (`glance`). Greatest and least heights of blocks
//! ([`crate::terrain::extremes`]) let long ones pass over what lies below them and stop far below the ground (`skip`),
//! and an inner loop takes what remains (`run`). None of these changes an answer; [`Lines::plain`] does without them.
//!
//! [`naive`] answers the same questions straight from the definitions, slowly, and shares no code with the rest.

mod derived;
#[cfg(test)]
mod derived_tests;
mod dyadic;
mod earth;
#[cfg(test)]
mod earth_tests;
mod glance;
#[cfg(test)]
mod glance_tests;
mod ground;
mod horizon;
mod matrix;
pub mod naive;
mod precision;
mod profile;
mod ray;
mod real;
mod run;
mod skip;
mod surface;
mod sweep;
#[cfg(test)]
mod tests;
mod viewshed;
mod walk;

pub use derived::{
    Derived, GroundState, LineState, MAX_WITNESSES, Obstruction, Place, Stretch, Witness, derive, ground_stretches,
    known_obstruction, least_target_height, line_stretches, witnesses,
};
pub use earth::{Curvature, Earth};
pub use ground::{GroundPoint, ground, ground_batch};
pub use horizon::{Horizon, HorizonCrest, horizon};
pub use matrix::{Matrix, matrix};
pub use precision::{NotAPrecision, Precision};
pub use profile::{Break, profile};
pub use ray::{Ray, RayEnd, RayHit, ray, ray_end};
pub use surface::{Face, on_ground, surface_height};
pub use viewshed::{Progress, Region, Summary, Tile, View, ViewshedError, viewshed, viewshed_extent};

use rayon::prelude::*;
use sightline_proto::{
    predicates::{Exact, FilterOnly, Kernel},
    verdict::MeshVerdict,
};
use thiserror::Error;

use self::walk::Walk;
use crate::terrain::{Grid, HeightField, PAGE_SIDE, ReadError};

/// The verdict on a line of sight, in the order in which verdicts of parts combine: the greatest wins.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Verdict {
    /// Nothing known or unknown is in the way.
    Visible,
    /// Not blocked, but part of the line is over unknown ground.
    Unknown,
    /// Some point of the line over known ground is strictly below it.
    Blocked,
}

impl Verdict {
    /// VISIBLE, UNKNOWN or BLOCKED.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Visible => "VISIBLE",
            Self::Unknown => "UNKNOWN",
            Self::Blocked => "BLOCKED",
        }
    }

    /// What a mesh must show of it; `None` for UNKNOWN, which asks nothing of a mesh.
    pub const fn on_mesh(self) -> Option<MeshVerdict> {
        match self {
            Self::Visible => Some(MeshVerdict::Visible),
            Self::Unknown => None,
            Self::Blocked => Some(MeshVerdict::Blocked),
        }
    }
}

/// How to ask for a line of sight.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
pub struct Options {
    /// Whether contact with known ground strictly between the ends blocks.
    pub strict: bool,
    /// How certain the answer has to be. On a curved Earth it is always exact.
    pub precision: Precision,
    /// The shape of the Earth under the line.
    pub earth: Earth,
}

/// The answer to a line-of-sight question.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Answer {
    /// The verdict; exact when [`Answer::certain`].
    pub verdict: Verdict,
    /// For a visible line: whether it touches the surface strictly between its ends.
    pub grazes: bool,
    /// Whether verdict and grazing are exact. Never so for FAST and F64; so for TOLERANCE unless bounds decided
    /// something within the tolerance.
    pub certain: bool,
}

impl Answer {
    /// Stands where there is none as yet.
    const NONE: Self = Self { verdict: Verdict::Unknown, grazes: false, certain: false };
}

/// Why a line-of-sight question has no answer.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum LosError {
    /// A coordinate is NaN or infinite.
    #[error("{what} is {value}: coordinates must be finite numbers")]
    NotFinite {
        /// Which coordinate.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A tolerance is negative or not a number.
    #[error("a tolerance of {0} height units: it must be a number not below 0")]
    BadTolerance(f64),
    /// A radius, a curvature or a range that makes no sense.
    #[error("{what} is {value}: it must be {must}")]
    OutOfBounds {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// A line crosses more edges than the caller wants to know of.
    #[error("the line crosses more than {limit} edges: ask for a part of it, or raise the limit")]
    TooManyBreaks {
        /// The limit that was given.
        limit: usize,
    },
    /// The ground plus the height asked for is beyond the range of f64.
    #[error("{height} above the ground at ({x}, {y}) is beyond the range of numbers")]
    OutOfRange {
        /// East coordinate in posts.
        x: f64,
        /// North coordinate in posts.
        y: f64,
        /// Height above the ground in height units.
        height: f64,
    },
    /// The terrain could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// The line of sight from `a` to `b` on the finest surface of `field`. Ends in the grid frame.
pub fn line_of_sight<H>(field: &H, a: [f64; 3], b: [f64; 3], options: Options) -> Result<Answer, LosError>
where
    H: HeightField + ?Sized,
{
    Lines::new(field).ask(a, b, options)
}

/// [`line_of_sight`] by the plain walk ([`Lines::plain`]) with the rungs of `K`, whatever the precision; a kernel without
/// an exact rung is wrong near ties.
pub fn line_of_sight_with<K, H>(field: &H, a: [f64; 3], b: [f64; 3], options: Options) -> Result<Answer, LosError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    Lines::plain(field).ask_with::<K>(a, b, options, Manner { plain: true, ..Manner::default() })
}

/// How crossings and blocks are decided besides the kernel.
#[derive(Clone, Copy, Default, Debug)]
struct Manner {
    /// Without skipping.
    plain: bool,
    /// How far to go when rounded numbers do not tell.
    rung: Rung,
    /// In height units.
    tolerance: f64,
}

/// What is asked beyond rounded numbers.
#[derive(Clone, Copy, PartialEq, Default, Debug)]
enum Rung {
    /// Bounds of errors, and the ladder where they do not tell.
    #[default]
    Sure,
    /// Nothing: f64 at its word.
    Rounded,
    /// Nothing: f32 at its word.
    Fast,
}

/// Asks one line after the other of one field, with the pages of the last ones at hand.
pub struct Lines<'a, H: HeightField + ?Sized> {
    walk: Walk<'a, H>,
    plain: bool,
}

impl<'a, H: HeightField + ?Sized> Lines<'a, H> {
    /// Lines of `field`.
    pub fn new(field: &'a H) -> Self {
        Self { walk: Walk::new(field, [0.0; 3], [0.0; 3]), plain: false }
    }

    /// Lines of `field` by the plain walk, which looks at every crossing on the way. The same answers in more time:
    /// to check the others with, and to compare.
    pub fn plain(field: &'a H) -> Self {
        Self { plain: true, ..Self::new(field) }
    }

    /// The line of sight from `a` to `b`.
    #[inline]
    pub fn ask(&mut self, a: [f64; 3], b: [f64; 3], options: Options) -> Result<Answer, LosError> {
        if !options.earth.is_flat() {
            check_finite(a, ["ax", "ay", "az"])?;
            check_finite(b, ["bx", "by", "bz"])?;
            if let Precision::Tolerance(tolerance) = options.precision
                && (tolerance.is_nan() || tolerance < 0.0)
            {
                return Err(LosError::BadTolerance(tolerance));
            }
            self.walk.manner = Manner { plain: self.plain, ..Manner::default() };
            return derived::curved_answer(&mut self.walk, a, b, options);
        }
        let manner = Manner { plain: self.plain, ..Manner::default() };
        match options.precision {
            Precision::Exact => self.ask_with::<Exact>(a, b, options, manner),
            Precision::F64 => self.ask_with::<FilterOnly>(a, b, options, Manner { rung: Rung::Rounded, ..manner }),
            Precision::Fast => self.ask_with::<FilterOnly>(a, b, options, Manner { rung: Rung::Fast, ..manner }),
            Precision::Tolerance(tolerance) if tolerance >= 0.0 => {
                self.ask_with::<Exact>(a, b, options, Manner { tolerance, ..manner })
            }
            Precision::Tolerance(tolerance) => Err(LosError::BadTolerance(tolerance)),
        }
    }

    fn ask_with<K: Kernel>(
        &mut self,
        a: [f64; 3],
        b: [f64; 3],
        options: Options,
        manner: Manner,
    ) -> Result<Answer, LosError> {
        (self.walk.a, self.walk.b, self.walk.manner) = (a, b, manner);
        let met = match walk::at_a_glance(&mut self.walk)? {
            Some(met) => met,
            None => {
                let is_inside = self.walk.is_inside();
                if !is_inside {
                    check_finite(a, ["ax", "ay", "az"])?;
                    check_finite(b, ["bx", "by", "bz"])?;
                }
                walk::walk::<K, H>(&mut self.walk, is_inside, options.strict)?
            }
        };
        let blocked = met.blocked || options.strict && met.contact;
        let verdict = match (blocked, met.unknown) {
            (true, _) => Verdict::Blocked,
            (_, true) => Verdict::Unknown,
            _ => Verdict::Visible,
        };
        let certain = !met.tolerated && !matches!(options.precision, Precision::Fast | Precision::F64);
        Ok(Answer { verdict, grazes: verdict == Verdict::Visible && met.contact, certain })
    }
}

/// Lines of a batch that one core takes together.
const BATCH_SHARE: usize = 1024;
/// Lines that are fetched together.
const GATHER: usize = 32;
/// Batches of fewer lines are asked in the order in which they came.
const WORTH_SORTING: usize = 1024;
/// Binary logarithm of the squares along each side of the grid by which a batch is sorted.
const SQUARES_SHIFT: u32 = 7;

/// Many lines at once, over all cores, answers in the order of `lines`. The first error in that order wins.
///
/// They are asked in the order of their middles along a Z curve, so that lines that follow each other read the same
/// pages. That order changes no answer.
pub fn line_of_sight_batch<H>(field: &H, lines: &[[[f64; 3]; 2]], options: Options) -> Result<Vec<Answer>, LosError>
where
    H: HeightField + ?Sized,
{
    let order = batch_order(field.grid(), lines);
    let shares: Vec<_> = order.par_chunks(BATCH_SHARE).map(|share| ask_share(field, lines, share, options)).collect();
    let mut answers = vec![Answer::NONE; lines.len()];
    let mut failure: Option<(u32, LosError)> = None;
    for (share, (found, failed)) in order.chunks(BATCH_SHARE).zip(shares) {
        for (&n, answer) in share.iter().zip(found) {
            answers[n as usize] = answer;
        }
        failure = failure.into_iter().chain(failed).min_by_key(|(n, _)| *n);
    }
    failure.map_or(Ok(answers), |(_, error)| Err(error))
}

/// The answers to the lines of these numbers; of those without one, the first in the order of `lines`.
fn ask_share<H>(
    field: &H,
    lines: &[[[f64; 3]; 2]],
    share: &[u32],
    options: Options,
) -> (Vec<Answer>, Option<(u32, LosError)>)
where
    H: HeightField + ?Sized,
{
    let mut asked = Lines::new(field);
    let mut failure: Option<(u32, LosError)> = None;
    let mut answers = Vec::with_capacity(share.len());
    for share in share.chunks(GATHER) {
        // Lines that lie scattered are fetched together, so that the processor waits for all of them once.
        let mut gathered = [[[0.0; 3]; 2]; GATHER];
        for (line, &n) in gathered.iter_mut().zip(share) {
            *line = lines[n as usize];
        }
        for (&n, [a, b]) in share.iter().zip(gathered) {
            answers.push(asked.ask(a, b, options).unwrap_or_else(|error| {
                failure = failure.take().into_iter().chain([(n, error)]).min_by_key(|(n, _)| *n);
                Answer::NONE
            }));
        }
    }
    (answers, failure)
}

/// The numbers of lines in the order in which a batch of them is best asked: by the square of posts that their middle is
/// in, along a Z curve, and as they came in each. One counting sort, which takes a small part of the time of short lines.
pub fn batch_order(grid: Grid, lines: &[[[f64; 3]; 2]]) -> Vec<u32> {
    if lines.len() < WORTH_SORTING {
        return (0..lines.len() as u32).collect();
    }
    // Squares of a page, or as much larger as it takes to have at most 128 x 128 of them.
    let longest = grid.nx().max(grid.ny());
    let shift = (u32::BITS - (longest - 1).leading_zeros()).saturating_sub(SQUARES_SHIFT).max(PAGE_SIDE.ilog2());
    let per = 0.5 / f64::from(1_u32 << shift);
    let square_of = |[a, b]: &[[f64; 3]; 2]| {
        // Casts of what is beyond the grid end up at its border, or at another square: that harms nobody.
        let along = |k: usize| spread(((a[k] + b[k]) * per) as u32 & ((1 << SQUARES_SHIFT) - 1));
        (along(0) | along(1) << 1) as usize
    };
    let mut starts = vec![0_u32; 1 << (2 * SQUARES_SHIFT)];
    let squares: Vec<u32> = lines.iter().map(|line| square_of(line) as u32).collect();
    for &square in &squares {
        starts[square as usize] += 1;
    }
    let mut next = 0;
    for start in &mut starts {
        (*start, next) = (next, next + *start);
    }
    let mut order = vec![0; lines.len()];
    for (n, &square) in (0..).zip(&squares) {
        let start = &mut starts[square as usize];
        order[*start as usize] = n;
        *start += 1;
    }
    order
}

/// The bits of a number below 256 with a zero before each.
fn spread(bits: u32) -> u32 {
    let bits = (bits | bits << 4) & 0x0f0f;
    let bits = (bits | bits << 2) & 0x3333;
    (bits | bits << 1) & 0x5555
}

fn check_finite(values: [f64; 3], names: [&'static str; 3]) -> Result<(), LosError> {
    for (value, what) in values.into_iter().zip(names) {
        if !value.is_finite() {
            return Err(LosError::NotFinite { what, value });
        }
    }
    Ok(())
}
