//! Adjoining `.hgt` tiles as one raster; a single tile is a mosaic of one.
//!
//! Neighbours share the posts of their common border. There a known post beats a void one, else the tile further
//! south wins, and of two equally far south the one further west. What the overlaps showed is counted, each row once.
//! Tiles that a full rectangle would have but that were not given are void. Tiles on both sides of the 180th meridian do
//! not adjoin here.
//!
//! Kept at hand: the tiles of the row of tiles being read (two rows of tiles at a shared row of posts), those of rows of
//! many in files, and one byte a post of one row.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::terrain::Georeference;

use super::hgt::{Corner, Packing, Tile, VOID};
use super::{DemError, OpenOptions, Raster, RasterInfo, SeamReport, crs};

/// What the parts of a mosaic say of one post of the row being read.
const KNOWN: u8 = 1;
const KNOWN_TWICE: u8 = 2;
const DIFFERS: u8 = 4;
const VOID_SOMEWHERE: u8 = 8;

/// Counts what the overlaps of a mosaic's parts show, each row once.
pub(super) struct Overlap {
    /// What was counted so far.
    pub(super) report: SeamReport,
    /// Rows that the report already covers.
    counted: Vec<bool>,
    flags: Vec<u8>,
    largest_difference_m: f64,
}

impl Overlap {
    /// Nothing counted yet, of `tiles` parts over `nx` by `ny` posts.
    pub(super) fn new(tiles: u32, nx: u32, ny: u32) -> Self {
        let report = SeamReport { tiles, ..SeamReport::default() };
        Self { report, counted: vec![false; ny as usize], flags: vec![0; nx as usize], largest_difference_m: 0.0 }
    }

    /// Begins a row.
    pub(super) fn begin_row(&mut self) {
        self.flags.fill(0);
        self.largest_difference_m = 0.0;
    }

    /// Puts what one part has at column `i`, NaN for void, into `post`, unless an earlier part knows it.
    #[inline]
    pub(super) fn put(&mut self, post: &mut f64, i: usize, height: f64) {
        let flags = &mut self.flags[i];
        if height.is_nan() {
            *flags |= VOID_SOMEWHERE;
        } else if post.is_nan() {
            *flags |= KNOWN;
            *post = height;
        } else {
            *flags |= KNOWN_TWICE;
            if *post != height {
                *flags |= DIFFERS;
                self.largest_difference_m = f64::max(self.largest_difference_m, (*post - height).abs());
            }
        }
    }

    /// Puts what the only part that has these columns has there, NaN for void, into `posts`.
    fn put_alone(&mut self, posts: &mut [f64], columns: Range<usize>, heights: impl Iterator<Item = f64>) {
        posts.iter_mut().zip(heights).for_each(|(post, height)| *post = height);
        // Of a post that one part has alone, nothing is counted but that it is covered.
        self.flags[columns].fill(KNOWN);
    }

    /// Counts row `j`, which is complete.
    pub(super) fn end_row(&mut self, j: u32) {
        if std::mem::replace(&mut self.counted[j as usize], true) {
            return;
        }
        let report = &mut self.report;
        for flags in &self.flags {
            report.compared_posts += u64::from(flags & KNOWN_TWICE != 0);
            report.differing_posts += u64::from(flags & DIFFERS != 0);
            report.filled_posts += u64::from(flags & (KNOWN | VOID_SOMEWHERE) == KNOWN | VOID_SOMEWHERE);
            report.uncovered_posts += u64::from(*flags == 0);
        }
        report.largest_difference_m = report.largest_difference_m.max(self.largest_difference_m);
    }
}

/// Tiles on a lattice of whole degrees.
pub(super) struct Mosaic {
    info: RasterInfo,
    /// By row of tiles and column of tiles, from the south-west.
    tiles: BTreeMap<(u32, u32), Tile>,
    /// Cells along the side of a tile.
    cells: u32,
    nodata: Option<f64>,
    overlap: Overlap,
    /// Bytes of unpacked tiles at hand, at most.
    unpacked_bytes: u64,
}

impl Mosaic {
    /// Opens tiles that adjoin each other.
    pub(super) fn open(files: &[(PathBuf, Packing)], options: &OpenOptions) -> Result<Self, DemError> {
        let mut tiles = Vec::with_capacity(files.len());
        for (path, packing) in files {
            tiles.push(Tile::look(path, *packing)?);
        }
        check_set(&tiles)?;
        let bound = |f: fn(&Tile) -> i32| {
            let (least, most) = tiles.iter().map(f).fold((i32::MAX, i32::MIN), |(a, b), v| (a.min(v), b.max(v)));
            (least, most.abs_diff(least) + 1)
        };
        let ((south, rows), (west, columns)) = (bound(|t| t.corner.lat), bound(|t| t.corner.lon));
        let side = tiles[0].side;
        let count = tiles.len() as u32;
        let info = describe(Corner { lat: south, lon: west }, side, [columns, rows], count, options, tiles[0].path())?;
        let has_packed = files.iter().any(|(_, packing)| *packing != Packing::Raw);
        // Where a row of posts is shared, two rows of tiles are at hand.
        let at_hand = u64::from(has_packed) * u64::from(columns) * u64::from(rows.min(2));
        let unpacked = at_hand * u64::from(side) * u64::from(side) * 2;
        let is_long = cfg!(unix) && unpacked > options.memory_bytes as u64;
        tiles.iter_mut().for_each(|tile| tile.is_one_of_many = is_long);
        let place = |t: Tile| ((t.corner.lat.abs_diff(south), t.corner.lon.abs_diff(west)), t);
        let mut overlap = Overlap::new(count, info.nx, info.ny);
        overlap.report.missing_tiles = rows * columns - count;
        Ok(Self {
            info,
            tiles: tiles.into_iter().map(place).collect(),
            cells: side - 1,
            nodata: options.nodata,
            overlap,
            unpacked_bytes: if is_long { 0 } else { unpacked },
        })
    }

