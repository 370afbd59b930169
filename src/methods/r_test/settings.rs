//! Settings of the method, the table `[method.r-test]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RTestSettings {
    /// Names of the sensors. Empty: all sensors of the machine file.
    pub sensors: Vec<String>,
    /// Number of stops in one revolution, at equal angles that start at zero.
    pub positions: usize,
    /// Displacement of the sphere from the origin along +X, −X, +Y, −Y, +Z and −Z for the calibration of the sensors.
    pub calibration_mm: f64,
    /// Feed of the calibration moves, mm/min.
    pub feed_mm_min: f64,
    /// Feed of the turns, degrees per minute.
    pub feed_deg_min: f64,
    /// Dwell time at a stop or calibration point before its samples, s.
    pub dwell_s: f64,
    /// Number of samples of each sensor at a stop or calibration point.
    pub samples: u32,
    /// Standard deviation of the sphere's form.
    pub u_sphere_form_um: f64,
    /// Number of Monte Carlo trials. 0: adaptive as in JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for RTestSettings {
    fn default() -> Self {
        Self {
            sensors: Vec::new(),
            positions: 24,
            calibration_mm: 0.1,
            feed_mm_min: 30.0,
            feed_deg_min: 720.0,
            dwell_s: 0.5,
            samples: 10,
            u_sphere_form_um: 0.05,
            monte_carlo_trials: 0,
        }
    }
}

/// Minimum number of stops. With fewer stops, the axis position and an error motion of low order are inseparable.
const MIN_STOPS_PER_REVOLUTION: usize = 4;
const MAX_STOPS_PER_REVOLUTION: usize = 720;
/// Maximum feed of the turns. With an axis 5 mm from its stated position the sphere moves at 2 mm/s relative to the
/// sensors.
const MAX_FEED_DEG_MIN: f64 = 1440.0;

impl RTestSettings {
    /// # Errors
    /// The numbers do not describe a possible measurement.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::check_number_ranges(
            &[
                ("calibration_mm", self.calibration_mm),
                ("feed_mm_min", self.feed_mm_min),
                ("feed_deg_min", self.feed_deg_min),
                ("samples", self.samples.into()),
            ],
            &[("dwell_s", self.dwell_s), ("u_sphere_form_um", self.u_sphere_form_um)],
        )?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)?;
        MethodRefusal::require(
            self.feed_deg_min <= MAX_FEED_DEG_MIN,
            format!("feed_deg_min = {} is too fast for sensors at a sphere", self.feed_deg_min),
            format!("choose feed_deg_min = {MAX_FEED_DEG_MIN} or less"),
        )?;
        MethodRefusal::require(
            (MIN_STOPS_PER_REVOLUTION..=MAX_STOPS_PER_REVOLUTION).contains(&self.positions),
            format!(
                "positions = {} is outside {MIN_STOPS_PER_REVOLUTION} to {MAX_STOPS_PER_REVOLUTION}",
                self.positions
            ),
            "choose positions = 24 (4 to 720)",
        )
    }
}
