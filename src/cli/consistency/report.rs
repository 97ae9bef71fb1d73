//! What a consistency test tells: a table, a document, a map.

use sightline_client::raster::{self, Mark, MarkKind, Picture, Style, Surface};
use sightline_proto::{diamond::Post, v1};

use super::{
    super::Failure,
    run::{Outcome, Plan, scene_from_grid},
};
use crate::{
    database::Database,
    evaluate::consistency::{ClientTally, percent},
    session::fidelity_to_wire,
    terrain::{HeightField, Posts},
};

/// Samples along the side of a map's ground.
const MAP_SAMPLES: u32 = 400;
/// Width of a map in pixels.
const MAP_WIDTH_PX: u32 = 1200;
/// A line is drawn as wrong when plain meshes get it wrong in more than one of so many comparisons.
const WRONG_IN: u64 = 10;

/// How many findings there are that must not be, those of the instrument itself included.
pub(in super::super) fn findings(outcome: &Outcome) -> u64 {
    outcome.comparison.total().findings() + outcome.checks.naive_differs
}

/// The table and the sums, as lines of text.
pub(in super::super) fn table(plan: &Plan, outcome: &Outcome) -> String {
    let mut out = String::from(
        "client          flight      budget  frames  comparisons  silent  named  unknown  mismatches  plain wrong\n",
    );
    let total = outcome.comparison.total();
    let flights = plan.clients.iter().map(|c| c.preset.name()).chain([""]);
    for (tally, flight) in outcome.comparison.clients.iter().chain([&total]).zip(flights) {
        out += &row(tally, flight);
    }
    let checks = outcome.checks;
    let answered = checks.visible + checks.blocked;
    out += &format!(
        "\n{} sight lines at {} epochs: {:.1} % of the exact verdicts are VISIBLE, {} UNKNOWN; {} redone by the naive \
         reference, {} differ\n",
        outcome.scenario.lines.len(),
        checks.epochs,
        percent(checks.visible, answered),
        checks.unknown,
        checks.naive,
        checks.naive_differs,
    );
    out += &format!(
        "silent disagreements: {} with sight lines; without them the same clients got {:.1} % of {} verdicts wrong\n",
        total.silent_disagreements,
        percent(total.plain_disagreements, total.plain_comparisons),
        total.plain_comparisons,
    );
    for e in &outcome.comparison.examples {
        out += &format!(
            "  {}: frame {} (pose {}, epoch {}): line {} is {} and comes out {}{}, ends {:?}\n",
            e.client,
            e.sequence,
            e.pose_sequence,
            e.epoch,
            e.line,
            e.exact,
            e.on_mesh,
            if e.named { ", but is named" } else { "" },
            e.ends,
        );
    }
    out
}

fn row(tally: &ClientTally, flight: &str) -> String {
    let budget = if tally.budget == 0 { String::new() } else { tally.budget.to_string() };
    let mismatches = tally.findings() - tally.silent_disagreements;
    format!(
        "{:<15} {:<10} {:>7} {:>7} {:>12} {:>7} {:>6} {:>8} {:>11} {:>10.1} %\n",
        tally.name,
        flight,
        budget,
        tally.frames,
        tally.comparisons,
        tally.silent_disagreements,
        tally.named,
        tally.unknown,
        mismatches,
        percent(tally.plain_disagreements, tally.plain_comparisons),
    )
}

