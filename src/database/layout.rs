//! Which posts and which bounds a page holds.
//!
//! Height pages are the 64 by 64 posts of `terrain::PAGE_SIDE`, cut at the border of the grid. A bounds page of the
//! lattice of step 2^k holds the diamonds of 16 by 16 *quads*. The quad (a, b) has the lattice posts (2a, 2b) to
//! (2a + 1, 2b + 1); its south-west post lies on a coarser lattice too and is stored there, so three are its own. At
//! k = 1 the pages cover the same posts as the height pages, and each level up four times as many.
//!
//! ```text
//!   north ─ centre        order in the file: east (2a+1, 2b), north (2a, 2b+1), centre (2a+1, 2b+1)
//!     │        │
//!    (own of ─ east
//!    coarser)
//! ```

use sightline_proto::diamond::Post;

use super::{
    curve,
    format::{Element, Section},
};
use crate::terrain::{PAGE_SIDE, PageId};

/// Quads along the side of a bounds page.
pub(super) const QUAD_SIDE: u32 = 16;
/// Diamonds of a quad.
pub(super) const QUAD_DIAMONDS: usize = 3;

/// How a paged section is cut into pages.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Paging {
    /// Cells from west to east and from south to north: posts of the grid, or quads of a lattice.
    cells: (u32, u32),
    /// Cells along the side of a page.
    side: u32,
}

impl Paging {
    /// The pages of a grid of `nx` by `ny` posts, or of a level of as many blocks.
    pub(super) fn of_heights(nx: u32, ny: u32) -> Self {
        Self { cells: (nx, ny), side: PAGE_SIDE }
    }

    /// The pages of a lattice of `columns` by `rows` posts.
    pub(super) fn of_lattice(columns: u32, rows: u32) -> Self {
        Self { cells: (columns.div_ceil(2), rows.div_ceil(2)), side: QUAD_SIDE }
    }

    /// The pages of a section, or `None` when it has none.
    pub(super) fn of_section(section: &Section) -> Option<Self> {
        match section.element {
            Element::I16 | Element::I32 | Element::PairI16 | Element::PairI32 => {
                Some(Self::of_heights(section.columns, section.rows))
            }
            element if element.is_of_bounds() => Some(Self::of_lattice(section.columns, section.rows)),
            _ => None,
        }
    }

    /// Cells from west to east and from south to north.
    pub(super) fn cells(&self) -> (u32, u32) {
        self.cells
    }

    /// Pages from west to east and from south to north.
    pub(super) fn columns_rows(&self) -> (u32, u32) {
        (self.cells.0.div_ceil(self.side), self.cells.1.div_ceil(self.side))
    }

    /// Number of pages.
    pub(super) fn pages(&self) -> u64 {
        let (columns, rows) = self.columns_rows();
        u64::from(columns) * u64::from(rows)
    }

    /// The number of the page at `id` in the order of the file.
    pub(super) fn number(&self, id: PageId) -> u64 {
        let (columns, rows) = self.columns_rows();
        curve::rank(columns, rows, id.pi, id.pj)
    }

    /// The page with number `n`.
    pub(super) fn id(&self, n: u64) -> PageId {
        let (columns, rows) = self.columns_rows();
        let (pi, pj) = curve::place(columns, rows, n);
        PageId { pi, pj }
    }

    /// Cells of the page at `id` from west to east and from south to north: fewer on the border.
    pub(super) fn size(&self, id: PageId) -> (u32, u32) {
        let cut = |cells: u32, page: u32| (cells - page * self.side).min(self.side);
        (cut(self.cells.0, id.pi), cut(self.cells.1, id.pj))
    }
}

/// Where the bounds of a diamond are stored.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct BoundsPlace {
    /// The exponent of the lattice's step: at least 1.
    pub(super) level: u32,
    /// Column and row of the post on that lattice.
    pub(super) at: (u32, u32),
}

impl BoundsPlace {
    /// The place of the diamond at `p`; `None` when `p` has an odd coordinate or is the origin.
    pub(super) fn of(p: Post) -> Option<Self> {
        let level = (p.i | p.j).trailing_zeros();
        (1..32).contains(&level).then(|| Self { level, at: (p.i >> level, p.j >> level) })
    }

    /// The page that holds it, its quad within the page and its number within the quad.
    pub(super) fn in_page(self) -> (PageId, (u32, u32), usize) {
        let (a, b) = self.at;
        let (u, v) = (a / 2, b / 2);
        let id = PageId { pi: u / QUAD_SIDE, pj: v / QUAD_SIDE };
        (id, (u % QUAD_SIDE, v % QUAD_SIDE), (a % 2 + 2 * (b % 2)) as usize - 1)
    }
}

/// The lattice post that is number `n` of the quad (u, v).
pub(super) fn quad_post(u: u32, v: u32, n: usize) -> (u32, u32) {
    let n = n as u32 + 1;
    (2 * u + n % 2, 2 * v + n / 2)
}

/// The step exponents whose lattices are stored for a root square of 2^m cells: the posts of the lattice of step 2^m
/// are the corners, which are no diamonds.
pub(super) fn stored_levels(root_exponent: u8) -> std::ops::Range<u8> {
    1..root_exponent.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_even_post_is_stored_once_and_found_again() {
        for (i, j) in (0..80).flat_map(|j| (0..80).map(move |i| (2 * i, 2 * j))).skip(1) {
            let place = BoundsPlace::of(Post::new(i, j)).unwrap();
            assert!(place.at.0 % 2 + place.at.1 % 2 > 0, "({i}, {j}) is on a coarser lattice");
            let (id, (u, v), n) = place.in_page();
            let (a, b) = quad_post(id.pi * QUAD_SIDE + u, id.pj * QUAD_SIDE + v, n);
            assert_eq!((a << place.level, b << place.level), (i, j));
        }
        assert_eq!(BoundsPlace::of(Post::new(3, 4)), None);
        assert_eq!(BoundsPlace::of(Post::new(0, 0)), None);
    }

    #[test]
    fn pages_are_cut_at_the_border() {
        let paging = Paging::of_heights(130, 64);
        assert_eq!((paging.columns_rows(), paging.pages()), ((3, 1), 3));
        assert_eq!(paging.size(PageId { pi: 2, pj: 0 }), (2, 64));
        let paging = Paging::of_lattice(33, 1);
        assert_eq!((paging.columns_rows(), paging.size(PageId { pi: 1, pj: 0 })), ((2, 1), (1, 1)));
        assert_eq!(Paging::of_lattice(0, 5).pages(), 0);
    }
}
