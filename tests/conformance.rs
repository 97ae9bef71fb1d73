//! The conformance vectors: see `conformance/README.md`. The name of every test here contains `conformance`.

mod vectors;

use sightline_proto::{
    mesh::Mesh,
    verdict::{MeshVerdict, verdict_on_mesh},
};
use vectors::{folder, grid, mesh_lines, meshes};

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
