//! The slow and the fast feed, and the distance that a touch at the fast feed needs.

use crate::MethodRefusal;
use machine::record::machine::{Machine, Probe};

use super::settings::LatchDelaySettings;

/// Minimum ratio of the fast to the measuring feed. A smaller ratio is refused.
const MIN_FEED_RATIO: f64 = 2.0;
/// Longest latch delay for which the touches are planned, s: the fast touch keeps its feed for this time after contact.
const MAX_LATCH_DELAY_S: f64 = 0.05;
/// Factor on the acceleration distance. Declared accelerations are maxima; a smooth start needs about twice the
/// distance.
const ACCELERATION_DISTANCE_FACTOR: f64 = 2.0;
/// Factor by which a default feed is lowered in each step.
const FEED_REDUCTION_FACTOR: f64 = 0.9;

/// Feeds of the slow and the fast touches, and the lengths that the fast feed needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TouchFeeds {
    pub measuring_feed_mm_min: f64,
    pub fast_feed_mm_min: f64,
    /// Distance over which the fast touch accelerates to its feed, mm.
    pub fast_run_up_mm: f64,
    /// Distance that the fast touch needs before the first and beyond the last possible contact, mm. Within this
    /// distance the touch reaches its feed and keeps it for longer than any latch delay.
    pub fast_touch_margin_mm: f64,
}

impl TouchFeeds {
    /// Chooses the feeds. Without a fast feed in the settings, the search feed is lowered until the touch fits in the
    /// overtravel; a stated fast feed is not lowered. `length_mm`: length of a touch for a given `margin_mm`.
    ///
    /// # Errors
    /// The feeds are too close to each other, the fast feed exceeds the rapid rate of an axis, or the touch would be
    /// longer than the overtravel.
    pub fn from_settings(
        machine: &Machine,
        probe: &Probe,
        settings: &LatchDelaySettings,
        length_mm: impl Fn(f64) -> f64,
    ) -> Result<Self, MethodRefusal> {
        let min_mm_min = MIN_FEED_RATIO * probe.feed_mm_min;
        let overtravel = probe.overtravel_mm;
        let fits = |feeds: &Self| length_mm(feeds.fast_touch_margin_mm) <= overtravel;
        let largest_mm_min = settings.fast_feed_mm_min.unwrap_or(probe.search_feed_mm_min);
        let mut feeds = Self::from_fast_feed(machine, probe, largest_mm_min);
        if settings.fast_feed_mm_min.is_none() {
            while feeds.fast_feed_mm_min * FEED_REDUCTION_FACTOR >= min_mm_min && !fits(&feeds) {
                feeds = Self::from_fast_feed(machine, probe, (feeds.fast_feed_mm_min * FEED_REDUCTION_FACTOR).floor());
            }
        }
        let Self { fast_feed_mm_min: fast_mm_min, .. } = feeds;
        let linear = machine.axes.iter().filter(|(axis, _)| axis.is_linear());
        let rapid = linear.map(|(_, spec)| spec.rapid_per_min).fold(f64::INFINITY, f64::min);
        MethodRefusal::require(
            (min_mm_min..=rapid).contains(&fast_mm_min),
            format!(
                "the fast feed of {fast_mm_min} mm/min is not allowed: it must be at least \
                     {MIN_FEED_RATIO} times the measuring feed of {} mm/min, and at most the rapid \
                     rate of the axes, {rapid} mm/min",
                probe.feed_mm_min
            ),
            "state fast_feed_mm_min in [method.latch-delay], ten times feed_mm_min if the \
                          overtravel allows",
        )?;
        MethodRefusal::require(
            fits(&feeds),
            format!(
                "a touch at {fast_mm_min} mm/min would be {:.2} mm long, more than the overtravel \
                 of {overtravel} mm: {:.2} mm of it are for acceleration and for a delay of up to \
                 {} ms",
                length_mm(feeds.fast_touch_margin_mm),
                2.0 * feeds.fast_touch_margin_mm,
                MAX_LATCH_DELAY_S * 1e3
            ),
            "reduce fast_feed_mm_min in [method.latch-delay], or uncertainty_mm in [artefact] \
                 (mount the part nearer to its stated position)",
        )?;
        Ok(feeds)
    }

    fn from_fast_feed(machine: &Machine, probe: &Probe, fast_feed_mm_min: f64) -> Self {
        let fast_run_up_mm = ACCELERATION_DISTANCE_FACTOR * acceleration_distance_mm(machine, fast_feed_mm_min);
        let fast_touch_margin_mm = fast_run_up_mm + fast_feed_mm_min / 60.0 * MAX_LATCH_DELAY_S;
        Self { measuring_feed_mm_min: probe.feed_mm_min, fast_feed_mm_min, fast_run_up_mm, fast_touch_margin_mm }
    }
}

/// Acceleration distance to the feed on the slowest linear axis: v²/2a.
pub fn acceleration_distance_mm(machine: &Machine, feed_mm_min: f64) -> f64 {
    (feed_mm_min / 60.0).powi(2) / (2.0 * machine.min_linear_acceleration_mm_s2())
}
