//! The desk between the triggers and the run: who may start what, and how things stand. A small
//! struct under a lock that is never held for longer than it takes to look; the run is not disturbed
//! by whoever asks.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::Log;
use super::config::{Config, Demand};
use crate::controllers::Halt;
use crate::record::estimate::{Estimate, Parameter, Verdict};

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
}

/// All of them.
#[cfg(test)]
pub const REFUSALS: [Refusal; 16] = [
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
];

/// What the machine says of itself, as far as it is fresh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Said {
    pub fresh: bool,
    pub enable: bool,
    pub auto: bool,
    pub door: bool,
    pub stop: bool,
}

impl Said {
    fn lacks(self, demands: &[Demand]) -> Option<Refusal> {
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

/// What the service must do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ask {
    Start { cycle: u16 },
    Acknowledge,
    End,
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
    pub deviations: Vec<Parameter>,
}

struct Inner {
    board: Board,
    /// Of the run that is on.
    halt: Option<Halt>,
    stop: bool,
    /// A cycle ended, or a start was refused as too soon.
    last_end: Option<Instant>,
}

#[derive(Clone)]
pub struct Desk {
    inner: Arc<Mutex<Inner>>,
    asks: mpsc::Sender<Ask>,
    cycles: Arc<[u16]>,
    demand: Arc<[Demand]>,
    min_interval: Duration,
    log: Log,
}

impl Desk {
    /// The other end gets what must be done.
    pub fn new(config: &Config, log: Log) -> (Self, mpsc::Receiver<Ask>) {
        let (asks, todo) = mpsc::channel(8);
        let board = Board::default();
        let inner = Inner { board, halt: None, stop: false, last_end: None };
        let desk = Self {
            inner: Arc::new(Mutex::new(inner)),
            asks,
            cycles: config.cycle.iter().map(|cycle| cycle.number).collect(),
            demand: config.demand.clone().into(),
            min_interval: config.min_interval,
            log,
        };
        (desk, todo)
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn board(&self) -> Board {
        self.inner().board.clone()
    }

    /// A trigger asks for `cycle`. From an accepted start on the service is running.
    ///
    /// # Errors
    /// Why not; it is on the board and in the log as well.
    pub fn start(&self, cycle: u16, said: Said, by: &str) -> Result<(), Refusal> {
        let mut inner = self.inner();
        let judged = self.judge(&inner, cycle, said);
        let sent = judged
            .and_then(|()| self.asks.try_send(Ask::Start { cycle }).map_err(|_| Refusal::NotReady));
        if let Err(why) = sent {
            drop(inner);
            self.refuse(why, &format!("start of cycle {cycle} by {by}"));
            return Err(why);
        }
        inner.stop = false;
        let board = &mut inner.board;
        board.accepted = board.accepted.wrapping_add(1);
        (board.state, board.cycle, board.run) = (State::Running, cycle, 0);
        (board.progress_percent, board.verdict) = (0, None);
        board.deviations.clear();
        drop(inner);
        (self.log)(&format!("cycle {cycle} is started by {by}"));
        Ok(())
    }

    fn judge(&self, inner: &Inner, cycle: u16, said: Said) -> Result<(), Refusal> {
        match inner.board.state {
            State::Waiting => {}
            State::Running => return Err(Refusal::Busy),
            State::Held => return Err(Refusal::Held),
            State::Failed => return Err(Refusal::Failed),
            State::Starting | State::Ending => return Err(Refusal::NotReady),
        }
        if !self.cycles.contains(&cycle) {
            return Err(Refusal::NoSuchCycle);
        }
        if let Some(why) = said.lacks(&self.demand) {
            return Err(why);
        }
        match inner.last_end.is_some_and(|end| end.elapsed() < self.min_interval) {
            true => Err(Refusal::TooSoon),
            false => Ok(()),
        }
    }

    /// Put a refusal where it can be read.
    pub fn refuse(&self, why: Refusal, what: &str) {
        let mut inner = self.inner();
        inner.board.refusal = Some(why);
        inner.board.refused = inner.board.refused.wrapping_add(1);
        drop(inner);
        (self.log)(&format!("refused, {what}: {why}"));
    }

    /// Somebody at the machine has looked at it.
    pub fn acknowledge(&self, by: &str) {
        let state = self.inner().board.state;
        let waits = matches!(state, State::Held | State::Failed);
        if !waits || self.asks.try_send(Ask::Acknowledge).is_err() {
            self.refuse(Refusal::NothingToAcknowledge, &format!("acknowledgement by {by}"));
        }
    }

    /// Hold the machine, if a run is on; at once, whatever it does.
    pub fn stop(&self, by: &str) {
        let mut inner = self.inner();
        if inner.board.state != State::Running {
            return;
        }
        inner.stop = true;
        let halt = inner.halt.clone();
        drop(inner);
        if let Some(halt) = halt {
            halt.now();
        }
        (self.log)(&format!("stopped by {by}"));
    }

    /// The service ends: as [`Self::stop`], and nothing starts any more.
    pub(super) fn end(&self) {
        let mut inner = self.inner();
        inner.stop = true;
        inner.board.state = State::Ending;
        let halt = inner.halt.clone();
        drop(inner);
        if let Some(halt) = halt {
            halt.now();
        }
        // Full: whoever empties it looks at the state as well.
        let _ = self.asks.try_send(Ask::End);
    }

    pub(super) fn is_ending(&self) -> bool {
        self.inner().board.state == State::Ending
    }

    /// The devices of the run are open. A stop that came before is not forgotten.
    pub(super) fn under_way(&self, halt: &Halt) {
        let mut inner = self.inner();
        inner.halt = Some(halt.clone());
        let stop = inner.stop;
        drop(inner);
        if stop {
            halt.now();
        }
    }

    pub(super) fn show(&self, change: impl FnOnce(&mut Board)) {
        change(&mut self.inner().board);
    }

    /// The cycle has ended, with an estimate or without.
    pub(super) fn ended(&self, state: State, estimate: Option<&Estimate>) {
        let mut inner = self.inner();
        inner.halt = None;
        inner.last_end = Some(Instant::now());
        if let Some(estimate) = estimate {
            inner.board.progress_percent = 100;
            inner.board.verdict = Some(estimate.verdict);
            inner.board.deviations = estimate.parameters.clone();
        }
        drop(inner);
        self.becomes(state);
    }

    /// Unless it ends.
    pub(super) fn becomes(&self, state: State) {
        let mut inner = self.inner();
        if inner.board.state != State::Ending {
            inner.board.state = state;
        }
    }
}
