//! Steering a system's setting to a number of triangles.
//!
//! None of the systems here but ROAM takes a triangle count; their papers steer a setting (a threshold in pixels, a
//! desired resolution, a ratio) from frame to frame. Here the setting for a count is found by bisection, so that it does
//! not depend on the frames before. Counts are nearly monotone in the setting; where stitching makes them waver, the
//! result still never exceeds the count, but need not be the closest.

use super::LodError;

/// Steps of bisection: 32 octaves of setting are then known to a millionth.
const STEPS: usize = 26;

/// The range of a setting: its coarsest value and its finest one, both above 0, in either order.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SettingRange {
    /// The value that gives the coarsest mesh.
    pub coarse: f64,
    /// The value that gives the finest mesh.
    pub fine: f64,
}

impl SettingRange {
    /// Refuses a setting outside the range.
    pub(super) fn check(&self, setting: f64) -> Result<f64, LodError> {
        let (least, greatest) = (self.coarse.min(self.fine), self.coarse.max(self.fine));
        if (least..=greatest).contains(&setting) {
            Ok(setting)
        } else {
            Err(LodError::Setting { setting, least, greatest })
        }
    }

    /// The finest setting found for which `count` is at most `most`; the coarsest when there is none.
    pub(super) fn steer(
        &self,
        most: u32,
        mut count: impl FnMut(f64) -> Result<usize, LodError>,
    ) -> Result<f64, LodError> {
        let (mut coarse, mut fine) = (self.coarse, self.fine);
        if count(fine)? <= most as usize {
            return Ok(fine);
        }
        for _ in 0..STEPS {
            // The geometric mean, without the overflow or underflow of a product.
            let middle = coarse.sqrt() * fine.sqrt();
            if count(middle)? <= most as usize { coarse = middle } else { fine = middle }
        }
        Ok(coarse)
    }
}
