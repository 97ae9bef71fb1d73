//! One run of a consistency test: chooses a world, directs it, flies independent clients over it, and compares.
//!
//! The server is only one side of the comparison. The truth is computed here, from the database and from the world that
//! this process itself directs; the other side are records of processes that have nothing but the bytes received.

use std::{collections::BTreeMap, sync::Arc, time::Instant};

use glam::DQuat;
use serde::Serialize;
use sightline_proto::{diamond::Post, v1};
use tokio::sync::mpsc;

use super::{
    super::{
        Failure, connect,
        generator::{FlightOrder, NEAR_M, Order, PictureOrder, Wishes},
    },
    director::{Director, tick_of},
    plan::Plan,
    worker::{self, Word},
};
use crate::{
    database::Database,
    evaluate::{
        consistency::{Comparison, Source},
        flight::Plan as FlightPlan,
        oracle::{FieldOracle, Oracle, OracleError},
        record::{Kind, Record},
        scenario::{self, Scenario, Truth, Wish},
    },
    roam::{Target, ViewMesh},
    terrain::synthetic::mix,
    view::{Camera, Projection},
};

/// Records that may wait for the comparison; then the clients wait.
const WAITING_RECORDS: usize = 256;
/// Truths of epochs kept at hand.
const MAX_TRUTHS: usize = 64;
/// One exact verdict in so many is redone by the naive reference.
const NAIVE_EVERY: u64 = 100;
/// Poses a second of all flights.
const RATE_HZ: f64 = 10.0;

/// The last meshes of a client: active posts but for the corners, with heights. `None` where they were not told.
#[derive(Clone, Default, Debug)]
pub(in super::super) struct LastMeshes {
    /// Of the view that honours the sight lines.
    pub(in super::super) lines: Option<Vec<(Post, i32)>>,
    /// Of the plain view.
    pub(in super::super) plain: Option<Vec<(Post, i32)>>,
}

/// What was found.
#[derive(Clone, Debug)]
pub(in super::super) struct Outcome {
    pub(in super::super) comparison: Comparison,
    pub(in super::super) scenario: Scenario,
    /// The exercise at the last tick.
    pub(in super::super) last: Truth,
    pub(in super::super) checks: Checks,
    /// How many servers.
    pub(in super::super) servers: usize,
    /// By client.
    pub(in super::super) meshes: Vec<LastMeshes>,
    pub(in super::super) seconds: f64,
}

/// What the parent counted of its own work.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub(in super::super) struct Checks {
    /// Epochs whose exact verdicts were computed.
    pub(in super::super) epochs: u64,
    /// Exact verdicts that are VISIBLE, UNKNOWN, BLOCKED.
    pub(in super::super) visible: u64,
    pub(in super::super) unknown: u64,
    pub(in super::super) blocked: u64,
    /// Exact verdicts redone by the naive rational reference, and those that came out differently.
    pub(in super::super) naive: u64,
    pub(in super::super) naive_differs: u64,
    /// Verdicts that a sabotage was meant to turn.
    pub(in super::super) sabotaged_verdicts: u64,
}

