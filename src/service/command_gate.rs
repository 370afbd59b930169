//! The gate between the triggers and the run: it accepts or refuses commands and holds the machine state. The
//! data are in a small struct behind a mutex that is held only for a read or an update, so that clients do not
//! delay the run.

use std::collections::BTreeMap;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};
use tracing::field::Empty;
use tracing::info_span;

use super::config::ServeConfig;
use super::heartbeat::Heartbeat;
use super::machine_state::{CycleEnd, Interlocks, MachineState, Refusal, ServiceState};
use super::schedule_state::{ReadinessSource, StartDueCycleRequest};
use super::worker_command::{HoldEffect, Inspection, InspectionResultReceiver, WorkerCommand};
use super::{Log, lock};
use crate::run::{OpenPrompt, PromptAnswerSource, RehearsalResult};
use crate::store::{Journal, NewestMeasuredRuns, RunId, StoreError};
use devices::controllers::HaltHandle;

/// State of a [`CommandGate`].
#[derive(Default)]
pub(super) struct CommandGateState {
    pub(super) machine_state: MachineState,
    /// Halt handle of the run in progress.
    halt_handle: Option<HaltHandle>,
    /// Hold (or end of the service) that is requested since the last accepted start or resume; it also takes effect
    /// on devices that open later.
    is_hold_requested: bool,
    /// Whether an accepted command (start, resume, acknowledgement or compensation) is not finished yet.
    is_command_in_progress: bool,
    /// The answered prompt and the name of the person who answered, until the run reads them.
    prompt_answer: Option<(OpenPrompt, String)>,
    /// Result of the rehearsal of each cycle at the start of the service, by cycle number. A rehearsal plans and
    /// proves the whole run without motion.
    rehearsal_results_by_cycle: BTreeMap<u16, RehearsalResult>,
    /// Time at which the last cycle ended.
    last_cycle_end_time: Option<Instant>,
    /// Why the register of artefacts permits no run; `None`: it permits runs.
    pub(super) artefact_failure: Option<String>,
    /// Functions that report the readiness of the machine, one for each trigger that can report it.
    pub(super) readiness_sources: Vec<ReadinessSource>,
    /// Channel to the scheduler; `None` before the scheduler starts.
    pub(super) due_request_sender: Option<Sender<StartDueCycleRequest>>,
}

/// Handle of the gate of one machine; all clones share one state.
#[derive(Clone)]
pub struct CommandGate {
    gate_state: Arc<Mutex<CommandGateState>>,
    /// Newest heartbeat of the worker.
    pub(super) heartbeat: Arc<Mutex<Heartbeat>>,
    /// Channel of the accepted commands to the worker.
    command_sender: mpsc::Sender<WorkerCommand>,
    pub(super) config: Arc<ServeConfig>,
    log: Log,
    /// Counter of the changes of the machine state; it wakes the subscribers.
    change_counter: Arc<watch::Sender<u64>>,
    /// Serialises the queries of the newest runs, so that an older result never replaces a newer one.
    newest_runs_query_lock: Arc<Mutex<()>>,
}

impl CommandGate {
    /// The returned receiver receives the accepted commands.
    pub fn new(config: &ServeConfig, log: Log) -> (Self, mpsc::Receiver<WorkerCommand>) {
        let (command_sender, command_receiver) = mpsc::channel(8);
        let gate = Self {
            gate_state: Arc::default(),
            heartbeat: Arc::new(Mutex::new(Heartbeat::now(config.max_event_interval))),
            command_sender,
            config: Arc::new(config.clone()),
            log,
            change_counter: Arc::new(watch::Sender::new(0)),
            newest_runs_query_lock: Arc::default(),
        };
        (gate, command_receiver)
    }

