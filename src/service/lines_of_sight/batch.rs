//! Many lines in columns of equal length.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use sightline_proto::{predicates::exact_signs_here, v1};
use tonic::Status;

use super::{
    super::{
        ServedTerrain, Shared, convert,
        status::{IntoStatus, too_many, unequal},
        wanted::Wanted,
    },
    Sender, resolve, send,
};
use crate::{
    exercise::{Altitude, Frame, Place, Site},
    los::{self, Lines, Options},
    terrain::HeightField,
};

/// Answers in one message of a batch: small enough that the first come soon.
const CHUNK_LINES: usize = 4_096;
/// Lines that are put in order together: their answers wait for each other.
const WINDOW_LINES: usize = 8 * CHUNK_LINES;
/// Lines that one core takes together; between two shares it asks whether the call is still wanted.
const SHARE_LINES: usize = 64;

/// Lines to be answered.
pub(super) struct Batch {
    request: v1::QueryLineOfSightBatchRequest,
    frame: Frame,
    altitude: Altitude,
    options: Options,
    /// Lines answered that took exact arithmetic, and that nobody has counted yet.
    exact_lines: AtomicU64,
}

/// Verdict, whether the line grazes, and whether both are exact.
type Brief = (v1::Verdict, bool, bool);

/// The ends of a line in the grid frame; `None` when one is given above ground that is unknown.
type Resolved = Result<Option<[[f64; 3]; 2]>, Status>;

impl Batch {
    pub(super) fn new(
        request: v1::QueryLineOfSightBatchRequest,
        site: &Site,
        most_lines: usize,
    ) -> Result<Self, Status> {
        let columns = [&request.ax, &request.ay, &request.az, &request.bx, &request.by, &request.bz];
        let lengths = columns.map(Vec::len);
        if lengths.iter().any(|&length| length != lengths[0]) {
            return Err(unequal("ax, ay, az, bx, by, bz", &lengths));
        }
        if lengths[0] == 0 {
            return Err(Status::invalid_argument("a batch without lines"));
        }
        if lengths[0] > most_lines {
            return Err(too_many("lines in one batch", lengths[0], most_lines));
        }
        let (frame, altitude) = (convert::frame(request.frame)?, convert::altitude(request.altitude)?);
        let options = Options { strict: request.strict, ..convert::options(request.options.as_ref(), site)? };
        Ok(Self { request, frame, altitude, options, exact_lines: AtomicU64::new(0) })
    }

    pub(super) fn len(&self) -> usize {
        self.request.ax.len()
    }

    fn ends(&self, n: usize) -> [Place; 2] {
        let request = &self.request;
        let place = |position| Place { position, frame: self.frame, altitude: self.altitude };
        [place([request.ax[n], request.ay[n], request.az[n]]), place([request.bx[n], request.by[n], request.bz[n]])]
    }

    pub(super) fn send_all<T: ServedTerrain>(
        &self,
        shared: &Shared<T>,
        wanted: &Wanted,
        sender: &Sender<v1::QueryLineOfSightBatchResponse>,
    ) -> Result<(), Status> {
        for first in (0..self.len()).step_by(WINDOW_LINES) {
            let lines = first..self.len().min(first + WINDOW_LINES);
            let briefs = self.answer(lines, &*shared.terrain, &shared.site, wanted)?;
            for (n, briefs) in briefs.chunks(CHUNK_LINES).enumerate() {
                let answers = to_wire(first + n * CHUNK_LINES, briefs);
                shared.metrics.answered(&answers.verdicts, self.exact_lines.swap(0, Ordering::Relaxed));
                send(sender, wanted, answers)?;
            }
        }
        Ok(())
    }

    /// The answers to all lines in one message, and how many took exact arithmetic.
    pub(super) fn answer_all(
        &self,
        terrain: &impl HeightField,
        site: &Site,
        wanted: &Wanted,
    ) -> Result<(v1::QueryLineOfSightBatchResponse, u64), Status> {
        let answers = to_wire(0, &self.answer(0..self.len(), terrain, site, wanted)?);
        Ok((answers, self.exact_lines.swap(0, Ordering::Relaxed)))
    }

    /// The answers to some of the lines, in their order; they are asked in that of [`los::batch_order`]. All are
    /// computed, then the first error in the order of the lines wins, so that the answer does not depend on threads.
    fn answer(
        &self,
        lines: Range<usize>,
        terrain: &impl HeightField,
        site: &Site,
        wanted: &Wanted,
    ) -> Result<Vec<Brief>, Status> {
        let first = lines.start;
        let resolved = self.resolve_all(lines, terrain, site, wanted)?;
        let places: Vec<_> =
            resolved.iter().map(|ends| ends.as_ref().ok().copied().flatten().unwrap_or_default()).collect();
        let order = los::batch_order(terrain.grid(), &places);
        let share = |share: &[u32]| -> Result<Vec<Result<Brief, Status>>, Status> {
            wanted.check()?;
            let mut asked = Lines::new(terrain);
            Ok(share.iter().map(|&n| self.answer_one(first, n as usize, &resolved, &mut asked)).collect())
        };
        let shares: Vec<_> = order.par_chunks(SHARE_LINES).map(share).collect();
        let mut briefs: Vec<_> = resolved.iter().map(|_| Ok((v1::Verdict::Unknown, false, true))).collect();
        for (share, answers) in order.chunks(SHARE_LINES).zip(shares) {
            for (&n, brief) in share.iter().zip(answers?) {
                briefs[n as usize] = brief;
            }
        }
        briefs.into_iter().collect()
    }

    /// The ends of some of the lines in the grid frame.
    fn resolve_all(
        &self,
        lines: Range<usize>,
        terrain: &impl HeightField,
        site: &Site,
        wanted: &Wanted,
    ) -> Result<Vec<Resolved>, Status> {
        let numbers: Vec<usize> = lines.collect();
        let share = |share: &[usize]| -> Result<Vec<_>, Status> {
            wanted.check()?;
            let one = |&n: &usize| resolve(terrain, site, self.ends(n)).map_err(|status| named(n, &status));
            Ok(share.iter().map(one).collect())
        };
        let shares: Vec<Result<Vec<_>, Status>> = numbers.par_chunks(SHARE_LINES).map(share).collect();
        Ok(shares.into_iter().collect::<Result<Vec<_>, Status>>()?.concat())
    }

    /// The answer to line `n` of those from `first` on.
    fn answer_one<H: HeightField>(
        &self,
        first: usize,
        n: usize,
        resolved: &[Resolved],
        asked: &mut Lines<'_, H>,
    ) -> Result<Brief, Status> {
        let Some([a, b]) = resolved[n].clone()? else { return Ok((v1::Verdict::Unknown, false, true)) };
        let before = exact_signs_here();
        let answer = asked.ask(a, b, self.options).map_err(|error| named(first + n, &error.into_status()))?;
        if exact_signs_here() > before {
            self.exact_lines.fetch_add(1, Ordering::Relaxed);
        }
        Ok((convert::verdict_to_wire(Some(answer.verdict)).0, answer.grazes, answer.certain))
    }
}

/// The status of line `n`.
fn named(n: usize, status: &Status) -> Status {
    Status::new(status.code(), format!("line {n}: {}", status.message()))
}

fn to_wire(first_index: usize, briefs: &[Brief]) -> v1::QueryLineOfSightBatchResponse {
    let mut response = v1::QueryLineOfSightBatchResponse { first_index: first_index as u32, ..Default::default() };
    for &(verdict, grazes, certain) in briefs {
        response.verdicts.push(verdict.into());
        response.grazes.push(grazes);
        response.certain.push(certain);
    }
    response
}