/// Something worth showing while it runs.
#[derive(Clone, Debug)]
pub(in super::super) enum Happening<'a> {
    /// A step before the flight.
    Step(&'a str),
    /// A client has flown so many poses.
    Poses { client: usize, poses: u64, comparison: &'a Comparison },
    /// Something odd that a client said.
    Remark(String),
}

/// Runs the test against the servers at `addresses`, which must hold the terrain of `database`; clients take them in turn.
pub(in super::super) fn run(
    runtime: &tokio::runtime::Runtime,
    database: &Arc<Database>,
    addresses: &[String],
    plan: &Plan,
    show: &mut dyn FnMut(Happening),
) -> Result<Outcome, Failure> {
    let started = Instant::now();
    let mut oracle = FieldOracle(&**database);
    let truth_failed = |e: OracleError| Failure::input("the database", e);
    show(Happening::Step("choosing sight lines"));
    let theatre = scenario::choose_theatre(database.scale(), plan.seed, &mut oracle).map_err(truth_failed)?;
    let theatre_m = in_metres(theatre, database);
    let wish = Wish {
        lines: plan.sight_lines,
        ticks: plan.frames as u64,
        fidelity: plan.fidelity,
        comings: plan.changes.lines,
        seed: plan.seed,
    };
    let meshes = plain_meshes(database, plan, theatre_m)?;
    let scenario = scenario::choose(wish, theatre, database.scale(), &meshes, &mut oracle).map_err(truth_failed)?;
    drop(meshes);
    show(Happening::Step("registering the exercise"));
    let mut servers = Vec::new();
    for address in addresses {
        let client = runtime.block_on(connect::connect(address))?;
        same_terrain(&runtime.block_on(client.terrain()).map_err(connect::failure)?, database)?;
        servers.push(client);
    }
    let director = runtime.block_on(Director::begin(servers, &plan.exercise, scenario.clone()))?;
    let names = plan.clients.iter().map(|c| (c.name.clone(), c.triangles));
    let run = Run {
        plan,
        director,
        truths: Truths::new(&scenario, plan.seed, oracle),
        comparison: Comparison::new(names, scenario.lines.len()),
        sabotaged: 0,
        meshes: vec![LastMeshes::default(); plan.clients.len()],
        servers: addresses.len(),
    };
    show(Happening::Step("flying"));
    let Run { director, truths, comparison, sabotaged, meshes, .. } =
        runtime.block_on(run.fly(addresses, theatre_m, show))?;
    let (last, checks) = truths.finish(director.tick(), sabotaged)?;
    if !plan.keep_exercise {
        runtime.block_on(director.end())?;
    }
    let (servers, seconds) = (addresses.len(), started.elapsed().as_secs_f64());
    Ok(Outcome { comparison, scenario, last, checks, servers, meshes, seconds })
}

fn in_metres(theatre: [[f64; 2]; 2], database: &Database) -> [[f64; 2]; 2] {
    let scale = database.scale();
    theatre.map(|[x, y]| [x * scale.east_m, y * scale.north_m])
}

fn same_terrain(served: &v1::TerrainDescription, database: &Database) -> Result<(), Failure> {
    if served.version[..] == database.version()[..] {
        return Ok(());
    }
    Err(Failure::Input("the server holds another terrain than the database given: their versions differ".into()))
}

fn flight_seed(plan: &Plan, client: usize) -> u64 {
    mix(plan.seed ^ mix(client as u64))
}

/// The meshes that the clients would get without sight lines, each from the middle of its flight.
fn plain_meshes(
    database: &Arc<Database>,
    plan: &Plan,
    theatre_m: [[f64; 2]; 2],
) -> Result<Vec<ViewMesh<Database>>, Failure> {
    let scale = database.scale();
    let mut oracle = FieldOracle(&**database);
    let mut meshes = Vec::new();
    for (n, client) in plan.clients.iter().enumerate() {
        let refused = |e: &dyn std::fmt::Display| Failure::Usage(format!("client {}: {e}", client.name));
        let flight = FlightPlan::preset(client.preset, theatre_m, plan.frames, RATE_HZ, flight_seed(plan, n))
            .map_err(|e| refused(&e))?;
        let mut ground = Vec::new();
        for [x, y] in flight.ground_points() {
            let grid = database.grid();
            let x = (x / scale.east_m).clamp(0.0, f64::from(grid.nx() - 1));
            let y = (y / scale.north_m).clamp(0.0, f64::from(grid.ny() - 1));
            let z = oracle.above_ground(x, y, 0.0).map_err(|e| Failure::input("the database", e))?;
            ground.push(z.unwrap_or(0.0) * scale.up_m);
        }
        let viewpoints = flight.fly(&ground).map_err(|e| refused(&e))?;
        let Some(middle) = viewpoints.get(viewpoints.len() / 2) else { continue };
        let [x, y, z, w] = middle.rotation;
        let projection = Projection::Perspective { tan_half_fov: client.tan_half_fov, near_m: NEAR_M };
        let camera = Camera::new(middle.eye, DQuat::from_xyzw(x, y, z, w), projection, plan.viewport_px)
            .map_err(|e| refused(&e))?;
        let failed = |e: &dyn std::fmt::Display| Failure::input("the database", e);
        let mut mesh = ViewMesh::new(Arc::clone(database), scale).map_err(|e| failed(&e))?;
        mesh.update(&camera, Target::TriangleBudget(client.triangles), &[]).map_err(|e| refused(&e))?;
        meshes.push(mesh);
    }
    Ok(meshes)
}

/// The exact verdicts by epoch, computed when they are first needed.
struct Truths<O> {
    scenario: Scenario,
    seed: u64,
    oracle: O,
    known: BTreeMap<u64, Truth>,
    checks: Checks,
    /// Verdicts met so far: of each hundred, the seed picks the one that is redone.
    met: u64,
}

impl<O: Oracle> Truths<O> {
    fn new(scenario: &Scenario, seed: u64, oracle: O) -> Self {
        Self { scenario: scenario.clone(), seed, oracle, known: BTreeMap::new(), checks: Checks::default(), met: 0 }
    }

    fn at(&mut self, tick: u64) -> Result<&Truth, Failure> {
        if !self.known.contains_key(&tick) {
            let failed = |e: OracleError| Failure::input("the database", e);
            let before = self.known.values().next();
            let truth = self.scenario.truth(tick, before, &mut self.oracle).map_err(failed)?;
            self.check(&truth).map_err(failed)?;
            if self.known.len() >= MAX_TRUTHS {
                self.known.pop_first();
            }
            self.known.insert(tick, truth);
        }
        Ok(&self.known[&tick])
    }

    fn check(&mut self, truth: &Truth) -> Result<(), OracleError> {
        self.checks.epochs += 1;
        for line in truth.lines.values() {
            match line.verdict {
                v1::Verdict::Visible => self.checks.visible += 1,
                v1::Verdict::Blocked => self.checks.blocked += 1,
                _ => self.checks.unknown += 1,
            }
            let pick = mix(self.seed ^ mix(self.met / NAIVE_EVERY)) % NAIVE_EVERY;
            let chosen = self.met % NAIVE_EVERY == pick;
            self.met += 1;
            if let Some(ends) = line.ends.filter(|_| chosen) {
                self.checks.naive += 1;
                self.checks.naive_differs += u64::from(self.oracle.naive_verdict(ends)? != line.verdict);
            }
        }
        Ok(())
    }

    fn finish(mut self, tick: u64, sabotaged_verdicts: u64) -> Result<(Truth, Checks), Failure> {
        let last = self.at(tick)?.clone();
        Ok((last, Checks { sabotaged_verdicts, ..self.checks }))
    }
}

/// A run in progress.
struct Run<'a, O> {
    plan: &'a Plan,
    director: Director,
    truths: Truths<O>,
    comparison: Comparison,
    sabotaged: u64,
    meshes: Vec<LastMeshes>,
    servers: usize,
}

