//! How fast a view sends: a rate and a bandwidth that its client chose. Time is an argument, in milliseconds from any
//! moment that stays the same.
//!
//! Both are kept by waiting, never by leaving something out of a frame: what waits is the newest state, so a client
//! under a cap gets fewer frames, each as true as any other.

use sightline_proto::v1;

use super::SettingsError;

/// Greatest rate that a client may ask for.
pub const MAX_RATE_HZ: f64 = 1_000.0;
/// Least bandwidth that a client may ask for.
pub const MIN_BYTES_PER_S: u64 = 1_000;

/// When the next frame may go.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Pacer {
    /// Least time from frame to frame; 0: none.
    interval_ms: f64,
    /// What a byte takes; 0: nothing.
    ms_per_byte: f64,
    /// The moment from which the rate allows the next frame.
    rate_free_ms: f64,
    /// The moment at which the bytes sent so far are paid for.
    bytes_free_ms: f64,
}

impl Pacer {
    /// Takes a new pace; what has been sent stays accounted for.
    pub fn set(&mut self, pace: &v1::Pace) -> Result<(), SettingsError> {
        let v1::Pace { max_rate_hz, max_bytes_per_s } = *pace;
        if !(0.0..=MAX_RATE_HZ).contains(&max_rate_hz) {
            return Err(SettingsError::Rate(max_rate_hz));
        }
        if max_bytes_per_s != 0 && max_bytes_per_s < MIN_BYTES_PER_S {
            return Err(SettingsError::Bandwidth(max_bytes_per_s));
        }
        self.interval_ms = if max_rate_hz > 0.0 { 1e3 / max_rate_hz } else { 0.0 };
        self.ms_per_byte = if max_bytes_per_s > 0 { 1e3 / max_bytes_per_s as f64 } else { 0.0 };
        Ok(())
    }

    /// The moment from which the next frame may go.
    pub fn free_ms(&self) -> f64 {
        let rate = if self.interval_ms > 0.0 { self.rate_free_ms } else { 0.0 };
        let bytes = if self.ms_per_byte > 0.0 { self.bytes_free_ms } else { 0.0 };
        rate.max(bytes)
    }

    /// Tells of a frame of `bytes` that went at `now_ms`.
    pub fn sent(&mut self, now_ms: f64, bytes: usize) {
        // From the moment planned, so that waking late lowers no rate; but a pause is not made up for.
        self.rate_free_ms = (self.rate_free_ms + self.interval_ms).max(now_ms + 0.5 * self.interval_ms);
        self.bytes_free_ms = self.bytes_free_ms.max(now_ms) + bytes as f64 * self.ms_per_byte;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pacer(max_rate_hz: f64, max_bytes_per_s: u64) -> Pacer {
        let mut pacer = Pacer::default();
        pacer.set(&v1::Pace { max_rate_hz, max_bytes_per_s }).unwrap();
        pacer
    }

    /// Frames sent within `ms` by a view that always has one, `late_ms` after it may go.
    fn frames(mut pacer: Pacer, ms: f64, late_ms: f64, bytes: usize) -> u32 {
        let (mut now, mut count) = (0.0, 0);
        loop {
            now = pacer.free_ms().max(now) + late_ms;
            if now > ms {
                return count;
            }
            pacer.sent(now, bytes);
            count += 1;
            assert!(count < 1_000_000);
        }
    }

    #[test]
    fn rate_and_bandwidth_hold_in_the_long_run() {
        // Half a millisecond more, since three hundred thirtieths of a second come out a little above ten.
        assert_eq!(frames(pacer(30.0, 0), 10_000.5, 0.0, 500), 301);
        // Woken two milliseconds late each time, it keeps its rate.
        assert!((299..=301).contains(&frames(pacer(30.0, 0), 10_000.0, 2.0, 500)));
        assert_eq!(frames(pacer(0.0, 10_000), 10_000.0, 0.0, 500), 201);
        // The narrower one counts.
        assert_eq!(frames(pacer(30.0, 5_000), 10_000.0, 0.0, 500), 101);
    }

    #[test]
    fn a_pause_is_not_made_up_for() {
        let mut pacer = pacer(10.0, 1_000);
        pacer.sent(0.0, 100);
        pacer.sent(60_000.0, 100);
        assert!(pacer.free_ms() >= 60_050.0, "{pacer:?}");
    }

    #[test]
    fn without_a_pace_nothing_waits_and_nonsense_is_refused() {
        let mut free = Pacer::default();
        free.sent(5.0, 1 << 30);
        assert!(free.free_ms() <= 5.0);
        for (rate, bytes) in [(f64::NAN, 0), (-1.0, 0), (1e9, 0), (0.0, 1)] {
            assert!(free.set(&v1::Pace { max_rate_hz: rate, max_bytes_per_s: bytes }).is_err(), "{rate} {bytes}");
        }
    }
}
