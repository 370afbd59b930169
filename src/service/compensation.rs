//! Compensation at the page: a person's decision, executed by the worker, which holds the machine's lock.

use std::thread;

use super::command_gate::CommandGate;
use super::machine_state::{Refusal, ServiceState};
use super::worker::MachineWorker;
use super::worker_command::{CompensationJob, CompensationResultReceiver, WorkerCommand};
use crate::compensation::{CompensationError, MachineCompensation};
use crate::store::{Journal, MachineLock};

impl CommandGate {
    /// Writes or restores values of the control, as a person decided. `what`: for the log.
    ///
    /// # Errors
    /// The machine does not wait for a start; the refusal is also in the machine state and in the log.
    pub fn compensate<T: Send + 'static>(
        &self,
        what: &str,
        target: Option<String>,
        decide: impl FnOnce(&MachineCompensation<'_>, &MachineLock) -> Result<T, CompensationError> + Send + 'static,
    ) -> Result<CompensationResultReceiver<T>, Refusal> {
        let inner = self.lock_state();
        let judged = inner.machine_state.state.check_waiting();
        let (job, result) = CompensationJob::new(target, decide);
        drop(self.send_command(inner, judged, WorkerCommand::Compensate(job), what)?);
        Ok(result)
    }
}

impl MachineWorker {
    /// Blocks this thread, on which nothing else happens while the machine waits.
    pub(super) fn execute_compensation(&self, job: CompensationJob, journal: &Journal) {
        if let Some(lock) = &self.machine_lock {
            // The writes to the journal block, which the thread of a runtime must not do.
            let executed = thread::scope(|scope| {
                let execute = || job.execute(&self.machine_file, journal, lock);
                thread::Builder::new()
                    .name("compensation".to_owned())
                    .spawn_scoped(scope, execute)
                    .map(|thread| thread.join())
            });
            match executed {
                Ok(Ok(())) => {}
                Ok(Err(_)) => {
                    self.log.error("the compensation ended by a fault of the program: read its state on the page")
                }
                Err(error) => {
                    self.log.error(&format!("the compensation is not executed: no thread can be started: {error}"));
                }
            }
        }
        self.gate.finish_command(ServiceState::Waiting);
    }
}
