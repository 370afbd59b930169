//! A due cycle starts if a person has armed it and the machine reports that it is ready; otherwise the reason is
//! recorded.
//!
//! `due_and_missed_slots` finds the slots, and `start_decision` decides whether a slot may start; both are pure
//! functions. The `Scheduler` checks the clock once a second, on its own thread, so that a changed clock or a suspended
//! computer causes no wrong start. The outcome of a slot is in the journal before the machine moves.

pub mod calendar;
mod due_and_missed_slots;
pub mod entry;
mod scheduler;
mod slot_recorder;
mod start_decision;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use jiff::Timestamp;

use self::scheduler::Scheduler;
pub use self::scheduler::planned_schedules;
use self::slot_recorder::SlotRecorder;
use super::command_gate::CommandGate;
use super::config::ServeConfig;
use super::schedule_state::StartDueCycleRequest;
use super::{Log, ServeError, spawn_thread};
use crate::store::Journal;
use link::Clock;
use link::clock::HostClock;

/// Period of the clock checks.
const CLOCK_CHECK_PERIOD: Duration = Duration::from_secs(1);

/// Starts the scheduler thread of `machine`; it runs until the service ends. The caller holds the machine's lock. On
/// return, the journal contains the outcomes of the slots that an earlier process started.
///
/// # Errors
/// The journal cannot be written, or the thread cannot be started.
pub fn start_scheduler(
    machine: &str,
    config: &ServeConfig,
    gate: &CommandGate,
    journal: &Arc<Journal>,
    log: &Log,
) -> Result<(), ServeError> {
    let (start_request_sender, start_request_receiver) = channel();
    gate.set_start_due_cycle_sender(start_request_sender);
    let records = SlotRecorder { machine: machine.to_owned(), journal: Arc::clone(journal), log: log.clone() };
    let (config, gate) = (config.clone(), gate.clone());
    let (result_sender, result_receiver) = channel();
    let run = move || match Scheduler::create_and_record_earlier_slots(records, config, gate) {
        Ok(scheduler) => {
            let _ = result_sender.send(Ok(()));
            run_scheduler(scheduler, &start_request_receiver);
        }
        Err(error) => drop(result_sender.send(Err(error))),
    };
    // The scheduler blocks on the journal, so it needs a thread without a tokio runtime.
    spawn_thread("schedule", run)?;
    let died = || ServeError::ThreadNotStarted(std::io::Error::other("the thread of the schedule panicked"));
    Ok(result_receiver.recv().map_err(|_| died())??)
}

/// Checks the schedules every second, and at each request that a client reports a cycle as due, which it then
/// executes; until the service ends.
fn run_scheduler(mut scheduler: Scheduler, start_requests: &Receiver<StartDueCycleRequest>) {
    let clock = HostClock::start();
    loop {
        let request = match start_requests.recv_timeout(CLOCK_CHECK_PERIOD) {
            Ok(request) => Some(request),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        if scheduler.is_service_ending() {
            return;
        }
        let (now, now_s) = (Timestamp::now(), clock.now_s());
        scheduler.check_schedules(now, now_s);
        if let Some(request) = request {
            scheduler.start_cycle_reported_as_due(request, now);
        }
    }
}
