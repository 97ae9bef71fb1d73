//! The directory of a paged section: for each page, in the order of the pages, where it is and its checksum.
//!
//! Blocks of 128 entries, each block with a checksum of its own that is seeded with its number, so that a block out of
//! place is damage too. A reader loads the one block that it needs; the Z curve makes it serve a whole neighbourhood.

use xxhash_rust::xxh3::xxh3_64_with_seed;

use super::format::{u32_at, u64_at};

/// Entries of a block; the last block of a section may have fewer.
pub(super) const BLOCK_ENTRIES: u64 = 128;
/// Bytes of an entry.
pub(super) const ENTRY_BYTES: u64 = 24;
const CHECKSUM_BYTES: u64 = 8;

/// The bit of a page's flags that says that a bitmap of voids follows the heights.
pub(super) const HAS_VOIDS: u32 = 1;
/// The bit of a page's flags that says that all its cells are equal, and one stands for them.
pub(super) const IS_CONSTANT: u32 = 2;

/// Where a page is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Entry {
    /// First byte in the file.
    pub(super) offset: u64,
    /// xxh3 64 of its bytes.
    pub(super) checksum: u64,
    /// Bytes.
    pub(super) length: u32,
    pub(super) flags: u32,
}

/// Number of blocks of a section of `pages` pages.
pub(super) fn blocks(pages: u64) -> u64 {
    pages.div_ceil(BLOCK_ENTRIES)
}

/// Bytes of a directory of `pages` entries; `None` when no file is that long.
pub(super) fn bytes(pages: u64) -> Option<u64> {
    pages.checked_mul(ENTRY_BYTES)?.checked_add(blocks(pages) * CHECKSUM_BYTES)
}

/// Where block `n` of a directory of `pages` entries starts, from the start of the directory, and its length.
pub(super) fn block_span(pages: u64, n: u64) -> (u64, usize) {
    let entries = (pages - n * BLOCK_ENTRIES).min(BLOCK_ENTRIES);
    (n * (BLOCK_ENTRIES * ENTRY_BYTES + CHECKSUM_BYTES), (entries * ENTRY_BYTES + CHECKSUM_BYTES) as usize)
}

/// The bytes of block `n`, which has these entries.
pub(super) fn encode_block(n: u64, entries: &[Entry]) -> Vec<u8> {
    let mut out = Vec::with_capacity(entries.len() * ENTRY_BYTES as usize + CHECKSUM_BYTES as usize);
    for entry in entries {
        out.extend_from_slice(&entry.offset.to_le_bytes());
        out.extend_from_slice(&entry.checksum.to_le_bytes());
        out.extend_from_slice(&entry.length.to_le_bytes());
        out.extend_from_slice(&entry.flags.to_le_bytes());
    }
    let checksum = xxh3_64_with_seed(&out, n);
    out.extend_from_slice(&checksum.to_le_bytes());
    out
}

/// The entries of block `n`; `None` when its checksum does not fit.
pub(super) fn decode_block(n: u64, bytes: &[u8]) -> Option<Box<[Entry]>> {
    let (inside, checksum) = bytes.split_last_chunk::<{ CHECKSUM_BYTES as usize }>()?;
    if u64::from_le_bytes(*checksum) != xxh3_64_with_seed(inside, n) {
        return None;
    }
    let entry =
        |b: &[u8]| Entry { offset: u64_at(b, 0), checksum: u64_at(b, 8), length: u32_at(b, 16), flags: u32_at(b, 20) };
    Some(inside.chunks_exact(ENTRY_BYTES as usize).map(entry).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_where_they_are_said_to_be() {
        for pages in [0, 1, 127, 128, 129, 300] {
            let entries: Vec<_> =
                (0..pages).map(|n| Entry { offset: n * 10, checksum: !n, length: n as u32, flags: 1 }).collect();
            let blocks_of = entries.chunks(BLOCK_ENTRIES as usize);
            let all: Vec<u8> = (0..).zip(blocks_of).flat_map(|(n, block)| encode_block(n, block)).collect();
            assert_eq!(bytes(pages), Some(all.len() as u64));
            let mut back = Vec::new();
            for n in 0..blocks(pages) {
                let (at, length) = block_span(pages, n);
                let block = &all[at as usize..][..length];
                back.extend(decode_block(n, block).unwrap());
                assert_eq!(decode_block(n + 1, block), None, "a block out of place");
            }
            assert_eq!(back, entries);
        }
        assert_eq!(bytes(u64::MAX), None);
    }
}
