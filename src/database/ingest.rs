//! From a raster to a database: quantise once, fill voids for drawing, compute the bounds, write.
//!
//! The heights become integers of the declared unit, to the nearest and ties away from zero; from then on that is the
//! terrain. Rows are read once, from south to north, and become pages on a disk; all else is made from those, some at a
//! time, so that the memory taken stays below what is allowed, whatever the size of the terrain.

use std::{
    path::Path,
    sync::{Mutex, PoisonError},
};

use thiserror::Error;

use super::{
    budget::{Budget, DEFAULT_MEMORY_BYTES},
    draft::{Draft, Heights, Measured},
    error::WriteError,
    fill::{self, fill_voids},
    manifest::Provenance,
    scratch::Scratch,
    writer::{self, Content, Description, Written},
};
use crate::{
    dem::{DemError, Raster, SeamReport},
    terrain::{Grid, GridError, HeightField, PAGE_POSTS, PAGE_SIDE, ReadError, SceneScale},
};

/// What is done about posts without data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum VoidPolicy {
    /// They stay void: filled for drawing, unknown to lines of sight.
    Keep,
    /// A raster that has any is refused.
    Reject,
}

/// How a raster is ingested.
#[derive(Clone, PartialEq, Debug)]
pub struct IngestOptions {
    /// Metres per height unit; `None` takes what the raster suggests.
    pub unit_m: Option<f64>,
    /// What is done about voids.
    pub voids: VoidPolicy,
    /// Whether an existing database is replaced.
    pub replace: bool,
    /// Names of the sources, for the manifest.
    pub sources: Vec<String>,
    /// Bytes of memory that the program may take, what the raster's reader keeps at hand included.
    pub memory_bytes: usize,
}

impl Default for IngestOptions {
    fn default() -> Self {
        let (unit_m, voids, replace, sources) = (None, VoidPolicy::Keep, false, Vec::new());
        Self { unit_m, voids, replace, sources, memory_bytes: DEFAULT_MEMORY_BYTES }
    }
}

/// What an ingest is doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stage {
    /// Reading and quantising heights.
    Reading,
    /// Filling voids.
    Filling,
    /// Measuring the deviations of the hierarchy's triangles.
    Measuring,
    /// Writing the file.
    Writing,
}

/// How far an ingest has come: posts done in this stage, of all posts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct IngestProgress {
    /// What it is doing.
    pub stage: Stage,
    /// Posts done.
    pub done: u64,
    /// Posts in all.
    pub total: u64,
}

/// What was ingested.
#[derive(Clone, PartialEq, Debug)]
pub struct Ingested {
    /// The file that was written.
    pub written: Written,
    /// Posts of the grid.
    pub posts: u64,
    /// Posts without data.
    pub void_posts: u64,
    /// Metres per height unit.
    pub unit_m: f64,
    /// What the overlaps of tiles showed, for a mosaic.
    pub seams: Option<SeamReport>,
}

/// Why a raster could not be ingested.
#[derive(Debug, Error)]
pub enum IngestError {
    /// The input could not be read.
    #[error(transparent)]
    Dem(#[from] DemError),
    /// The database could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Voids were to be rejected.
    #[error("{void_posts} of {posts} posts are void; give --void keep to ingest them as unknown")]
    Voids {
        /// Posts without data.
        void_posts: u64,
        /// Posts of the grid.
        posts: u64,
    },
    /// The unit is no unit.
    #[error("a height unit of {0} m: it must be finite and above 0")]
    Unit(f64),
    /// A height does not fit 32 bits of the unit.
    #[error(
        "the height {height_m} m of post ({i}, {j}) is more than 2^31 - 1 units of {unit_m} m; choose a larger --unit"
    )]
    Range {
        /// Column.
        i: u32,
        /// Row.
        j: u32,
        /// The height in metres.
        height_m: f64,
        /// Metres per height unit.
        unit_m: f64,
    },
}

impl From<GridError> for IngestError {
    fn from(error: GridError) -> Self {
        Self::Write(error.into())
    }
}

impl From<ReadError> for IngestError {
    fn from(error: ReadError) -> Self {
        Self::Write(error.into())
    }
}

