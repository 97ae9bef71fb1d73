//! Looks for values that are likely wrong, and changes none of them.
//!
//! - A **spike** is a known post with at least [`SPIKE_NEIGHBOURS`] known ones among its eight neighbours, that lies
//!   above all of them, or below all of them, by more than [`SPIKE_M`] and by more than [`SPIKE_SPREADS`] times the
//!   difference between the highest and the lowest of them. A summit or a pit of real terrain has sides; a wrong sample
//!   has none. Both numbers are guesses that let every real file at hand pass but those with spikes in them; what would
//!   change them is a real summit that is reported. Errors of more than one adjoining post are not found.
//! - A height **out of range** is below -11,000 m or above 9,000 m, where the Earth has no ground.
//! - A **mark** is a height of exactly -9999 m: what many writers use for no data.
//! - **Seams** are suspicious when tiles differ by more than [`SEAM_M`] where they share posts: the vertical error that
//!   SRTM's specification allows (90 % of posts).
//! - So is a raster without any known post.

use super::{DemError, Progress, Raster, SeamReport};

/// Least number of known neighbours of a spike.
pub const SPIKE_NEIGHBOURS: usize = 5;
/// Least distance of a spike from all its neighbours, in metres.
pub const SPIKE_M: f64 = 50.0;
/// And in differences between the highest and the lowest of them.
pub const SPIKE_SPREADS: f64 = 2.0;
/// Largest difference between tiles on shared posts that is not suspicious, in metres.
pub const SEAM_M: f64 = 16.0;
/// Where the Earth has ground, in metres.
pub const EARTH_M: std::ops::RangeInclusive<f64> = -11_000.0..=9_000.0;
/// What many writers use for no data.
pub const MARK_M: f64 = -9999.0;
/// Most findings that are kept; all are counted.
pub const MAX_FINDINGS: usize = 100;

/// What is suspicious about a post.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Suspicion {
    /// Far above all its neighbours.
    Spike,
    /// Far below all its neighbours.
    Pit,
    /// Where the Earth has no ground.
    OutOfRange,
    /// A value that many writers use for no data.
    Mark,
}

impl Suspicion {
    /// In a few words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Spike => "a spike above all its neighbours",
            Self::Pit => "a spike below all its neighbours",
            Self::OutOfRange => "out of the Earth's range",
            Self::Mark => "a value that often stands for no data",
        }
    }
}

/// A suspicious post.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Finding {
    /// What is suspicious.
    pub suspicion: Suspicion,
    /// Column, eastward.
    pub i: u32,
    /// Row, northward.
    pub j: u32,
    /// Its height in metres.
    pub height_m: f64,
}

/// What a check found.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct CheckReport {
    /// Posts in all.
    pub posts: u64,
    /// Posts without data.
    pub void_posts: u64,
    /// The lowest and the highest known post, the south-western of several; `None` when all are void.
    pub extremes: Option<[Extreme; 2]>,
    /// Spikes above their neighbours.
    pub spikes: u64,
    /// Spikes below their neighbours.
    pub pits: u64,
    /// Heights out of the Earth's range.
    pub out_of_range: u64,
    /// Heights that often stand for no data.
    pub marks: u64,
    /// The first [`MAX_FINDINGS`] of them, south row first.
    pub findings: Vec<Finding>,
    /// What the overlaps of a mosaic showed.
    pub seams: Option<SeamReport>,
}

/// A known post and its height.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Extreme {
    /// Column, eastward.
    pub i: u32,
    /// Row, northward.
    pub j: u32,
    /// Its height in metres.
    pub height_m: f64,
}

impl CheckReport {
    /// Whether anything is suspicious.
    pub fn is_suspicious(&self) -> bool {
        self.suspicious_posts() > 0 || self.are_seams_suspicious() || self.extremes.is_none()
    }

    /// Suspicious posts in all.
    pub fn suspicious_posts(&self) -> u64 {
        self.spikes + self.pits + self.out_of_range + self.marks
    }

    /// Whether tiles differ by more than they may.
    pub fn are_seams_suspicious(&self) -> bool {
        self.seams.is_some_and(|s| s.largest_difference_m > SEAM_M)
    }

    fn look(&mut self, i: u32, j: u32, height_m: f64, spike: Option<Suspicion>) {
        if height_m.is_nan() {
            self.void_posts += 1;
            return;
        }
        let here = Extreme { i, j, height_m };
        let [lowest, highest] = self.extremes.get_or_insert([here; 2]);
        if height_m < lowest.height_m {
            *lowest = here;
        }
        if height_m > highest.height_m {
            *highest = here;
        }
        let suspicion = match spike {
            _ if height_m == MARK_M => Suspicion::Mark,
            _ if !EARTH_M.contains(&height_m) => Suspicion::OutOfRange,
            Some(spike) => spike,
            None => return,
        };
        *match suspicion {
            Suspicion::Spike => &mut self.spikes,
            Suspicion::Pit => &mut self.pits,
            Suspicion::OutOfRange => &mut self.out_of_range,
            Suspicion::Mark => &mut self.marks,
        } += 1;
        if self.findings.len() < MAX_FINDINGS {
            self.findings.push(Finding { suspicion, i, j, height_m });
        }
    }
}

/// Reads all of `raster`, three rows at hand. `progress` counts posts.
pub fn check(raster: &mut dyn Raster, progress: &mut dyn FnMut(Progress)) -> Result<CheckReport, DemError> {
    let (nx, ny) = (raster.info().nx, raster.info().ny);
    let total = u64::from(nx) * u64::from(ny);
    let mut report = CheckReport { posts: total, ..CheckReport::default() };
    let void = || vec![f64::NAN; nx as usize];
    // South, here and north; beyond the raster nothing is known.
    let mut rows = [void(), void(), void()];
    raster.read_rows(0, &mut rows[2])?;
    for j in 0..ny {
        rows.rotate_left(1);
        match j + 1 {
            north if north < ny => raster.read_rows(north, &mut rows[2])?,
            _ => rows[2].fill(f64::NAN),
        }
        for i in 0..nx {
            report.look(i, j, rows[1][i as usize], spike(&rows, i as usize));
        }
        progress(Progress { done: u64::from(j + 1) * u64::from(nx), total });
    }
    report.seams = raster.seams();
    Ok(report)
}

/// Whether the post in the middle row is a spike.
fn spike([south, here, north]: &[Vec<f64>; 3], i: usize) -> Option<Suspicion> {
    let height = here[i];
    if height.is_nan() {
        return None;
    }
    let columns = i.saturating_sub(1)..(i + 2).min(here.len());
    let (mut known, mut least, mut most) = (0, f64::INFINITY, f64::NEG_INFINITY);
    for (row, is_here) in [(south, false), (here, true), (north, false)] {
        for n in columns.clone().filter(|n| (!is_here || *n != i) && !row[*n].is_nan()) {
            (known, least, most) = (known + 1, least.min(row[n]), most.max(row[n]));
        }
    }
    if known < SPIKE_NEIGHBOURS {
        return None;
    }
    let limit = f64::max(SPIKE_M, SPIKE_SPREADS * (most - least));
    match height {
        z if z - most > limit => Some(Suspicion::Spike),
        z if least - z > limit => Some(Suspicion::Pit),
        _ => None,
    }
}
