//! All machines of one daemon. Each has its own worker and thread, so that the computations of one run do not
//! delay another machine.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle};

use super::captures::Captures;
use super::command_gate::CommandGate;
use super::config::{Config, Http};
use super::metrics::Metrics;
use super::retention::{self, Retention};
use super::worker::MachineWorker;
use super::{Ended, Log, ServeError, http, notify};
use crate::setup::{MachineFile, Pace};
use crate::store::Journal;
use devices::controllers::Halt;

/// The machines that the daemon serves, before it starts.
pub struct Service {
    workers: Vec<MachineWorker>,
    http: Option<Http>,
    folder: PathBuf,
    log: Log,
    metrics: Metrics,
    captures: Option<Captures>,
    retention: Option<Retention>,
}

impl Service {
    /// `folder`: folder of the journal and the locks. Nothing is opened yet.
    ///
    /// # Errors
    /// A cycle has an unknown method or invalid settings, two machines have the same name, or no trigger could start
    /// a machine.
    pub fn new(
        machines: Vec<(MachineFile, Config)>,
        http: Option<Http>,
        folder: PathBuf,
        pace: Pace,
        log: Log,
    ) -> Result<Self, ServeError> {
        let (several, metrics) = (machines.len() > 1, Metrics::default());
        let mut workers: Vec<MachineWorker> = Vec::new();
        for (machine, config) in machines {
            let name = machine.machine.name.clone();
            if workers.iter().any(|other| other.name() == name) {
                return Err(ServeError::SameName(name));
            }
            if http.is_none() && config.modbus.is_none() && config.line.is_none() {
                return Err(ServeError::NoWayIn(name));
            }
            let log = if several { log.of(name) } else { log.clone() };
            let served = (machine, config);
            workers.push(MachineWorker::new(served, folder.clone(), pace, log)?);
        }
        let (captures, retention) = (None, None);
        Ok(Self { workers, http, folder, log, metrics, captures, retention })
    }

    /// Captures every byte of each run's links: the file name is that of `file` with the run's number before the
    /// extension.
    pub fn capturing(mut self, file: PathBuf) -> Self {
        let captures = Captures::new(file);
        let workers = self.workers.into_iter();
        self.workers = workers.map(|one| one.capturing(captures.clone())).collect();
        self.captures = Some(captures);
        self
    }

    /// Removes old samples and captures according to `retention`.
    pub fn retaining(self, retention: Option<Retention>) -> Self {
        Self { retention, ..self }
    }

    /// Checks that the plans of all cycles can be measured. Nothing is opened.
    ///
    /// # Errors
    /// The first cycle that cannot be measured.
    pub fn check(&self) -> Result<(), ServeError> {
        let runtime = tokio::runtime::Builder::new_current_thread().build();
        let runtime = runtime.map_err(ServeError::Thread)?;
        self.workers.iter().try_for_each(|one| runtime.block_on(one.rehearse()))
    }

    /// Handle that ends the service: it holds each machine on which a run is in progress.
    pub fn halt(&self) -> Halt {
        let (gates, log) = (self.gates(), self.log.clone());
        Halt::new(move || {
            gates.iter().for_each(CommandGate::end);
            notify::stopping(&log);
        })
    }

    fn gates(&self) -> Vec<CommandGate> {
        self.workers.iter().map(|one| one.gate().clone()).collect()
    }

    /// Serves until [`Service::halt`] is triggered.
    ///
    /// # Errors
    /// The service cannot start; then no machine is served.
    pub fn serve(self) -> Result<Ended, ServeError> {
        let journal = Arc::new(Journal::watched(&self.folder, self.metrics.wrote())?);
        let (halt, gates) = (self.halt(), self.gates());
        let watched = self.workers.iter().map(|one| (one.name().to_owned(), one.gate().clone()));
        let watched: notify::Watched = watched.collect();
        let shown = self.workers.iter().map(MachineWorker::served_machine).collect();
        let (ready, all_ready) = channel();
        let threads: Result<Vec<_>, ServeError> = self
            .workers
            .into_iter()
            .map(|one| Thread::start(one, Arc::clone(&journal), ready.clone()))
            .collect();
        drop(ready);
        let begun = threads.and_then(|threads| {
            until_ready(&all_ready)?;
            if let Some(config) = &self.http {
                http::start(config, shown, Arc::clone(&journal), self.metrics, &self.log)?;
            }
            if let Some(retention) = self.retention {
                retention::start(retention, journal, self.captures, gates, &self.log)?;
            }
            notify::ready(watched, &self.log)?;
            Ok(threads)
        });
        if begun.is_err() {
            halt.now();
        }
        let threads = begun?;
        self.log.say("ready");
        let ended = threads.into_iter().map(Thread::join).collect::<Result<Vec<_>, _>>()?;
        Ok(if ended.contains(&Ended::Held) { Ended::Held } else { Ended::Waiting })
    }
}

/// Waits until each worker has begun; returns the first error.
fn until_ready(all_ready: &Receiver<Result<(), ServeError>>) -> Result<(), ServeError> {
    all_ready.iter().collect()
}

/// The thread of a worker.
struct Thread {
    name: String,
    thread: JoinHandle<Ended>,
}

impl Thread {
    fn start(
        worker: MachineWorker,
        journal: Arc<Journal>,
        ready: Sender<Result<(), ServeError>>,
    ) -> Result<Self, ServeError> {
        let name = worker.name().to_owned();
        let thread = Builder::new().name("machine".to_owned());
        let thread =
            thread.spawn(move || live(worker, &journal, ready)).map_err(ServeError::Thread)?;
        Ok(Self { name, thread })
    }

    fn join(self) -> Result<Ended, ServeError> {
        self.thread.join().map_err(|_| ServeError::Died(self.name))
    }
}

fn live(
    mut worker: MachineWorker,
    journal: &Arc<Journal>,
    ready: Sender<Result<(), ServeError>>,
) -> Ended {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let begun = runtime.map_err(ServeError::Thread).and_then(|runtime| {
        runtime.block_on(worker.start(journal))?;
        Ok(runtime)
    });
    let (runtime, told) = match begun {
        Ok(runtime) => (Some(runtime), Ok(())),
        Err(error) => (None, Err(error)),
    };
    // The receiver may have been dropped, because another machine could not begin.
    let _ = ready.send(told);
    drop(ready);
    runtime.map_or(Ended::Waiting, |runtime| runtime.block_on(worker.run(journal)))
}
