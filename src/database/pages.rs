//! The bytes of one page, of heights, of bounds or of extremes, and what they decode to.

use std::borrow::Cow;

use super::{
    directory::{HAS_VOIDS, IS_CONSTANT},
    format::{Element, u32_at},
    layout::{QUAD_DIAMONDS, QUAD_SIDE},
};
use crate::{
    terrain::{Block, HeightPage, PAGE_POSTS, PAGE_SIDE, Samples, Stored, extremes::Extremes},
    wedgie::DiamondBounds,
};

/// Bytes of a cell of a page: of a height, of the extremes of a block, or of the bounds of a quad.
fn cell_bytes(element: Element) -> Option<usize> {
    match element {
        Element::I16 => Some(2),
        Element::I32 | Element::PairI16 => Some(4),
        Element::PairI32 => Some(8),
        Element::Bounds => Some(12 * QUAD_DIAMONDS),
        Element::ShortBounds => Some(SHORT_BYTES * QUAD_DIAMONDS),
        Element::BoundsI16 => Some((SHORT_BYTES + 2) * QUAD_DIAMONDS),
        Element::BoundsI32 => Some((SHORT_BYTES + 4) * QUAD_DIAMONDS),
        Element::Byte | Element::Other(_) => None,
    }
}

/// Bytes of a page of `size` cells with `flags`; `None` for flags or elements that no page has.
pub(super) fn page_bytes(element: Element, size: (u32, u32), flags: u32) -> Option<usize> {
    let cells = (size.0 * size.1) as usize;
    let most = if element.is_of_bounds() { IS_CONSTANT } else { HAS_VOIDS | IS_CONSTANT };
    if flags & !most != 0 || (flags & IS_CONSTANT != 0 && cells < 2) {
        return None;
    }
    let stored = if flags & IS_CONSTANT != 0 { 1 } else { cells };
    let voids = if flags & HAS_VOIDS != 0 { cells.div_ceil(8) } else { 0 };
    Some(stored * cell_bytes(element)? + voids)
}

/// Leaves one cell of `width` bytes of a page where all of several are equal, and says so in its flags.
fn shorten(mut cells: Vec<u8>, width: usize) -> (Vec<u8>, u32) {
    // All are equal when each byte is that of one cell before.
    if cells.len() < 2 * width || cells[width..] != cells[..cells.len() - width] {
        return (cells, 0);
    }
    cells.truncate(width);
    (cells, IS_CONSTANT)
}

/// All cells of a page of `cells`, and what follows them.
fn all_cells(bytes: &[u8], element: Element, cells: usize, flags: u32) -> (Cow<'_, [u8]>, &[u8]) {
    let width = cell_bytes(element).unwrap_or_default();
    if flags & IS_CONSTANT != 0 {
        let (one, rest) = bytes.split_at(width);
        return (one.repeat(cells).into(), rest);
    }
    let (all, rest) = bytes.split_at(width * cells);
    (all.into(), rest)
}

/// Bytes of the bounds of a diamond as they are written, without its height.
const SHORT_BYTES: usize = 9;

/// The index in a [`HeightPage`] of each post of a page of `size` posts, in the order of the file.
fn posts((w, h): (u32, u32)) -> impl Iterator<Item = usize> {
    (0..h).flat_map(move |j| (0..w).map(move |i| (j * PAGE_SIDE + i) as usize))
}

