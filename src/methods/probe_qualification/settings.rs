//! Settings of the method, the table `[method.probe-qualification]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Id of the ball to be touched. Empty: the first one that is accessible all around.
    pub ball: String,
    /// Number of directions around the ball, at equal angles.
    pub azimuths: u32,
    /// Touches of each direction at the measuring feed, and at the fast feed.
    pub repeats: u32,
    /// Highest harmonic order of the map, unless `[probe] lobing_orders` has a higher one.
    pub orders: u32,
    /// Roundness of the ball by its certificate: largest less smallest radius of a section (RONt, ISO 12181-1).
    /// Absent: not certified.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form_um: Option<f64>,
    /// Orientations of the spindle, degrees. Absent: 0, 90, 180 and 270 if the spindle is an axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spindle_deg: Option<Vec<f64>>,
    /// Feed of the faster touches. Absent: the search feed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fast_feed_mm_min: Option<f64>,
    /// Clearance before the expected contact, mm.
    pub standoff_mm: f64,
    /// Overtravel of a touch beyond the expected contact, mm.
    pub search_mm: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            ball: String::new(),
            azimuths: 24,
            repeats: 3,
            orders: 6,
            form_um: None,
            spindle_deg: None,
            fast_feed_mm_min: None,
            standoff_mm: 0.5,
            search_mm: 1.0,
        }
    }
}

const MOST_AZIMUTHS: u32 = 360;
const MOST_REPEATS: u32 = 100;
const MOST_ORDERS: u32 = 100;
/// Minimum distance before and beyond the expected contact: [`LEAST_MM`] in mm plus [`OFFSETS`] standard deviations
/// of the stylus offset. A half turn of the spindle displaces the stylus by twice its offset.
const LEAST_MM: f64 = 0.1;
const OFFSETS: f64 = 6.0;

impl Settings {
    /// # Errors
    /// The settings would fail during the run.
    pub fn check(&self) -> Result<(), Refused> {
        Refused::check_numbers(
            &[("standoff_mm", self.standoff_mm), ("search_mm", self.search_mm)],
            &[("form_um", self.form_um.unwrap_or(0.0))],
        )?;
        Refused::unless(
            (2..=MOST_REPEATS).contains(&self.repeats),
            format!("{} touches of a direction do not show how they repeat", self.repeats),
            "choose repeats = 3, at least 2 and at most 100",
        )?;
        Refused::unless(
            (3..=MOST_ORDERS).contains(&self.orders) && self.azimuths <= MOST_AZIMUTHS,
            "orders must be 3 to 100, and azimuths no more than 360",
            "leave orders (6) and azimuths (24) out",
        )?;
        let is_angle = |degrees: &f64| (-360.0..=360.0).contains(degrees);
        Refused::unless(
            self.spindle_deg.iter().flatten().all(is_angle),
            "spindle_deg has an angle beyond a turn",
            "leave it out, or choose e.g. [0, 90, 180, 270]",
        )
    }

    /// Checks the length of the touches. `offset_mm`: standard uncertainty of the stylus offset.
    ///
    /// # Errors
    /// The touches are so short that a turned stylus could miss the ball.
    pub fn check_length(&self, offset_mm: f64) -> Result<(), Refused> {
        let least = LEAST_MM + OFFSETS * offset_mm;
        Refused::unless(
            self.standoff_mm >= least && self.search_mm >= least,
            format!(
                "standoff_mm and search_mm must be {least:.2} or more: the stylus may stand off"
            ),
            "leave them out, or choose 0.5 and 1.0",
        )
    }

    /// # Errors
    /// There are too few directions to separate the orders up to `last`.
    pub fn check_azimuths(&self, last: u32) -> Result<(), Refused> {
        let least = last.saturating_mul(2).saturating_add(2);
        Refused::unless(
            self.azimuths >= least,
            format!("{} azimuths do not tell the orders up to {last} apart", self.azimuths),
            format!("choose azimuths = {least} or more"),
        )
    }
}
