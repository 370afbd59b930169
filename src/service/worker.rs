//! Worker of one machine: it waits, and executes the commands that its gate has accepted, one at a time.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::timeout;
use tracing::field::Empty;
use tracing::{Instrument, Span, info_span};

use super::captures::{CaptureFiles, RunCapture};
use super::command_gate::CommandGate;
use super::config::{CycleConfig, ServeConfig};
use super::cycle_failure::CycleFailure;
use super::http::ServedMachine;
use super::identification_queue::IdentificationQueue;
use super::last_run::last_run_awaiting_inspection;
use super::machine_state::{CycleEnd, CycleOutcome, RunFailure, ServiceState};
use super::run_events::RunEventPublisher;
use super::worker_command::{InspectionReport, WorkerCommand};
use super::{ExitState, Log, ServeError, schedule, triggers};
use crate::run::{self, CycleError, IdentificationError};
use crate::setup::{self, Devices, EarlierSessions, MachineFile, SetupError, SimulationPace};
use crate::store::{Journal, MachineLock, RunId, StoreError};
use link::LinkMode;
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;

/// Time between two heartbeats while the worker waits, and between two checks of the artefact register, of other
/// processes and of pending identifications.
const IDLE_POLL_PERIOD: Duration = Duration::from_secs(1);
/// Maximum time between two heartbeats while the worker waits; after that, the worker counts as hung.
const MAX_IDLE_HEARTBEAT_INTERVAL: Duration = Duration::from_secs(10);

/// Executes the accepted commands of one machine, one at a time, on its own thread; has the machine's lock except
/// while the machine is held.
pub(super) struct MachineWorker {
    pub(super) machine_file: MachineFile,
    config: ServeConfig,
    pub(super) state_dir: PathBuf,
    pub(super) simulation_pace: SimulationPace,
    pub(super) gate: CommandGate,
    commands: mpsc::Receiver<WorkerCommand>,
    pub(super) log: Log,
    /// `None`: the links are not captured.
    pub(super) capture_files: Option<CaptureFiles>,
    /// The machine's lock; `None` while a person may resume the run from another process.
    pub(super) machine_lock: Option<MachineLock>,
    /// Identifications of runs that were measured but not identified, by this process or an earlier one.
    pub(super) identification_queue: IdentificationQueue,
}

impl MachineWorker {
    /// `folder`: folder of the journal and the locks. Nothing is opened yet.
    ///
    /// # Errors
    /// A cycle has an unknown method or invalid settings.
    pub fn new(
        machine: MachineFile,
        config: ServeConfig,
        folder: PathBuf,
        pace: SimulationPace,
        log: Log,
    ) -> Result<Self, ServeError> {
        for cycle in &config.cycles {
            setup::configure_method_and_plan_without_steps(&machine, &cycle.method, cycle.repeat)?;
        }
        let (gate, commands) = CommandGate::new(&config, log.clone());
        Ok(Self {
            machine_file: machine,
            config,
            state_dir: folder,
            simulation_pace: pace,
            gate,
            commands,
            log,
            capture_files: None,
            machine_lock: None,
            identification_queue: IdentificationQueue::default(),
        })
    }

    /// Acquires the machine's lock, rehearses the cycles, and starts the triggers and the schedule. Call it inside
    /// the tokio runtime that will execute the commands.
    ///
    /// # Errors
    /// The machine cannot be served.
    pub async fn start_serving(&mut self, journal: &Arc<Journal>) -> Result<(), ServeError> {
        self.machine_lock = Some(self.acquire_lock(journal).await?);
        self.rehearse_cycles().await?;
        self.update_artefact_condition();
        triggers::start_triggers(&self.config, &self.gate, &self.log)?;
        match last_run_awaiting_inspection(journal, self.machine_name())? {
            Some(before) => {
                self.log.info(&format!("run {} is unfinished: a person must resume or acknowledge it", before.run));
                self.machine_lock = None;
                let run = u32::try_from(before.run.0).unwrap_or(u32::MAX);
                self.gate.update_machine_state(|machine_state| {
                    (machine_state.run, machine_state.failure) = (run, Some(before.failure))
                });
                self.gate.finish_command(ServiceState::Held);
            }
            None => self.gate.finish_command(ServiceState::Waiting),
        }
        schedule::start_scheduler(self.machine_name(), &self.config, &self.gate, journal, &self.log)?;
        // The duration of the start-up does not count: progress is monitored from here on.
        self.gate.report_progress(MAX_IDLE_HEARTBEAT_INTERVAL);
        Ok(())
    }

