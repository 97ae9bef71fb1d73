//! Posts, pages and the trait through which the algorithms read heights.

use std::sync::{Arc, OnceLock};

use sightline_proto::diamond::{Post, RootSquare};
use thiserror::Error;

use super::{
    block::Block,
    extremes::{BlockMaxima, ExtremesPage},
};

/// Posts along the side of a page.
pub const PAGE_SIDE: u32 = 64;
/// Posts of a page.
pub const PAGE_POSTS: usize = (PAGE_SIDE * PAGE_SIDE) as usize;

/// The extent of a grid of posts, at least 2 by 2, and the root square that covers it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Grid {
    nx: u32,
    ny: u32,
    root: RootSquare,
}

/// Why a size is not a grid's.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
#[error("a grid of {nx} x {ny} posts: it needs 2 to 2^30 + 1 posts a side")]
pub struct GridError {
    /// Posts from west to east.
    pub nx: u32,
    /// Posts from south to north.
    pub ny: u32,
}

impl Grid {
    /// A grid of `nx` by `ny` posts.
    pub fn new(nx: u32, ny: u32) -> Result<Self, GridError> {
        let root = RootSquare::covering(nx, ny).ok_or(GridError { nx, ny })?;
        Ok(Self { nx, ny, root })
    }

    /// Posts from west to east.
    pub fn nx(self) -> u32 {
        self.nx
    }

    /// Posts from south to north.
    pub fn ny(self) -> u32 {
        self.ny
    }

    /// The smallest root square that covers the grid.
    pub fn root(self) -> RootSquare {
        self.root
    }

    /// Number of posts.
    pub fn posts(self) -> u64 {
        u64::from(self.nx) * u64::from(self.ny)
    }

    /// Whether `p` is a post of the grid, as opposed to padding.
    pub fn contains(self, p: Post) -> bool {
        p.i < self.nx && p.j < self.ny
    }

    /// The post of the grid whose height `p` has: itself, or for padding the nearest one of the border.
    pub fn clamp(self, p: Post) -> Post {
        Post::new(p.i.min(self.nx - 1), p.j.min(self.ny - 1))
    }

    /// Pages from west to east, and from south to north.
    pub fn pages(self) -> (u32, u32) {
        (self.nx.div_ceil(PAGE_SIDE), self.ny.div_ceil(PAGE_SIDE))
    }

    /// Posts of the grid in a page of it, from west to east and from south to north: fewer on the border.
    pub fn page_size(self, id: PageId) -> (u32, u32) {
        let cut = |posts: u32, page: u32| (posts - page * PAGE_SIDE).min(PAGE_SIDE);
        (cut(self.nx, id.pi), cut(self.ny, id.pj))
    }
}

/// A page of posts: those with `i / 64 == pi` and `j / 64 == pj`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
pub struct PageId {
    /// Page column, eastward.
    pub pi: u32,
    /// Page row, northward.
    pub pj: u32,
}

impl PageId {
    /// The page that holds post `p`.
    pub fn of(p: Post) -> Self {
        Self { pi: p.i / PAGE_SIDE, pj: p.j / PAGE_SIDE }
    }
}

/// Why heights or bounds could not be read. Never a verdict.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum ReadError {
    /// The file does not hold what was written to it.
    #[error("{what} of the database is damaged: {detail}; run `sightline verify`, then ingest it again")]
    Damaged {
        /// Which page, table or section.
        what: String,
        /// What is wrong with it.
        detail: String,
    },
    /// The operating system refused a read.
    #[error("reading {what}: {detail}")]
    Io {
        /// What was read.
        what: String,
        /// The system's words.
        detail: String,
    },
}

/// The heights of a page in the narrowest type that holds them; row-major, south row first, [`PAGE_POSTS`] long.
#[derive(Clone, Debug)]
pub enum Samples {
    /// 16-bit integers.
    I16(Block<i16>),
    /// 32-bit integers.
    I32(Block<i32>),
    /// Any finite f64.
    F64(Block<f64>),
}

