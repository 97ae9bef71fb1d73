//! What a consistency test runs: clients, sight lines, and what changes meanwhile. All of it follows from the seed.

use std::path::PathBuf;

use crate::{
    evaluate::{flight::Preset, sabotage::Sabotage},
    roam::Fidelity,
    session::MAX_TRIANGLES,
    terrain::synthetic::mix,
};

/// Poses between two changes of a client's budget.
const BUDGET_POSES: u64 = 10;
/// Poses between two jumps of a client's view.
const JUMP_POSES: usize = 15;

/// A client of the test.
#[derive(Clone, Debug)]
pub(in super::super) struct ClientPlan {
    pub(in super::super) name: String,
    pub(in super::super) triangles: u32,
    pub(in super::super) tan_half_fov: f64,
    pub(in super::super) preset: Preset,
}

/// What changes while it runs, beside entities that move and views that fly.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub(in super::super) struct Changes {
    /// Clients allow other numbers of triangles.
    pub(in super::super) budgets: bool,
    /// Views jump.
    pub(in super::super) jumps: bool,
    /// Sight lines come and go.
    pub(in super::super) lines: bool,
}

/// What is to be run.
#[derive(Clone, Debug)]
pub(in super::super) struct Plan {
    pub(in super::super) exercise: String,
    pub(in super::super) clients: Vec<ClientPlan>,
    pub(in super::super) sight_lines: usize,
    pub(in super::super) frames: usize,
    pub(in super::super) seed: u64,
    pub(in super::super) fidelity: Fidelity,
    pub(in super::super) viewport_px: [u32; 2],
    pub(in super::super) changes: Changes,
    /// Whether the last meshes are wanted, for a map.
    pub(in super::super) wants_meshes: bool,
    /// A client to be sabotaged, and how.
    pub(in super::super) sabotage: Option<(usize, Sabotage)>,
    /// The folder for pictures of the last frames.
    pub(in super::super) pictures: Option<PathBuf>,
    /// Whether the exercise stays on the server when the run is over.
    pub(in super::super) keep_exercise: bool,
}

impl Plan {
    /// Triangles that a client allows for a pose: now and then half, a quarter, or twice what it began with.
    fn budget_at(&self, client: usize, pose: u64) -> u32 {
        let usual = self.clients[client].triangles;
        let phase = pose / BUDGET_POSES;
        if !self.changes.budgets || phase == 0 {
            return usual;
        }
        match mix(self.seed ^ mix(client as u64) ^ mix(phase << 8)) % 4 {
            0 => usual,
            1 => (usual / 2).max(2),
            2 => (usual / 4).max(2),
            _ => usual.saturating_mul(2).min(MAX_TRIANGLES),
        }
    }

    /// Poses between two jumps of a view, if views jump.
    pub(super) fn jump_every(&self) -> Option<usize> {
        self.changes.jumps.then_some(JUMP_POSES)
    }

    /// Triangles that a frame made for a pose may have: the budget for the next pose may already count.
    pub(super) fn greatest_budget(&self, client: usize, pose: u64) -> u32 {
        self.budget_at(client, pose).max(self.budget_at(client, pose + 1))
    }

    /// The budgets of a client, each with the pose from which it counts.
    pub(super) fn budgets(&self, client: usize) -> Vec<(u64, u32)> {
        let phases = (1..).map(|phase| phase * BUDGET_POSES).take_while(|&pose| pose < self.frames as u64);
        phases.filter(|_| self.changes.budgets).map(|pose| (pose, self.budget_at(client, pose))).collect()
    }
}
