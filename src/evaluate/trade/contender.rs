//! Who is compared: the systems of `lod`, and this project's refinement without and with its sight lines.

use std::sync::Arc;

use super::{Instrument, TradeError, wire::Client, world::World};
use crate::{
    lod::{Algorithm, IndexedMesh, LevelOfDetail, LodView, Statistics, System, Target},
    roam::{self, RequiredLine, ViewMesh},
    wedgie::MemoryTerrain,
};

/// One of those who are compared.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Contender {
    /// A system of the papers.
    Other(Algorithm),
    /// This project's refinement, as if there were no sight lines.
    Plain,
    /// The same, with the sight lines registered that are asked.
    Kept,
}

impl Contender {
    /// All but full resolution, which is what the others are measured against.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        let others = Algorithm::ALL.into_iter().filter(|&a| a != Algorithm::Full).map(Self::Other);
        others.chain([Self::Plain, Self::Kept])
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Other(algorithm) => algorithm.name(),
            Self::Plain => "Sightline, no lines registered",
            Self::Kept => "Sightline, lines registered",
        }
    }

    /// Whether it is this project's.
    pub(super) fn is_own(self) -> bool {
        matches!(self, Self::Plain | Self::Kept)
    }

    /// What it flies with: the setting that gave a number of triangles; our own takes the number itself.
    pub(super) fn target(self, wanted: u32, setting: f64) -> Target {
        match self {
            Self::Other(_) => Target::Setting(setting),
            Self::Plain | Self::Kept => Target::Triangles(wanted),
        }
    }

    /// Whether its vertices can move gradually.
    pub(super) fn morphs(self) -> bool {
        use Algorithm::{GeoMipMap, ImprovedGeoMipMap, Quadtree, TStrip};
        self.is_own() || matches!(self, Self::Other(Quadtree | GeoMipMap | ImprovedGeoMipMap | TStrip))
    }
}

/// A contender, prepared for a terrain.
pub(super) struct Maker {
    inner: Inner,
    /// How long the preparation took.
    pub(super) preparation_s: f64,
}

enum Inner {
    Other(Box<System>),
    Ours { mesh: Box<ViewMesh<MemoryTerrain>>, lines: Vec<RequiredLine>, client: Box<Client> },
}

/// What a contender made of a view.
pub(super) struct Made {
    pub(super) mesh: IndexedMesh,
    /// What it promises, if anything.
    pub(super) bound_px: Option<f64>,
    pub(super) statistics: Statistics,
    /// The lines that it says are wrong on this mesh.
    pub(super) named: Vec<u64>,
    /// Bytes that are sent of it in place of triangles: to our clients, and GEOmancy's buffers.
    pub(super) payload_bytes: Option<usize>,
    /// Time to make it; for our own without listing its triangles, which clients do from what changed.
    pub(super) seconds: f64,
}

impl Maker {
    /// Prepares a contender; the lines count for [`Contender::Kept`].
    pub(super) fn new(
        contender: Contender,
        world: &World,
        lines: &[RequiredLine],
        instrument: &Instrument<'_>,
    ) -> Result<Self, TradeError> {
        match contender {
            Contender::Other(algorithm) => {
                let (system, preparation_s) = instrument.timed(|| algorithm.prepare(&world.ground));
                Ok(Self { inner: Inner::Other(Box::new(system)), preparation_s })
            }
            Contender::Plain | Contender::Kept => {
                let mesh = Box::new(ViewMesh::new(Arc::clone(&world.terrain), world.scale())?);
                let lines = if contender == Contender::Kept { lines.to_vec() } else { Vec::new() };
                let client = Box::new(Client::new(world)?);
                Ok(Self { inner: Inner::Ours { mesh, lines, client }, preparation_s: world.bounds_s })
            }
        }
    }

    /// The mesh for a view.
    pub(super) fn update(
        &mut self,
        view: &LodView,
        target: Target,
        instrument: &Instrument<'_>,
    ) -> Result<Made, TradeError> {
        match &mut self.inner {
            Inner::Other(system) => {
                let (frame, seconds) = instrument.timed(|| system.update(view, target));
                let frame = frame?;
                let (bound_px, statistics) = (frame.bound_px, frame.statistics);
                let (mesh, named) = (frame.mesh, Vec::new());
                let sends_tiles = matches!(**system, System::Geomancy(_));
                let payload_bytes = sends_tiles.then_some(statistics.index_bytes as usize);
                Ok(Made { mesh, bound_px, statistics, named, payload_bytes, seconds })
            }
            Inner::Ours { mesh, lines, client } => {
                let budget = match target {
                    Target::Triangles(n) => n,
                    Target::Setting(n) => n as u32,
                };
                let target = roam::Target::TriangleBudget(budget);
                let (report, seconds) = instrument.timed(|| mesh.update(view.camera(), target, lines));
                let report = report?;
                let statistics = Statistics {
                    setting: f64::from(budget),
                    decisions: report.work.priorities,
                    splits: report.work.splits,
                    merges: report.work.merges,
                    ..Statistics::default()
                };
                let payload_bytes = Some(client.take(mesh, &report, lines)?);
                let (mesh, bound_px, named) = (client.drawn(mesh), Some(report.bound_px), report.unsatisfied);
                Ok(Made { mesh, bound_px, statistics, named, payload_bytes, seconds })
            }
        }
    }

    /// Bytes held besides the heights: what all views share, and what this one has.
    pub(super) fn memory_bytes(&self, world: &World) -> usize {
        match &self.inner {
            Inner::Other(system) => system.memory_bytes(),
            Inner::Ours { mesh, .. } => mesh.memory_bytes() + world.terrain.bounds_bytes(),
        }
    }

    /// Lets vertices move gradually, in systems that can.
    pub(super) fn set_morph(&mut self, morph: bool) {
        match &mut self.inner {
            Inner::Other(system) => system.set_morph(morph),
            Inner::Ours { client, .. } => client.set_morph(morph),
        }
    }
}