/// Ingests `raster` into a database at `path`. `progress` is called from any thread, one at a time.
pub fn ingest(
    raster: &mut dyn Raster,
    path: &Path,
    options: &IngestOptions,
    progress: &mut (dyn FnMut(IngestProgress) + Send),
) -> Result<Ingested, IngestError> {
    writer::refuse_existing(path, options.replace)?;
    let info = raster.info().clone();
    let unit_m = options.unit_m.unwrap_or(info.unit_m);
    if !(unit_m.is_finite() && unit_m > 0.0) {
        return Err(IngestError::Unit(unit_m));
    }
    let grid = Grid::new(info.nx, info.ny)?;
    let at_hand = usize::try_from(raster.memory_bytes()).unwrap_or(usize::MAX);
    let budget = writer::budget(options.memory_bytes.saturating_sub(at_hand), grid).map_err(|error| match error {
        WriteError::Memory { needed, nx, ny, .. } => {
            WriteError::Memory { needed: needed.saturating_add(at_hand), given: options.memory_bytes, nx, ny }
        }
        error => error,
    })?;
    ingest_within(raster, grid, unit_m, path, options, budget, progress)
}

fn ingest_within(
    raster: &mut dyn Raster,
    grid: Grid,
    unit_m: f64,
    path: &Path,
    options: &IngestOptions,
    budget: Budget,
    progress: &mut (dyn FnMut(IngestProgress) + Send),
) -> Result<Ingested, IngestError> {
    let total = grid.posts();
    let mut tell = |stage, done| progress(IngestProgress { stage, done, total });
    let scratch = Scratch::beside(path, budget.cache_bytes)?;
    let mut heights = read(raster, &scratch, grid, unit_m, &mut |done| tell(Stage::Reading, done))?;
    raster.release();
    let void_posts = heights.void_posts;
    if void_posts == total {
        return Err(WriteError::AllVoid { posts: total }.into());
    }
    if void_posts > 0 {
        if options.voids == VoidPolicy::Reject {
            return Err(IngestError::Voids { void_posts, posts: total });
        }
        tell(Stage::Filling, 0);
        fill_voids(&scratch, &mut heights, &mut |done| tell(Stage::Filling, done))?;
    }
    let place = raster.info().georeference;
    let georeference = place.is_placed().then_some(place);
    let scale = match georeference {
        Some(place) => place.scene_scale(grid.nx(), grid.ny(), unit_m),
        None => SceneScale { up_m: unit_m, ..SceneScale::UNIT },
    };
    let draft = {
        let state = Mutex::new((0, &mut tell));
        Draft::complete(&scratch, heights, scale, budget, &|more| {
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            state.0 = (state.0 + more).min(total);
            let done = state.0;
            (state.1)(Stage::Measuring, done);
        })?
    };
    let seams = raster.seams();
    let provenance = Provenance {
        sources: options.sources.clone(),
        written_by: concat!("sightline ", env!("CARGO_PKG_VERSION")).into(),
        void_filling: if void_posts > 0 { fill::METHOD.into() } else { String::new() },
        seam_disagreements: seams.map_or(0, |s| s.differing_posts),
    };
    let description = Description { scale, georeference, provenance };
    let written = writer::publish(path, options.replace, |file| {
        Content::plan(&draft, &description)?.write(file, path, &mut |done| tell(Stage::Writing, done))
    })?;
    Ok(Ingested { written, posts: total, void_posts, unit_m, seams })
}

/// Reads and quantises all rows into pages, voids at 0.
fn read<'a>(
    raster: &mut dyn Raster,
    scratch: &'a Scratch,
    grid: Grid,
    unit_m: f64,
    progress: &mut dyn FnMut(u64),
) -> Result<Heights<'a>, IngestError> {
    let (nx, page_rows) = (grid.nx() as usize, grid.pages().1);
    let mut heights = Heights::new(scratch, grid);
    let rows_of = |pj: u32| (grid.ny() - pj * PAGE_SIDE).min(PAGE_SIDE);
    let mut read = |pj: u32, band_m: &mut Vec<f64>| {
        band_m.resize(rows_of(pj) as usize * nx, 0.0);
        raster.read_rows(pj * PAGE_SIDE, band_m)
    };
    let (mut band_m, mut next_m) = (Vec::new(), Vec::new());
    read(0, &mut next_m)?;
    for pj in 0..page_rows {
        std::mem::swap(&mut band_m, &mut next_m);
        // The next rows are read while these become pages.
        let (pushed, next) = rayon::join(
            || push(&mut heights, pj, &band_m, unit_m),
            || if pj + 1 < page_rows { read(pj + 1, &mut next_m) } else { Ok(()) },
        );
        pushed?;
        next?;
        progress(u64::from(pj * PAGE_SIDE + rows_of(pj)) * nx as u64);
    }
    Ok(heights)
}

