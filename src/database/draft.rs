//! A database in the making: heights, then bounds and extremes, as pages in a scratch file, and at last all of them in
//! the order of the file.
//!
//! Memory follows from the width of the grid and the number of its pages, not from its posts ([`super::budget`]).

use std::{borrow::Cow, ops::Range, sync::Arc};

use rayon::prelude::*;
use sightline_proto::diamond::Post;

use super::{
    budget::Budget,
    coarse::CoarseHeights,
    directory::Entry,
    error::WriteError,
    format::Element,
    layout::{BoundsPlace, Paging, QUAD_DIAMONDS, QUAD_SIDE, quad_post},
    pages::{self, BoundsPage},
    scratch::{Scratch, Shelf, heights_format},
};
use crate::{
    terrain::{
        Grid, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, ReadError, Samples, SceneScale,
        extremes::{self, BLOCK_SIDE, Extremes},
    },
    wedgie::{self, BoundsStore, DiamondBounds, Effort, LatticeSize, TightReader},
};

/// Numbers of shelves: of heights; of bounds from the exponent of their step; of extremes, filled levels and heights of
/// coarse lattices above these.
const HEIGHTS: u8 = 0;
const EXTREMES: u8 = 40;
pub(super) const LEVELS: u8 = 60;
pub(super) const COARSE: u8 = 100;

/// What a page of heights holds.
pub(super) struct Measured {
    pub(super) page: HeightPage,
    /// The least and the greatest known height.
    pub(super) known: Option<(i32, i32)>,
    pub(super) void_posts: u64,
}

impl Measured {
    /// A page of [`PAGE_POSTS`] drawn heights, row by row from the south, and the bits of void ones; those beyond the grid
    /// are 0 and not void.
    pub(super) fn new(heights: &[i32], voids: &[u64; PAGE_POSTS / 64], known: Option<(i32, i32)>) -> Self {
        let void_posts = voids.iter().map(|row| u64::from(row.count_ones())).sum();
        let page = HeightPage::new(narrowest(heights), (void_posts > 0).then(|| Box::new(*voids)));
        Self { page, known, void_posts }
    }
}

/// Heights in as few bits as they need.
pub(super) fn narrowest(heights: &[i32]) -> Samples {
    let (low, high) = heights.iter().fold((0, 0), |(low, high), &z| (z.min(low), z.max(high)));
    if [low, high].iter().any(|&z| i16::try_from(z).is_err()) {
        return Samples::I32(heights.to_vec().into());
    }
    Samples::I16(heights.iter().map(|&z| z as i16).collect::<Vec<_>>().into())
}

/// Heights on a shelf.
pub(super) struct Heights<'a> {
    grid: Grid,
    pub(super) shelf: Shelf<'a>,
    /// The range of known heights so far.
    pub(super) known: Option<(i32, i32)>,
    pub(super) void_posts: u64,
    /// Whether a height needs more than 16 bits.
    is_wide: bool,
}

impl<'a> Heights<'a> {
    pub(super) fn new(scratch: &'a Scratch, grid: Grid) -> Self {
        let shelf = Shelf::new(scratch, HEIGHTS, Paging::of_heights(grid.nx(), grid.ny()));
        Self { grid, shelf, known: None, void_posts: 0, is_wide: false }
    }

    /// Makes the pages of row `pj` on all threads. Of several errors it gives that of the westernmost page.
    pub(super) fn push_row<E: From<WriteError> + Send>(
        &mut self,
        pj: u32,
        page: impl Fn(PageId) -> Result<Measured, E> + Sync,
    ) -> Result<(), E> {
        let made = (0..self.grid.pages().0).into_par_iter().map(|pi| {
            let id = PageId { pi, pj };
            let Measured { page, known, void_posts } = page(id)?;
            Ok((id, self.shelf.put_heights(id, page)?, known, void_posts))
        });
        // Results in order, so that the first error is always the same one.
        for made in made.collect::<Vec<Result<_, E>>>() {
            let (id, entry, known, void_posts) = made?;
            self.is_wide |= heights_format(&entry).0 == Element::I32;
            self.shelf.set(id, entry);
            self.known = [self.known, known].into_iter().flatten().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
            self.void_posts += void_posts;
        }
        Ok(())
    }

