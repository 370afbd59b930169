//! Settings of the method, the table `[method.latch-delay]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::MethodRefusal;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LatchDelaySettings {
    /// Feed of the faster touches. Absent: the search feed, reduced so that the axes can brake within the
    /// overtravel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fast_feed_mm_min: Option<f64>,
    /// Number of touches at each feed, without the search touch.
    pub touches: u32,
    /// Azimuth of the probe position at the artefact, seen from above, from X towards Y, with the table at zero. For
    /// a ball, the candidate touch nearest to this direction is used. Absent: for a round part the first of 0°, 90°,
    /// 180° and 270° that the axes reach, for a ball from above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction_deg: Option<f64>,
}

impl Default for LatchDelaySettings {
    fn default() -> Self {
        Self { fast_feed_mm_min: None, touches: 12, direction_deg: None }
    }
}

/// Minimum number of planned touches at each feed. Fewer are refused: they do not estimate the scatter.
pub const MIN_PLANNED_TOUCHES_PER_FEED: u32 = 5;
const MAX_PLANNED_TOUCHES_PER_FEED: u32 = 200;

impl LatchDelaySettings {
    /// Checks `touches` and `direction_deg`. `fast_feed_mm_min` is checked when the feeds are chosen.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::require(
            (MIN_PLANNED_TOUCHES_PER_FEED..=MAX_PLANNED_TOUCHES_PER_FEED).contains(&self.touches),
            format!(
                "touches = {} at each feed is outside {MIN_PLANNED_TOUCHES_PER_FEED} to {MAX_PLANNED_TOUCHES_PER_FEED}",
                self.touches
            ),
            "omit touches (default 12)",
        )?;
        MethodRefusal::require(
            self.direction_deg.is_none_or(|degrees| (-360.0..=360.0).contains(&degrees)),
            "direction_deg is outside -360 to 360",
            "omit it, or choose e.g. 90",
        )
    }
}
