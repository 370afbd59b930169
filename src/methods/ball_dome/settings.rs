//! Settings of the method, the table `[method.ball-dome]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;
use crate::ball_measurement::{ConfiguredPositions, RotaryPositions, SearchMode, TouchSettings};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BallDomeSettings {
    /// Commanded positions of a rotary axis that tilts the artefact. The indexations are all combinations of `tilt_deg`
    /// and `turn_deg`. Default positions outside the limits of an axis are omitted.
    pub tilt_deg: Vec<f64>,
    /// Commanded positions of a rotary axis parallel to the spindle.
    pub turn_deg: Vec<f64>,
    /// Name of the ball to which the stylus of variants N2 and S2 is fitted; empty: the first ball of the artefact.
    pub tool_ball: String,
    /// When fast touches search for a ball before it is measured slowly.
    pub find: SearchMode,
    /// Number of touches of one measurement: 5, or more for a form check.
    pub touches: usize,
    /// Whether one ball is measured again at the start, the middle and the end, to detect drift.
    pub references: bool,
    /// Minimum duration of the rest check before the run, min: one ball is measured repeatedly until the machine creeps
    /// no faster than the declared `drift_um_per_h`; 0: no rest check.
    #[serde(rename = "watch_min")]
    pub rest_check_min: f64,
    /// Clearance before the expected contact of a slow touch, mm.
    pub standoff_mm: f64,
    /// Maximum travel of a slow touch beyond the expected contact, mm.
    pub search_mm: f64,
    /// Maximum form of one measurement of a ball (largest minus smallest residual of its sphere), µm. Above it the
    /// ball is measured again; if the repeated value is above it too, the run is held.
    pub form_limit_um: f64,
    /// Maximum difference between measured and stated ball diameter, including the probe's pre-travel, µm. Above it
    /// the ball is measured again; if the repeated value is above it too, the run is held.
    pub diameter_limit_um: f64,
    /// Number of Monte Carlo trials; 0 selects the adaptive rule of JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for BallDomeSettings {
    fn default() -> Self {
        Self {
            tilt_deg: vec![-90.0, -54.0, -18.0, 18.0, 54.0, 90.0],
            turn_deg: vec![0.0, 90.0, 180.0, 270.0],
            tool_ball: String::new(),
            find: SearchMode::Once,
            touches: 5,
            references: true,
            rest_check_min: 0.0,
            standoff_mm: 0.5,
            search_mm: 1.0,
            form_limit_um: 15.0,
            diameter_limit_um: 30.0,
            monte_carlo_trials: 0,
        }
    }
}

impl BallDomeSettings {
    pub fn touch_settings(&self) -> TouchSettings {
        TouchSettings {
            search_mode: self.find,
            touch_count: self.touches,
            has_references: self.references,
            min_rest_check_s: 60.0 * self.rest_check_min,
            standoff_mm: self.standoff_mm,
            search_mm: self.search_mm,
            form_hold_limit_mm: self.form_limit_um * 1e-3,
            diameter_deviation_hold_limit_mm: self.diameter_limit_um * 1e-3,
        }
    }

    /// Positions of the rotary axes; the spindle is not turned.
    pub fn rotary_positions(&self) -> RotaryPositions<'_> {
        let usual = Self::default();
        RotaryPositions {
            tilt: ConfiguredPositions::new("tilt_deg", &self.tilt_deg, &usual.tilt_deg),
            turn: ConfiguredPositions::new("turn_deg", &self.turn_deg, &usual.turn_deg),
            spindle: None,
        }
    }

    /// # Errors
    /// A setting does not allow a measurement.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        self.touch_settings().check()?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)
    }
}
