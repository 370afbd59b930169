//! The desk between the triggers and the run: who may start what, and how things stand. A small
//! struct under a lock that is never held for longer than it takes to look; the run is not disturbed
//! by whoever asks.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};
use tracing::field::Empty;
use tracing::info_span;

use super::Log;
use super::ask::{Answer, Ask, Looked, Stopped};
use super::board::{Board, Refusal, Said, State};
use super::config::{Config, Demand};
use super::metrics::Tally;
use super::pulse::Pulse;
use super::rota::Rota;
use crate::run::{Answers, Asked, Rehearsed};
use crate::store::RunId;
use devices::controllers::Halt;
use machine::record::estimate::Estimate;

struct Inner {
    board: Board,
    /// Of the run that is on.
    halt: Option<Halt>,
    stop: bool,
    /// Something is asked for that has not come to its end.
    acting: bool,
    /// Who has done what was asked, until the run takes it.
    answer: Option<(Asked, String)>,
    /// Of each cycle.
    rehearsed: BTreeMap<u16, Rehearsed>,
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
    pulse: Pulse,
    tally: Tally,
    /// Counts what changed on the board.
    changes: Arc<watch::Sender<u64>>,
    rota: Rota,
}

impl Desk {
    /// The other end gets what must be done.
    pub fn new(config: &Config, log: Log, tally: Tally) -> (Self, mpsc::Receiver<Ask>) {
        let (asks, todo) = mpsc::channel(8);
        let board = Board::default();
        let (answer, rehearsed, acting) = (None, BTreeMap::new(), false);
        let inner =
            Inner { board, halt: None, stop: false, acting, answer, rehearsed, last_end: None };
        let desk = Self {
            inner: Arc::new(Mutex::new(inner)),
            asks,
            cycles: config.cycle.iter().map(|cycle| cycle.number).collect(),
            demand: config.demand.clone().into(),
            min_interval: config.min_interval,
            log,
            pulse: Pulse::new(config.patience),
            tally,
            changes: Arc::new(watch::Sender::new(0)),
            rota: Rota::default(),
        };
        (desk, todo)
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Of the worker at this machine.
    pub fn pulse(&self) -> &Pulse {
        &self.pulse
    }

    pub(super) fn tally(&self) -> &Tally {
        &self.tally
    }

    pub fn board(&self) -> Board {
        self.inner().board.clone()
    }

    /// Sees each change of the board; who is slow sees the last.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    fn changed(&self) {
        self.changes.send_modify(|count| *count = count.wrapping_add(1));
    }

    /// Where the schedule meets whoever asks.
    pub fn rota(&self) -> &Rota {
        &self.rota
    }

    /// Whether [`Self::start`] would accept it just now; nobody is told.
    ///
    /// # Errors
    /// Why not.
    pub fn may(&self, cycle: u16, said: Said) -> Result<(), Refusal> {
        self.judge(&self.inner(), cycle, said)
    }

    /// A trigger asks for `cycle`. From an accepted start on the service is running.
    ///
    /// # Errors
    /// Why not; it is on the board and in the log as well.
    pub fn start(&self, cycle: u16, said: Said, by: &str) -> Result<(), Refusal> {
        let mut inner = self.inner();
        let judged = self.judge(&inner, cycle, said);
        if let Err(why) = judged.and_then(|()| self.send(&mut inner, Ask::Start { cycle })) {
            drop(inner);
            self.refuse(why, &format!("start of cycle {cycle} by {by}"));
            return Err(why);
        }
        inner.stop = false;
        inner.board.accepted = inner.board.accepted.wrapping_add(1);
        let machine_s = inner.rehearsed.get(&cycle).map(|known| known.machine_s);
        inner.board.begins(cycle, machine_s);
        drop(inner);
        self.changed();
        self.log.say(&format!("cycle {cycle} is started by {by}"));
        Ok(())
    }

    /// A person lets the held run go on. From an accepted one on the service is running. `said`: what the
    /// machine says of itself, or a person.
    ///
    /// # Errors
    /// Nothing is held here, or the service is busy; it is on the board and in the log as well.
    pub fn resume(&self, run: RunId, looked: Looked<'_>, said: Said) -> Result<Answer, Refusal> {
        let mut inner = self.inner();
        let judged = match inner.board.state {
            State::Held => said.lacks(&self.demand).map_or(Ok(()), Err),
            State::Running => Err(Refusal::Busy),
            _ => Err(Refusal::NothingToAcknowledge),
        };
        let (word, answer) = looked.word();
        let ask = Ask::Resume { run, word };
        if let Err(why) = judged.and_then(|()| self.send(&mut inner, ask)) {
            drop(inner);
            self.refuse(why, &format!("resume of run {run} by {}", looked.who));
            return Err(why);
        }
        inner.stop = false;
        let cycle = inner.board.cycle;
        // How much of it is done already only the run will know.
        inner.board.begins(cycle, None);
        inner.board.run = u32::try_from(run.0).unwrap_or(u32::MAX);
        drop(inner);
        self.changed();
        self.log.say(&format!("run {run} is resumed by {}", looked.who));
        Ok(answer)
    }

