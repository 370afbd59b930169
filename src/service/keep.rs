//! `[retention]`: what was sampled in runs of long ago goes, with their captures, once they have an
//! estimate. Only while no machine measures.

use std::sync::Arc;
use std::thread::{Builder, sleep};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;

use super::board::State;
use super::captures::Captures;
use super::desk::Desk;
use super::{Log, ServeError};
use crate::store::{Journal, StoreError};

/// How often it is looked for.
const EVERY: Duration = Duration::from_secs(3600);
/// How often it is asked whether all machines wait.
const TICK: Duration = Duration::from_secs(10);

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    keep_days: u32,
}

/// Found sound.
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

/// Keep to it for as long as the process lives.
///
/// # Errors
/// No thread.
pub(super) fn start(
    retention: Retention,
    journal: Arc<Journal>,
    captures: Option<Captures>,
    desks: Vec<Desk>,
    log: &Log,
) -> Result<(), ServeError> {
    let log = log.clone();
    let busy = move || desks.iter().any(|desk| desk.board().state == State::Running);
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

/// A run at a time; what a cycle interrupts is done the next time.
fn sweep(
    Retention { keep_days }: Retention,
    journal: &Journal,
    captures: Option<&Captures>,
    busy: &impl Fn() -> bool,
    log: &Log,
) -> Result<(), StoreError> {
    let age = SignedDuration::from_hours(24 * i64::from(keep_days));
    for run in journal.outlived(Timestamp::now() - age)? {
        if busy() {
            return Ok(());
        }
        let scans = journal.forget_scans(run)?;
        if scans > 0 {
            log.say(&format!("run {run}: the samples of {scans} scans are removed"));
        }
        if captures.is_some_and(|captures| captures.forget(run)) {
            log.say(&format!("run {run}: its capture is removed"));
        }
    }
    Ok(())
}
