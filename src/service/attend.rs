//! At one machine: waiting, and doing what its desk has accepted, one thing at a time.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::timeout;
use tracing::field::Empty;
use tracing::{Instrument, Span, debug, info_span};

use super::ask::{Ask, Word};
use super::board::{Board, Failure, State};
use super::captures::{Begun, Captures};
use super::config::{Config, Cycle};
use super::desk::Desk;
use super::http::{Last, Shown};
use super::identify::Identifications;
use super::metrics::{Metrics, Outcome};
use super::past::unfinished;
use super::{Ended, Log, ServeError, schedule, triggers};
use crate::run::{self, Asked, CycleError, Unidentified};
use crate::setup::{self, Devices, MachineFile, Pace, Past, SetupError};
use crate::store::{Journal, MachineLock, RunId, StoreError, sha256_text};
use link::Wiring;
use machine::record::estimate::Estimate;
use machine::record::event::Event;

/// Who waits says so this often,
const TICK: Duration = Duration::from_secs(1);
/// and is late after so long.
const LATE: Duration = Duration::from_secs(10);

/// Why a cycle has no estimate.
#[derive(Debug, thiserror::Error)]
pub(super) enum Failed {
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Cycle(#[from] CycleError),
}

impl Failed {
    /// Somebody wanted it so.
    fn is_stop(&self) -> bool {
        matches!(self, Self::Cycle(error) if error.is_stop())
    }
}

/// Of a part of the whole, never back.
pub(super) struct Progress {
    pub(super) whole_s: f64,
    pub(super) percent: u16,
}

/// One machine, waiting.
pub(super) struct Attendant {
    machine: MachineFile,
    config: Config,
    pub(super) folder: PathBuf,
    pub(super) pace: Pace,
    pub(super) desk: Desk,
    asks: mpsc::Receiver<Ask>,
    pub(super) log: Log,
    captures: Option<Captures>,
    /// While no person may resume it.
    pub(super) lock: Option<MachineLock>,
    /// Of runs that were measured before.
    pub(super) identifications: Identifications,
}

impl Attendant {
    /// `folder`: where journal and locks are. Nothing is opened yet.
    ///
    /// # Errors
    /// A cycle of a method or with settings that there are not.
    pub fn new(
        (machine, config): (MachineFile, Config),
        folder: PathBuf,
        pace: Pace,
        log: Log,
        metrics: &Metrics,
    ) -> Result<Self, ServeError> {
        for cycle in &config.cycle {
            setup::header(&machine, &cycle.method, cycle.repeat)?;
        }
        let (desk, asks) = Desk::new(&config, log.clone(), metrics.of(&machine.machine.name));
        let (captures, lock, identifications) = (None, None, Identifications::default());
        Ok(Self { machine, config, folder, pace, desk, asks, log, captures, lock, identifications })
    }

    pub fn capturing(self, captures: Captures) -> Self {
        Self { captures: Some(captures), ..self }
    }

    /// The machine is ours, its cycles could be measured, its triggers are heard. Call inside the tokio
    /// runtime that [`Self::attend`] will live in.
    ///
    /// # Errors
    /// What keeps it from serving at all.
    pub async fn begin(&mut self, journal: &Arc<Journal>) -> Result<(), ServeError> {
        self.lock = Some(self.take(journal).await?);
        self.rehearse().await?;
        triggers::start(&self.config, &self.desk, &self.log)?;
        match unfinished(journal, self.name())? {
            Some(before) => {
                self.log.say(&format!("run {} is unfinished and waits for a person", before.run));
                self.lock = None;
                let run = u32::try_from(before.run.0).unwrap_or(u32::MAX);
                self.desk.show(|board| (board.run, board.failure) = (run, Some(before.why)));
                self.desk.becomes(State::Held);
            }
            None => self.desk.becomes(State::Waiting),
        }
        let kept = (self.config.schedule.as_slice(), self.config.demand.as_slice());
        schedule::start(self.name(), kept, &self.desk, journal, &self.log)?;
        // However long that took: its progress is watched from now on.
        self.desk.pulse().beat(LATE);
        Ok(())
    }

    /// Until the desk's end. What befalls a cycle is on the board and in the log.
    pub async fn attend(mut self, journal: &Journal) -> Ended {
        loop {
            self.desk.pulse().beat(LATE);
            let ask = match timeout(TICK, self.asks.recv()).await {
                Ok(Some(ask)) => ask,
                Ok(None) => break,
                // Nobody has asked.
                Err(_) => {
                    self.look_elsewhere(journal).await;
                    self.identifications.step(&self.desk, &self.log, journal).await;
                    continue;
                }
            };
            self.desk.pulse().beat(self.config.patience);
            match ask {
                _ if self.desk.is_ending() => break,
                Ask::End => break,
                Ask::Acknowledge(word) => self.acknowledged(word, journal).await,
                Ask::Start { cycle } => {
                    let span = info_span!("cycle", machine = self.name(), cycle, run = Empty);
                    if let Some(ended) = self.cycle(cycle, journal).instrument(span).await {
                        return ended;
                    }
                }
                Ask::Resume { run, word } => {
                    let span = info_span!("cycle", machine = self.name(), run = run.0);
                    let again = self.cycle_again((run, word), journal).instrument(span);
                    if let Some(ended) = again.await {
                        return ended;
                    }
                }
            }
        }
        Ended::Waiting
    }

