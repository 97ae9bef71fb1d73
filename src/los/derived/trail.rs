//! The crossings of AB with all four families of edge lines, in exact order from A to B.
//!
//! Each [`Sweep`] numbers its crossings in order, so this is a merge of four. Two rounded parameters further apart than
//! their errors tell the order; otherwise the point P where the two lines meet does: it is a post (columns and rows
//! meet at posts, and so does everything with the diagonals), and on which side of AB it lies is an orientation. Say
//! line 1 runs in direction r and is crossed at X = P + s r; the side of P tells the sign of s; the function g of line
//! 2 has g(X) - c = s (r . grad g), and its growth along AB then says whether X is before or beyond the crossing with
//! line 2. Nothing here divides.

use std::cmp::Ordering;

use sightline_proto::predicates::{Exact, Sign, orient2d_with};

use crate::los::sweep::{Family, Sweep};

/// A crossing, by the number of its sweep and its own in it.
#[derive(Clone, Copy, Debug)]
pub(in crate::los) struct Step {
    pub(in crate::los) sweep: usize,
    pub(in crate::los) n: i64,
}

/// The next crossing of one family.
#[derive(Clone, Copy, Debug)]
struct Head {
    n: i64,
    c: i64,
    t: f64,
}

/// A merge of four sweeps.
#[derive(Clone, Debug)]
pub(in crate::los) struct Trail {
    pub(in crate::los) sweeps: [Sweep; 4],
    heads: [Option<Head>; 4],
    a: [f64; 2],
    b: [f64; 2],
}

impl Trail {
    pub(in crate::los) fn new(sweeps: [Sweep; 4], a: [f64; 2], b: [f64; 2]) -> Self {
        let mut trail = Self { sweeps, heads: [None; 4], a, b };
        for sweep in 0..4 {
            trail.heads[sweep] = trail.head(sweep, 0);
        }
        trail
    }

    fn head(&self, sweep: usize, n: i64) -> Option<Head> {
        let sweep = &self.sweeps[sweep];
        (n >= 0 && n < sweep.count).then(|| {
            let c = sweep.line(n);
            Head { n, c, t: sweep.parameter(c) }
        })
    }

    /// The next crossing; where AB meets a post, that of one family stands for all.
    pub(in crate::los) fn step(&mut self) -> Option<Step> {
        let mut best: Option<(usize, Head)> = None;
        let mut together = [false; 4];
        for sweep in 0..4 {
            let Some(head) = self.heads[sweep] else { continue };
            let order = best.map_or(Ordering::Less, |(other, at)| self.order((sweep, head), (other, at)));
            match order {
                Ordering::Less => {
                    together = [false; 4];
                    best = Some((sweep, head));
                }
                Ordering::Equal => {}
                Ordering::Greater => continue,
            }
            together[sweep] = true;
        }
        let (sweep, head) = best?;
        for other in (0..4).filter(|&other| together[other]) {
            let next = self.heads[other].map_or(0, |at| at.n + 1);
            self.heads[other] = self.head(other, next);
        }
        Some(Step { sweep, n: head.n })
    }

    /// The last crossing before those to come.
    pub(in crate::los) fn before(&self) -> Option<Step> {
        self.passed().map(|(sweep, head)| Step { sweep, n: head.n })
    }

    fn passed(&self) -> Option<(usize, Head)> {
        let mut best: Option<(usize, Head)> = None;
        for sweep in 0..4 {
            let to_come = self.heads[sweep].map_or(self.sweeps[sweep].count, |head| head.n);
            let Some(head) = self.head(sweep, to_come - 1) else { continue };
            if best.is_none_or(|(other, at)| self.order((sweep, head), (other, at)) == Ordering::Greater) {
                best = Some((sweep, head));
            }
        }
        best
    }

    /// Passes over the crossings of a stretch that ends at `t`, as [`Sweep::until`] counts them; whether there are any.
    ///
    /// By its rounded number a crossing of one family may be passed and an earlier one of another not, so those that
    /// come before the last one passed, or with it, follow: they are no further from the stretch than that one.
    pub(in crate::los) fn pass(&mut self, t: f64) -> bool {
        let mut any = false;
        for sweep in 0..4 {
            if let Some(head) = self.heads[sweep] {
                let n = self.sweeps[sweep].until(t);
                if n > head.n {
                    any = true;
                    self.heads[sweep] = self.head(sweep, n);
                }
            }
        }
        let Some((last, at)) = self.passed().filter(|_| any) else { return false };
        for sweep in (0..4).filter(|&sweep| sweep != last) {
            while let Some(head) = self.heads[sweep]
                && self.order((sweep, head), (last, at)) != Ordering::Greater
            {
                self.heads[sweep] = self.head(sweep, head.n + 1);
            }
        }
        true
    }

    /// The order of two crossings of different families along AB; equal at a post.
    fn order(&self, (s1, x1): (usize, Head), (s2, x2): (usize, Head)) -> Ordering {
        let (first, second) = (&self.sweeps[s1], &self.sweeps[s2]);
        if (x1.t - x2.t).abs() > first.t_error + second.t_error {
            return x1.t.total_cmp(&x2.t);
        }
        self.exact_order((first, x1.c), (second, x2.c))
    }

    #[cold]
    fn exact_order(&self, (first, c1): (&Sweep, i64), (second, c2): (&Sweep, i64)) -> Ordering {
        let post = meeting(first.family, c1, second.family, c2);
        // Positive when P is beyond the crossing with line 1, along that line.
        let beyond = orient2d_with::<Exact>(self.a, self.b, post).times(first.turn);
        let grows = second.turn.times(second.family.turn());
        match (-beyond).times(along_gradient(first.family, second.family)).times(grows) {
            Sign::Negative => Ordering::Less,
            Sign::Zero => Ordering::Equal,
            Sign::Positive => Ordering::Greater,
        }
    }
}

/// Where a line of one family meets one of another.
fn meeting(first: Family, c1: i64, second: Family, c2: i64) -> [f64; 2] {
    use Family::{Column, Falling, Rising, Row};
    let [x, y] = match (first, second) {
        (Column, Row) => [c1, c2],
        (Column, Rising) => [c1, c1 - c2],
        (Column, Falling) => [c1, c2 - c1],
        (Row, Rising) => [c2 + c1, c1],
        (Row, Falling) => [c2 - c1, c1],
        (Rising, Falling) => [(c1 + c2) / 2, (c2 - c1) / 2],
        (Column, Column) | (Row, Row) | (Rising, Rising) | (Falling, Falling) => {
            debug_assert!(false, "lines of one family do not meet");
            [0, 0]
        }
        _ => return meeting(second, c2, first, c1),
    };
    [x as f64, y as f64]
}

/// The sign by which the function of `second` grows along lines of `first`.
fn along_gradient(first: Family, second: Family) -> Sign {
    let direction = |family| match family {
        Family::Column => [0, 1],
        Family::Row => [1, 0],
        Family::Rising => [1, 1],
        Family::Falling => [1, -1],
    };
    let gradient = |family| match family {
        Family::Column => [1, 0],
        Family::Row => [0, 1],
        Family::Rising => [1, -1],
        Family::Falling => [1, 1],
    };
    let (r, g) = (direction(first), gradient(second));
    Sign::of(f64::from(r[0] * g[0] + r[1] * g[1]))
}
