//! The reference: verdicts straight from the definitions, in whole numbers, without filters, slowly.
//!
//! Shares no code with the rest of this module: not the predicates, not the crossings, not the way to find faces. Each
//! post, open edge and open triangle near the line is a list of conditions on the parameter t of AB, each condition
//! the sign of a linear function of t. "Some point of AB over this face is strictly below the surface" is one more
//! condition, and the answer is whether the conditions have a common solution with 0 <= t <= 1. Faces are taken from
//! the cells that the plan line meets, column by column of the grid.
//!
//! All numbers are integers: coordinates are multiplied by a common power of two, which changes no sign; solutions are
//! fractions of them. This is rational arithmetic that leaves out the cancelling.

mod fractions;

use std::cmp::Ordering;

use num_bigint::{BigInt, Sign};
use num_traits::{Signed, Zero};
use sightline_proto::diamond::Post;

pub use self::fractions::{Exactly, exactly};
use super::{Answer, LosError, Options, Verdict};
use crate::terrain::{HeightField, Posts};

/// The line of sight from `a` to `b`, by definition. Costs a fraction of a millisecond a cell; on a curved Earth, of
/// every cell of the grid.
pub fn line_of_sight<H>(field: &H, a: [f64; 3], b: [f64; 3], options: Options) -> Result<Answer, LosError>
where
    H: HeightField + ?Sized,
{
    if !options.earth.is_flat() {
        return fractions::line_of_sight(field, a, b, options);
    }
    super::check_finite(a, ["ax", "ay", "az"])?;
    super::check_finite(b, ["bx", "by", "bz"])?;
    let plan = Plan::new(a, b);
    let mut question = Question { posts: Posts::new(field), plan, z: [a[2], b[2]], found: Found::default() };
    question.outside();
    question.cells()?;
    let Found { below, unknown, contact } = question.found;
    let verdict = match (below || options.strict && contact, unknown) {
        (true, _) => Verdict::Blocked,
        (_, true) => Verdict::Unknown,
        _ => Verdict::Visible,
    };
    Ok(Answer { verdict, grazes: verdict == Verdict::Visible && contact, certain: true })
}

/// A linear function of t, by its values at t = 0 and t = 1.
#[derive(Clone, Debug)]
struct Linear {
    at_a: BigInt,
    at_b: BigInt,
}

/// What a function must be for a point to count.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Must {
    BePositive,
    BeZero,
}

/// A bound of t: numerator, denominator above 0, and whether t must not reach it.
type Bound = (BigInt, BigInt, bool);

/// Whether some t, 0 <= t <= 1 (0 < t < 1 when `between`), meets all conditions.
fn solvable(conditions: &[(&Linear, Must)], between: bool) -> bool {
    let mut low: Bound = (BigInt::zero(), BigInt::from(1), between);
    let mut high: Bound = (BigInt::from(1), BigInt::from(1), between);
    for (function, must) in conditions {
        // f(t) = at_a + t slope.
        let slope = &function.at_b - &function.at_a;
        if slope.is_zero() {
            let holds = match must {
                Must::BePositive => function.at_a.is_positive(),
                Must::BeZero => function.at_a.is_zero(),
            };
            if !holds {
                return false;
            }
            continue;
        }
        let root = match slope.sign() {
            Sign::Minus => (function.at_a.clone(), -&slope),
            _ => (-&function.at_a, slope.clone()),
        };
        let open = *must == Must::BePositive;
        if slope.is_positive() || *must == Must::BeZero {
            raise(&mut low, (root.0.clone(), root.1.clone(), open));
        }
        if slope.is_negative() || *must == Must::BeZero {
            lower(&mut high, (root.0, root.1, open));
        }
    }
    match compare(&low, &high) {
        Ordering::Less => true,
        Ordering::Equal => !low.2 && !high.2,
        Ordering::Greater => false,
    }
}

