//! The conformance vectors: see `conformance/README.md`. The name of every test here contains `conformance`.

mod vectors;

use std::collections::BTreeMap;

use sightline::{
    los::{Answer, LosError, Options, line_of_sight, line_of_sight_with, naive},
    terrain::MemoryField,
};
use sightline_proto::{
    mesh::Mesh,
    predicates::FilterOnly,
    verdict::{MeshVerdict, verdict_on_mesh},
};
use vectors::{SightLine, folder, grid, mesh_lines, meshes, sight_lines};

type Asked = fn(&MemoryField, [f64; 3], [f64; 3], Options) -> Result<Answer, LosError>;

/// The lines that `ask` answers wrongly from either end, of those whose number `chosen` picks; and how many it picks.
fn wrong_lines(ask: Asked, chosen: impl Fn(usize) -> bool) -> (Vec<SightLine>, usize) {
    let mut grids: BTreeMap<String, MemoryField> = BTreeMap::new();
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (_, line) in sight_lines(&folder()).into_iter().enumerate().filter(|&(n, _)| chosen(n)) {
        let field = grids.entry(line.grid.clone()).or_insert_with(|| grid(&folder(), &line.grid).field());
        let verdict = |a, b| ask(field, a, b, Options::default()).unwrap().verdict.name();
        count += 1;
        if verdict(line.a, line.b) != line.verdict || verdict(line.b, line.a) != line.verdict {
            wrong.push(line);
        }
    }
    (wrong, count)
}

#[test]
fn conformance_sight_lines() {
    let (wrong, all) = wrong_lines(line_of_sight, |_| true);
    assert!(all > 0);
    assert!(wrong.is_empty(), "{} of {all} wrong: {:#?}", wrong.len(), &wrong[..wrong.len().min(5)]);
}

#[test]
fn conformance_sight_lines_by_the_naive_reference() {
    let (wrong, all) = wrong_lines(naive::line_of_sight, |n| n % 5 == 0);
    assert!(all > 0);
    assert!(wrong.is_empty(), "{} of {all} wrong: {:#?}", wrong.len(), &wrong[..wrong.len().min(5)]);
}

#[test]
fn conformance_sight_lines_need_the_exact_rung() {
    let (wrong, all) = wrong_lines(line_of_sight_with::<FilterOnly, _>, |_| true);
    let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
    for line in &wrong {
        *kinds.entry(&line.kind).or_default() += 1;
    }
    println!("without the exact rung {} of {all} lines are wrong: {kinds:?}", wrong.len());
    assert!(!wrong.is_empty(), "either exact arithmetic is never needed, or the kernel is not used");
}

fn name(verdict: MeshVerdict) -> &'static str {
    match verdict {
        MeshVerdict::Visible => "VISIBLE",
        MeshVerdict::Blocked => "BLOCKED",
    }
}

#[test]
fn conformance_verdicts_on_meshes() {
    let meshes = meshes(&folder());
    let lines = mesh_lines(&folder());
    assert!(!lines.is_empty());
    for line in lines {
        let mesh = &meshes[line.mesh];
        assert_eq!(name(verdict_on_mesh(mesh, line.a, line.b)), line.on_mesh, "{line:?}");
        assert_eq!(name(verdict_on_mesh(mesh, line.b, line.a)), line.on_mesh, "reversed {line:?}");
    }
}

#[test]
fn conformance_meshes_have_the_listed_triangles() {
    for mesh in meshes(&folder()) {
        let mut count = 0;
        mesh.for_each_triangle(|_| count += 1);
        assert_eq!(count, mesh.triangles, "mesh {}", mesh.index);
    }
}

#[test]
fn conformance_full_meshes_give_the_finest_verdicts() {
    let lines = mesh_lines(&folder());
    for mesh in meshes(&folder()) {
        let full = mesh.refined_to_the_finest(&grid(&folder(), &mesh.grid_name));
        for line in lines.iter().filter(|l| l.mesh == mesh.index) {
            // These grids have no voids: a line is unknown only for what lies outside, which no mesh counts.
            let expected = if line.on_finest == "BLOCKED" { "BLOCKED" } else { "VISIBLE" };
            assert_eq!(name(verdict_on_mesh(&full, line.a, line.b)), expected, "{line:?}");
        }
    }
}
