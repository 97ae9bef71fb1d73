//! The order of pages in a section: the Z curve (Morton, "A computer oriented geodetic data base", 1966) over a
//! rectangle of any size, without gaps.
//!
//! A square whose side is the next power of two is descended, south-west, south-east, north-west, north-east; what of
//! a quadrant lies beyond the rectangle counts nothing. So the pages of an aligned block of 2^n by 2^n are neighbours
//! in the file, at every scale, and the number of a page follows from its place by arithmetic.

/// The number of the page in column `c` and row `r` of `columns` by `rows` pages.
pub(super) fn rank(columns: u32, rows: u32, c: u32, r: u32) -> u64 {
    debug_assert!(c < columns && r < rows);
    let (mut w, mut h, mut c, mut r) = (u64::from(columns), u64::from(rows), u64::from(c), u64::from(r));
    let (mut half, mut before) = (half_side(w, h), 0);
    while half > 0 {
        let (west, south) = (w.min(half), h.min(half));
        let (east, north) = (c >= half, r >= half);
        let band = if north { h - south } else { south };
        before += if north { w * south } else { 0 } + if east { west * band } else { 0 };
        (c, w) = if east { (c - half, w - west) } else { (c, west) };
        (r, h) = if north { (r - half, band) } else { (r, band) };
        half /= 2;
    }
    before
}

/// The column and row of page number `n`: the inverse of [`rank`].
pub(super) fn place(columns: u32, rows: u32, n: u64) -> (u32, u32) {
    debug_assert!(n < u64::from(columns) * u64::from(rows));
    let (mut w, mut h, mut left) = (u64::from(columns), u64::from(rows), n);
    let (mut c, mut r, mut half) = (0, 0, half_side(w, h));
    while half > 0 {
        let (west, south) = (w.min(half), h.min(half));
        let north = left >= w * south;
        let band = if north { h - south } else { south };
        left -= if north { w * south } else { 0 };
        let east = left >= west * band;
        left -= if east { west * band } else { 0 };
        (c, w) = if east { (c + half, w - west) } else { (c, west) };
        (r, h) = if north { (r + half, band) } else { (r, band) };
        half /= 2;
    }
    (c as u32, r as u32)
}

fn half_side(w: u64, h: u64) -> u64 {
    w.max(h).next_power_of_two() / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rank_numbers_every_page_once_and_place_inverts_it() {
        for (columns, rows) in [(1, 1), (2, 1), (1, 7), (3, 5), (8, 8), (13, 6), (76, 76), (17, 33)] {
            let total = u64::from(columns) * u64::from(rows);
            for n in 0..total {
                let (c, r) = place(columns, rows, n);
                assert!(c < columns && r < rows, "{columns} x {rows}: {n} at ({c}, {r})");
                assert_eq!(rank(columns, rows, c, r), n, "{columns} x {rows}");
            }
        }
    }

    #[test]
    fn aligned_blocks_are_neighbours() {
        let (columns, rows) = (13, 11);
        let numbers: Vec<_> = (4..8).flat_map(|r| (8..12).map(move |c| rank(columns, rows, c, r))).collect();
        let (least, greatest) = (numbers.iter().min().unwrap(), numbers.iter().max().unwrap());
        assert_eq!(greatest - least, 15);
        assert_eq!([rank(4, 4, 0, 0), rank(4, 4, 1, 0), rank(4, 4, 0, 1), rank(4, 4, 1, 1)], [0, 1, 2, 3]);
    }

    #[test]
    fn the_largest_grid_does_not_overflow() {
        let side = (1 << 24) + 1;
        let last = rank(side, side, side - 1, side - 1);
        assert_eq!(last, u64::from(side) * u64::from(side) - 1);
        assert_eq!(place(side, side, last), (side - 1, side - 1));
    }
}
