//! Settings of the method, the table `[method.latch-delay]` of the machine file.

use serde::{Deserialize, Serialize};

use crate::Refused;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Feed of the faster touches. Absent: the search feed, reduced so that the axes can brake within the
    /// overtravel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fast_feed_mm_min: Option<f64>,
    /// Number of touches at each feed.
    pub touches: u32,
    /// Azimuth of the probe position at the artefact, seen from above, from X towards Y. Absent: for a round part
    /// the first of 0°, 90°, 180° and 270° that the axes reach, for a ball from above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction_deg: Option<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { fast_feed_mm_min: None, touches: 12, direction_deg: None }
    }
}

/// Minimum number of touches at each feed for an estimate of their scatter.
pub const LEAST_TOUCHES: u32 = 5;
const MOST_TOUCHES: u32 = 200;

impl Settings {
    /// Rejects settings that would fail during the run.
    pub fn check(&self) -> Result<(), Refused> {
        let refused = |why, instead: &str| Err(Refused { why, instead: instead.to_owned() });
        if !(LEAST_TOUCHES..=MOST_TOUCHES).contains(&self.touches) {
            return refused(
                format!(
                    "{} touches at each feed; {LEAST_TOUCHES} to {MOST_TOUCHES} tell how they scatter",
                    self.touches
                ),
                "leave touches out (12)",
            );
        }
        if self.direction_deg.is_some_and(|degrees| !(-360.0..=360.0).contains(&degrees)) {
            return refused(
                "direction_deg is no angle within a turn".to_owned(),
                "leave it out, or choose e.g. 90",
            );
        }
        Ok(())
    }
}