    /// The element of all pages: of 16 bits when all drawn heights fit.
    pub(super) fn element(&self) -> Element {
        if self.is_wide { Element::I32 } else { Element::I16 }
    }

    /// The element of all pages of bounds: with heights as these.
    pub(super) fn element_of_bounds(&self) -> Element {
        if self.is_wide { Element::BoundsI32 } else { Element::BoundsI16 }
    }

    /// The bytes of page `id` with `element`, and its flags.
    pub(super) fn encoded(&self, id: PageId, element: Element) -> Result<(Vec<u8>, u32), WriteError> {
        let (stored, flags) = heights_format(self.shelf.entry(id));
        if stored == element {
            return Ok((self.shelf.bytes(id)?, flags));
        }
        let encoded = pages::encode_heights(&*self.shelf.heights(id)?, element, self.shelf.paging.size(id));
        encoded.ok_or_else(|| WriteError::Description("heights do not fit their section".into()))
    }

    /// The drawn heights of the posts nearest to the corners of the root square.
    pub(super) fn of_corners(&self) -> Result<[i32; 4], ReadError> {
        let mut heights = [0; 4];
        for (height, corner) in heights.iter_mut().zip(self.grid.root().corners()) {
            let p = self.grid.clamp(corner);
            *height = self.shelf.heights(PageId::of(p))?.at(p.i % PAGE_SIDE, p.j % PAGE_SIDE).z as i32;
        }
        Ok(heights)
    }

    /// Bytes of all pages with `element`.
    pub(super) fn bytes(&self, element: Element) -> u64 {
        let paging = self.shelf.paging;
        let of = |n: u64| {
            let id = paging.id(n);
            pages::page_bytes(element, paging.size(id), heights_format(self.shelf.entry(id)).1).unwrap_or_default()
                as u64
        };
        (0..paging.pages()).map(of).sum()
    }
}

impl HeightField for Heights<'_> {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        self.shelf.heights(id)
    }
}

/// Lattices of bounds on shelves.
pub(super) struct Lattices<'a> {
    scratch: &'a Scratch,
    pub(super) shelves: Vec<(LatticeSize, Shelf<'a>)>,
    element: Element,
    /// Rows of the last lattice that are there.
    rows: u32,
}

impl<'a> Lattices<'a> {
    /// The bounds of all diamonds over `heights`.
    pub(super) fn of(
        scratch: &'a Scratch,
        heights: &Heights<'_>,
        scale: SceneScale,
        effort: Effort,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Self, WriteError> {
        let lattices = Self { scratch, shelves: Vec::new(), element: heights.element_of_bounds(), rows: 0 };
        let mut all = InTheMaking { lattices, heights: CoarseHeights::of(scratch, heights)? };
        let wide = heights.element() == Element::I32;
        wedgie::compute_bounds(heights, scale, wide, effort, &mut all, progress)?;
        Ok(all.lattices)
    }
}

/// Lattices of bounds that are not yet complete, and the heights that go beside them.
struct InTheMaking<'a, 'h> {
    lattices: Lattices<'a>,
    heights: CoarseHeights<'h>,
}

impl BoundsStore for InTheMaking<'_, '_> {
    type Error = WriteError;
    type Reader<'r>
        = Reader<'r>
    where
        Self: 'r;

    fn append(&mut self, size: LatticeSize, rows: &[DiamondBounds]) -> Result<(), WriteError> {
        self.lattices.append(size, rows, &self.heights)
    }

    fn rows(&self, size: LatticeSize, rows: Range<u32>) -> Result<Cow<'_, [DiamondBounds]>, ReadError> {
        self.lattices.rows(size, rows)
    }

    fn reader(&self) -> Reader<'_> {
        let lattices = &self.lattices;
        Reader { lattices, slots: lattices.shelves.iter().map(|_| [const { None }; SLOTS]).collect() }
    }
}

