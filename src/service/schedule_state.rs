//! Schedule of a machine: the planned slots, the machine's readiness for an unattended start, and requests that a
//! cycle is due.

use std::sync::Arc;

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Span, Timestamp, Zoned};
use serde::Serialize;
use tokio::sync::oneshot;

use super::machine_state::{Interlocks, PlannedSchedule};
use super::not_started::NotStartedReason;
use crate::store::{Arming, Journal, ScheduleSlot, StoreError};

/// Interlocks that the machine reports, and the further conditions of an unattended cycle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Readiness {
    pub interlocks: Interlocks,
    /// Whether the probe is in the spindle and operational.
    pub is_probe_ready: bool,
    /// Whether the artefact is at the position of the machine file.
    pub is_artefact_in_place: bool,
    /// Whether the machine and its surroundings are at the agreed temperature.
    pub is_temperature_in_range: bool,
    /// Whether the control executes no program.
    pub is_control_idle: bool,
}

impl Readiness {
    /// Combines the fresh reports of several sources: every condition must hold in all of them, and a stop input of
    /// one is enough. The result counts as fresh.
    pub(super) fn combine(self, other: Self) -> Self {
        let (one, two) = (self.interlocks, other.interlocks);
        Self {
            interlocks: Interlocks {
                is_fresh: true,
                is_start_enabled: one.is_start_enabled && two.is_start_enabled,
                is_auto_mode: one.is_auto_mode && two.is_auto_mode,
                is_door_closed: one.is_door_closed && two.is_door_closed,
                is_stop_set: one.is_stop_set || two.is_stop_set,
                has_person_for_prompts: false,
            },
            is_probe_ready: self.is_probe_ready && other.is_probe_ready,
            is_artefact_in_place: self.is_artefact_in_place && other.is_artefact_in_place,
            is_temperature_in_range: self.is_temperature_in_range && other.is_temperature_in_range,
            is_control_idle: self.is_control_idle && other.is_control_idle,
        }
    }
}

/// Schedule of a machine: next times, armings, and the outcome of the last slots, newest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agenda {
    /// Schedules of the machine file with their next times.
    pub planned: Vec<PlannedSchedule>,
    /// The last arming of each cycle, also if it has ended.
    #[serde(rename = "armed")]
    pub last_armings: Vec<Arming>,
    /// Newest slots with their outcome, newest first.
    #[serde(rename = "last")]
    pub newest_slots: Vec<ScheduleSlot>,
}

/// Collects the schedule data that the web page and the HTTP API show.
///
/// # Errors
/// The journal cannot be read.
pub fn load_agenda(journal: &Journal, planned: Vec<PlannedSchedule>, machine: &str) -> Result<Agenda, StoreError> {
    const MAX_LISTED_SLOTS: usize = 50;
    Ok(Agenda {
        planned,
        last_armings: journal.last_arming_of_each_cycle(machine)?,
        newest_slots: journal.newest_slots(machine, MAX_LISTED_SLOTS)?,
    })
}

/// Maximum duration of an arming.
const MAX_ARMING_DURATION: SignedDuration = SignedDuration::from_hours(24 * 366);

/// Arming of `cycle` of `machine` by `who` from `now` on. It ends at `until`: an instant
/// (`2027-01-31T18:00:00+01:00`), or a duration from `now` (`14d`).
///
/// # Errors
/// `until` is neither an instant nor a duration, is in the past, or is more than a year away.
pub fn new_arming(
    machine: &str,
    cycle: u16,
    who: &str,
    why: &str,
    until: &str,
    now: Timestamp,
) -> Result<Arming, String> {
    // Whole seconds are enough for a person.
    let now = Timestamp::from_second(now.as_second()).unwrap_or(now);
    let for_so_long = |span: Span| Some(now.to_zoned(TimeZone::UTC).checked_add(span).ok()?.timestamp());
    let instant = until.parse::<Timestamp>().ok();
    let instant = instant.or_else(|| until.parse::<Zoned>().ok().map(|zoned| zoned.timestamp()));
    let instant = instant.or_else(|| until.parse::<Span>().ok().and_then(for_so_long));
    let Some(until) = instant else {
        return Err(format!("`{until}` is neither a time nor a duration"));
    };
    if until <= now {
        return Err(format!("{until} has already passed"));
    }
    if until.duration_since(now) > MAX_ARMING_DURATION {
        return Err(format!("{until} is more than a year away; an arming lasts at most a year"));
    }
    let [machine, who, why] = [machine, who, why].map(str::to_owned);
    Ok(Arming { machine, cycle, who, why, armed: now, until, ended: None, broken_by_run: None })
}

/// Command to start `cycle` now, because a client reports that the cycle is due. Result: `Ok` if the cycle starts,
/// otherwise the reason why it does not start.
pub struct StartDueCycleRequest {
    pub cycle: u16,
    /// Name of the client that reports the cycle as due.
    pub who: String,
    pub result_sender: oneshot::Sender<Result<(), NotStartedReason>>,
}

/// Returns the present report of one source; without a recent report its interlocks are not fresh.
pub(super) type ReadinessSource = Arc<dyn Fn() -> Readiness + Send + Sync>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arming_end_must_be_a_time_or_duration_within_a_year() {
        let now: Timestamp = "2026-11-22T12:00:00Z".parse().unwrap();
        let until =
            |words: &str| new_arming("the mill", 1, "Ada", "", words, now).map(|arming| arming.until.to_string());
        assert_eq!(until("14d").unwrap(), "2026-12-06T12:00:00Z");
        assert_eq!(until("8h").unwrap(), "2026-11-22T20:00:00Z");
        assert_eq!(until("2026-12-24T06:00:00+01:00").unwrap(), "2026-12-24T05:00:00Z");
        assert_eq!(until("2026-12-24T06:00[Europe/Berlin]").unwrap(), "2026-12-24T05:00:00Z");
        for (words, why) in [
            ("tomorrow", "neither"),
            ("2026-12-24T06:00", "neither"),
            ("-1d", "passed"),
            ("2026-11-22T12:00:00Z", "passed"),
            ("2y", "more than a year"),
        ] {
            let error = until(words).unwrap_err();
            assert!(error.contains(why), "{words}: {error}");
        }
    }
}
