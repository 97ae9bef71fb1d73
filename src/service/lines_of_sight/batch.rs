//! Many lines in columns of equal length.

use rayon::prelude::*;
use sightline_proto::v1;
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
    los::{Lines, Options},
    terrain::HeightField,
};

/// Answers in one message of a batch: small enough that the first come soon.
const CHUNK_LINES: usize = 4_096;
/// Lines that one core takes together; between two shares it asks whether the call is still wanted.
const SHARE_LINES: usize = 64;

/// Lines to be answered.
pub(super) struct Batch {
    request: v1::QueryLineOfSightBatchRequest,
    frame: Frame,
    altitude: Altitude,
    options: Options,
}

/// Verdict, whether the line grazes, and whether both are exact.
type Brief = (v1::Verdict, bool, bool);

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
        Ok(Self { request, frame, altitude, options })
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
        for first in (0..self.len()).step_by(CHUNK_LINES) {
            let lines = first..self.len().min(first + CHUNK_LINES);
            let answers = self.answer(lines, &*shared.terrain, &shared.site, wanted)?;
            shared.metrics.answered(&answers.verdicts);
            send(sender, wanted, answers)?;
        }
        Ok(())
    }

    /// The answers to some of the lines. All are computed, then the first error in order wins, so that the answer does
    /// not depend on threads.
    pub(super) fn answer(
        &self,
        lines: std::ops::Range<usize>,
        terrain: &impl HeightField,
        site: &Site,
        wanted: &Wanted,
    ) -> Result<v1::QueryLineOfSightBatchResponse, Status> {
        let first_index = lines.start as u32;
        let numbers: Vec<usize> = lines.collect();
        let share = |share: &[usize]| -> Result<Vec<Brief>, Status> {
            wanted.check()?;
            let mut asked = Lines::new(terrain);
            share.iter().map(|&n| self.answer_one(n, terrain, site, &mut asked)).collect()
        };
        let shares: Vec<_> = numbers.par_chunks(SHARE_LINES).map(share).collect();
        let mut response = v1::QueryLineOfSightBatchResponse { first_index, ..Default::default() };
        for share in shares {
            for (verdict, grazes, certain) in share? {
                response.verdicts.push(verdict.into());
                response.grazes.push(grazes);
                response.certain.push(certain);
            }
        }
        Ok(response)
    }

    fn answer_one<H: HeightField>(
        &self,
        n: usize,
        terrain: &H,
        site: &Site,
        asked: &mut Lines<'_, H>,
    ) -> Result<Brief, Status> {
        let named = |status: Status| Status::new(status.code(), format!("line {n}: {}", status.message()));
        let Some([a, b]) = resolve(terrain, site, self.ends(n)).map_err(named)? else {
            return Ok((v1::Verdict::Unknown, false, true));
        };
        let answer = asked.ask(a, b, self.options).map_err(|error| named(error.into_status()))?;
        Ok((convert::verdict_to_wire(Some(answer.verdict)).0, answer.grazes, answer.certain))
    }
}
