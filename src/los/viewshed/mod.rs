//! The exact viewshed: what one observer sees of every post of a region, at a fraction of a query a post.
//!
//! Each cell holds the verdict of [`super::line_of_sight`] from the observer A to the target on its post, the least
//! f64 not below the post's height plus the height asked for; no ground, no target: a void post is UNKNOWN. No cell is
//! ever interpolated or sampled: most are settled by bounds of A's horizon (`fan`), some by walking back a few steps
//! from the target (`back`), and whatever is left is asked ([`Summary::asked`]).
//!
//! Cells come in tiles of a page each, as soon as a tile is complete, always in the same order. Memory is proportional
//! to the reach of the region, not to its area: the four quadrants around A advance together, ring by ring, and only
//! the tiles on the front are held.
//!
//! The idea of bounding the horizon over a sector of azimuths, and asking where the bounds leave a doubt, is that of
//! the sweeps over radial events (Van Kreveld, "Variations on sweep algorithms: efficient computation of extended
//! viewsheds and class intervals", 1996) turned from sampling into a filter, as S2's predicates are filters.

mod back;
mod column;
mod fan;
mod near;
mod push;
mod region;
#[cfg(test)]
mod tests;

use std::{
    collections::BTreeMap,
    ops::{ControlFlow, RangeInclusive},
};

use rayon::prelude::*;
use thiserror::Error;

use self::{
    column::TAME,
    fan::Fan,
    region::{Cells, REACH_LIMIT},
};
use super::{Earth, Lines, LosError, Options, Verdict, check_finite, on_ground, surface::two_sum, sweep::is_tiny};
use crate::terrain::{Grid, HeightField, PAGE_POSTS, PAGE_SIDE, PageId, Posts, SceneScale};

/// Which posts to look at; those outside the grid are left out.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Region {
    /// Posts within so many metres of the observer, in plan, in the scene frame.
    Radius {
        /// In metres.
        metres: f64,
        /// Metres per post.
        scale: SceneScale,
    },
    /// Posts of a rectangle.
    Rectangle {
        /// Columns.
        i: [u32; 2],
        /// Rows.
        j: [u32; 2],
    },
}

/// What is asked of a viewshed.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct View {
    /// A, in the grid frame; anywhere.
    pub observer: [f64; 3],
    /// Height of targets above their posts, in height units.
    pub target_height: f64,
    /// Which posts.
    pub region: Region,
    /// Whether contact with the ground between A and the target blocks.
    pub strict: bool,
    /// The shape of the Earth under the lines of sight.
    pub earth: Earth,
}

/// The cells of one page of posts.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Tile {
    /// Which page.
    pub page: PageId,
    /// Row-major, south row first, [`PAGE_SIDE`] a row; `None` outside the region.
    pub cells: Box<[Option<Verdict>]>,
    filled: usize,
}

impl Tile {
    fn new(page: PageId) -> Self {
        Self { page, cells: vec![None; PAGE_POSTS].into(), filled: 0 }
    }

    fn set(&mut self, i: u32, j: u32, verdict: Verdict) {
        let cell = &mut self.cells[(j % PAGE_SIDE * PAGE_SIDE + i % PAGE_SIDE) as usize];
        debug_assert!(cell.is_none(), "cell ({i}, {j}) is decided twice");
        *cell = Some(verdict);
        self.filled += 1;
    }

    fn join(&mut self, other: &Self) {
        for (cell, &found) in self.cells.iter_mut().zip(&other.cells) {
            debug_assert!(cell.is_none() || found.is_none(), "a cell of {:?} is decided twice", self.page);
            *cell = cell.or(found);
        }
        self.filled += other.filled;
    }
}

/// Tiles that are not complete yet.
type Tiles = BTreeMap<PageId, Tile>;

/// How many cells have been delivered, and of how many.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Progress {
    /// Cells delivered.
    pub done: u64,
    /// Cells of the region.
    pub total: u64,
}

/// What a viewshed found.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct Summary {
    /// Cells that are seen.
    pub visible: u64,
    /// Cells that are not.
    pub blocked: u64,
    /// Void posts, and those behind unknown ground.
    pub unknown: u64,
    /// How many of all these took a query of their own.
    pub asked: u64,
}

