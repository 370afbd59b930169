//! Retract out of contact. After an unexpected contact the stylus stays deflected, and no control executes a
//! probing move while its probe input is closed. The operator names one linear axis and a direction, the
//! machine makes one small feed move, and the probe is read again.

use std::time::Instant;

use super::jog::{self, JogError, RETRACT_MM};
use super::question_text::look_for;
use super::{Check, Ended, Part, control};
use devices::controllers::ControllerError;
use machine::record::question::{Answer, AxisDirection, Jog, Question};
use machine::{Axis, Position};

/// Maximum number of answers in one check.
const MAX_ANSWERS: usize = 20;

/// Asks for a direction and makes a step, until the probe input is open or the operator leaves it closed.
///
/// # Errors
/// The stylus was retracted out of contact, a stop was requested, or the control cannot continue.
pub(super) async fn out_of_contact(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    let mut last_result = None;
    for answers in 0..=MAX_ANSWERS {
        let look = control::status(check, since).await?;
        if !look.probe_closed {
            return if answers > 0 { Err(freed(check, since)) } else { Ok(()) };
        }
        if answers == MAX_ANSWERS {
            break;
        }
        let look_for = visible_motions(check, &look.stands);
        let question = Question::RetractDirection { position: look.stands, look_for, last_result };
        let Answer::Retract(direction) = check.ask(question).await? else { return Ok(()) };
        last_result = Some(step(check, direction).await?);
    }
    let what = format!("the probe still reads closed after {MAX_ANSWERS} answers");
    let remedy = "look at the machine and the stylus; retract by hand at the control";
    check.failed(Part::Probe, since, what, remedy);
    Err(Ended::Unsafe)
}

/// Ends the check: jogs are proven from the position that the control reports, but the stylus met something at
/// an unexpected place.
fn freed(check: &mut Check<'_>, since: Instant) -> Ended {
    let what =
        "out of contact: the probe reads open; the machine may not stand where its control shows";
    let remedy = "jog it clear at the control, find out what the stylus met, home it if its position may be \
                  wrong; then check again";
    check.failed(Part::Probe, since, what, remedy);
    Ended::Unsafe
}

/// Visible motion of each linear axis at a positive command.
fn visible_motions(check: &Check<'_>, position: &Position) -> Vec<String> {
    let machine = &check.file.machine;
    let motions = Axis::LINEAR.into_iter().filter_map(|axis| {
        let jog = Jog { axis, by: RETRACT_MM, feed_per_min: 0.0 };
        Some(format!("{axis}+: {}", look_for(machine, position, &jog)?))
    });
    motions.collect()
}

/// Makes one step and describes its result. A step without a proof is not made.
async fn step(check: &mut Check<'_>, direction: AxisDirection) -> Result<String, Ended> {
    let since = Instant::now();
    let position = control::prepare_in_contact(check).await?;
    match jog::retract(check, &position, direction).await {
        Ok(()) => Ok(format!("{direction}: moved by {RETRACT_MM} mm")),
        // The usual outcome of every step but the last.
        Err(JogError::Control(ControllerError::StillTripped { .. })) => {
            Ok(format!("{direction}: moved by {RETRACT_MM} mm; the probe still reads closed"))
        }
        Err(error) if error.is_harmless() => {
            Ok(format!("{direction}: nothing has moved: {error}; {}", error.remedy()))
        }
        Err(error) => {
            check.go_on()?;
            check.failed(Part::Probe, since, format!("{direction}: {error}"), error.remedy());
            Err(Ended::Unsafe)
        }
    }
}