/// The bytes of a page of heights and its flags; `None` when a height does not fit the element.
pub(super) fn encode_heights(page: &HeightPage, element: Element, size: (u32, u32)) -> Option<(Vec<u8>, u32)> {
    let mut out = Vec::with_capacity(4 * (size.0 * size.1) as usize);
    for j in 0..size.1 {
        let row = (j * PAGE_SIDE) as usize..(j * PAGE_SIDE + size.0) as usize;
        match (page.samples(), element) {
            (Samples::I16(z), Element::I16) => append(&mut out, &z[row], |z| Some(z.to_le_bytes())),
            (Samples::I16(z), _) => append(&mut out, &z[row], |z| Some(i32::from(z).to_le_bytes())),
            (Samples::I32(z), Element::I16) => {
                append(&mut out, &z[row], |z| Some(i16::try_from(z).ok()?.to_le_bytes()))
            }
            (Samples::I32(z), _) => append(&mut out, &z[row], |z| Some(z.to_le_bytes())),
            (Samples::F64(z), Element::I16) => {
                append(&mut out, &z[row], |z| Some(i16::try_from(exact_i32(z)?).ok()?.to_le_bytes()))
            }
            (Samples::F64(z), _) => append(&mut out, &z[row], |z| Some(exact_i32(z)?.to_le_bytes())),
        }?;
    }
    let (mut out, mut flags) = shorten(out, cell_bytes(element)?);
    if page.has_voids() {
        let mut bits = vec![0_u8; ((size.0 * size.1) as usize).div_ceil(8)];
        for (n, index) in posts(size).enumerate() {
            let post = page.at(index as u32 % PAGE_SIDE, index as u32 / PAGE_SIDE);
            bits[n / 8] |= u8::from(post.void) << (n % 8);
        }
        if bits.iter().any(|&b| b != 0) {
            flags |= HAS_VOIDS;
            out.extend_from_slice(&bits);
        }
    }
    Some((out, flags))
}

/// Appends `values` as bytes; `None` when one has none.
fn append<const N: usize, V: Copy>(
    out: &mut Vec<u8>,
    values: &[V],
    bytes: impl Fn(V) -> Option<[u8; N]>,
) -> Option<()> {
    let start = out.len();
    out.resize(start + N * values.len(), 0);
    for (slot, &value) in out[start..].as_chunks_mut::<N>().0.iter_mut().zip(values) {
        *slot = bytes(value)?;
    }
    Some(())
}

/// `z` as an integer, if it is one of 32 bits.
pub(super) fn exact_i32(z: f64) -> Option<i32> {
    let n = z as i32;
    (f64::from(n) == z).then_some(n)
}

/// The page of heights in `bytes`, which are as many as [`page_bytes`] says.
pub(super) fn decode_heights(
    bytes: &[u8],
    element: Element,
    size: (u32, u32),
    flags: u32,
) -> Result<HeightPage, String> {
    let cells = (size.0 * size.1) as usize;
    let (values, bits) = all_cells(bytes, element, cells, flags);
    let samples = if element == Element::I16 {
        Samples::I16(decode_samples(&values, size.0, i16::from_le_bytes))
    } else {
        Samples::I32(decode_samples(&values, size.0, i32::from_le_bytes))
    };
    let voids = if flags & HAS_VOIDS != 0 { Some(decode_voids(bits, cells, size)?) } else { None };
    Ok(HeightPage::new(samples, voids))
}

/// The samples of a page of `width` columns, row by row: post by post they took half of all instructions of a first mesh.
fn decode_samples<const N: usize, V: Stored + Default>(
    values: &[u8],
    width: u32,
    decode: impl Fn([u8; N]) -> V,
) -> Block<V> {
    let mut samples = [V::default(); PAGE_POSTS];
    let rows = samples.chunks_exact_mut(PAGE_SIDE as usize).zip(values.chunks_exact(N * width as usize));
    for (row, bytes) in rows {
        for (sample, value) in row.iter_mut().zip(bytes.as_chunks::<N>().0) {
            *sample = decode(*value);
        }
    }
    Block::from(&samples)
}

fn decode_voids(bits: &[u8], cells: usize, size: (u32, u32)) -> Result<Box<[u64; PAGE_POSTS / 64]>, String> {
    let spare = bits.len() * 8 - cells;
    if bits.iter().all(|&b| b == 0) || bits.last().is_some_and(|b| u32::from(*b) >> (8 - spare) != 0) {
        return Err("its bitmap of voids is empty or has reserved bits set".into());
    }
    let mut voids = Box::new([0; PAGE_POSTS / 64]);
    for (n, index) in posts(size).enumerate() {
        voids[index / 64] |= u64::from(bits[n / 8] >> (n % 8) & 1) << (index % 64);
    }
    Ok(voids)
}

