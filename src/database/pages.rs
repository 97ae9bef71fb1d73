//! The bytes of one page, of heights, of bounds or of extremes, and what they decode to.

use super::{
    directory::HAS_VOIDS,
    format::Element,
    layout::{QUAD_DIAMONDS, QUAD_SIDE},
};
use crate::{
    terrain::{Block, HeightPage, PAGE_POSTS, PAGE_SIDE, Samples, Stored, extremes::Extremes},
    wedgie::DiamondBounds,
};

/// Bytes of a page of `size` cells with `flags`; `None` for flags or elements that no page has.
pub(super) fn page_bytes(element: Element, size: (u32, u32), flags: u32) -> Option<usize> {
    let cells = (size.0 * size.1) as usize;
    let voids = if flags == HAS_VOIDS { cells.div_ceil(8) } else { 0 };
    match (element, flags) {
        (Element::I16, 0 | HAS_VOIDS) => Some(2 * cells + voids),
        (Element::I32 | Element::PairI16, 0 | HAS_VOIDS) => Some(4 * cells + voids),
        (Element::PairI32, 0 | HAS_VOIDS) => Some(8 * cells + voids),
        (Element::Bounds, 0) => Some(12 * cells * QUAD_DIAMONDS),
        (Element::ShortBounds, 0) => Some(SHORT_BYTES * cells * QUAD_DIAMONDS),
        _ => None,
    }
}

/// Bytes of the bounds of a diamond as they are written.
pub(super) const SHORT_BYTES: usize = 9;

/// The index in a [`HeightPage`] of each post of a page of `size` posts, in the order of the file.
fn posts((w, h): (u32, u32)) -> impl Iterator<Item = usize> {
    (0..h).flat_map(move |j| (0..w).map(move |i| (j * PAGE_SIDE + i) as usize))
}

/// The bytes of a page of heights and its flags; `None` when a height does not fit the element.
pub(super) fn encode_heights(page: &HeightPage, element: Element, size: (u32, u32)) -> Option<(Vec<u8>, u32)> {
    let mut out = Vec::with_capacity(4 * (size.0 * size.1) as usize);
    let mut bits = Vec::new();
    let mut flags = 0;
    for (n, index) in posts(size).enumerate() {
        let post = page.at(index as u32 % PAGE_SIDE, index as u32 / PAGE_SIDE);
        let z = exact_i32(post.z)?;
        match element {
            Element::I16 => out.extend_from_slice(&i16::try_from(z).ok()?.to_le_bytes()),
            _ => out.extend_from_slice(&z.to_le_bytes()),
        }
        if n % 8 == 0 {
            bits.push(0_u8);
        }
        if post.void {
            bits[n / 8] |= 1 << (n % 8);
            flags = HAS_VOIDS;
        }
    }
    if flags == HAS_VOIDS {
        out.extend_from_slice(&bits);
    }
    Some((out, flags))
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
    let width = if element == Element::I16 { 2 } else { 4 };
    let (values, bits) = bytes.split_at(width * cells);
    let samples = if element == Element::I16 {
        Samples::I16(decode_samples(values, size.0, i16::from_le_bytes))
    } else {
        Samples::I32(decode_samples(values, size.0, i32::from_le_bytes))
    };
    let voids = if flags == HAS_VOIDS { Some(decode_voids(bits, cells, size)?) } else { None };
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
    if bits.iter().all(|&b| b == 0) {
        return Some((out, 0));
    }
    out.extend_from_slice(&bits);
    Some((out, HAS_VOIDS))
}

/// The values of a page of extremes, laid out as a [`HeightPage`] is; nothing beyond its size.
pub(super) fn decode_extremes(
    bytes: &[u8],
    element: Element,
    size: (u32, u32),
    flags: u32,
) -> Result<Box<[Extremes; PAGE_POSTS]>, String> {
    let cells = (size.0 * size.1) as usize;
    let width = if element == Element::PairI16 { 2 } else { 4 };
    let (values, bits) = bytes.split_at(2 * width * cells);
    let voids = if flags == HAS_VOIDS { Some(decode_voids(bits, cells, size)?) } else { None };
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

/// The bounds of the diamonds of a page.
#[derive(Clone, Debug)]
pub(super) struct BoundsPage {
    columns: u32,
    diamonds: Box<[DiamondBounds]>,
}

impl BoundsPage {
    /// The bounds of number `n` of the quad at column `u` and row `v` of the page.
    pub(super) fn at(&self, (u, v): (u32, u32), n: usize) -> DiamondBounds {
        debug_assert!(u < self.columns && v < QUAD_SIDE);
        self.diamonds[(v * self.columns + u) as usize * QUAD_DIAMONDS + n]
    }

    /// Bytes that it keeps in memory, about.
    pub(super) fn weight(&self) -> usize {
        self.diamonds.len() * size_of::<DiamondBounds>() + 128
    }
}

/// Adds the bytes of one diamond's bounds; those that do not fit into 24 bits are rounded up.
pub(super) fn encode_bounds(out: &mut Vec<u8>, bounds: DiamondBounds) {
    for v in [bounds.tight, bounds.nested, bounds.radius_m] {
        out.extend_from_slice(&(v.to_bits().div_ceil(1 << SHORT_SHIFT)).to_le_bytes()[..3]);
    }
}

/// Bits that a short bound lacks at the low end.
const SHORT_SHIFT: u32 = 7;

/// What is wrong with `bounds`, if anything. Infinite ones are sound: nothing less is sure.
pub(super) fn check_bounds(bounds: &DiamondBounds) -> Result<(), String> {
    let DiamondBounds { tight, nested, radius_m } = *bounds;
    let sane = tight >= 0.0 && nested >= tight && radius_m >= 0.0;
    if sane { Ok(()) } else { Err(format!("bounds of {tight}, {nested}, {radius_m} make no sense")) }
}

/// The page of bounds in `bytes`, which are as many as [`page_bytes`] says.
pub(super) fn decode_bounds(bytes: &[u8], element: Element, size: (u32, u32)) -> Result<BoundsPage, String> {
    let values: Vec<f32> = match element {
        Element::ShortBounds => {
            let (values, _) = bytes.as_chunks::<3>();
            values.iter().map(|&[a, b, c]| f32::from_bits(u32::from_le_bytes([a, b, c, 0]) << SHORT_SHIFT)).collect()
        }
        _ => {
            let (values, _) = bytes.as_chunks::<4>();
            values.iter().map(|&value| f32::from_le_bytes(value)).collect()
        }
    };
    let (triples, _) = values.as_chunks::<3>();
    let mut diamonds = Vec::with_capacity(triples.len());
    for &[tight, nested, radius_m] in triples {
        let bounds = DiamondBounds { tight, nested, radius_m };
        check_bounds(&bounds)?;
        diamonds.push(bounds);
    }
    Ok(BoundsPage { columns: size.0, diamonds: diamonds.into() })
}