impl Lattices<'_> {
    /// Keeps the next rows of a lattice with their heights.
    fn append(
        &mut self,
        size: LatticeSize,
        rows: &[DiamondBounds],
        heights: &CoarseHeights<'_>,
    ) -> Result<(), WriteError> {
        if self.shelves.last().is_none_or(|(last, _)| *last != size) {
            let paging = Paging::of_lattice(size.columns, size.rows);
            self.shelves.push((size, Shelf::new(self.scratch, size.k, paging)));
            self.rows = 0;
        }
        let Some((_, shelf)) = self.shelves.last_mut() else { return Ok(()) };
        let first = self.rows / (2 * QUAD_SIDE);
        let count = rows.len() as u32 / size.columns;
        let page_rows = count.div_ceil(2 * QUAD_SIDE);
        let ids: Vec<_> = (first..first + page_rows)
            .flat_map(|pj| (0..shelf.paging.columns_rows().0).map(move |pi| PageId { pi, pj }))
            .collect();
        let put = |&id: &PageId| {
            let quads = shelf.paging.size(id);
            let diamonds = diamonds_of_page(size, id, quads, self.rows, rows);
            Ok((id, shelf.put_bounds(id, diamonds, heights.of_bounds(size, id, quads)?, self.element)?))
        };
        let made: Result<Vec<(PageId, Entry)>, WriteError> = ids.par_iter().map(put).collect();
        made?.into_iter().for_each(|(id, entry)| shelf.set(id, entry));
        self.rows += count;
        Ok(())
    }

    fn rows(&self, size: LatticeSize, rows: Range<u32>) -> Result<Cow<'_, [DiamondBounds]>, ReadError> {
        let (columns, side) = (size.columns as usize, 2 * QUAD_SIDE);
        let mut out = vec![DiamondBounds::default(); rows.len() * columns];
        let shelf = &self.shelves[size.k as usize - 1].1;
        let page_rows: Vec<_> = (rows.start / side..rows.end.div_ceil(side)).collect();
        // Each row of pages has rows of its own in `out`.
        let mut rest = &mut out[..];
        let mut parts = Vec::with_capacity(page_rows.len());
        for pj in page_rows {
            let (from, to) = (rows.start.max(pj * side), rows.end.min((pj + 1) * side));
            let (part, left) = rest.split_at_mut((to - from) as usize * columns);
            parts.push((pj, from..to, part));
            rest = left;
        }
        parts.into_par_iter().try_for_each(|(pj, rows, out)| {
            (0..shelf.paging.columns_rows().0).try_for_each(|pi| {
                let id = PageId { pi, pj };
                let page = shelf.bounds(id, self.element)?;
                let quads = shelf.paging.size(id);
                let mut diamonds = page.diamonds().iter();
                for (v, u) in (0..quads.1).flat_map(|v| (0..quads.0).map(move |u| (v, u))) {
                    for (n, bounds) in diamonds.by_ref().take(QUAD_DIAMONDS).enumerate() {
                        let (a, b) = quad_post(pi * QUAD_SIDE + u, pj * QUAD_SIDE + v, n);
                        if a < size.columns && rows.contains(&b) {
                            out[(b - rows.start) as usize * columns + a as usize] = *bounds;
                        }
                    }
                }
                Ok(())
            })
        })?;
        Ok(out.into())
    }
}

/// The diamonds of a page of bounds whose rows are among `rows`, of which the first is row `first` of the lattice.
fn diamonds_of_page(
    size: LatticeSize,
    id: PageId,
    quads: (u32, u32),
    first: u32,
    rows: &[DiamondBounds],
) -> Vec<DiamondBounds> {
    let mut diamonds = Vec::with_capacity((quads.0 * quads.1) as usize * QUAD_DIAMONDS);
    for (v, u) in (0..quads.1).flat_map(|v| (0..quads.0).map(move |u| (v, u))) {
        for n in 0..QUAD_DIAMONDS {
            let (a, b) = quad_post(id.pi * QUAD_SIDE + u, id.pj * QUAD_SIDE + v, n);
            let inside = a < size.columns && b < size.rows;
            let at = (b - first) as usize * size.columns as usize + a as usize;
            diamonds.push(if inside { rows[at] } else { DiamondBounds::default() });
        }
    }
    diamonds
}

/// Pages of each lattice that a reader keeps at hand: 4 by 4.
const SLOTS: usize = 16;

/// A page at hand, and its place.
type Slot = Option<(PageId, Arc<BoundsPage>)>;

/// Reads bounds of complete lattices here and there.
pub(super) struct Reader<'a> {
    lattices: &'a Lattices<'a>,
    /// By lattice from k = 1.
    slots: Vec<[Slot; SLOTS]>,
}

