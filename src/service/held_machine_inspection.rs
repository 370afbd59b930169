//! End of the held state: a person reports the inspection of the machine (the run stays unfinished, new cycles may
//! start), or another process has ended the run.

use super::ServeError;
use super::last_run::{last_run, last_run_awaiting_inspection};
use super::machine_state::{Refusal, ServiceState};
use super::worker::MachineWorker;
use super::worker_command::InspectionReport;
use crate::store::{Journal, MachineLock};
use machine::record::event::RunEvent;

impl MachineWorker {
    /// Acts on the report of a person who has inspected the machine. A new cycle may then start; the held run is not
    /// resumed.
    pub(super) async fn handle_acknowledgement(&mut self, report: InspectionReport, journal: &Journal) {
        let (why, cause) = match self.acknowledge_held_run(&report, journal).await {
            Ok(None) => {
                self.gate.update_machine_state(|machine_state| machine_state.failure = None);
                self.gate.finish_command(ServiceState::Waiting);
                self.log.info("the held or failed state of the machine is acknowledged; a new cycle may start");
                let _ = report.result_sender.send(Ok(()));
                return;
            }
            Ok(Some(why)) => (why, String::new()),
            Err(ServeError::Lock(error)) => (Refusal::UsedByOtherProgram, format!(" ({error})")),
            Err(error) => (Refusal::NotReady, format!(" ({error})")),
        };
        let previous_state = self.gate.machine_state().state;
        if previous_state == ServiceState::Held {
            self.machine_lock = None;
        }
        self.gate.record_refusal(why, &format!("acknowledgement by {}{cause}", report.who));
        self.gate.finish_command(previous_state);
        // The receiver may have been dropped.
        let _ = report.result_sender.send(Err(why));
    }

    /// Acquires the machine's lock and, if a run awaits an inspection, records the acknowledgement in the journal.
    /// `None`: the acknowledgement is accepted, also without such a run.
    async fn acknowledge_held_run(
        &mut self,
        InspectionReport { who, why, is_homed: homed, .. }: &InspectionReport,
        journal: &Journal,
    ) -> Result<Option<Refusal>, ServeError> {
        match self.machine_lock {
            None => self.machine_lock = Some(self.acquire_lock(journal).await?),
            Some(_) => self.queue_unidentified_runs(journal)?,
        }
        let Some(held_run) = last_run_awaiting_inspection(journal, self.machine_name())? else { return Ok(None) };
        if held_run.may_have_lost_position && !homed {
            return Ok(Some(Refusal::PositionLost));
        }
        let homed = if *homed { ", all axes are homed" } else { "" };
        let why = if why.is_empty() { String::new() } else { format!(" ({why})") };
        let what = format!("the run stays unfinished{homed}; new cycles may start{why}");
        let event = RunEvent::Acknowledged { who: who.clone(), what, leaves: true };
        journal.add_event(held_run.run, &event).await?;
        Ok(None)
    }

    /// Updates the machine state while the machine is held and this process does not have the machine's lock: whether
    /// another process has the lock, and how that process left the run.
    pub(super) async fn update_state_from_other_process(&mut self, journal: &Journal) {
        let machine_state = self.gate.machine_state();
        if self.machine_lock.is_some() || machine_state.state != ServiceState::Held {
            return;
        }
        let elsewhere = MachineLock::holder(&self.state_dir, self.machine_name()).is_some();
        if elsewhere != machine_state.is_locked_by_other_process {
            self.gate.update_machine_state(|machine_state| machine_state.is_locked_by_other_process = elsewhere);
        }
        let last = last_run(journal, self.machine_name()).ok().flatten();
        let changed = last.is_some_and(|run| !run.state.is_resumable());
        if !elsewhere && (machine_state.is_locked_by_other_process || changed) {
            self.reload_run_state(journal).await;
        }
    }

    /// Reads the last run again; if no run awaits an inspection, the machine waits for a start again. The lock is
    /// acquired first: only then is a run whose process has died marked as interrupted.
    async fn reload_run_state(&mut self, journal: &Journal) {
        // If another process has acquired the lock meanwhile, the next call detects it.
        let Ok(lock) = self.acquire_lock(journal).await else { return };
        match last_run_awaiting_inspection(journal, self.machine_name()) {
            Ok(None) => {
                self.machine_lock = Some(lock);
                if self.gate.set_state_if_idle(ServiceState::Waiting) {
                    self.gate.update_machine_state(|machine_state| machine_state.failure = None);
                    self.log.info("another program has completed or closed the run; a new cycle may start");
                }
            }
            Ok(Some(held_run)) => {
                self.gate.update_machine_state(|machine_state| machine_state.failure = Some(held_run.failure))
            }
            Err(error) => self.log.error(&error.to_string()),
        }
    }
}
