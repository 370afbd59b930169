//! Checks that each device answers. If the answer makes no sense, the driver of the control diagnoses the link.

use std::time::Instant;

use super::{Check, CheckEnd, CheckPart, Verdict};
use crate::setup::SetupError;
use crate::setup::machine_file::Control;
use devices::controllers::{ControllerError, DiagnosisMode, DiagnosisRequest};
use machine::record::question::{Answer, Question};

pub(super) async fn check_links(check: &mut Check<'_>) -> Result<(), CheckEnd> {
    let since = Instant::now();
    let error = match check.open_devices(check.pace).await {
        Ok(()) => {
            let at = match &check.file.controller.control {
                Control::Real(control) => control.describe_address(),
                Control::Simulated(_) => "simulated".to_owned(),
            };
            check.report_ok(CheckPart::Links, since, format!("the link to the control is open: {at}"));
            return check.check_stop();
        }
        Err(SetupError::Controller(error)) => error,
        Err(SetupError::Link(error)) => error.into(),
        Err(error) => {
            check.report_failed(CheckPart::Links, since, error.to_string(), error.remedy().unwrap_or_default());
            return Err(CheckEnd::Unsafe);
        }
    };
    report_link_fault(check, CheckPart::Links, since, &error).await?;
    Err(CheckEnd::Unsafe)
}

/// Reports the failure and its possible causes; closes the link.
pub(super) async fn report_link_fault(
    check: &mut Check<'_>,
    part: CheckPart,
    since: Instant,
    error: &ControllerError,
) -> Result<(), CheckEnd> {
    check.report_failed(part, since, error.to_string(), error.remedy());
    check.devices = None;
    let Control::Real(control) = &check.file.controller.control else { return check.check_stop() };
    let request = DiagnosisRequest { machine: &check.file.machine, failure: error, mode: DiagnosisMode::Passive };
    let mut found = control.diagnose(request).await;
    let more = found.is_empty() || found.iter().any(|suspicion| suspicion.needs_active_search);
    if more && check.prompt_operator(diagnosis_question()).await? == Answer::Yes {
        found = control.diagnose(DiagnosisRequest { mode: DiagnosisMode::Active, ..request }).await;
    }
    for suspicion in found {
        let (what, remedy) = (suspicion.to_string(), suspicion.remedy);
        check.add_finding(part, Verdict::Failed, since, what, Some(remedy));
    }
    check.check_stop()
}

fn diagnosis_question() -> Question {
    let what = "The cause is not clear. The check can send requests at other baud rates, with the protocols \
        of other controls and to other unit identifiers. These requests are not commands to a control, but \
        another device on the link may misinterpret them. Make sure that nothing can move. Send the \
        requests?";
    Question::AllowAction { action: what.to_owned() }
}
