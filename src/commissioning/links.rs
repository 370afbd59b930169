//! Checks that the control answers. If it does not, the driver of the control diagnoses the link.

use super::{CheckEnd, CheckPart, MachineCheck, PartTimer};
use crate::setup::SetupError;
use crate::setup::machine_file::ControlConfig;
use devices::controllers::{ConnectionDiagnosisRequest, ControllerError, DiagnosisMode};
use machine::record::question::{OperatorAnswer, OperatorQuestion};

pub(super) async fn check_links(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let timer = PartTimer::start(CheckPart::Links);
    let error = match check.open_devices(check.pace).await {
        Ok(()) => {
            let at = match &check.machine_file.controller_section.control {
                ControlConfig::Real(control) => control.describe_address(),
                ControlConfig::Simulated(_) => "simulated".to_owned(),
            };
            check.report_ok(timer, format!("the link to the control is open: {at}"));
            return check.require_no_stop_request();
        }
        Err(SetupError::Controller(error)) => error,
        Err(SetupError::Link(error)) => error.into(),
        Err(error) => {
            check.report_failed(timer, error.to_string(), error.remedy().unwrap_or_default());
            return Err(CheckEnd::Unsafe);
        }
    };
    end_with_link_fault(check, timer, &error).await
}

/// Reports `error` and its possible causes, closes the link and returns the end of the check. If the cause is
/// unclear and the operator permits the search, other baud rates and protocols are searched too.
pub(super) async fn end_with_link_fault<T>(
    check: &mut MachineCheck<'_>,
    timer: PartTimer,
    error: &ControllerError,
) -> Result<T, CheckEnd> {
    check.report_failed(timer, error.to_string(), error.remedy());
    check.devices = None;
    if let ControlConfig::Real(control) = &check.machine_file.controller_section.control {
        let machine = &check.machine_file.machine;
        let request = ConnectionDiagnosisRequest { machine, failure: error, mode: DiagnosisMode::ConfiguredSettings };
        let mut diagnoses = control.diagnose_connection(request).await;
        let is_unclear =
            diagnoses.is_empty() || diagnoses.iter().any(|diagnosis| diagnosis.needs_other_settings_search);
        if is_unclear && check.prompt_operator(active_diagnosis_question()).await? == OperatorAnswer::Yes {
            diagnoses = control
                .diagnose_connection(ConnectionDiagnosisRequest { mode: DiagnosisMode::OtherSettings, ..request })
                .await;
        }
        for diagnosis in diagnoses {
            check.report_failed(timer, diagnosis.to_string(), diagnosis.remedy);
        }
    }
    check.require_no_stop_request()?;
    Err(CheckEnd::Unsafe)
}

fn active_diagnosis_question() -> OperatorQuestion {
    let what = "The cause is not clear. The check can send requests at other baud rates, with the protocols \
        of other controls and to other unit identifiers. These requests are not commands to a control, but \
        another device on the link may misinterpret them. Make sure that nothing can move. Send the requests?";
    OperatorQuestion::AllowAction { action: what.to_owned() }
}
