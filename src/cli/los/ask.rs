//! Whom to ask for a line of sight, and the answer in one shape.

use std::path::Path;

use rayon::prelude::*;
use sightline_client::{Client, ClientError, v1};

use super::more::More;
use crate::{
    cli::{Failure, args::EarthShape, connect, info},
    database::Database,
    exercise::{Altitude, Frame, Place, PlaceError, Site},
    los::{self, Derived, Earth, Lines, LosError, Options, Precision, Verdict},
    terrain::{Georeference, HeightField, ReadError},
};

/// Lines that are sent to a server in one call.
const SERVER_BATCH: usize = 50_000;
/// Lines of a file that one core takes together.
const SHARE_LINES: usize = 64;

/// How the ends are given and what blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Manner {
    pub(super) frame: Frame,
    pub(super) altitude: Altitude,
    pub(super) options: Options,
    /// As it was asked for: what a server is told.
    pub(super) earth: EarthShape,
    /// Whether to add what takes longer.
    pub(super) derive: bool,
}

/// The infimum of the points below ground, seen from one end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Obstruction {
    /// In the grid frame.
    pub(super) position: [f64; 3],
    /// Slant range from that end.
    pub(super) range_m: f64,
}

/// The answer about one line.
#[derive(Clone, Debug)]
pub(super) struct Reply {
    pub(super) verdict: &'static str,
    /// Why it is UNKNOWN.
    pub(super) reason: Option<&'static str>,
    pub(super) grazes: bool,
    /// Whether the verdict is exact.
    pub(super) certain: bool,
    /// The ends in the grid frame; `None` when there is no ground to stand on.
    pub(super) resolved: Option<[[f64; 3]; 2]>,
    /// Length in plan.
    pub(super) range_m: f64,
    /// 0 without a georeference.
    pub(super) sagitta_m: f64,
    pub(super) first_from_a: Option<Obstruction>,
    pub(super) first_from_b: Option<Obstruction>,
    /// In height units.
    pub(super) least_clearance: Option<f64>,
    pub(super) more: Option<More>,
}

const NO_GROUND: &str = "an end is given above ground where no ground is known";
const UNKNOWN_GROUND: &str = "the line passes over a void post or leaves the grid";

/// Verdict and whether the line grazes; all that a server says of a line in a batch.
pub(super) type Brief = (&'static str, bool);

/// Whoever knows the terrain.
pub(super) enum Asker {
    Database(Box<Database>, Site),
    Server(Client, tokio::runtime::Runtime),
}

impl Asker {
    /// A target with `://` is a server, any other a database.
    pub(super) fn open(target: &str) -> Result<Self, Failure> {
        if !target.contains("://") {
            let database = info::open(Path::new(target))?;
            let site = Site { scale: database.scale(), georeference: database.georeference() };
            return Ok(Self::Database(Box::new(database), site));
        }
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| Failure::environment("starting the network", error))?;
        let client = runtime.block_on(connect::connect(target))?;
        Ok(Self::Server(client, runtime))
    }

    /// The shape of the Earth under the terrain; a server works it out for itself.
    pub(super) fn earth(&self, shape: EarthShape) -> Result<Earth, Failure> {
        match self {
            Self::Database(_, site) => shape.earth(site.scale),
            Self::Server(..) => Ok(Earth::Flat),
        }
    }

    pub(super) fn is_server(&self) -> bool {
        matches!(self, Self::Server(..))
    }

    /// Everything about one line.
    pub(super) fn ask(&self, manner: Manner, ends: [[f64; 3]; 2]) -> Result<Reply, Failure> {
        match self {
            Self::Database(database, site) => resolve(database, site, manner, ends)
                .and_then(|ends| ask_database(database, &mut Lines::new(database), site, manner, ends))
                .map_err(place_failure),
            Self::Server(client, runtime) => {
                let [a, b] = ends.map(|end| Some(end_to_wire(manner, end)));
                let request = v1::QueryLineOfSightRequest {
                    a,
                    b,
                    strict: manner.options.strict,
                    derive: manner.options.precision == Precision::Exact,
                    options: Some(options_to_wire(manner)),
                    stretches: manner.derive,
                };
                runtime
                    .block_on(client.query(request))
                    .map_err(client_failure)
                    .map(|response| reply_from_wire(manner, response))
            }
        }
    }

    /// Everything about many lines, on all cores; `None` when only a server knows the terrain. The error of the first
    /// line that has one comes with its number.
    pub(super) fn ask_all(
        &self,
        manner: Manner,
        lines: &[[[f64; 3]; 2]],
    ) -> Option<Result<Vec<Reply>, (usize, Failure)>> {
        let Self::Database(database, site) = self else { return None };
        Some(ask_database_all(database, site, manner, lines).map_err(|(n, error)| (n, place_failure(error))))
    }

    /// Verdicts of many lines from a server.
    pub(super) fn ask_server(&self, manner: Manner, lines: &[[[f64; 3]; 2]]) -> Result<Vec<Brief>, Failure> {
        let Self::Server(client, runtime) = self else { return Ok(Vec::new()) };
        let mut all = Vec::with_capacity(lines.len());
        for part in lines.chunks(SERVER_BATCH) {
            let column = |end: usize, axis: usize| part.iter().map(|line| line[end][axis]).collect();
            let request = v1::QueryLineOfSightBatchRequest {
                frame: frame_to_wire(manner.frame).into(),
                altitude: altitude_to_wire(manner.altitude).into(),
                strict: manner.options.strict,
                options: Some(options_to_wire(manner)),
                ax: column(0, 0),
                ay: column(0, 1),
                az: column(0, 2),
                bx: column(1, 0),
                by: column(1, 1),
                bz: column(1, 2),
            };
            let answers = runtime.block_on(client.query_batch(request)).map_err(client_failure)?;
            if answers.verdicts.len() != part.len() {
                return Err(Failure::Input("the server answered fewer lines than it was asked".into()));
            }
            all.extend(answers.verdicts.into_iter().map(verdict_name).zip(answers.grazes));
        }
        Ok(all)
    }
}

