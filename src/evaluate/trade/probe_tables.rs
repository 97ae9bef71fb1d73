//! What the probes found, as tables.

use super::{
    document::{Block, Cell, Claim, Ruling, Section, Table, exact, timed},
    findings::Findings,
    lindstrom,
};

/// The claims and what they rest on.
pub(super) fn section(found: &Findings<'_>, claims: Vec<Claim>) -> Section {
    let mut blocks = vec![Block::Text(format!("{ABOUT} {}", tally(&claims))), Block::Claims(claims)];
    if let Some(world) = found.worlds.first() {
        blocks.push(Block::Table(lindstrom::table(found.criteria, world)));
    }
    blocks.extend([strips(found), thresholds(found)].map(Block::Table));
    Section { title: "Claims of the papers".into(), blocks }
}

const ABOUT: &str = "Each verdict follows from numbers of this run. A claim about terrains in general is confirmed only if it \
     holds on all that were measured; numbers that a paper calls \"about\" so much are confirmed within a fifth. A system \
     here follows its paper, not the program that its author measured.";

/// How many claims have which verdict.
fn tally(claims: &[Claim]) -> String {
    let count = |ruling: Ruling| claims.iter().filter(|claim| claim.ruling == ruling).count();
    let all = [Ruling::Confirmed, Ruling::Refuted, Ruling::NotReproducible, Ruling::Untestable];
    let counts: Vec<_> = all.into_iter().map(|ruling| format!("{} {}", count(ruling), ruling.name())).collect();
    format!("Of {} claims: {}.", claims.len(), counts.join(", "))
}

fn strips(found: &Findings<'_>) -> Table {
    let cells = |row: &super::probes::Strips| {
        let [list, greedy, kept, fans] = row.bytes.map(|bytes| Cell::number(bytes as f64 / 1e3));
        vec![
            found.name(row.world).into(),
            Cell::count(row.triangles),
            Cell::number(row.greedy),
            Cell::number(row.kept),
            Cell::number(row.operations),
            Cell::number(row.written),
            Cell::number(100.0 * (row.slower - 1.0)),
            list,
            greedy,
            kept,
            fans,
        ]
    };
    Table {
        file: "strips",
        title: "Triangle strips of ROAM as published".into(),
        note: "At the end of a flight: strips grown greedily over the whole mesh, and strips that are kept while triangles \
               come and go. Bytes are of indices of 4 bytes, one of which ends each strip or fan."
            .into(),
        columns: vec![
            exact("terrain"),
            exact("triangles"),
            exact("in a greedy strip"),
            exact("in a kept strip"),
            exact("split and merged a frame"),
            exact("vertices written a frame"),
            timed("slower by, %"),
            exact("list, kB"),
            exact("greedy, kB"),
            exact("kept, kB"),
            exact("fans, kB"),
        ],
        rows: found.probes.strips.iter().map(cells).collect(),
    }
}

fn thresholds(found: &Findings<'_>) -> Table {
    let cells = |row: &super::probes::Threshold| {
        vec![
            found.name(row.world).into(),
            Cell::number(row.px),
            Cell::number(row.triangles.round()),
            Cell::number(row.dirty_tiles),
            Cell::number(row.index_bytes / 1e3),
        ]
    };
    Table {
        file: "geomancy",
        title: "GEOmancy at its thresholds".into(),
        note: "Over a straight flight: triangles, and the tiles whose index buffers are sent again in a frame.".into(),
        columns: vec![
            exact("terrain"),
            exact("threshold, px"),
            exact("triangles"),
            exact("tiles sent a frame"),
            exact("indices sent a frame, kB"),
        ],
        rows: found.probes.thresholds.iter().map(cells).collect(),
    }
}