    /// Executes the accepted commands until the gate ends. Errors of a cycle are in the machine state and in the log.
    pub async fn execute_commands(mut self, journal: &Journal) -> ExitState {
        loop {
            self.gate.report_progress(MAX_IDLE_HEARTBEAT_INTERVAL);
            let command = match timeout(IDLE_POLL_PERIOD, self.commands.recv()).await {
                Ok(Some(command)) => command,
                Ok(None) => break,
                // No command arrived within the poll period.
                Err(_) => {
                    self.update_artefact_condition();
                    self.update_state_from_other_process(journal).await;
                    self.identification_queue.advance(&self.gate, &self.log, journal).await;
                    continue;
                }
            };
            self.gate.report_progress(self.config.max_event_interval);
            let exit_state = match command {
                _ if self.gate.is_ending() => break,
                WorkerCommand::ShutDown => break,
                WorkerCommand::Acknowledge(report) => {
                    self.handle_acknowledgement(report, journal).await;
                    None
                }
                WorkerCommand::StartCycle { cycle } => {
                    let span = info_span!("cycle", machine = self.machine_name(), cycle, run = Empty);
                    self.run_cycle(cycle, journal).instrument(span).await
                }
                WorkerCommand::Compensate(job) => {
                    self.execute_compensation(job, journal);
                    None
                }
                WorkerCommand::ResumeRun { run, report } => {
                    let span = info_span!("cycle", machine = self.machine_name(), run = run.0);
                    self.resume_cycle(run, report, journal).instrument(span).await
                }
            };
            if let Some(exit_state) = exit_state {
                return exit_state;
            }
        }
        ExitState::NoRunInProgress
    }

    /// Measures and identifies a new run, and records the result; returns the exit state if the service must end.
    async fn run_cycle(&mut self, cycle_number: u16, journal: &Journal) -> Option<ExitState> {
        let measured = self.measure_cycle(cycle_number, journal).await;
        self.finish_cycle(measured, ServiceState::Failed)
    }

    /// Resumes the held run and records the result; returns the exit state if the service must end. `None` also if
    /// the resume is refused.
    async fn resume_cycle(&mut self, run: RunId, report: InspectionReport, journal: &Journal) -> Option<ExitState> {
        let resumable_run = self.prepare_resume(run, report, journal).await?;
        let measured = self.resume_run(resumable_run, journal).await;
        // If the devices could not be opened, the run still waits for a person.
        self.finish_cycle(measured, ServiceState::Held)
    }

    /// Rehearses all cycles, so that an error is reported at the start and not when the operator presses the button.
    pub async fn rehearse_cycles(&self) -> Result<(), ServeError> {
        let dialect = setup::machine_dialect(&self.machine_file)?;
        let mut all = BTreeMap::new();
        for CycleConfig { number, method, repeat } in &self.config.cycles {
            let (method, plan_without_steps) =
                setup::configure_method_and_plan_without_steps(&self.machine_file, method, *repeat)?;
            let rehearsed = run::rehearse(method.as_ref(), &plan_without_steps, &dialect).await;
            let rehearsed =
                rehearsed.map_err(|error| ServeError::InvalidCycle { number: *number, error: Box::new(error) })?;
            let minutes = rehearsed.machine_time_s / 60.0;
            let person = if rehearsed.has_prompts { "; its plan has prompts" } else { "" };
            self.log.info(&format!("cycle {number}: machine time about {minutes:.0} min{person}"));
            all.insert(*number, rehearsed);
        }
        self.gate.set_rehearsal_results(all);
        Ok(())
    }

    pub fn served_machine(&self) -> ServedMachine {
        ServedMachine {
            name: self.machine_name().to_owned(),
            machine_file: Arc::new(self.machine_file.clone()),
            gate: self.gate.clone(),
            live_part_cache: Arc::default(),
        }
    }

    pub fn machine_name(&self) -> &str {
        &self.machine_file.machine.name
    }

    /// Maximum time between two events of a run; after that, the run counts as hung.
    pub(super) fn max_event_interval(&self) -> Duration {
        self.config.max_event_interval
    }

    /// Acquires the machine's lock, marks runs whose process has died as interrupted, and queues the runs without an
    /// estimate.
    pub(super) async fn acquire_lock(&mut self, journal: &Journal) -> Result<MachineLock, ServeError> {
        let lock = MachineLock::acquire(&self.state_dir, self.machine_name())?;
        journal.mark_running_runs_interrupted(&lock).await?;
        self.queue_unidentified_runs(journal)?;
        Ok(lock)
    }

    /// Queues the runs without an estimate. Call this function only while this process holds the machine's lock.
    pub(super) fn queue_unidentified_runs(&mut self, journal: &Journal) -> Result<(), StoreError> {
        self.identification_queue.queue_unidentified_runs(journal, &self.machine_file.machine.name)
    }

