//! The five criteria of Lindstrom et al., "Real-Time, Continuous Level of Detail Rendering of Height Fields", 1996, as Ye
//! and Wang restate them, system by system:
//!
//! (i) the mesh can be queried directly; (ii) changes of the terrain cost little; (iii) detail in one place has no
//! effect elsewhere; (iv) a small change of the view changes the number of triangles little; (v) the error is bounded.
//!
//! (i) is met alike by all here, since each gives a mesh whose triangles are looked up by place. (ii) is the time to take up
//! heights that changed in 16 x 16 posts: T-Strip edits, the others prepare again. (iii) is what one spike does to
//! triangles that are far from it. (iv) and (v) are taken from the measurements of meshes.

use std::sync::Arc;

use super::{
    Instrument, Plan, TradeError,
    contender::{Contender, Maker},
    document::{Cell, Table, exact, timed},
    flown::Flown,
    greatest,
    meshes::Row,
    world::{World, view},
};
use crate::{
    evaluate::flight::Preset,
    lod::{Algorithm, Metric, TStrip},
    terrain::MemoryField,
};

/// Posts along the side of what is edited.
const EDITED: u32 = 16;
/// Height of the spike in metres.
const SPIKE_M: f64 = 300.0;
/// What is further from the spike than this in either direction is far, as a share of the side.
const FAR: u32 = 8;

/// A system by the five criteria.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Criteria {
    pub(super) contender: Contender,
    /// Seconds to take up an edit.
    pub(super) edit_s: f64,
    /// Share of the triangles far from a spike that it changes, and triangles more.
    pub(super) far_share: f64,
    pub(super) more: f64,
    /// Greatest relative change of the number of triangles from one frame to the next.
    pub(super) step: f64,
    /// Whether there is a bound, and whether it was kept in all views.
    pub(super) bound: Option<bool>,
}

/// All systems on the first terrain, at the number of triangles that is nearest to 10,000.
pub(super) fn measure(
    world: &World,
    rows: &[Row],
    plan: &Plan,
    instrument: &Instrument<'_>,
) -> Result<Vec<Criteria>, TradeError> {
    let wanted = plan.usual_count();
    let spiked = spiked(world, instrument)?;
    let mut found = Vec::new();
    for contender in Contender::all().filter(|&c| c != Contender::Kept) {
        let of_it: Vec<_> = rows.iter().filter(|row| row.contender == contender && row.wanted == wanted).collect();
        let Some(first) = of_it.first() else { continue };
        let target = contender.target(wanted, first.still.setting);
        let [far_share, more] = spread(contender, [world, &spiked], target, instrument)?;
        let steps = of_it.iter().flat_map(|row| row.flown.triangles.windows(2).map(|w| (w[1] - w[0]).abs() / w[0]));
        let has_bound = first.still.bound_px.is_some();
        found.push(Criteria {
            contender,
            edit_s: edit(contender, world, &first.flown, plan, instrument)?,
            far_share,
            more,
            step: greatest(&steps.collect::<Vec<_>>()),
            bound: has_bound.then(|| of_it.iter().all(|row| row.still.bound_kept)),
        });
    }
    Ok(found)
}

/// The post of the spike: a quarter from the north-east.
fn place(world: &World) -> [u32; 2] {
    world.cells().map(|cells| (cells * 0.75) as u32 | 1)
}

fn spiked(world: &World, instrument: &Instrument<'_>) -> Result<World, TradeError> {
    let (grid, at) = (world.ground.grid(), place(world));
    let field = MemoryField::from_fn(grid.nx(), grid.ny(), |i, j| {
        let spike = if [i, j] == at { SPIKE_M / world.scale().up_m } else { 0.0 };
        Some(world.ground.z(i, j) + spike.round())
    })?;
    World::new("", field, world.scale(), instrument)
}

/// The share of triangles far from the spike that are not in the mesh without it, and how many more there are in all.
fn spread(
    contender: Contender,
    worlds: [&World; 2],
    target: crate::lod::Target,
    instrument: &Instrument<'_>,
) -> Result<[f64; 2], TradeError> {
    let at = place(worlds[0]);
    let far = worlds[0].ground.side() / FAR;
    let view = view(&worlds[0].flight(Preset::Straight, 1, 1)?[0])?;
    let mut plans = Vec::new();
    let mut counts = Vec::new();
    for world in worlds {
        let mesh = Maker::new(contender, world, &[], instrument)?.update(&view, target, instrument)?.mesh;
        counts.push(mesh.len() as f64);
        let mut plan: Vec<_> = mesh
            .iter()
            .filter(|t| t.iter().all(|v| v.post.i.abs_diff(at[0]) > far || v.post.j.abs_diff(at[1]) > far))
            .map(|t| {
                let mut keys = t.map(|v| v.post.key());
                keys.sort_unstable();
                keys
            })
            .collect();
        plan.sort_unstable();
        plans.push(plan);
    }
    let new = plans[1].iter().filter(|t| plans[0].binary_search(t).is_err()).count();
    Ok([new as f64 / plans[1].len().max(1) as f64, counts[1] - counts[0]])
}

/// The time to take up changed heights: the least of several.
fn edit(
    contender: Contender,
    world: &World,
    flown: &Flown,
    plan: &Plan,
    instrument: &Instrument<'_>,
) -> Result<f64, TradeError> {
    let [west, south] = place(world).map(|v| v.saturating_sub(EDITED));
    if contender == Contender::Other(Algorithm::TStrip) {
        let mut strips = TStrip::new(Arc::clone(&world.ground), Metric::Distance);
        let heights = Arc::clone(&world.ground);
        let mut change = |by: f64| strips.edit(west, south, EDITED, EDITED, |i, j| heights.z(i, j) + by);
        // The first edit makes a copy of the height map, which others share.
        change(1.0);
        let mut least = f64::INFINITY;
        for _ in 0..plan.repeats {
            least = least.min(instrument.timed(|| change(2.0)).1);
        }
        return Ok(least);
    }
    // To prepare anew, and what a first frame takes beyond the others.
    Ok(flown.preparation_s + (flown.first_s - flown.frame_s).max(0.0))
}

/// The criteria as a table.
pub(super) fn table(rows: &[Criteria], world: &World) -> Table {
    let cells = |row: &Criteria| {
        vec![
            row.contender.name().into(),
            Cell::number(1e3 * row.edit_s),
            Cell::number(100.0 * row.far_share),
            Cell::number(row.more),
            Cell::number(100.0 * row.step),
            row.bound.map_or(Cell::Nothing, Cell::Mark),
        ]
    };
    Table {
        file: "criteria",
        title: format!("Lindstrom's five criteria, on {}", world.name),
        note: format!(
            "(i), that a mesh can be queried directly, is met alike by all: triangles are looked up by place. (ii) time \
             to take up an edit of {EDITED} x {EDITED} posts; T-Strip edits, all others prepare anew and then take a first frame. (iii) what a spike \
             of {SPIKE_M} m at one post does to triangles further off than an eighth of the side. (iv) the greatest \
             change of the number of triangles from one frame to the next. (v) whether a bound on the error is \
             promised, and was kept in all views."
        ),
        columns: vec![
            exact("system"),
            timed("(ii) edit, ms"),
            exact("(iii) far triangles changed, %"),
            exact("(iii) triangles more"),
            exact("(iv) greatest step, %"),
            exact("(v) bound kept"),
        ],
        rows: rows.iter().map(cells).collect(),
    }
}
