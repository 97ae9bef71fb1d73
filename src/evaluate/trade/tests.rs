//! A tiny run: everything is measured, nothing depends on the run, and no line is wrong in silence where lines are kept.

use std::{cell::Cell as Memory, collections::BTreeSet, sync::OnceLock, time::Duration};

use super::{
    document::{Block, Cell, Document, Ruling},
    *,
};
use crate::terrain::{SceneScale, synthetic};

fn tiny() -> Plan {
    Plan {
        synthetic_side: 65,
        greatest_side: 65,
        counts: vec![600],
        views: 1,
        frames: 3,
        mesh_lines: 12,
        query_lines: 40,
        registered: vec![3, 9],
        registered_budget: 1_000,
        thesis_cells: 32,
        probe_cells: 32,
        repeats: 1,
    }
}

fn report() -> (Document, usize) {
    let steps = Memory::new(0);
    let tell = |step: Step<'_>| {
        assert!(step.done <= step.total && !step.name.is_empty());
        steps.set(steps.get() + 1);
    };
    // A clock that stands still: what is left differs between runs for another reason than time.
    let instrument = Instrument { clock: &|| Duration::ZERO, tell: &tell };
    let scale = SceneScale { east_m: 30.0, north_m: 40.0, up_m: 1.0 };
    let world = |name: &str, nx, ny, seed| {
        World::new(name, synthetic::fractal(nx, ny, seed, 300).unwrap(), scale, &instrument).unwrap()
    };
    let worlds = [world("square", 65, 65, 1), world("oblong", 60, 41, 2)];
    let document = run(&tiny(), &worlds, &instrument).unwrap();
    (document, steps.get())
}

/// The report of one run, for both tests.
fn once() -> &'static (Document, usize) {
    static REPORT: OnceLock<(Document, usize)> = OnceLock::new();
    REPORT.get_or_init(report)
}

#[test]
fn a_report_is_complete_and_the_same_in_every_run() {
    let (document, steps) = once();
    assert!(*document == report().0, "two runs differ");
    assert!(*steps > 20, "{steps}");
    let mut files = BTreeSet::new();
    for table in document.tables() {
        assert!(files.insert(table.file), "{} is there twice", table.file);
        assert!(!table.rows.is_empty(), "{} is empty", table.file);
        for row in &table.rows {
            assert_eq!(row.len(), table.columns.len(), "{}", table.file);
        }
    }
    let column = |file: &str, name: &str| -> Vec<(String, Cell)> {
        let table = document.tables().find(|table| table.file == file).unwrap();
        let at = table.columns.iter().position(|column| column.name == name).unwrap();
        let system = |row: &[Cell]| match &row[1] {
            Cell::Text(name) => name.clone(),
            _ => String::new(),
        };
        table.rows.iter().map(|row| (system(row), row[at].clone())).collect()
    };
    // Exact answers and registered lines are never wrong; others are, or nothing would be measured.
    let wrong = column("meshes-accuracy", "wrong between others, %");
    let kept = wrong.iter().filter(|(system, _)| system == "Sightline, lines registered");
    assert!(kept.clone().count() == 2 && kept.into_iter().all(|(_, cell)| *cell == Cell::Number(0.0)));
    assert!(wrong.iter().any(|(_, cell)| matches!(cell, Cell::Number(v) if *v > 0.0)));
    assert!(column("fidelity", "wrong in silence").iter().all(|(_, cell)| *cell == Cell::Number(0.0)));
    assert!(column("lines-of-sight", "reference differs").iter().all(|(_, cell)| *cell == Cell::Number(0.0)));
    let table = document.tables().find(|table| table.file == "lines-of-sight").unwrap();
    let wrong_in = |way: &str| -> f64 {
        let rows = table.rows.iter().filter(|row| row[2] == Cell::from(way));
        rows.map(|row| if let Cell::Number(wrong) = row[6] { wrong } else { f64::NAN }).sum()
    };
    assert_eq!((wrong_in("EXACT"), wrong_in("EXACT, every crossing")), (0.0, 0.0));
    assert!(wrong_in("sampling every post (GIS)") > 0.0);
}

#[test]
fn every_claim_has_a_verdict_and_the_counts_of_the_papers_come_out() {
    let (document, _) = once();
    let blocks = document.sections.iter().flat_map(|section| &section.blocks);
    let claims: Vec<_> =
        blocks.filter_map(|b| if let Block::Claims(c) = b { Some(c) } else { None }).flatten().collect();
    assert!(claims.len() > 20 && claims.iter().all(|claim| !claim.found.is_empty() && !claim.found.contains("NaN")));
    let ruling = |start: &str| claims.iter().find(|claim| claim.claim.starts_with(start)).unwrap().ruling;
    assert_eq!(ruling("T-Strip takes 341"), Ruling::Confirmed);
    assert_eq!(ruling("GeoMipMap cannot go below"), Ruling::Refuted);
    assert_eq!(ruling("Frame rates"), Ruling::Untestable);
}