    /// Records the result of a cycle; returns the exit state if the service must end. `state_if_unopened`: state of
    /// the machine if the cycle ended before its devices were open.
    fn finish_cycle(
        &mut self,
        measured: Result<(RunId, Estimate), CycleFailure>,
        state_if_unopened: ServiceState,
    ) -> Option<ExitState> {
        let end = match &measured {
            Ok((run, estimate)) => {
                self.log.info(&format!("run {run} is finished, verdict {}", estimate.verdict));
                let outcome = Some(CycleOutcome::Judged(estimate.verdict));
                CycleEnd { state: ServiceState::Waiting, estimate: Some(estimate), outcome, ..CycleEnd::default() }
            }
            Err(failed) => self.log_failed_cycle(failed, state_if_unopened),
        };
        let state = end.state;
        if state == ServiceState::Held {
            // From now on a person may resume the run, from the web page or from the command line.
            self.machine_lock = None;
        }
        self.gate.record_cycle_end(end);
        (state != ServiceState::Waiting && self.gate.is_ending()).then_some(ExitState::RunHeld)
    }

    /// Logs why a cycle has no estimate, and returns how it ended. A run whose identification was stopped is queued for
    /// a later identification.
    fn log_failed_cycle(&mut self, failed: &CycleFailure, state_if_unopened: ServiceState) -> CycleEnd<'static> {
        let (state, outcome) = match failed {
            CycleFailure::Cycle(error) if error.holds_machine() => (ServiceState::Held, Some(CycleOutcome::Held)),
            // The run is completely measured and nothing moves; it is identified, and counted, while the machine waits.
            CycleFailure::Cycle(CycleError::NotIdentified { run, why: IdentificationError::Stopped }) => {
                self.identification_queue.add_run(*run);
                (ServiceState::Waiting, None)
            }
            CycleFailure::Cycle(error) => {
                (ServiceState::Failed, (!error.is_requested_stop()).then_some(CycleOutcome::Failed))
            }
            CycleFailure::Setup(_) | CycleFailure::Artefact(_) => (state_if_unopened, Some(CycleOutcome::Failed)),
        };
        let RunFailure { what, remedy } = failed.describe();
        let message = match &remedy {
            Some(remedy) if state != ServiceState::Waiting => format!("{what}; {remedy}"),
            _ => what.clone(),
        };
        match failed {
            CycleFailure::Cycle(error) if error.is_requested_stop() => self.log.info(&message),
            _ => self.log.error(&message),
        }
        let failure = (state != ServiceState::Waiting).then_some(RunFailure { what, remedy });
        let is_link_error = matches!(failed, CycleFailure::Cycle(CycleError::MeasurementIncomplete { error, .. }) if error.is_link_error());
        CycleEnd { state, estimate: None, failure, outcome, ended_by_link_error: is_link_error }
    }

    /// Opens the devices, measures a new run and identifies it.
    async fn measure_cycle(&self, cycle_number: u16, journal: &Journal) -> Result<(RunId, Estimate), CycleFailure> {
        let allowed = self.config.cycles.iter().find(|cycle| cycle.number == cycle_number);
        let Some(CycleConfig { method, repeat, .. }) = allowed else {
            return Err(SetupError::NoSuchMethod { name: format!("cycle {cycle_number}") }.into());
        };
        let (method, mut plan_without_steps) =
            setup::configure_method_and_plan_without_steps(&self.machine_file, method, *repeat)?;
        plan_without_steps.report = self.report_data_for_run()?;
        let opening = setup::open_devices(&self.machine_file, self.simulation_pace, EarlierSessions::default());
        let (devices, capture) = self.open_devices_with_capture(opening).await?;
        let mut events = RunEventPublisher::new(&self.gate, &self.log, self.max_event_interval());
        let mut publish = |event: &RunEvent| events.publish_event(event);
        let begun = |id: RunId| {
            Span::current().record("run", id.0);
            self.log.info(&format!("run {id} begins"));
            capture.iter().for_each(|capture| capture.name_after_run(id));
            self.gate.update_machine_state(|machine_state| machine_state.run = u32::try_from(id.0).unwrap_or(u32::MAX));
        };
        let answers = self.gate.prompt_answer_source(self.max_event_interval());
        let cycle = run::Cycle {
            machine_file: &self.machine_file,
            method: method.into(),
            plan_without_steps,
            prompt_answer_source: answers,
        };
        let ended = cycle.run(&devices, journal, begun, &mut publish).await;
        capture.into_iter().for_each(RunCapture::finish);
        Ok(ended?)
    }

    /// Opens the devices, with a capture if configured. After this call, a hold reaches the control; a hold requested
    /// before takes effect now.
    pub(super) async fn open_devices_with_capture(
        &self,
        opening: impl Future<Output = Result<Devices, SetupError>>,
    ) -> Result<(Devices, Option<RunCapture<'_>>), SetupError> {
        let capture = self.capture_files.as_ref().and_then(|captures| captures.create_for_cycle(&self.log));
        let link_mode = capture.as_ref().map_or(LinkMode::Direct, RunCapture::link_mode);
        let devices = link_mode.apply_to(opening).await?;
        self.gate.register_halt_handle(&devices.open_controller.halt_handle());
        Ok((devices, capture))
    }
}