    async fn cycle(&mut self, number: u16, journal: &Journal) -> Option<Ended> {
        let measured = self.measured(number, journal).await;
        self.after(measured, State::Failed)
    }

    async fn cycle_again(
        &mut self,
        (run, word): (RunId, Word),
        journal: &Journal,
    ) -> Option<Ended> {
        let again = self.acknowledged_again(run, word, journal).await?;
        let measured = self.measured_again(again, journal).await;
        // Where nothing could be opened the run waits for a person as before.
        self.after(measured, State::Held)
    }

    /// What any cycle would be refused for is told now, not when the operator presses the button.
    pub async fn rehearse(&self) -> Result<(), ServeError> {
        let dialect = setup::dialect(&self.machine)?;
        let mut all = BTreeMap::new();
        for Cycle { number, method, repeat } in &self.config.cycle {
            let (method, plan) = setup::header(&self.machine, method, *repeat)?;
            let rehearsed = run::rehearse(method.as_ref(), &plan, &dialect).await;
            let rehearsed = rehearsed.map_err(|error| {
                let (number, error) = (*number, Box::new(error));
                ServeError::Cycle { number, error }
            })?;
            let minutes = rehearsed.machine_s / 60.0;
            let person = if rehearsed.asks { "; it asks a person" } else { "" };
            self.log
                .say(&format!("cycle {number} takes the machine about {minutes:.0} min{person}"));
            all.insert(*number, rehearsed);
        }
        self.desk.rehearsed(all);
        Ok(())
    }

    pub fn shown(&self) -> Shown {
        let (cycles, demand) = (self.config.cycle.clone(), self.config.demand.clone());
        let (name, tolerance) = (self.name().to_owned(), self.machine.tolerance.clone());
        let (last, file_sha256) =
            (Last::new(self.config.verdict), sha256_text(self.machine.text()));
        Shown { name, file_sha256, desk: self.desk.clone(), cycles, demand, tolerance, last }
    }

    pub fn name(&self) -> &str {
        &self.machine.machine.name
    }

    pub fn desk(&self) -> &Desk {
        &self.desk
    }

    /// A run that tells nothing for longer is taken for one that hangs.
    pub(super) fn patience(&self) -> Duration {
        self.config.patience
    }

    pub(super) async fn take(&mut self, journal: &Journal) -> Result<MachineLock, ServeError> {
        let lock = MachineLock::acquire(&self.folder, self.name())?;
        journal.mark_interrupted(&lock).await?;
        self.find_unidentified(journal)?;
        Ok(lock)
    }

    /// Only while the machine is ours.
    pub(super) fn find_unidentified(&mut self, journal: &Journal) -> Result<(), StoreError> {
        self.identifications.find(journal, &self.machine.machine.name)
    }

    /// Show how a run has ended; the service ends with it if it must. `unopened`: how the machine stands if
    /// its devices could not be opened.
    fn after(
        &mut self,
        measured: Result<(RunId, Estimate), Failed>,
        unopened: State,
    ) -> Option<Ended> {
        let (state, why) = match &measured {
            Ok(_) => (State::Waiting, None),
            Err(Failed::Cycle(error)) if error.holds() => (State::Held, Some(of_cycle(error))),
            // All is measured and nothing moves; the run is identified while the machine waits.
            Err(Failed::Cycle(CycleError::Identification { run, why: Unidentified::Stopped })) => {
                self.identifications.add(*run);
                (State::Waiting, None)
            }
            Err(Failed::Cycle(error)) => (State::Failed, Some(of_cycle(error))),
            Err(Failed::Setup(error)) => {
                let (what, remedy) = (error.to_string(), error.remedy());
                (unopened, Some(Failure { what, remedy }))
            }
        };
        let told = match (&measured, &why) {
            (Ok((run, estimate)), _) => {
                format!("run {run} is finished, verdict {}", estimate.verdict)
            }
            (_, Some(Failure { what, remedy: Some(remedy) })) => format!("{what}; {remedy}"),
            (Err(Failed::Cycle(error)), None) => of_cycle(error).what,
            (_, why) => why.as_ref().map_or(String::new(), |why| why.what.clone()),
        };
        match &measured {
            Err(failed) if !failed.is_stop() => self.log.fault(&told),
            _ => self.log.say(&told),
        }
        self.count(&measured);
        self.desk.show(|board| board.failure = why);
        if state == State::Held {
            // Now a person may resume it, here or at the command.
            self.lock = None;
        }
        self.desk.ended(state, measured.ok().as_ref().map(|(_, estimate)| estimate));
        (state != State::Waiting && self.desk.is_ending()).then_some(Ended::Held)
    }

