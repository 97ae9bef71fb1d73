//! Meshes for no view in particular: the vertical error of ours beside that of RTIN, as the library MARTINI makes it (after
//! Evans, Kirkpatrick and Townsend, "Right-triangulated irregular networks", 2001).
//!
//! A post's error there is its height above the middle of its base, or the greatest one of its children's; the greatest
//! are split first. `tests/bench` (`mesh_error`) has Delatin, greedy insertion, and the best bintree mesh beside them.

use std::sync::Arc;

use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
};

use super::{
    Plan, TradeError,
    document::{Cell, Table, exact},
    world::World,
};
use crate::{
    lod::{
        Ground, IndexedMesh,
        measure::{VerticalError, vertical_error},
    },
    roam::{Target, ViewMesh},
    view::Camera,
};

/// Both at a number of triangles.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Row {
    pub(super) world: usize,
    pub(super) wanted: u32,
    pub(super) ours: VerticalError,
    pub(super) rtin: VerticalError,
    /// Metres of a unit of both.
    up_m: f64,
}

/// The errors at all numbers of triangles.
pub(super) fn measure(number: usize, world: &World, plan: &Plan) -> Result<Vec<Row>, TradeError> {
    let mut ours = ViewMesh::new(Arc::clone(&world.terrain), world.scale())?;
    let order = order(&world.ground);
    let mut rows = Vec::new();
    for &wanted in &plan.counts {
        ours.update(&Camera::everywhere(), Target::TriangleBudget(wanted), &[])?;
        let rtin = Prefix::new(&world.ground, &order, wanted);
        rows.push(Row {
            world: number,
            wanted,
            ours: vertical_error(&IndexedMesh::of(&ours), &world.ground),
            rtin: vertical_error(&IndexedMesh::of(&rtin), &world.ground),
            up_m: world.scale().up_m,
        });
    }
    Ok(rows)
}

/// All posts but the corners in the order in which RTIN splits them. An error is no less than those below it, so every
/// beginning of the order is a mesh.
fn order(ground: &Ground) -> Vec<Post> {
    let (root, side) = (ground.grid().root(), ground.side());
    let place = |p: Post| (p.j * (side + 1) + p.i) as usize;
    let posts = (0..=side).flat_map(|j| (0..=side).map(move |i| Post::new(i, j)));
    let mut posts: Vec<_> = posts.filter_map(|p| Some((root.level(p)?, p))).collect();
    posts.sort_unstable_by_key(|&(level, p)| (std::cmp::Reverse(level), p));
    let mut errors = vec![0.0_f64; (side as usize + 1).pow(2)];
    for &(_, p) in &posts {
        let z = |p: Post| ground.z(p.i, p.j);
        let own = root.base_ends(p).map_or(0.0, |[e0, e1]| (z(p) - 0.5 * (z(e0) + z(e1))).abs());
        errors[place(p)] = root.children(p).fold(own, |most, child| most.max(errors[place(child)]));
    }
    posts.sort_unstable_by(|a, b| errors[place(b.1)].total_cmp(&errors[place(a.1)]).then(a.cmp(b)));
    posts.into_iter().map(|(_, p)| p).collect()
}

/// The mesh of as many of the first posts as fit.
struct Prefix<'a> {
    ground: &'a Ground,
    active: Vec<bool>,
}

impl<'a> Prefix<'a> {
    fn new(ground: &'a Ground, order: &[Post], wanted: u32) -> Self {
        let root = ground.grid().root();
        let mut mesh = Self { ground, active: vec![false; (ground.side() as usize + 1).pow(2)] };
        for p in root.corners() {
            mesh.add(p);
        }
        let mut triangles = 2;
        for &p in order {
            triangles += root.parents(p).count() as u32;
            if triangles > wanted {
                break;
            }
            mesh.add(p);
        }
        mesh
    }

    fn add(&mut self, p: Post) {
        let n = self.place(p);
        self.active[n] = true;
    }

    fn place(&self, p: Post) -> usize {
        (p.j * (self.ground.side() + 1) + p.i) as usize
    }
}

impl Mesh for Prefix<'_> {
    fn root(&self) -> RootSquare {
        self.ground.grid().root()
    }

    fn grid_size(&self) -> (u32, u32) {
        (self.ground.grid().nx(), self.ground.grid().ny())
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.active[self.place(p)].then(|| self.ground.z(p.i, p.j))
    }
}

/// The errors as a table.
pub(super) fn table(rows: &[Row], worlds: &[World]) -> Table {
    let cells = |row: &Row| {
        vec![
            worlds.get(row.world).map_or("", |world| world.name.as_str()).into(),
            Cell::count(row.wanted as usize),
            Cell::number(row.ours.max * row.up_m),
            Cell::number(row.rtin.max * row.up_m),
            Cell::number(row.ours.max / row.rtin.max),
            Cell::number(row.ours.rms * row.up_m),
            Cell::number(row.rtin.rms * row.up_m),
        ]
    };
    let columns =
        ["terrain", "triangles", "Sightline max, m", "RTIN max, m", "ratio of both", "Sightline RMS, m", "RTIN RMS, m"];
    Table {
        file: "meshes-without-a-view",
        title: "Without a view: vertical error beside RTIN".into(),
        note: "Meshes refined for the greatest vertical error anywhere. RTIN is what MARTINI makes; greedy insertion \
               (Delatin), which is not bound to bintree triangles, is compared in tests/bench, mesh_error."
            .into(),
        columns: columns.map(exact).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
