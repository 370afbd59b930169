//! All machines of one daemon: an attendant and a thread each, so that what one run computes does not
//! make another machine wait.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle};

use super::attend::Attendant;
use super::captures::Captures;
use super::config::{Config, Http};
use super::desk::Desk;
use super::keep::{self, Retention};
use super::metrics::Metrics;
use super::{Ended, Log, ServeError, http, notify};
use crate::setup::{MachineFile, Pace};
use crate::store::Journal;
use devices::controllers::Halt;

/// Machines, waiting.
pub struct Service {
    attendants: Vec<Attendant>,
    http: Option<Http>,
    folder: PathBuf,
    log: Log,
    metrics: Metrics,
    captures: Option<Captures>,
    retention: Option<Retention>,
}

impl Service {
    /// `folder`: where journal and locks are. Nothing is opened yet.
    ///
    /// # Errors
    /// A cycle of a method or with settings that there are not; a machine that nothing could start.
    pub fn new(
        machines: Vec<(MachineFile, Config)>,
        http: Option<Http>,
        folder: PathBuf,
        pace: Pace,
        log: Log,
    ) -> Result<Self, ServeError> {
        let (several, metrics) = (machines.len() > 1, Metrics::default());
        let mut attendants: Vec<Attendant> = Vec::new();
        for (machine, config) in machines {
            let name = machine.machine.name.clone();
            if attendants.iter().any(|other| other.name() == name) {
                return Err(ServeError::SameName(name));
            }
            if http.is_none() && config.modbus.is_none() && config.line.is_none() {
                return Err(ServeError::NoWayIn(name));
            }
            let log = if several { log.of(name) } else { log.clone() };
            let served = (machine, config);
            attendants.push(Attendant::new(served, folder.clone(), pace, log, &metrics)?);
        }
        let (captures, retention) = (None, None);
        Ok(Self { attendants, http, folder, log, metrics, captures, retention })
    }

    /// With every byte of each run's links in a file: `file` with the run's number before its ending.
    pub fn capturing(mut self, file: PathBuf) -> Self {
        let captures = Captures::new(file);
        let attendants = self.attendants.into_iter();
        self.attendants = attendants.map(|one| one.capturing(captures.clone())).collect();
        self.captures = Some(captures);
        self
    }

    /// What is old and large goes in time.
    pub fn retaining(self, retention: Option<Retention>) -> Self {
        Self { retention, ..self }
    }

    /// Whether it could serve: all cycles could be measured. Nothing is opened.
    ///
    /// # Errors
    /// The first cycle that could not.
    pub fn check(&self) -> Result<(), ServeError> {
        let runtime = tokio::runtime::Builder::new_current_thread().build();
        let runtime = runtime.map_err(ServeError::Thread)?;
        self.attendants.iter().try_for_each(|one| runtime.block_on(one.rehearse()))
    }

    /// Ends the service: holds each machine where a run is on.
    pub fn halt(&self) -> Halt {
        let (desks, log) = (self.desks(), self.log.clone());
        Halt::new(move || {
            desks.iter().for_each(Desk::end);
            notify::stopping(&log);
        })
    }

    fn desks(&self) -> Vec<Desk> {
        self.attendants.iter().map(|one| one.desk().clone()).collect()
    }

    /// Until [`Service::halt`].
    ///
    /// # Errors
    /// What keeps it from serving at all: then no machine is served.
    pub fn serve(self) -> Result<Ended, ServeError> {
        let journal = Arc::new(Journal::watched(&self.folder, self.metrics.wrote())?);
        let (halt, desks) = (self.halt(), self.desks());
        let watched = self.attendants.iter().map(|one| (one.name().to_owned(), one.desk().clone()));
        let watched: notify::Watched = watched.collect();
        let shown = self.attendants.iter().map(Attendant::shown).collect();
        let (ready, all_ready) = channel();
        let threads: Result<Vec<_>, ServeError> = self
            .attendants
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
                keep::start(retention, journal, self.captures, desks, &self.log)?;
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

/// Each has begun; the first that cannot is told.
fn until_ready(all_ready: &Receiver<Result<(), ServeError>>) -> Result<(), ServeError> {
    all_ready.iter().collect()
}

/// Where an attendant lives.
struct Thread {
    name: String,
    thread: JoinHandle<Ended>,
}

impl Thread {
    fn start(
        attendant: Attendant,
        journal: Arc<Journal>,
        ready: Sender<Result<(), ServeError>>,
    ) -> Result<Self, ServeError> {
        let name = attendant.name().to_owned();
        let thread = Builder::new().name("machine".to_owned());
        let thread =
            thread.spawn(move || live(attendant, &journal, ready)).map_err(ServeError::Thread)?;
        Ok(Self { name, thread })
    }

    fn join(self) -> Result<Ended, ServeError> {
        self.thread.join().map_err(|_| ServeError::Died(self.name))
    }
}

fn live(
    mut attendant: Attendant,
    journal: &Arc<Journal>,
    ready: Sender<Result<(), ServeError>>,
) -> Ended {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let begun = runtime.map_err(ServeError::Thread).and_then(|runtime| {
        runtime.block_on(attendant.begin(journal))?;
        Ok(runtime)
    });
    let (runtime, told) = match begun {
        Ok(runtime) => (Some(runtime), Ok(())),
        Err(error) => (None, Err(error)),
    };
    // Whoever waits for it may have gone: another machine could not begin.
    let _ = ready.send(told);
    drop(ready);
    runtime.map_or(Ended::Waiting, |runtime| runtime.block_on(attendant.attend(journal)))
}
