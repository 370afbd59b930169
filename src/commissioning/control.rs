//! Checks that the control's device information agrees with the machine file.

use super::machine_file_comparison::{MachineFileDifference, machine_file_differences};
use super::question_text::format_position;
use super::{CheckEnd, CheckPart, MachineCheck, PartTimer, links};
use devices::controllers::{ControllerError, DeviceInfo, MachineSnapshot, describe_unreadable_items};
use machine::Position;
use machine::record::question::{OperatorAnswer, OperatorQuestion};

/// Compares the device information of the control with the machine file and prepares the control. Ends the check with
/// `Unsafe` if a finding of the control forbids motion. Other differences, or a control that reports no device
/// information, are failed findings, and the check goes on.
pub(super) async fn check_control(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let timer = PartTimer::start(CheckPart::Control);
    let result = check.controller()?.identify_device().await;
    check.require_no_stop_request()?;
    let may_move = match result {
        Ok(info) => compare_device_info_and_permit_motion(check, info, timer),
        Err(error) => {
            // If the control cannot be prepared either, that error explains more.
            prepare_and_confirm_position(check).await?;
            let what = format!("the control does not report travel, speeds and axes: {error}");
            check.report_failed(timer, what, error.remedy());
            return Ok(());
        }
    };
    if may_move {
        return prepare_and_confirm_position(check).await;
    }
    // If the reported positions are wrong, even a small jog can move the machine to any position.
    prepare_and_report_position(check).await?;
    Err(CheckEnd::Unsafe)
}

/// Compares the control's device information with the machine file, and reports the differences and the remarks of the
/// control. Returns false if a remark forbids motion; differences do not.
fn compare_device_info_and_permit_motion(check: &mut MachineCheck<'_>, info: DeviceInfo, timer: PartTimer) -> bool {
    check.summary.control = Some(info.identity.clone());
    check.probe_polarity_hint.clone_from(&info.probe_inversion_hint);
    let differences = machine_file_differences(&check.machine_file.machine, &info);
    if differences.is_empty() && !info.axes.is_empty() {
        let reports_speeds = info.axes.values().any(|axis| axis.rapid_per_min.is_some());
        let agreement = if reports_speeds {
            "travel, speeds and axes agree with the machine file"
        } else {
            "the axes agree with the machine file; the control does not report travel and speeds"
        };
        check.report_ok(timer, format!("{}: {agreement}", info.identity));
    }
    for MachineFileDifference { axis_beyond_limits: beyond_limits, description: what, remedy } in differences {
        check.axes_beyond_limits.extend(beyond_limits);
        check.report_failed(timer, what, remedy);
    }
    let may_move = !info.findings.iter().any(|remark| remark.is_blocking);
    for remark in info.findings {
        if remark.is_blocking {
            check.report_failed(timer, remark.description, remark.remedy);
        } else {
            check.report_ok(timer, format!("{} ({})", remark.description, remark.remedy));
        }
    }
    may_move
}

/// Prepares the control; the first time, the operator compares its display with the reported position.
pub(super) async fn prepare_and_confirm_position(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let first = check.position.is_none();
    prepare_and_report_position(check).await?;
    if first && check.position.is_some() { confirm_displayed_position(check).await } else { Ok(()) }
}

/// State of the probe input and position. If the control does not report them, the check ends with a finding of the
/// part `probe`.
pub(super) async fn read_snapshot_for_probe_part(
    check: &mut MachineCheck<'_>,
    timer: PartTimer,
) -> Result<MachineSnapshot, CheckEnd> {
    let result = check.controller()?.read_snapshot().await;
    result.or_else(|error| check.end_with_fault(timer, error.to_string(), error.remedy()))
}

/// Prepares a retract while the probe input is closed; returns the position of all axes.
pub(super) async fn prepare_in_contact(check: &mut MachineCheck<'_>) -> Result<Position, CheckEnd> {
    let timer = PartTimer::start(CheckPart::Control);
    match check.controller()?.prepare_in_contact().await {
        Ok(prepared) => {
            check.transmission = Some(prepared.transmission);
            Ok(prepared.position)
        }
        Err(error) => {
            check.require_no_stop_request()?;
            links::end_with_link_fault(check, timer, &error).await
        }
    }
}

/// Prepares the control and reports its position. A probe input that is closed at the first preparation is no
/// failure here: the part `probe` checks it.
async fn prepare_and_report_position(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let timer = PartTimer::start(CheckPart::Control);
    match check.controller()?.prepare().await {
        Ok(prepared) => {
            let position = format_position(&prepared.position);
            let what = format!("ready at {position}; stopping method: {}", prepared.stop_description);
            check.summary.control = Some(prepared.identity);
            check.transmission = Some(prepared.transmission);
            check.report_ok(timer, what);
            let is_first = check.position.replace(prepared.position).is_none();
            let not_readable = describe_unreadable_items(&prepared.unreadable_items).filter(|_| is_first);
            if let Some(what) = not_readable {
                check.report_ok(timer, what);
            }
            Ok(())
        }
        Err(ControllerError::ProbeClosed) if check.position.is_none() => Ok(()),
        Err(ControllerError::NotReady { state, .. }) if check.is_reported_failed(&state) => {
            check.devices = None;
            Err(CheckEnd::Unsafe)
        }
        Err(error) => {
            check.require_no_stop_request()?;
            links::end_with_link_fault(check, timer, &error).await
        }
    }
}

/// Prompts the operator to compare the reported position with the display; the answer no ends the check, without an
/// operator the comparison is skipped. Only an operator can detect a wrong scale or a wrong order of registers that
/// leaves all axes within their travel; an absolute move of one millimetre could then go anywhere.
async fn confirm_displayed_position(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let timer = PartTimer::start(CheckPart::Control);
    let position = check.position.clone().unwrap_or_default();
    let reported = format_position(&position);
    match check.prompt_operator(OperatorQuestion::DisplayedPosition(position)).await? {
        OperatorAnswer::Yes => check.report_ok(timer, "the display of the control shows the same position"),
        OperatorAnswer::No => {
            let what = format!("the display of the control does not show the reported position {reported}");
            let remedy = "the check does not move the machine in this state. Modbus: compare `type`, \
                `order` and `scale` of the position registers with the program of the control. Other \
                controls: check that the units are millimetres and that the display shows machine coordinates";
            return check.end_with_fault(timer, what, remedy);
        }
        _ => {
            let what = "no operator is present to compare the position with the display of the control";
            check.report_unchecked(CheckPart::Control, what);
        }
    }
    Ok(())
}
