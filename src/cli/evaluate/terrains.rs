//! The terrains of a report: a synthetic one, the demo's, and those that the user names.

use std::{
    fs,
    path::{Path, PathBuf},
};

use super::{
    super::{Failure, demo::ELEVATION, generator::write, info::open_failure, ingest::dem_failure},
    failure,
};
use crate::{
    database::{self, Database, IngestOptions, OpenError, OpenOptions},
    dem,
    evaluate::trade::{Instrument, Plan, Step, TradeError, World},
    terrain::{HeightField, MemoryField, PAGE_SIDE, PageId, Posts, ReadError, SceneScale, synthetic},
};

/// Height of the synthetic terrain in metres, and metres between its posts.
const AMPLITUDE_M: i32 = 600;
const STEP_M: f64 = 30.0;
const SEED: u64 = 1;

/// All terrains of a report. `folder` is where files may stand for a moment.
pub(super) fn load(
    named: &[PathBuf],
    folder: &Path,
    plan: &Plan,
    instrument: &Instrument<'_>,
) -> Result<Vec<World>, Failure> {
    let total = named.len() + 2;
    let tell = |done| (instrument.tell)(Step { name: "reading terrains", done, total });
    tell(0);
    let side = plan.synthetic_side;
    let field = synthetic::fractal(side, side, SEED, AMPLITUDE_M).map_err(|e| failure(TradeError::Grid(e)))?;
    let scale = SceneScale { east_m: STEP_M, north_m: STEP_M, up_m: 1.0 };
    let mut worlds = vec![World::new("synthetic hills", field, scale, instrument).map_err(failure)?];
    tell(1);
    let source = folder.join("jacksboro.tif.partial");
    write(&source, ELEVATION)?;
    let built_in = ingested(&source, folder).and_then(|database| world("Jacksboro", &database, plan, instrument));
    remove(&source);
    worlds.push(built_in?);
    for (n, path) in named.iter().enumerate() {
        tell(2 + n);
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        let database = match Database::open(path, OpenOptions::default()) {
            Err(OpenError::NotADatabase) => ingested(path, folder)?,
            opened => opened.map_err(|error| open_failure(path, error))?,
        };
        worlds.push(world(&name, &database, plan, instrument)?);
    }
    Ok(worlds)
}

/// An elevation file as a database, whose file is there for as long as it takes to open it.
fn ingested(source: &Path, folder: &Path) -> Result<Database, Failure> {
    let mut raster = dem::open(&[source.to_owned()], &dem::OpenOptions::default(), &mut |_| {}).map_err(dem_failure)?;
    let target = folder.join("terrain.sightline.partial");
    let options = IngestOptions { replace: true, ..IngestOptions::default() };
    let written = database::ingest(&mut *raster, &target, &options, &mut |_| {});
    let opened = written
        .map_err(|error| Failure::input(source.display(), error))
        .and_then(|_| Database::open(&target, OpenOptions::default()).map_err(|error| open_failure(&target, error)));
    // The open file is read to its end although its name goes.
    remove(&target);
    opened
}

/// That a file which is of no use could not be removed harms nobody.
fn remove(path: &Path) {
    let _ = fs::remove_file(path);
}

/// The middle of a database in memory, with voids as they are drawn.
fn world(name: &str, database: &Database, plan: &Plan, instrument: &Instrument<'_>) -> Result<World, Failure> {
    let field = middle(database, plan.greatest_side).map_err(|error| Failure::input(name, error))?;
    World::new(name, field, database.scale(), instrument).map_err(failure)
}

fn middle(database: &Database, side: u32) -> Result<MemoryField, ReadError> {
    let grid = HeightField::grid(database);
    let [nx, ny] = [grid.nx(), grid.ny()].map(|posts| posts.min(side));
    // Even offsets keep the triangulation.
    let [west, south] = [grid.nx() - nx, grid.ny() - ny].map(|rest| (rest / 2) & !1);
    let mut posts = Posts::new(database);
    let mut failed = None;
    let field = MemoryField::from_fn(nx, ny, |i, j| {
        let (i, j) = (west + i, south + j);
        let page = posts.page(PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE });
        let post = page.map(|page| page.at(i % PAGE_SIDE, j % PAGE_SIDE));
        Some(post.map_or_else(
            |error| {
                failed = Some(error);
                0.0
            },
            |post| post.z,
        ))
    });
    match (failed, field) {
        (Some(error), _) => Err(error),
        (None, field) => field.map_err(|error| ReadError::Io { what: "the middle".into(), detail: error.to_string() }),
    }
}
