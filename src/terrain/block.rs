//! Memory for the heights of a page: cells of large pieces that the system is asked to back with huge pages.
//!
//! Who asks for one short line after the other reads some heights here and some there, and mostly waits: for the heights,
//! and before them for the processor to find out where their page of memory is. Heights that lie scattered over the
//! heap, at 4 KiB a page of memory, are out of reach of the buffers that remember it (TLB); pieces of 2 MiB are not.
//! `ARCHITECTURE.md` has the figures.
//!
//! A freed cell is used again, and a piece goes back to the system when all its cells are free and others are too. This
//! is the one module of the project with `unsafe`: a slab that is filled while its other cells are read cannot be told to
//! the compiler otherwise. Its tests compare it with vectors.

#![allow(unsafe_code)]

use std::{
    alloc::{Layout, handle_alloc_error},
    collections::BTreeMap,
    fmt,
    ops::Deref,
    ptr::NonNull,
    sync::{Mutex, MutexGuard, PoisonError},
};

use memmap2::MmapMut;

use super::field::PAGE_POSTS;

/// The size and alignment of a huge page.
const HUGE_BYTES: usize = 2 << 20;
/// Bytes of a piece that hold cells. It takes address space, not memory, until it is written to.
const PIECE_BYTES: usize = 8 * HUGE_BYTES;

/// What a height may be stored as.
pub trait Stored: Copy + Send + Sync + fmt::Debug + sealed::Pooled + 'static {}

impl<T: Copy + Send + Sync + fmt::Debug + sealed::Pooled + 'static> Stored for T {}

mod sealed {
    use super::Pool;

    /// A type without padding for which every pattern of bits is a value, and the cells of its size.
    pub trait Pooled: Sized {
        fn pool() -> &'static Pool;
    }
}

macro_rules! pooled {
    ($($t:ty),*) => { $(
        impl sealed::Pooled for $t {
            fn pool() -> &'static Pool {
                static POOL: Pool = Pool::new();
                &POOL
            }
        }
    )* };
}

pooled!(i16, i32, f64);

/// A mapping with cells in it.
struct Piece {
    memory: MmapMut,
    /// The bytes of the mapping at which cells begin that nobody holds; the last is the next to be taken.
    free: Vec<usize>,
}

impl Piece {
    /// A piece of free cells of `bytes`, which divide a huge page.
    fn new(bytes: usize) -> Self {
        let length = PIECE_BYTES + HUGE_BYTES;
        let Ok(memory) = MmapMut::map_anon(length) else {
            handle_alloc_error(Layout::array::<u8>(length).unwrap_or(Layout::new::<u8>()))
        };
        // Where the system knows no huge pages, or wants none, the memory is as good as any.
        #[cfg(target_os = "linux")]
        let _ = memory.advise(memmap2::Advice::HugePage);
        // The mapping begins anywhere; there is room for all cells behind the first whole huge page in it.
        let first = memory.as_ptr().align_offset(HUGE_BYTES);
        Self { memory, free: (first..first + PIECE_BYTES).step_by(bytes).rev().collect() }
    }

    fn address(&self) -> usize {
        self.memory.as_ptr().addr()
    }
}

/// The cells of one size: pieces by their address.
pub struct Pool(Mutex<BTreeMap<usize, Piece>>);

impl Pool {
    const fn new() -> Self {
        Self(Mutex::new(BTreeMap::new()))
    }

    fn pieces(&self) -> MutexGuard<'_, BTreeMap<usize, Piece>> {
        // A thread that panicked while it held the lock left valid pieces: all steps keep them so.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A cell of `bytes`, aligned to them, that is the caller's alone until it is given back.
    fn take(&self, bytes: usize) -> *mut u8 {
        let mut pieces = self.pieces();
        let taken = pieces.values_mut().find_map(|piece| piece.free.pop().map(|start| (piece.memory.as_ptr(), start)));
        let (memory, start) = taken.unwrap_or_else(|| {
            let mut piece = Piece::new(bytes);
            let (memory, start) = (piece.memory.as_ptr(), piece.free.pop().unwrap_or_default());
            pieces.insert(piece.address(), piece);
            (memory, start)
        });
        // The mapping is writable, and keeps its place when it is moved.
        memory.wrapping_add(start).cast_mut()
    }

    /// Takes a cell of `bytes` back.
    fn give(&self, cell: *mut u8, bytes: usize) {
        let mut pieces = self.pieces();
        let Some((&address, piece)) = pieces.range_mut(..=cell.addr()).next_back() else { return };
        piece.free.push(cell.addr() - address);
        if piece.free.len() == PIECE_BYTES / bytes && pieces.values().filter(|piece| !piece.free.is_empty()).count() > 1
        {
            pieces.remove(&address);
        }
    }
}

/// [`PAGE_POSTS`] values in a cell of their own.
pub struct Block<T: Stored>(NonNull<[T; PAGE_POSTS]>);

// SAFETY: a block owns its cell alone, as a box does, and its values may be sent.
unsafe impl<T: Stored> Send for Block<T> {}
// SAFETY: shared, a block gives out shared references to its values, and nothing writes to them.
unsafe impl<T: Stored> Sync for Block<T> {}

