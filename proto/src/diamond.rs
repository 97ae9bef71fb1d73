//! The longest-edge bisection hierarchy of a square of 2^m by 2^m cells, by arithmetic alone.
//!
//! Every post except the four corners is the centre of exactly one *diamond*: the two bintree triangles (one on the
//! border) whose bases have their midpoint there. So a post names its diamond, and parents, children and levels follow
//! from the bits of its coordinates: no pointers, no neighbour tables. The same topology as in Duchaineau et al.,
//! "Good terrain geometry, cheap!", section 4, whose triangles are found there through neighbour links.
//!
//! ```text
//!   (0,s)─────────(s,s)      b = lowest set bit of i | j.
//!     │ ╲    2    ╱ │        Both i/b and j/b odd: a *square* diamond; base and apexes are the
//!     │   ╲     ╱   │        corners (i ± b, j ± b).
//!     │ 3   (c)   1 │        Only one odd: a *tilted* diamond; its corners are (i ± b, j) and
//!     │   ╱     ╲   │        (i, j ± b); the base lies along the odd axis.
//!     │ ╱    0    ╲ │
//!   (0,0)─────────(s,0)
//! ```

use std::cmp::Ordering;

/// Greatest supported exponent of a root square: posts of 2^30 + 1 a side.
pub const MAX_ROOT_EXPONENT: u8 = 30;

/// A post of the grid: column `i` eastward, row `j` northward; (0, 0) is the south-west corner.
///
/// Ordered by row, then column.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Post {
    /// Column, eastward.
    pub i: u32,
    /// Row, northward.
    pub j: u32,
}

impl Post {
    /// The post in column `i` and row `j`.
    pub const fn new(i: u32, j: u32) -> Self {
        Self { i, j }
    }

    /// The post as one number, ordered like the post itself.
    pub const fn key(self) -> u64 {
        (self.j as u64) << 32 | self.i as u64
    }

    /// The inverse of [`Post::key`].
    pub const fn from_key(key: u64) -> Self {
        Self { i: key as u32, j: (key >> 32) as u32 }
    }

    /// The post `di` east and `dj` north of this one; `None` outside the square of `side` cells from (0, 0).
    #[inline]
    pub fn offset(self, di: i64, dj: i64, side: u32) -> Option<Self> {
        let at = |v: u32, d: i64| u32::try_from(i64::from(v) + d).ok().filter(|&v| v <= side);
        Some(Self { i: at(self.i, di)?, j: at(self.j, dj)? })
    }

    #[inline]
    fn midpoint(self, other: Self) -> Option<Self> {
        let (i, j) = (self.i + other.i, self.j + other.j);
        (i % 2 == 0 && j % 2 == 0).then_some(Self { i: i / 2, j: j / 2 })
    }
}

impl Ord for Post {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key().cmp(&other.key())
    }
}

impl PartialOrd for Post {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// A bintree triangle: a right isosceles triangle in plan. Split at the midpoint of its base `e0 e1`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Triangle {
    /// The post at the right angle.
    pub apex: Post,
    /// First end of the base.
    pub e0: Post,
    /// Second end of the base.
    pub e1: Post,
}

impl Triangle {
    /// The post at which the triangle is split; `None` when it is a triangle of the finest surface.
    #[inline]
    pub fn base_midpoint(&self) -> Option<Post> {
        self.e0.midpoint(self.e1)
    }

    /// The two children across the base midpoint `m`, in the order in which a mesh visits them.
    #[inline]
    pub fn children(&self, m: Post) -> [Self; 2] {
        [Self { apex: m, e0: self.apex, e1: self.e0 }, Self { apex: m, e0: self.e1, e1: self.apex }]
    }

    /// The same triangle with its base reversed if (apex, e0, e1) turned counter-clockwise.
    #[inline]
    fn clockwise(self) -> Self {
        let [a, e0, e1] = [self.apex, self.e0, self.e1].map(|p| (i64::from(p.i), i64::from(p.j)));
        let turn = (e0.0 - a.0) * (e1.1 - a.1) - (e0.1 - a.1) * (e1.0 - a.0);
        if turn > 0 { Self { apex: self.apex, e0: self.e1, e1: self.e0 } } else { self }
    }

    /// The corners in counter-clockwise order, seen from above: apex, e1, e0.
    ///
    /// (apex, e0, e1) turns clockwise in both roots, and the order of children keeps the turn.
    pub fn corners(&self) -> [Post; 3] {
        [self.apex, self.e1, self.e0]
    }
}

/// The root square: 2^m by 2^m cells with its south-west corner at post (0, 0).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct RootSquare {
    exponent: u8,
}

impl RootSquare {
    /// The square of 2^`exponent` cells a side; `None` above [`MAX_ROOT_EXPONENT`].
    pub fn new(exponent: u8) -> Option<Self> {
        (exponent <= MAX_ROOT_EXPONENT).then_some(Self { exponent })
    }

