//! From a raster to a database: quantise once, fill voids for drawing, compute the bounds, write.
//!
//! The heights become integers of the declared unit, to the nearest and ties away from zero; from then on that is the
//! terrain. The heights and bounds of the whole terrain are in memory meanwhile (about 2 and 8 bytes a post).

use std::{
    path::Path,
    sync::{Mutex, PoisonError},
};

use thiserror::Error;

use super::{
    error::WriteError,
    fill::{self, fill_voids},
    manifest::Provenance,
    paged::PagedField,
    writer::{self, Description, Written},
};
use crate::{
    dem::{DemError, Raster, SeamReport},
    terrain::{Grid, GridError, PAGE_SIDE, ReadError, SceneScale},
    wedgie::BoundsPyramid,
};

/// What is done about posts without data.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum VoidPolicy {
    /// They stay void: filled for drawing, unknown to lines of sight.
    #[default]
    Keep,
    /// A raster that has any is refused.
    Reject,
}

/// How a raster is ingested.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct IngestOptions {
    /// Metres per height unit; `None` takes what the raster suggests.
    pub unit_m: Option<f64>,
    /// What is done about voids.
    pub voids: VoidPolicy,
    /// Whether an existing database is replaced.
    pub replace: bool,
    /// Names of the sources, for the manifest.
    pub sources: Vec<String>,
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

/// How far an ingest has come: posts done in this stage, of all posts. Filling reports its start only.
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
    let total = grid.posts();
    let mut tell = |stage, done| progress(IngestProgress { stage, done, total });
    let (mut field, void_posts) = read(raster, grid, unit_m, &mut |done| tell(Stage::Reading, done))?;
    if void_posts == total {
        return Err(WriteError::AllVoid { posts: total }.into());
    }
    if void_posts > 0 {
        if options.voids == VoidPolicy::Reject {
            return Err(IngestError::Voids { void_posts, posts: total });
        }
        tell(Stage::Filling, 0);
        fill_voids(&mut field);
    }
    let georeference = info.georeference.is_placed().then_some(info.georeference);
    let scale = match georeference {
        Some(place) => place.scene_scale(info.nx, info.ny, unit_m),
        None => SceneScale { up_m: unit_m, ..SceneScale::UNIT },
    };
    let bounds = {
        let state = Mutex::new((0, &mut tell));
        BoundsPyramid::compute_with(&field, scale, &|more| {
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
    let written = writer::write(path, options.replace, &field, &bounds, &description, &mut |done| {
        tell(Stage::Writing, done);
    })?;
    Ok(Ingested { written, posts: total, void_posts, unit_m, seams })
}

/// Reads and quantises all rows; the field, voids at 0, and the number of voids.
fn read(
    raster: &mut dyn Raster,
    grid: Grid,
    unit_m: f64,
    progress: &mut dyn FnMut(u64),
) -> Result<(PagedField, u64), IngestError> {
    let nx = grid.nx() as usize;
    let mut field = PagedField::new(grid);
    let mut heights = Vec::new();
    let mut band = Vec::new();
    let mut void_posts = 0;
    for j0 in (0..grid.ny()).step_by(PAGE_SIDE as usize) {
        let rows = (grid.ny() - j0).min(PAGE_SIDE);
        heights.resize(rows as usize * nx, 0.0);
        raster.read_rows(j0, &mut heights)?;
        band.clear();
        for (n, &height_m) in heights.iter().enumerate() {
            if height_m.is_nan() {
                void_posts += 1;
                band.push(None);
                continue;
            }
            let quantised = quantise(height_m, unit_m);
            if quantised.is_none() {
                let (i, j) = ((n % nx) as u32, j0 + (n / nx) as u32);
                return Err(IngestError::Range { i, j, height_m, unit_m });
            }
            band.push(quantised);
        }
        field.push_band(&band);
        progress(u64::from(j0 + rows) * nx as u64);
    }
    Ok((field, void_posts))
}

/// The nearest integer of units, ties away from zero; `None` beyond 2^31 - 1.
fn quantise(height_m: f64, unit_m: f64) -> Option<i32> {
    let units = (height_m / unit_m).round();
    (units.abs() <= f64::from(i32::MAX)).then_some(units as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        database::{Database, OpenOptions, verify},
        dem::RasterInfo,
        terrain::{Georeference, HeightField, Posts},
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
