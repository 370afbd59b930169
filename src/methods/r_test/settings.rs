//! Settings of the method, the table `[method.r-test]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Names of the sensors; empty: all of the machine file.
    pub sensors: Vec<String>,
    /// Stops in one revolution, at equal angles from zero on.
    pub positions: usize,
    /// The sphere is moved by so much along X, Y and Z to calibrate the sensors.
    pub calibration_mm: f64,
    /// Feed of these moves, mm/min.
    pub feed_mm_min: f64,
    /// Feed of the turns, degrees a minute.
    pub feed_deg_min: f64,
    /// Rest at a stop before its samples, and how many are taken there of each sensor.
    pub dwell_s: f64,
    pub samples: u32,
    /// Standard deviation of the sphere's form.
    pub u_sphere_form_um: f64,
    /// Trials of the Monte Carlo propagation; 0 lets JCGM 101, 7.9 decide.
    pub monte_carlo_trials: usize,
}

impl Default for Settings {
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

/// Fewer stops do not separate the axis position from an error motion of low order.
const MIN_POSITIONS: usize = 4;
const MAX_POSITIONS: usize = 720;
/// With an axis 5 mm from where it is stated the sphere moves by 2 mm/s against the sensors.
const MAX_FEED_DEG_MIN: f64 = 1440.0;

impl Settings {
    /// # Errors
    /// Numbers that make no measurement.
    pub fn check(&self) -> Result<(), Refused> {
        Refused::check_numbers(
            &[
                ("calibration_mm", self.calibration_mm),
                ("feed_mm_min", self.feed_mm_min),
                ("feed_deg_min", self.feed_deg_min),
                ("samples", self.samples.into()),
            ],
            &[("dwell_s", self.dwell_s), ("u_sphere_form_um", self.u_sphere_form_um)],
        )?;
        Refused::check_trials(self.monte_carlo_trials)?;
        Refused::unless(
            self.feed_deg_min <= MAX_FEED_DEG_MIN,
            format!("feed_deg_min = {} is too fast for sensors about a sphere", self.feed_deg_min),
            format!("choose feed_deg_min = {MAX_FEED_DEG_MIN} or less"),
        )?;
        Refused::unless(
            (MIN_POSITIONS..=MAX_POSITIONS).contains(&self.positions),
            format!("{} positions of a revolution are too few or too many", self.positions),
            "choose positions = 24, at least 4 and at most 720",
        )
    }
}
