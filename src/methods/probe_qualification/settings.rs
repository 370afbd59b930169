//! Settings of the method, the table `[method.probe-qualification]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProbeQualificationSettings {
    /// Id of the ball to be touched. Empty: the first ball that is accessible all around.
    pub ball: String,
    /// Number of directions on the main circle around the ball, at equal angles.
    pub azimuths: u32,
    /// Number of touches of each direction at the measuring feed, and again at the fast feed in the first spindle
    /// orientation.
    pub repeats: u32,
    /// Highest harmonic order of the map, unless `[probe] lobing_orders` or the default orders (2 to 6) have a higher
    /// one.
    pub orders: u32,
    /// Roundness of the ball by its certificate: largest minus smallest radius of a section (RONt, ISO 12181-1).
    /// Absent: not certified.
    #[serde(rename = "form_um", skip_serializing_if = "Option::is_none")]
    pub certified_roundness_um: Option<f64>,
    /// Orientations of the spindle, degrees. Absent: 0, 90, 180 and 270 if the spindle is an axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spindle_deg: Option<Vec<f64>>,
    /// Feed of the faster touches, above the measuring feed and at most the search feed. Absent: the search feed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fast_feed_mm_min: Option<f64>,
    /// Clearance before the expected contact, mm.
    pub standoff_mm: f64,
    /// Overtravel of a touch beyond the expected contact, mm.
    pub search_mm: f64,
}

impl Default for ProbeQualificationSettings {
    fn default() -> Self {
        Self {
            ball: String::new(),
            azimuths: 24,
            repeats: 3,
            orders: 6,
            certified_roundness_um: None,
            spindle_deg: None,
            fast_feed_mm_min: None,
            standoff_mm: 0.5,
            search_mm: 1.0,
        }
    }
}

const MAX_AZIMUTHS: u32 = 360;
const MAX_REPEATS: u32 = 100;
const MAX_HARMONIC_ORDER: u32 = 100;
/// Minimum of `standoff_mm` and of `search_mm`, each, before the part for the stylus offset is added, mm. A smaller
/// setting is refused.
const MIN_STANDOFF_OR_SEARCH_MM: f64 = 0.1;
/// Number of standard uncertainties of the stylus offset that are added to the minimum of `standoff_mm` and of
/// `search_mm`. A half turn of the spindle displaces the stylus by twice its offset.
const STYLUS_OFFSET_SIGMAS: f64 = 6.0;

impl ProbeQualificationSettings {
    /// # Errors
    /// The settings would fail during the run.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::check_number_ranges(
            &[("standoff_mm", self.standoff_mm), ("search_mm", self.search_mm)],
            &[("form_um", self.certified_roundness_um.unwrap_or(0.0))],
        )?;
        MethodRefusal::require(
            (2..=MAX_REPEATS).contains(&self.repeats),
            format!("repeats = {}: the repeatability requires 2 to 100 touches in each direction", self.repeats),
            "choose repeats = 3 (2 to 100)",
        )?;
        MethodRefusal::require(
            (3..=MAX_HARMONIC_ORDER).contains(&self.orders) && self.azimuths <= MAX_AZIMUTHS,
            "orders must be 3 to 100, and azimuths at most 360",
            "remove orders (default 6) and azimuths (default 24)",
        )?;
        let is_angle = |degrees: &f64| (-360.0..=360.0).contains(degrees);
        MethodRefusal::require(
            self.spindle_deg.iter().flatten().all(is_angle),
            "spindle_deg contains an angle outside -360° to 360°",
            "remove spindle_deg, or choose for example [0, 90, 180, 270]",
        )
    }

    /// Checks that stand-off and search of the touches are long enough. `u_stylus_offset_mm`: standard uncertainty of
    /// the stylus offset.
    ///
    /// # Errors
    /// The touches are so short that a turned stylus could miss the ball.
    pub fn check_touch_length(&self, u_stylus_offset_mm: f64) -> Result<(), MethodRefusal> {
        let least = MIN_STANDOFF_OR_SEARCH_MM + STYLUS_OFFSET_SIGMAS * u_stylus_offset_mm;
        MethodRefusal::require(
            self.standoff_mm >= least && self.search_mm >= least,
            format!("standoff_mm and search_mm must be at least {least:.2}, because of the stylus offset"),
            "remove both settings, or choose 0.5 and 1.0",
        )
    }

    /// Requires at least 2 · `highest_order` + 2 azimuths.
    ///
    /// # Errors
    /// There are too few directions to separate the orders up to `highest_order`.
    pub fn check_azimuths(&self, highest_order: u32) -> Result<(), MethodRefusal> {
        let least = highest_order.saturating_mul(2).saturating_add(2);
        MethodRefusal::require(
            self.azimuths >= least,
            format!("{} azimuths do not separate the orders up to {highest_order}", self.azimuths),
            format!("choose azimuths = {least} or more"),
        )
    }
}