impl Samples {
    /// Heights, [`PAGE_POSTS`] of them, in the narrowest type that holds them to the last bit.
    pub(super) fn narrowest(heights: Vec<f64>) -> Self {
        let small: Option<Vec<i16>> = heights.iter().map(|&z| whole(z).and_then(|n| n.try_into().ok())).collect();
        if let Some(small) = small {
            return Self::I16(small.into());
        }
        let whole: Option<Vec<i32>> = heights.iter().map(|&z| whole(z)).collect();
        whole.map_or_else(|| Self::F64(heights.into()), |whole| Self::I32(whole.into()))
    }
}

/// A number as an integer, unless bits would be lost (that of -0 too).
fn whole(z: f64) -> Option<i32> {
    let n = z as i32;
    (f64::from(n).to_bits() == z.to_bits()).then_some(n)
}

/// A page of heights. Void posts carry their filled (drawn) height; posts of the page beyond the grid are 0.
#[derive(Clone, Debug)]
pub struct HeightPage {
    samples: Samples,
    /// One bit a post, set where void; `None` when no post of the page is.
    voids: Option<Box<[u64; PAGE_POSTS / 64]>>,
    /// Found when they are first asked for. Apart, so that what every reader looks at is small.
    maxima: OnceLock<Box<BlockMaxima>>,
}

impl HeightPage {
    /// A page of samples and, where some are void, their bits.
    pub fn new(samples: Samples, voids: Option<Box<[u64; PAGE_POSTS / 64]>>) -> Self {
        Self { samples, voids, maxima: OnceLock::new() }
    }

    /// The greatest heights of its blocks.
    #[inline]
    pub fn maxima(&self) -> &BlockMaxima {
        self.maxima.get_or_init(|| Box::new(BlockMaxima::of_heights(&self.samples, self.voids.as_deref())))
    }

    /// The heights.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// One bit a post, row by row from the south, lowest bit first, set where void; `None` when no post of the page is.
    #[inline]
    pub fn voids(&self) -> Option<&[u64; PAGE_POSTS / 64]> {
        self.voids.as_deref()
    }

    /// Whether any post of the page is void.
    pub fn has_voids(&self) -> bool {
        self.voids.is_some()
    }

    /// The post at column `i` and row `j` of the page, both below [`PAGE_SIDE`].
    #[inline]
    pub fn at(&self, i: u32, j: u32) -> DrawnPost {
        let n = (j * PAGE_SIDE + i) as usize;
        let z = match &self.samples {
            Samples::I16(s) => f64::from(s[n]),
            Samples::I32(s) => f64::from(s[n]),
            Samples::F64(s) => s[n],
        };
        let void = self.voids.as_ref().is_some_and(|v| v[n / 64] >> (n % 64) & 1 == 1);
        DrawnPost { z, void }
    }
}

/// What is stored of a post: the height at which it is drawn, and whether that height is only filled in.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct DrawnPost {
    /// Height in height units; for a void post the filled one.
    pub z: f64,
    /// Whether there is no data here: unknown to lines of sight.
    pub void: bool,
}

/// A grid of posts with exact heights, read by page.
pub trait HeightField: Send + Sync {
    /// The extent of the grid.
    fn grid(&self) -> Grid;

    /// Reads one page. `id` must be within [`Grid::pages`].
    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError>;

    /// The same page where the field has it in memory for as long as it lives: then readers need not hold it.
    #[inline]
    fn resident(&self, id: PageId) -> Option<&HeightPage> {
        let _ = id;
        None
    }

    /// Reads one page of a level of least and greatest heights ([`super::extremes`]), `level` at least 1. `None` when the
    /// field does not keep them: then what asks for bounds reads more pages of heights, and answers the same.
    fn extremes(&self, level: u32, id: PageId) -> Result<Option<Arc<ExtremesPage>>, ReadError> {
        let _ = (level, id);
        Ok(None)
    }

    /// The drawn heights at the corners of the root square, in the order of `RootSquare::corners`, where the field has them at
    /// hand; `None` tells nothing: then they are where all heights are, in up to four pages far apart.
    fn corner_heights(&self) -> Result<Option<[f64; 4]>, ReadError> {
        Ok(None)
    }
}

