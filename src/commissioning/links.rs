//! Checks that each device answers. If the answer makes no sense, the driver of the control diagnoses the link.

use std::time::Instant;

use super::{Check, Ended, Part, Verdict};
use crate::setup::SetupError;
use crate::setup::machine_file::Control;
use devices::controllers::{ControllerError, Leave};
use machine::record::question::{Answer, Question};

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    let error = match check.open(check.pace).await {
        Ok(()) => {
            let at = match &check.file.controller.control {
                Control::Real(control) => control.at(),
                Control::Simulated(_) => "simulated".to_owned(),
            };
            check.well(Part::Links, since, format!("the link of the control is open: {at}"));
            return check.go_on();
        }
        Err(SetupError::Controller(error)) => error,
        Err(SetupError::Link(error)) => error.into(),
        Err(error) => {
            check.failed(Part::Links, since, error.to_string(), error.remedy().unwrap_or_default());
            return Err(Ended::Unsafe);
        }
    };
    why(check, Part::Links, since, &error).await?;
    Err(Ended::Unsafe)
}

/// Reports the failure and its possible causes; closes the link.
pub(super) async fn why(
    check: &mut Check<'_>,
    part: Part,
    since: Instant,
    error: &ControllerError,
) -> Result<(), Ended> {
    check.failed(part, since, error.to_string(), error.remedy());
    check.devices = None;
    let Control::Real(control) = &check.file.controller.control else { return check.go_on() };
    let machine = &check.file.machine;
    let mut found = control.diagnose(machine, error, Leave::Listen).await;
    let more = found.is_empty() || found.iter().any(|suspicion| suspicion.vague);
    if more && check.ask(may_ask()).await? == Answer::Yes {
        found = control.diagnose(machine, error, Leave::Ask).await;
    }
    for suspicion in found {
        let (what, remedy) = (suspicion.to_string(), suspicion.remedy);
        check.found(part, Verdict::Failed, since, what, Some(remedy));
    }
    check.go_on()
}

fn may_ask() -> Question {
    let what = "It is not clear why. The device can be asked at other speeds, in the languages of other \
                controls and under other unit numbers. These are no commands to them; if another device \
                hangs there, nobody knows what it makes of it. May it be asked so?";
    Question::May { what: what.to_owned() }
}
