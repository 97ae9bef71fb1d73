//! What the benchmarks share: a square piece of a database in memory.

use std::{error::Error, path::Path};

use sightline::{
    database::{Database, OpenOptions},
    terrain::{HeightField, MemoryField, PAGE_SIDE, PageId, Posts, SceneScale},
};

/// The `side` by `side` posts of a database from post (`west`, `south`), or as many as there are, in memory; voids as
/// they are drawn.
pub fn cut(path: &Path, [west, south]: [u32; 2], side: u32) -> Result<(MemoryField, SceneScale), Box<dyn Error>> {
    let database = Database::open(path, OpenOptions::default())?;
    let grid = HeightField::grid(&database);
    let size = |posts: u32, first: u32| posts.saturating_sub(first).min(side);
    let mut posts = Posts::new(&database);
    let mut failure = None;
    let field = MemoryField::from_fn(size(grid.nx(), west), size(grid.ny(), south), |i, j| {
        let (i, j) = (west + i, south + j);
        match posts.page(PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE }) {
            Ok(page) => Some(page.at(i % PAGE_SIDE, j % PAGE_SIDE).z),
            Err(error) => {
                failure = Some(error);
                None
            }
        }
    })?;
    failure.map_or(Ok((field, database.scale())), |error| Err(error.into()))
}
