//! The journal (SQLite, write-ahead log, every commit synced) and the machine lock. Only durable data is
//! acknowledged; this module interprets no result.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use machine::record::estimate::{Estimate, Parameter, Verdict};
use machine::record::event::RunEvent;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::{Reading, Temperatures};

mod artefact_register;
mod audit;
mod backup;
mod checksum;
mod columns;
mod compensation;
mod connection;
mod durable_dir;
mod error;
mod format_identification;
mod journal;
mod lock;
mod migration;
mod read;
mod retention;
mod run_lists;
mod scan;
mod schedule;
mod schema;
mod signature;
mod state_dir;
mod state_file;
#[cfg(test)]
mod tests;
mod verified_copy;
mod write;

pub use artefact_register::{ArtefactRegister, ArtefactRegisterError, CertificateState, RegisteredArtefact};
pub use audit::{AuditEntry, StoredAuditEntry};
pub use backup::{BackupContent, backup};
pub use compensation::{
    CompensationEvent, CompensationState, CompensationValue, NewCompensation, StoredCompensation,
    UnfinishedCompensation,
};
pub use error::{StoreError, StoreFault};
pub use journal::{AwaitableWrite, Journal};
pub use lock::{LockError, LockHolder, MachineLock};
pub use run_lists::{NewestMeasuredRuns, RunFilter};
pub use schedule::{Arming, ScheduleSlot, SlotOutcome};
pub use signature::EstimateSignature;
pub use state_dir::state_dir;
pub use state_file::{FileVersion, StateFile, StateFileError};

/// Number of a run in its journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct RunId(pub i64);

impl std::fmt::Display for RunId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// State of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RunState {
    /// In progress, or its process died and this is not yet noticed.
    Running,
    /// Stopped by request or by a fault after motion; an operator may resume the run.
    Held,
    /// Measured to its end without a stored estimate. The journal derives this state: `finished` without an
    /// estimate.
    #[serde(rename = "not identified")]
    NotIdentified,
    /// Measured to its end, with an estimate.
    Finished,
    /// Ended by an error before any motion; not resumable.
    Failed,
    /// The process of the run died; an operator must check the machine before anything else.
    Interrupted,
    /// Not resumable, because its references moved or were never measured; its readings stay.
    #[serde(rename = "closed")]
    NotResumable,
}

impl RunState {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Held => "held",
            Self::NotIdentified => "not identified",
            Self::Finished => "finished",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
            Self::NotResumable => "closed",
        }
    }

    /// Whether an operator may resume the run.
    pub fn is_resumable(self) -> bool {
        matches!(self, Self::Held | Self::Interrupted)
    }
}

/// Data with which a run begins.
#[derive(Debug, Clone)]
pub struct NewRun {
    /// Text of the machine file as it was read.
    pub machine_file_text: String,
    /// Plan with the steps known so far; usually none.
    pub plan: Plan,
}

/// Head of a run, as shown in a list of runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunSummary {
    pub id: RunId,
    pub started: Timestamp,
    /// Time at which the run reached its present state; `None` while it runs.
    pub ended: Option<Timestamp>,
    pub method: String,
    pub machine: String,
    pub state: RunState,
    /// Version of the program that began the run.
    pub program_version: String,
    /// SHA-256 of the text of the machine file, see [`sha256_text`].
    pub config_sha256: String,
    /// Hash of the plan so far, see [`sha256_of_json`].
    pub plan_sha256: String,
    /// Name in the last signature of the run's last estimate; `None`: this estimate is not signed.
    pub signed: Option<String>,
    /// Verdict of the run's last estimate; `None`: the run has no estimate.
    pub verdict: Option<Verdict>,
    /// Reason why the run is held, failed or closed; `None` in other states.
    pub end_reason: Option<String>,
}

/// All data of one run in the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRun {
    pub summary: RunSummary,
    /// Text of the machine file as it was read.
    pub machine_file_text: String,
    /// Plan with the steps of all stages that were started, and the interruptions.
    pub plan: Plan,
    /// Stages in the order in which they were started.
    pub stages: Vec<Stage>,
    /// Readings in the order in which they were acknowledged.
    pub readings: Vec<Reading>,
    /// Time at which the last reading was acknowledged; `None` without readings, or if an older version stored
    /// them.
    pub last_reading_stored_at: Option<Timestamp>,
    /// Events with the times at which they were stored, oldest first.
    pub events: Vec<(Timestamp, RunEvent)>,
    /// Estimates, oldest first; the last one is valid.
    pub estimates: Vec<StoredEstimate>,
    /// Signatures, oldest first. A signature of an earlier estimate does not apply to the last one.
    pub signatures: Vec<(Timestamp, EstimateSignature)>,
}

impl StoredRun {
    /// Last estimate of the readings of this run alone.
    pub fn own_estimate(&self) -> Option<&Estimate> {
        let estimates = self.estimates.iter().rev().map(|stored| &stored.estimate);
        estimates.into_iter().find(|estimate| estimate.combined_runs().is_empty())
    }
}

/// Progress of a run; cheap enough for polling.
#[derive(Debug, Clone, PartialEq)]
pub struct RunProgress {
    /// Plan with the steps so far, without interruptions.
    pub plan: Plan,
    /// Stages in the order in which they were started.
    pub stages: Vec<Stage>,
    /// Step and repeat of each stored touch and scan.
    pub stored_steps_and_repeats: Vec<(u32, u32)>,
    /// The reading that was stored last; for a scan its last sample.
    pub last_reading: Option<Reading>,
}

/// One estimate of a run; a run may have several.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredEstimate {
    pub created: Timestamp,
    pub estimate: Estimate,
    /// Hash of the estimate, see [`sha256_of_json`].
    pub sha256: String,
    /// Version of the program that computed the estimate.
    pub program_version: String,
}

/// Selects which estimate of a run is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EstimateSelection {
    /// The last estimate, which is the valid one and may combine several runs.
    Last,
    /// The last estimate from the readings of this run alone.
    LastOwn,
}

/// Result of a finished run from one of its estimates.
#[derive(Debug, Clone, PartialEq)]
pub struct FinishedRunResult {
    pub run: RunId,
    /// Time at which the run began.
    pub started: Timestamp,
    /// Time at which the run was measured to its end; `started` if the journal does not contain it.
    pub ended: Timestamp,
    pub method: String,
    pub verdict: Verdict,
    pub parameters: Vec<Parameter>,
    /// Time from the first to the last reading, s, if the estimate contains it.
    pub first_to_last_reading_s: Option<f64>,
    /// Mean temperatures over the run's readings, a scan counting as one; thermometers without a value are left out.
    pub temperatures_c: Temperatures,
}

/// SHA-256, in hexadecimal digits, of the compact JSON of `value`: independent of the formatting of a file that
/// contains it.
///
/// # Errors
/// `value` cannot be written as JSON.
pub fn sha256_of_json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string(value).map(|text| sha256_text(&text))
}

/// SHA-256 of `text` in hexadecimal digits, as in `config_sha256` of a run.
pub fn sha256_text(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}
