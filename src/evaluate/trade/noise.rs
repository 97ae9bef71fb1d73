//! Synthetic terrains made by the five methods that Inam's "Evaluation of Terrain Rendering Algorithms" (2005), section
//! 3.2.1, names, as heights of 8 bits, which the thesis used.
//!
//! The thesis made its terrains with TerraGen 0.9 and gives neither seeds nor settings; what it says of each ("more flat
//! terrain than mountains", "mountains close to each other") is followed here. Midpoint displacement after Fournier, Fussell
//! and Carpenter, "Computer rendering of stochastic models", 1982; noise after Perlin, "Improving noise", 2002;
//! multifractals after Musgrave in Ebert et al., "Texturing and Modeling", chapter 16. Only + - x / and square roots are
//! used: the same on every machine.

use crate::terrain::{GridError, MemoryField, synthetic::mix};

/// Greatest height: 8 bits.
const GREATEST: f64 = 255.0;
/// Posts across one cell of the coarsest octave, as a share of the side: four cells.
const COARSEST: u32 = 4;
const OCTAVES: u32 = 5;

/// How a terrain is made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Method {
    SubdivideAndDisplace,
    Perlin,
    MultiPerlin,
    Ridged,
    RidgedMulti,
}

impl Method {
    /// Those of the thesis, in its order.
    pub(super) const ALL: [Self; 5] =
        [Self::SubdivideAndDisplace, Self::Perlin, Self::MultiPerlin, Self::Ridged, Self::RidgedMulti];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::SubdivideAndDisplace => "subdivide and displace",
            Self::Perlin => "Perlin",
            Self::MultiPerlin => "multi-Perlin",
            Self::Ridged => "ridged",
            Self::RidgedMulti => "ridged multi",
        }
    }

    /// Whether the thesis says that it is more mountains than plains.
    pub(super) fn is_jagged(self) -> bool {
        matches!(self, Self::Ridged | Self::RidgedMulti)
    }

    /// Pairs of methods that differ in whether plains or mountains prevail, as the thesis says: plains first.
    pub(super) const OPPOSITES: [[Self; 2]; 2] = [[Self::Perlin, Self::Ridged], [Self::MultiPerlin, Self::RidgedMulti]];

    /// The terrain of 2^k cells a side, from 0 to 255.
    pub(super) fn terrain(self, cells: u32, seed: u64) -> Result<MemoryField, GridError> {
        let heights = match self {
            Self::SubdivideAndDisplace => displaced(cells, seed),
            _ => (0..=cells)
                .flat_map(|j| (0..=cells).map(move |i| (i, j)))
                .map(|(i, j)| self.height(f64::from(i) / f64::from(cells), f64::from(j) / f64::from(cells), seed))
                .collect(),
        };
        let range = heights.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], &z| [l.min(z), h.max(z)]);
        let scale = GREATEST / (range[1] - range[0]).max(f64::MIN_POSITIVE);
        let at = |i: u32, j: u32| heights[j as usize * (cells as usize + 1) + i as usize];
        MemoryField::from_fn(cells + 1, cells + 1, |i, j| Some(((at(i, j) - range[0]) * scale).round()))
    }

    /// A height at a place of the unit square.
    fn height(self, x: f64, y: f64, seed: u64) -> f64 {
        let (mut sum, mut weight, mut gain) = (0.0, 1.0, 1.0);
        for octave in 0..OCTAVES {
            let cells = f64::from(COARSEST << octave);
            let n = gradient_noise(x * cells, y * cells, seed ^ mix(u64::from(octave)));
            let ridge = 1.0 - n.abs();
            match self {
                Self::SubdivideAndDisplace | Self::Perlin => sum += gain * n,
                // Finer octaves count where coarser ones are high, so mountains stand together.
                Self::MultiPerlin => {
                    sum += gain * weight * n;
                    weight = (weight * (0.8 + n)).clamp(0.0, 1.0);
                }
                Self::Ridged => sum += gain * ridge,
                Self::RidgedMulti => {
                    sum += gain * weight * ridge * ridge;
                    weight = (2.0 * ridge * ridge * weight).clamp(0.0, 1.0);
                }
            }
            gain *= 0.5;
        }
        // Plains below, mountains above.
        if self == Self::Perlin { (sum + 0.2).max(0.0) * (sum + 0.2).max(0.0) } else { sum }
    }
}

