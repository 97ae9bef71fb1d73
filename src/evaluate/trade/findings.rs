//! All that was measured in a run, for what is concluded from it.

use super::{contender::Contender, fidelity, lindstrom, meshes, probes::Probes, queries, thesis, world::World};

/// All that was measured.
pub(super) struct Findings<'a> {
    pub(super) worlds: &'a [World],
    pub(super) meshes: &'a [meshes::Row],
    pub(super) queries: &'a [queries::Row],
    pub(super) fidelity: &'a [fidelity::Row],
    pub(super) thesis: &'a [thesis::Row],
    pub(super) criteria: &'a [lindstrom::Criteria],
    pub(super) probes: &'a Probes,
    /// The number of triangles at which contenders are compared where one number will do.
    pub(super) usual_count: u32,
}

impl Findings<'_> {
    pub(super) fn name(&self, world: usize) -> &str {
        self.worlds.get(world).map_or("", |world| &world.name)
    }

    /// A contender's rows on a terrain, from few triangles to many.
    pub(super) fn curve(&self, world: usize, contender: Contender) -> Vec<&meshes::Row> {
        self.meshes.iter().filter(|row| row.world == world && row.contender == contender).collect()
    }

    /// A contender's row at the usual number.
    pub(super) fn usual(&self, world: usize, contender: Contender) -> Option<&meshes::Row> {
        self.curve(world, contender).into_iter().find(|row| row.wanted == self.usual_count)
    }

    /// The rows of two contenders in one of the thesis's test cases, set by set.
    pub(super) fn pairs(&self, case: u8, a: Contender, b: Contender) -> Vec<(&thesis::Row, &thesis::Row)> {
        let of =
            |contender: Contender| self.thesis.iter().filter(move |row| row.case == case && row.contender == contender);
        of(a).zip(of(b)).collect()
    }
}