/// The bytes of a page of extremes and its flags, from the values of its `size` blocks; `None` when a height does not fit
/// the element.
pub(super) fn encode_extremes(values: &[Extremes], element: Element) -> Option<(Vec<u8>, u32)> {
    let mut out = Vec::new();
    let mut bits = vec![0_u8; values.len().div_ceil(8)];
    for (n, value) in values.iter().enumerate() {
        for z in [exact_i32(value.least)?, exact_i32(value.greatest)?] {
            match element {
                Element::PairI16 => out.extend_from_slice(&i16::try_from(z).ok()?.to_le_bytes()),
                _ => out.extend_from_slice(&z.to_le_bytes()),
            }
        }
        bits[n / 8] |= u8::from(value.void) << (n % 8);
    }
    let (mut out, mut flags) = shorten(out, cell_bytes(element)?);
    if bits.iter().any(|&b| b != 0) {
        out.extend_from_slice(&bits);
        flags |= HAS_VOIDS;
    }
    Some((out, flags))
}

/// The values of a page of extremes, laid out as a [`HeightPage`] is; nothing beyond its size.
pub(super) fn decode_extremes(
    bytes: &[u8],
    element: Element,
    size: (u32, u32),
    flags: u32,
) -> Result<Box<[Extremes; PAGE_POSTS]>, String> {
    let cells = (size.0 * size.1) as usize;
    let (values, bits) = all_cells(bytes, element, cells, flags);
    let voids = if flags & HAS_VOIDS != 0 { Some(decode_voids(bits, cells, size)?) } else { None };
    let heights: Vec<i32> = match element {
        Element::PairI16 => values.as_chunks::<2>().0.iter().map(|b| i16::from_le_bytes(*b).into()).collect(),
        _ => values.as_chunks::<4>().0.iter().map(|b| i32::from_le_bytes(*b)).collect(),
    };
    let mut all = Box::new([Extremes::NOTHING; PAGE_POSTS]);
    for (index, &[least, greatest]) in posts(size).zip(heights.as_chunks::<2>().0) {
        if least > greatest {
            return Err(format!("a least height of {least} above a greatest of {greatest}"));
        }
        let void = voids.as_ref().is_some_and(|v| v[index / 64] >> (index % 64) & 1 == 1);
        all[index] = Extremes { least: least.into(), greatest: greatest.into(), void };
    }
    Ok(all)
}

/// Bytes that a decoded page of heights keeps in memory, about.
pub(super) fn heights_weight(page: &HeightPage) -> usize {
    let width = match page.samples() {
        Samples::I16(_) => 2,
        Samples::I32(_) => 4,
        Samples::F64(_) => 8,
    };
    width * PAGE_POSTS + if page.has_voids() { VOIDS_BYTES } else { 0 } + 128
}

/// The most that [`heights_weight`] is for a page of integers.
pub(super) fn most_heights_weight(element: Element) -> usize {
    (if element == Element::I16 { 2 } else { 4 }) * PAGE_POSTS + VOIDS_BYTES + 128
}

const VOIDS_BYTES: usize = PAGE_POSTS / 8;

/// The bounds of the diamonds of a page, and the heights of their posts where these stand beside them.
#[derive(Clone, Debug)]
pub(super) struct BoundsPage {
    columns: u32,
    diamonds: Box<[DiamondBounds]>,
    /// As many, or none.
    heights: Box<[i32]>,
}

impl BoundsPage {
    /// A page of `columns` quads a row with three diamonds each.
    pub(super) fn new(columns: u32, diamonds: Vec<DiamondBounds>, heights: Vec<i32>) -> Self {
        debug_assert!(heights.is_empty() || heights.len() == diamonds.len());
        Self { columns, diamonds: diamonds.into(), heights: heights.into() }
    }

    /// Heights, three a quad, row by row of quads; none where they do not stand beside the bounds.
    pub(super) fn heights(&self) -> &[i32] {
        &self.heights
    }

    /// Three diamonds a quad, row by row of quads.
    pub(super) fn diamonds(&self) -> &[DiamondBounds] {
        &self.diamonds
    }

    /// The bounds of number `n` of the quad at column `u` and row `v` of the page.
    pub(super) fn at(&self, (u, v): (u32, u32), n: usize) -> DiamondBounds {
        debug_assert!(u < self.columns && v < QUAD_SIDE);
        self.diamonds[(v * self.columns + u) as usize * QUAD_DIAMONDS + n]
    }

    /// The height of the same post, if it is there.
    pub(super) fn height_at(&self, (u, v): (u32, u32), n: usize) -> Option<f64> {
        self.heights.get((v * self.columns + u) as usize * QUAD_DIAMONDS + n).map(|&z| z.into())
    }

