//! `[retention]`: removes the samples and the captures of old runs that have an estimate. It runs only while no
//! machine measures.

use std::sync::Arc;
use std::thread::sleep;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;

use super::captures::CaptureFiles;
use super::command_gate::CommandGate;
use super::key_range::check_key_range;
use super::machine_state::ServiceState;
use super::{Log, ServeError, spawn_thread};
use crate::store::{Journal, StoreError};

/// Pause between two removals of old samples and captures.
const REMOVAL_PERIOD: Duration = Duration::from_secs(3600);
/// Time between two checks whether all machines wait.
const IDLE_CHECK_PERIOD: Duration = Duration::from_secs(10);

/// Keys of `[retention]`, before validation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RetentionKeys {
    /// Time for which scan samples and captures are kept, days; runs and results are always kept.
    keep_days: u32,
}

/// `[retention]`, validated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "RetentionKeys")]
pub struct RetentionConfig {
    /// Age, days, from which the scan samples and the capture of a run with an estimate are removed.
    pub keep_samples_days: u32,
}

impl TryFrom<RetentionKeys> for RetentionConfig {
    type Error = String;

    fn try_from(RetentionKeys { keep_days }: RetentionKeys) -> Result<Self, String> {
        check_key_range("keep_days", keep_days, 30, 36_500).map(|()| Self { keep_samples_days: keep_days })
    }
}

/// Starts the thread that removes old samples and captures for as long as the process lives.
///
/// # Errors
/// The thread cannot be started.
pub(super) fn start_retention(
    retention: RetentionConfig,
    journal: Arc<Journal>,
    captures: Option<CaptureFiles>,
    gates: Vec<CommandGate>,
    log: &Log,
) -> Result<(), ServeError> {
    let log = log.clone();
    let is_any_run_in_progress = move || gates.iter().any(|gate| gate.machine_state().state == ServiceState::Running);
    let remove_when_idle = move || {
        while is_any_run_in_progress() {
            sleep(IDLE_CHECK_PERIOD);
        }
        if let Err(error) =
            remove_expired_samples(retention, &journal, captures.as_ref(), &is_any_run_in_progress, &log)
        {
            log.error(&format!("retention: {error}; {}", error.remedy()));
        }
        sleep(REMOVAL_PERIOD);
    };
    spawn_thread("retention", move || std::iter::repeat_with(remove_when_idle).for_each(drop))
}

/// Removes the samples and captures of runs that ended more than `keep_samples_days` ago and have an estimate. When a
/// cycle begins, the removal stops; the next call continues it.
fn remove_expired_samples(
    RetentionConfig { keep_samples_days: keep_days }: RetentionConfig,
    journal: &Journal,
    captures: Option<&CaptureFiles>,
    is_any_run_in_progress: &impl Fn() -> bool,
    log: &Log,
) -> Result<(), StoreError> {
    let age = SignedDuration::from_hours(24 * i64::from(keep_days));
    for run in journal.finished_runs_ended_before(Timestamp::now() - age)? {
        if is_any_run_in_progress() {
            return Ok(());
        }
        let scans = journal.remove_scans(run)?;
        if scans > 0 {
            log.info(&format!("run {run}: the samples of {scans} scans are removed"));
        }
        if captures.is_some_and(|captures| captures.delete_capture_file(run)) {
            log.info(&format!("run {run}: the capture file is removed"));
        }
    }
    Ok(())
}
