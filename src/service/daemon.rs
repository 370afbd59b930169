//! All machines of one daemon. Each has its own worker and thread, so that the computations of one run do not
//! delay another machine.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::thread::{Builder, JoinHandle};

use super::captures::CaptureFiles;
use super::command_gate::CommandGate;
use super::config::HttpConfig;
use super::daemon_file::DaemonFile;
use super::metrics::Metrics;
use super::retention::{self, RetentionConfig};
use super::worker::MachineWorker;
use super::{ExitState, Log, ServeError, http, systemd_watchdog};
use crate::setup::SimulationPace;
use crate::store::Journal;
use devices::controllers::HaltHandle;

/// The machines that the daemon serves, before it starts.
pub struct Service {
    workers: Vec<MachineWorker>,
    /// `None`: no web page and no HTTP API.
    http_config: Option<HttpConfig>,
    /// Folder of the journal, the locks and the tokens.
    state_dir: PathBuf,
    log: Log,
    metrics: Metrics,
    /// `None`: the links are not captured.
    capture_files: Option<CaptureFiles>,
    /// `None`: samples and captures of old runs are never removed.
    retention_config: Option<RetentionConfig>,
}

impl Service {
    /// `state_dir`: folder of the journal and the locks. Nothing is opened yet.
    ///
    /// # Errors
    /// A cycle has an unknown method or invalid settings, two machines have the same name, or no trigger could start
    /// a machine.
    pub fn new(file: DaemonFile, state_dir: PathBuf, pace: SimulationPace, log: Log) -> Result<Self, ServeError> {
        let DaemonFile { machines, http_config: http, retention_config: retention } = file;
        let has_several_machines = machines.len() > 1;
        let mut workers: Vec<MachineWorker> = Vec::new();
        for (machine, config) in machines {
            let name = machine.machine.name.clone();
            if workers.iter().any(|other| other.machine_name() == name) {
                return Err(ServeError::DuplicateMachineName(name));
            }
            if http.is_none() && config.modbus_server_config.is_none() && config.line_interface_config.is_none() {
                return Err(ServeError::NoTrigger(name));
            }
            let log = if has_several_machines { log.with_machine_prefix(name) } else { log.clone() };
            workers.push(MachineWorker::new(machine, config, state_dir.clone(), pace, log)?);
        }
        Ok(Self {
            workers,
            http_config: http,
            state_dir,
            log,
            metrics: Metrics::default(),
            capture_files: None,
            retention_config: retention,
        })
    }

    /// Captures every byte of each run's links: the file name is that of `file` with the run's number before the
    /// extension.
    pub fn with_captures(mut self, file: PathBuf) -> Self {
        let captures = CaptureFiles::new(file);
        self.workers.iter_mut().for_each(|worker| worker.capture_files = Some(captures.clone()));
        self.capture_files = Some(captures);
        self
    }

    /// Checks that the plans of all cycles can be measured, and that the certificates of the artefacts are valid.
    /// Nothing is opened.
    ///
    /// # Errors
    /// The first cycle that cannot be measured, or the first machine whose artefact must not be used.
    pub fn check_plans(&self) -> Result<(), ServeError> {
        let runtime = tokio::runtime::Builder::new_current_thread().build();
        let runtime = runtime.map_err(ServeError::ThreadNotStarted)?;
        self.workers.iter().try_for_each(|worker| {
            runtime.block_on(worker.rehearse_cycles())?;
            worker.report_data_for_run()?;
            Ok(())
        })
    }

    /// Handle that ends the service: it holds each machine on which a run is in progress.
    pub fn shut_down_handle(&self) -> HaltHandle {
        let (gates, log) = (self.gates(), self.log.clone());
        HaltHandle::new(move || {
            gates.iter().for_each(CommandGate::shut_down);
            systemd_watchdog::notify_stopping(&log);
        })
    }

    fn gates(&self) -> Vec<CommandGate> {
        self.workers.iter().map(|worker| worker.gate.clone()).collect()
    }

    /// Serves until [`Service::shut_down_handle`] is triggered. Returns `RunHeld` if this end has interrupted the run
    /// of at least one machine.
    ///
    /// # Errors
    /// The service cannot start; then no machine is served. Or the thread of a worker has panicked.
    pub fn serve(self) -> Result<ExitState, ServeError> {
        let journal =
            Arc::new(Journal::open_with_job_callback(&self.state_dir, self.metrics.journal_write_observer())?);
        let (halt, gates) = (self.shut_down_handle(), self.gates());
        let watched_machines =
            self.workers.iter().map(|worker| (worker.machine_name().to_owned(), worker.gate.clone())).collect();
        let served_machines = self.workers.iter().map(MachineWorker::served_machine).collect();
        let (ready, all_ready) = channel();
        let threads: Result<Vec<_>, ServeError> = self
            .workers
            .into_iter()
            .map(|worker| WorkerThread::start(worker, Arc::clone(&journal), ready.clone()))
            .collect();
        drop(ready);
        let started = threads.and_then(|threads| {
            // Each worker reports that it has begun; the first error ends the wait.
            all_ready.iter().collect::<Result<(), ServeError>>()?;
            if let Some(config) = &self.http_config {
                http::start_http_server(config, served_machines, Arc::clone(&journal), self.metrics, &self.log)?;
            }
            if let Some(retention) = self.retention_config {
                retention::start_retention(retention, journal, self.capture_files, gates, &self.log)?;
            }
            systemd_watchdog::notify_ready_and_start_watchdog(watched_machines, &self.log)?;
            Ok(threads)
        });
        if started.is_err() {
            halt.trigger();
        }
        let threads = started?;
        self.log.info("ready");
        let ended = threads.into_iter().map(WorkerThread::join).collect::<Result<Vec<_>, _>>()?;
        Ok(if ended.contains(&ExitState::RunHeld) { ExitState::RunHeld } else { ExitState::NoRunInProgress })
    }
}

/// Thread that runs a [`MachineWorker`] until the service ends; `join` returns the exit state.
struct WorkerThread {
    machine_name: String,
    thread: JoinHandle<ExitState>,
}

impl WorkerThread {
    fn start(
        worker: MachineWorker,
        journal: Arc<Journal>,
        ready: Sender<Result<(), ServeError>>,
    ) -> Result<Self, ServeError> {
        let name = worker.machine_name().to_owned();
        let thread = Builder::new().name("machine".to_owned());
        let thread = thread.spawn(move || run_worker(worker, &journal, ready)).map_err(ServeError::ThreadNotStarted)?;
        Ok(Self { machine_name: name, thread })
    }

    fn join(self) -> Result<ExitState, ServeError> {
        self.thread.join().map_err(|_| ServeError::ThreadPanicked(self.machine_name))
    }
}

/// Starts and runs a worker; sends to `ready` once whether the start has succeeded.
fn run_worker(mut worker: MachineWorker, journal: &Arc<Journal>, ready: Sender<Result<(), ServeError>>) -> ExitState {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let started = runtime.map_err(ServeError::ThreadNotStarted).and_then(|runtime| {
        runtime.block_on(worker.start_serving(journal))?;
        Ok(runtime)
    });
    // The receiver may have been dropped, because another machine could not begin.
    let report = |result| drop(ready.send(result));
    match started {
        Ok(runtime) => {
            report(Ok(()));
            drop(ready);
            runtime.block_on(worker.execute_commands(journal))
        }
        Err(error) => {
            report(Err(error));
            ExitState::NoRunInProgress
        }
    }
}
