//! `trued serve`. Each machine has a worker on its own thread: it holds the machine's lock, waits for a trigger,
//! runs a cycle, stores the verdict, and waits again. All machines share one journal and one page.
//!
//! [`command_gate`] decides whether a cycle may start; `http`, [`schedule`] and [`triggers`] request starts. A cycle
//! that ends with the machine held releases the machine's lock, so that a person can resume the run. No cycle starts
//! until a person has acknowledged the held state.

mod artefact_condition;
mod captures;
pub mod command_gate;
#[cfg(test)]
mod command_gate_tests;
mod compensation;
pub mod config;
mod cycle_failure;
mod daemon;
mod daemon_file;
mod gate_inputs;
mod heartbeat;
mod held_machine_inspection;
mod http;
mod identification_queue;
mod key_range;
mod last_run;
mod log;
pub mod log_destination;
pub mod machine_state;
mod metrics;
mod not_started;
mod result_metrics;
mod resume;
mod retention;
mod run_events;
pub mod schedule;
pub mod schedule_state;
mod systemd_watchdog;
pub mod triggers;
mod worker;
mod worker_command;

use std::sync::{Mutex, MutexGuard, PoisonError};

pub use self::config::{HttpConfig, ServeConfig};
pub use self::daemon::Service;
pub use self::daemon_file::DaemonFile;
pub use self::http::{PageAddressFile, Role, Token, TokenError, TokenStore, machine_page_path};
pub use self::log::Log;
use crate::run::RunError;
use crate::setup::SetupError;
use crate::store::{ArtefactRegisterError, LockError, StoreError};

/// Why the service cannot serve.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The rehearsal of the configured cycle `number` failed.
    #[error("cycle {number} cannot be measured: {error}")]
    InvalidCycle { number: u16, error: Box<RunError> },
    #[error("{server} cannot listen on {listen}: {source}")]
    Listen { server: &'static str, listen: std::net::SocketAddr, source: std::io::Error },
    #[error("two machines have the name `{0}`")]
    DuplicateMachineName(String),
    /// The machine of this name has neither Modbus server, text line nor page.
    #[error("no interface can start a cycle of `{0}`")]
    NoTrigger(String),
    #[error(transparent)]
    Token(#[from] TokenError),
    #[error(transparent)]
    Artefact(#[from] ArtefactRegisterError),
    #[error("a thread cannot be started: {0}")]
    ThreadNotStarted(std::io::Error),
    #[error("the worker thread of `{0}` panicked")]
    ThreadPanicked(String),
}

impl ServeError {
    /// Remedy, where the message does not contain one.
    pub fn remedy(&self) -> Option<String> {
        let remedy = match self {
            Self::Setup(error) => return error.remedy(),
            Self::InvalidCycle { error, .. } => return Some(error.remedy()),
            Self::Artefact(error) => return Some(error.remedy()),
            Self::ThreadNotStarted(_) => return None,
            Self::Store(error) => error.remedy(),
            Self::Lock(error) => error.remedy(),
            Self::Token(error) => error.remedy(),
            Self::Listen { .. } => {
                "set `listen` to an address of this computer and a free port; a port below 1024 \
                 requires the capability CAP_NET_BIND_SERVICE"
            }
            Self::DuplicateMachineName(_) => {
                "the journal identifies machines by name: give each machine its own `name` in [machine]"
            }
            Self::NoTrigger(_) => "add [serve.modbus], [serve.line] or [serve.http] to its machine file",
            Self::ThreadPanicked(_) => "inspect the machine, and report the error in the log as a defect of trued",
        };
        Some(remedy.to_owned())
    }
}

/// Locks a mutex, also after a panic of another thread.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Starts a thread of the service.
fn spawn_thread(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), ServeError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(work).map(drop).map_err(ServeError::ThreadNotStarted)
}

/// State in which the service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExitState {
    /// No run was in progress.
    NoRunInProgress,
    /// A run was in progress and is not complete: the machine is held. With several machines: at least one of them is
    /// held.
    RunHeld,
}