/// Why there is no viewshed.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum ViewshedError {
    /// The radius is not a distance.
    #[error("a radius of {0} m: it must be a finite number above 0")]
    BadRadius(f64),
    /// No post of the grid is in the region.
    #[error("no post of the terrain is in the region: see `sightline info` for its extent")]
    EmptyRegion,
    /// The observer is so far away that distances have no meaning any more.
    #[error("an observer at ({0}, {1}) posts is too far from the terrain for a radius: at most 2^40 posts")]
    FarObserver(f64, f64),
    /// The receiver of tiles wanted no more.
    #[error("stopped")]
    Stopped,
    /// A line of sight could not be asked.
    #[error(transparent)]
    Los(#[from] LosError),
}

/// The viewshed of `view`: every cell goes to `sink` exactly once, in tiles. All cores work on it; the answer does not
/// depend on how many there are.
pub fn viewshed<H, S>(field: &H, view: &View, mut sink: S) -> Result<Summary, ViewshedError>
where
    H: HeightField + ?Sized,
    S: FnMut(Tile, Progress) -> ControlFlow<()>,
{
    let [x, y, z] = view.observer;
    check_finite(view.observer, ["x", "y", "z"])?;
    check_finite([x, y, view.target_height], ["x", "y", "target height"])?;
    let cells = Cells::new(field.grid(), [x, y], view.region)?;
    let asker = Asker { field, view, cells: &cells };
    let own = Lines::new(field).ask(view.observer, view.observer, asker.options())?;
    let mut delivery = Delivery { cells: &cells, sink: &mut sink, open: Tiles::new(), summary: Summary::default() };
    let bend: f64 = view.earth.coefficients().iter().sum();
    let trusted = cells.reach() < REACH_LIMIT
        && z.abs() < TAME
        && bend * REACH_LIMIT * REACH_LIMIT < TAME
        && !is_tiny(view.earth.coefficients())
        && !is_tiny([x, y]);
    if own.verdict == Verdict::Blocked || !trusted {
        // Every line from below the ground is blocked, which its end tells; what is too large for bounds is asked.
        for page in cells.pages() {
            delivery.take(asker.page(page)?)?;
        }
    } else {
        let mut fans = Fan::around(&asker, own.verdict == Verdict::Unknown).map_err(LosError::from)?;
        delivery.take(asker.nearest()?)?;
        while !fans.is_empty() {
            let found: Vec<_> = fans.par_iter_mut().map(Fan::advance).collect();
            for found in found {
                delivery.take(found?)?;
            }
            fans.retain(|fan| !fan.is_done());
            delivery.complete()?;
        }
    }
    delivery.complete()?;
    debug_assert!(delivery.open.is_empty() && delivery.done() == cells.total());
    Ok(delivery.summary)
}

/// The least and the greatest column and row with a cell: `[[west, south], [east, north]]`, and the number of cells.
pub fn viewshed_extent(grid: Grid, view: &View) -> Result<([[u32; 2]; 2], u64), ViewshedError> {
    let cells = Cells::new(grid, [view.observer[0], view.observer[1]], view.region)?;
    let ends = |axis: usize| {
        let [low, high] = cells.extent(axis);
        let has = |&at: &i64| cells.along(axis, at).is_some();
        // There is at least one cell.
        let first = (low..=high).find(has).unwrap_or(low);
        [first as u32, (low..=high).rev().find(has).unwrap_or(first) as u32]
    };
    let ([west, east], [south, north]) = (ends(0), ends(1));
    Ok(([[west, south], [east, north]], cells.total()))
}

/// Cells that were decided together, and how many of them were asked.
struct Found {
    tiles: Tiles,
    asked: u64,
}

struct Delivery<'a, S> {
    cells: &'a Cells,
    sink: &'a mut S,
    open: Tiles,
    summary: Summary,
}

