//! A seeded sequence of choices: the same on every machine.

use crate::terrain::synthetic::mix;

/// A seeded sequence of choices.
#[derive(Clone, Debug)]
pub struct Dice {
    state: u64,
}

impl Dice {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self { state: mix(seed) }
    }

    /// A number in [0, 1).
    pub fn fraction(&mut self) -> f64 {
        self.state = mix(self.state);
        (self.state >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A number from 0 to `end` - 1; 0 when there is none.
    pub fn below(&mut self, end: usize) -> usize {
        ((self.fraction() * end as f64) as usize).min(end.saturating_sub(1))
    }

    /// A unit vector.
    pub fn heading(&mut self) -> [f64; 2] {
        loop {
            let v = [2.0 * self.fraction() - 1.0, 2.0 * self.fraction() - 1.0];
            let square = v[0] * v[0] + v[1] * v[1];
            if square > 0.01 && square <= 1.0 {
                return v.map(|c| c / square.sqrt());
            }
        }
    }

    /// A place in a rectangle, a `margin` of its sides away from its border.
    pub fn place(&mut self, [low, high]: [[f64; 2]; 2], margin: f64) -> [f64; 2] {
        [0, 1].map(|k| low[k] + (margin + (1.0 - 2.0 * margin) * self.fraction()) * (high[k] - low[k]))
    }
}
