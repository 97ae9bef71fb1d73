//! A fan: some of the sectors of a quadrant around A, swept outwards column by column.
//!
//! A cell whose target is above the upper bound of its sector before its own column, and above the one diagonal that
//! its path may cross after that, is VISIBLE (UNKNOWN where all paths of the sector pass over unknown ground); one that
//! is below the lower bound is BLOCKED. Between the bounds the path is followed back ([`super::back`]), and what is
//! still in doubt is asked. The faces that hold the target's post cannot hide it: the ground meets the path there at
//! the post itself.

use super::{
    Asker, Found, Tile, Tiles,
    column::{Column, Frame, Reader, Shot},
    near,
    push::{Gap, Horizon, Sectors, margin},
};
use crate::{
    los::{Lines, LosError, Verdict},
    terrain::{HeightField, PAGE_SIDE, PageId, ReadError},
};

/// Columns that a fan sweeps before tiles are handed over.
const BAND: usize = 64;
/// How far back a path is followed, in columns.
pub(super) const BACK: usize = 16;
const SLOTS: usize = BACK + 2;
/// Sectors for each post that the farthest column has for a slope of 1.
const SECTORS_PER_POST: f64 = 1.0;
/// Cells nearer than this, in posts, are asked.
const ASKED_NEAR: f64 = 3.0;
/// A column nearer than this, in posts, has no part in lower bounds. Posts of farther ones have slopes below 2^6, which
/// makes the error of q 2^-45 scale; edges span at least scale, so shares are off by less than 2^-43.
const NEAREST: f64 = 1.0 / 16.0;
/// A quadrant of fewer sectors is one fan, otherwise two.
const LEAST_FAN: i64 = 128;

/// See the module.
pub(super) struct Fan<'a, H: HeightField + ?Sized> {
    pub(super) asker: &'a Asker<'a, H>,
    lines: Lines<'a, H>,
    pub(super) frame: Frame,
    reader: Reader<'a, H>,
    pub(super) horizon: Horizon,
    /// The sectors whose cells are this fan's.
    own: std::ops::Range<i64>,
    /// Ring n is column `first` + n steps away from A.
    pub(super) n: usize,
    a: i64,
    end: i64,
    columns: Vec<Column>,
    /// Upper bounds: in slot n those before ring n.
    uppers: Vec<Vec<f64>>,
}

impl<'a, H: HeightField + ?Sized> Fan<'a, H> {
    /// The fans that have all cells but the nearest. `unknown`: whether A is over unknown ground.
    pub(super) fn around(asker: &'a Asker<'a, H>, unknown: bool) -> Result<Vec<Self>, ReadError> {
        let [x, y, z] = asker.view.observer;
        let mut fans = Vec::new();
        for axis in [0, 1] {
            let (along, across) = if axis == 0 { (x, y) } else { (y, x) };
            let [east, north] = asker.view.earth.coefficients();
            let bend = if axis == 0 { [east, north] } else { [north, east] };
            for forward in [true, false] {
                let frame = Frame { axis, forward, along, across, z, bend };
                fans.extend(Self::quadrant(asker, frame, unknown)?);
            }
        }
        Ok(fans)
    }

    fn quadrant(asker: &'a Asker<'a, H>, frame: Frame, unknown: bool) -> Result<Vec<Self>, ReadError> {
        let grid = asker.field.grid();
        let last = i64::from(if frame.axis == 0 { grid.nx() } else { grid.ny() }) - 1;
        let mut a = (frame.along.floor() as i64).clamp(-1, last + 1);
        while frame.x(a) < 1.0 {
            a = frame.next(a);
        }
        a = if frame.forward { a.max(0) } else { a.min(last) };
        let [low, high] = asker.cells.extent(frame.axis);
        let end = if frame.forward { frame.next(high) } else { frame.next(low) };
        if if frame.forward { a >= end } else { a <= end } {
            return Ok(Vec::new());
        }
        let scale = (frame.x(frame.before(end)) * SECTORS_PER_POST).ceil().max(8.0);
        let offset = scale + 1.5;
        let count = 2 * scale as i64 + 1;
        let parts = if count < LEAST_FAN { 1 } else { 2 };
        (0..parts)
            .map(|part| {
                let own = 1 + count * part / parts..1 + count * (part + 1) / parts;
                let len = (own.end - own.start) as usize + 2;
                let sectors = Sectors { scale, offset, base: own.start - 1, len };
                let mut fan = Self {
                    asker,
                    lines: asker.lines(),
                    frame,
                    reader: Reader::new(asker.field, frame),
                    horizon: Horizon::new(sectors, if unknown { Gap::All } else { Gap::None }),
                    own,
                    n: 0,
                    a,
                    end,
                    columns: vec![Column::default(); SLOTS],
                    uppers: vec![Vec::new(); SLOTS],
                };
                near::push(&mut fan.horizon, &frame, a, &mut fan.reader)?;
                fan.push_nearest()?;
                fan.horizon.upper(&mut fan.uppers[0]);
                Ok(fan)
            })
            .collect()
    }

