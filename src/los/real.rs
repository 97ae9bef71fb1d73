//! The numbers in which a [`super::glance`] computes: f64, and f32 for the FAST rung.

use std::ops::{Add, Div, Mul, Sub};

/// The numbers in which a glance computes.
pub(super) trait Real:
    Copy + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// 1.5 times the weight of the bit before the point: added to a small number, it leaves a whole number in the low
    /// bits.
    const WHOLE: Self;
    const ZERO: Self;
    const HALF: Self;
    const ONE: Self;
    fn of(v: f64) -> Self;
    fn of_whole(v: i32) -> Self;
    /// The whole number in the low bits.
    fn low_bits(self) -> i32;
    fn abs(self) -> Self;
}

impl Real for f64 {
    const WHOLE: Self = 6_755_399_441_055_744.0;
    const ZERO: Self = 0.0;
    const HALF: Self = 0.5;
    const ONE: Self = 1.0;

    #[inline]
    fn of(v: f64) -> Self {
        v
    }

    #[inline]
    fn of_whole(v: i32) -> Self {
        f64::from(v)
    }

    #[inline]
    fn low_bits(self) -> i32 {
        self.to_bits() as i32
    }

    #[inline]
    fn abs(self) -> Self {
        self.abs()
    }
}

impl Real for f32 {
    const WHOLE: Self = 12_582_912.0;
    const ZERO: Self = 0.0;
    const HALF: Self = 0.5;
    const ONE: Self = 1.0;

    #[inline]
    fn of(v: f64) -> Self {
        v as f32
    }

    #[inline]
    fn of_whole(v: i32) -> Self {
        v as f32
    }

    #[inline]
    fn low_bits(self) -> i32 {
        // Whole numbers here are below 2^21 in magnitude.
        ((self.to_bits() as i32) << 10) >> 10
    }

    #[inline]
    fn abs(self) -> Self {
        self.abs()
    }
}

/// The floor of a number below 2^21 in magnitude, and whether it is whole.
#[inline]
pub(super) fn floor<R: Real>(v: R) -> (i32, bool) {
    let shifted = v + R::WHOLE;
    let nearest = shifted - R::WHOLE;
    (shifted.low_bits() - i32::from(nearest > v), nearest == v)
}
