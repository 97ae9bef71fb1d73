//! Lines of sight: what each precision, and each way that others go, costs and gets wrong.
//!
//! The truth is the exact verdict, of which the first of each set are computed again by the naive reference in
//! fractions. *Sampling* is what GIS tools do: a height at each post's distance along the line, interpolated between the
//! four posts around it, against the line's. *T-Strip's walk* is Szoka's line-to with sector maxima
//! (`lod::SectorMaxima`), on the terrain and on the mesh of a view.

use std::sync::Arc;

use super::{
    Instrument, Plan, Step, TradeError,
    document::{Axis, Block, Cell, Figure, Section, Series, Table, exact, timed},
    lines::{self, Line},
    world::{World, view},
};
use crate::{
    evaluate::flight::Preset,
    lod::{Ground, LevelOfDetail, Metric, TStrip, Target},
    los::{self, Lines, Options, Precision, Verdict},
    wedgie::MemoryTerrain,
};

/// The tolerance that is tried, in metres.
const TOLERANCE_M: f64 = 1.0;
/// Lines of each set that are computed again in fractions.
const CHECKED: usize = 12;
/// Triangles of the mesh on which T-Strip walks.
const MESH_TRIANGLES: u32 = 10_000;
/// Range of the short lines in metres.
const SHORT_M: f64 = 1_000.0;

/// A way to answer.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Way {
    Precision(Precision),
    /// The exact walk that looks at every crossing.
    Plain,
    Sampling,
    LineTo,
    /// The same over the blocks of a mesh.
    LineToOnMesh,
}

impl Way {
    fn name(self) -> String {
        match self {
            Self::Precision(Precision::Exact) => "EXACT".into(),
            Self::Precision(Precision::F64) => "F64".into(),
            Self::Precision(Precision::Fast) => "FAST".into(),
            Self::Precision(Precision::Tolerance(_)) => format!("TOLERANCE, {TOLERANCE_M} m"),
            Self::Plain => "EXACT, every crossing".into(),
            Self::Sampling => "sampling every post (GIS)".into(),
            Self::LineTo => "T-Strip's line-to walk".into(),
            Self::LineToOnMesh => "the same on its mesh".into(),
        }
    }
}

/// A way on a set of lines.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Row {
    pub(super) world: usize,
    pub(super) set: &'static str,
    pub(super) way: Way,
    pub(super) lines: usize,
    pub(super) visible: usize,
    pub(super) wrong: usize,
    pub(super) per_second: f64,
    /// Of the first lines of the set, those for which the naive reference differs from the exact verdict.
    pub(super) naive_differs: usize,
}

/// Asks all lines in all ways.
pub(super) fn measure(
    number: usize,
    world: &World,
    plan: &Plan,
    instrument: &Instrument<'_>,
) -> Result<Vec<Row>, TradeError> {
    let name = format!("lines of sight on {}", world.name);
    let tolerance = Precision::Tolerance(TOLERANCE_M / world.scale().up_m);
    let ways = [Precision::Fast, Precision::F64, Precision::Exact, tolerance].map(Way::Precision);
    let mut strips = TStrip::new(Arc::clone(&world.ground), Metric::Distance);
    strips.update(&view(&world.flight(Preset::Straight, 1, 1)?[0])?, Target::Triangles(MESH_TRIANGLES))?;
    let mut rows = Vec::new();
    let short = SHORT_M.min(0.3 * world.shorter_side_m());
    let long = world.shorter_side_m();
    let sets = [
        ("ordinary, to 1 km", lines::between(world, plan.query_lines, short, 31)?),
        ("ordinary, across", lines::between(world, plan.query_lines, long, 32)?),
        ("post to post", lines::post_to_post(world, plan.query_lines, 33)?),
        ("grazing", lines::grazing(world, plan.query_lines / 10, 34)?),
    ];
    for (n, (set, lines)) in sets.iter().enumerate() {
        (instrument.tell)(Step { name: &name, done: n, total: sets.len() });
        let naive_differs = naive_differs(world, lines)?;
        for way in ways.into_iter().chain([Way::Plain, Way::Sampling, Way::LineTo, Way::LineToOnMesh]) {
            let mut seconds = f64::INFINITY;
            let mut blocked = Vec::new();
            for _ in 0..plan.repeats {
                let (answers, took) = instrument.timed(|| answer(way, world, &strips, lines));
                (blocked, seconds) = (answers?, seconds.min(took));
            }
            let is_wrong = |(line, blocked): &(&Line, bool)| (line.verdict == Verdict::Blocked) != *blocked;
            rows.push(Row {
                world: number,
                set,
                way,
                lines: lines.len(),
                visible: lines.iter().filter(|line| line.verdict == Verdict::Visible).count(),
                wrong: lines.iter().zip(blocked).filter(is_wrong).count(),
                per_second: lines.len() as f64 / seconds,
                naive_differs,
            });
        }
    }
    Ok(rows)
}

/// Of the first lines, those for which fractions say something else than the exact verdict.
fn naive_differs(world: &World, lines: &[Line]) -> Result<usize, TradeError> {
    let mut differ = 0;
    for line in lines.iter().take(CHECKED) {
        let [a, b] = line.ends;
        let naive = los::naive::line_of_sight(&*world.terrain, a, b, Options::default())?;
        differ += usize::from(naive.verdict != line.verdict);
    }
    Ok(differ)
}