    /// The smallest square that covers a grid of `nx` by `ny` posts; `None` for fewer than 2 posts or too many.
    pub fn covering(nx: u32, ny: u32) -> Option<Self> {
        let cells = nx.max(ny).checked_sub(1)?;
        if nx < 2 || ny < 2 || cells > 1 << MAX_ROOT_EXPONENT {
            return None;
        }
        Self::new(u8::try_from(cells.next_power_of_two().trailing_zeros()).ok()?)
    }

    /// The exponent m.
    pub fn exponent(self) -> u8 {
        self.exponent
    }

    /// Cells a side, 2^m. Posts run from 0 to this number inclusive.
    pub fn side(self) -> u32 {
        1 << self.exponent
    }

    /// How many levels of diamonds there are: 2m, numbered from 0 (coarsest).
    pub fn levels(self) -> u8 {
        2 * self.exponent
    }

    /// The corners, in the order south-west, south-east, north-west, north-east.
    pub fn corners(self) -> [Post; 4] {
        let s = self.side();
        [Post::new(0, 0), Post::new(s, 0), Post::new(0, s), Post::new(s, s)]
    }

    /// Whether `p` is a post of the square.
    #[inline]
    pub fn contains(self, p: Post) -> bool {
        p.i <= self.side() && p.j <= self.side()
    }

    /// Whether `p` is one of the four corners, which belong to every mesh and are no diamond's centre.
    #[inline]
    pub fn is_corner(self, p: Post) -> bool {
        (p.i == 0 || p.i == self.side()) && (p.j == 0 || p.j == self.side())
    }

    /// The two root triangles, south-east then north-west.
    pub fn roots(self) -> [Triangle; 2] {
        let [south_west, south_east, north_west, north_east] = self.corners();
        [
            Triangle { apex: south_east, e0: south_west, e1: north_east },
            Triangle { apex: north_west, e0: north_east, e1: south_west },
        ]
    }

    /// The level of the diamond at `p`: 0 for the centre of the square, up to 2m - 1; `None` for a corner.
    #[inline]
    pub fn level(self, p: Post) -> Option<u8> {
        if self.is_corner(p) {
            return None;
        }
        let (b, kind) = Kind::of(p);
        let square = 2 * (self.exponent - 1 - b.trailing_zeros() as u8);
        Some(match kind {
            Kind::Square => square,
            Kind::TiltedEast | Kind::TiltedNorth => square + 1,
        })
    }

    /// The posts that must be active before `p` may be: the apexes of its diamond's triangles. Two, or one where the
    /// diamond is cut by the border of the square; none for a corner.
    #[inline]
    pub fn parents(self, p: Post) -> impl Iterator<Item = Post> {
        let offsets = if self.is_corner(p) { [(0, 0); 2] } else { Self::apex_offsets(p) };
        let side = self.side();
        offsets.into_iter().filter(|&o| o != (0, 0)).filter_map(move |(di, dj)| p.offset(di, dj, side))
    }

    /// The posts whose diamonds have `p` as a parent: up to four; none at the finest level and for corners.
    ///
    /// (A corner is the apex of a root triangle and so the parent of the centre; that is not listed here because
    /// corners are always active.)
    #[inline]
    pub fn children(self, p: Post) -> impl Iterator<Item = Post> {
        let offsets = match (self.is_corner(p), Kind::of(p)) {
            (true, _) => [(0, 0); 4],
            (false, (b, Kind::Square)) => {
                let b = i64::from(b);
                [(0, -b), (-b, 0), (b, 0), (0, b)]
            }
            (false, (b, _)) => {
                let h = i64::from(b / 2);
                [(-h, -h), (h, -h), (-h, h), (h, h)]
            }
        };
        let side = self.side();
        offsets.into_iter().filter(|&o| o != (0, 0)).filter_map(move |(di, dj)| p.offset(di, dj, side))
    }

    /// The triangles of the diamond at `p`, which has its base midpoint there: two, or one on the border of the
    /// square; none for a corner. Each is oriented as descending from the roots would orient it.
    #[inline]
    pub fn triangles(self, p: Post) -> impl Iterator<Item = Triangle> {
        let side = self.side();
        self.parents(p)
            .filter_map(move |apex| {
                // The base runs across the line from apex to p: turn p - apex by a quarter to either side.
                let (di, dj) = (i64::from(p.i) - i64::from(apex.i), i64::from(p.j) - i64::from(apex.j));
                Some(Triangle { apex, e0: p.offset(dj, -di, side)?, e1: p.offset(-dj, di, side)? })
            })
            .map(Triangle::clockwise)
    }

    /// The ends of the base of the diamond at `p`, which is their midpoint; `None` for a corner and outside the square.
    pub fn base_ends(self, p: Post) -> Option<[Post; 2]> {
        self.triangles(p).next().map(|t| [t.e0, t.e1])
    }

