//! What was measured of meshes, as tables and figures.

use super::{
    contender::Contender,
    document::{Axis, Block, Cell, Column, Figure, Section, Series, Table, exact, timed},
    greatest, mean,
    meshes::Row,
    world::World,
};

const MILLISECONDS: f64 = 1e3;
const MEGABYTES: f64 = 1e-6;
const KILOBYTES: f64 = 1e-3;
const PERCENT: f64 = 100.0;

/// Part (b) of the report.
pub(super) fn section(rows: &[Row], without_view: Table, worlds: &[World]) -> Section {
    let mut blocks = vec![Block::Text(ABOUT.into())];
    for (number, world) in worlds.iter().enumerate() {
        let of_world: Vec<_> = rows.iter().filter(|row| row.world == number).collect();
        blocks.extend(figures(&of_world, world).map(Block::Figure));
    }
    blocks.push(Block::Table(without_view));
    blocks.extend([accuracy(rows, worlds), motion(rows, worlds), sizes(rows, worlds)].map(Block::Table));
    Section { title: "Meshes".into(), blocks }
}

const ABOUT: &str = "Each system is asked for the same numbers of triangles over the whole terrain, in the same views \
     (1280 x 720 pixels, 60 degrees, 150 m above ground). A system that cannot do with so few gives its coarsest mesh. \
     Errors are vertical, over the whole grid, and so favour systems that do not care about the view; distortion is \
     what a viewer sees: how far posts in the picture, hidden ones included, are drawn from their place. A sight line \
     is wrong when its exact verdict on the mesh differs from the exact verdict on the finest terrain; ends are 2 m \
     above ground. Then each system flies at 250 m/s and 30 frames a second, with the setting that gave the number in \
     the first view, as the papers do. Times of other systems include the list of all triangles; those of Sightline \
     do not, since its clients keep a mesh and are sent what changes.";

/// The curves of one terrain.
fn figures(rows: &[&Row], world: &World) -> [Figure; 4] {
    let triangles = || Axis { label: "triangles", is_log: true };
    let figure = |what: &str, label, is_log, value: fn(&Row) -> f64| Figure {
        title: format!("{}: {what}", world.name),
        across: triangles(),
        up: Axis { label, is_log },
        series: curves(rows, value),
        is_joined: true,
    };
    [
        figure("vertical error (root mean square)", "metres", true, |row| row.still.rms_m),
        figure("distortion in the picture (greatest)", "pixels", true, |row| row.still.distortion_px),
        figure("wrong sight lines between others", "percent", false, |row| row.still.others.silent_percent()),
        figure("time of a frame (median)", "milliseconds", true, |row| row.flown.frame_s * MILLISECONDS),
    ]
}

/// A curve for each contender.
fn curves(rows: &[&Row], value: impl Fn(&Row) -> f64) -> Vec<Series> {
    let of = |contender: Contender| {
        let points = rows.iter().filter(|row| row.contender == contender);
        let points = points.map(|row| [row.still.triangles, value(row)]).collect();
        Series { name: contender.name().into(), points, is_own: contender.is_own() }
    };
    Contender::all().map(of).collect()
}

/// The cells that name a row.
fn names(row: &Row, worlds: &[World]) -> [Cell; 3] {
    let world = worlds.get(row.world).map_or("", |world| &world.name);
    [world.into(), row.contender.name().into(), Cell::count(row.wanted as usize)]
}

fn rows_of<const N: usize>(rows: &[Row], worlds: &[World], cells: impl Fn(&Row) -> [Cell; N]) -> Vec<Vec<Cell>> {
    rows.iter().map(|row| names(row, worlds).into_iter().chain(cells(row)).collect()).collect()
}

fn columns<const N: usize>(own: [Column; N]) -> Vec<Column> {
    let named = ["terrain", "system", "asked for, triangles"].map(exact);
    named.into_iter().chain(own).collect()
}