    /// The rows of tiles that hold row `j`: one, or two where `j` is shared.
    fn tile_rows(&self, j: u32) -> std::ops::RangeInclusive<u32> {
        let last = (self.info.ny - 1) / self.cells - 1;
        let first = if j.is_multiple_of(self.cells) { (j / self.cells).saturating_sub(1) } else { j / self.cells };
        first..=(j / self.cells).min(last)
    }
}

impl Raster for Mosaic {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let rows = self.tile_rows(j);
        let is_shared = rows.start() != rows.end();
        let nodata = self.nodata.unwrap_or(f64::NAN);
        let height = |sample: &[u8; 2]| match i16::from_be_bytes(*sample) {
            VOID => f64::NAN,
            z if f64::from(z) == nodata => f64::NAN,
            z => f64::from(z),
        };
        out.fill(f64::NAN);
        self.overlap.begin_row();
        for (&(tj, ti), tile) in &mut self.tiles {
            if !rows.contains(&tj) {
                tile.release();
                continue;
            }
            let samples = tile.row(j - tj * self.cells)?;
            let start = ti as usize * self.cells as usize;
            let (samples, _) = samples.as_chunks();
            // Columns that no other tile has in this row.
            let own = if is_shared { 0..0 } else { 1..samples.len() - 1 };
            for i in (0..own.start).chain(own.end..samples.len()) {
                self.overlap.put(&mut out[start + i], start + i, height(&samples[i]));
            }
            let posts = start + own.start..start + own.end;
            self.overlap.put_alone(&mut out[posts.clone()], posts, samples[own].iter().map(height));
        }
        self.overlap.end_row(j);
        Ok(())
    }

    fn seams(&self) -> Option<SeamReport> {
        (self.overlap.report.tiles > 1).then_some(self.overlap.report)
    }

    fn release(&mut self) {
        self.tiles.values_mut().for_each(Tile::release);
    }

    fn memory_bytes(&self) -> u64 {
        self.unpacked_bytes
    }
}

/// Refuses tiles of different spacing, the same tile twice, and tiles that do not hang together.
fn check_set(tiles: &[Tile]) -> Result<(), DemError> {
    let first = &tiles[0];
    let mut left = BTreeMap::new();
    for tile in tiles {
        if tile.side != first.side {
            let detail = format!(
                "{} has {} posts a side and {} has {}; give tiles of one spacing",
                first.path().display(),
                first.side,
                tile.path().display(),
                tile.side
            );
            return Err(DemError::Mosaic { detail });
        }
        if left.insert(tile.corner, tile).is_some() {
            return Err(DemError::Mosaic { detail: format!("tile {} is given twice", tile.corner) });
        }
    }
    let mut reached = vec![first.corner];
    left.remove(&first.corner);
    while let Some(at) = reached.pop() {
        for (north, east) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
            let next = Corner { lat: at.lat + north, lon: at.lon + east };
            if left.remove(&next).is_some() {
                reached.push(next);
            }
        }
    }
    match left.keys().next() {
        Some(stray) => {
            let detail = format!(
                "tile {stray} does not adjoin {}, nor does any tile between; ingest it on its own",
                first.corner
            );
            Err(DemError::Mosaic { detail })
        }
        None => Ok(()),
    }
}

fn describe(
    corner: Corner,
    side: u32,
    [columns, rows]: [u32; 2],
    tiles: u32,
    options: &OpenOptions,
    path: &Path,
) -> Result<RasterInfo, DemError> {
    let step = 1.0 / f64::from(side - 1);
    let mut georeference = Georeference {
        epsg: Some(4326),
        geographic: true,
        origin: [f64::from(corner.lon), f64::from(corner.lat)],
        step: [step, step],
    };
    let (nx, ny) = (columns * (side - 1) + 1, rows * (side - 1) + 1);
    let mut notes = vec!["heights are taken as above the EGM96 geoid, as SRTM's are; the file does not say".to_owned()];
    if tiles > 1 {
        notes.push(format!("a mosaic of {tiles} tiles, {columns} x {rows}"));
    }
    crs::override_epsg(&mut georeference, options.epsg, &mut notes);
    crs::check(path, &georeference, nx, ny)?;
    let arc_seconds = 3600 / (side - 1);
    Ok(RasterInfo { format: format!("SRTM .hgt, {arc_seconds} arc-second"), nx, ny, georeference, unit_m: 1.0, notes })
}
