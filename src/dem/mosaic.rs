//! Adjoining `.hgt` tiles as one raster; a single tile is a mosaic of one.
//!
//! Neighbours share the posts of their common border. There a known post beats a void one, else the tile further
//! south wins, and of two equally far south the one further west. What the overlaps showed is counted, each row once.
//! Tiles that a full rectangle would have but that were not given are void. Tiles on both sides of the 180th meridian do
//! not adjoin here.
//!
//! Kept at hand: the tiles of the row of tiles being read (two rows of tiles at a shared row of posts), and one byte a
//! post of one row.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::terrain::Georeference;

use super::hgt::{Corner, Packing, Tile, VOID};
use super::{DemError, OpenOptions, Raster, RasterInfo, SeamReport, crs};

/// What the tiles say of one post of the row being read.
const KNOWN: u8 = 1;
const KNOWN_TWICE: u8 = 2;
const DIFFERS: u8 = 4;
const VOID_SOMEWHERE: u8 = 8;

/// Tiles on a lattice of whole degrees.
pub(super) struct Mosaic {
    info: RasterInfo,
    /// By row of tiles and column of tiles, from the south-west.
    tiles: BTreeMap<(u32, u32), Tile>,
    /// Cells along the side of a tile.
    cells: u32,
    nodata: Option<f64>,
    seams: SeamReport,
    /// Rows that the seam report already covers.
    counted: Vec<bool>,
    flags: Vec<u8>,
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
        let seams = SeamReport { tiles: count, missing_tiles: rows * columns - count, ..SeamReport::default() };
        let info = describe(Corner { lat: south, lon: west }, side, [columns, rows], count, options, tiles[0].path())?;
        let place = |t: Tile| ((t.corner.lat.abs_diff(south), t.corner.lon.abs_diff(west)), t);
        Ok(Self {
            counted: vec![false; info.ny as usize],
            flags: vec![0; info.nx as usize],
            info,
            tiles: tiles.into_iter().map(place).collect(),
            cells: side - 1,
            nodata: options.nodata,
            seams,
        })
    }

    /// The rows of tiles that hold row `j`: one, or two where `j` is shared.
    fn tile_rows(&self, j: u32) -> std::ops::RangeInclusive<u32> {
        let last = (self.info.ny - 1) / self.cells - 1;
        let first = if j.is_multiple_of(self.cells) { (j / self.cells).saturating_sub(1) } else { j / self.cells };
        first..=(j / self.cells).min(last)
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let rows = self.tile_rows(j);
        out.fill(f64::NAN);
        self.flags.fill(0);
        let mut largest = 0.0;
        for (&(tj, ti), tile) in &mut self.tiles {
            if !rows.contains(&tj) {
                tile.release();
                continue;
            }
            let samples = tile.row(j - tj * self.cells)?;
            let start = ti as usize * self.cells as usize;
            let posts = out[start..].iter_mut().zip(&mut self.flags[start..]);
            for (bytes, (post, flags)) in samples.chunks_exact(2).zip(posts) {
                let sample = i16::from_be_bytes([bytes[0], bytes[1]]);
                let height = f64::from(sample);
                if sample == VOID || self.nodata == Some(height) {
                    *flags |= VOID_SOMEWHERE;
                } else if post.is_nan() {
                    *flags |= KNOWN;
                    *post = height;
                } else {
                    *flags |= KNOWN_TWICE;
                    if *post != height {
                        *flags |= DIFFERS;
                        largest = f64::max(largest, (*post - height).abs());
                    }
                }
            }
        }
        self.count(j, largest);
        Ok(())
    }

    fn count(&mut self, j: u32, largest_difference_m: f64) {
        if std::mem::replace(&mut self.counted[j as usize], true) {
            return;
        }
        for flags in &self.flags {
            self.seams.compared_posts += u64::from(flags & KNOWN_TWICE != 0);
            self.seams.differing_posts += u64::from(flags & DIFFERS != 0);
            self.seams.filled_posts += u64::from(flags & (KNOWN | VOID_SOMEWHERE) == KNOWN | VOID_SOMEWHERE);
        }
        self.seams.largest_difference_m = self.seams.largest_difference_m.max(largest_difference_m);
    }
}

impl Raster for Mosaic {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_rows(&mut self, j0: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.assert_rows(j0, out);
        for (j, row) in (j0..).zip(out.chunks_exact_mut(self.info.nx as usize)) {
            self.read_row(j, row)?;
        }
        Ok(())
    }

    fn seams(&self) -> Option<SeamReport> {
        (self.seams.tiles > 1).then_some(self.seams)
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
