//! Adjoining or overlapping rasters of any format as one: GeoTIFF tiles, DTED cells, or a mix.
//!
//! The posts of all parts must lie on one lattice: the same reference system and spacing, and origins a whole number of
//! posts apart, as far as [`MAX_SHIFT_POSTS`] sees; others are refused, or resampled first
//! on request ([`on_finest_lattice`]). Parts may share a border (posts on it are in
//! both), overlap by any amount, or follow each other without a shared post, as pixels do. The parts must hang together
//! that way. Where several parts know a post, the part whose south edge lies further south wins, and of two equally far
//! south the one whose west edge lies further west; a known post beats a void one. What the overlaps showed is counted,
//! each row once. Posts of the bounding rectangle that no part covers are void.
//!
//! Kept at hand: what each part of the row being read keeps, and nine bytes a post of one row.

use std::path::{Path, PathBuf};

use crate::terrain::Georeference;

use super::{DemError, Raster, RasterInfo, Resampling, SeamReport, crs, mosaic::Overlap, resample::Resampled};

/// The most by which a post may be moved to lie on the first part's lattice, in posts. A guess, as large as no place is
/// known better than and far larger than what printing coordinates with six digits does; with half a post, pixel centres
/// and pixel corners could no longer be told apart.
const MAX_SHIFT_POSTS: f64 = 0.02;
/// Most posts along a side, as for one raster.
const MAX_SIDE: f64 = (1_u64 << 30) as f64 + 1.0;

/// One part, and where its posts lie in the whole.
struct Part {
    raster: Box<dyn Raster>,
    path: PathBuf,
    /// Column and row of its south-western post, and the column and row after its north-eastern one.
    west: u32,
    south: u32,
    east: u32,
    north: u32,
}

/// Several rasters as one.
pub(super) struct Join {
    info: RasterInfo,
    /// In the order in which they win.
    parts: Vec<Part>,
    overlap: Overlap,
    row: Vec<f64>,
}

impl Join {
    /// Puts at least two rasters, each with the file that it comes from, beside each other. Those that meet in a row keep
    /// at most `memory_bytes` at hand.
    pub(super) fn new(rasters: Rasters, memory_bytes: usize) -> Result<Self, DemError> {
        let places: Vec<_> = rasters.iter().map(|(path, raster)| (path.as_path(), raster.info())).collect();
        let (georeference, corners) = lattice(&places)?;
        let info = describe(&places, georeference, &corners)?;
        let parts = rasters.into_iter().zip(corners).map(|((path, raster), [west, south])| {
            let (east, north) = (west + raster.info().nx, south + raster.info().ny);
            Part { raster, path, west, south, east, north }
        });
        let mut parts: Vec<_> = parts.collect();
        parts.sort_by_key(|p| (p.south, p.west));
        check_set(&parts)?;
        let overlap = Overlap::new(parts.len() as u32, info.nx, info.ny);
        let mut join = Self { row: vec![0.0; info.nx as usize], info, parts, overlap };
        join.limit_memory(memory_bytes)?;
        Ok(join)
    }

    /// Most parts that share a row.
    fn most_in_a_row(&self) -> usize {
        let count = |row: u32| self.parts.iter().filter(|part| (part.south..part.north).contains(&row)).count();
        self.parts.iter().map(|part| count(part.south)).max().unwrap_or(1)
    }
}

impl Raster for Join {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        out.fill(f64::NAN);
        self.overlap.begin_row();
        for part in &mut self.parts {
            if !(part.south..part.north).contains(&j) {
                part.raster.release();
                continue;
            }
            let row = &mut self.row[..(part.east - part.west) as usize];
            part.raster.read_rows(j - part.south, row)?;
            for (i, height) in (part.west as usize..).zip(row) {
                self.overlap.put(&mut out[i], i, *height);
            }
        }
        self.overlap.end_row(j);
        Ok(())
    }

    fn seams(&self) -> Option<SeamReport> {
        Some(self.overlap.report)
    }

    fn release(&mut self) {
        self.parts.iter_mut().for_each(|part| part.raster.release());
    }

    fn limit_memory(&mut self, bytes: usize) -> Result<(), DemError> {
        let each = bytes / self.most_in_a_row();
        self.parts.iter_mut().try_for_each(|part| part.raster.limit_memory(each))
    }

    fn memory_bytes(&self) -> u64 {
        let mut all: Vec<_> = self.parts.iter().map(|part| part.raster.memory_bytes()).collect();
        all.sort_unstable();
        all.iter().rev().take(self.most_in_a_row()).sum()
    }
}

/// Rasters with the file that each comes from.
type Rasters = Vec<(PathBuf, Box<dyn Raster>)>;

/// Brings all rasters to the lattice of the one with the smallest cells, the first of several.
pub(super) fn on_finest_lattice(rasters: Rasters, method: Resampling) -> Result<Rasters, DemError> {
    let cell = |info: &RasterInfo| info.georeference.step[0] * info.georeference.step[1];
    let finest = rasters.iter().map(|(path, raster)| (path.clone(), raster.info().clone()));
    let Some((finest_path, finest)) = finest.reduce(|a, b| if cell(&b.1) < cell(&a.1) { b } else { a }) else {
        return Ok(rasters);
    };
    let brought = rasters.into_iter().map(|(path, raster)| {
        let places = [(finest_path.as_path(), &finest), (path.as_path(), raster.info())];
        let system = |info: &RasterInfo| (info.georeference.epsg, info.georeference.geographic);
        // Other reference systems are refused when all are put beside each other.
        if system(&finest) != system(raster.info())
            || !raster.info().georeference.is_placed()
            || lattice(&places).is_ok()
        {
            return Ok((path, raster));
        }
        let raster = Resampled::new(raster, &path, &finest.georeference, method)?;
        Ok((path, Box::new(raster) as Box<dyn Raster>))
    });
    brought.collect()
}

