//! Settings of the method, the table `[method.self-calibration]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;
use machine::Position;
use machine::record::artefact::Cylinder;

/// Orientation of the spindle while the probe moves around the part.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpindleMode {
    /// The spindle keeps its orientation. Stylus offset and lobing are in the budget.
    #[default]
    Fixed,
    /// The spindle turns with the probe angle, so that the same point of the stylus always touches.
    Follow,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SelfCalibrationSettings {
    /// Number N of equispaced angles.
    pub positions: usize,
    /// Probe angles of Tests 1a, 1b, 1c…: multiples of 360°/N, the first is 0. Absent: `[0, 360/N, 90]` if 90° is a
    /// multiple, otherwise `[0, 360/N]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probe_angles_deg: Option<Vec<f64>>,
    /// Heights of the touches above the foot of the part. Empty: half the part's height. Two or more heights also
    /// give the tilts E_A0C and E_B0C.
    pub heights_mm: Vec<f64>,
    pub spindle: SpindleMode,
    /// Positions of the other rotary axes during the cycle, degrees, 0 for axes that are not named. The measured axis
    /// is the table axis that is along Z at these positions.
    #[serde(rename = "at", skip_serializing_if = "Position::is_empty")]
    pub other_rotary_positions: Position,
    /// Whether to locate the part first, by four search touches around it, and one on its top if `z_reference` is set.
    pub locate: bool,
    /// Whether to touch the part at the probe angles 0°, 90° and 180° (or the nearest grid angles) before the first
    /// test and after each, to measure drift.
    pub references: bool,
    /// Whether to touch the top face of the part when the part is located, and with each round of references to
    /// measure drift of Z.
    pub z_reference: bool,
    /// Position of the touch on the top face relative to the part's axis in X and Y with the axis at 0, mm. Required if
    /// the part has a bore, for example.
    pub z_reference_at_mm: [f64; 2],
    /// Order of the drift polynomial in X, Y and radius. 0: no drift is fitted.
    pub drift_order: usize,
    /// Whether to correct for touches off the radial line (METHODS section 1, second order).
    pub second_order: bool,
    /// Number of passes of the complete cycle. Touches that no other touch checks are then measured once more.
    pub repeats: u32,
    /// Clearance before the expected contact, mm.
    pub standoff_mm: f64,
    /// Overtravel of a touch beyond the expected contact, mm.
    pub search_mm: f64,
    /// Number of Monte Carlo trials. 0: adaptive as in JCGM 101, 7.9.
    pub monte_carlo_trials: usize,
}

impl Default for SelfCalibrationSettings {
    fn default() -> Self {
        Self {
            positions: 8,
            probe_angles_deg: None,
            heights_mm: Vec::new(),
            spindle: SpindleMode::Fixed,
            other_rotary_positions: Position::new(),
            locate: true,
            references: true,
            z_reference: true,
            z_reference_at_mm: [0.0, 0.0],
            drift_order: 1,
            second_order: true,
            repeats: 1,
            standoff_mm: 0.5,
            search_mm: 1.0,
            monte_carlo_trials: 0,
        }
    }
}

const MIN_HEIGHT_DIFFERENCE_MM: f64 = 1.0;
/// Minimum cosine of the angle between an axis and Z of the machine frame: one degree.
pub const MIN_COSINE_TO_MACHINE_Z: f64 = 0.99985;

impl SelfCalibrationSettings {
    /// Whether the top face of the part is touched.
    pub fn touches_top(&self) -> bool {
        self.z_reference && (self.references || self.locate)
    }

    /// Rejects settings that would fail during the run.
    pub fn check(&self, part: &Cylinder, ball_radius_mm: f64) -> Result<(), MethodRefusal> {
        self.check_reach(part)?;
        self.check_heights_are_on_flank_and_apart(part, ball_radius_mm)?;
        MethodRefusal::require(
            (1..=100).contains(&self.repeats) && self.drift_order <= 3,
            "repeats must be 1 to 100, and drift_order 0 to 3",
            "remove repeats and drift_order",
        )?;
        MethodRefusal::check_monte_carlo_trials(self.monte_carlo_trials)
    }

    /// Checks that the touches of the top face, and with `locate` = false those of the flank, reach the part at every
    /// position within its uncertainty, and that the part is upright.
    fn check_reach(&self, part: &Cylinder) -> Result<(), MethodRefusal> {
        let Cylinder { uncertainty_mm, axis, radius_mm, .. } = part;
        MethodRefusal::require(
            self.standoff_mm > 0.0 && self.search_mm > 0.0,
            "standoff_mm and search_mm must be greater than 0",
            "remove both settings, or choose about 0.5 and 1.0",
        )?;
        MethodRefusal::require(
            self.locate || *uncertainty_mm < self.standoff_mm.min(self.search_mm),
            format!(
                "with locate = false the position of the part must be known within standoff_mm = {} and \
                    search_mm = {}, but [artefact] uncertainty_mm = {uncertainty_mm}",
                self.standoff_mm, self.search_mm
            ),
            "choose locate = true, or correct [artefact] uncertainty_mm",
        )?;
        let [x, y] = self.z_reference_at_mm;
        MethodRefusal::require(
            !self.touches_top() || x.hypot(y) + uncertainty_mm < *radius_mm,
            format!("the Z reference at [{x}, {y}] mm may miss the top face"),
            "choose z_reference_at_mm well inside the part's radius, or z_reference = false",
        )?;
        let length = axis.iter().map(|part| part * part).sum::<f64>().sqrt();
        let [x, y, z] = axis.map(|part| (part / length * 1e3).round() / 1e3 + 0.0);
        MethodRefusal::require(
            axis[2] > MIN_COSINE_TO_MACHINE_Z * length,
            format!(
                "the part is not upright in the measuring position: the axis of the part is along [{x}, {y}, {z}] of \
                the machine, not [0, 0, 1]"
            ),
            "this method requires an upright cylinder: correct [artefact] axis, which is the direction with \
            all axes at zero",
        )
    }

    /// The heights must be on the flank of the part and 1 mm apart.
    fn check_heights_are_on_flank_and_apart(&self, part: &Cylinder, ball_radius_mm: f64) -> Result<(), MethodRefusal> {
        let on_flank = |height: &f64| *height > ball_radius_mm && *height <= part.height_mm;
        let outside = self.heights_mm.iter().find(|height| !on_flank(height));
        MethodRefusal::require(
            outside.is_none(),
            format!("at a height of {} mm the ball is off the flank", outside.unwrap_or(&0.0)),
            "choose heights_mm above the ball's radius and up to the part's height_mm",
        )?;
        let close =
            |(i, a): (usize, &f64)| self.heights_mm[..i].iter().any(|b| (a - b).abs() < MIN_HEIGHT_DIFFERENCE_MM);
        MethodRefusal::require(
            !self.heights_mm.iter().enumerate().any(close),
            "two values of heights_mm differ by less than 1 mm",
            "choose heights_mm at least 1 mm apart; a large distance gives a smaller U",
        )
    }
}
