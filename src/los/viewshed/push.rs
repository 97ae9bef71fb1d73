//! Bounds of the horizon in each sector of a fan, and how columns of posts raise them.
//!
//! Sectors are bounded by rays at equal steps of the slope m; q = m scale + offset counts them, so ray k is at q = k
//! and sector k lies between rays k and k + 1. Along the slope m the horizon up to some x is the greatest projected
//! height s of the ground met so far; the target is hidden exactly when its own s is less. On a triangle, s is a
//! quotient of two linear functions, so over the part of a triangle within a sector it is greatest at a corner: a post
//! in the sector, or where one of the two rays crosses an edge. Hence
//!
//! - **upper bound**: the greatest of the posts in the sector and of all crossings of its two rays;
//! - **lower bound**: whatever the slope, the path crosses each column; where the column's edges are known all across
//!   the sector, somewhere on the path is ground as high as the least of them, which is at a ray or a post again.
//!
//! **Errors.** With u = 2^-53 the rounded s is off by 4 u |s|, and q by at most 2^-48 scale near the wedge (|m| <= 5).
//! The share of an edge at which a ray crosses it is off by 3.1 * 2^-48 scale / |dq|. Edges with |dq| < 2^-20 scale
//! ([`RADIAL`]) are left out: both their posts are within 2^-20 scale of any ray that crosses them. Posts within twice
//! that ([`NEAR_RAY`]) of a ray count in the sectors on both sides of it; so does, with them, whatever is missed where
//! rounding puts the end of an edge on the wrong side of a ray. For the rest, the share is off by less than 2^-26, so s
//! by 2^-25 of the greatest |s| of the two columns, and 2^-23 of it ([`margin`]) covers this, the rounding of the
//! products, and the margin's own. It is some micrometres to a millimetre of height: it decides how many cells are
//! asked, never what is answered.
//!
//! **On a curved Earth** a target T is hidden behind ground G, at the share t of the way, when
//! za + t (zT - za) - t (1 - t) W < zG. As the W of the way to G is t^2 W, that is t (zT - za - W) < zG - za - t^2 W: all
//! is as on a flat Earth once each point is lowered by its own W. Lowered edges and chords bend upwards between their
//! ends, by at most (east + north) / 4 each, both being at most a cell long: the margin has their sum, divided by the
//! distance. Lower bounds need none of it. A target that clears the last crossing by that clears the chord to its post.

use sightline_proto::predicates::FLUSHED;

use super::column::{Column, Frame, Shot};

/// Edges that span less of the slope are left to their posts.
pub(super) const RADIAL: f64 = 1.0 / (1 << 20) as f64;
/// A post this near a ray, in slope, counts in both sectors.
pub(super) const NEAR_RAY: f64 = 2.0 * RADIAL;

/// How far a projected height of two columns can be off.
pub(super) fn margin(frame: &Frame, before: &Column, column: &Column) -> f64 {
    // The column before is at least half as far away, or there is none.
    before.most.max(column.most) / (1 << 23) as f64 + frame.bulge() * column.per_x + FLUSHED
}

/// The sectors of a fan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sectors {
    /// Sectors for a slope of 1.
    pub(super) scale: f64,
    /// Where the slope is 0: half way between two rays, so that no ray runs along a row, a column or a diagonal.
    pub(super) offset: f64,
    /// The first sector held.
    pub(super) base: i64,
    /// How many are held. The first and the last are another fan's, and only for posts near its border.
    pub(super) len: usize,
}

impl Sectors {
    /// The slope of ray `k`.
    pub(super) fn slope(&self, k: i64) -> f64 {
        (k as f64 - self.offset) / self.scale
    }

    /// The sectors held that q is in or too near to.
    pub(super) fn around(&self, q: f64) -> std::ops::Range<usize> {
        let near = NEAR_RAY * self.scale;
        self.held(floor(q - near), floor(q + near) + 1)
    }

    /// The part of sectors `first..end` that is held, numbered from the base.
    fn held(&self, first: i64, end: i64) -> std::ops::Range<usize> {
        let len = self.len as i64;
        let (first, end) = ((first - self.base).clamp(0, len), (end - self.base).clamp(0, len));
        first as usize..(end as usize).max(first as usize)
    }