    /// Nothing else is accepted until its end is on the board.
    fn send(&self, inner: &mut Inner, ask: Ask) -> Result<(), Refusal> {
        if inner.acting {
            return Err(Refusal::NotReady);
        }
        self.asks.try_send(ask).map_err(|_| Refusal::NotReady)?;
        inner.acting = true;
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
        if inner.rehearsed.get(&cycle).is_some_and(|known| known.asks) && !said.person {
            return Err(Refusal::AsksPerson);
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
        self.tally.refused(why);
        self.changed();
        self.log.say(&format!("refused, {what}: {why}"));
    }

    /// Somebody at the machine has looked at it, and leaves what is held as it is.
    ///
    /// # Errors
    /// Nothing waits for it; it is on the board and in the log as well.
    pub fn acknowledge(&self, looked: Looked<'_>) -> Result<Answer, Refusal> {
        let mut inner = self.inner();
        let judged = match inner.board.state {
            State::Held | State::Failed => Ok(()),
            _ => Err(Refusal::NothingToAcknowledge),
        };
        let (word, answer) = looked.word();
        if let Err(why) = judged.and_then(|()| self.send(&mut inner, Ask::Acknowledge(word))) {
            drop(inner);
            self.refuse(why, &format!("acknowledgement by {}", looked.who));
            return Err(why);
        }
        Ok(answer)
    }

    /// What is known of each cycle before it begins: nothing starts one that asks a person where nobody is.
    pub(super) fn rehearsed(&self, cycles: BTreeMap<u16, Rehearsed>) {
        self.inner().rehearsed = cycles;
    }

    /// Somebody has done what the run has asked for at this step, in this pass.
    ///
    /// # Errors
    /// Nothing, or something else, is asked; it is on the board and in the log as well.
    pub fn answer(&self, (step, repeat): (u32, u32), who: &str) -> Result<(), Refusal> {
        let mut inner = self.inner();
        let meant = |asked: &mut Asked| (asked.step, asked.repeat) == (step, repeat);
        let Some(asked) = inner.board.asked.take_if(meant) else {
            drop(inner);
            let why = Refusal::NotAsked;
            self.refuse(why, &format!("answer to step {step} by {who}"));
            return Err(why);
        };
        inner.answer = Some((asked, who.to_owned()));
        drop(inner);
        self.changed();
        Ok(())
    }

    /// Where the run asks. Who waits for a person lives, each look within `patience`.
    pub(super) fn answers(&self, patience: Duration) -> Answers {
        let desk = self.clone();
        Answers::new(move |asked| {
            desk.pulse.beat(patience);
            let given = desk.inner().answer.take_if(|(to, _)| to == asked);
            given.map(|(_, who)| who)
        })
    }

    /// Hold the machine, if a run is on or about to begin; at once, whatever the board says.
    pub fn stop(&self, by: &str) -> Stopped {
        let mut inner = self.inner();
        if inner.board.state != State::Running && inner.halt.is_none() {
            return if inner.board.elsewhere { Stopped::Elsewhere } else { Stopped::Nothing };
        }
        inner.stop = true;
        let (halt, run) = (inner.halt.clone(), inner.board.run);
        drop(inner);
        if let Some(halt) = halt {
            halt.now();
        }
        // Said on the thread of whoever asks, and found by the run that it holds; 0 is none.
        let span = info_span!("hold", run = Empty);
        span.record("run", (run > 0).then_some(run));
        span.in_scope(|| self.log.say(&format!("stopped by {by}")));
        Stopped::Run
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
        self.changed();
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
        self.changed();
    }

    /// The cycle has ended, with an estimate or without.
    pub(super) fn ended(&self, state: State, estimate: Option<&Estimate>) {
        let mut inner = self.inner();
        (inner.halt, inner.answer, inner.board.asked) = (None, None, None);
        inner.last_end = Some(Instant::now());
        if let Some(estimate) = estimate {
            inner.board.progress_percent = 100;
            inner.board.verdict = Some(estimate.verdict);
            inner.board.deviations = estimate.parameters.clone();
        }
        (inner.board.stage, inner.board.step) = (String::new(), String::new());
        inner.board.remaining_s = None;
        drop(inner);
        self.becomes(state);
    }

    /// This is how things stand, unless something is asked for meanwhile: then its end tells. Whether it was not.
    pub(super) fn rests(&self, state: State) -> bool {
        let mut inner = self.inner();
        if inner.acting || inner.board.state == State::Ending {
            return false;
        }
        inner.board.state = state;
        drop(inner);
        self.changed();
        true
    }

    /// What was asked for has come to its end: this is how things stand now. Not once it ends.
    pub(super) fn becomes(&self, state: State) {
        let mut inner = self.inner();
        inner.acting = false;
        if inner.board.state != State::Ending {
            inner.board.state = state;
        }
        drop(inner);
        self.changed();
    }
}

#[cfg(test)]
impl Desk {
    /// Of a machine with one cycle; the other end as [`Self::new`].
    pub fn for_tests() -> (Self, mpsc::Receiver<Ask>) {
        let config = "min_interval_s = 0.0\n[[cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n";
        let (log, metrics): (Log, _) = (Log::new(|_, _| {}), super::metrics::Metrics::default());
        Self::new(&toml::from_str(config).unwrap(), log, metrics.of("mill"))
    }
}