/// Whether each line is blocked.
fn answer(way: Way, world: &World, strips: &TStrip, lines: &[Line]) -> Result<Vec<bool>, TradeError> {
    let ask = |mut asked: Lines<'_, MemoryTerrain>, precision| -> Result<Vec<bool>, TradeError> {
        let options = Options { precision, ..Options::default() };
        let blocked = |line: &Line| Ok(asked.ask(line.ends[0], line.ends[1], options)?.verdict == Verdict::Blocked);
        lines.iter().map(blocked).collect()
    };
    match way {
        Way::Precision(precision) => ask(Lines::new(&*world.terrain), precision),
        Way::Plain => ask(Lines::plain(&*world.terrain), Precision::Exact),
        Way::Sampling => Ok(lines.iter().map(|line| is_blocked_at_samples(&world.ground, line.ends)).collect()),
        Way::LineTo => {
            let blocked = |line: &Line| strips.sectors().blocked_by_terrain(&world.ground, line.ends[0], line.ends[1]);
            Ok(lines.iter().map(blocked).collect())
        }
        Way::LineToOnMesh => Ok(lines.iter().map(|line| strips.blocked_by_mesh(line.ends[0], line.ends[1])).collect()),
    }
}

/// Whether a sample along the line lies below the bilinear surface.
fn is_blocked_at_samples(ground: &Ground, [a, b]: [[f64; 3]; 2]) -> bool {
    let steps = (b[0] - a[0]).abs().max((b[1] - a[1]).abs()).ceil().max(1.0) as u32;
    (0..=steps).any(|n| {
        let t = f64::from(n) / f64::from(steps);
        let [x, y, z] = [0, 1, 2].map(|k| a[k] + t * (b[k] - a[k]));
        z < bilinear(ground, x, y)
    })
}

/// The surface as GIS tools interpolate it: between the four posts around a point.
fn bilinear(ground: &Ground, x: f64, y: f64) -> f64 {
    let grid = ground.grid();
    let cell = |v: f64, posts: u32| (v.max(0.0) as u32).min(posts - 2);
    let (i, j) = (cell(x, grid.nx()), cell(y, grid.ny()));
    let (u, v) = (x - f64::from(i), y - f64::from(j));
    let along = |j: u32| ground.z(i, j) + u * (ground.z(i + 1, j) - ground.z(i, j));
    along(j) + v * (along(j + 1) - along(j))
}

/// Part (a) of the report.
pub(super) fn section(rows: &[Row], worlds: &[World]) -> Section {
    let mut blocks = vec![Block::Text(ABOUT.into())];
    blocks.extend(worlds.iter().enumerate().map(|(number, world)| Block::Figure(figure(rows, number, world))));
    blocks.push(Block::Table(table(rows, worlds)));
    Section { title: "Lines of sight".into(), blocks }
}

const ABOUT: &str = "What a query costs and how often it is wrong, on one core, lines asked one by one. Ordinary lines \
     run between random places 2 m above ground. Lines from post to post, with ends in whole height units, touch the \
     ground exactly every now and then. Grazing lines are made to touch it: half of them end at the least height from which \
     the observer is seen, the others at the number below it. FAST and F64 stop where EXACT goes on when rounding could \
     have changed a sign. T-Strip walks in rounded numbers, on the terrain and on its mesh of 10,000 triangles in one view, \
     which is what a game asks.";

fn figure(rows: &[Row], number: usize, world: &World) -> Figure {
    let of_way = |row: &&Row| row.world == number;
    let mut series: Vec<Series> = Vec::new();
    for row in rows.iter().filter(of_way) {
        let point = [row.per_second, percent_wrong(row)];
        match series.iter_mut().find(|series| series.name == row.way.name()) {
            Some(series) => series.points.push(point),
            None => series.push(Series {
                name: row.way.name(),
                points: vec![point],
                is_own: matches!(row.way, Way::Precision(Precision::Exact)),
            }),
        }
    }
    Figure {
        title: format!("{}: wrong verdicts against speed, a point for each set", world.name),
        across: Axis { label: "queries a second", is_log: true },
        up: Axis { label: "wrong, percent", is_log: false },
        series,
        is_joined: false,
    }
}

fn percent_wrong(row: &Row) -> f64 {
    100.0 * row.wrong as f64 / row.lines.max(1) as f64
}

fn table(rows: &[Row], worlds: &[World]) -> Table {
    let cells = |row: &Row| {
        vec![
            worlds.get(row.world).map_or("", |world| world.name.as_str()).into(),
            row.set.into(),
            row.way.name().into(),
            Cell::count(row.lines),
            Cell::number(100.0 * row.visible as f64 / row.lines.max(1) as f64),
            Cell::number(row.per_second.round()),
            Cell::count(row.wrong),
            Cell::number(percent_wrong(row)),
            Cell::count(row.naive_differs),
        ]
    };
    Table {
        file: "lines-of-sight",
        title: "Precision against speed".into(),
        note: format!(
            "Queries a second are the best of several. The last column: of the first {CHECKED} lines of a set, those for \
             which a naive reference in fractions differs from EXACT."
        ),
        columns: vec![
            exact("terrain"),
            exact("lines"),
            exact("way"),
            exact("asked"),
            exact("visible, %"),
            timed("queries a second"),
            exact("wrong"),
            exact("wrong, %"),
            exact("reference differs"),
        ],
        rows: rows.iter().map(cells).collect(),
    }
}