    /// The projected post at height `s` and slope `q`.
    #[inline]
    pub(super) fn shot(&self, s: f64, q: f64) -> Shot {
        let sector = floor(q);
        let (fraction, near) = (q - sector as f64, NEAR_RAY * self.scale);
        let k = (sector - self.base).clamp(-1, self.len as i64) as i32;
        Shot { s, q, k, is_near_ray: fraction <= near || fraction >= 1.0 - near }
    }

    /// The rays between two sectors, numbered from the base: the number of each, and its q.
    #[inline]
    fn between(&self, from: i32, to: i32, mut of: impl FnMut(usize, f64)) {
        let (mut k, mut ray) = (from + 1, (self.base + i64::from(from) + 1) as f64);
        // Mostly one or two: counting in f64, which is exact, keeps the compiler from making a loop for many.
        while k <= to {
            of(k as usize, ray);
            k += 1;
            ray += 1.0;
        }
    }
}

/// The greatest integer not above a number far within the range of i64.
#[inline]
pub(super) fn floor(v: f64) -> i64 {
    // Without SSE 4.1 the standard one is a call.
    let whole = v as i64;
    whole - i64::from(whole as f64 > v)
}

/// Whether paths in a sector pass over unknown ground.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Gap {
    /// None does.
    None,
    /// Some may.
    Some,
    /// All do.
    All,
}

/// What is known of the horizon in the sectors of a fan.
#[derive(Clone, Debug)]
pub(super) struct Horizon {
    pub(super) sectors: Sectors,
    /// The highest crossing of each ray so far, widened.
    pub(super) rays: Vec<f64>,
    /// The highest post of each sector so far, widened.
    pub(super) posts: Vec<f64>,
    /// The lower bound of each sector's horizon.
    pub(super) lower: Vec<f64>,
    pub(super) gaps: Vec<Gap>,
    /// Where each ray crosses the column at hand; minus infinity where it does not, NaN where that is unknown.
    chain: Vec<f64>,
    /// The least post of the column at hand in each sector.
    least: Vec<f64>,
}

impl Horizon {
    pub(super) fn new(sectors: Sectors, gap: Gap) -> Self {
        let lowest = |len| vec![f64::NEG_INFINITY; len];
        let len = sectors.len;
        Self {
            sectors,
            rays: lowest(len + 1),
            posts: lowest(len),
            lower: lowest(len),
            gaps: vec![gap; len],
            chain: lowest(len + 1),
            least: lowest(len),
        }
    }

    /// The upper bound of each sector.
    pub(super) fn upper(&self, upper: &mut Vec<f64>) {
        upper.clear();
        let pairs = self.rays.iter().zip(&self.rays[1..]).zip(&self.posts);
        upper.extend(pairs.map(|((&left, &right), &post)| greater(greater(left, right), post)));
    }

