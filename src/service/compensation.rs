//! Compensation requested on the web page: a person decides, and the worker, which holds the lock, executes this.

use std::thread;

use super::command_gate::CommandGate;
use super::machine_state::{Refusal, ServiceState};
use super::worker::MachineWorker;
use super::worker_command::{CompensationJob, CompensationResultReceiver, WorkerCommand};
use crate::compensation::{CompensationError, MachineCompensation};
use crate::store::{Journal, MachineLock};

impl CommandGate {
    /// Lets the worker read, write or restore values of the control, as a person requested; `decide` is the work, and
    /// the receiver gets its result. `what`: name of the command in the log. `target`: key of `[compensation]`, if
    /// there are several.
    ///
    /// # Errors
    /// The machine does not wait for a start, or a command is in progress; the refusal is also in the machine state and
    /// in the log.
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
    /// Executes the job while the worker's thread waits: it has no other task while the machine waits for a start. The
    /// command ends before the result is sent. Without the machine's lock or after a panic, no result is sent.
    pub(super) fn execute_compensation(&self, job: CompensationJob, journal: &Journal) {
        let mut send_result = None;
        if let Some(lock) = &self.machine_lock {
            // Journal writes block, and a thread of an async runtime must not block.
            let executed = thread::scope(|scope| {
                let execute = || job.execute(&self.machine_file, journal, lock);
                thread::Builder::new()
                    .name("compensation".to_owned())
                    .spawn_scoped(scope, execute)
                    .map(|thread| thread.join())
            });
            match executed {
                Ok(Ok(send)) => send_result = Some(send),
                Ok(Err(_)) => self.log.error("the compensation ended by a program error: read its state on the page"),
                Err(error) => {
                    self.log.error(&format!("the compensation is not executed: no thread can be started: {error}"));
                }
            }
        }
        self.gate.finish_command(ServiceState::Waiting);
        if let Some(send) = send_result {
            send();
        }
    }
}
