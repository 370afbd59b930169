//! `trued serve`. For each machine an attendant on a thread of its own: it holds the machine's
//! lock, waits for triggers, runs a cycle, judges, waits again. One journal and one page for all.
//!
//! What may start a cycle is in [`desk`]; each folder here is a way in. A cycle that ends with the
//! machine held lets go of the machine's lock, so that a person can resume it; nothing starts until
//! somebody has acknowledged.

mod again;
mod ask;
mod attend;
pub mod board;
mod captures;
pub mod config;
mod daemon_file;
pub mod desk;
#[cfg(test)]
mod desk_tests;
mod http;
mod identify;
mod keep;
mod leave;
mod log;
mod metrics;
mod notify;
mod past;
mod pulse;
pub mod rota;
pub mod schedule;
pub mod telemetry;
mod together;
pub mod triggers;

pub use self::config::{Config, Http};
pub use self::daemon_file::DaemonFile;
pub use self::http::{Role, Token, TokenError, Tokens, Whereabouts, address};
pub use self::log::Log;
pub use self::together::Service;
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
    /// What to do next, where the message does not say it already.
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

/// How the service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// While it waited.
    Waiting,
    /// A run was under way and has not come to its end: the machine holds.
    Held,
}
