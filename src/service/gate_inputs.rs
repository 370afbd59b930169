//! Inputs of the gate other than commands: progress of the worker, readiness reports of the machine, and requests to
//! start a due cycle.

use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;

use tokio::sync::oneshot;

use super::command_gate::CommandGate;
use super::heartbeat::Heartbeat;
use super::lock;
use super::machine_state::Interlocks;
use super::not_started::NotStartedReason;
use super::schedule_state::{Readiness, StartDueCycleRequest};

impl CommandGate {
    /// Sets the reason why the artefact register permits no run (`None`: it permits runs). Returns whether it changed.
    pub(super) fn set_artefact_failure(&self, failure: Option<String>) -> bool {
        let mut inner = self.lock_state();
        let is_new = inner.artefact_failure != failure;
        inner.artefact_failure = failure;
        is_new
    }

    /// Reports progress of the worker; the next report is due within `next_report_within`.
    pub fn report_progress(&self, next_report_within: Duration) {
        *lock(&self.heartbeat) = Heartbeat::now(next_report_within);
    }

    /// Time since the last report of progress.
    pub fn progress_age(&self) -> Duration {
        lock(&self.heartbeat).age()
    }

    /// Whether the time that the last report of progress announced has passed: the worker counts as hung.
    pub fn is_progress_late(&self) -> bool {
        lock(&self.heartbeat).is_late()
    }

    /// Adds a source that reports the readiness of the machine.
    pub fn add_readiness_source(&self, source: impl Fn() -> Readiness + Send + Sync + 'static) {
        self.lock_state().readiness_sources.push(Arc::new(source));
    }

    /// Combined readiness of all sources. `None` without a source, or while one of them is stale: an unattended start
    /// needs the report of every source.
    pub fn combined_readiness(&self) -> Option<Readiness> {
        let reports = self.read_readiness_sources();
        let is_fresh = reports.iter().all(|report| report.interlocks.is_fresh);
        is_fresh.then(|| reports.into_iter().reduce(Readiness::combine)).flatten()
    }

    /// Combined interlocks of the fresh sources only: a person can replace a stale source, but cannot override a
    /// fresh one. `None`: no source is fresh.
    pub fn combined_fresh_interlocks(&self) -> Option<Interlocks> {
        let fresh = self.read_readiness_sources().into_iter().filter(|report| report.interlocks.is_fresh);
        fresh.reduce(Readiness::combine).map(|report| report.interlocks)
    }

    fn read_readiness_sources(&self) -> Vec<Readiness> {
        // A source may use the gate: the lock is released before the sources are called.
        let sources = self.lock_state().readiness_sources.clone();
        sources.iter().map(|source| source()).collect()
    }

    /// Sets the channel on which the scheduler receives the commands to start a due cycle.
    pub fn set_start_due_cycle_sender(&self, start_request_sender: Sender<StartDueCycleRequest>) {
        self.lock_state().due_request_sender = Some(start_request_sender);
    }

    /// Requests, on behalf of `who`, that the scheduler starts `cycle` now. `None`: the scheduler is not running.
    pub fn start_due_cycle(&self, cycle: u16, who: String) -> Option<oneshot::Receiver<Result<(), NotStartedReason>>> {
        let (result_sender, result_receiver) = oneshot::channel();
        let start_request_sender = self.lock_state().due_request_sender.clone()?;
        start_request_sender.send(StartDueCycleRequest { cycle, who, result_sender }).ok()?;
        Some(result_receiver)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readiness_needs_all_sources_and_none_stale() {
        let interlocks = Interlocks {
            is_fresh: true,
            is_start_enabled: true,
            is_auto_mode: true,
            is_door_closed: true,
            is_stop_set: false,
            has_person_for_prompts: false,
        };
        let all = Readiness {
            interlocks,
            is_probe_ready: true,
            is_artefact_in_place: true,
            is_temperature_in_range: true,
            is_control_idle: true,
        };
        let gate = CommandGate::for_tests().0;
        assert_eq!((gate.combined_readiness(), gate.combined_fresh_interlocks()), (None, None));
        gate.add_readiness_source(move || all);
        assert_eq!((gate.combined_readiness(), gate.combined_fresh_interlocks()), (Some(all), Some(interlocks)));
        let silent = CommandGate::for_tests().0;
        silent.add_readiness_source(Readiness::default);
        silent.add_readiness_source(move || all);
        assert_eq!((silent.combined_readiness(), silent.combined_fresh_interlocks()), (None, Some(interlocks)));
        let other = Readiness {
            interlocks: Interlocks { is_door_closed: false, is_stop_set: true, ..interlocks },
            is_control_idle: false,
            ..all
        };
        gate.add_readiness_source(move || other);
        assert_eq!(gate.combined_readiness(), Some(other));
    }
}
