//! The reference in fractions: verdicts on a curved Earth, and derived values, straight from the definitions.
//!
//! Every face of every cell of the grid is a list of linear conditions on the parameter t of AB; together they leave an
//! interval of t. There the clearance is f(t) = f(0) + t (f(1) - f(0)) - W t (1 - t), convex, least at its vertex or at
//! the end nearest to it. Nothing is filtered, skipped or ordered, and no code is shared with the product.

use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::{One, Signed, Zero};
use sightline_proto::diamond::Post;

use super::super::{Answer, Earth, LosError, Options, Verdict, check_finite};
use crate::terrain::{HeightField, Posts};

type Q = BigRational;

/// What follows from a line, exactly.
#[derive(Clone, PartialEq, Default, Debug)]
pub struct Exactly {
    /// The infimum of the t of points strictly below known ground, if there are any. `None` on a curved Earth, where it
    /// is no fraction.
    pub first_t: Option<Q>,
    /// The infimum of the clearance over known ground.
    pub least_clearance: Option<Q>,
    /// The supremum over known ground beyond A of the height of B at which AB touches it. Flat Earth only.
    pub target_height: Option<Q>,
}

/// The verdict by definition. Looks at every cell of the grid.
pub(super) fn line_of_sight<H>(field: &H, a: [f64; 3], b: [f64; 3], options: Options) -> Result<Answer, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite(b, ["bx", "by", "bz"])?;
    let all = Line::new(a, b, options.earth).all(field)?;
    let below = all.known.iter().any(Chord::is_below);
    let contact = a != b && all.known.iter().any(Chord::touches);
    let verdict = match (below || options.strict && contact, all.unknown) {
        (true, _) => Verdict::Blocked,
        (_, true) => Verdict::Unknown,
        _ => Verdict::Visible,
    };
    Ok(Answer { verdict, grazes: verdict == Verdict::Visible && contact, certain: true })
}

/// Derived values by definition. Looks at every cell of the grid.
pub fn exactly<H>(field: &H, a: [f64; 3], b: [f64; 3], earth: Earth) -> Result<Exactly, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite(b, ["bx", "by", "bz"])?;
    let line = Line::new(a, b, earth);
    let known = line.all(field)?.known;
    let first = known.iter().filter(|_| line.w.is_zero()).filter_map(Chord::first_below).min();
    let target = known.iter().filter(|_| line.w.is_zero()).filter_map(|chord| chord.needed(&line)).max();
    Ok(Exactly {
        first_t: first,
        least_clearance: known.iter().map(|chord| chord.at(&chord.vertex())).min(),
        target_height: target,
    })
}

fn q(v: f64) -> Q {
    Q::from_float(v).unwrap_or_default()
}

fn whole(v: i64) -> Q {
    Q::from(BigInt::from(v))
}

/// AB in fractions.
struct Line {
    from: [Q; 3],
    by: [Q; 3],
    w: Q,
}

/// A linear function of t by its values at 0 and 1, and whether it must be above 0 or be 0.
struct Condition {
    at_a: Q,
    at_b: Q,
    positive: bool,
}

/// What AB is over.
#[derive(Default)]
struct All {
    known: Vec<Chord>,
    unknown: bool,
}

/// AB over one face.
struct Chord {
    low: Q,
    high: Q,
    low_open: bool,
    high_open: bool,
    /// Clearance at t = 0 and t = 1 over the face, extended; and W.
    f: [Q; 2],
    w: Q,
}

impl Line {
    fn new(a: [f64; 3], b: [f64; 3], earth: Earth) -> Self {
        let (from, to) = (a.map(q), b.map(q));
        let by = [0, 1, 2].map(|k| &to[k] - &from[k]);
        let [east, north] = earth.coefficients().map(q);
        let w = &by[0] * &by[0] * east + &by[1] * &by[1] * north;
        Self { from, by, w }
    }