    /// The column before the first, if it is ahead of A at all: what it hides, it hides from all cells.
    fn push_nearest(&mut self) -> Result<(), ReadError> {
        let a = self.frame.before(self.a);
        let grid = self.asker.field.grid();
        let last = i64::from(if self.frame.axis == 0 { grid.nx() } else { grid.ny() }) - 1;
        if self.frame.x(a) < NEAREST || a < 0 || a > last {
            return Ok(());
        }
        let mut column = Column::default();
        let (low, high) = self.posts_of(a);
        self.reader.read(&self.horizon.sectors, a, low, high, &mut column)?;
        let margin = margin(&self.frame, &Column::default(), &column);
        self.horizon.push_column(&column, margin);
        Ok(())
    }

    pub(super) fn is_done(&self) -> bool {
        self.a == self.end
    }

    /// Column `n`, one of the last.
    pub(super) fn column(&self, n: usize) -> &Column {
        &self.columns[n % SLOTS]
    }

    /// The upper bounds before column `n`.
    pub(super) fn upper(&self, n: usize) -> &[f64] {
        &self.uppers[n % SLOTS]
    }

    /// Sweeps the next columns.
    pub(super) fn advance(&mut self) -> Result<Found, LosError> {
        let mut found = Found { tiles: Tiles::new(), asked: 0 };
        for _ in 0..BAND {
            if self.is_done() {
                break;
            }
            self.ring(&mut found)?;
            self.a = self.frame.next(self.a);
            self.n += 1;
        }
        Ok(found)
    }

    fn ring(&mut self, found: &mut Found) -> Result<(), LosError> {
        let mut column = std::mem::take(&mut self.columns[self.n % SLOTS]);
        let (first, last) = self.posts_of(self.a);
        self.reader.read(&self.horizon.sectors, self.a, first, last, &mut column)?;
        self.columns[self.n % SLOTS] = column;
        self.cells(found)?;
        let column = &self.columns[self.n % SLOTS];
        let none = Column::default();
        let before = if self.n == 0 { &none } else { &self.columns[(self.n - 1) % SLOTS] };
        let margin = margin(&self.frame, before, column);
        self.horizon.push_strip(before, column, margin);
        self.horizon.push_column(column, margin);
        if before.voids || column.voids {
            self.horizon.mark_gaps(&self.frame, before, column);
        }
        self.horizon.upper(&mut self.uppers[(self.n + 1) % SLOTS]);
        Ok(())
    }

    /// The posts of column `a` that paths to cells of this fan can be near, three more than are between the outermost.
    fn posts_of(&self, a: i64) -> (i64, i64) {
        let (x, sectors) = (self.frame.x(a), &self.horizon.sectors);
        let corridor = self.asker.cells.corridor(self.frame.axis, x);
        let ray = |k: i64| self.frame.across + x * sectors.slope(k);
        let grid = self.asker.field.grid();
        let across = i64::from(if self.frame.axis == 0 { grid.ny() } else { grid.nx() }) - 1;
        let low = ray(sectors.base).max(corridor[0]).floor() as i64 - 3;
        let high = ray(sectors.base + sectors.len as i64).min(corridor[1]).ceil() as i64 + 3;
        (low.max(0), high.min(across))
    }

