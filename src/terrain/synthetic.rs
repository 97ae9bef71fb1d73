//! Deterministic synthetic terrains for tests and measurements: integer arithmetic only, so the same on every machine.

use super::{GridError, MemoryField};

/// A deterministic 64-bit mix of a counter (splitmix64, Steele et al. 2014).
pub const fn mix(n: u64) -> u64 {
    let mut z = n.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Fractal value noise with integer heights between about -`amplitude` and `amplitude`.
///
/// Octave k interpolates lattice values 2^k posts apart bilinearly, with half the amplitude of the octave above.
pub fn fractal(nx: u32, ny: u32, seed: u64, amplitude: i32) -> Result<MemoryField, GridError> {
    MemoryField::from_fn(nx, ny, |i, j| Some(f64::from(fractal_height(i, j, seed, amplitude))))
}

/// The height of post (i, j) of [`fractal`].
pub fn fractal_height(i: u32, j: u32, seed: u64, amplitude: i32) -> i32 {
    const OCTAVES: u32 = 7;
    let mut sum = 0_i64;
    for k in 0..OCTAVES {
        let scale = (i64::from(amplitude) * 1024) >> (OCTAVES - k);
        let lattice = |a: u32, b: u32| {
            let h = mix(seed ^ mix((u64::from(k) << 58) | (u64::from(a) << 29) | u64::from(b)));
            i64::from(h as u16) - 32_768
        };
        let (a, b, step) = (i >> k, j >> k, 1_i64 << k);
        let (u, v) = (i64::from(i) - (i64::from(a) << k), i64::from(j) - (i64::from(b) << k));
        let south = lattice(a, b) * (step - u) + lattice(a + 1, b) * u;
        let north = lattice(a, b + 1) * (step - u) + lattice(a + 1, b + 1) * u;
        sum += (south * (step - v) + north * v) / (step * step) * scale / 32_768;
    }
    (sum / 1024) as i32
}

/// A plane with integer slopes: every line in it is a tie.
pub fn plane(nx: u32, ny: u32, east: i32, north: i32) -> Result<MemoryField, GridError> {
    MemoryField::from_fn(nx, ny, |i, j| Some(f64::from(east) * f64::from(i) + f64::from(north) * f64::from(j)))
}