impl TightReader for Reader<'_> {
    fn tight(&mut self, p: Post) -> Result<f32, ReadError> {
        let Some(place) = BoundsPlace::of(p) else { return Ok(0.0) };
        let level = place.level as usize - 1;
        let Some((size, shelf)) = self.lattices.shelves.get(level) else { return Ok(0.0) };
        if place.at.0 >= size.columns || place.at.1 >= size.rows {
            return Ok(0.0);
        }
        let (id, quad, n) = place.in_page();
        let slot = &mut self.slots[level][(id.pi % 4 + id.pj % 4 * 4) as usize];
        match slot {
            Some((at, page)) if *at == id => Ok(page.at(quad, n).tight),
            _ => {
                let page = shelf.bounds(id, self.lattices.element)?;
                let tight = page.at(quad, n).tight;
                *slot = Some((id, page));
                Ok(tight)
            }
        }
    }
}

/// The extremes of all levels of `heights`, whose pages are complete, on shelves by level from 1.
pub(super) fn extremes_of<'a>(scratch: &'a Scratch, heights: &Heights<'_>) -> Result<Vec<Shelf<'a>>, WriteError> {
    let (grid, mut shelves) = (heights.grid, Vec::new());
    let element = if heights.element() == Element::I16 { Element::PairI16 } else { Element::PairI32 };
    let mut below = Vec::new();
    for level in 1..extremes::levels(grid) + 1 {
        let (columns, rows) = extremes::extent(grid, level);
        let paging = Paging::of_heights(columns, rows);
        let mut shelf = Shelf::new(scratch, EXTREMES + level as u8, paging);
        let mut all = Vec::with_capacity(paging.pages() as usize);
        for pj in 0..paging.columns_rows().1 {
            let first = pj * PAGE_SIDE;
            let count = PAGE_SIDE.min(rows - first);
            let values = match level {
                1 => first_level(heights, first, count, columns)?,
                _ => below[first as usize * columns as usize..][..(count * columns) as usize].to_vec(),
            };
            for pi in 0..paging.columns_rows().0 {
                let of_page: Vec<_> = extremes::of_page(&values, columns, PageId { pi, pj: 0 }).copied().collect();
                let encoded = pages::encode_extremes(&of_page, element)
                    .ok_or_else(|| WriteError::Description("heights do not fit their section".into()))?;
                let entry = shelf.put(encoded)?;
                shelf.set(PageId { pi, pj }, entry);
                all.push(of_page.into_iter().fold(Extremes::NOTHING, Extremes::join));
            }
        }
        below = all;
        shelves.push(shelf);
    }
    Ok(shelves)
}

/// Rows `first` to `first + count` of the values of level 1.
fn first_level(heights: &Heights<'_>, first: u32, count: u32, columns: u32) -> Result<Vec<Extremes>, ReadError> {
    let (grid, blocks) = (heights.grid, PAGE_SIDE / BLOCK_SIDE);
    let mut values = vec![Extremes::NOTHING; (count * columns) as usize];
    let strips = values.par_chunks_mut((blocks * columns) as usize).enumerate();
    strips.try_for_each(|(n, strip)| {
        let pj = first / blocks + n as u32;
        (0..grid.pages().0).try_for_each(|pi| {
            let id = PageId { pi, pj };
            let size = grid.page_size(id);
            let across = size.0.div_ceil(BLOCK_SIDE);
            for (n, value) in (0..).zip(Extremes::of_blocks(&*heights.page(id)?, size)) {
                strip[(n / across * columns + pi * blocks + n % across) as usize] = value;
            }
            Ok(())
        })
    })?;
    Ok(values)
}

/// A draft with all its parts.
pub(super) struct Draft<'a> {
    pub(super) heights: Heights<'a>,
    pub(super) lattices: Lattices<'a>,
    pub(super) extremes: Vec<Shelf<'a>>,
}

impl<'a> Draft<'a> {
    /// Completes a draft from its heights, of which not all are void and the void ones are filled.
    pub(super) fn complete(
        scratch: &'a Scratch,
        heights: Heights<'a>,
        scale: SceneScale,
        budget: Budget,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Self, WriteError> {
        let extremes = extremes_of(scratch, &heights)?;
        let lattices = Lattices::of(scratch, &heights, scale, budget.effort, progress)?;
        Ok(Self { heights, lattices, extremes })
    }
}