    /// Bytes that it keeps in memory, about.
    pub(super) fn weight(&self) -> usize {
        size_of_val(&*self.diamonds) + size_of_val(&*self.heights) + 128
    }
}

/// The bytes of a page of bounds and its flags, from three diamonds a quad and the heights of their posts; bounds that do not
/// fit into 24 bits are rounded up. An error when they make no sense.
pub(super) fn encode_bounds(
    diamonds: &[DiamondBounds],
    heights: &[i32],
    element: Element,
) -> Result<(Vec<u8>, u32), String> {
    let cell = cell_bytes(element).ok_or("no element of bounds")?;
    let width = cell / QUAD_DIAMONDS;
    let mut out = vec![0; width * diamonds.len()];
    for (record, (bounds, &height)) in out.chunks_exact_mut(width).zip(diamonds.iter().zip(heights)) {
        check_bounds(bounds)?;
        let (short, rest) = record.split_at_mut(SHORT_BYTES);
        for (slot, value) in short.as_chunks_mut().0.iter_mut().zip([bounds.tight, bounds.nested, bounds.radius_m]) {
            let [a, b, c, _] = value.to_bits().div_ceil(1 << SHORT_SHIFT).to_le_bytes();
            *slot = [a, b, c];
        }
        if element == Element::BoundsI16 && i16::try_from(height).is_err() {
            return Err(format!("a height of {height} in 16 bits"));
        }
        // The low bytes of a number that fits are that number in fewer bytes.
        rest.copy_from_slice(&height.to_le_bytes()[..rest.len()]);
    }
    Ok(shorten(out, cell))
}

/// Bits that a short bound lacks at the low end.
const SHORT_SHIFT: u32 = 7;

/// What is wrong with `bounds`, if anything. Infinite ones are sound: nothing less is sure.
fn check_bounds(bounds: &DiamondBounds) -> Result<(), String> {
    let DiamondBounds { tight, nested, radius_m } = *bounds;
    let sane = tight >= 0.0 && nested >= tight && radius_m >= 0.0;
    if sane { Ok(()) } else { Err(format!("bounds of {tight}, {nested}, {radius_m} make no sense")) }
}

/// The page of bounds in `bytes`, which are as many as [`page_bytes`] says.
pub(super) fn decode_bounds(
    bytes: &[u8],
    element: Element,
    size: (u32, u32),
    flags: u32,
) -> Result<BoundsPage, String> {
    let (bytes, _) = all_cells(bytes, element, (size.0 * size.1) as usize, flags);
    let (diamonds, heights) = match element {
        Element::BoundsI16 => records::<{ SHORT_BYTES + 2 }>(&bytes, |[.., a, b]| i16::from_le_bytes([a, b]).into()),
        Element::BoundsI32 => {
            records::<{ SHORT_BYTES + 4 }>(&bytes, |[.., a, b, c, d]| i32::from_le_bytes([a, b, c, d]))
        }
        Element::ShortBounds => (records::<SHORT_BYTES>(&bytes, |_| 0).0, Vec::new()),
        _ => {
            let full = |b: &[u8; 12], at: usize| f32::from_bits(u32_at(b, at));
            let of = |b| DiamondBounds { tight: full(b, 0), nested: full(b, 4), radius_m: full(b, 8) };
            (bytes.as_chunks::<12>().0.iter().map(of).collect(), Vec::new())
        }
    };
    diamonds.iter().try_for_each(check_bounds)?;
    Ok(BoundsPage::new(size.0, diamonds, heights))
}

/// Short bounds and the heights behind them, from records of `N` bytes.
fn records<const N: usize>(bytes: &[u8], height: impl Fn([u8; N]) -> i32) -> (Vec<DiamondBounds>, Vec<i32>) {
    let (records, _) = bytes.as_chunks::<N>();
    let short =
        |b: &[u8; N], at: usize| f32::from_bits(u32::from_le_bytes([b[at], b[at + 1], b[at + 2], 0]) << SHORT_SHIFT);
    let bounds = |b| DiamondBounds { tight: short(b, 0), nested: short(b, 3), radius_m: short(b, 6) };
    (records.iter().map(bounds).collect(), records.iter().map(|&record| height(record)).collect())
}
