//! The crown: what every view needs before all else lies side by side in the file, and is read at once.
//!
//! The coarsest lattices of bounds have one page or a few, and a directory each; they are the last sections of bounds, and the
//! heights of the root square's corners stand behind them. One read of all of them takes the place of a dozen, or of two
//! dozen where pages of heights had to be read for the corners. It is a way to read and no part of the format: each page and
//! block in it is checked as any other, so damage within it is an error for who needs what is damaged, and for nobody else.

use std::{ops::Range, sync::OnceLock};

use xxhash_rust::xxh3::xxh3_64;

use super::{
    format::{Section, u64_at},
    source::PageSource,
};

/// Greatest length of the crown in bytes: the lattices of up to 65 posts a side have 50 kB, the one below would have 150.
const MOST_BYTES: u64 = 1 << 16;

/// Bytes of a section of corners: four heights and a checksum.
pub(super) const CORNERS_BYTES: usize = CORNERS_CHECKSUM_AT + 8;
const CORNERS_CHECKSUM_AT: usize = 4 * 4;

/// The section of the corners' heights, in the order of `RootSquare::corners`.
pub(super) fn encode_corners(heights: [i32; 4]) -> [u8; CORNERS_BYTES] {
    let mut out = [0; CORNERS_BYTES];
    let (values, checksum) = out.split_at_mut(CORNERS_CHECKSUM_AT);
    for (value, height) in values.as_chunks_mut::<4>().0.iter_mut().zip(heights) {
        *value = height.to_le_bytes();
    }
    checksum.copy_from_slice(&xxh3_64(values).to_le_bytes());
    out
}

/// The heights in a section of corners; `None` when its checksum does not fit.
pub(super) fn decode_corners(bytes: &[u8]) -> Option<[i32; 4]> {
    let bytes: &[u8; CORNERS_BYTES] = bytes.try_into().ok()?;
    let (values, _) = bytes.split_at(CORNERS_CHECKSUM_AT);
    (u64_at(bytes, CORNERS_CHECKSUM_AT) == xxh3_64(values))
        .then(|| std::array::from_fn(|n| i32::from_le_bytes(std::array::from_fn(|b| values[4 * n + b]))))
}

/// Where the crown is, and what was read of it.
pub(super) struct Crown {
    span: Range<u64>,
    held: OnceLock<Box<[u8]>>,
}

impl Crown {
    /// Of a file with these sections: as many of the coarsest `lattices` as fit, and the corners where they follow.
    pub(super) fn of(sections: &[Section], lattices: &[usize], corners: Option<usize>) -> Self {
        let end_of = |n: usize| sections[n].offset + sections[n].length;
        let last = corners.or(lattices.last().copied());
        let mut span = last.map_or(0..0, |n| end_of(n)..end_of(n));
        for &n in corners.iter().chain(lattices.iter().rev()) {
            if end_of(n) != span.start || span.end - sections[n].offset > MOST_BYTES {
                break;
            }
            span.start = sections[n].offset;
        }
        Self { span, held: OnceLock::new() }
    }

    /// Bytes of it.
    pub(super) fn bytes(&self) -> u64 {
        self.span.end - self.span.start
    }

    /// `length` bytes from `offset` on, if they are in it: from memory where it was read before, else `was_read` is told.
    /// `None` as well when it cannot be read, which says nothing of those bytes.
    pub(super) fn get(
        &self,
        source: &dyn PageSource,
        offset: u64,
        length: usize,
        was_read: impl FnOnce(),
    ) -> Option<&[u8]> {
        let end = offset.checked_add(length as u64)?;
        if offset < self.span.start || end > self.span.end {
            return None;
        }
        let held = match self.held.get() {
            Some(held) => held,
            None => {
                // At most `MOST_BYTES`, whatever the file says of its sections.
                let mut bytes = vec![0; self.bytes() as usize];
                source.read_exact_at(&mut bytes, self.span.start).ok()?;
                was_read();
                // Another thread may have read it meanwhile.
                self.held.get_or_init(|| bytes.into())
            }
        };
        held.get((offset - self.span.start) as usize..(end - self.span.start) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::database::{
        damage_tests::Bytes,
        format::{Element, Kind},
    };

    /// Sections of these lengths, end to end from byte 100 on.
    fn sections(lengths: &[u64]) -> Vec<Section> {
        let ends = lengths.iter().scan(100, |end, length| {
            *end += length;
            Some(*end)
        });
        let of = |(end, &length): (u64, &u64)| Section {
            kind: Kind::Bounds,
            flags: 0,
            element: Element::BoundsI16,
            level: 0,
            columns: 0,
            rows: 0,
            pages: 0,
            offset: end - length,
            length,
        };
        ends.zip(lengths).map(of).collect()
    }

    #[test]
    fn it_is_what_fits_at_the_end_of_the_bounds() {
        let most = MOST_BYTES;
        let span = |lengths: &[u64], lattices: &[usize], corners| {
            let Range { start, end } = Crown::of(&sections(lengths), lattices, corners).span;
            (start, end)
        };
        assert_eq!(span(&[7, most, 5, 3, 9], &[0, 1, 2], Some(3)), (107 + most, 115 + most));
        assert_eq!(span(&[7, most - 8, 5, 3, 9], &[0, 1, 2], Some(3)), (107, 107 + most));
        // Without corners, with corners alone, with something between two lattices or before the corners.
        assert_eq!(span(&[7, 8, 9], &[0, 1], None), (100, 115));
        assert_eq!(span(&[7, 8, 9], &[], Some(1)), (107, 115));
        assert_eq!(span(&[7, 8, 9, 10], &[0, 2], Some(3)), (115, 134));
        assert_eq!(span(&[7, 8, 9, 10], &[0, 1], Some(3)), (124, 134));
        // One that is too long; none at all.
        assert_eq!(span(&[7, most + 1], &[0, 1], None), (108 + most, 108 + most));
        assert_eq!(span(&[7], &[], None), (0, 0));
    }

    #[test]
    fn it_is_read_once_and_not_where_the_file_ends_before_it_does() {
        let content: Vec<u8> = (0..200).collect();
        let (file, cut) = (Bytes::boxed(&content), Bytes::boxed(&content[..110]));
        let crown = Crown::of(&sections(&[5, 20, 10]), &[0, 1], Some(2));
        let mut reads = 0;
        assert_eq!(crown.get(&*cut, 101, 2, || reads += 1), None);
        for (offset, length) in [(99, 1), (99, 10), (134, 2), (135, 0), (140, 1), (u64::MAX, 1), (0, usize::MAX)] {
            let expected = (offset == 135).then_some(&[][..]);
            assert_eq!(crown.get(&*file, offset, length, || reads += 1), expected, "{offset} {length}");
        }
        for (offset, length) in [(100, 35), (104, 3), (134, 1)] {
            let expected = &content[offset..offset + length];
            assert_eq!(crown.get(&*file, offset as u64, length, || reads += 1), Some(expected));
        }
        assert_eq!((reads, crown.bytes()), (1, 35));
    }

    #[test]
    fn corners_round_trip_and_every_flipped_bit_is_refused() {
        let heights = [i32::MIN, -1, 300, i32::MAX];
        let bytes = encode_corners(heights);
        assert_eq!(decode_corners(&bytes), Some(heights));
        for bit in 0..8 * bytes.len() {
            let mut bad = bytes;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(decode_corners(&bad), None, "bit {bit}");
        }
        assert_eq!(decode_corners(&bytes[1..]), None);
    }
}
