//! The exact traversal: every edge and post of the finest triangulation that AB crosses, each decided once.
//!
//! **What is enough.** AB meets relative interiors of faces. On a known triangle or edge the clearance is linear along
//! AB, so a point strictly below exists exactly when one of the chord's ends is strictly below, and those lie on faces
//! of the same face, which are known too. Chord ends are A, B, posts on AB, and transversal crossings of open edges.
//! AB over an open triangle with a void corner V leaves it at an end of AB or, on at least one side, through a face
//! that contains V; so the same points reveal unknown ground. And AB leaves the grid exactly when an end is outside. So
//! it is enough to look at the ends and, for each [`Sweep`], at the crossings strictly between the ends. A line along
//! an edge crosses other families at the edge's posts.
//!
//! **Rungs.** A crossing is settled by the rounded crossing and its error bound ([`super::sweep`]) nearly always; close
//! to a post, by the post's height and its neighbours' within the same errors; otherwise by the predicates of the
//! kernel, which find the edge by the orientations of its posts.

use std::ops::Range;

use sightline_proto::{
    diamond::Post,
    predicates::{FLUSHED, Kernel, Sign, are_equal, compare, orient2d_with, orient3d_with, plan},
};

use super::{
    Manner, Rung,
    glance::{self, Glance},
    run::{self, Stop},
    skip,
    surface::Face,
    sweep::{Crossing, Family, ROUNDOFF, Span, Sweep, TINY, TRUSTED_MAGNITUDE},
};
use crate::terrain::{DrawnPost, Grid, HeightField, PAGE_SIDE, PageId, Posts, ReadError};

/// Crossings of one family in a row before the next family's turn, so that all four use the same pages.
const RUN: i64 = 256;
/// Lines no longer than this along x and y are looked at in full: to look for what can be skipped would cost more.
const FEW_CELLS: f64 = 24.0;

/// What a line met.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Met {
    /// A known point strictly above the line.
    pub(super) blocked: bool,
    /// An unknown point.
    pub(super) unknown: bool,
    /// A known point on the line strictly between its ends.
    pub(super) contact: bool,
    /// Something that was settled only within the tolerance.
    pub(super) tolerated: bool,
}

impl Met {
    /// Whether nothing that follows can change the verdict.
    #[inline]
    fn decides(self, strict: bool) -> bool {
        self.blocked || strict && self.contact
    }
}

/// Whether AB is no longer than [`FEW_CELLS`] along x and y.
#[inline]
fn is_short(a: [f64; 3], b: [f64; 3]) -> bool {
    let [wide, high] = [0, 1].map(|k: usize| (b[k] - a[k]).abs());
    wide.max(high) <= FEW_CELLS
}

/// What a glance settles of a short line, whatever its ends are: nearly all of them.
#[inline]
pub(super) fn at_a_glance<H>(walk: &mut Walk<'_, H>) -> Result<Option<Met>, ReadError>
where
    H: HeightField + ?Sized,
{
    if walk.manner.plain || !is_short(walk.a, walk.b) { Ok(None) } else { walk.glance() }
}

/// Walks AB until it is blocked (when `strict`, by contact too) or ends, passing over what the blocks settle.
/// `is_inside` says whether [`Walk::is_inside`].
pub(super) fn walk<K, H>(walk: &mut Walk<'_, H>, is_inside: bool, strict: bool) -> Result<Met, ReadError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    if !walk.manner.plain && is_inside {
        return walk_inside::<K, H>(walk, strict);
    }
    let mut met = Met::default();
    walk.ends::<K>(&mut met)?;
    if met.decides(strict) {
        return Ok(met);
    }
    let Some(span) = Span::new(walk.posts.grid(), walk.a, walk.b) else { return Ok(met) };
    let sweeps = Family::ALL.map(|family| Sweep::new(family, walk.posts.grid(), span, walk.a, walk.b));
    if walk.manner.plain || !skip::walk::<K, H>(walk, &sweeps, span, strict, &mut met)? {
        walk_all::<K, H>(walk, &sweeps, strict, &mut met)?;
    }
    Ok(met)
}