fn accuracy(rows: &[Row], worlds: &[World]) -> Table {
    Table {
        file: "meshes-accuracy",
        title: "How good meshes are".into(),
        note: "In views that stand still. Wrong lines are percent of those asked; named lines are those of which the \
               frame itself says that they are wrong. A bound is kept when no measured distortion exceeds it."
            .into(),
        columns: columns([
            exact("triangles"),
            exact("error max, m"),
            exact("error RMS, m"),
            exact("error mean, m"),
            exact("distortion max, px"),
            exact("distortion RMS, px"),
            exact("bound, px"),
            exact("bound kept"),
            exact("wrong from viewer, %"),
            exact("wrong between others, %"),
            exact("named, %"),
        ]),
        rows: rows_of(rows, worlds, |row| {
            let still = &row.still;
            let lines = (still.viewer.lines + still.others.lines) as f64;
            let named = (still.viewer.named + still.others.named) as f64;
            let kept = if still.bound_px.is_some() { Cell::Mark(still.bound_kept) } else { Cell::Nothing };
            [
                Cell::number(still.triangles),
                Cell::number(still.max_m),
                Cell::number(still.rms_m),
                Cell::number(still.mean_m),
                Cell::number(still.distortion_px),
                Cell::number(still.distortion_rms_px),
                Cell::number(still.bound_px),
                kept,
                Cell::number(still.viewer.silent_percent()),
                Cell::number(still.others.silent_percent()),
                Cell::number(PERCENT * named / lines),
            ]
        }),
    }
}

fn motion(rows: &[Row], worlds: &[World]) -> Table {
    Table {
        file: "meshes-motion",
        title: "What a flight costs, and what pops".into(),
        note: "Jumps are of points of the surface from one frame to the next, from level of detail alone: both meshes \
               seen from the later frame's eye; the percentile is of the points that move. Morphed: with vertices that \
               move gradually, in systems that can. After half a turn: the greatest distortion of the first frame, and \
               once the view has stood still. Nested spheres depend on the threshold: they are made in the first frame."
            .into(),
        columns: columns([
            exact("triangles, least"),
            exact("triangles, most"),
            timed("prepare, ms"),
            timed("first frame, ms"),
            timed("frame, ms"),
            timed("frame after turn, ms"),
            exact("changed a frame, %"),
            exact("jump max, px"),
            exact("jump p95, px"),
            exact("morphed max, px"),
            exact("morphed p95, px"),
            exact("after turn, px"),
            exact("settled, px"),
        ]),
        rows: rows_of(rows, worlds, |row| {
            let flown = &row.flown;
            let least = flown.triangles.iter().copied().fold(f64::INFINITY, f64::min);
            [
                Cell::number(least),
                Cell::number(greatest(&flown.triangles)),
                Cell::number(flown.preparation_s * MILLISECONDS),
                Cell::number(flown.first_s * MILLISECONDS),
                Cell::number(flown.frame_s * MILLISECONDS),
                Cell::number(flown.turn_s * MILLISECONDS),
                Cell::number(PERCENT * mean(&flown.changed_shares)),
                Cell::number(flown.pops.largest_px),
                Cell::number(flown.pops.p95_px),
                Cell::number(flown.morphed.map(|pops| pops.largest_px)),
                Cell::number(flown.morphed.map(|pops| pops.p95_px)),
                Cell::number(flown.turned_px),
                Cell::number(flown.settled_px),
            ]
        }),
    }
}

fn sizes(rows: &[Row], worlds: &[World]) -> Table {
    Table {
        file: "meshes-size",
        title: "What meshes take".into(),
        note:
            "Memory is what is held besides the heights; of Sightline's, the bounds are shared by all views. Bytes are \
               of indices of 4 bytes: the whole mesh as a list, as strips grown greedily, as fans; and a list of the \
               triangles that came with a frame. Sent: GEOmancy's index buffers, and Sightline's payloads, which hold the \
               heights, too. Thin triangles have an angle below 15 degrees, in plan and in posts."
                .into(),
        columns: columns([
            exact("memory, MB"),
            exact("list, kB"),
            exact("strips, kB"),
            exact("triangles in a strip"),
            exact("fans, kB"),
            exact("changed a frame, kB"),
            exact("sent a frame, kB"),
            exact("thin, %"),
            exact("budget overrun, triangles"),
        ]),
        rows: rows_of(rows, worlds, |row| {
            let (still, flown) = (&row.still, &row.flown);
            let [list, strips, fans] = still.bytes.map(|bytes| Cell::number(bytes as f64 * KILOBYTES));
            [
                Cell::number(flown.memory_bytes as f64 * MEGABYTES),
                list,
                strips,
                Cell::number(still.strip_length),
                fans,
                Cell::number(flown.changed_bytes() * KILOBYTES),
                Cell::number(flown.sent_bytes.map(|bytes| bytes * KILOBYTES)),
                Cell::number(PERCENT * still.thin),
                Cell::number(flown.overrun as f64),
            ]
        }),
    }
}