    fn all<H: HeightField + ?Sized>(&self, field: &H) -> Result<All, LosError> {
        let (mut posts, mut all) = (Posts::new(field), All::default());
        let grid = field.grid();
        let [east, north] = [grid.nx() - 1, grid.ny() - 1];
        for (axis, last) in [(0, east), (1, north)] {
            let end = [self.from[axis].clone(), &self.from[axis] + &self.by[axis]];
            all.unknown |= end.iter().any(|v| v.is_negative() || *v > whole(i64::from(last)));
        }
        for (j, i) in (0..=north).flat_map(|j| (0..=east).map(move |i| (j, i))) {
            let at = |di: u32, dj: u32| Post::new(i + di, j + dj);
            let mut faces = vec![vec![at(0, 0)]];
            if i < east {
                faces.push(vec![at(0, 0), at(1, 0)]);
            }
            if j < north {
                faces.push(vec![at(0, 0), at(0, 1)]);
            }
            if i < east && j < north {
                let (diagonal, others) = match (i + j) % 2 {
                    0 => ([at(0, 0), at(1, 1)], [at(1, 0), at(0, 1)]),
                    _ => ([at(1, 0), at(0, 1)], [at(0, 0), at(1, 1)]),
                };
                faces.push(diagonal.to_vec());
                faces.extend(others.map(|other| vec![diagonal[0], diagonal[1], other]));
            }
            for face in faces {
                self.face(&mut posts, &face, &mut all)?;
            }
        }
        Ok(all)
    }

    fn face<H>(&self, posts: &mut Posts<'_, H>, face: &[Post], all: &mut All) -> Result<(), LosError>
    where
        H: HeightField + ?Sized,
    {
        if (0..2).any(|axis| self.passes_by(face, axis)) {
            return Ok(());
        }
        let weights = [0, 1].map(|t| self.weights(face, t));
        let mut conditions: Vec<_> = (0..weights[0].0.len())
            .map(|n| Condition { at_a: weights[0].0[n].clone(), at_b: weights[1].0[n].clone(), positive: true })
            .collect();
        conditions.extend((0..weights[0].1.len()).map(|n| Condition {
            at_a: weights[0].1[n].clone(),
            at_b: weights[1].1[n].clone(),
            positive: false,
        }));
        let Some((low, low_open, high, high_open)) = interval(&conditions) else { return Ok(()) };
        let mut heights = Vec::new();
        for &p in face {
            let post = posts.at(p)?;
            if post.void {
                all.unknown = true;
                return Ok(());
            }
            heights.push(q(post.z));
        }
        let f = [0, 1].map(|t: i64| {
            let ground: Q = weights[t as usize].0.iter().zip(&heights).map(|(w, z)| w * z).sum();
            &self.from[2] + &self.by[2] * whole(t) - ground
        });
        all.known.push(Chord { low, high, low_open, high_open, f, w: self.w.clone() });
        Ok(())
    }

    /// Whether AB and a face have no coordinate in common.
    fn passes_by(&self, face: &[Post], axis: usize) -> bool {
        let of = |p: &Post| whole(i64::from([p.i, p.j][axis]));
        let ends = [self.from[axis].clone(), &self.from[axis] + &self.by[axis]];
        face.iter().all(|p| ends.iter().all(|end| of(p) < *end))
            || face.iter().all(|p| ends.iter().all(|end| of(p) > *end))
    }

    /// The barycentric weights of the point of AB at t = 0 or 1 in a face, and what must be 0 for it to be in its span.
    fn weights(&self, face: &[Post], t: i64) -> (Vec<Q>, Vec<Q>) {
        let at = [0, 1].map(|k| &self.from[k] + &self.by[k] * whole(t));
        let offset = |p: Post| [&at[0] - whole(i64::from(p.i)), &at[1] - whole(i64::from(p.j))];
        let d = offset(face[0]);
        let leg = |n: usize| {
            [whole(i64::from(face[n].i) - i64::from(face[0].i)), whole(i64::from(face[n].j) - i64::from(face[0].j))]
        };
        match face.len() {
            1 => (vec![Q::one()], d.to_vec()),
            2 => {
                let u = leg(1);
                let along = (&d[0] * &u[0] + &d[1] * &u[1]) / (&u[0] * &u[0] + &u[1] * &u[1]);
                (vec![Q::one() - &along, along], vec![&d[0] * &u[1] - &d[1] * &u[0]])
            }
            _ => {
                let (u, v) = (leg(1), leg(2));
                let area = &u[0] * &v[1] - &u[1] * &v[0];
                let second = (&d[0] * &v[1] - &d[1] * &v[0]) / &area;
                let third = (&u[0] * &d[1] - &u[1] * &d[0]) / &area;
                (vec![Q::one() - &second - &third, second, third], Vec::new())
            }
        }
    }
}

/// The t in 0..=1 that meet all conditions.
fn interval(conditions: &[Condition]) -> Option<(Q, bool, Q, bool)> {
    let (mut low, mut low_open, mut high, mut high_open) = (Q::zero(), false, Q::one(), false);
    for Condition { at_a, at_b, positive } in conditions {
        let slope = at_b - at_a;
        if slope.is_zero() {
            if if *positive { at_a.is_positive() } else { at_a.is_zero() } {
                continue;
            }
            return None;
        }
        let root = -at_a / &slope;
        if !positive || slope.is_positive() {
            if root > low {
                (low, low_open) = (root.clone(), *positive);
            } else if root == low {
                low_open |= positive;
            }
        }
        if !positive || slope.is_negative() {
            if root < high {
                (high, high_open) = (root, *positive);
            } else if root == high {
                high_open |= positive;
            }
        }
    }
    (low < high || low == high && !low_open && !high_open).then_some((low, low_open, high, high_open))
}

impl Chord {
    fn at(&self, t: &Q) -> Q {
        &self.f[0] + t * (&self.f[1] - &self.f[0]) - &self.w * t * (Q::one() - t)
    }