/// The same for a line that [`Walk::is_inside`] and was not settled [`at_a_glance`]. What decides most lines at the least
/// cost comes first.
fn walk_inside<K, H>(walk: &mut Walk<'_, H>, strict: bool) -> Result<Met, ReadError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    let mut met = Met::default();
    let (a, b) = (walk.a, walk.b);
    let [wide, high] = [0, 1].map(|k: usize| (b[k] - a[k]).abs());
    let families = if wide > high { Family::ALL } else { Family::ROWS_FIRST };
    let grid = walk.posts.grid();
    let sweep = |n: usize| sweep_inside(families[n], grid, a, b);
    if is_short(a, b) {
        for n in 0..families.len() {
            let sweep = sweep(n);
            if !walk.take::<K>(&sweep, 0..sweep.count, strict, &mut met)? {
                return Ok(met);
            }
        }
    } else {
        if skip::is_blocked_at_places(walk, &sweep(0))? {
            return Ok(Met { blocked: true, ..met });
        }
        if skip::is_clear(walk, &mut met)? {
            return Ok(met);
        }
        if let Some(met) = walk.glance()? {
            return Ok(met);
        }
        let sweeps = [0, 1, 2, 3].map(sweep);
        if !skip::walk::<K, H>(walk, &sweeps, Span::ALL, strict, &mut met)? {
            walk_all::<K, H>(walk, &sweeps, strict, &mut met)?;
        }
        if met.decides(strict) {
            return Ok(met);
        }
    }
    if !walk.is_above_at_ends()? {
        walk.ends::<K>(&mut met)?;
    }
    Ok(met)
}

/// The sweep of a family over a line that [`Walk::is_inside`].
#[inline]
fn sweep_inside(family: Family, grid: Grid, a: [f64; 3], b: [f64; 3]) -> Sweep {
    Sweep::over_grid(family, a, b).unwrap_or_else(|| Sweep::new(family, grid, Span::ALL, a, b))
}