/// The replies in the order of the lines, which are asked in that of [`los::batch_order`].
fn ask_database_all(
    database: &Database,
    site: &Site,
    manner: Manner,
    lines: &[[[f64; 3]; 2]],
) -> Result<Vec<Reply>, (usize, PlaceError)> {
    let resolved: Vec<_> = lines.par_iter().map(|&ends| resolve(database, site, manner, ends)).collect();
    let places: Vec<_> =
        resolved.iter().map(|ends| ends.as_ref().ok().copied().flatten().unwrap_or_default()).collect();
    let order = los::batch_order(HeightField::grid(database), &places);
    let shares = order.par_chunks(SHARE_LINES).map(|share| {
        let mut asked = Lines::new(database);
        let ask = |&n: &u32| {
            let ends = resolved[n as usize].clone();
            (n as usize, ends.and_then(|ends| ask_database(database, &mut asked, site, manner, ends)))
        };
        share.iter().map(ask).collect::<Vec<_>>()
    });
    let mut replies: Vec<_> = shares.flatten().collect();
    replies.sort_unstable_by_key(|(n, _)| *n);
    replies.into_iter().map(|(n, reply)| reply.map_err(|error| (n, error))).collect()
}

/// The ends in the grid frame; `None` when there is no ground to stand on.
fn resolve(
    database: &Database,
    site: &Site,
    manner: Manner,
    ends: [[f64; 3]; 2],
) -> Result<Option<[[f64; 3]; 2]>, PlaceError> {
    let [a, b] = ends.map(|position| {
        let place = Place { position, frame: manner.frame, altitude: manner.altitude };
        site.grid_from_place(database, &place, 0.0)
    });
    Ok(a?.zip(b?).map(|(a, b)| [a, b]))
}

fn ask_database(
    database: &Database,
    asked: &mut Lines<'_, Database>,
    site: &Site,
    manner: Manner,
    resolved: Option<[[f64; 3]; 2]>,
) -> Result<Reply, PlaceError> {
    let Some([a, b]) = resolved else {
        return Ok(Reply {
            verdict: Verdict::Unknown.name(),
            reason: Some(NO_GROUND),
            grazes: false,
            certain: true,
            resolved: None,
            range_m: 0.0,
            sagitta_m: 0.0,
            first_from_a: None,
            first_from_b: None,
            least_clearance: None,
            more: None,
        });
    };
    let answer = asked.ask(a, b, manner.options)?;
    // Derived values are exact about where the line goes under; beside another verdict they would contradict it.
    let derived = match manner.options.precision {
        Precision::Exact => los::derive(database, a, b, manner.options)?,
        _ => Derived::default(),
    };
    let more = manner.derive.then(|| More::new(database, a, b, manner.options, &derived)).transpose()?;
    let scale = site.scale;
    let apart = |p: [f64; 3], q: [f64; 3]| {
        let [x, y, z] = [(q[0] - p[0]) * scale.east_m, (q[1] - p[1]) * scale.north_m, (q[2] - p[2]) * scale.up_m];
        (x * x + y * y + z * z).sqrt()
    };
    let range_m = apart([a[0], a[1], 0.0], [b[0], b[1], 0.0]);
    let seen_from = |end, first: Option<los::Obstruction>| {
        first.map(|first| Obstruction { position: first.place.point, range_m: apart(end, first.place.point) })
    };
    Ok(Reply {
        verdict: answer.verdict.name(),
        reason: (answer.verdict == Verdict::Unknown).then_some(UNKNOWN_GROUND),
        grazes: answer.grazes,
        certain: answer.certain,
        resolved: Some([a, b]),
        range_m,
        sagitta_m: site.georeference.map_or(0.0, |_| Georeference::sagitta_m(range_m)),
        first_from_a: seen_from(a, derived.first_from_a),
        first_from_b: seen_from(b, derived.first_from_b),
        least_clearance: derived.least_clearance.filter(|_| answer.verdict == Verdict::Visible).map(|p| p.clearance),
        more,
    })
}