impl<T: Stored> Block<T> {
    const BYTES: usize = size_of::<[T; PAGE_POSTS]>();

    fn new(from: &[T; PAGE_POSTS]) -> Self {
        const { assert!(HUGE_BYTES.is_multiple_of(Self::BYTES)) };
        let Some(values) = NonNull::new(T::pool().take(Self::BYTES).cast::<[T; PAGE_POSTS]>()) else {
            unreachable!("no cell lies at 0")
        };
        debug_assert!(values.is_aligned());
        // SAFETY: the cell is as large as the values, aligned, writable, and nobody else's until `drop`, so it cannot
        // overlap `from` either.
        unsafe { values.write(*from) };
        Self(values)
    }
}

impl<T: Stored> Deref for Block<T> {
    type Target = [T; PAGE_POSTS];

    #[inline]
    fn deref(&self) -> &[T; PAGE_POSTS] {
        // SAFETY: written whole in `new`, aligned, in memory that stays until `drop`, and not written again.
        unsafe { self.0.as_ref() }
    }
}

impl<T: Stored> Drop for Block<T> {
    fn drop(&mut self) {
        T::pool().give(self.0.as_ptr().cast(), Self::BYTES);
    }
}

impl<T: Stored> Clone for Block<T> {
    fn clone(&self) -> Self {
        Self::new(self)
    }
}

impl<T: Stored> fmt::Debug for Block<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_slice().fmt(f)
    }
}

impl<T: Stored> From<&[T; PAGE_POSTS]> for Block<T> {
    fn from(values: &[T; PAGE_POSTS]) -> Self {
        Self::new(values)
    }
}

impl<T: Stored> From<Vec<T>> for Block<T> {
    /// # Panics
    /// When there are not [`PAGE_POSTS`] values: that is the caller's defect, not the input's.
    fn from(values: Vec<T>) -> Self {
        match values.as_slice().try_into() {
            Ok(values) => Self::new(values),
            Err(_) => panic!("a page has {PAGE_POSTS} posts, not {}", values.len()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::synthetic::mix;

    /// Blocks and vectors made, cloned and dropped in the same random order hold the same values.
    fn churn<T: Stored + PartialEq>(seed: u64, value: impl Fn(u64) -> T) {
        let mut kept: Vec<(Block<T>, Vec<T>)> = Vec::new();
        for n in 0..2_000 {
            let draw = mix(seed ^ n);
            let which = (draw >> 32) as usize % kept.len().max(1);
            match draw % 5 {
                0..=1 => {
                    let values: Vec<T> = (0..PAGE_POSTS as u64).map(|k| value(mix(draw ^ k))).collect();
                    kept.push((values.clone().into(), values));
                }
                2 if !kept.is_empty() => kept.push(kept[which].clone()),
                3 if !kept.is_empty() => drop(kept.swap_remove(which)),
                _ => {}
            }
            if kept.len() > 40 {
                kept.truncate(3);
            }
            if let Some((block, values)) = kept.get(which) {
                assert!(block.as_slice() == values, "step {n} of seed {seed}");
            }
        }
        assert!(kept.iter().all(|(block, values)| block.as_slice() == values));
    }

    #[test]
    fn blocks_hold_what_vectors_hold() {
        std::thread::scope(|scope| {
            for seed in 0..4 {
                scope.spawn(move || churn(seed, |n| n as i16));
            }
            scope.spawn(|| churn(9, |n| n as i32));
            scope.spawn(|| churn(10, |n| n as f64));
        });
    }

    #[test]
    fn cells_are_used_again_and_pieces_given_back() {
        const BYTES: usize = 8192;
        const ALL: usize = PIECE_BYTES / BYTES;
        let pool = Pool::new();
        // The number of pieces, and of their free cells.
        let kept = || {
            let pieces = pool.pieces();
            (pieces.len(), pieces.values().map(|piece| piece.free.len()).sum::<usize>())
        };
        let cells: Vec<_> = (0..2 * ALL + 1).map(|_| pool.take(BYTES)).collect();
        assert_eq!(kept(), (3, ALL - 1));
        let mut places: Vec<_> = cells.iter().map(|cell| cell.addr()).collect();
        places.sort_unstable();
        assert!(places.windows(2).all(|pair| pair[1] - pair[0] >= BYTES), "no two cells overlap");
        for piece in pool.pieces().values() {
            let (from, to) = (piece.address(), piece.address() + piece.memory.len());
            let inside = places.iter().filter(|&&at| from <= at && at + BYTES <= to && at % BYTES == 0).count();
            assert_eq!(inside + piece.free.len(), ALL);
        }
        for cell in cells {
            pool.give(cell, BYTES);
            assert!(kept().1 < 2 * ALL, "of pieces that are free as a whole one is kept");
        }
        assert_eq!(kept(), (1, ALL));
        assert!(places.contains(&pool.take(BYTES).addr()));
    }

    #[test]
    #[should_panic = "4096 posts, not 3"]
    fn a_page_of_another_size_is_refused() {
        let _ = Block::from(vec![1_i16, 2, 3]);
    }
}