/// Walks all crossings, passing over nothing.
fn walk_all<K, H>(walk: &mut Walk<'_, H>, sweeps: &[Sweep; 4], strict: bool, met: &mut Met) -> Result<(), ReadError>
where
    K: Kernel,
    H: HeightField + ?Sized,
{
    let longest = sweeps.iter().map(|s| s.count).max().unwrap_or(0);
    let runs = (longest + RUN - 1) / RUN;
    for run in 0..runs {
        for sweep in sweeps {
            // Lines of a family are equally far apart, so equal shares of crossings are equal stretches of AB.
            let share = sweep.count * run / runs..sweep.count * (run + 1) / runs;
            if !walk.take::<K>(sweep, share, strict, met)? {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// What lies under a crossing.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Found {
    /// Ground outside the grid.
    Outside,
    /// A face with a void corner.
    Unknown,
    /// Known ground, with the sign of the line's height over it.
    Known(Sign),
}

/// A line over a field.
pub(super) struct Walk<'a, H: HeightField + ?Sized> {
    pub(super) posts: Posts<'a, H>,
    pub(super) a: [f64; 3],
    pub(super) b: [f64; 3],
    pub(super) manner: Manner,
}

impl<'a, H: HeightField + ?Sized> Walk<'a, H> {
    pub(super) fn new(field: &'a H, a: [f64; 3], b: [f64; 3]) -> Self {
        Self { posts: Posts::new(field), a, b, manner: Manner::default() }
    }

    /// Decides crossings in a row; whether it is worth going on.
    #[inline]
    pub(super) fn take<K: Kernel>(
        &mut self,
        sweep: &Sweep,
        crossings: Range<i64>,
        strict: bool,
        met: &mut Met,
    ) -> Result<bool, ReadError> {
        let Range { start: mut n, end } = crossings;
        while n < end {
            if sweep.inside {
                let id = PageId::of(self.posts.grid().clamp(sweep.near(n)));
                match run::run(sweep, self.posts.page(id)?, id, n..end, &mut met.unknown) {
                    Stop::Through => {
                        (n..end).for_each(|_| K::settled());
                        return Ok(true);
                    }
                    Stop::Blocked => {
                        met.blocked = true;
                        return Ok(false);
                    }
                    Stop::At(undecided) => {
                        (n..undecided).for_each(|_| K::settled());
                        n = undecided;
                    }
                }
            }
            let found =
                if self.manner.rung == Rung::Fast { self.cross_fast(sweep, n) } else { self.cross::<K>(sweep, n) };
            n += 1;
            match found? {
                Found::Known(Sign::Positive) | Found::Outside => continue,
                Found::Known(Sign::Negative) => met.blocked = true,
                Found::Known(Sign::Zero) => met.contact = true,
                Found::Unknown => met.unknown = true,
            }
            if met.decides(strict) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// All that AB meets, where a [`glance`] tells.
    #[inline]
    fn glance(&mut self) -> Result<Option<Met>, ReadError> {
        let (a, b) = (self.a, self.b);
        let glance = match self.manner.rung {
            Rung::Sure => glance::glance::<f64, H, true>(&mut self.posts, a, b),
            Rung::Rounded => glance::glance::<f64, H, false>(&mut self.posts, a, b),
            Rung::Fast => glance::glance::<f32, H, false>(&mut self.posts, a, b),
        };
        Ok(match glance? {
            Glance::Clear => Some(Met::default()),
            Glance::Blocked => Some(Met { blocked: true, ..Met::default() }),
            Glance::Unsure => None,
        })
    }

    /// Whether both ends are over the grid, with no coordinate so small that sums might be subnormal and no height so
    /// great that products might overflow.
    #[inline]
    pub(super) fn is_inside(&self) -> bool {
        let grid = self.posts.grid();
        let limit = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
        let within = |v: f64, limit: f64| (v >= TINY || v.to_bits() == 0) && v <= limit;
        let end = |p: [f64; 3]| within(p[0], limit[0]) && within(p[1], limit[1]) && p[2].abs() <= TRUSTED_MAGNITUDE;
        end(self.a) && end(self.b)
    }

    /// What the ends meet, and whether AB touches between them without crossing anything.
    fn ends<K: Kernel>(&mut self, met: &mut Met) -> Result<(), ReadError> {
        let grid = self.posts.grid();
        let mut touching = Vec::new();
        for end in [self.a, self.b] {
            let Some(face) = Face::at(grid, plan(end)) else {
                met.unknown = true;
                continue;
            };
            match face.heights(&mut self.posts)? {
                None => met.unknown = true,
                Some(heights) => match face.height_sign::<K>(heights, end) {
                    Sign::Negative => met.blocked = true,
                    Sign::Zero => touching.push(face),
                    Sign::Positive => {}
                },
            }
        }
        // Both ends on the ground of one face: then so is all between them. (A vertical line is excluded: only its
        // lower end may touch.)
        if let [first, second] = touching[..]
            && !are_equal(plan(self.a), plan(self.b))
            && let Some(face) = first.joined(&second)
        {
            let mut known = true;
            for p in face {
                known &= !self.posts.at(p)?.void;
            }
            met.contact |= known;
        }
        Ok(())
    }

    /// Whether both ends of a line that is inside are certainly above known ground.
    ///
    /// Fractions of coordinates are exact. A point so close to the diagonal x + y = 1 that the rounded sum does not say
    /// on which side it lies is off by less than u; so with m the greatest magnitude on the page the ground is off by
    /// less than 4 u m for that, and 16 u m for five roundings of numbers up to 4 m.
    #[inline]
    fn is_above_at_ends(&mut self) -> Result<bool, ReadError> {
        for [x, y, z] in [self.a, self.b] {
            let (i, j) = (x as u32, y as u32);
            let (u, v) = (x - f64::from(i), y - f64::from(j));
            let page = self.posts.page(PageId::of(Post::new(i, j)))?;
            let (i, j, rises) = (i % PAGE_SIDE, j % PAGE_SIDE, (i + j) % 2 == 0);
            let magnitude = page.maxima().magnitude();
            if i + 1 == PAGE_SIDE || j + 1 == PAGE_SIDE || page.has_voids() || magnitude > TRUSTED_MAGNITUDE {
                return Ok(false);
            }
            let [sw, se, nw, ne] = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| page.at(i, j).z);
            let ground = match (rises, u > v, u + v > 1.0) {
                (true, true, _) => sw + u * (se - sw) + v * (ne - se),
                (true, false, _) => sw + v * (nw - sw) + u * (ne - nw),
                (false, _, true) => ne + (1.0 - u) * (nw - ne) + (1.0 - v) * (se - ne),
                (false, _, false) => sw + u * (se - sw) + v * (nw - sw),
            };
            let bound = 32.0 * ROUNDOFF * magnitude + 4.0 * ROUNDOFF * z.abs() + FLUSHED;
            // Not so for NaN.
            let above = z - ground > bound;
            if !above {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Decides crossing `n` of a sweep.
    #[inline]
    pub(super) fn cross<K: Kernel>(&mut self, sweep: &Sweep, n: i64) -> Result<Found, ReadError> {
        let crossing = sweep.crossing(n);
        if !sweep.trusted {
            return self.cross_exactly::<K>(sweep, crossing);
        }
        let (first, last) = sweep.family.posts(crossing.c, self.posts.grid());
        let error = sweep.v_error;
        if crossing.v < first as f64 - error || crossing.v > last as f64 + error {
            return Ok(Found::Outside);
        }
        // Rounds up only below 0, where the fraction is less than the error.
        let v = crossing.v as i64;
        let fraction = crossing.v - v as f64;
        if fraction <= error || 1.0 - fraction <= error {
            return self.cross_near_post::<K>(sweep, crossing, (first, last));
        }
        let (p, q) = self.pair(sweep.family.post(crossing.c, v), sweep.family.post(crossing.c, v + 1))?;
        if p.void || q.void {
            return Ok(Found::Unknown);
        }
        // The interpolated height is off by |q - p| times the error of the fraction, and by at most 6 u max(|p|, |q|)
        // for its three roundings. The bound is infinite or NaN where q - p overflows.
        let rise = q.z - p.z;
        let clearance = crossing.z - (p.z + fraction * rise);
        let bound = sweep.z_error + error * rise.abs() + 8.0 * ROUNDOFF * (p.z.abs() + q.z.abs());
        match settle::<K>(clearance, bound) {
            Some(sign) => Ok(Found::Known(sign)),
            None => self.cross_exactly::<K>(sweep, crossing),
        }
    }

    /// Decides crossing `n` in f32, which takes the height between two posts for what it is even at a post.
    fn cross_fast(&mut self, sweep: &Sweep, n: i64) -> Result<Found, ReadError> {
        let crossing = sweep.crossing_fast(n);
        let (first, last) = sweep.family.posts(crossing.c, self.posts.grid());
        if !(crossing.v >= first as f64 && crossing.v <= last as f64) {
            return Ok(Found::Outside);
        }
        let v = crossing.v as i64;
        let (p, q) = self.pair(sweep.family.post(crossing.c, v), sweep.family.post(crossing.c, (v + 1).min(last)))?;
        if p.void || q.void {
            return Ok(Found::Unknown);
        }
        let fraction = (crossing.v - v as f64) as f32;
        let (from, to) = (p.z as f32, q.z as f32);
        Ok(Found::Known(Sign::of(f64::from(crossing.z as f32 - (from + fraction * (to - from))))))
    }

    /// A crossing so close to a post that it may be on the post or on the edge to either side of it. The ground there
    /// differs from the post's height by at most twice the error of v times the steeper rise.
    fn cross_near_post<K: Kernel>(
        &mut self,
        sweep: &Sweep,
        crossing: Crossing,
        (first, last): (i64, i64),
    ) -> Result<Found, ReadError> {
        let v = (crossing.v.round() as i64).clamp(first, last);
        let at = |v: i64| sweep.family.post(crossing.c, v);
        let post = self.posts.at(at(v))?;
        let mut known = !post.void;
        let mut steepest = 0.0_f64;
        for neighbour in [v - 1, v + 1] {
            if neighbour >= first && neighbour <= last {
                let other = self.posts.at(at(neighbour))?;
                known &= !other.void;
                steepest = steepest.max((other.z - post.z).abs());
            }
        }
        if known {
            let bound = sweep.z_error + 2.0 * sweep.v_error * steepest;
            match settle::<K>(crossing.z - post.z, bound) {
                Some(Sign::Positive) => return Ok(Found::Known(Sign::Positive)),
                // At the border of the grid the crossing may be outside.
                Some(sign) if v > first && v < last => return Ok(Found::Known(sign)),
                _ => {}
            }
        }
        self.cross_exactly::<K>(sweep, crossing)
    }

    /// Decides a crossing by orientations alone; the rounded crossing only says where to begin to look.
    #[cold]
    #[inline(never)]
    fn cross_exactly<K: Kernel>(&mut self, sweep: &Sweep, crossing: Crossing) -> Result<Found, ReadError> {
        let (family, c) = (sweep.family, crossing.c);
        let Some((v, on_post)) = self.place::<K>(sweep, crossing) else { return Ok(Found::Outside) };
        let p = self.posts.at(family.post(c, v))?;
        let space = |v: i64, z: f64| {
            let [x, y] = family.point(c, v);
            [x, y, z]
        };
        if on_post {
            // Any height does for the second point: the line meets the edge at the first.
            let sign = orient3d_with::<K>(self.a, self.b, space(v, p.z), space(v + 1, p.z)).times(sweep.turn);
            return Ok(if p.void { Found::Unknown } else { Found::Known(sign) });
        }
        let q = self.posts.at(family.post(c, v + 1))?;
        if p.void || q.void {
            return Ok(Found::Unknown);
        }
        if compare(p.z, q.z) == Sign::Zero && compare(self.a[2], self.b[2]) == Sign::Zero {
            // Level line over a level edge: as common as lakes, and a comparison.
            return Ok(Found::Known(compare(self.a[2], p.z)));
        }
        Ok(Found::Known(orient3d_with::<K>(self.a, self.b, space(v, p.z), space(v + 1, q.z)).times(sweep.turn)))
    }

    /// The post at or before a crossing, along its line, and whether the crossing is on that post; `None` outside the
    /// grid. By orientations alone.
    pub(super) fn place<K: Kernel>(&self, sweep: &Sweep, crossing: Crossing) -> Option<(i64, bool)> {
        let (a, b) = (plan(self.a), plan(self.b));
        // Along the line this grows from negative to positive, with a zero where AB meets a post.
        let side = |v: i64| orient2d_with::<K>(a, b, sweep.family.point(crossing.c, v)).times(sweep.turn);
        locate(side, sweep.family.posts(crossing.c, self.posts.grid()), crossing.v)
    }

    /// Two posts, which mostly lie in one page.
    #[inline]
    fn pair(&mut self, p: Post, q: Post) -> Result<(DrawnPost, DrawnPost), ReadError> {
        let page = PageId::of(p);
        if page != PageId::of(q) {
            return Ok((self.posts.at(p)?, self.posts.at(q)?));
        }
        let page = self.posts.page(page)?;
        Ok((page.at(p.i % PAGE_SIDE, p.j % PAGE_SIDE), page.at(q.i % PAGE_SIDE, q.j % PAGE_SIDE)))
    }
}

/// The greatest v in `first..=last` with `side(v) <= 0`, and whether it is zero there; `None` when the line passes
/// below first or beyond last. `side` grows; `hint` is probably near.
fn locate(side: impl Fn(i64) -> Sign, (first, last): (i64, i64), hint: f64) -> Option<(i64, bool)> {
    // Casts of NaN and of what is out of range end up within the range too.
    let guess = (hint.floor() as i64).clamp(first, last);
    let (mut low, mut high) = (first, last);
    match (side(guess), guess < last) {
        (Sign::Zero, _) => return Some((guess, true)),
        (Sign::Negative, true) => match side(guess + 1) {
            Sign::Positive => return Some((guess, false)),
            Sign::Zero => return Some((guess + 1, true)),
            Sign::Negative => low = guess + 1,
        },
        (Sign::Negative, false) => return None,
        (Sign::Positive, _) => high = guess,
    }
    // Now search [low, high]: beyond last, or before first, there is nothing.
    match (side(low), side(high)) {
        (Sign::Zero, _) => return Some((low, true)),
        (_, Sign::Zero) => return Some((high, true)),
        (Sign::Positive, _) | (_, Sign::Negative) => return None,
        _ => {}
    }
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        match side(middle) {
            Sign::Negative => low = middle,
            Sign::Zero => return Some((middle, true)),
            Sign::Positive => high = middle,
        }
    }
    Some((low, false))
}

/// The sign of a value known to within `bound`.
#[inline]
fn settle<K: Kernel>(value: f64, bound: f64) -> Option<Sign> {
    let sign = if !K::FILTERS {
        return None;
    } else if value > bound {
        Sign::Positive
    } else if value < -bound {
        Sign::Negative
    } else {
        return None;
    };
    K::settled();
    Some(sign)
}