    /// Where on the closed chord the clearance is least.
    fn vertex(&self) -> Q {
        let slope = &self.f[1] - &self.f[0];
        if self.w.is_zero() {
            return if slope.is_negative() { self.high.clone() } else { self.low.clone() };
        }
        let vertex = (&self.w - slope) / (&self.w * whole(2));
        vertex.clamp(self.low.clone(), self.high.clone())
    }

    /// Whether some point is strictly below the ground. What holds at an open end holds beside it.
    fn is_below(&self) -> bool {
        self.at(&self.vertex()).is_negative()
    }

    /// Whether some point strictly between the ends of AB is on the ground, given that none is below.
    fn touches(&self) -> bool {
        let inside = |t: &Q| t.is_positive() && *t < Q::one();
        let vertex = self.vertex();
        if !self.at(&vertex).is_zero() {
            return false;
        }
        if self.low < self.high && self.w.is_zero() && self.f[0] == self.f[1] {
            return true;
        }
        let reached = (vertex != self.low || !self.low_open) && (vertex != self.high || !self.high_open);
        inside(&vertex) && reached
    }

    /// The infimum of t strictly below, where W is 0.
    fn first_below(&self) -> Option<Q> {
        if !self.is_below() {
            return None;
        }
        if self.at(&self.low).is_negative() {
            return Some(self.low.clone());
        }
        Some(&self.f[0] / (&self.f[0] - &self.f[1]))
    }

    /// The greatest height of B at which AB touches the ground here, where W is 0.
    fn needed(&self, line: &Line) -> Option<Q> {
        // The ground is az + t dz - f(t); the line at height az + t h touches it where h = dz - f(t) / t.
        let ends = [&self.low, &self.high].into_iter().filter(|t| t.is_positive());
        ends.map(|t| &line.from[2] + &line.by[2] - self.at(t) / t).max()
    }
}
