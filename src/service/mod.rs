//! `trued serve`. Each machine has a worker on its own thread: it holds the machine's lock, waits for a trigger,
//! runs a cycle, stores the verdict, and waits again. All machines share one journal and one page.
//!
//! [`command_gate`] decides what may start a cycle; `http`, [`schedule`] and [`triggers`] are the ways to start
//! one. A cycle that ends with the machine held releases the machine's lock, so that a person can resume the run.
//! No cycle starts until a person has acknowledged.

mod acknowledge;
mod captures;
pub mod command_gate;
#[cfg(test)]
mod command_gate_tests;
pub mod config;
mod cycle_failure;
mod daemon;
mod daemon_file;
mod heartbeat;
mod http;
mod identify;
mod last_run;
mod log;
pub mod machine_state;
mod metrics;
mod notify;
mod resume;
mod retention;
mod run_events;
pub mod schedule;
pub mod schedule_state;
pub mod telemetry;
pub mod triggers;
mod worker;
mod worker_command;

pub use self::config::{Config, Http};
pub use self::daemon::Service;
pub use self::daemon_file::DaemonFile;
pub use self::http::{PageAddressFile, Role, Token, TokenError, Tokens, address};
pub use self::log::Log;
use crate::run::RunError;
use crate::setup::SetupError;
use crate::store::{LockError, StoreError};

/// Why the service cannot serve.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Lock(#[from] LockError),
    #[error("cycle {number} cannot be measured: {error}")]
    Cycle { number: u16, error: Box<RunError> },
    #[error("{what} cannot listen on {listen}: {source}")]
    Listen { what: &'static str, listen: std::net::SocketAddr, source: std::io::Error },
    #[error("two machines are named `{0}`")]
    SameName(String),
    #[error("nothing could start a cycle of `{0}`")]
    NoWayIn(String),
    #[error(transparent)]
    Token(#[from] TokenError),
    #[error("a thread cannot be started: {0}")]
    Thread(std::io::Error),
    #[error("the thread of `{0}` has died")]
    Died(String),
}

impl ServeError {
    /// Remedy, where the message does not contain one.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Setup(error) => error.remedy(),
            Self::Store(error) => Some(error.remedy().to_owned()),
            Self::Lock(error) => Some(error.remedy().to_owned()),
            Self::Cycle { error, .. } => Some(error.remedy()),
            Self::Listen { .. } => Some(
                "its listen is an address of this computer and a port that nobody else \
                 has; ports below 1024 need a right of their own"
                    .to_owned(),
            ),
            Self::SameName(_) => Some(
                "the journal tells machines by their name: give each its own in [machine]"
                    .to_owned(),
            ),
            Self::NoWayIn(_) => {
                Some("add [serve.modbus], [serve.line] or [serve.http] to its file".to_owned())
            }
            Self::Token(error) => Some(error.remedy().to_owned()),
            Self::Thread(_) => None,
            Self::Died(_) => Some(
                "look at the machine and report what stands in the log as an error of trued"
                    .to_owned(),
            ),
        }
    }
}

/// State in which the service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// No run was in progress.
    Waiting,
    /// A run was in progress and is not complete: the machine is held.
    Held,
}
