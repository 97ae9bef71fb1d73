//! Readers of the conformance vectors, shared by tests. Panics on anything unexpected: a test's own input.

use std::{collections::HashMap, fs, path::Path, path::PathBuf};

use sightline::terrain::{Grid, MemoryField};
use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
};

/// The folder of the vectors.
pub(crate) fn folder() -> PathBuf {
    match std::env::var_os("SIGHTLINE_CONFORMANCE") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance"),
    }
}

fn read(folder: &Path, name: &str) -> String {
    let path = folder.join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Rows of heights, south first; void posts are `None`.
pub(crate) struct Heights {
    rows: Vec<Vec<Option<f64>>>,
}

impl Heights {
    /// Posts east and north.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.rows[0].len() as u32, self.rows.len() as u32)
    }

    /// The height of a post, or of the nearest one of the border; `None` when void.
    pub(crate) fn clamped(&self, i: u32, j: u32) -> Option<f64> {
        let (nx, ny) = self.size();
        self.rows[j.min(ny - 1) as usize][i.min(nx - 1) as usize]
    }
}

impl Heights {
    /// The grid as a height field.
    pub(crate) fn field(&self) -> MemoryField {
        let (nx, ny) = self.size();
        MemoryField::from_fn(nx, ny, |i, j| self.clamped(i, j)).unwrap()
    }
}

/// The grid `name`.
pub(crate) fn grid(folder: &Path, name: &str) -> Heights {
    let void = (name == "void_i16").then_some(-32_768.0);
    let number = |field: &str| field.trim().parse::<f64>().unwrap_or_else(|e| panic!("{name}: '{field}': {e}"));
    let row = |line: &str| line.split(',').map(number).map(|z| (Some(z) != void).then_some(z)).collect();
    let rows: Vec<Vec<_>> = read(folder, &format!("{name}.csv")).lines().map(row).collect();
    assert!(rows.iter().all(|r| r.len() == rows[0].len()));
    Heights { rows }
}

/// A mesh as a plain map of active posts.
pub(crate) struct SetMesh {
    /// Its number in the file.
    pub(crate) index: usize,
    /// The grid it lies over.
    pub(crate) grid_name: String,
    /// The number of triangles in the file.
    pub(crate) triangles: usize,
    root: RootSquare,
    size: (u32, u32),
    active: HashMap<Post, f64>,
}

impl SetMesh {
    /// The mesh of all posts of the same root square.
    pub(crate) fn refined_to_the_finest(&self, heights: &Heights) -> Self {
        let side = self.root.side();
        let posts = (0..=side).flat_map(|j| (0..=side).map(move |i| Post::new(i, j)));
        Self {
            index: self.index,
            grid_name: self.grid_name.clone(),
            triangles: 0,
            root: self.root,
            size: self.size,
            active: posts.map(|p| (p, heights.clamped(p.i, p.j).unwrap_or(0.0))).collect(),
        }
    }
}

impl Mesh for SetMesh {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        self.size
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.active.get(&p).copied()
    }
}

fn posts(list: &str) -> Vec<Post> {
    let post = |text: &str| {
        let (i, j) = text.split_once(',').unwrap_or_else(|| panic!("'{text}' is no post"));
        Post::new(i.parse().unwrap(), j.parse().unwrap())
    };
    list.split_whitespace().map(post).collect()
}

/// The meshes of `mesh.csv`, at the place of their number.
pub(crate) fn meshes(folder: &Path) -> Vec<SetMesh> {
    let text = read(folder, "mesh.csv");
    let meshes: Vec<_> = text.lines().skip(1).map(|line| mesh(folder, line)).collect();
    assert!(meshes.iter().enumerate().all(|(n, m)| m.index == n));
    meshes
}

fn mesh(folder: &Path, line: &str) -> SetMesh {
    // Only the lists of posts hold commas, and those are quoted: fields are separated where quotes are even.
    let mut fields = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            c => fields.last_mut().unwrap().push(c),
        }
    }
    let [index, grid_name, _seeds, closed, triangles] = &fields[..] else { panic!("'{line}'") };
    let heights = grid(folder, grid_name);
    let (nx, ny) = heights.size();
    let active = posts(closed).into_iter().map(|p| (p, heights.clamped(p.i, p.j).unwrap())).collect();
    SetMesh {
        index: index.parse().unwrap(),
        grid_name: grid_name.clone(),
        triangles: triangles.parse().unwrap(),
        root: Grid::new(nx, ny).unwrap().root(),
        size: (nx, ny),
        active,
    }
}

/// A line of `mesh_sight_lines.csv`.
#[derive(Debug)]
pub(crate) struct MeshLine {
    /// The number of the mesh.
    pub(crate) mesh: usize,
    /// One end.
    pub(crate) a: [f64; 3],
    /// The other end.
    pub(crate) b: [f64; 3],
    /// The verdict on the mesh.
    pub(crate) on_mesh: String,
    /// The verdict on the finest surface.
    pub(crate) on_finest: String,
}

/// The lines of `mesh_sight_lines.csv`.
pub(crate) fn mesh_lines(folder: &Path) -> Vec<MeshLine> {
    let text = read(folder, "mesh_sight_lines.csv");
    let line = |line: &str| {
        let fields: Vec<_> = line.split(',').collect();
        let [mesh, ax, ay, az, bx, by, bz, on_mesh, on_finest] = fields[..] else { panic!("'{line}'") };
        let at = |p: [&str; 3]| p.map(|v| v.parse().unwrap());
        MeshLine {
            mesh: mesh.parse().unwrap(),
            a: at([ax, ay, az]),
            b: at([bx, by, bz]),
            on_mesh: on_mesh.to_owned(),
            on_finest: on_finest.to_owned(),
        }
    };
    text.lines().skip(1).map(line).collect()
}

/// A line of `sight_lines.csv`.
#[derive(Debug)]
pub(crate) struct SightLine {
    /// The grid it is over.
    pub(crate) grid: String,
    /// How it was made.
    pub(crate) kind: String,
    /// One end.
    pub(crate) a: [f64; 3],
    /// The other end.
    pub(crate) b: [f64; 3],
    /// The verdict on the finest surface.
    pub(crate) verdict: String,
}

/// The lines of `sight_lines.csv`.
pub(crate) fn sight_lines(folder: &Path) -> Vec<SightLine> {
    let text = read(folder, "sight_lines.csv");
    let line = |line: &str| {
        let fields: Vec<_> = line.split(',').collect();
        let [grid, kind, ax, ay, az, bx, by, bz, verdict] = fields[..] else { panic!("'{line}'") };
        let at = |p: [&str; 3]| p.map(|v| v.parse().unwrap());
        SightLine {
            grid: grid.to_owned(),
            kind: kind.to_owned(),
            a: at([ax, ay, az]),
            b: at([bx, by, bz]),
            verdict: verdict.to_owned(),
        }
    };
    text.lines().skip(1).map(line).collect()
}
