//! The two feeds, and the distance that a touch at the faster one needs.

use crate::Refused;
use machine::record::machine::{Machine, Probe};

use super::settings::Settings;

/// Minimum ratio of the two feeds.
const LEAST_RATIO: f64 = 2.0;
/// Longest delay during which a touch must remain at its full feed, s.
const LONGEST_DELAY_S: f64 = 0.05;
/// Factor on the acceleration distance. Declared accelerations are maxima; a smooth start needs about twice the
/// distance.
const ACCELERATION_DISTANCE_FACTOR: f64 = 2.0;
/// Factor by which a default feed is lowered in each step.
const LOWER: f64 = 0.9;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feeds {
    pub measuring_mm_min: f64,
    pub fast_mm_min: f64,
    /// Distance over which the fast touch accelerates to its feed, mm.
    pub run_up_mm: f64,
    /// Distance that the fast touch needs before the first and beyond the last possible contact, mm, so that it
    /// moves at its feed for longer than any delay.
    pub room_mm: f64,
}

impl Feeds {
    /// Chooses the feeds. `length_mm`: length of a touch with a given room.
    ///
    /// # Errors
    /// The feeds are too close to each other, no axis reaches one of them, or the touch would be longer than the
    /// overtravel.
    pub fn choose(
        (machine, probe): (&Machine, &Probe),
        settings: &Settings,
        length_mm: impl Fn(f64) -> f64,
    ) -> Result<Self, Refused> {
        let least = LEAST_RATIO * probe.feed_mm_min;
        let overtravel = probe.overtravel_mm;
        let fits = |feeds: &Self| length_mm(feeds.room_mm) <= overtravel;
        let mut feeds = Self::of(machine, probe, settings.fast_feed_mm_min);
        if settings.fast_feed_mm_min.is_none() {
            while feeds.fast_mm_min * LOWER >= least && !fits(&feeds) {
                feeds = Self::of(machine, probe, Some((feeds.fast_mm_min * LOWER).floor()));
            }
        }
        let Self { fast_mm_min, .. } = feeds;
        let rapid = linear(machine, |spec| spec.rapid_per_min);
        if !(least..=rapid).contains(&fast_mm_min) {
            return Err(Refused {
                why: format!(
                    "a fast feed of {fast_mm_min} mm/min beside a measuring feed of {} mm/min: it must be \
                     at least {LEAST_RATIO} times that, and at most the {rapid} mm/min of the axes",
                    probe.feed_mm_min
                ),
                instead:
                    "state fast_feed_mm_min in [method.latch-delay], ten times feed_mm_min if the \
                          overtravel allows"
                        .to_owned(),
            });
        }
        if fits(&feeds) {
            return Ok(feeds);
        }
        Err(Refused {
            why: format!(
                "a touch at {fast_mm_min} mm/min would be {:.2} mm long, more than the overtravel of \
                 {overtravel} mm: {:.2} mm of it to come to its feed and to see a delay of {} ms",
                length_mm(feeds.room_mm),
                2.0 * feeds.room_mm,
                LONGEST_DELAY_S * 1e3
            ),
            instead:
                "lower fast_feed_mm_min in [method.latch-delay], or [artefact] uncertainty_mm: set \
                      the part up nearer to where the file says"
                    .to_owned(),
        })
    }

    fn of(machine: &Machine, probe: &Probe, fast_mm_min: Option<f64>) -> Self {
        let fast_mm_min = fast_mm_min.unwrap_or(probe.search_feed_mm_min);
        let run_up_mm = ACCELERATION_DISTANCE_FACTOR * run_up_mm(machine, fast_mm_min);
        let room_mm = run_up_mm + fast_mm_min / 60.0 * LONGEST_DELAY_S;
        Self { measuring_mm_min: probe.feed_mm_min, fast_mm_min, run_up_mm, room_mm }
    }
}

/// Acceleration distance to the feed on the slowest linear axis: v²/2a.
pub fn run_up_mm(machine: &Machine, feed_mm_min: f64) -> f64 {
    let weakest = linear(machine, |spec| spec.acceleration_per_s2);
    (feed_mm_min / 60.0).powi(2) / (2.0 * weakest)
}

/// Minimum over the linear axes.
fn linear(machine: &Machine, of: impl Fn(&machine::record::machine::AxisSpec) -> f64) -> f64 {
    let axes = machine.axes.iter().filter(|(axis, _)| axis.is_linear());
    axes.map(|(_, spec)| of(spec)).fold(f64::INFINITY, f64::min)
}
