//! How things stand, for whoever asks.

use serde::Serialize;
use utoipa::ToSchema;

use super::config::Demand;
use crate::run::Asked;
use machine::record::estimate::{Parameter, Verdict};
use machine::record::watch::LiveValues;

/// What the service does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum State {
    #[default]
    Starting = 0,
    Waiting = 1,
    Running = 2,
    /// The machine holds, or an unfinished run waits: for a person.
    Held = 3,
    /// The last cycle could not be measured; nothing of it is unfinished.
    Failed = 4,
    Ending = 5,
}

impl State {
    pub const ALL: [Self; 6] =
        [Self::Starting, Self::Waiting, Self::Running, Self::Held, Self::Failed, Self::Ending];

    pub fn word(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Waiting => "waiting",
            Self::Running => "running",
            Self::Held => "held",
            Self::Failed => "failed",
            Self::Ending => "ending",
        }
    }
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    #[error("a run is on")]
    Busy = 1,
    #[error("the machine is held: a person must look at it and acknowledge")]
    Held = 2,
    #[error("the last cycle failed and is not acknowledged")]
    Failed = 3,
    #[error("the configuration has no such cycle")]
    NoSuchCycle = 4,
    #[error("the external start is not enabled at the machine")]
    NotEnabled = 5,
    #[error("the control is not in its automatic mode")]
    NotAuto = 6,
    #[error("a guard is open")]
    DoorOpen = 7,
    #[error("the control's sign of life is too old")]
    Stale = 8,
    #[error("the last cycle ended or was asked for only just now")]
    TooSoon = 9,
    #[error("the stop is asked for as well")]
    Stopped = 10,
    #[error("several cycles at once")]
    Several = 11,
    #[error("the service is not ready")]
    NotReady = 12,
    #[error("the control may have lost its position: home, then `trued resume`")]
    PositionLost = 13,
    #[error("another program has the machine")]
    Elsewhere = 14,
    #[error("there is nothing to acknowledge")]
    NothingToAcknowledge = 15,
    #[error("no such word")]
    Unreadable = 16,
    #[error("its plan asks a person: somebody must be there who starts and answers it")]
    AsksPerson = 17,
    #[error("that is not asked, or not any more")]
    NotAsked = 18,
}

/// All of them.
#[cfg(test)]
pub const REFUSALS: [Refusal; 18] = [
    Refusal::Busy,
    Refusal::Held,
    Refusal::Failed,
    Refusal::NoSuchCycle,
    Refusal::NotEnabled,
    Refusal::NotAuto,
    Refusal::DoorOpen,
    Refusal::Stale,
    Refusal::TooSoon,
    Refusal::Stopped,
    Refusal::Several,
    Refusal::NotReady,
    Refusal::PositionLost,
    Refusal::Elsewhere,
    Refusal::NothingToAcknowledge,
    Refusal::Unreadable,
    Refusal::AsksPerson,
    Refusal::NotAsked,
];

/// What the machine says of itself, as far as it is fresh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Said {
    pub fresh: bool,
    pub enable: bool,
    pub auto: bool,
    pub door: bool,
    pub stop: bool,
    /// Somebody has started it who answers what it asks; no machine says so.
    pub person: bool,
}

impl Said {
    pub(super) fn lacks(self, demands: &[Demand]) -> Option<Refusal> {
        if !self.fresh {
            return Some(Refusal::Stale);
        }
        let missing = |demand: &Demand| match demand {
            Demand::Enable => (!self.enable).then_some(Refusal::NotEnabled),
            Demand::Auto => (!self.auto).then_some(Refusal::NotAuto),
            Demand::Door => (!self.door).then_some(Refusal::DoorOpen),
        };
        demands.iter().find_map(missing).or(self.stop.then_some(Refusal::Stopped))
    }
}

/// How things stand: everything that a trigger may tell.
#[derive(Debug, Clone, Default)]
pub struct Board {
    pub state: State,
    pub progress_percent: u16,
    /// Of the last cycle that came to its end; `None` before.
    pub verdict: Option<Verdict>,
    /// The cycle that runs or ran last, 0 before.
    pub cycle: u16,
    /// The run of this cycle, 0 before it has one.
    pub run: u32,
    /// Counters, they wrap.
    pub accepted: u16,
    pub refused: u16,
    pub refusal: Option<Refusal>,
    /// Runs that were identified while the machine waited; it wraps.
    pub identified: u16,
    pub deviations: Vec<Parameter>,
    /// What the run does just now: its stage and its step; empty while none is on.
    pub stage: String,
    pub step: String,
    /// Machine time that is left, s: by its plan until the run knows better; `None` where nobody knows.
    pub remaining_s: Option<f64>,
    /// Touches and scans that are in the journal.
    pub measured: u32,
    /// While held: another program has the machine, and may move it.
    pub elsewhere: bool,
    /// Why the last cycle did not come to its end, and what to do; `None` once that is settled.
    pub failure: Option<Failure>,
    /// What a person is asked to do; nothing moves before it is answered.
    pub asked: Option<Asked>,
    /// What the sensors read that the person who is asked watches; `None` before the first values.
    pub live: Option<LiveValues>,
}

/// In words, for a person.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, ToSchema)]
pub struct Failure {
    pub what: String,
    pub remedy: Option<String>,
}

impl Board {
    /// Nothing of what was before stands on. `machine_s`: what it will take, as far as that is known.
    pub(super) fn begins(&mut self, cycle: u16, machine_s: Option<f64>) {
        (self.state, self.cycle, self.run) = (State::Running, cycle, 0);
        (self.progress_percent, self.verdict) = (0, None);
        self.deviations.clear();
        (self.elsewhere, self.failure) = (false, None);
        (self.stage, self.step) = (String::new(), String::new());
        (self.remaining_s, self.measured) = (machine_s, 0);
        (self.asked, self.live) = (None, None);
    }
}
