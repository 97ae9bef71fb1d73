//! Files whose checksums fit, and which nobody wrote: mutations of sound ones, with every checksum put right again. What
//! opens them must refuse them or read something, whatever they say; a checksum does not protect from who can compute it.
//!
//! A run is a second's worth, the same each time. `SIGHTLINE_FUZZ_FILES` makes so many files, from `SIGHTLINE_FUZZ_SEED`.

use sightline_proto::diamond::Post;
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

use super::{
    Database, OpenOptions,
    damage_tests::{Bytes, NO_CACHE, written},
    directory::{self, BLOCK_ENTRIES, ENTRY_BYTES},
    envelope,
    format::{self, Kind, Section, u32_at, u64_at},
    layout::Paging,
    tests::terrain,
    verify::verify_source,
};
use crate::{
    terrain::{HeightField, PageId, extremes, synthetic::mix},
    wedgie::ErrorBounds,
};

/// Files of a run that nobody asks to be long.
const SHORT_RUN: u64 = 600;
/// Pages of a file that are read: one may state many.
const PAGES: u32 = 8;

/// Random numbers from a seed.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(1);
        mix(self.0)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.roll() % end.max(1) as u64) as usize
    }
}

/// Changes some bytes of one part: the header, the table, or a section's directory or content.
fn mutate(dice: &mut Dice, bytes: &mut [u8], sections: &[Section]) {
    let part = match dice.below(sections.len() + 2) {
        0 => 0..format::HEADER_BYTES,
        1 => format::HEADER_BYTES..format::front_bytes(sections.len()) as usize,
        n => {
            let s = &sections[n - 2];
            let directory = directory::bytes(s.pages).unwrap_or_default() * u64::from(s.pages > 0);
            let [start, middle, end] = [0, directory, s.length].map(|at| (s.offset + at) as usize);
            if dice.below(2) == 0 && middle > start { start..middle } else { middle..end }
        }
    };
    for _ in 0..1 + dice.below(3) {
        let at = part.start + dice.below(part.len());
        match dice.below(4) {
            0 => bytes[at] ^= 1 << dice.below(8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][dice.below(5)],
            2 => bytes[at] = dice.roll() as u8,
            // A whole number at once.
            _ => {
                let value = [0, 1, 2, u64::MAX, 1 << 31, dice.roll()][dice.below(6)].to_le_bytes();
                let end = (at + 8).min(part.end);
                bytes[at..end].copy_from_slice(&value[..end - at]);
            }
        }
    }
}

/// Puts all checksums right, where `sections` says that they are.
fn repair(bytes: &mut [u8], sections: &[Section]) {
    let manifest = sections[0].offset as usize..(sections[0].offset + sections[0].length) as usize;
    let value = &bytes[manifest.start + envelope::HEADER_BYTES..manifest.end];
    let sum = xxh3_64_with_seed(value, u64::from(u32_at(&bytes[manifest.clone()], 8)));
    bytes[manifest.start + 24..][..8].copy_from_slice(&sum.to_le_bytes());
    for s in sections.iter().filter(|s| s.pages > 0) {
        for block in 0..directory::blocks(s.pages) {
            let (at, length) = directory::block_span(s.pages, block);
            let start = (s.offset + at) as usize;
            let entries = (length - 8) / ENTRY_BYTES as usize;
            for entry in (0..entries).map(|n| start + n * ENTRY_BYTES as usize) {
                let (offset, length) = (u64_at(bytes, entry) as usize, u32_at(bytes, entry + 16) as usize);
                let page = offset.checked_add(length).and_then(|end| bytes.get(offset..end));
                let sum = page.map_or(0, xxh3_64);
                bytes[entry + 8..][..8].copy_from_slice(&sum.to_le_bytes());
            }
            let sum = xxh3_64_with_seed(&bytes[start..start + length - 8], block);
            bytes[start + length - 8..][..8].copy_from_slice(&sum.to_le_bytes());
        }
    }
    for at in sections.iter().filter(|s| s.kind == Kind::Corners).map(|s| s.offset as usize) {
        let sum = xxh3_64(&bytes[at..at + 16]);
        bytes[at + 16..at + 24].copy_from_slice(&sum.to_le_bytes());
    }
    let front = format::front_bytes(sections.len()) as usize;
    let sum = xxh3_64(&bytes[format::HEADER_BYTES..front]);
    bytes[24..32].copy_from_slice(&sum.to_le_bytes());
    let sum = xxh3_64(&bytes[..32]);
    bytes[32..40].copy_from_slice(&sum.to_le_bytes());
}

/// Reads this and that; whether all of it was there.
fn read(database: &Database) -> bool {
    let grid = HeightField::grid(database);
    let mut sound = database.corner_heights().is_ok();
    for level in 0..extremes::levels(grid) + 1 {
        let (columns, rows) = if level == 0 { Some(grid.pages()) } else { extremes::pages(grid, level) }.unwrap();
        for (pj, pi) in (0..rows.min(PAGES)).flat_map(|pj| (0..columns.min(PAGES)).map(move |pi| (pj, pi))) {
            let id = PageId { pi, pj };
            sound &= if level == 0 { database.page(id).is_ok() } else { database.extremes(level, id).is_ok() };
        }
    }
    let side = grid.root().side();
    for (i, j) in (0..=side).step_by(2).take(200).flat_map(|j| [(0, j), (side / 2, j), (j, 2.min(side))]) {
        let p = Post::new(i, j);
        sound &= grid.root().is_corner(p) || database.bounds(p).is_ok();
    }
    sound
}

#[test]
fn files_that_nobody_wrote_are_refused_or_read() {
    let sound: Vec<_> = [(68, 21, 1, true), (150, 200, -70_000, false), (1100, 70, 1, true), (2, 3, 1, false)]
        .into_iter()
        .map(|(nx, ny, factor, voids)| written(&terrain(nx, ny, 5, factor, voids), usize::MAX).0)
        .map(|bytes| {
            let sections = Database::open_whole(Bytes::boxed(&bytes), NO_CACHE).unwrap().sections;
            assert!(sections.iter().all(|s| Paging::of_section(s).is_none_or(|paging| paging.pages() == s.pages)));
            assert!(sections.iter().all(|s| s.pages <= 3 * BLOCK_ENTRIES));
            (bytes, sections)
        })
        .collect();
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seed = number("SIGHTLINE_FUZZ_SEED").unwrap_or(1);
    let most = number("SIGHTLINE_FUZZ_FILES").unwrap_or(SHORT_RUN);
    let mut dice = Dice(seed);
    let (mut opened, mut whole) = (0, 0);
    for n in 0..most {
        let (bytes, sections) = &sound[dice.below(sound.len())];
        let mut bytes = bytes.clone();
        mutate(&mut dice, &mut bytes, sections);
        repair(&mut bytes, sections);
        let verified = verify_source(Bytes::boxed(&bytes), &|_, _| ());
        let Ok(database) = Database::open_whole(Bytes::boxed(&bytes), OpenOptions { cache_bytes: 1 << 20 }) else {
            continue;
        };
        opened += 1;
        let is_whole = read(&database);
        whole += u64::from(is_whole);
        let is_sound = verified.is_ok_and(|found| found.damage.is_empty());
        assert!(is_whole || !is_sound, "file {n} of seed {seed} is called sound");
    }
    println!("{most} files, {opened} opened, {whole} of them read");
    assert!(opened > most / 3 && whole > most / 8 && whole < opened, "{most} {opened} {whole}");
}
