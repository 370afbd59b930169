//! Floor 8: `trued serve`, in its smallest form. One machine; it holds its lock, waits for triggers,
//! runs a cycle, judges, waits again.
//!
//! What may start a cycle is in [`desk`]; each folder here is a way in. A cycle that ends with the
//! machine held lets go of the machine's lock, so that a person can resume it; nothing starts until
//! somebody has acknowledged.

mod attend;
pub mod board;
mod captures;
pub mod config;
pub mod desk;
mod http;
mod past;
pub mod triggers;

use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::mpsc;

use self::captures::Captures;
pub use self::config::Config;
use self::desk::{Ask, Desk};
pub use self::http::{Role, Token, TokenError, Tokens};
use crate::controllers::Halt;
use crate::run::RunError;
use crate::setup::{MachineFile, Pace, SetupError};
use crate::store::{LockError, StoreError};

/// Words for the person who reads the log.
pub type Log = Arc<dyn Fn(&str) + Send + Sync>;

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
    #[error(transparent)]
    Token(#[from] TokenError),
    #[error("a thread cannot be started: {0}")]
    Thread(std::io::Error),
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
            Self::Token(error) => Some(error.remedy().to_owned()),
            Self::Thread(_) => None,
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

/// One machine, waiting.
pub struct Service {
    machine: MachineFile,
    config: Config,
    folder: PathBuf,
    pace: Pace,
    desk: Desk,
    asks: mpsc::Receiver<Ask>,
    log: Log,
    captures: Option<Captures>,
}

impl Service {
    /// `folder`: where journal and locks are. Nothing is opened yet.
    ///
    /// # Errors
    /// A cycle of a method or with settings that there are not.
    pub fn new(
        machine: MachineFile,
        config: Config,
        folder: PathBuf,
        pace: Pace,
        log: Log,
    ) -> Result<Self, ServeError> {
        for cycle in &config.cycle {
            crate::setup::header(&machine, &cycle.method, cycle.repeat)?;
        }
        let (desk, asks) = Desk::new(&config, log.clone());
        Ok(Self { machine, config, folder, pace, desk, asks, log, captures: None })
    }

    /// With every byte of each run's links in a file: `file` with the run's number before its ending.
    pub fn capturing(mut self, file: PathBuf) -> Self {
        self.captures = Some(Captures::new(file));
        self
    }

    /// Ends the service: holds the machine if a run is on.
    pub fn halt(&self) -> Halt {
        let desk = self.desk.clone();
        Halt::new(move || desk.end())
    }
}