fn frame_to_wire(frame: Frame) -> v1::CoordinateFrame {
    match frame {
        Frame::Grid => v1::CoordinateFrame::Grid,
        Frame::Map => v1::CoordinateFrame::Map,
        Frame::Geographic => v1::CoordinateFrame::Geographic,
        Frame::Scene => v1::CoordinateFrame::Scene,
    }
}

fn altitude_to_wire(altitude: Altitude) -> v1::AltitudeReference {
    match altitude {
        Altitude::Absolute => v1::AltitudeReference::Absolute,
        Altitude::AboveGround => v1::AltitudeReference::AboveGround,
    }
}

fn options_to_wire(manner: Manner) -> v1::QueryOptions {
    let (precision, tolerance) = match manner.options.precision {
        Precision::Exact => (v1::Precision::Exact, 0.0),
        Precision::F64 => (v1::Precision::F64, 0.0),
        Precision::Fast => (v1::Precision::Fast, 0.0),
        Precision::Tolerance(tolerance) => (v1::Precision::Tolerance, tolerance),
    };
    let sphere = manner.earth.sphere().map(|(radius_m, refraction)| v1::SphericalEarth { radius_m, refraction });
    v1::QueryOptions { precision: precision.into(), tolerance, sphere }
}

fn end_to_wire(manner: Manner, [x, y, z]: [f64; 3]) -> v1::SightLineEnd {
    v1::SightLineEnd {
        position: Some(v1::Position { x, y, z }),
        frame: frame_to_wire(manner.frame).into(),
        altitude: altitude_to_wire(manner.altitude).into(),
    }
}

fn verdict_name(verdict: v1::Verdict) -> &'static str {
    match verdict {
        v1::Verdict::Unspecified => "UNSPECIFIED",
        v1::Verdict::Visible => Verdict::Visible.name(),
        v1::Verdict::Unknown => Verdict::Unknown.name(),
        v1::Verdict::Blocked => Verdict::Blocked.name(),
    }
}

fn reply_from_wire(manner: Manner, response: v1::QueryLineOfSightResponse) -> Reply {
    let more = (manner.derive && response.resolved.is_some()).then(|| More::from_wire(&response));
    let point = |p: Option<v1::Position>| p.map_or([0.0; 3], |p| [p.x, p.y, p.z]);
    let obstruction =
        |o: Option<v1::Obstruction>| o.map(|o| Obstruction { position: point(o.position), range_m: o.range_m });
    Reply {
        verdict: verdict_name(response.verdict()),
        reason: match response.unknown_reason() {
            // Only registered lines are ever inactive.
            v1::UnknownReason::Unspecified | v1::UnknownReason::Inactive => None,
            v1::UnknownReason::UnknownGround => Some(UNKNOWN_GROUND),
            v1::UnknownReason::NoGround => Some(NO_GROUND),
        },
        grazes: response.grazes,
        certain: response.certain,
        resolved: response.resolved.map(|segment| [point(segment.a), point(segment.b)]),
        range_m: response.range_m,
        sagitta_m: response.sagitta_m,
        first_from_a: obstruction(response.first_from_a),
        first_from_b: obstruction(response.first_from_b),
        least_clearance: response.least_clearance,
        more,
    }
}

pub(in crate::cli) fn place_failure(error: PlaceError) -> Failure {
    match error {
        PlaceError::NoGeoreference | PlaceError::NotGeographic => Failure::Usage(error.to_string()),
        PlaceError::Ground(LosError::Read(ReadError::Io { .. })) => Failure::Environment(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

fn client_failure(error: ClientError) -> Failure {
    match error {
        ClientError::Connect { .. } => Failure::Environment(error.to_string()),
        _ => Failure::Input(format!("the server: {error}")),
    }
}
