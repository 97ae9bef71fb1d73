//! Which of many points see which: every pair asked once, since A sees B exactly when B sees A.

use rayon::prelude::*;

use super::{Lines, LosError, Options, Verdict};
use crate::terrain::HeightField;

/// The verdicts between points.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Matrix {
    /// For each point, the verdicts on the lines to itself and to those after it.
    rows: Vec<Vec<Verdict>>,
}

impl Matrix {
    /// How many points there are.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The verdict between two points, in either order.
    ///
    /// # Panics
    /// When one of them is not below [`Matrix::len`].
    pub fn between(&self, m: usize, n: usize) -> Verdict {
        self.rows[m.min(n)][m.max(n) - m.min(n)]
    }

    /// How many pairs of two different points have this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.rows.iter().flat_map(|row| &row[1..]).filter(|&&found| found == verdict).count()
    }
}

/// The verdicts between all of `points`, over all cores. A point that is `None` has no ground to stand on: UNKNOWN to
/// all. The first error in order of pairs wins.
pub fn matrix<H>(field: &H, points: &[Option<[f64; 3]>], options: Options) -> Result<Matrix, LosError>
where
    H: HeightField + ?Sized,
{
    let row = |m: usize| {
        let mut lines = Lines::new(field);
        let mut ask = |b: &Option<[f64; 3]>| match (points[m], *b) {
            (Some(a), Some(b)) => Ok(lines.ask(a, b, options)?.verdict),
            _ => Ok(Verdict::Unknown),
        };
        points[m..].iter().map(&mut ask).collect::<Result<Vec<_>, LosError>>()
    };
    let rows: Vec<_> = (0..points.len()).into_par_iter().map(row).collect();
    Ok(Matrix { rows: rows.into_iter().collect::<Result<_, _>>()? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        los::{line_of_sight, on_ground},
        terrain::synthetic,
    };

    #[test]
    fn each_pair_has_the_verdict_of_its_own_query_in_both_directions() {
        let field = synthetic::fractal(60, 60, 4, 60).unwrap();
        let points: Vec<_> = (0..12_u64)
            .map(|n| {
                let at = |k: u64| (synthetic::mix(2 * n + k) % 700) as f64 / 10.0;
                on_ground(&field, at(0), at(1), 2.0).unwrap().map(|z| [at(0), at(1), z])
            })
            .collect();
        assert!(points.iter().any(Option::is_none) && points.iter().filter(|p| p.is_some()).count() > 5);
        let matrix = matrix(&field, &points, Options::default()).unwrap();
        assert_eq!((matrix.len(), matrix.is_empty()), (12, false));
        for (m, a) in points.iter().enumerate() {
            for (n, b) in points.iter().enumerate() {
                let expected = match (a, b) {
                    (Some(a), Some(b)) => line_of_sight(&field, *a, *b, Options::default()).unwrap().verdict,
                    _ => Verdict::Unknown,
                };
                assert_eq!(matrix.between(m, n), expected, "{m} and {n}");
            }
        }
        let pairs: usize = [Verdict::Visible, Verdict::Blocked, Verdict::Unknown].map(|v| matrix.count(v)).iter().sum();
        assert_eq!(pairs, 66);
        assert!(matrix.count(Verdict::Visible) > 0 && matrix.count(Verdict::Blocked) > 0);
    }
}