impl<S: FnMut(Tile, Progress) -> ControlFlow<()>> Delivery<'_, S> {
    fn done(&self) -> u64 {
        self.summary.visible + self.summary.blocked + self.summary.unknown
    }

    fn take(&mut self, found: Found) -> Result<(), ViewshedError> {
        self.summary.asked += found.asked;
        for (page, tile) in found.tiles {
            match self.open.entry(page) {
                std::collections::btree_map::Entry::Vacant(entry) => {
                    entry.insert(tile);
                }
                std::collections::btree_map::Entry::Occupied(mut entry) => entry.get_mut().join(&tile),
            }
        }
        Ok(())
    }

    /// Hands over the tiles that are complete.
    fn complete(&mut self) -> Result<(), ViewshedError> {
        let ready: Vec<_> =
            self.open.values().filter(|t| t.filled == self.cells.count_in(t.page)).map(|t| t.page).collect();
        for page in ready {
            let Some(tile) = self.open.remove(&page) else { continue };
            for verdict in tile.cells.iter().flatten() {
                *match verdict {
                    Verdict::Visible => &mut self.summary.visible,
                    Verdict::Blocked => &mut self.summary.blocked,
                    Verdict::Unknown => &mut self.summary.unknown,
                } += 1;
            }
            let progress = Progress { done: self.done(), total: self.cells.total() };
            if (self.sink)(tile, progress).is_break() {
                return Err(ViewshedError::Stopped);
            }
        }
        Ok(())
    }
}

/// Whom to ask about one cell.
struct Asker<'a, H: HeightField + ?Sized> {
    field: &'a H,
    view: &'a View,
    cells: &'a Cells,
}

impl<'a, H: HeightField + ?Sized> Asker<'a, H> {
    fn options(&self) -> Options {
        Options { strict: self.view.strict, earth: self.view.earth, ..Options::default() }
    }

    fn lines(&self) -> Lines<'a, H> {
        Lines::new(self.field)
    }

    /// The verdict on the target over a known post of height `z`.
    fn ask(&self, lines: &mut Lines<'a, H>, [i, j]: [u32; 2], z: f64) -> Result<Verdict, LosError> {
        let [x, y] = [f64::from(i), f64::from(j)];
        let height = self.view.target_height;
        let (sum, error) = two_sum(z, height);
        let is_kept = !is_tiny([z, height]);
        let top = match error {
            // The exact sum is above its rounded value.
            e if is_kept && e > 0.0 => sum.next_up(),
            e if is_kept && e <= 0.0 => sum,
            // Out of the range in which a sum knows its error.
            _ => on_ground(self.field, x, y, height)?.unwrap_or(sum),
        };
        if !top.is_finite() {
            return Err(LosError::OutOfRange { x, y, height });
        }
        Ok(lines.ask(self.view.observer, [x, y, top], self.options())?.verdict)
    }

    /// Asks posts `i` of row `j`.
    fn row(&self, j: u32, i: RangeInclusive<u32>, tile: &mut Tile) -> Result<u64, LosError> {
        let (mut lines, mut posts) = (self.lines(), Posts::new(self.field));
        let mut asked = 0;
        for i in i {
            let post = posts.at(sightline_proto::diamond::Post::new(i, j))?;
            let verdict = if post.void {
                Verdict::Unknown
            } else {
                asked += 1;
                self.ask(&mut lines, [i, j], post.z)?
            };
            tile.set(i, j, verdict);
        }
        Ok(asked)
    }

    /// All cells of a page, one by one.
    fn page(&self, page: PageId) -> Result<Found, LosError> {
        let rows = self.cells.rows_of(page);
        let found: Result<Vec<_>, LosError> = rows
            .into_par_iter()
            .map(|(j, i)| {
                let mut tile = Tile::new(page);
                let asked = self.row(j, i, &mut tile)?;
                Ok((tile, asked))
            })
            .collect();
        let (mut whole, mut asked) = (Tile::new(page), 0);
        for (tile, n) in found? {
            whole.join(&tile);
            asked += n;
        }
        Ok(Found { tiles: Tiles::from([(page, whole)]), asked })
    }

    /// The cells less than a post from A in both directions, which belong to no fan.
    fn nearest(&self) -> Result<Found, LosError> {
        let mut found = Found { tiles: Tiles::new(), asked: 0 };
        for (j, i) in self.cells.nearest() {
            let tile = |i| PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE };
            for i in i {
                let page = tile(i);
                let tile = found.tiles.entry(page).or_insert_with(|| Tile::new(page));
                found.asked += self.row(j, i..=i, tile)?;
            }
        }
        Ok(found)
    }
}