/// Number of pages of heights that a [`Posts`] keeps at hand; a power of two.
const SLOTS: usize = 64;
/// Number of pages of extremes: as many of level 1, and 4 of each of four levels above.
const COARSE_SLOTS: usize = SLOTS + 16;

/// A reader's own view of a field: keeps the last pages it met, so that neighbouring posts cost no lock.
pub struct Posts<'a, H: HeightField + ?Sized> {
    field: &'a H,
    grid: Grid,
    slots: Box<[Option<Held>; SLOTS]>,
    coarse: Box<[Option<HeldExtremes>; COARSE_SLOTS]>,
}

/// A page of heights at hand.
type Held = (PageId, Arc<HeightPage>);
/// The level and place of a page of extremes, and the page if there is one.
type HeldExtremes = (u32, PageId, Option<Arc<ExtremesPage>>);

impl<'a, H: HeightField + ?Sized> Posts<'a, H> {
    /// A reader of `field` with nothing at hand.
    pub fn new(field: &'a H) -> Self {
        Self {
            field,
            grid: field.grid(),
            slots: Box::new([const { None }; SLOTS]),
            coarse: Box::new([const { None }; COARSE_SLOTS]),
        }
    }

    /// The extent of the grid.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// The post at `p`, which may be padding: then the drawn height of the nearest border post, and void.
    #[inline]
    pub fn at(&mut self, p: Post) -> Result<DrawnPost, ReadError> {
        let inside = self.grid.clamp(p);
        let page = self.page(PageId::of(inside))?;
        let post = page.at(inside.i % PAGE_SIDE, inside.j % PAGE_SIDE);
        Ok(DrawnPost { z: post.z, void: post.void || inside != p })
    }

    /// The page `id`, which must be within the grid.
    #[inline]
    pub fn page(&mut self, id: PageId) -> Result<&HeightPage, ReadError> {
        if let Some(page) = self.field.resident(id) {
            return Ok(page);
        }
        let slot = slot_of(id);
        if self.slots[slot].as_ref().is_none_or(|(held, _)| *held != id) {
            self.slots[slot] = Some((id, self.field.page(id)?));
        }
        match &self.slots[slot] {
            Some((_, page)) => Ok(page),
            None => unreachable!("the slot was filled above"),
        }
    }

    /// The pages south-west, south-east, north-west and north-east of a window with corners `first` and `last`, which are
    /// at most a page apart.
    pub(crate) fn window(&mut self, first: PageId, last: PageId) -> Result<[&HeightPage; 4], ReadError> {
        let ids = [(first.pi, first.pj), (last.pi, first.pj), (first.pi, last.pj), (last.pi, last.pj)]
            .map(|(pi, pj)| PageId { pi, pj });
        let field = self.field;
        if let [Some(sw), Some(se), Some(nw), Some(ne)] = ids.map(|id| field.resident(id)) {
            return Ok([sw, se, nw, ne]);
        }
        for id in ids {
            self.page(id)?;
        }
        Ok(ids.map(|id| match (field.resident(id), &self.slots[slot_of(id)]) {
            (Some(page), _) => page,
            (None, Some((_, page))) => &**page,
            (None, None) => unreachable!("the slots of pages so close are different ones, and were filled above"),
        }))
    }

    /// The page `id` of a level of extremes from 1; `None` when the field has none.
    #[inline]
    pub(super) fn extremes(&mut self, level: u32, id: PageId) -> Result<Option<&ExtremesPage>, ReadError> {
        let slot = match level {
            1 => slot_of(id),
            _ => SLOTS + (id.pi % 2 + id.pj % 2 * 2 + level % 4 * 4) as usize,
        };
        let slot = &mut self.coarse[slot % COARSE_SLOTS];
        if slot.as_ref().is_none_or(|(at, held, _)| (*at, *held) != (level, id)) {
            *slot = Some((level, id, self.field.extremes(level, id)?));
        }
        Ok(slot.as_ref().and_then(|(.., page)| page.as_deref()))
    }
}

/// The slot of a page: those next to each other have different ones.
#[inline]
fn slot_of(id: PageId) -> usize {
    (id.pi as usize % 8 + id.pj as usize % 8 * 8) % SLOTS
}
