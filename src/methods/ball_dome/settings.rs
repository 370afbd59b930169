//! Settings of the method, the table `[method.ball-dome]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;
use crate::ball_measurement::{Find, NamedPositions, RotaryPositions, TouchSettings};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Positions of a rotary axis that tilts the artefact, and of one parallel to the spindle, as commanded: the
    /// indexations are all pairs. The defaults are cut to the axes' limits.
    pub tilt_deg: Vec<f64>,
    pub turn_deg: Vec<f64>,
    /// The ball that gives the stylus of N2 and S2; empty: the first of the artefact.
    pub tool_ball: String,
    pub find: Find,
    /// Touches of one measurement: 5, or more for a form check.
    pub touches: usize,
    /// Measure one ball again at the start, the middle and the end, to see drift.
    pub references: bool,
    /// Measure one ball again and again before the rest, so many minutes, until the machine creeps no faster than
    /// `drift_um_per_h` of it declares; 0: not at all.
    pub watch_min: f64,
    /// Clear distance before the expected contact of a slow touch, and how far beyond it may go.
    pub standoff_mm: f64,
    pub search_mm: f64,
    /// Form of one measurement of a ball (largest less smallest residual of its sphere) beyond which the
    /// run holds.
    pub form_limit_um: f64,
    /// Difference from the stated diameter, the probe's pre-travel with it, beyond which the run holds.
    pub diameter_limit_um: f64,
    /// Trials of the Monte Carlo propagation; 0 lets JCGM 101, 7.9 decide.
    pub monte_carlo_trials: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            tilt_deg: vec![-90.0, -54.0, -18.0, 18.0, 54.0, 90.0],
            turn_deg: vec![0.0, 90.0, 180.0, 270.0],
            tool_ball: String::new(),
            find: Find::Once,
            touches: 5,
            references: true,
            watch_min: 0.0,
            standoff_mm: 0.5,
            search_mm: 1.0,
            form_limit_um: 15.0,
            diameter_limit_um: 30.0,
            monte_carlo_trials: 0,
        }
    }
}

impl Settings {
    pub fn touch(&self) -> TouchSettings {
        TouchSettings {
            find: self.find,
            touches: self.touches,
            has_references: self.references,
            watch_s: 60.0 * self.watch_min,
            standoff_mm: self.standoff_mm,
            search_mm: self.search_mm,
            form_limit_mm: self.form_limit_um * 1e-3,
            diameter_limit_mm: self.diameter_limit_um * 1e-3,
        }
    }

    /// The spindle stays as it is.
    pub fn positions(&self) -> RotaryPositions<'_> {
        let usual = Self::default();
        let named = |key, degrees, default: &[f64]| NamedPositions {
            key,
            degrees,
            is_default: degrees == default,
        };
        RotaryPositions {
            tilt: named("tilt_deg", &self.tilt_deg, &usual.tilt_deg),
            turn: named("turn_deg", &self.turn_deg, &usual.turn_deg),
            spindle: None,
        }
    }

    /// # Errors
    /// Numbers that make no measurement.
    pub fn check(&self) -> Result<(), Refused> {
        self.touch().check()?;
        Refused::check_trials(self.monte_carlo_trials)
    }
}
