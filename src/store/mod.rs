//! The one journal (SQLite, write-ahead log, every commit synced) and the machine lock.
//! Nothing is acknowledged that is not durable; nothing here interprets a result.

use jiff::Timestamp;
use serde::Serialize;
use sha2::{Digest, Sha256};

use machine::record::estimate::{Estimate, Parameter};
use machine::record::event::Event;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::{Reading, Temperatures};

mod audit;
mod backup;
mod checksum;
mod columns;
mod connection;
mod error;
mod folder;
mod identity;
mod journal;
mod lock;
mod migration;
mod page;
mod read;
mod retention;
mod scan;
mod schedule;
mod schema;
mod signature;
mod snapshot;
mod state_dir;
#[cfg(test)]
mod tests;
mod write;

pub use audit::{Audit, Audited};
pub use backup::{Copied, backup};
pub use error::{Fault, StoreError};
pub use journal::{Journal, Pending};
pub use lock::{Holder, LockError, MachineLock};
pub use page::{Newest, NewestRuns, Wanted};
pub use schedule::{Arming, Outcome, Slot};
pub use signature::Signature;
pub use state_dir::state_dir;

/// Number of a run in its journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct RunId(pub i64);

impl std::fmt::Display for RunId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Where a run stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RunState {
    Running,
    /// Stopped safely; a person may resume it.
    Held,
    /// Measured to its end; no estimate is stored. The journal derives it: `finished` without an estimate.
    #[serde(rename = "not identified")]
    NotIdentified,
    /// Measured, with an estimate.
    Finished,
    Failed,
    /// Its process died; a person looks at the machine before anything else.
    Interrupted,
    /// It cannot go on, because its references moved or were never measured; what it measured stays.
    Closed,
}

impl RunState {
    const ALL: [RunState; 7] = [
        Self::Running,
        Self::Held,
        Self::NotIdentified,
        Self::Finished,
        Self::Failed,
        Self::Interrupted,
        Self::Closed,
    ];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Held => "held",
            Self::NotIdentified => "not identified",
            Self::Finished => "finished",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
            Self::Closed => "closed",
        }
    }

    /// Whether a person may let it go on.
    pub fn is_resumable(self) -> bool {
        matches!(self, Self::Held | Self::Interrupted)
    }

    fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == text)
    }
}

/// What is known of a run when it begins.
#[derive(Debug, Clone)]
pub struct NewRun {
    /// The machine file as it was read.
    pub config: String,
    /// With the steps known so far; usually none.
    pub plan: Plan,
}

/// The head of a run: what a list of runs shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunSummary {
    pub id: RunId,
    pub started: Timestamp,
    /// When the run came to its present state; `None` while it runs.
    pub ended: Option<Timestamp>,
    pub method: String,
    pub machine: String,
    pub state: RunState,
    pub program_version: String,
    pub config_sha256: String,
    /// Of the plan as far as it is written, see [`sha256`].
    pub plan_sha256: String,
    /// Who signed its last estimate last.
    pub signed: Option<String>,
}

/// Everything the journal holds of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRun {
    pub summary: RunSummary,
    /// The machine file as it was read.
    pub config: String,
    pub plan: Plan,
    /// In the order in which they were started.
    pub stages: Vec<Stage>,
    /// In the order in which they were acknowledged.
    pub readings: Vec<Reading>,
    /// When the last of them was; `None` without readings, or if an older version kept them.
    pub measured_until: Option<Timestamp>,
    pub events: Vec<(Timestamp, Event)>,
    /// Oldest first; the last one counts.
    pub estimates: Vec<StoredEstimate>,
    /// Oldest first; one that is bound to an earlier estimate does not speak for the last.
    pub signatures: Vec<(Timestamp, Signature)>,
}

/// How far a run has come: cheap enough to be asked for again and again.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// With the steps so far, without interruptions.
    pub plan: Plan,
    pub stages: Vec<Stage>,
    /// Step and repeat of each touch and scan that is kept.
    pub done: Vec<(u32, u32)>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct StoredEstimate {
    pub made: Timestamp,
    pub estimate: Estimate,
    pub sha256: String,
    pub program_version: String,
}

/// What the last estimate of a finished run says.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    pub run: RunId,
    pub started: Timestamp,
    pub method: String,
    pub parameters: Vec<Parameter>,
    /// Means over its readings; without what nobody has said.
    pub temperatures_c: Temperatures,
}

/// SHA-256, in hexadecimal digits, of the compact JSON of `value`: independent of how a file that
/// holds it was laid out.
///
/// # Errors
/// When `value` cannot be written as JSON.
pub fn sha256(value: &impl Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string(value).map(|text| sha256_text(&text))
}

/// As in `config_sha256` of a run.
pub fn sha256_text(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}