    /// The post that the diamond at `p` hangs on: the finer end of its base, two levels up. `None` for the first two
    /// levels, whose bases end in corners of the square.
    pub fn hangs_on(self, p: Post) -> Option<Post> {
        let [e0, e1] = self.base_ends(p)?;
        [e0, e1].into_iter().filter(|&e| self.level(e).is_some()).max_by_key(|&e| self.level(e))
    }

    #[inline]
    fn apex_offsets(p: Post) -> [(i64, i64); 2] {
        let (b, kind) = Kind::of(p);
        let d = i64::from(b);
        match kind {
            Kind::TiltedEast => [(0, -d), (0, d)],
            Kind::TiltedNorth => [(-d, 0), (d, 0)],
            // The apexes are the corners whose coordinates, in steps of 2b, have an odd sum.
            Kind::Square if (i64::from(p.i) - d + i64::from(p.j) - d) & (2 * d) != 0 => [(-d, -d), (d, d)],
            Kind::Square => [(d, -d), (-d, d)],
        }
    }
}

/// The three shapes of a diamond; see the drawing at the top.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    Square,
    /// The base runs east.
    TiltedEast,
    /// The base runs north.
    TiltedNorth,
}

impl Kind {
    /// The kind of `p`'s diamond and the half-length b. Not for post (0, 0).
    #[inline]
    fn of(p: Post) -> (u32, Self) {
        let b = 1 << (p.i | p.j).trailing_zeros().min(31);
        let kind = match (p.i & b != 0, p.j & b != 0) {
            (true, true) => Self::Square,
            (true, false) => Self::TiltedEast,
            (false, _) => Self::TiltedNorth,
        };
        (b, kind)
    }
}

/// Whether the surface of a grid is bent across the diagonal from south-west to north-east in the cell whose
/// south-west post is `p`: the diagonal joins the two posts whose coordinates have an even sum.
pub const fn diagonal_rises(p: Post) -> bool {
    (p.i ^ p.j) & 1 == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Every diamond of a small square, found by descending from the roots.
    fn by_descent(root: RootSquare) -> BTreeMap<Post, (u8, Vec<Triangle>)> {
        fn descend(t: Triangle, level: u8, out: &mut BTreeMap<Post, (u8, Vec<Triangle>)>) {
            let Some(m) = t.base_midpoint() else { return };
            let entry = out.entry(m).or_insert((level, Vec::new()));
            assert_eq!(entry.0, level);
            entry.1.push(t);
            for child in t.children(m) {
                descend(child, level + 1, out);
            }
        }
        let mut out = BTreeMap::new();
        for t in root.roots() {
            descend(t, 0, &mut out);
        }
        out
    }

    #[test]
    fn arithmetic_agrees_with_descent() {
        for m in 0..6 {
            let root = RootSquare::new(m).unwrap();
            let found = by_descent(root);
            let s = root.side() as usize + 1;
            assert_eq!(found.len(), s * s - 4);
            for (&p, (level, triangles)) in &found {
                assert_eq!(root.level(p), Some(*level), "{p:?}");
                let mut expected: Vec<_> = triangles.iter().map(|t| t.apex).collect();
                let mut parents: Vec<_> = root.parents(p).collect();
                expected.sort();
                parents.sort();
                assert_eq!(parents, expected, "{p:?}");
                let mut arithmetic: Vec<_> = root.triangles(p).collect();
                let mut descended = triangles.clone();
                arithmetic.sort_by_key(|t| t.apex);
                descended.sort_by_key(|t| t.apex);
                assert_eq!(arithmetic, descended, "{p:?}");
                for child in root.children(p) {
                    assert!(root.parents(child).any(|q| q == p), "{p:?} {child:?}");
                }
                for parent in root.parents(p).filter(|&q| !root.is_corner(q)) {
                    assert!(root.children(parent).any(|q| q == p), "{p:?} {parent:?}");
                }
            }
        }
    }

    #[test]
    fn corners_turn_counter_clockwise() {
        let root = RootSquare::new(4).unwrap();
        for triangles in by_descent(root).values().map(|v| &v.1) {
            for t in triangles {
                let [p, q, r] = t.corners().map(|p| (i64::from(p.i), i64::from(p.j)));
                assert!((q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0) > 0);
            }
        }
    }

    #[test]
    fn the_square_covers_the_grid_and_is_least() {
        for (nx, ny, m) in [(2, 2, 0), (3, 2, 1), (41, 23, 6), (65, 65, 6), (66, 2, 7), (4801, 4801, 13)] {
            assert_eq!(RootSquare::covering(nx, ny).map(RootSquare::exponent), Some(m));
        }
        assert_eq!(RootSquare::covering(1, 5), None);
        assert_eq!(RootSquare::covering(0, 5), None);
        assert_eq!(RootSquare::covering(u32::MAX, 5), None);
    }
}