    pub(super) fn lock_state(&self) -> MutexGuard<'_, CommandGateState> {
        lock(&self.gate_state)
    }

    pub fn machine_state(&self) -> MachineState {
        self.lock_state().machine_state.clone()
    }

    /// Subscribes to the changes of the machine state. A slow subscriber sees only the latest value.
    pub fn subscribe_changes(&self) -> watch::Receiver<u64> {
        self.change_counter.subscribe()
    }

    fn notify_change(&self) {
        self.change_counter.send_modify(|count| *count = count.wrapping_add(1));
    }

    /// Queries the journal for the newest runs of this machine. Blocks this thread.
    ///
    /// # Errors
    /// The journal cannot be read; the previous result is discarded.
    pub fn refresh_newest_runs(&self, journal: &Journal, machine: &str) -> Result<(), StoreError> {
        let query = lock(&self.newest_runs_query_lock);
        let found = journal.newest_measured_runs(machine);
        let newest = found.as_ref().map_or_else(|_| NewestMeasuredRuns::default(), NewestMeasuredRuns::clone);
        if *self.lock_state().machine_state.newest_runs != newest {
            self.update_machine_state(|machine_state| machine_state.newest_runs = Arc::new(newest));
        }
        drop(query);
        found.map(drop)
    }

    /// Checks all conditions of [`Self::start_cycle`], except whether another command is in progress. A refusal is
    /// neither counted nor logged.
    ///
    /// # Errors
    /// The reason of the refusal.
    pub fn check_start(&self, cycle: u16, interlocks: Interlocks) -> Result<(), Refusal> {
        self.check_start_conditions(&self.lock_state(), cycle, interlocks)
    }

    /// Starts `cycle` on behalf of a trigger. After an accepted start, the service state is `Running`.
    ///
    /// # Errors
    /// The reason of the refusal; it is also in the machine state and in the log.
    pub fn start_cycle(&self, cycle: u16, interlocks: Interlocks, by: &str) -> Result<(), Refusal> {
        let inner = self.lock_state();
        let judged = self.check_start_conditions(&inner, cycle, interlocks);
        let what = format!("start of cycle {cycle} by {by}");
        let mut inner = self.send_command(inner, judged, WorkerCommand::StartCycle { cycle }, &what)?;
        inner.is_hold_requested = false;
        inner.machine_state.accepted_start_count = inner.machine_state.accepted_start_count.wrapping_add(1);
        let machine_s = inner.rehearsal_results_by_cycle.get(&cycle).map(|known| known.machine_time_s);
        inner.machine_state.begin_cycle(cycle, machine_s);
        drop(inner);
        self.notify_change();
        self.log.info(&format!("cycle {cycle} is started by {by}"));
        Ok(())
    }

    /// Resumes the held run on behalf of a person. After an accepted command, the service state is `Running`; the
    /// receiver gets the worker's decision about the report. `interlocks`: state of the inputs that the machine or a
    /// person reports.
    ///
    /// # Errors
    /// The machine is not held, an interlock prevents the start, or the service is busy; the refusal is also in the
    /// machine state and in the log.
    pub fn resume_run(
        &self,
        run: RunId,
        inspection: Inspection<'_>,
        interlocks: Interlocks,
    ) -> Result<InspectionResultReceiver, Refusal> {
        let inner = self.lock_state();
        let judged = match inner.machine_state.state {
            ServiceState::Held => interlocks.start_refusal(&self.config.required_interlocks).map_or(Ok(()), Err),
            ServiceState::Running => Err(Refusal::Busy),
            _ => Err(Refusal::NothingToAcknowledge),
        };
        let (report, answer) = inspection.report_and_result_receiver();
        let command = WorkerCommand::ResumeRun { run, report };
        let what = format!("resume of run {run} by {}", inspection.who);
        let mut inner = self.send_command(inner, judged, command, &what)?;
        inner.is_hold_requested = false;
        let cycle = inner.machine_state.cycle;
        // The rehearsed time of the whole cycle does not apply to the rest of a run.
        inner.machine_state.begin_cycle(cycle, None);
        inner.machine_state.run = u32::try_from(run.0).unwrap_or(u32::MAX);
        drop(inner);
        self.notify_change();
        self.log.info(&format!("run {run} is resumed by {}", inspection.who));
        Ok(answer)
    }

    /// Sends the command `what` to the worker if `accepted` is `Ok` and no other command is in progress. No other
    /// command is accepted until this one is finished. A refusal is recorded in the machine state and in the log.
    pub(super) fn send_command<'a>(
        &self,
        mut inner: MutexGuard<'a, CommandGateState>,
        accepted: Result<(), Refusal>,
        command: WorkerCommand,
        what: &str,
    ) -> Result<MutexGuard<'a, CommandGateState>, Refusal> {
        let sent = accepted.and_then(|()| match inner.is_command_in_progress {
            true => Err(Refusal::NotReady),
            false => self.command_sender.try_send(command).map_err(|_| Refusal::NotReady),
        });
        if let Err(why) = sent {
            drop(inner);
            self.record_refusal(why, what);
            return Err(why);
        }
        inner.is_command_in_progress = true;
        Ok(inner)
    }

    /// Checks all conditions of a start except whether another command is in progress, which [`Self::send_command`]
    /// checks. Returns the first refusal.
    fn check_start_conditions(
        &self,
        inner: &CommandGateState,
        cycle: u16,
        interlocks: Interlocks,
    ) -> Result<(), Refusal> {
        inner.machine_state.state.check_waiting()?;
        if !self.config.cycles.iter().any(|known| known.number == cycle) {
            return Err(Refusal::NoSuchCycle);
        }
        if inner.rehearsal_results_by_cycle.get(&cycle).is_some_and(|known| known.has_prompts)
            && !interlocks.has_person_for_prompts
        {
            return Err(Refusal::PlanHasPrompts);
        }
        if inner.artefact_failure.is_some() {
            return Err(Refusal::ArtefactRefused);
        }
        if let Some(why) = interlocks.start_refusal(&self.config.required_interlocks) {
            return Err(why);
        }
        match inner.last_cycle_end_time.is_some_and(|end| end.elapsed() < self.config.min_pause_between_cycles) {
            true => Err(Refusal::TooSoon),
            false => Ok(()),
        }
    }

    /// Records a refusal in the machine state and the log.
    pub fn record_refusal(&self, why: Refusal, what: &str) {
        self.update_machine_state(|machine_state| {
            machine_state.last_refusal = Some(why);
            machine_state.refusal_count = machine_state.refusal_count.wrapping_add(1);
            *machine_state.counters.refusal_counts.entry(why).or_default() += 1;
        });
        self.log.info(&format!("request refused: {what}: {why}"));
    }

    /// Requests the acknowledgement of the held or failed state: a person has inspected the machine. The worker
    /// decides; the receiver gets its result. The held run stays unfinished.
    ///
    /// # Errors
    /// There is nothing to acknowledge, or a command is in progress; the refusal is also in the machine state and in
    /// the log.
    pub fn acknowledge(&self, inspection: Inspection<'_>) -> Result<InspectionResultReceiver, Refusal> {
        let inner = self.lock_state();
        let judged = match inner.machine_state.state {
            ServiceState::Held | ServiceState::Failed => Ok(()),
            _ => Err(Refusal::NothingToAcknowledge),
        };
        let (report, answer) = inspection.report_and_result_receiver();
        let what = format!("acknowledgement by {}", inspection.who);
        drop(self.send_command(inner, judged, WorkerCommand::Acknowledge(report), &what)?);
        Ok(answer)
    }

    /// Stores the results of the rehearsals by cycle number. A cycle with prompts does not start without a person at
    /// the machine.
    pub(super) fn set_rehearsal_results(&self, cycles: BTreeMap<u16, RehearsalResult>) {
        self.lock_state().rehearsal_results_by_cycle = cycles;
    }

    /// Answers the prompt of this step and repeat: the person has done what the run requested.
    ///
    /// # Errors
    /// No prompt, or another one, is open; the refusal is also in the machine state and in the log.
    pub fn answer_prompt(&self, step: u32, repeat: u32, who: &str) -> Result<(), Refusal> {
        let mut inner = self.lock_state();
        let meant = |asked: &mut OpenPrompt| (asked.step_id, asked.repeat_number) == (step, repeat);
        let Some(asked) = inner.machine_state.open_prompt.take_if(meant) else {
            drop(inner);
            let why = Refusal::PromptNotOpen;
            self.record_refusal(why, &format!("answer to step {step} by {who}"));
            return Err(why);
        };
        inner.prompt_answer = Some((asked, who.to_owned()));
        drop(inner);
        self.notify_change();
        Ok(())
    }

    /// Source of the answers for the run. Each poll reports progress with `next_report_within`, so that a run that
    /// waits for a person does not count as hung.
    pub(super) fn prompt_answer_source(&self, next_report_within: Duration) -> PromptAnswerSource {
        let gate = self.clone();
        PromptAnswerSource::new(move |asked| {
            gate.report_progress(next_report_within);
            let given = gate.lock_state().prompt_answer.take_if(|(to, _)| to == asked);
            given.map(|(_, who)| who)
        })
    }

    /// Holds the machine at once if a run is in progress or about to begin, even if the machine state does not show
    /// a run.
    pub fn hold_machine(&self, by: &str) -> HoldEffect {
        let mut inner = self.lock_state();
        if inner.machine_state.state != ServiceState::Running && inner.halt_handle.is_none() {
            return if inner.machine_state.is_locked_by_other_process {
                HoldEffect::OtherProcessCannotBeHeld
            } else {
                HoldEffect::NoRunInProgress
            };
        }
        inner.is_hold_requested = true;
        let (halt, run) = (inner.halt_handle.clone(), inner.machine_state.run);
        drop(inner);
        if let Some(halt) = halt {
            halt.trigger();
        }
        // Logged on the caller's thread, with the number of the run that is held; 0 means none.
        let span = info_span!("hold", run = Empty);
        span.record("run", (run > 0).then_some(run));
        span.in_scope(|| self.log.info(&format!("hold requested by {by}")));
        HoldEffect::RunHeld
    }

    /// Ends the service: holds a run in progress or about to begin, and accepts no further command.
    pub(super) fn shut_down(&self) {
        let mut inner = self.lock_state();
        inner.is_hold_requested = true;
        inner.machine_state.state = ServiceState::Ending;
        let halt = inner.halt_handle.clone();
        drop(inner);
        if let Some(halt) = halt {
            halt.trigger();
        }
        self.notify_change();
        // If the channel is full, the worker checks the state before each command.
        let _ = self.command_sender.try_send(WorkerCommand::ShutDown);
    }

    pub(super) fn is_ending(&self) -> bool {
        self.lock_state().machine_state.state == ServiceState::Ending
    }

    /// Registers the halt handle of the run, whose devices are open now. A hold requested earlier takes effect here.
    pub(super) fn register_halt_handle(&self, halt: &HaltHandle) {
        let mut inner = self.lock_state();
        inner.halt_handle = Some(halt.clone());
        let stop = inner.is_hold_requested;
        drop(inner);
        if stop {
            halt.trigger();
        }
    }

    /// Changes the machine state and notifies the subscribers.
    pub(super) fn update_machine_state(&self, change: impl FnOnce(&mut MachineState)) {
        change(&mut self.lock_state().machine_state);
        self.notify_change();
    }

    /// Ends the command in progress, a start or a resume: records the end in the machine state, drops the halt handle
    /// and an unread answer, and begins the minimum pause between two cycles.
    pub(super) fn record_cycle_end(&self, end: CycleEnd<'_>) {
        let mut inner = self.lock_state();
        (inner.halt_handle, inner.prompt_answer) = (None, None);
        inner.last_cycle_end_time = Some(Instant::now());
        inner.machine_state.end_cycle(&end);
        drop(inner);
        self.finish_command(end.state);
    }

    /// Sets the state, unless a command is in progress (the end of the command sets it) or the service is ending.
    /// Returns whether the state was set.
    pub(super) fn set_state_if_idle(&self, state: ServiceState) -> bool {
        let mut inner = self.lock_state();
        if inner.is_command_in_progress || inner.machine_state.state == ServiceState::Ending {
            return false;
        }
        inner.machine_state.state = state;
        drop(inner);
        self.notify_change();
        true
    }

    /// Ends the command in progress and sets the state, unless the service is ending.
    pub(super) fn finish_command(&self, state: ServiceState) {
        let mut inner = self.lock_state();
        inner.is_command_in_progress = false;
        if inner.machine_state.state != ServiceState::Ending {
            inner.machine_state.state = state;
        }
        drop(inner);
        self.notify_change();
    }
}

#[cfg(test)]
impl CommandGate {
    /// Gate of a machine with one cycle; the receiver is that of [`Self::new`].
    pub fn for_tests() -> (Self, mpsc::Receiver<WorkerCommand>) {
        let config = "min_interval_s = 0.0\n[[cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n";
        Self::new(&toml::from_str(config).unwrap(), Log::new(|_, _| {}))
    }
}
