//! Resume of a run by the machine's worker, requested by a person at the web page.

use std::collections::BTreeSet;

use super::ServeError;
use super::captures::RunCapture;
use super::cycle_failure::CycleFailure;
use super::machine_state::{Refusal, ServiceState};
use super::run_events::RunEventPublisher;
use super::worker::MachineWorker;
use super::worker_command::InspectionReport;
use crate::run::{ResumableRun, ResumeRefusal};
use crate::setup;
use crate::store::{Journal, RunId};
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;

/// Why a run cannot be resumed.
#[derive(Debug, thiserror::Error)]
enum ResumeError {
    /// The machine's lock cannot be acquired, or the journal cannot be read or written.
    #[error(transparent)]
    Serve(#[from] ServeError),
    #[error(transparent)]
    Refused(#[from] ResumeRefusal),
}

impl MachineWorker {
    /// Prepares the resume of a run: this process acquires the machine's lock and writes the acknowledgement to the
    /// journal. Returns `None` after a refusal; the lock is then released, so that another process may resume the run.
    pub(super) async fn prepare_resume(
        &mut self,
        run: RunId,
        report: InspectionReport,
        journal: &Journal,
    ) -> Option<ResumableRun> {
        let InspectionReport { who, is_homed: homed, result_sender, .. } = report;
        match self.acknowledge_resume(run, &who, homed, journal).await {
            Ok(resumable_run) => {
                let _ = result_sender.send(Ok(()));
                Some(resumable_run)
            }
            Err(error) => {
                let why = match error {
                    ResumeError::Serve(ServeError::Lock(_)) => Refusal::UsedByOtherProgram,
                    ResumeError::Refused(ResumeRefusal::HomingNotConfirmed(_)) => Refusal::PositionLost,
                    _ => Refusal::NotReady,
                };
                self.gate.record_refusal(why, &format!("resume of run {run} by {who} ({error})"));
                self.machine_lock = None;
                self.gate.finish_command(ServiceState::Held);
                let _ = result_sender.send(Err(why));
                None
            }
        }
    }

    /// Acquires the machine's lock, checks that the run can still be resumed, and writes the acknowledgement to the
    /// journal.
    async fn acknowledge_resume(
        &mut self,
        run: RunId,
        who: &str,
        homed: bool,
        journal: &Journal,
    ) -> Result<ResumableRun, ResumeError> {
        if self.machine_lock.is_none() {
            self.machine_lock = Some(self.acquire_lock(journal).await?);
        }
        // Another process may have resumed the run meanwhile: the journal's current content decides.
        let resumable_run = ResumableRun::from_stored(journal.load_run(run).map_err(ServeError::from)?)?;
        let acknowledged = resumable_run.acknowledgement_event(who, homed)?;
        journal.add_event(run, &acknowledged).await.map_err(ServeError::from)?;
        Ok(resumable_run)
    }

    /// Opens the devices, measures the rest of the run and identifies it, after [`Self::prepare_resume`].
    pub(super) async fn resume_run(
        &self,
        resumable_run: ResumableRun,
        journal: &Journal,
    ) -> Result<(RunId, Estimate), CycleFailure> {
        let opening =
            setup::open_devices(&resumable_run.machine_file, self.simulation_pace, resumable_run.earlier_sessions());
        let (devices, capture) = self.open_devices_with_capture(opening).await?;
        let mut events = RunEventPublisher::new(&self.gate, &self.log, self.max_event_interval());
        let mut publish = |event: &RunEvent| events.publish_event(event);
        capture.iter().for_each(|capture| capture.name_after_run(resumable_run.stored_run.summary.id));
        let readings = resumable_run.stored_run.readings.iter();
        let stored_readings: BTreeSet<_> = readings.map(|reading| (reading.step, reading.repeat)).collect();
        self.gate.update_machine_state(|machine_state| {
            machine_state.stored_touch_and_scan_count = u32::try_from(stored_readings.len()).unwrap_or(u32::MAX)
        });
        let answers = self.gate.prompt_answer_source(self.max_event_interval());
        let ended = resumable_run.resume_and_identify(&devices, journal, answers, &mut publish).await;
        capture.into_iter().for_each(RunCapture::finish);
        Ok(ended?)
    }
}
