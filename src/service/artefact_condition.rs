//! Whether the certificate of the machine's artefact permits a start. The register may change, and a certificate may
//! expire, while the daemon runs.

use jiff::Zoned;

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

    /// Lets the gate refuse or accept starts according to the register, and logs a change.
    pub(super) fn update_artefact_condition(&self) {
        let failure = self.report_data_for_run().err().map(|error| format!("{error}; {}", error.remedy()));
        if self.gate.set_artefact_failure(failure.clone()) {
            match failure {
                Some(failure) => self.log.error(&format!("no cycle will be started: {failure}")),
                None => self.log.info("the register of artefacts permits runs"),
            }
        }
    }
}