    /// Decides the cells of the column at hand.
    fn cells(&mut self, found: &mut Found) -> Result<(), LosError> {
        let Some(cells) = self.asker.cells.along(self.frame.axis, self.a) else { return Ok(()) };
        let column = self.column(self.n);
        let ray = |k: i64| self.frame.across + column.x * self.horizon.sectors.slope(k);
        let first = (*cells.start()).max(ray(self.own.start).floor() as i64 - 1).max(column.b);
        let last = (*cells.end()).min(ray(self.own.end).ceil() as i64 + 1).min(column.end() - 1);
        let aim = self.aim();
        let side = i64::from(PAGE_SIDE);
        let mut b = first;
        while b <= last {
            let until = (b / side * side + side - 1).min(last);
            let [i, j] = self.frame.post(self.a, b);
            let page = PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE };
            let tile = found.tiles.entry(page).or_insert_with(|| Tile::new(page));
            for b in b..=until {
                if let Some((verdict, asked)) = self.cell(&aim, b)? {
                    let [i, j] = self.frame.post(self.a, b);
                    tile.set(i, j, verdict);
                    found.asked += u64::from(asked);
                }
            }
            if tile.filled == 0 {
                found.tiles.remove(&page);
            }
            b = until + 1;
        }
        Ok(())
    }

    /// What the targets of the column at hand have in common.
    fn aim(&self) -> Aim {
        let (none, column) = (Column::default(), self.column(self.n));
        let before = if self.n == 0 { &none } else { self.column(self.n - 1) };
        let height = self.asker.view.target_height;
        let rise = height * column.per_x;
        Aim {
            slot: self.n % SLOTS,
            slot_before: (self.n + SLOTS - 1) % SLOTS,
            below_ground: height < 0.0,
            bounded: self.n > 0 && column.x >= ASKED_NEAR && !self.reader.wild,
            rise,
            // The target is rounded up to an f64, and that three times more.
            margin: margin(&self.frame, before, column) + rise / (1_u64 << 40) as f64,
        }
    }

    /// The verdict on the cell of post `b`, and whether it was asked; `None` when it is another fan's.
    #[inline]
    fn cell(&mut self, aim: &Aim, b: i64) -> Result<Option<(Verdict, bool)>, LosError> {
        let column = &self.columns[aim.slot];
        let y = self.frame.y(b);
        // A cell as far along both axes is east's or west's.
        if if self.frame.axis == 0 { y.abs() > column.x } else { y.abs() >= column.x } {
            return Ok(None);
        }
        let post = column.posts[(b - column.b) as usize];
        // The first and the last sector held are another fan's.
        if post.k < 1 || post.k as usize >= self.horizon.sectors.len - 1 {
            return Ok(None);
        }
        if post.s.is_nan() {
            return Ok(Some((Verdict::Unknown, false)));
        }
        if aim.below_ground {
            return Ok(Some((Verdict::Blocked, false)));
        }
        if aim.bounded
            && let Some(verdict) = self.bounded(aim, b, y, post)
        {
            return Ok(Some((verdict, false)));
        }
        let at = self.frame.post(self.a, b);
        let z = self.reader.height(self.a, b)?.unwrap_or(0.0);
        Ok(Some((self.asker.ask(&mut self.lines, at, z)?, true)))
    }

    /// What the bounds say of the target over post `b`, if they are sure.
    #[inline]
    fn bounded(&self, aim: &Aim, b: i64, y: f64, post: Shot) -> Option<Verdict> {
        let (target, margin) = (post.s + aim.rise, aim.margin);
        let bounds = self.bounds(&self.uppers[aim.slot], post);
        if target + margin < bounds.lower {
            return Some(Verdict::Blocked);
        }
        let last = self.last_crossing(aim, b, y, post.q);
        if last > target + margin {
            return Some(Verdict::Blocked);
        }
        // NaN is not clear, and none is.
        let clear = last < target - margin;
        match bounds.gap {
            _ if !clear => None,
            Gap::None if target - margin > bounds.upper => Some(Verdict::Visible),
            Gap::All if target - margin > bounds.upper => Some(Verdict::Unknown),
            Gap::None => self.back(y, post, target, margin),
            _ => None,
        }
    }

    /// What holds for a post, whichever of the sectors that it is too near to tell it is in.
    #[inline]
    pub(super) fn bounds(&self, upper: &[f64], post: Shot) -> Bounds {
        let horizon = &self.horizon;
        let k = post.k as usize;
        let mut bounds = Bounds { upper: upper[k], lower: horizon.lower[k], gap: horizon.gaps[k] };
        if post.is_near_ray {
            for other in horizon.sectors.around(post.q) {
                bounds.upper = bounds.upper.max(upper[other]);
                bounds.lower = bounds.lower.min(horizon.lower[other]);
                if bounds.gap != horizon.gaps[other] {
                    bounds.gap = Gap::Some;
                }
            }
        }
        bounds
    }

    /// The projected height at which the path to post `b` crosses a diagonal after the column before; minus infinity
    /// where it crosses none, NaN where that is unknown.
    #[inline]
    fn last_crossing(&self, aim: &Aim, b: i64, y: f64, q: f64) -> f64 {
        if (self.a + b) & 1 == 0 || y == 0.0 {
            return f64::NEG_INFINITY;
        }
        // A diagonal joins the posts beside this one of even sum; the path comes from the side of A.
        let (column, before) = (&self.columns[aim.slot], &self.columns[aim.slot_before]);
        let beside = if y > 0.0 { b - 1 } else { b + 1 };
        let (Some(from), Some(to)) = (before.post(b), column.post(beside)) else { return f64::NAN };
        from.s + (q - from.q) / (to.q - from.q) * (to.s - from.s)
    }
}

/// What the targets of a column have in common.
struct Aim {
    /// Where the column at hand is held, and the one before.
    slot: usize,
    slot_before: usize,
    below_ground: bool,
    /// Whether bounds may be used.
    bounded: bool,
    /// By how much targets are above their posts, projected.
    rise: f64,
    margin: f64,
}

/// Bounds of the horizon.
pub(super) struct Bounds {
    pub(super) upper: f64,
    lower: f64,
    gap: Gap,
}