fn compare(a: &Bound, b: &Bound) -> Ordering {
    (&a.0 * &b.1).cmp(&(&b.0 * &a.1))
}

fn raise(low: &mut Bound, to: Bound) {
    match compare(&to, low) {
        Ordering::Greater => *low = to,
        Ordering::Equal => low.2 |= to.2,
        Ordering::Less => {}
    }
}

fn lower(high: &mut Bound, to: Bound) {
    match compare(&to, high) {
        Ordering::Less => *high = to,
        Ordering::Equal => high.2 |= to.2,
        Ordering::Greater => {}
    }
}

/// Finite numbers as integers after multiplication by the least common power of two that makes them so, at least 1.
fn integers<const N: usize>(values: [f64; N]) -> ([BigInt; N], usize) {
    let parts = values.map(|v| {
        let (mantissa, exponent, sign) = num_traits::Float::integer_decode(v);
        let zeros = mantissa.trailing_zeros().min(63);
        (BigInt::from(mantissa >> zeros) * sign, i64::from(exponent) + i64::from(zeros))
    });
    let nonzero = parts.iter().filter(|(m, _)| !m.is_zero()).map(|&(_, e)| e);
    let least = nonzero.min().unwrap_or(0).min(0);
    let scaled = parts.map(|(m, e)| if m.is_zero() { m } else { m << (e - least) as usize });
    (scaled, least.unsigned_abs() as usize)
}

/// The plan line in integers: posts are multiples of 2^shift.
struct Plan {
    x: [BigInt; 2],
    y: [BigInt; 2],
    shift: usize,
}

impl Plan {
    fn new(a: [f64; 3], b: [f64; 3]) -> Self {
        let ([ax, ay, bx, by], shift) = integers([a[0], a[1], b[0], b[1]]);
        Self { x: [ax, bx], y: [ay, by], shift }
    }

    fn post(&self, p: Post) -> [BigInt; 2] {
        [BigInt::from(p.i) << self.shift, BigInt::from(p.j) << self.shift]
    }

    /// The turn p, q, point of AB: positive to the left of pq.
    fn left_of(&self, p: Post, q: Post) -> Linear {
        let ([px, py], [qx, qy]) = (self.post(p), self.post(q));
        let at = |n: usize| (&qx - &px) * (&self.y[n] - &py) - (&qy - &py) * (&self.x[n] - &px);
        Linear { at_a: at(0), at_b: at(1) }
    }

    /// Distance of the point of AB ahead of p in the direction of q.
    fn ahead_of(&self, p: Post, q: Post) -> Linear {
        let ([px, py], [qx, qy]) = (self.post(p), self.post(q));
        let at = |n: usize| (&qx - &px) * (&self.x[n] - &px) + (&qy - &py) * (&self.y[n] - &py);
        Linear { at_a: at(0), at_b: at(1) }
    }

    /// x or y of the point of AB less that of a post.
    fn beyond(&self, axis: usize, posts: u32) -> Linear {
        let limit = BigInt::from(posts) << self.shift;
        let of = [&self.x, &self.y][axis];
        Linear { at_a: &of[0] - &limit, at_b: &of[1] - &limit }
    }

    /// Conditions of the point of AB being the post.
    fn on_post(&self, p: Post) -> [Linear; 2] {
        [self.beyond(0, p.i), self.beyond(1, p.j)]
    }
}

#[derive(Default)]
struct Found {
    below: bool,
    unknown: bool,
    contact: bool,
}

struct Question<'a, H: HeightField + ?Sized> {
    posts: Posts<'a, H>,
    plan: Plan,
    z: [f64; 2],
    found: Found,
}

