//! Settings of the method, the table `[method.ball-plate]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;
use crate::ball_measurement::{SearchMode, TouchSettings};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BallPlateSettings {
    /// Number M of stops per revolution of the table. The balls are at multiples of 360°/M.
    pub positions: usize,
    /// Number of revolutions in each direction.
    pub revolutions: usize,
    /// Whether the table also turns back through all stops. Otherwise the reversal is not measured, and drift
    /// is harder to separate from the error motions.
    pub both_directions: bool,
    /// Highest order of the harmonics of the six error motions.
    pub harmonics: usize,
    /// Highest n of the sub-harmonics θ/2 to θ/n, for bearings and drives that repeat after n revolutions; 0 or 1:
    /// none.
    pub sub_harmonics: usize,
    /// Whether each error motion has a separate value at each stop instead of harmonics. Drift and reversal
    /// are then not fitted: they are part of the values, and drift is included in their U.
    #[serde(rename = "values")]
    pub value_per_stop: bool,
    /// Order of the polynomial in time that models the drift of X, Y and Z; 0: drift is not fitted.
    pub drift_order: usize,
    /// Whether the run may take more than four hours.
    pub long: bool,
    /// Number of touches of one measurement: 5, or more for a form check.
    pub touches: usize,
    /// Whether one ball is measured again at the start, the middle and the end.
    pub references: bool,
    /// Clearance before the expected contact of a slow touch, mm.
    pub standoff_mm: f64,
    /// Maximum travel of a slow touch beyond the expected contact, mm.
    pub search_mm: f64,
    /// Maximum form of one measurement of a ball, µm. Above it the ball is measured again; if the repeated value is
    /// above it too, the run is held.
    pub form_limit_um: f64,
    /// Maximum difference between measured and stated ball diameter, including the probe's pre-travel, µm. Above it
    /// the ball is measured again; if the repeated value is above it too, the run is held.
    pub diameter_limit_um: f64,
    /// Number of Monte Carlo trials; 0 selects the adaptive rule of JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for BallPlateSettings {
    fn default() -> Self {
        Self {
            positions: 36,
            revolutions: 1,
            both_directions: true,
            harmonics: 8,
            sub_harmonics: 0,
            value_per_stop: false,
            drift_order: 3,
            long: false,
            touches: 5,
            references: true,
            standoff_mm: 0.5,
            search_mm: 1.0,
            form_limit_um: 15.0,
            diameter_limit_um: 30.0,
            monte_carlo_trials: 0,
        }
    }
}

/// Maximum order of the drift polynomial; higher orders would follow the scatter.
const MAX_DRIFT_ORDER: usize = 5;
/// Maximum number of stops per revolution; more would take days.
const MAX_POSITIONS: usize = 720;

impl BallPlateSettings {
    /// Refuses settings that would make the run fail, before the first motion.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::require(
            self.positions <= MAX_POSITIONS,
            format!("positions = {} exceeds the maximum", self.positions),
            format!("choose positions = {} (default); the maximum is {MAX_POSITIONS}", Self::default().positions),
        )?;
        MethodRefusal::require(
            self.harmonics > 0 && 2 * self.harmonics < self.positions,
            format!(
                "{} positions do not determine {} harmonics: more than twice as many positions are required",
                self.positions, self.harmonics
            ),
            format!("choose positions = {} or more, or fewer harmonics", 4 * self.harmonics.max(1)),
        )?;
        MethodRefusal::require(
            self.revolutions > 0 && self.sub_harmonics <= self.revolutions,
            format!(
                "sub-harmonics up to θ/{0} require {0} revolutions in one direction, but revolutions = {1}",
                self.sub_harmonics, self.revolutions
            ),
            format!("choose revolutions = {}", self.sub_harmonics.max(1)),
        )?;
        MethodRefusal::require(
            self.drift_order <= MAX_DRIFT_ORDER,
            format!(
                "drift_order = {} is too high: the polynomial would follow the scatter of the touches",
                self.drift_order
            ),
            format!("choose drift_order = 3 (default); the maximum is {MAX_DRIFT_ORDER}"),
        )?;
        self.touch_settings().check()?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)
    }

    pub fn touch_settings(&self) -> TouchSettings {
        TouchSettings {
            search_mode: SearchMode::Once,
            touch_count: self.touches,
            has_references: self.references,
            min_rest_check_s: 0.0,
            standoff_mm: self.standoff_mm,
            search_mm: self.search_mm,
            form_hold_limit_mm: self.form_limit_um * 1e-3,
            diameter_deviation_hold_limit_mm: self.diameter_limit_um * 1e-3,
        }
    }
}
