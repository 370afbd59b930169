//! Schedule of a machine: the planned slots, the machine's readiness for an unattended start, and requests that a
//! cycle is due.

use std::sync::Arc;
use std::sync::mpsc::Sender;

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Span, Timestamp, Zoned};
use serde::Serialize;
use tokio::sync::oneshot;

use super::command_gate::CommandGate;
use super::machine_state::Interlocks;
use crate::store::{Arming, Journal, ScheduleSlot, StoreError};

/// Interlocks that the machine reports, and the further conditions of an unattended cycle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Readiness {
    pub interlocks: Interlocks,
    pub probe: bool,
    pub artefact: bool,
    pub temperature: bool,
    /// Whether the control executes no program.
    pub idle: bool,
}

impl Readiness {
    /// Combines the reports of several sources: every condition must hold in all of them.
    fn and(self, other: Self) -> Self {
        let (one, two) = (self.interlocks, other.interlocks);
        Self {
            interlocks: Interlocks {
                fresh: true,
                enable: one.enable && two.enable,
                auto: one.auto && two.auto,
                door: one.door && two.door,
                stop: one.stop || two.stop,
                person: false,
            },
            probe: self.probe && other.probe,
            artefact: self.artefact && other.artefact,
            temperature: self.temperature && other.temperature,
            idle: self.idle && other.idle,
        }
    }
}

/// Current state of one schedule.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Planned {
    pub name: String,
    pub cycle: u16,
    /// Time pattern and time zone, as in the machine file.
    pub at: String,
    pub zone: String,
    pub latest_min: u64,
    /// Next times, in the schedule's time zone.
    pub next: Vec<Zoned>,
    /// Since when a due slot has been waiting, and for which condition.
    pub waiting: Option<String>,
}

/// Schedule of a machine: next times, armings, and the outcome of the last slots, newest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agenda {
    pub planned: Vec<Planned>,
    pub armed: Vec<Arming>,
    pub last: Vec<ScheduleSlot>,
}

/// Collects what the page and the HTTP API show of a schedule.
///
/// # Errors
/// The journal cannot be read.
pub fn agenda(
    journal: &Journal,
    planned: Vec<Planned>,
    machine: &str,
) -> Result<Agenda, StoreError> {
    const LAST: usize = 50;
    Ok(Agenda {
        planned,
        armed: journal.armings(machine)?,
        last: journal.newest_slots(machine, LAST)?,
    })
}

/// Maximum duration of an arming.
const LONGEST: SignedDuration = SignedDuration::from_hours(24 * 366);

/// Arming of `cycle` of `machine` by `who` from `now` on. `until` is an instant (`2027-01-31T18:00:00+01:00`) or
/// a duration (`14d`).
///
/// # Errors
/// `until` is neither an instant nor a duration, is in the past, or is more than a year away.
pub fn arming(
    (machine, cycle): (&str, u16),
    (who, why): (&str, &str),
    until: &str,
    now: Timestamp,
) -> Result<Arming, String> {
    // Whole seconds are enough for a reader.
    let now = Timestamp::from_second(now.as_second()).unwrap_or(now);
    let for_so_long =
        |span: Span| Some(now.to_zoned(TimeZone::UTC).checked_add(span).ok()?.timestamp());
    let instant = until.parse::<Timestamp>().ok();
    let instant = instant.or_else(|| until.parse::<Zoned>().ok().map(|zoned| zoned.timestamp()));
    let instant = instant.or_else(|| until.parse::<Span>().ok().and_then(for_so_long));
    let Some(until) = instant else {
        return Err(format!("`{until}` is neither a time nor a duration"));
    };
    if until <= now {
        return Err(format!("{until} has already passed"));
    }
    if until.duration_since(now) > LONGEST {
        return Err(format!("{until} is more than a year away; an arming lasts at most a year"));
    }
    let [machine, who, why] = [machine, who, why].map(str::to_owned);
    Ok(Arming { machine, cycle, who, why, armed: now, until, ended: None, broken: None })
}