/// Makes the pages of row `pj` from its heights in metres.
fn push(heights: &mut Heights<'_>, pj: u32, band_m: &[f64], unit_m: f64) -> Result<(), IngestError> {
    let nx = heights.grid().nx() as usize;
    heights.push_row(pj, |id| {
        let west = (id.pi * PAGE_SIDE) as usize;
        let rows = band_m.chunks_exact(nx).map(|row| &row[west..nx.min(west + PAGE_SIDE as usize)]);
        quantised(rows, unit_m).map_err(|[i, j]| {
            let (i, height_m) = (west as u32 + i, band_m[j as usize * nx + west + i as usize]);
            IngestError::Range { i, j: pj * PAGE_SIDE + j, height_m, unit_m }
        })
    })
}

/// A page from its rows, heights in metres, NaN where void; the column and row of a height that does not fit.
fn quantised<'a>(rows: impl Iterator<Item = &'a [f64]>, unit_m: f64) -> Result<Measured, [u32; 2]> {
    let (mut heights, mut voids) = (vec![0; PAGE_POSTS], [0; PAGE_POSTS / 64]);
    let (mut low, mut high) = (i32::MAX, i32::MIN);
    for (j, (row, out)) in rows.zip(heights.chunks_exact_mut(PAGE_SIDE as usize)).enumerate() {
        for (i, (&height_m, out)) in row.iter().zip(out).enumerate() {
            if height_m.is_nan() {
                voids[j] |= 1 << i;
                continue;
            }
            let z = quantise(height_m, unit_m).ok_or([i as u32, j as u32])?;
            (low, high) = (low.min(z), high.max(z));
            *out = z;
        }
    }
    Ok(Measured::new(&heights, &voids, (low <= high).then_some((low, high))))
}

