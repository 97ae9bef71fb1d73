//! What a client is sent of our meshes, in bytes, and what it draws of them between frames: the payloads of `WIRE.md`, a
//! replica, and the client library's gradual vertices.

use sightline_client::morph::{Line, Morph};
use sightline_proto::{diamond::Post, mesh::Mesh, replica::Replica, v1};

use super::{
    TradeError,
    world::{RATE_HZ, World},
};
use crate::{
    lod::IndexedMesh,
    roam::{MeshReport, RequiredLine, ViewMesh},
    wedgie::MemoryTerrain,
};

/// How long a post takes to its place.
const MORPH_S: f64 = 0.5;

/// What a client holds.
pub(super) struct Client {
    replica: Replica,
    morph: Option<Morph>,
    wants_morph: bool,
}

impl Client {
    pub(super) fn new(world: &World) -> Result<Self, TradeError> {
        let (grid, scale) = (world.ground.grid(), world.scale());
        let corner_heights = grid.root().corners().map(|p| world.ground.z(p.i, p.j) as i64).to_vec();
        let description = v1::TerrainDescription {
            nx: grid.nx(),
            ny: grid.ny(),
            root_exponent: u32::from(grid.root().exponent()),
            metres_per_post_east: scale.east_m,
            metres_per_post_north: scale.north_m,
            metres_per_height_unit: scale.up_m,
            corner_heights,
            ..v1::TerrainDescription::default()
        };
        Ok(Self { replica: Replica::new(&description)?, morph: None, wants_morph: false })
    }

    /// Lets posts slide to their places from the second frame on: the first one comes as it is.
    pub(super) fn set_morph(&mut self, morph: bool) {
        self.wants_morph = morph;
    }

    /// Takes a frame. Returns the bytes of its payload.
    pub(super) fn take(
        &mut self,
        mesh: &ViewMesh<MemoryTerrain>,
        report: &MeshReport,
        lines: &[RequiredLine],
    ) -> Result<usize, TradeError> {
        let added: Vec<(Post, i32)> = report.added.iter().filter_map(|&p| Some((p, mesh.height(p)? as i32))).collect();
        let sequence = self.replica.sequence() + 1;
        let payload = self.replica.advance(&report.removed, &added, sequence)?;
        if let Some(morph) = &mut self.morph {
            let lines: Vec<Line> = lines.iter().map(|line| [line.a, line.b]).collect();
            morph.advance(&self.replica, &lines, time_s(sequence));
        } else if self.wants_morph {
            self.morph = Some(Morph::new(&self.replica, MORPH_S));
        }
        Ok(payload.len())
    }

    /// What it draws: the frame's mesh, unless posts slide.
    pub(super) fn drawn(&self, mesh: &ViewMesh<MemoryTerrain>) -> IndexedMesh {
        match &self.morph {
            Some(morph) => IndexedMesh::of(&morph.drawn(time_s(self.replica.sequence()))),
            None => IndexedMesh::of(mesh),
        }
    }
}

/// When a frame is drawn.
fn time_s(sequence: u64) -> f64 {
    sequence as f64 / RATE_HZ
}
