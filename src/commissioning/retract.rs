//! Retract out of contact. After an unexpected contact the stylus stays deflected, and no control executes a
//! probing move while its probe input is closed. The operator names one linear axis and a direction, the
//! machine makes one small feed move, and the probe is read again.

use super::jog::{self, JogError, RETRACT_INCREMENT_MM};
use super::question_text::visible_motion;
use super::{CheckEnd, CheckPart, MachineCheck, PartTimer, control};
use devices::controllers::ControllerError;
use machine::record::question::{AxisDirection, Jog, OperatorAnswer, OperatorQuestion};
use machine::{Axis, Position};

/// Maximum number of the operator's directions in one check, with those that caused no motion.
const MAX_RETRACT_ANSWERS: usize = 20;

/// Prompts for a direction and moves by one increment, until the probe input is open or the operator leaves it closed.
///
/// # Errors
/// The stylus was retracted out of contact, or is still in contact after `MAX_RETRACT_ANSWERS` answers; a stop was
/// requested, or the control cannot continue.
pub(super) async fn retract_from_contact(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let timer = PartTimer::start(CheckPart::Probe);
    let mut last_result = None;
    for answers in 0..=MAX_RETRACT_ANSWERS {
        let snapshot = control::read_snapshot_for_probe_part(check, timer).await?;
        if !snapshot.is_probe_closed {
            return if answers > 0 { Err(report_released_stylus(check, timer)) } else { Ok(()) };
        }
        if answers == MAX_RETRACT_ANSWERS {
            break;
        }
        let visible_motions = visible_motions(check, &snapshot.position);
        let question = OperatorQuestion::RetractDirection { position: snapshot.position, visible_motions, last_result };
        let OperatorAnswer::Retract(direction) = check.prompt_operator(question).await? else {
            return Ok(());
        };
        last_result = Some(retract_by_one_increment(check, direction).await?);
    }
    let what = format!("the probe still reads closed after {MAX_RETRACT_ANSWERS} answers of the operator");
    let remedy = "check the machine and the stylus; retract with the jog keys of the control";
    check.report_failed(timer, what, remedy);
    Err(CheckEnd::Unsafe)
}

/// Reports that the stylus is out of contact, and ends the check: jogs are proven from the position that the control
/// reports, and after a contact at an unexpected position the reported position may be wrong.
fn report_released_stylus(check: &mut MachineCheck<'_>, timer: PartTimer) -> CheckEnd {
    let what = "the stylus is out of contact and the probe reads open; the position of the machine may differ from \
        the display of the control";
    let remedy = "jog the machine clear at the control, find the body that the stylus touched, and home the \
        machine if its position may be wrong; then repeat the check";
    check.report_failed(timer, what, remedy);
    CheckEnd::Unsafe
}

/// Visible motion of each linear axis at a positive command.
fn visible_motions(check: &MachineCheck<'_>, position: &Position) -> Vec<String> {
    let machine = &check.machine_file.machine;
    let motions = Axis::LINEAR.into_iter().filter_map(|axis| {
        let jog = Jog { axis, by: RETRACT_INCREMENT_MM, feed_per_min: 0.0 };
        Some(format!("{axis}+: {}", visible_motion(machine, position, &jog)?))
    });
    motions.collect()
}

/// Moves by one retract increment and describes the result. A move that cannot be proven is not executed.
async fn retract_by_one_increment(check: &mut MachineCheck<'_>, direction: AxisDirection) -> Result<String, CheckEnd> {
    let timer = PartTimer::start(CheckPart::Probe);
    let position = control::prepare_in_contact(check).await?;
    match jog::run_retract_increment(check, &position, direction).await {
        Ok(()) => Ok(format!("{direction}: moved by {RETRACT_INCREMENT_MM} mm")),
        // The usual outcome of every increment but the last.
        Err(JogError::Control(ControllerError::ProbeStillClosed { .. })) => {
            Ok(format!("{direction}: moved by {RETRACT_INCREMENT_MM} mm; the probe still reads closed"))
        }
        Err(error) if error.is_proof_failure() => Ok(format!("{direction}: no motion: {error}; {}", error.remedy())),
        Err(error) => check.end_with_fault(timer, format!("{direction}: {error}"), error.remedy()),
    }
}