/// Request that `cycle` is due now. The answer: its slot starts, or the reason why not.
pub struct DueRequest {
    pub cycle: u16,
    pub who: String,
    pub answer: oneshot::Sender<Result<(), String>>,
}

pub(super) type ReadinessSource = Arc<dyn Fn() -> Readiness + Send + Sync>;

/// What the schedule and the triggers share of a machine.
impl CommandGate {
    /// Adds a source that reports the readiness of the machine.
    pub fn add_readiness_source(&self, source: impl Fn() -> Readiness + Send + Sync + 'static) {
        self.inner().readiness_sources.push(Arc::new(source));
    }

    /// Combined readiness of all sources. `None` without a source, or while one of them is stale: an unattended start
    /// needs the report of every source.
    pub fn combined_readiness(&self) -> Option<Readiness> {
        let reports = self.readiness_reports();
        let is_fresh = reports.iter().all(|report| report.interlocks.fresh);
        is_fresh.then(|| reports.into_iter().reduce(Readiness::and)).flatten()
    }

    /// Combined interlocks of the fresh sources only: a person can replace a stale source, but cannot override a
    /// fresh one.
    pub fn fresh_interlocks(&self) -> Option<Interlocks> {
        let fresh = self.readiness_reports().into_iter().filter(|report| report.interlocks.fresh);
        fresh.reduce(Readiness::and).map(|report| report.interlocks)
    }

    fn readiness_reports(&self) -> Vec<Readiness> {
        // A source may use the gate: the lock is released before the sources are called.
        let sources = self.inner().readiness_sources.clone();
        sources.iter().map(|source| source()).collect()
    }

    /// Sets the channel on which the scheduler receives the requests that a cycle is due.
    pub fn set_due_requests(&self, due_requests: Sender<DueRequest>) {
        self.inner().due_requests = Some(due_requests);
    }

    /// Requests on behalf of `who` that `cycle` is due now. `None`: no schedule is running yet.
    pub fn request_due(
        &self,
        cycle: u16,
        who: String,
    ) -> Option<oneshot::Receiver<Result<(), String>>> {
        let (answer, answered) = oneshot::channel();
        let due_requests = self.inner().due_requests.clone()?;
        due_requests.send(DueRequest { cycle, who, answer }).ok()?;
        Some(answered)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arming_ends_within_a_year() {
        let now: Timestamp = "2026-11-22T12:00:00Z".parse().unwrap();
        let until = |words: &str| {
            arming(("the mill", 1), ("Ada", ""), words, now).map(|arming| arming.until.to_string())
        };
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
            let told = until(words).unwrap_err();
            assert!(told.contains(why), "{words}: {told}");
        }
    }

    #[test]
    fn where_several_tell_all_must_say_so_and_none_may_be_silent() {
        let interlocks = Interlocks {
            fresh: true,
            enable: true,
            auto: true,
            door: true,
            stop: false,
            person: false,
        };
        let all =
            Readiness { interlocks, probe: true, artefact: true, temperature: true, idle: true };
        let gate = CommandGate::for_tests().0;
        assert_eq!((gate.combined_readiness(), gate.fresh_interlocks()), (None, None));
        gate.add_readiness_source(move || all);
        assert_eq!(
            (gate.combined_readiness(), gate.fresh_interlocks()),
            (Some(all), Some(interlocks))
        );
        let silent = CommandGate::for_tests().0;
        silent.add_readiness_source(Readiness::default);
        silent.add_readiness_source(move || all);
        assert_eq!(
            (silent.combined_readiness(), silent.fresh_interlocks()),
            (None, Some(interlocks))
        );
        let other = Readiness {
            interlocks: Interlocks { door: false, stop: true, ..interlocks },
            idle: false,
            ..all
        };
        gate.add_readiness_source(move || other);
        assert_eq!(gate.combined_readiness(), Some(other));
    }
}