impl<H: HeightField + ?Sized> Question<'_, H> {
    /// A point of AB outside the grid rectangle is unknown.
    fn outside(&mut self) {
        let grid = self.posts.grid();
        for (axis, posts) in [(0, grid.nx()), (1, grid.ny())] {
            let above = self.plan.beyond(axis, posts - 1);
            let below = negated(&self.plan.beyond(axis, 0));
            for condition in [above, below] {
                self.found.unknown |= solvable(&[(&condition, Must::BePositive)], false);
            }
        }
    }

    /// Looks at every closed cell that the plan line meets, and perhaps at a neighbour.
    fn cells(&mut self) -> Result<(), LosError> {
        let grid = self.posts.grid();
        let Some((west, east)) = range(&self.plan.x, self.plan.shift, grid.nx() - 1) else { return Ok(()) };
        for i in west..=east {
            let Some((south, north)) = self.rows(i) else { continue };
            for j in south..=north {
                self.cell(i, j)?;
                if self.found.below {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// The cells of column `i` that AB may meet: those between its y where it enters and leaves the closed column.
    fn rows(&self, i: u32) -> Option<(u32, u32)> {
        let rows = self.posts.grid().ny() - 1;
        let slope = &self.plan.x[1] - &self.plan.x[0];
        if slope.is_zero() {
            return range(&self.plan.y, self.plan.shift, rows);
        }
        let mut y = Vec::new();
        for border in [i, i + 1] {
            // y slope at t = (border - x_a) / slope, with t cut to 0..=1, over a positive denominator.
            let ahead = (BigInt::from(border) << self.plan.shift) - &self.plan.x[0];
            let (ahead, slope) = if slope.is_negative() { (-ahead, -&slope) } else { (ahead, slope.clone()) };
            let t = ahead.clamp(BigInt::zero(), slope.clone());
            let scaled = &self.plan.y[0] * &slope + t * (&self.plan.y[1] - &self.plan.y[0]);
            y.push(floor_divide(&scaled, &slope));
            y.push(-floor_divide(&-scaled, &slope));
        }
        let least = y.iter().min()?.clone();
        let greatest = y.iter().max()?.clone();
        range(&[least, greatest], self.plan.shift, rows)
    }

    fn cell(&mut self, i: u32, j: u32) -> Result<(), LosError> {
        let [sw, se, nw, ne] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(di, dj)| Post::new(i + di, j + dj));
        // The diagonal joins the two posts with an even sum; triangles turn counter-clockwise.
        let (diagonal, triangles) = match (i + j) % 2 {
            0 => ([sw, ne], [[sw, se, ne], [sw, ne, nw]]),
            _ => ([se, nw], [[se, ne, nw], [se, nw, sw]]),
        };
        for p in [sw, se, nw, ne] {
            self.post(p)?;
        }
        for edge in [[sw, se], [nw, ne], [sw, nw], [se, ne], diagonal] {
            self.edge(edge)?;
        }
        for triangle in triangles {
            self.triangle(triangle)?;
        }
        Ok(())
    }

    fn post(&mut self, p: Post) -> Result<(), LosError> {
        let [x, y] = self.plan.on_post(p);
        let on = [(&x, Must::BeZero), (&y, Must::BeZero)];
        if !solvable(&on, false) {
            return Ok(());
        }
        let Some([z]) = self.heights([p])? else { return Ok(()) };
        let ([az, bz, z], _) = integers([self.z[0], self.z[1], z]);
        self.judge(&on, Linear { at_a: az - &z, at_b: bz - &z });
        Ok(())
    }

    fn edge(&mut self, [p, q]: [Post; 2]) -> Result<(), LosError> {
        let (left, after, before) = (self.plan.left_of(p, q), self.plan.ahead_of(p, q), self.plan.ahead_of(q, p));
        let on = [(&left, Must::BeZero), (&after, Must::BePositive), (&before, Must::BePositive)];
        if !solvable(&on, false) {
            return Ok(());
        }
        let Some(heights) = self.heights([p, q])? else { return Ok(()) };
        let ([az, bz, zp, zq], _) = integers([self.z[0], self.z[1], heights[0], heights[1]]);
        // The ground is zp + (zq - zp) after / length^2, wherever on the edge; times length^2 it is a whole number.
        let length = &after.at_a + &before.at_a;
        let above = |z: BigInt, ahead: &BigInt| (z - &zp) * &length - (&zq - &zp) * ahead;
        let clearance = Linear { at_a: above(az, &after.at_a), at_b: above(bz, &after.at_b) };
        self.judge(&on, clearance);
        Ok(())
    }

    fn triangle(&mut self, [p, q, r]: [Post; 3]) -> Result<(), LosError> {
        let sides = [self.plan.left_of(q, r), self.plan.left_of(r, p), self.plan.left_of(p, q)];
        let inside = [0, 1, 2].map(|n| (&sides[n], Must::BePositive));
        if !solvable(&inside, false) {
            return Ok(());
        }
        let Some(heights) = self.heights([p, q, r])? else { return Ok(()) };
        let ([az, bz, zp, zq, zr], _) = integers([self.z[0], self.z[1], heights[0], heights[1], heights[2]]);
        // The turns are barycentric weights; their sum is the same everywhere.
        let above = |z: BigInt, of: fn(&Linear) -> &BigInt| {
            let [wp, wq, wr] = [0, 1, 2].map(|n| of(&sides[n]));
            z * (wp + wq + wr) - (wp * &zp + wq * &zq + wr * &zr)
        };
        let clearance = Linear { at_a: above(az, |f| &f.at_a), at_b: above(bz, |f| &f.at_b) };
        self.judge(&inside, clearance);
        Ok(())
    }

    /// The heights of a face that AB meets, or `None` and the discovery that it is unknown.
    fn heights<const N: usize>(&mut self, posts: [Post; N]) -> Result<Option<[f64; N]>, LosError> {
        let mut heights = [0.0; N];
        for (height, p) in heights.iter_mut().zip(posts) {
            let post = self.posts.at(p)?;
            if post.void {
                self.found.unknown = true;
                return Ok(None);
            }
            *height = post.z;
        }
        Ok(Some(heights))
    }

    /// Takes note of whether AB, where it is over the face, is below or on the ground.
    fn judge(&mut self, over: &[(&Linear, Must)], clearance: Linear) {
        let under = negated(&clearance);
        let also = |function, must| over.iter().copied().chain([(function, must)]).collect::<Vec<_>>();
        self.found.below |= solvable(&also(&under, Must::BePositive), false);
        self.found.contact |= solvable(&also(&clearance, Must::BeZero), true) && self.moves();
    }

    /// Whether the ends differ: a line of length zero never grazes.
    fn moves(&self) -> bool {
        self.plan.x[0] != self.plan.x[1] || self.plan.y[0] != self.plan.y[1] || self.z[0] != self.z[1]
    }
}

fn negated(f: &Linear) -> Linear {
    Linear { at_a: -&f.at_a, at_b: -&f.at_b }
}

fn floor_divide(a: &BigInt, b: &BigInt) -> BigInt {
    let (quotient, remainder) = (a / b, a % b);
    if remainder.is_negative() { quotient - 1 } else { quotient }
}

/// The cells along one axis, of `cells`, whose closed range meets that between two coordinates.
fn range(ends: &[BigInt; 2], shift: usize, cells: u32) -> Option<(u32, u32)> {
    let (least, greatest) = (ends.iter().min()?, ends.iter().max()?);
    let unit = BigInt::from(1) << shift;
    // A coordinate on a whole number also meets the cell before it.
    let first = floor_divide(&(least - 1), &unit).max(BigInt::zero());
    let last = floor_divide(greatest, &unit).min(BigInt::from(cells) - 1);
    let cell = |v: BigInt| u32::try_from(v).ok();
    let (first, last) = (cell(first)?, cell(last)?);
    (first <= last && least <= &(BigInt::from(cells) << shift)).then_some((first, last))
}
