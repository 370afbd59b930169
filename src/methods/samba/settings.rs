//! Settings of the method, the table `[method.samba]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;
use crate::ball_measurement::{ConfiguredPositions, RotaryPositions, SearchMode, TouchSettings};

/// Choice of the indexations.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DesignKind {
    /// Greedy choice among the candidates, within the budget.
    #[default]
    Optimal,
    /// The design of paper 4, section 3: 32 positions of B, C and S, 109 balls.
    Paper,
}

/// Quantity that the greedy choice minimises.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum OptimalityCriterion {
    /// The volume of the confidence ellipsoid of the machine's parameters.
    #[default]
    D,
    /// The mean variance of the machine's parameters, each relative to its requirement.
    A,
}

/// Whether the spindle turns with the design.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpindleOrientMode {
    /// Oriented by the control if the machine file declares an axis S, otherwise fixed.
    #[default]
    Auto,
    /// Oriented by the control; refused if the machine file declares no axis S.
    Orient,
    /// Not turned by the design, even if the machine file declares an axis S.
    Fixed,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SambaSettings {
    /// Machine errors to identify, by ISO names (`EX0C`, `EXX1`, `EXC_sin2`). Empty: the set that ISO 10791-6
    /// implies for the topology, without the errors that are not identifiable with an upright spindle.
    pub parameters: Vec<String>,
    pub design: DesignKind,
    pub criterion: OptimalityCriterion,
    /// Maximum number of ball measurements over all indexations.
    #[serde(rename = "balls")]
    pub max_ball_measurements: usize,
    /// Maximum number of indexations.
    pub indexations: usize,
    /// Maximum machine time, min; 0: no limit.
    pub minutes: f64,
    /// Whether each ball is searched at every indexation or only once.
    #[serde(rename = "find")]
    pub ball_search_mode: SearchMode,
    pub spindle: SpindleOrientMode,
    /// Candidate positions of rotary axes that tilt the workpiece or the head (A, B), as commanded. The
    /// defaults are restricted to the limits of the axes; a position that the user states must be within the limits. An
    /// axis that tilts the head stays at 0: balls are touched from above only.
    pub tilt_deg: Vec<f64>,
    /// Candidate positions of a rotary axis parallel to the spindle (C).
    pub turn_deg: Vec<f64>,
    /// Candidate positions of the spindle (S), if it is oriented.
    pub spindle_deg: Vec<f64>,
    /// Number of touches of one measurement: 5, or more for a form check.
    pub touches: usize,
    /// Whether one ball is measured again at the start, the middle and the end, to detect drift.
    pub references: bool,
    /// Clearance before the expected contact of a slow touch, mm.
    pub standoff_mm: f64,
    /// Maximum travel of a slow touch beyond the expected contact, mm.
    pub search_mm: f64,
    /// Maximum form deviation of one ball measurement (largest minus smallest residual of the fitted sphere), µm.
    /// Above it the ball is measured again; if the repeated value is above it too, the run is held.
    pub form_limit_um: f64,
    /// Maximum difference from the stated diameter, including the probe's pre-travel, µm. Above it the ball is
    /// measured again; if the repeated value is above it too, the run is held.
    pub diameter_limit_um: f64,
    /// Number of Monte Carlo trials; 0 selects the adaptive rule of JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for SambaSettings {
    fn default() -> Self {
        Self {
            parameters: Vec::new(),
            design: DesignKind::Optimal,
            criterion: OptimalityCriterion::D,
            max_ball_measurements: 109,
            indexations: 32,
            minutes: 0.0,
            ball_search_mode: SearchMode::Every,
            spindle: SpindleOrientMode::Auto,
            tilt_deg: vec![-90.0, -60.0, -30.0, -10.0, 0.0, 10.0, 30.0, 60.0, 90.0],
            turn_deg: vec![0.0, 90.0, 180.0, 270.0],
            spindle_deg: vec![0.0, 90.0, 180.0, 270.0],
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

/// Maximum number of ball measurements; a design of this size is still computed in a second or two.
const MAX_BALL_MEASUREMENTS: usize = 2_000;

impl SambaSettings {
    pub fn touch_settings(&self) -> TouchSettings {
        TouchSettings {
            search_mode: self.ball_search_mode,
            touch_count: self.touches,
            has_references: self.references,
            min_rest_check_s: 0.0,
            standoff_mm: self.standoff_mm,
            search_mm: self.search_mm,
            form_hold_limit_mm: self.form_limit_um * 1e-3,
            diameter_deviation_hold_limit_mm: self.diameter_limit_um * 1e-3,
        }
    }

    /// Candidate positions of the axes, including those of the spindle if it is oriented.
    pub fn candidate_positions(&self, is_spindle_oriented: bool) -> RotaryPositions<'_> {
        let usual = Self::default();
        let positions = ConfiguredPositions::new;
        RotaryPositions {
            tilt: positions("tilt_deg", &self.tilt_deg, &usual.tilt_deg),
            turn: positions("turn_deg", &self.turn_deg, &usual.turn_deg),
            spindle: is_spindle_oriented.then(|| positions("spindle_deg", &self.spindle_deg, &usual.spindle_deg)),
        }
    }

    /// Refuses settings that would make the run fail, before the first motion.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        self.touch_settings().check()?;
        MethodRefusal::require(
            (1..=MAX_BALL_MEASUREMENTS).contains(&self.max_ball_measurements) && self.indexations > 0,
            format!(
                "a budget of {} balls at {} indexations is not possible",
                self.max_ball_measurements, self.indexations
            ),
            "omit balls and indexations (defaults 109 and 32), or choose up to 2000 balls",
        )?;
        MethodRefusal::require(
            self.minutes >= 0.0 && self.minutes.is_finite(),
            format!("minutes = {} is negative or not finite", self.minutes),
            "choose minutes = 0 for no limit, or the available machine time",
        )?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)
    }
}
