//! Settings of the method, the table `[method.ball-plate]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;
use crate::ball_measurement::{Find, TouchSettings};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Stops in one revolution of the table, M. The balls stand at multiples of 360°/M.
    pub positions: usize,
    /// Revolutions in each direction.
    pub revolutions: usize,
    /// Whether the table turns back as far as it has turned: otherwise no reversal is seen, and drift
    /// is harder to tell from the error motions.
    pub both_directions: bool,
    /// Highest harmonic of the six error motions.
    pub harmonics: usize,
    /// Sub-harmonics θ/2 to θ/n of bearings and drives that repeat after n revolutions; 0: none.
    pub sub_harmonics: usize,
    /// Whether each error motion gets a value of its own at each stop, in place of harmonics. Drift and reversal
    /// are then not fitted: they are part of the values, and drift stands in their U.
    pub values: bool,
    /// Order of the polynomial in time that takes the drift of X, Y and Z; 0: none is fitted.
    pub drift_order: usize,
    /// Whether the run may take more than four hours.
    pub long: bool,
    /// Touches of one measurement: 5, or more for a form check.
    pub touches: usize,
    /// Measure one ball again at the start, the middle and the end.
    pub references: bool,
    /// Clear distance before the expected contact of a slow touch, and how far beyond it may go.
    pub standoff_mm: f64,
    pub search_mm: f64,
    /// Form of one measurement of a ball beyond which the run holds.
    pub form_limit_um: f64,
    /// Difference from the stated diameter, the probe's pre-travel with it, beyond which the run holds.
    pub diameter_limit_um: f64,
    /// Trials of the Monte Carlo propagation; 0 lets JCGM 101, 7.9 decide.
    pub monte_carlo_trials: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            positions: 36,
            revolutions: 1,
            both_directions: true,
            harmonics: 8,
            sub_harmonics: 0,
            values: false,
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

/// Beyond it polynomials of time follow the scatter.
const MAX_DRIFT_ORDER: usize = 5;
/// More would take days.
const MAX_POSITIONS: usize = 720;

impl Settings {
    /// What would fail on the way, refused before the first move.
    pub fn check(&self) -> Result<(), Refused> {
        Refused::unless(
            self.positions <= MAX_POSITIONS,
            format!("{} positions of a revolution are more than a run can have", self.positions),
            format!("choose positions = 72, at most {MAX_POSITIONS}"),
        )?;
        Refused::unless(
            self.harmonics > 0 && 2 * self.harmonics < self.positions,
            format!(
                "{} positions do not show {} harmonics: more than twice as many are needed",
                self.positions, self.harmonics
            ),
            format!("choose positions = {} or more, or fewer harmonics", 4 * self.harmonics.max(1)),
        )?;
        Refused::unless(
            self.revolutions > 0 && self.sub_harmonics <= self.revolutions,
            format!(
                "sub-harmonics up to θ/{} need as many revolutions in one direction, not {}",
                self.sub_harmonics, self.revolutions
            ),
            format!("choose revolutions = {}", self.sub_harmonics.max(1)),
        )?;
        Refused::unless(
            self.drift_order <= MAX_DRIFT_ORDER,
            format!("drift_order = {} follows the scatter of the touches", self.drift_order),
            format!("choose drift_order = 3, at most {MAX_DRIFT_ORDER}"),
        )?;
        self.touch().check()?;
        Refused::check_trials(self.monte_carlo_trials)
    }

    pub fn touch(&self) -> TouchSettings {
        TouchSettings {
            find: Find::Once,
            touches: self.touches,
            has_references: self.references,
            watch_s: 0.0,
            standoff_mm: self.standoff_mm,
            search_mm: self.search_mm,
            form_limit_mm: self.form_limit_um * 1e-3,
            diameter_limit_mm: self.diameter_limit_um * 1e-3,
        }
    }
}