    /// Raises the bounds by a column: its posts and the edges between them.
    pub(super) fn push_column(&mut self, column: &Column, margin: f64) {
        self.chain.fill(f64::NEG_INFINITY);
        self.least.fill(f64::INFINITY);
        let sectors = self.sectors;
        let per_q = column.x / sectors.scale;
        for pair in column.posts.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            // Numbers are the same for both edges of a post, so no ray falls between two edges.
            let slope = (to.s - from.s) * per_q;
            sectors.between(from.k, to.k, |k, ray| self.chain[k] = from.s + (ray - from.q) * slope);
        }
        for &post in &column.posts {
            self.push_post(post, margin);
        }
        let low = self.lower.iter_mut().zip(&self.least).zip(self.chain.iter().zip(&self.chain[1..]));
        for ((lower, &least), (&left, &right)) in low {
            let low = if left < right { left } else { right };
            let low = if least < low { least } else { low } - margin;
            // A NaN on either side is unknown ground in the sector, an infinity no crossing: this then adds NaN.
            *lower = greater(low + 0.0 * (left + right), *lower);
        }
        for (ray, &crossing) in self.rays.iter_mut().zip(&self.chain) {
            *ray = greater(crossing + margin, *ray);
        }
    }

    #[inline]
    fn push_post(&mut self, Shot { s, q, k, is_near_ray }: Shot, margin: f64) {
        let least = if s.is_nan() { f64::NEG_INFINITY } else { s };
        let mut push = |k: usize| {
            self.posts[k] = greater(s + margin, self.posts[k]);
            self.least[k] = if least < self.least[k] { least } else { self.least[k] };
        };
        if is_near_ray {
            self.sectors.around(q).for_each(push);
        } else if k >= 0 && (k as usize) < self.sectors.len {
            push(k as usize);
        }
    }

    /// Where an edge has a void end, some paths of the sectors that it spans may be over unknown ground.
    fn mark_gap(&mut self, u: Shot, v: Shot) {
        if u.s.is_nan() || v.s.is_nan() {
            for k in self.sectors.around(u.q.min(v.q)).start..self.sectors.around(u.q.max(v.q)).end {
                self.gaps[k] = self.gaps[k].max(Gap::Some);
            }
        }
    }

    /// Raises the upper bound by the edges between two columns that follow each other.
    pub(super) fn push_strip(&mut self, before: &Column, column: &Column, margin: f64) {
        let Some((first, near, far)) = strip(before, column) else { return };
        // A cell's diagonal joins its posts of even sum.
        let mut rises = (before.a + first) & 1 == 0;
        for (near, far) in near.windows(2).zip(far.windows(2)) {
            self.push_edge(near[0], far[0], margin);
            if rises {
                self.push_edge(near[0], far[1], margin)
            } else {
                self.push_edge(near[1], far[0], margin)
            }
            rises = !rises;
        }
        if let (Some(&near), Some(&far)) = (near.last(), far.last()) {
            self.push_edge(near, far, margin);
        }
    }

    #[inline]
    fn push_edge(&mut self, u: Shot, v: Shot, margin: f64) {
        if u.k == v.k {
            return;
        }
        let (from, to) = if u.k < v.k { (u, v) } else { (v, u) };
        let span = to.q - from.q;
        if span < RADIAL * self.sectors.scale {
            return;
        }
        let slope = (to.s - from.s) / span;
        let rays = &mut self.rays;
        self.sectors.between(from.k, to.k, |k, ray| {
            // A void end makes this NaN, which raises nothing.
            rays[k] = greater(from.s + (ray - from.q) * slope + margin, rays[k]);
        });
    }

    /// Notes which sectors the void posts of the last two columns touch, and which the last crosses void altogether.
    pub(super) fn mark_gaps(&mut self, frame: &Frame, before: &Column, column: &Column) {
        if let Some((_, near, far)) = strip(before, column) {
            // All edges between the columns, and diagonals that are none: a little more than there is.
            for (near, far) in near.windows(2).zip(far.windows(2)) {
                for (u, v) in [(near[0], far[0]), (near[0], far[1]), (near[1], far[0]), (near[1], far[1])] {
                    self.mark_gap(u, v);
                }
            }
        }
        for pair in column.posts.windows(2) {
            self.mark_gap(pair[0], pair[1]);
        }
        for k in 0..self.sectors.len {
            let ray = self.sectors.base + k as i64;
            let across = |k| frame.across + column.x * self.sectors.slope(k);
            // A post more on either side than there can be.
            let posts = across(ray).floor() as i64 - 1..=across(ray + 1).ceil() as i64 + 1;
            let inside = *posts.start() >= column.b && *posts.end() < column.end();
            if inside && posts.into_iter().all(|b| column.at(b).is_nan()) {
                self.gaps[k] = Gap::All;
            }
        }
    }
}

/// The part of two columns that is in both: its first index across, and the posts of each.
fn strip<'a>(before: &'a Column, column: &'a Column) -> Option<(i64, &'a [Shot], &'a [Shot])> {
    let (first, end) = (before.b.max(column.b), before.end().min(column.end()));
    let part = |column: &'a Column| column.posts.get((first - column.b) as usize..(end - column.b) as usize);
    if first < end { Some((first, part(before)?, part(column)?)) } else { None }
}

/// The greater of two numbers; the second where the first is NaN.
#[inline]
pub(super) fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}
