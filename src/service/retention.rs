//! `[retention]`: removes the samples and the captures of old runs that have an estimate. It runs only while no
//! machine measures.

use std::sync::Arc;
use std::thread::{Builder, sleep};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;

use super::captures::Captures;
use super::command_gate::CommandGate;
use super::machine_state::State;
use super::{Log, ServeError};
use crate::store::{Journal, StoreError};

/// Time between two searches for old data.
const EVERY: Duration = Duration::from_secs(3600);
/// Time between two checks whether all machines wait.
const TICK: Duration = Duration::from_secs(10);

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    keep_days: u32,
}

/// `[retention]`, validated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Retention {
    pub keep_days: u32,
}

impl TryFrom<Keys> for Retention {
    type Error = String;

    fn try_from(Keys { keep_days }: Keys) -> Result<Self, String> {
        match (30..=36_500).contains(&keep_days) {
            true => Ok(Self { keep_days }),
            false => Err(format!("keep_days is {keep_days}; from 30 to 36500")),
        }
    }
}

/// Applies the retention for as long as the process lives.
///
/// # Errors
/// The thread cannot be started.
pub(super) fn start(
    retention: Retention,
    journal: Arc<Journal>,
    captures: Option<Captures>,
    gates: Vec<CommandGate>,
    log: &Log,
) -> Result<(), ServeError> {
    let log = log.clone();
    let busy = move || gates.iter().any(|gate| gate.machine_state().state == State::Running);
    let keep = move || {
        while busy() {
            sleep(TICK);
        }
        if let Err(error) = sweep(retention, &journal, captures.as_ref(), &busy, &log) {
            log.fault(&format!("retention: {error}; {}", error.remedy()));
        }
        sleep(EVERY);
    };
    let thread = Builder::new().name("retention".to_owned());
    let thread = thread.spawn(move || std::iter::repeat_with(keep).for_each(drop));
    thread.map(drop).map_err(ServeError::Thread)
}

/// Processes one run at a time; after an interruption by a cycle, the next sweep continues.
fn sweep(
    Retention { keep_days }: Retention,
    journal: &Journal,
    captures: Option<&Captures>,
    busy: &impl Fn() -> bool,
    log: &Log,
) -> Result<(), StoreError> {
    let age = SignedDuration::from_hours(24 * i64::from(keep_days));
    for run in journal.runs_with_expired_samples(Timestamp::now() - age)? {
        if busy() {
            return Ok(());
        }
        let scans = journal.remove_scan_samples(run)?;
        if scans > 0 {
            log.say(&format!("run {run}: the samples of {scans} scans are removed"));
        }
        if captures.is_some_and(|captures| captures.forget(run)) {
            log.say(&format!("run {run}: its capture is removed"));
        }
    }
    Ok(())
}
