//! The trade report: what each level-of-detail system and each precision of a query costs and gives, measured on the same
//! terrains with the same measures, and what that says about the claims of the papers.
//!
//! Everything but times is a deterministic function of terrains and plan. Clocks and progress are arguments
//! ([`Instrument`]); nothing is written here: the result is a [`document::Document`].

mod choose;
mod claims;
mod contender;
pub mod document;
mod fidelity;
mod findings;
mod flown;
mod lindstrom;
mod lines;
mod mesh_tables;
mod meshes;
mod noise;
mod printed;
mod probe_tables;
mod probes;
mod queries;
mod rtin;
#[cfg(test)]
mod tests;
mod thesis;
mod vertex_bound;
mod wire;
mod world;

use std::time::Duration;

use thiserror::Error;

use self::{
    document::{Block, Document, Section},
    findings::Findings,
};
use crate::{
    evaluate::flight::FlightError,
    lod::LodError,
    los::LosError,
    roam::MeshError,
    terrain::{GridError, ReadError},
    view::CameraError,
};

pub use world::World;

/// How much is measured.
#[derive(Clone, PartialEq, Debug)]
pub struct Plan {
    /// Posts along the side of a synthetic terrain.
    pub synthetic_side: u32,
    /// Most posts along the side of a terrain that is given.
    pub greatest_side: u32,
    /// Triangles that meshes are asked for.
    pub counts: Vec<u32>,
    /// Views in which meshes stand still.
    pub views: usize,
    /// Frames of a flight.
    pub frames: usize,
    /// Sight lines of each kind asked of a mesh.
    pub mesh_lines: usize,
    /// Lines of each ordinary set of queries; a tenth as many grazing ones.
    pub query_lines: usize,
    /// Numbers of lines that are registered in a view, and the triangles of that view.
    pub registered: Vec<usize>,
    /// See `registered`.
    pub registered_budget: u32,
    /// Most cells along the side of the thesis's terrains.
    pub thesis_cells: u32,
    /// Cells along the side of the map on which GeoMipMap's coarsest mesh and T-Strip's steps are counted.
    pub probe_cells: u32,
    /// Times that something short is done to take the least time of.
    pub repeats: usize,
}

impl Plan {
    /// Less than half a minute.
    pub fn quick() -> Self {
        Self {
            synthetic_side: 257,
            greatest_side: 513,
            counts: vec![1_000, 3_000, 10_000],
            views: 1,
            frames: 10,
            mesh_lines: 150,
            query_lines: 4_000,
            registered: vec![10, 30, 100],
            registered_budget: 10_000,
            thesis_cells: 256,
            probe_cells: 1024,
            repeats: 2,
        }
    }

    /// Some minutes.
    pub fn full() -> Self {
        Self {
            synthetic_side: 513,
            greatest_side: 1025,
            counts: vec![1_000, 3_000, 10_000, 30_000, 100_000],
            views: 2,
            frames: 24,
            mesh_lines: 400,
            query_lines: 20_000,
            registered: vec![10, 30, 100, 300, 1_000],
            registered_budget: 10_000,
            thesis_cells: 512,
            probe_cells: 1024,
            repeats: 3,
        }
    }

    /// The number of triangles at which systems are compared where one number will do: the nearest to 10,000.
    pub(crate) fn usual_count(&self) -> u32 {
        self.counts.iter().copied().min_by_key(|count| count.abs_diff(10_000)).unwrap_or(10_000)
    }
}

/// Why there is no report.
#[derive(Debug, Error)]
pub enum TradeError {
    /// Heights could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A line of sight has no answer.
    #[error(transparent)]
    Los(#[from] LosError),
    /// A system gave no mesh.
    #[error(transparent)]
    Lod(#[from] LodError),
    /// Our refinement gave no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A viewpoint makes no camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// There is no such flight.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// A terrain that no client can hold.
    #[error(transparent)]
    Terrain(#[from] sightline_proto::replica::TerrainError),
    /// A frame that no client can take.
    #[error(transparent)]
    Frame(#[from] sightline_proto::replica::MeshError),
    /// A terrain of an impossible size.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// How far a run has come: what is measured, and how many of how many steps of it are done.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Step<'a> {
    /// What is measured.
    pub name: &'a str,
    /// Steps done.
    pub done: usize,
    /// Steps in all.
    pub total: usize,
}

/// A clock, and whom to tell of progress.
pub struct Instrument<'a> {
    /// Time since any moment.
    pub clock: &'a dyn Fn() -> Duration,
    /// Is told of each step.
    pub tell: &'a dyn Fn(Step<'_>),
}

impl Instrument<'_> {
    /// What `work` gives, and the seconds it took.
    pub(crate) fn timed<R>(&self, work: impl FnOnce() -> R) -> (R, f64) {
        let started = (self.clock)();
        let result = work();
        (result, (self.clock)().saturating_sub(started).as_secs_f64())
    }
}

/// Measures everything. The first of the terrains is taken for synthetic, all others for real.
pub fn run(plan: &Plan, worlds: &[World], instrument: &Instrument<'_>) -> Result<Document, TradeError> {
    let (mut meshes, mut queries, mut fidelity) = (Vec::new(), Vec::new(), Vec::new());
    let mut rtin = Vec::new();
    for (number, world) in worlds.iter().enumerate() {
        queries.extend(queries::measure(number, world, plan, instrument)?);
        meshes.extend(meshes::measure(number, world, plan, instrument)?);
        rtin.extend(rtin::measure(number, world, plan)?);
        fidelity.extend(fidelity::measure(number, world, plan, instrument)?);
    }
    let thesis = thesis::measure(worlds, plan, instrument)?;
    let probes = probes::measure(worlds, plan, instrument)?;
    let criteria = match worlds.first() {
        Some(world) => {
            let of_first: Vec<_> = meshes.iter().filter(|row| row.world == 0).cloned().collect();
            lindstrom::measure(world, &of_first, plan, instrument)?
        }
        None => Vec::new(),
    };
    let found = Findings {
        worlds,
        meshes: &meshes,
        queries: &queries,
        fidelity: &fidelity,
        thesis: &thesis,
        criteria: &criteria,
        probes: &probes,
        usual_count: plan.usual_count(),
    };
    let sections = vec![
        terrains(worlds),
        choose::section(&found),
        probe_tables::section(&found, claims::all(&found)),
        queries::section(&queries, worlds),
        mesh_tables::section(&meshes, rtin::table(&rtin, worlds), worlds),
        fidelity::section(&fidelity, worlds, plan),
        thesis::section(&thesis),
    ];
    Ok(Document { title: "What level of detail costs, and what it gets wrong".into(), sections })
}

/// What was measured on.
fn terrains(worlds: &[World]) -> Section {
    let list: Vec<_> = worlds
        .iter()
        .map(|world| {
            let [low, high] = world::height_range_m(world);
            format!("{}: {}, {low:.0} to {high:.0} m high", world.name, world.size())
        })
        .collect();
    let text = format!("Measured on {}.", list.join("; "));
    Section { title: "Terrains".into(), blocks: vec![Block::Text(text)] }
}

/// The median of `values`; NaN of none.
pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// The value below which a share of `values` lies; NaN of none.
pub(crate) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = (sorted.len().saturating_sub(1) as f64 * share) as usize;
    sorted.get(n).copied().unwrap_or(f64::NAN)
}

/// The mean of `values`; NaN of none.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The greatest of `values`; 0 of none.
pub(crate) fn greatest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}
