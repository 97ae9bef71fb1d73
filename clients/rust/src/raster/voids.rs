//! Where a terrain has no data, as samples of the whole: ground is drawn there, filled in, but nobody knows it.

/// Most samples along a side. Of larger terrains evenly spread posts are looked at, and smaller holes may be missed.
const MOST_SAMPLES: u32 = 512;

/// Samples over the extent of a [`super::Surface`], from its south-west corner to its north-east one.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Voids {
    columns: usize,
    rows: usize,
    /// Row by row from the south.
    cells: Vec<bool>,
}

impl Voids {
    /// Those of `cells`, which are row by row from the south; `None` where there are none, or `cells` has another size.
    pub fn new(columns: usize, rows: usize, cells: Vec<bool>) -> Option<Self> {
        let fits = columns.checked_mul(rows) == Some(cells.len());
        (fits && cells.contains(&true)).then_some(Self { columns, rows, cells })
    }

    /// The posts along an axis of so many that samples are taken at: all, or evenly spread ones with both ends.
    pub fn samples(posts: u32) -> Vec<u32> {
        let count = u64::from(posts.min(MOST_SAMPLES));
        let last = u64::from(posts.saturating_sub(1));
        (0..count).map(|n| ((2 * n * last + count - 1) / (2 * (count - 1)).max(1)) as u32).collect()
    }

    /// Whether there is no data at a place, given as fractions of the extent from the west and from the south.
    pub(super) fn at(&self, [east, north]: [f64; 2]) -> bool {
        let nearest = |fraction: f64, count: usize| {
            let last = count.saturating_sub(1);
            ((fraction * last as f64).round().max(0.0) as usize).min(last)
        };
        self.cells[nearest(north, self.rows) * self.columns + nearest(east, self.columns)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_all_posts_or_spread_evenly_with_both_ends() {
        assert_eq!(Voids::samples(5), [0, 1, 2, 3, 4]);
        let spread = Voids::samples(100_001);
        assert_eq!((spread.len(), spread[0], spread[511]), (512, 0, 100_000));
        assert!(spread.windows(2).all(|pair| (195..=196).contains(&(pair[1] - pair[0]))));
        assert_eq!(Voids::samples(1), [0]);
    }

    #[test]
    fn a_place_has_the_sample_nearest_to_it() {
        assert_eq!(Voids::new(2, 2, vec![false; 4]), None);
        assert_eq!(Voids::new(2, 3, vec![true; 4]), None);
        let voids = Voids::new(3, 2, vec![false, false, true, false, false, false]).unwrap();
        assert!(voids.at([0.8, 0.4]) && voids.at([1.0, 0.0]) && voids.at([7.0, -1.0]));
        assert!(!voids.at([0.7, 0.4]) && !voids.at([1.0, 0.6]));
    }
}