/// Everything as one JSON document.
pub(in super::super) fn document(plan: &Plan, outcome: &Outcome, database: &Database) -> serde_json::Value {
    let total = outcome.comparison.total();
    let checks = outcome.checks;
    let clients: Vec<_> = outcome
        .comparison
        .clients
        .iter()
        .zip(&plan.clients)
        .map(|(tally, client)| {
            serde_json::json!({
                "flight": client.preset.name(), "tan_half_fov": client.tan_half_fov, "found": tally,
                "plain_wrong_percent": percent(tally.plain_disagreements, tally.plain_comparisons),
            })
        })
        .collect();
    serde_json::json!({
        "terrain_version": hex(&database.version()), "seed": plan.seed, "fidelity": fidelity_to_wire(plan.fidelity).0.as_str_name(),
        "sight_lines": outcome.scenario.lines.len(), "entities": outcome.scenario.entities.len(),
        "frames": plan.frames, "clients": clients, "all": total, "checks": checks,
        "visible_percent": percent(checks.visible, checks.visible + checks.blocked),
        "plain_wrong_percent": percent(total.plain_disagreements, total.plain_comparisons),
        "findings": findings(outcome), "examples": outcome.comparison.examples, "seconds": outcome.seconds,
    })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// The theatre from above with the lines as they stand at the end; magenta where plain meshes are often wrong.
pub(in super::super) fn map(plan: &Plan, outcome: &Outcome, database: &Database) -> Result<Picture, Failure> {
    let surface = ground(outcome.scenario.theatre, database)?;
    let compared = outcome.comparison.total().plain_comparisons / (outcome.scenario.lines.len().max(1) as u64);
    let mut marks = Vec::new();
    for (&id, line) in &outcome.last.lines {
        let Some(ends) = line.ends else { continue };
        let wrong = outcome.comparison.plain_wrong_by_line[id as usize - 1] * WRONG_IN > compared;
        let kind = match line.verdict {
            _ if wrong => MarkKind::Wrong,
            v1::Verdict::Visible => MarkKind::Visible,
            v1::Verdict::Blocked => MarkKind::Blocked,
            v1::Verdict::Unknown | v1::Verdict::Unspecified => MarkKind::Unknown,
        };
        let [a, b] = ends.map(|p| scene_from_grid(database, p));
        marks.push(Mark { a, b, kind });
    }
    // Wrong ones last, so that they are on top.
    marks.sort_by_key(|mark| mark.kind == MarkKind::Wrong);
    let wrong = marks.iter().filter(|m| m.kind == MarkKind::Wrong).count();
    let total = outcome.comparison.total();
    let plain = percent(total.plain_disagreements, total.plain_comparisons);
    let caption = vec![
        format!("{} sight lines, {} clients, seed {}", outcome.scenario.lines.len(), plan.clients.len(), plan.seed),
        "green visible, red blocked, grey unknown".into(),
        format!("magenta: {wrong} that plain meshes often get wrong ({plain:.1} % of verdicts)"),
        format!("silent disagreements with sight lines: {}", total.silent_disagreements),
    ];
    Ok(raster::draw_map(&surface, None, MAP_WIDTH_PX, &marks, &Style { caption, ..Style::default() }))
}

/// The drawn heights of the theatre, at most [`MAP_SAMPLES`] a side.
fn ground(theatre: [[f64; 2]; 2], database: &Database) -> Result<Surface, Failure> {
    let mut posts = Posts::new(database);
    let grid = HeightField::grid(database);
    let axis = |k: usize, last: u32| -> Vec<u32> {
        let (low, high) = (theatre[0][k] as u32, (theatre[1][k].ceil() as u32).min(last));
        let steps = (high - low).clamp(1, MAP_SAMPLES);
        (0..=steps).map(|n| low + ((u64::from(high - low) * u64::from(n)) / u64::from(steps)) as u32).collect()
    };
    let (columns, rows) = (axis(0, grid.nx() - 1), axis(1, grid.ny() - 1));
    let mut surface = Surface::default();
    for &j in &rows {
        for &i in &columns {
            let z = posts.at(Post::new(i, j)).map_err(|e| Failure::input("the database", e))?.z;
            surface.vertices.push(scene_from_grid(database, [f64::from(i), f64::from(j), z]));
        }
    }
    let width = columns.len() as u32;
    for row in 0..rows.len() as u32 - 1 {
        for column in 0..width - 1 {
            let south_west = row * width + column;
            let (south_east, north_west) = (south_west + 1, south_west + width);
            surface.triangles.push([south_west, south_east, north_west]);
            surface.triangles.push([south_east, north_west + 1, north_west]);
        }
    }
    if let (Some(first), Some(last)) = (surface.vertices.first(), surface.vertices.last()) {
        surface.extent = [[first[0], first[1]], [last[0], last[1]]];
    }
    Ok(surface)
}
