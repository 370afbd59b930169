//! Data that the report of a run prints: which are missing, and whether the certificate of the artefact is valid.

use jiff::Zoned;

use super::finding::CheckPart;
use super::{MachineCheck, PartTimer};
use crate::setup::machine_file::ControlConfig;

impl MachineCheck<'_> {
    /// Reports an expired certificate and missing keys; neither makes the machine unsafe. A simulated machine may lack
    /// the keys.
    pub(super) fn check_report_data(&mut self) {
        let timer = PartTimer::start(CheckPart::Report);
        let data = &self.machine_file.report_data;
        let (missing, today) = (data.missing_keys().join(", "), Zoned::now().date().to_string());
        if data.is_certificate_expired(&today) {
            let due = data.certificate_due.clone().unwrap_or_default();
            let what = format!("the certificate of the artefact was valid until {due}");
            let remedy = "calibrate the artefact, then enter the new certificate: with `trued artefact add`, or in \
                          [report] if the artefact is not in the register";
            return self.report_failed(timer, what, remedy);
        }
        if let Some(due) = &data.certificate_due {
            let what = format!("the certificate of the artefact is valid until {due}");
            self.report_ok(timer, what);
        }
        let is_simulated = matches!(self.machine_file.controller_section.control, ControlConfig::Simulated(_));
        if !is_simulated && !missing.is_empty() {
            self.report_unchecked(
                CheckPart::Report,
                format!("the report will print \"not stated\" for these keys of [report]: {missing}"),
            );
        }
    }
}
