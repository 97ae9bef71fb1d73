//! Fidelity: what sight lines take from a mesh, by what they ask of it and by their number.

use std::sync::Arc;

use super::{
    Instrument, Plan, Step, TradeError,
    document::{Axis, Block, Cell, Figure, Section, Series, Table, exact, timed},
    lines, meshes,
    world::{World, view},
};
use crate::{
    evaluate::flight::Preset,
    lod::{IndexedMesh, LodView, measure::heights_at_posts},
    roam::{Fidelity, MeshReport, Target, ViewMesh},
    wedgie::MemoryTerrain,
};

/// How near the true obstruction must be, in metres, where that is asked.
const OBSTRUCTION_M: f64 = 50.0;

/// What is asked, from the least to the most.
const ASKED: [(&str, Fidelity); 4] = [
    ("VERDICT", Fidelity::Verdict),
    ("OBSTRUCTION, 50 m", Fidelity::Obstruction { distance_m: OBSTRUCTION_M }),
    ("WEDGIE", Fidelity::Wedgie),
    ("PROFILE", Fidelity::Profile),
];

/// A number of lines that ask for a fidelity.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Row {
    pub(super) world: usize,
    pub(super) asked: &'static str,
    pub(super) lines: usize,
    pub(super) stolen: u64,
    pub(super) named: usize,
    /// Lines that come out wrong in silence.
    pub(super) silent: usize,
    /// Greatest distortion in the picture, and of the plain mesh.
    pub(super) distortion_px: [f64; 2],
    /// Root of the mean square, and of the plain mesh.
    pub(super) rms_px: [f64; 2],
    pub(super) seconds: f64,
}

/// Registers more and more lines in one view.
pub(super) fn measure(
    number: usize,
    world: &World,
    plan: &Plan,
    instrument: &Instrument<'_>,
) -> Result<Vec<Row>, TradeError> {
    let view = view(&world.flight(Preset::Straight, 1, 1)?[0])?;
    let most = plan.registered.iter().copied().max().unwrap_or(0);
    let all = lines::third_party(world, most, 41)?;
    let (plain, _) = mesh(world, &view, plan.registered_budget, &[])?;
    let plain_shown = shown(world, &view, &plain);
    let name = format!("fidelity on {}", world.name);
    let total = ASKED.len() * plan.registered.len();
    let mut rows = Vec::new();
    for (asked, fidelity) in ASKED {
        for &count in &plan.registered {
            (instrument.tell)(Step { name: &name, done: rows.len(), total });
            let lines = all.get(..count).unwrap_or(&all);
            let required = lines::required(lines, fidelity);
            let (made, seconds) = instrument.timed(|| mesh(world, &view, plan.registered_budget, &required));
            let (mesh, report) = made?;
            let wrong = lines::wrong(world, &IndexedMesh::of(&mesh), lines);
            let shown = shown(world, &view, &mesh);
            rows.push(Row {
                world: number,
                asked,
                lines: lines.len(),
                stolen: mesh.stolen_from(&plain),
                named: report.unsatisfied.len(),
                silent: wrong.iter().filter(|&&n| !report.unsatisfied.contains(&(n as u64))).count(),
                distortion_px: [shown[0], plain_shown[0]],
                rms_px: [shown[1], plain_shown[1]],
                seconds,
            });
        }
    }
    Ok(rows)
}

type Made = (ViewMesh<MemoryTerrain>, MeshReport);

fn mesh(
    world: &World,
    view: &LodView,
    budget: u32,
    required: &[crate::roam::RequiredLine],
) -> Result<Made, TradeError> {
    let mut mesh = ViewMesh::new(Arc::clone(&world.terrain), world.scale())?;
    let report = mesh.update(view.camera(), Target::TriangleBudget(budget), required)?;
    Ok((mesh, report))
}

/// Distortion in the picture: greatest, and root of the mean square.
fn shown(world: &World, view: &LodView, mesh: &ViewMesh<MemoryTerrain>) -> [f64; 2] {
    meshes::distortion(world, view, &heights_at_posts(&IndexedMesh::of(mesh), &world.ground))
}

/// Part (c) of the report.
pub(super) fn section(rows: &[Row], worlds: &[World], plan: &Plan) -> Section {
    let about = format!(
        "Sight lines between others, registered in one view of {} triangles: what they take from the mesh that the view \
         would have without them, and what that does to the picture. VERDICT asks for the right answer only; OBSTRUCTION \
         also for the place where a line is blocked, within 50 m; WEDGIE is the papers' rule, full detail wherever a \
         triangle's wedgie is met; PROFILE asks for full detail all along. Lines for which there is no room are named by \
         the frame.",
        plan.registered_budget
    );
    let mut blocks = vec![Block::Text(about)];
    for (number, world) in worlds.iter().enumerate() {
        let figure = |what: &str, label, value: fn(&Row) -> f64| Figure {
            title: format!("{}: {what}", world.name),
            across: Axis { label: "sight lines registered", is_log: true },
            up: Axis { label, is_log: true },
            series: curves(rows, number, value),
            is_joined: true,
        };
        blocks.push(Block::Figure(figure("triangles stolen", "triangles", |row| row.stolen as f64)));
        blocks.push(Block::Figure(figure("distortion (RMS) beside the plain mesh", "times", |row| {
            row.rms_px[0] / row.rms_px[1]
        })));
    }
    blocks.push(Block::Table(table(rows, worlds)));
    Section { title: "Fidelity".into(), blocks }
}

fn curves(rows: &[Row], number: usize, value: fn(&Row) -> f64) -> Vec<Series> {
    let of = |(asked, _): (&'static str, Fidelity)| {
        let points = rows.iter().filter(|row| row.world == number && row.asked == asked);
        Series { name: asked.into(), points: points.map(|row| [row.lines as f64, value(row)]).collect(), is_own: false }
    };
    ASKED.into_iter().map(of).collect()
}

fn table(rows: &[Row], worlds: &[World]) -> Table {
    let cells = |row: &Row| {
        vec![
            worlds.get(row.world).map_or("", |world| world.name.as_str()).into(),
            row.asked.into(),
            Cell::count(row.lines),
            Cell::number(row.stolen as f64),
            Cell::number(row.stolen as f64 / row.lines.max(1) as f64),
            Cell::count(row.named),
            Cell::count(row.silent),
            Cell::number(row.distortion_px[0]),
            Cell::number(row.distortion_px[1]),
            Cell::number(row.rms_px[0]),
            Cell::number(row.rms_px[1]),
            Cell::number(1e3 * row.seconds),
        ]
    };
    Table {
        file: "fidelity",
        title: "What sight lines take".into(),
        note:
            "Stolen triangles are those that lines took from the plain mesh of the same budget. Wrong in silence: on \
               the mesh, and not named. The time is that of a first frame."
                .into(),
        columns: vec![
            exact("terrain"),
            exact("fidelity"),
            exact("lines"),
            exact("stolen, triangles"),
            exact("stolen a line"),
            exact("named"),
            exact("wrong in silence"),
            exact("distortion max, px"),
            exact("plain mesh, px"),
            exact("distortion RMS, px"),
            exact("plain mesh RMS, px"),
            timed("first frame, ms"),
        ],
        rows: rows.iter().map(cells).collect(),
    }
}
