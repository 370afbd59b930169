//! Between the schedule and whoever asks at the desk: what comes next, what the machine tells of itself
//! when nobody presses a button, and a call that something is due.

use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Span, Timestamp, Zoned};
use serde::Serialize;
use tokio::sync::oneshot;

use super::board::Said;
use crate::store::{Arming, Journal, Slot, StoreError};

/// What the machine says of itself, and of what a cycle without anybody there needs beyond.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Told {
    pub said: Said,
    pub probe: bool,
    pub artefact: bool,
    pub temperature: bool,
    /// The control executes no program.
    pub idle: bool,
}

impl Told {
    /// Where several tell, all must say so.
    fn and(self, other: Self) -> Self {
        let (one, two) = (self.said, other.said);
        Self {
            said: Said {
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

/// One schedule, as it stands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Planned {
    pub name: String,
    pub cycle: u16,
    /// Pattern and zone, as the machine file says.
    pub at: String,
    pub zone: String,
    pub latest_min: u64,
    /// What comes, on the clock of its zone.
    pub next: Vec<Zoned>,
    /// Since when a slot waits, and what for.
    pub waiting: Option<String>,
}

/// A machine's schedule: what comes, who has armed what, and what became of the last slots, newest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agenda {
    pub planned: Vec<Planned>,
    pub armed: Vec<Arming>,
    pub last: Vec<Slot>,
}

/// As the page and the interface show it.
///
/// # Errors
/// The journal cannot be read.
pub fn agenda(journal: &Journal, rota: &Rota, machine: &str) -> Result<Agenda, StoreError> {
    const LAST: usize = 50;
    Ok(Agenda {
        planned: rota.planned(),
        armed: journal.armings(machine)?,
        last: journal.slots(machine, LAST)?,
    })
}

/// Nobody arms a machine for longer.
const LONGEST: SignedDuration = SignedDuration::from_hours(24 * 366);

/// `cycle` of `machine` is armed by `who` from `now` on, `until` an instant (`2027-01-31T18:00:00+01:00`) or
/// for so long (`14d`).
///
/// # Errors
/// It does not say until when, or that is over, or too far away.
pub fn arming(
    (machine, cycle): (&str, u16),
    (who, why): (&str, &str),
    until: &str,
    now: Timestamp,
) -> Result<Arming, String> {
    // Nobody reads nanoseconds.
    let now = Timestamp::from_second(now.as_second()).unwrap_or(now);
    let for_so_long =
        |span: Span| Some(now.to_zoned(TimeZone::UTC).checked_add(span).ok()?.timestamp());
    let instant = until.parse::<Timestamp>().ok();
    let instant = instant.or_else(|| until.parse::<Zoned>().ok().map(|zoned| zoned.timestamp()));
    let instant = instant.or_else(|| until.parse::<Span>().ok().and_then(for_so_long));
    let Some(until) = instant else {
        return Err(format!("`{until}` is neither an instant nor a time span"));
    };
    if until <= now {
        return Err(format!("{until} is over already"));
    }
    if until.duration_since(now) > LONGEST {
        return Err(format!("{until} is more than a year away; an arming must be renewed"));
    }
    let [machine, who, why] = [machine, who, why].map(str::to_owned);
    Ok(Arming { machine, cycle, who, why, armed: now, until, ended: None, broken: None })
}

/// Somebody says that `cycle` is due now. The answer: its slot starts, or why not.
pub struct Call {
    pub cycle: u16,
    pub who: String,
    pub answer: oneshot::Sender<Result<(), String>>,
}

type Teller = Box<dyn Fn() -> Told + Send>;

#[derive(Clone, Default)]
pub struct Rota(Arc<Mutex<Inner>>);

#[derive(Default)]
struct Inner {
    planned: Vec<Planned>,
    tellers: Vec<Teller>,
    calls: Option<Sender<Call>>,
}

impl Rota {
    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One more who knows how the machine stands.
    pub fn tells(&self, teller: impl Fn() -> Told + Send + 'static) {
        self.inner().tellers.push(Box::new(teller));
    }

    /// By all who are there to tell; `None` without one, or while one of them is silent: where nobody stands at
    /// the machine, the word of all counts.
    pub fn told(&self) -> Option<Told> {
        let all = self.all();
        all.iter().all(|told| told.said.fresh).then(|| all.into_iter().reduce(Told::and)).flatten()
    }

    /// By those whose word is fresh: a person can vouch for the others, but not against these.
    pub fn heard(&self) -> Option<Said> {
        let fresh = self.all().into_iter().filter(|told| told.said.fresh);
        fresh.reduce(Told::and).map(|told| told.said)
    }

    fn all(&self) -> Vec<Told> {
        self.inner().tellers.iter().map(|teller| teller()).collect()
    }

    pub fn planned(&self) -> Vec<Planned> {
        self.inner().planned.clone()
    }

    pub fn plans(&self, planned: Vec<Planned>) {
        self.inner().planned = planned;
    }

    /// Where calls go.
    pub fn listens(&self, calls: Sender<Call>) {
        self.inner().calls = Some(calls);
    }

    /// `cycle` is due, says `who`. `None`: no schedule is kept yet.
    pub fn due(&self, cycle: u16, who: String) -> Option<oneshot::Receiver<Result<(), String>>> {
        let (answer, told) = oneshot::channel();
        let calls = self.inner().calls.clone()?;
        calls.send(Call { cycle, who, answer }).ok()?;
        Some(told)
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
            ("-1d", "over"),
            ("2026-11-22T12:00:00Z", "over"),
            ("2y", "more than a year"),
        ] {
            let told = until(words).unwrap_err();
            assert!(told.contains(why), "{words}: {told}");
        }
    }

    #[test]
    fn where_several_tell_all_must_say_so_and_none_may_be_silent() {
        let said =
            Said { fresh: true, enable: true, auto: true, door: true, stop: false, person: false };
        let all = Told { said, probe: true, artefact: true, temperature: true, idle: true };
        let rota = Rota::default();
        assert_eq!((rota.told(), rota.heard()), (None, None));
        rota.tells(move || all);
        assert_eq!((rota.told(), rota.heard()), (Some(all), Some(said)));
        let silent = Rota::default();
        silent.tells(Told::default);
        silent.tells(move || all);
        assert_eq!((silent.told(), silent.heard()), (None, Some(said)));
        let other = Told { said: Said { door: false, stop: true, ..said }, idle: false, ..all };
        rota.tells(move || other);
        assert_eq!(rota.told(), Some(other));
    }
}
