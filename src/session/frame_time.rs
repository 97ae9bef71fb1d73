//! Steers a view's triangle budget by how long its client's frames take.
//!
//! A client draws n triangles in about a + b n milliseconds, with a and b unknown, changing and noisy. Too slow is worse than
//! too coarse, so the budget falls at once, in proportion, and rises in small steps after frames have been fast for a
//! while. Between the two lies a band in which nothing changes: budgets that follow noise would be meshes that flicker.

use super::MIN_TRIANGLES;

/// The first budget, where the client has said nothing yet.
const FIRST_TRIANGLES: u32 = 3_000;
/// Slower than this share of what is wanted, twice in a row, is too slow.
const SLOW: f64 = 1.05;
const SLOW_REPORTS: u32 = 2;
/// Faster than this share, for so many reports in a row, leaves room.
const FAST: f64 = 0.8;
const FAST_REPORTS: u32 = 8;
/// What is aimed for when the budget changes: inside the band.
const AIM: f64 = 0.92;
/// Greatest change at a time, up and down.
const MOST_RISE: f64 = 1.15;
const MOST_FALL: f64 = 0.5;

/// The controller of one view. Times are what clients report; it has no clock.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FrameTime {
    wanted_ms: f64,
    max: u32,
    budget: u32,
    slow: u32,
    fast: u32,
}

impl FrameTime {
    /// A controller that aims for frames of `wanted_ms` with at most `max` triangles.
    pub fn new(wanted_ms: f64, max: u32) -> Self {
        Self { wanted_ms, max, budget: FIRST_TRIANGLES.min(max), slow: 0, fast: 0 }
    }

    /// Whether it aims for this.
    pub fn aims_for(&self, wanted_ms: f64, max: u32) -> bool {
        self.wanted_ms == wanted_ms && self.max == max
    }

    /// The triangle budget now.
    pub fn budget(&self) -> u32 {
        self.budget
    }

    /// Takes the time of a frame, above 0; whether the budget changed.
    pub fn report(&mut self, took_ms: f64) -> bool {
        let share = took_ms / self.wanted_ms;
        self.slow = if share > SLOW { self.slow + 1 } else { 0 };
        self.fast = if share < FAST { self.fast + 1 } else { 0 };
        if self.slow < SLOW_REPORTS && self.fast < FAST_REPORTS {
            return false;
        }
        (self.slow, self.fast) = (0, 0);
        let factor = (AIM / share).clamp(MOST_FALL, MOST_RISE);
        let before = self.budget;
        // Truncates; the product is within the range of the budget.
        self.budget = ((f64::from(before) * factor) as u32).clamp(MIN_TRIANGLES, self.max);
        self.budget != before
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::synthetic::mix;

    /// A client that takes `base_ms` and `per_1000_ms` for each thousand triangles, up to a tenth more or less.
    fn took_ms(n: u64, triangles: u32, base_ms: f64, per_1000_ms: f64) -> f64 {
        let noise = (mix(n) % 1000) as f64 / 5000.0 - 0.1;
        (base_ms + per_1000_ms * f64::from(triangles) / 1000.0) * (1.0 + noise)
    }

    #[test]
    fn budgets_settle_where_frames_take_what_is_wanted_and_stay() {
        for (base_ms, per_1000_ms) in [(1.0, 0.5), (4.0, 2.0), (0.1, 10.0), (12.0, 0.01)] {
            let mut control = FrameTime::new(16.0, 1_000_000);
            let report =
                |control: &mut FrameTime, n| control.report(took_ms(n, control.budget(), base_ms, per_1000_ms));
            (0..600).for_each(|n| {
                report(&mut control, n);
            });
            let changes = (600..1200).filter(|&n| report(&mut control, n)).count();
            let settled = base_ms + per_1000_ms * f64::from(control.budget()) / 1000.0;
            assert!((0.7..=1.1).contains(&(settled / 16.0)), "{settled} ms with {control:?}");
            assert!(changes < 15, "{changes} changes of {control:?}");
        }
    }

    #[test]
    fn a_client_that_becomes_slow_gets_less_within_a_few_frames() {
        let mut control = FrameTime::new(16.0, 100_000);
        (0..400).for_each(|n| {
            control.report(took_ms(n, control.budget(), 1.0, 0.5));
        });
        let before = control.budget();
        (0..12).for_each(|n| {
            control.report(took_ms(n, control.budget(), 1.0, 5.0));
        });
        assert!(control.budget() < before / 4, "{before}, then {control:?}");
    }

    #[test]
    fn budgets_keep_to_their_range() {
        let mut control = FrameTime::new(16.0, 5_000);
        (0..1000).for_each(|_| {
            control.report(0.001);
        });
        assert_eq!(control.budget(), 5_000);
        (0..1000).for_each(|_| {
            control.report(1e9);
        });
        assert_eq!(control.budget(), MIN_TRIANGLES);
        assert_eq!(FrameTime::new(1.0, 2).budget(), 2);
    }
}
