//! What the benchmarks share: a square piece of a database in memory, and a file that the system does not keep.

use std::{error::Error, path::Path, process::Command};

use sightline::{
    database::Database,
    terrain::{DrawnPost, HeightField, MemoryField, PAGE_SIDE, PageId, Posts},
};

/// The north-eastern `side` by `side` posts of a database, or as many as there are, in memory, voids as they are drawn.
pub fn north_east(database: &Database, side: u32) -> Result<MemoryField, Box<dyn Error>> {
    let grid = HeightField::grid(database);
    // Even offsets keep the triangulation.
    cut(database, [grid.nx(), grid.ny()].map(|posts| posts.saturating_sub(side) & !1), side, |post| Some(post.z))
}

/// The `side` by `side` posts of a database from post (`west`, `south`), or as many as there are, in memory, with the
/// heights that `height` gives them.
pub fn cut(
    database: &Database,
    [west, south]: [u32; 2],
    side: u32,
    height: impl Fn(DrawnPost) -> Option<f64>,
) -> Result<MemoryField, Box<dyn Error>> {
    let grid = HeightField::grid(database);
    let size = |posts: u32, first: u32| posts.saturating_sub(first).min(side);
    let mut posts = Posts::new(database);
    let mut failure = None;
    let field = MemoryField::from_fn(size(grid.nx(), west), size(grid.ny(), south), |i, j| {
        let (i, j) = (west + i, south + j);
        match posts.page(PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE }) {
            Ok(page) => height(page.at(i % PAGE_SIDE, j % PAGE_SIDE)),
            Err(error) => {
                failure = Some(error);
                None
            }
        }
    })?;
    failure.map_or(Ok(field), |error| Err(error.into()))
}

/// Has the system drop what it keeps of a file, by `dd` with `iflag=nocache`.
pub fn forget(path: &Path) -> Result<(), Box<dyn Error>> {
    let mut file = std::ffi::OsString::from("if=");
    file.push(path);
    let done = Command::new("dd").arg(file).args(["iflag=nocache", "count=0", "status=none"]).status()?;
    if done.success() { Ok(()) } else { Err(format!("dd ended with {done}").into()) }
}