impl<O: Oracle> Run<'_, O> {
    async fn fly(
        mut self,
        addresses: &[String],
        theatre_m: [[f64; 2]; 2],
        show: &mut dyn FnMut(Happening),
    ) -> Result<Self, Failure> {
        let (words_in, mut words) = mpsc::channel(WAITING_RECORDS);
        for n in 0..self.plan.clients.len() {
            worker::start(n, &self.order(n, &addresses[n % addresses.len()], theatre_m), words_in.clone())?;
        }
        drop(words_in);
        let mut flying = self.plan.clients.len();
        let mut done = vec![false; flying];
        while let Some((client, word)) = words.recv().await {
            match word {
                Word::Record(Record::Done { bytes, .. }) => {
                    done[client] = true;
                    self.comparison.clients[client].bytes = bytes;
                }
                Word::Record(record) => self.take(client, record, show).await?,
                Word::Nonsense(line) => return Err(self.failed(client, &format!("said '{line}'"))),
                Word::Ended(well) if well && done[client] => flying -= 1,
                Word::Ended(_) => return Err(self.failed(client, "ended before its flight was over")),
            }
            if flying == 0 {
                break;
            }
        }
        Ok(self)
    }

    fn failed(&self, client: usize, what: &str) -> Failure {
        Failure::Environment(format!("scene generator {} {what}", self.plan.clients[client].name))
    }

    fn order(&self, n: usize, address: &str, theatre_m: [[f64; 2]; 2]) -> Order {
        let client = &self.plan.clients[n];
        let pictures = self.plan.pictures.as_ref().map(|directory| PictureOrder {
            directory: directory.clone(),
            every: u64::MAX,
            window_m: Some(theatre_m),
        });
        Order {
            name: client.name.clone(),
            address: address.into(),
            exercise: self.plan.exercise.clone(),
            triangles: client.triangles,
            tan_half_fov: client.tan_half_fov,
            viewport_px: self.plan.viewport_px,
            wishes: Wishes::default(),
            flight: FlightOrder::Preset {
                name: client.preset.name().into(),
                area_m: Some(theatre_m),
                seed: flight_seed(self.plan, n),
            },
            poses: Some(self.plan.frames),
            rate_hz: RATE_HZ,
            lines: self.plan.sight_lines,
            plain: true,
            budgets: self.plan.budgets(n),
            jump_every: self.plan.jump_every(),
            tell_meshes: self.plan.wants_meshes,
            sabotage: self.plan.sabotage.filter(|(victim, _)| *victim == n).map(|(_, kind)| kind),
            pictures,
            record: None,
        }
    }

    async fn take(&mut self, client: usize, record: Record, show: &mut dyn FnMut(Happening)) -> Result<(), Failure> {
        match record {
            Record::Frame(frame) => {
                match tick_of(frame.epoch) {
                    Some(tick) if tick <= self.director.tick() + 1 => {
                        let budget = self.plan.greatest_budget(client, frame.pose_sequence);
                        let from = Source { client, server: client % self.servers, budget };
                        self.comparison.frame(from, &frame, self.truths.at(tick)?);
                    }
                    // An epoch that was never made: everything about the frame is wrong.
                    _ => self.comparison.clients[client].exercise_mismatches += 1,
                }
                if frame.kind == Kind::Plain {
                    let poses = frame.pose_sequence + 1;
                    show(Happening::Poses { client, poses, comparison: &self.comparison });
                    // The client that is ahead drives the world: one tick for each of its poses.
                    if poses > self.director.tick() {
                        self.director.advance().await?;
                    }
                }
            }
            Record::Refused { hash, detail, .. } => {
                let tally = &mut self.comparison.clients[client];
                tally.hash_mismatches += u64::from(hash);
                tally.refused += u64::from(!hash);
                show(Happening::Remark(format!("{}: {detail}", tally.name)));
            }
            Record::Tampered { betrays, detail } => {
                self.sabotaged += betrays.len() as u64;
                show(Happening::Remark(format!("{}: sabotaged: {detail}", self.plan.clients[client].name)));
            }
            Record::Mesh { kind: Kind::Lines, posts } => self.meshes[client].lines = Some(posts),
            Record::Mesh { kind: Kind::Plain, posts } => self.meshes[client].plain = Some(posts),
            Record::Done { .. } => {}
        }
        Ok(())
    }
}
