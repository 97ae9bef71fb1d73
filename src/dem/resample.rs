//! A raster on the lattice of another: what tiles of different spacing need to become one terrain.
//!
//! The posts are those of the other's lattice within this raster's outer posts; nothing is extrapolated. A post that lies
//! on one of this raster's own (to [`SNAP_POSTS`]) has its height unchanged. Others have that of the nearest post (the
//! north-eastern of several), or the bilinear mean of the four around, which is void when one of those is.
//!
//! Kept at hand: two rows, beside what the raster itself keeps.

use std::path::Path;

use crate::terrain::Georeference;

use super::{DemError, FLOAT_UNIT_M, Raster, RasterInfo, Resampling};

/// Within so many posts of a post a place is that post: coordinates are printed with some ten digits.
const SNAP_POSTS: f64 = 1e-6;
/// Most posts along a side, and furthest from the other's first one: beyond it, numbers of posts are no whole numbers.
const MAX_SIDE: f64 = (1_u64 << 30) as f64;
const MAX_NUMBER: f64 = (1_u64 << 40) as f64;

/// Where a post of the new lattice lies: the row or column before it, and how far it is on the way to the next.
#[derive(Clone, Copy)]
struct Stand {
    before: u32,
    part: f64,
}

/// The posts of the new lattice along one axis.
#[derive(Clone, Copy)]
struct Axis {
    /// Place and spacing of this raster's posts and of the other's, in map units.
    own: [f64; 2],
    other: [f64; 2],
    /// This raster's last post.
    last: f64,
    /// The number of the first post on the other's lattice.
    first: f64,
    posts: u32,
}

impl Axis {
    /// `None` when fewer than two posts lie within, or more than a side may have.
    fn new(own: [f64; 2], posts: u32, other: [f64; 2]) -> Option<Self> {
        let last = f64::from(posts - 1);
        let number = |at: f64| (own[0] + at * own[1] - other[0]) / other[1];
        let slack = SNAP_POSTS * own[1] / other[1];
        let (first, end) = ((number(0.0) - slack).ceil(), (number(last) + slack).floor());
        let count = end - first + 1.0;
        let fits = (2.0..=MAX_SIDE).contains(&count) && first.abs() <= MAX_NUMBER;
        fits.then_some(Self { own, other, last, first, posts: count as u32 })
    }

    /// Where post `n` lies on this raster, or the post that takes its place.
    fn stand(&self, n: u32, method: Resampling) -> Stand {
        let ([origin, step], [other_origin, other_step]) = (self.own, self.other);
        let at = ((self.first + f64::from(n)) * other_step + other_origin - origin) / step;
        let at = at.clamp(0.0, self.last);
        let at = if (at - at.round()).abs() <= SNAP_POSTS { at.round() } else { at };
        let stand = Stand { before: at as u32, part: at - at.floor() };
        match method {
            Resampling::Bilinear => stand,
            Resampling::Nearest => Stand { before: stand.before + u32::from(stand.part >= 0.5), part: 0.0 },
        }
    }
}

/// A raster on another lattice.
pub(super) struct Resampled {
    inner: Box<dyn Raster>,
    method: Resampling,
    info: RasterInfo,
    east: Axis,
    north: Axis,
    /// Rows of the raster that were read last, and their numbers.
    at_hand: [(Option<u32>, Vec<f64>); 2],
}

impl Resampled {
    /// `inner`, which comes from `path`, on the lattice of `other`.
    pub(super) fn new(
        inner: Box<dyn Raster>,
        path: &Path,
        other: &Georeference,
        method: Resampling,
    ) -> Result<Self, DemError> {
        let own = inner.info().clone();
        let axis = |k: usize, posts: u32| {
            let place = own.georeference;
            Axis::new([place.origin[k], place.step[k]], posts, [other.origin[k], other.step[k]])
        };
        let (Some(east), Some(north)) = (axis(0, own.nx), axis(1, own.ny)) else {
            let detail =
                format!("{} holds fewer than two or more than 2^30 posts of the finest file's lattice", path.display());
            return Err(DemError::Mosaic { detail });
        };
        let place = own.georeference;
        let mut info = RasterInfo {
            nx: east.posts,
            ny: north.posts,
            georeference: Georeference {
                origin: other.map_from_grid(east.first, north.first),
                step: other.step,
                ..place
            },
            ..own
        };
        if method == Resampling::Bilinear {
            info.unit_m = info.unit_m.min(FLOAT_UNIT_M);
        }
        info.notes.push(format!(
            "{} is resampled ({method}) from posts {} by {} map units apart to {} by {}",
            path.display(),
            place.step[0],
            place.step[1],
            other.step[0],
            other.step[1]
        ));
        let row = || (None, vec![0.0; own.nx as usize]);
        Ok(Self { inner, method, info, east, north, at_hand: [row(), row()] })
    }

    /// Brings row `j` of the raster to hand; gives which of the two it is. `keep` stays.
    fn row(&mut self, j: u32, keep: Option<usize>) -> Result<usize, DemError> {
        if let Some(n) = self.at_hand.iter().position(|(number, _)| *number == Some(j)) {
            return Ok(n);
        }
        let n = keep.map_or(0, |kept| 1 - kept);
        let (number, row) = &mut self.at_hand[n];
        *number = None;
        self.inner.read_row(j, row)?;
        *number = Some(j);
        Ok(n)
    }
}

impl Raster for Resampled {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let at = self.north.stand(j, self.method);
        let south = self.row(at.before, None)?;
        let north = if at.part > 0.0 { self.row(at.before + 1, Some(south))? } else { south };
        let (south, north) = (&self.at_hand[south].1, &self.at_hand[north].1);
        for (post, n) in out.iter_mut().zip(0..) {
            let Stand { before, part } = self.east.stand(n, self.method);
            let (west, east) = (before as usize, before as usize + usize::from(part > 0.0));
            // A weight of 0 must not take up a void.
            let between = |a: f64, b: f64, part: f64| if part > 0.0 { a + (b - a) * part } else { a };
            *post = between(between(south[west], south[east], part), between(north[west], north[east], part), at.part);
        }
        Ok(())
    }

    fn release(&mut self) {
        self.inner.release();
    }

    fn limit_memory(&mut self, bytes: usize) -> Result<(), DemError> {
        self.inner.limit_memory(bytes)
    }

    fn memory_bytes(&self) -> u64 {
        self.inner.memory_bytes()
    }
}
