//! Checks that the control's device information agrees with the machine file.

use std::time::Instant;

use super::question_text::position;
use super::{Check, Ended, Part, compare::Difference, compare::differences, links};
use devices::controllers::{ControllerError, DeviceInfo, Look, describe_not_readable};
use machine::Position;
use machine::record::question::{Answer, Question};

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    let introduced = check.controller()?.introduce().await;
    check.go_on()?;
    let may_move = match introduced {
        Ok(says) => compare(check, says, since),
        Err(error) => {
            // If the control cannot be prepared either, that error explains more.
            prepare(check).await?;
            let what = format!("travel, speeds and axes: the control does not tell them: {error}");
            check.failed(Part::Control, since, what, error.remedy());
            return Ok(());
        }
    };
    if may_move {
        return prepare(check).await;
    }
    // If its positions are in doubt, a small jog may go anywhere.
    ready(check).await?;
    Err(Ended::Unsafe)
}

/// Compares its device information with the machine file; returns whether it may move.
fn compare(check: &mut Check<'_>, says: DeviceInfo, since: Instant) -> bool {
    check.summary.control = Some(says.identity.clone());
    check.polarity.clone_from(&says.polarity);
    let differs = differences(&check.file.machine, &says);
    if differs.is_empty() && !says.axes.is_empty() {
        let told = says.axes.values().any(|axis| axis.rapid_per_min.is_some());
        let suits = if told {
            "travel, speeds and axes suit the machine file"
        } else {
            "axes suit the machine file; their travel and speeds it does not tell"
        };
        let what = format!("{}: {suits}", says.identity);
        check.well(Part::Control, since, what);
    }
    for Difference { beyond_limits, what, remedy } in differs {
        check.beyond_limits.extend(beyond_limits);
        check.failed(Part::Control, since, what, remedy);
    }
    let may_move = !says.remarks.iter().any(|remark| remark.hinders);
    for remark in says.remarks {
        if remark.hinders {
            check.failed(Part::Control, since, remark.what, remark.remedy);
        } else {
            check.well(Part::Control, since, format!("{} ({})", remark.what, remark.remedy));
        }
    }
    may_move
}

/// Prepares the control; the first time, the operator compares its display with the reported position.
pub(super) async fn prepare(check: &mut Check<'_>) -> Result<(), Ended> {
    let first = check.stands.is_none();
    ready(check).await?;
    if first && check.stands.is_some() { display(check).await } else { Ok(()) }
}

/// Probe and position, for the part `probe`. A control that does not report them is no fault of the probe.
pub(super) async fn status(check: &mut Check<'_>, since: Instant) -> Result<Look, Ended> {
    match check.controller()?.look().await {
        Ok(look) => Ok(look),
        Err(error) => {
            check.go_on()?;
            check.failed(Part::Probe, since, error.to_string(), error.remedy());
            Err(Ended::Unsafe)
        }
    }
}

/// Prepares a retract while the probe input is closed; returns the position of all axes.
pub(super) async fn prepare_in_contact(check: &mut Check<'_>) -> Result<Position, Ended> {
    let since = Instant::now();
    match check.controller()?.prepare_in_contact().await {
        Ok(prepared) => {
            check.transmission = Some(prepared.transmission);
            Ok(prepared.stands)
        }
        Err(error) => {
            check.go_on()?;
            links::why(check, Part::Control, since, &error).await?;
            Err(Ended::Unsafe)
        }
    }
}

/// Prepares the control. A closed probe input is left to the next part.
async fn ready(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    match check.controller()?.prepare().await {
        Ok(prepared) => {
            let stands = position(&prepared.stands);
            let what = format!("ready; it stands at {stands}; how it stops: {}", prepared.stop);
            check.summary.control = Some(prepared.identity);
            check.transmission = Some(prepared.transmission);
            check.well(Part::Control, since, what);
            let is_first = check.stands.replace(prepared.stands).is_none();
            let not_readable = describe_not_readable(&prepared.not_readable).filter(|_| is_first);
            if let Some(what) = not_readable {
                check.well(Part::Control, since, what);
            }
            Ok(())
        }
        Err(ControllerError::ProbeClosed) if check.stands.is_none() => Ok(()),
        Err(ControllerError::NotReady { state, .. }) if check.has_failed(&state) => {
            check.devices = None;
            Err(Ended::Unsafe)
        }
        Err(error) => {
            check.go_on()?;
            links::why(check, Part::Control, since, &error).await?;
            Err(Ended::Unsafe)
        }
    }
}

/// Only an operator can detect a wrong scale or a wrong order of registers that leaves all axes within their
/// travel; an absolute move of one millimetre could then go anywhere.
async fn display(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    let stands = check.stands.clone().unwrap_or_default();
    let told = position(&stands);
    match check.ask(Question::Shows(stands)).await? {
        Answer::Yes => check.well(Part::Control, since, "its own display shows the same position"),
        Answer::No => {
            let what = format!("its own display shows another position than {told}");
            let remedy = "nothing moves like this. Registers: compare `type`, `order` and `scale` of the \
                          positions with the control's program. Otherwise: is it in millimetres, and does \
                          the display show machine coordinates?";
            check.failed(Part::Control, since, what, remedy);
            return Err(Ended::Unsafe);
        }
        _ => {
            let what = "nobody is there to compare the position with the control's display";
            check.not_looked_at(Part::Control, what);
        }
    }
    Ok(())
}