fn refuse(detail: String) -> DemError {
    DemError::Mosaic { detail }
}

/// The common lattice, and where the south-western post of each raster lies on it.
fn lattice(places: &[(&Path, &RasterInfo)]) -> Result<(Georeference, Vec<[u32; 2]>), DemError> {
    let (first_path, first) = places[0];
    let base = first.georeference;
    let mut whole = Vec::with_capacity(places.len());
    for (path, info) in places {
        let place = info.georeference;
        let both = || format!("{} and {}", first_path.display(), path.display());
        if !place.is_placed() {
            return Err(refuse(format!("{} does not say where it lies; ingest it on its own", path.display())));
        }
        if (place.epsg, place.geographic) != (base.epsg, base.geographic) {
            let [a, b] = [&base, &place].map(system);
            return Err(refuse(format!("{} are in different reference systems, {a} and {b}", both())));
        }
        let mut corner = [0.0; 2];
        for axis in 0..2 {
            let posts = if axis == 0 { info.nx.max(first.nx) } else { info.ny.max(first.ny) };
            let drift = (place.step[axis] / base.step[axis] - 1.0).abs() * f64::from(posts);
            if drift > MAX_SHIFT_POSTS {
                let [[a, b], [c, d]] = [base.step, place.step];
                return Err(refuse(format!(
                    "{} have different spacings: posts lie {a} by {b} and {c} by {d} map units apart (east by north); \
                     give files of one spacing, or bring all to the finest with --resample nearest or bilinear",
                    both()
                )));
            }
            let offset = (place.origin[axis] - base.origin[axis]) / base.step[axis];
            corner[axis] = offset.round();
            let shift = (offset - corner[axis]).abs();
            // Not finite means that the parts are further apart than numbers reach.
            if !(shift + drift <= MAX_SHIFT_POSTS && corner[axis].abs() <= MAX_SIDE) {
                let side = ["east", "north"][axis];
                return Err(refuse(format!(
                    "the posts of {} are not on one lattice: they lie {offset} posts apart {side}; bring all to \
                     the finest with --resample nearest or bilinear",
                    both()
                )));
            }
        }
        whole.push(corner);
    }
    let least = |axis: usize| whole.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
    let (west, south) = (least(0), least(1));
    let origin = base.map_from_grid(west, south);
    let corners: Vec<_> = whole.iter().map(|[x, y]| [x - west, y - south]).collect();
    for (corner, (path, info)) in corners.iter().zip(places) {
        if corner[0] + f64::from(info.nx) > MAX_SIDE || corner[1] + f64::from(info.ny) > MAX_SIDE {
            return Err(refuse(format!("{} lies too far from the others", path.display())));
        }
    }
    let corners = corners.iter().map(|[x, y]| [*x as u32, *y as u32]).collect();
    Ok((Georeference { origin, ..base }, corners))
}

fn system(place: &Georeference) -> String {
    match place.epsg {
        Some(code) => format!("EPSG:{code}"),
        None if place.geographic => "degrees of an unnamed one".to_owned(),
        None => "an unnamed one".to_owned(),
    }
}

fn describe(
    places: &[(&Path, &RasterInfo)],
    georeference: Georeference,
    corners: &[[u32; 2]],
) -> Result<RasterInfo, DemError> {
    let (path, first) = places[0];
    let most = |axis: usize, n: fn(&RasterInfo) -> u32| {
        corners.iter().zip(places).map(|(c, (_, info))| c[axis] + n(info)).max().unwrap_or_default()
    };
    let (nx, ny) = (most(0, |i| i.nx), most(1, |i| i.ny));
    crs::check(path, &georeference, nx, ny)?;
    let mut notes: Vec<String> = Vec::new();
    for note in places.iter().flat_map(|(_, info)| &info.notes) {
        if !notes.contains(note) {
            notes.push(note.clone());
        }
    }
    notes.push(format!("a mosaic of {} files", places.len()));
    let format = match places.iter().find(|(_, info)| info.format != first.format) {
        None => first.format.clone(),
        Some((_, other)) => format!("{} and {}", first.format, other.format),
    };
    let unit_m = places.iter().map(|(_, info)| info.unit_m).fold(f64::INFINITY, f64::min);
    Ok(RasterInfo { format, nx, ny, georeference, unit_m, notes })
}

/// Refuses the same place twice, and parts that do not hang together.
fn check_set(parts: &[Part]) -> Result<(), DemError> {
    for pair in parts.windows(2) {
        let [a, b] = [&pair[0], &pair[1]].map(|p| (p.west, p.south, p.east, p.north));
        if a == b {
            let [a, b] = [pair[0].path.display(), pair[1].path.display()];
            return Err(refuse(format!("{a} and {b} cover the same place; give one of them")));
        }
    }
    let touches = |a: &Part, b: &Part| a.west <= b.east && b.west <= a.east && a.south <= b.north && b.south <= a.north;
    let mut left: Vec<_> = (1..parts.len()).collect();
    let mut reached = vec![0];
    while let Some(at) = reached.pop() {
        let (near, far): (Vec<_>, Vec<_>) = left.into_iter().partition(|&n| touches(&parts[at], &parts[n]));
        reached.extend(near);
        left = far;
    }
    match left.first() {
        Some(&stray) => {
            let [first, stray] = [&parts[0], &parts[stray]].map(|p| p.path.display());
            let detail = format!("{stray} does not adjoin {first}, nor does any file between; ingest it on its own");
            Err(refuse(detail))
        }
        None => Ok(()),
    }
}
