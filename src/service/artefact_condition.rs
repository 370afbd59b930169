//! Whether the certificate of the machine's artefact permits a start. The register may change, and a certificate may
//! expire, while the daemon runs.

use jiff::Zoned;

use super::ServeError;
use super::worker::MachineWorker;
use crate::store::{ArtefactRegister, ArtefactRegisterError};
use machine::record::report_data::ReportData;

impl MachineWorker {
    /// Data of the report for a run that begins now.
    ///
    /// # Errors
    /// The certificate of a registered artefact has expired, or the machine file contradicts the register.
    pub(super) fn report_data_for_run(&self) -> Result<ReportData, ArtefactRegisterError> {
        let register = ArtefactRegister::in_folder(&self.state_dir);
        register.report_data_for_run(&self.machine_file.report_data, Zoned::now().date())
    }

    /// Checks that the certificate of the artefact permits a run now.
    ///
    /// # Errors
    /// As [`Self::report_data_for_run`].
    pub fn check_artefact(&self) -> Result<(), ServeError> {
        Ok(self.report_data_for_run().map(drop)?)
    }

    /// Lets the gate refuse or accept starts according to the register, and logs a change.
    pub(super) fn update_artefact_condition(&self) {
        let error = self.report_data_for_run().err();
        let is_refused = error.is_some();
        let was_refused = std::mem::replace(&mut self.gate.lock_state().is_artefact_refused, is_refused);
        match error {
            Some(error) if !was_refused => {
                self.log.error(&format!("no cycle will be started: {error}; {}", error.remedy()));
            }
            None if was_refused => self.log.info("the certificate of the artefact is valid; a cycle may start"),
            _ => {}
        }
    }
}