    fn count(&self, measured: &Result<(RunId, Estimate), Failed>) {
        let tally = self.desk.tally();
        match measured {
            Ok((_, estimate)) => tally.ended(Outcome::Judged(estimate.verdict)),
            Err(Failed::Cycle(error)) if error.holds() => tally.ended(Outcome::Held),
            // Counted when it is identified.
            Err(failed) if failed.is_stop() => {}
            Err(_) => tally.ended(Outcome::Failed),
        }
        if let Err(Failed::Cycle(CycleError::Run { error, .. })) = measured
            && error.is_of_link()
        {
            tally.link_failed();
        }
    }

    async fn measured(&self, number: u16, journal: &Journal) -> Result<(RunId, Estimate), Failed> {
        let allowed = self.config.cycle.iter().find(|cycle| cycle.number == number);
        let Some(Cycle { method, repeat, .. }) = allowed else {
            return Err(SetupError::NoSuchMethod { name: format!("cycle {number}") }.into());
        };
        let (method, plan) = setup::header(&self.machine, method, *repeat)?;
        let opening = setup::devices(&self.machine, self.pace, Past::default());
        let (devices, capture) = self.open(opening).await?;
        let mut progress = Progress { whole_s: 0.0, percent: 0 };
        let mut tell = |event: &Event| self.tell(event, &mut progress);
        let begun = |id: RunId| {
            Span::current().record("run", id.0);
            self.log.say(&format!("run {id} begins"));
            capture.iter().for_each(|capture| capture.is_of(id));
            self.desk.show(|board| board.run = u32::try_from(id.0).unwrap_or(u32::MAX));
        };
        let machine = &self.machine;
        let (method, answers) = (method.into(), self.desk.answers(self.config.patience));
        let cycle = run::Cycle { machine, method, plan, answers };
        let ended = cycle.run(&devices, journal, begun, &mut tell).await;
        capture.into_iter().for_each(Begun::finish);
        Ok(ended?)
    }

    /// With every byte kept where that is wanted; a stop is heard from here on.
    pub(super) async fn open(
        &self,
        opening: impl Future<Output = Result<Devices, SetupError>>,
    ) -> Result<(Devices, Option<Begun<'_>>), SetupError> {
        let capture = self.captures.as_ref().and_then(|captures| captures.begin(&self.log));
        let wiring = capture.as_ref().map_or(Wiring::Plain, Begun::wiring);
        let devices = wiring.during(opening).await?;
        self.desk.under_way(&devices.controller.halt());
        Ok((devices, capture))
    }

    pub(super) fn tell(&self, event: &Event, progress: &mut Progress) {
        self.desk.pulse().beat(self.config.patience);
        match event {
            Event::Announced { text } => self.log.say(text),
            Event::StageStarted { stage } => {
                self.log.say(&format!("{}: {} touches", stage.name, stage.steps.len()));
                self.desk.show(|board| board.stage.clone_from(&stage.name));
            }
            Event::StepStarted { step, remaining_s, label, .. } => {
                debug!(step, "{label}");
                let percent = progress.at(*remaining_s);
                self.desk.show(|board: &mut Board| {
                    board.progress_percent = percent;
                    board.remaining_s = Some(*remaining_s);
                    board.step.clone_from(label);
                });
            }
            Event::Asked { step, repeat, text } => {
                self.log.say(&format!("a person is asked: {text}"));
                let asked = Asked { step: *step, repeat: *repeat, text: text.clone() };
                self.desk.show(|board| (board.asked, board.live) = (Some(asked), None));
            }
            Event::Watched { values } => {
                self.desk.show(|board| board.live = Some(values.clone()));
            }
            Event::Answered { who, .. } => self.log.say(&format!("done, says {who}")),
            Event::ReadingStored { .. } | Event::ScanStored { .. } => {
                self.desk.tally().read();
                self.desk.show(|board| board.measured += 1);
            }
            _ => {}
        }
    }
}

impl Progress {
    /// In percent; 100 is for the end.
    fn at(&mut self, remaining_s: f64) -> u16 {
        if remaining_s > self.whole_s {
            // After a stop the references come by themselves; what is left is known after them.
            (self.whole_s, self.percent) = (remaining_s, 0);
        }
        let done = 100.0 * (1.0 - remaining_s / self.whole_s.max(f64::MIN_POSITIVE));
        self.percent = self.percent.max(done.clamp(0.0, 99.0) as u16);
        self.percent
    }
}

fn of_cycle(error: &CycleError) -> Failure {
    let (what, remedy) = match error {
        CycleError::Run { run, error, .. } => (format!("run {run}: {error}"), error.remedy()),
        CycleError::Identification { run, why } => (
            format!("run {run} is measured and kept, but not identified: {why}"),
            why.remedy().map_or(String::new(), |remedy| format!("{remedy}; "))
                + &format!("`trued resume {run}` tries again, the machine does not move"),
        ),
        CycleError::Store(error) => (error.to_string(), error.remedy().to_owned()),
        CycleError::Unqualified(error) => (error.to_string(), error.remedy()),
    };
    Failure { what, remedy: Some(remedy) }
}