/// The nearest integer of units, ties away from zero; `None` beyond 2^31 - 1.
#[inline]
fn quantise(height_m: f64, unit_m: f64) -> Option<i32> {
    let units = height_m / unit_m;
    let whole = units as i32;
    if f64::from(whole) == units && whole > i32::MIN {
        return Some(whole);
    }
    let units = units.round();
    (units.abs() <= f64::from(i32::MAX)).then_some(units as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        database::{Database, OpenOptions, verify},
        dem::RasterInfo,
        terrain::{Georeference, HeightField, Posts, synthetic},
        wedgie::{BoundsPyramid, Effort},
    };
    use sightline_proto::diamond::Post;

    struct Synthetic {
        info: RasterInfo,
        height: fn(u32, u32) -> f64,
    }

    impl Raster for Synthetic {
        fn info(&self) -> &RasterInfo {
            &self.info
        }

        fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
            (0..).zip(out).for_each(|(i, slot)| *slot = (self.height)(i, j));
            Ok(())
        }
    }

    fn raster(height: fn(u32, u32) -> f64) -> Synthetic {
        let georeference =
            Georeference { epsg: Some(4326), geographic: true, origin: [7.0, 60.0], step: [1.0 / 1200.0; 2] };
        let (format, notes) = ("synthetic".into(), Vec::new());
        Synthetic { info: RasterInfo { format, nx: 90, ny: 130, georeference, unit_m: 0.25, notes }, height }
    }

    #[test]
    fn heights_are_quantised_once_and_voids_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("it.sldb");
        let height = |i: u32, j: u32| if i == j { f64::NAN } else { f64::from(i) * 0.3 - f64::from(j) };
        let mut stages = Vec::new();
        let options = IngestOptions { sources: vec!["a".into()], ..IngestOptions::default() };
        let done = ingest(&mut raster(height), &path, &options, &mut |p| stages.push(p.stage)).unwrap();
        stages.dedup();
        assert_eq!(stages, [Stage::Reading, Stage::Filling, Stage::Measuring, Stage::Writing]);
        assert_eq!((done.posts, done.void_posts, done.unit_m), (90 * 130, 90, 0.25));
        let database = Database::open(&path, OpenOptions::default()).unwrap();
        assert_eq!(database.version(), done.written.version);
        assert_eq!(database.scale().up_m, 0.25);
        assert!(database.scale().east_m < 0.51 * database.scale().north_m, "at 60 degrees north");
        assert_eq!(database.provenance().void_filling, fill::METHOD);
        let mut posts = Posts::new(&database);
        for (i, j) in (0..130).flat_map(|j| (0..90).map(move |i| (i, j))) {
            let post = posts.at(Post::new(i, j)).unwrap();
            assert_eq!(post.void, i == j);
            assert!(post.void || (post.z * 0.25 - height(i, j)).abs() <= 0.125, "({i}, {j})");
        }
        assert!(verify(&path, &|_, _| ()).unwrap().damage.is_empty());
        let again = ingest(&mut raster(height), &path, &options, &mut |_| ());
        assert!(matches!(again, Err(IngestError::Write(WriteError::Exists(_)))));
    }

    /// However little memory there is, and whatever is worked on at once, the file is the same, byte for byte.
    #[test]
    fn the_database_does_not_depend_on_memory() {
        let folder = tempfile::tempdir().unwrap();
        let height = |i: u32, j: u32| match (i / 70, j / 70) {
            (1, 1) => f64::NAN,
            (2 | 3, _) => 40.0,
            (_, 0) if i.is_multiple_of(7) => f64::NAN,
            _ => f64::from(synthetic::fractal_height(i, j, 3, 900)),
        };
        for (nx, ny, unit_m) in [(300, 210, 1.0), (150, 400, 0.01), (70, 1100, 1.0)] {
            let grid = Grid::new(nx, ny).unwrap();
            let files =
                [(0, 32, 1), (40_000, 64, 2), (100 << 20, 512, usize::MAX)].map(|(cache_bytes, rows, bands)| {
                    let path = folder.path().join(format!("{nx}-{cache_bytes}.sldb"));
                    let mut raster = raster(height);
                    (raster.info.nx, raster.info.ny) = (nx, ny);
                    let budget = Budget { cache_bytes, effort: Effort { rows, bands } };
                    let options = IngestOptions::default();
                    ingest_within(&mut raster, grid, unit_m, &path, &options, budget, &mut |_| ()).unwrap();
                    assert!(verify(&path, &|_, _| ()).unwrap().damage.is_empty());
                    std::fs::read(&path).unwrap()
                });
            assert!(files[0] == files[1] && files[1] == files[2], "{nx} x {ny}");
            let database = Database::open(&folder.path().join(format!("{nx}-0.sldb")), OpenOptions::default()).unwrap();
            let bounds = BoundsPyramid::compute(&database, database.scale()).unwrap();
            for (i, j) in (0..grid.root().side()).step_by(2).flat_map(|j| [(0, j), (2, j), (64, j), (j, j)]).skip(4) {
                let p = Post::new(i, j);
                assert_eq!(database.stored_bounds(p).unwrap(), bounds.get(p), "{p:?} of {nx} x {ny}");
            }
        }
    }

    #[test]
    fn what_cannot_be_a_terrain_is_refused_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("it.sldb");
        let attempt = |height, options: IngestOptions| ingest(&mut raster(height), &path, &options, &mut |_| ());
        let default = IngestOptions::default;
        let all_void = attempt(|_, _| f64::NAN, default());
        assert!(matches!(all_void, Err(IngestError::Write(WriteError::AllVoid { .. }))));
        let one_void = |i, j| if (i, j) == (3, 100) { f64::NAN } else { 1.0 };
        let rejected = attempt(one_void, IngestOptions { voids: VoidPolicy::Reject, ..default() });
        assert!(matches!(rejected, Err(IngestError::Voids { void_posts: 1, .. })));
        for unit_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let refused = attempt(|_, _| 1.0, IngestOptions { unit_m: Some(unit_m), ..default() });
            assert!(matches!(refused, Err(IngestError::Unit(_))), "{unit_m}");
        }
        let little = attempt(|_, _| 1.0, IngestOptions { memory_bytes: 1 << 20, ..default() });
        assert!(matches!(little, Err(IngestError::Write(WriteError::Memory { nx: 90, ny: 130, .. }))));
        let high = |i, j| if (i, j) == (3, 100) { 9000.0 } else { 1.0 };
        let refused = attempt(high, IngestOptions { unit_m: Some(1e-6), ..default() });
        assert!(matches!(refused, Err(IngestError::Range { i: 3, j: 100, .. })));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn quantising_rounds_to_the_nearest_and_ties_away_from_zero() {
        assert_eq!([0.5, -0.5, 0.49, 1.5, -2.5].map(|z| quantise(z, 1.0).unwrap()), [1, -1, 0, 2, -3]);
        assert_eq!(quantise(2_147_483_647.0, 1.0), Some(i32::MAX));
        assert_eq!(quantise(-2_147_483_648.0, 1.0), None);
        assert_eq!(quantise(1.0, 1e-300), None);
    }

    #[test]
    fn a_raster_without_a_place_stays_without_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("it.sldb");
        let mut raster = raster(|i, _| f64::from(i));
        raster.info.georeference = Georeference { epsg: None, geographic: false, origin: [0.0; 2], step: [1.0; 2] };
        ingest(&mut raster, &path, &IngestOptions::default(), &mut |_| ()).unwrap();
        let database = Database::open(&path, OpenOptions::default()).unwrap();
        assert_eq!(database.georeference(), None);
        assert_eq!(database.scale(), SceneScale { east_m: 1.0, north_m: 1.0, up_m: 0.25 });
        assert_eq!(HeightField::grid(&database).posts(), 90 * 130);
    }
}