/// Midpoint displacement on a square of 2^k cells: each square's middle, then each edge's, moves by chance, half as far
/// with each subdivision.
fn displaced(cells: u32, seed: u64) -> Vec<f64> {
    let width = cells as usize + 1;
    let mut z = vec![0.0; width * width];
    let mut reach = 1.0;
    let mut step = cells;
    while step > 1 {
        let half = step / 2;
        let chance = |i: u32, j: u32| reach * (2.0 * fraction(seed, i, j) - 1.0);
        let at = |i: u32, j: u32| j as usize * width + i as usize;
        for j in (half..cells).step_by(step as usize) {
            for i in (half..cells).step_by(step as usize) {
                let corners = [(i - half, j - half), (i + half, j - half), (i - half, j + half), (i + half, j + half)];
                z[at(i, j)] = corners.iter().map(|&(a, b)| z[at(a, b)]).sum::<f64>() / 4.0 + chance(i, j);
            }
        }
        for j in (0..=cells).step_by(half as usize) {
            let first = if (j / half).is_multiple_of(2) { half } else { 0 };
            for i in (first..=cells).step_by(step as usize) {
                let around = [
                    (i.checked_sub(half), Some(j)),
                    (Some(i + half).filter(|&v| v <= cells), Some(j)),
                    (Some(i), j.checked_sub(half)),
                    (Some(i), Some(j + half).filter(|&v| v <= cells)),
                ];
                let found: Vec<f64> = around.iter().filter_map(|&(a, b)| Some(z[at(a?, b?)])).collect();
                z[at(i, j)] = super::mean(&found) + chance(i, j);
            }
        }
        (reach, step) = (reach * 0.5, half);
    }
    z
}

/// A number in [0, 1).
fn fraction(seed: u64, i: u32, j: u32) -> f64 {
    (mix(seed ^ mix(u64::from(i) << 32 | u64::from(j))) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Gradient noise from about -1 to 1, 0 on the lattice.
fn gradient_noise(x: f64, y: f64, seed: u64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let (u, v) = (x - i, y - j);
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let corner = |a: u32, b: u32| {
        const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;
        const WAYS: [[f64; 2]; 8] = [
            [1.0, 0.0],
            [DIAGONAL, DIAGONAL],
            [0.0, 1.0],
            [-DIAGONAL, DIAGONAL],
            [-1.0, 0.0],
            [-DIAGONAL, -DIAGONAL],
            [0.0, -1.0],
            [DIAGONAL, -DIAGONAL],
        ];
        let [gx, gy] = WAYS[(8.0 * fraction(seed, i as u32 + a, j as u32 + b)) as usize];
        gx * (u - f64::from(a)) + gy * (v - f64::from(b))
    };
    let along = |b: u32| corner(0, b) + fade(u) * (corner(1, b) - corner(0, b));
    std::f64::consts::SQRT_2 * (along(0) + fade(v) * (along(1) - along(0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::Posts;
    use sightline_proto::diamond::Post;

    #[test]
    fn terrains_use_all_heights_and_are_as_flat_as_they_are_said_to_be() {
        let shares = Method::ALL.map(|method| {
            let field = method.terrain(64, 3).unwrap();
            let mut posts = Posts::new(&field);
            let mut heights: Vec<f64> = (0..65 * 65).map(|n| posts.at(Post::new(n % 65, n / 65)).unwrap().z).collect();
            heights.sort_by(f64::total_cmp);
            assert_eq!((heights[0], heights[65 * 65 - 1]), (0.0, 255.0), "{}", method.name());
            assert!(heights.iter().all(|z| z.fract() == 0.0));
            // The share of the lowest fifth of heights.
            heights.partition_point(|&z| z < 51.0) as f64 / heights.len() as f64
        });
        let [_, perlin, _, ridged, _] = shares;
        assert!(perlin > 0.4 && ridged < 0.2, "{shares:?}");
    }
}
