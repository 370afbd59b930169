//! Checks direction and distance of each axis against its command.

use super::jog::{self, JogError};
use super::question_text::{axis_unit, format_amount, format_signed_amount, visible_motion};
use super::{CheckEnd, CheckPart, MachineCheck, PartTimer};
use crate::setup::control_hints;
use machine::Axis;
use machine::record::machine::AxisSense;
use machine::record::question::{Jog, ObservedMotion, OperatorAnswer, OperatorQuestion};

/// Length of a jog, mm or degrees.
const JOG_LENGTH_MM_OR_DEG: f64 = 1.0;
/// Maximum difference of an observed distance from that of the jog, mm or degrees.
const OBSERVATION_TOLERANCE_MM_OR_DEG: f64 = 0.2;

/// Reason why no axis is jogged, and neither the hold nor the latch is checked.
pub(super) const PROBE_UNTESTED_REASON: &str = "the probe input was not tested, because no operator is present; without a working probe no contact \
    stops the machine";

/// Outcome of the check of one axis.
enum AxisOutcome {
    /// A finding is reported: ok, failed or not checked.
    Reported,
    /// No operator is present.
    NoOperator,
}

/// Jogs each axis except S. Without a tested probe or without an operator no axis is jogged.
pub(super) async fn check_axes(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    if !check.is_probe_working {
        check.report_unchecked(CheckPart::Axes, PROBE_UNTESTED_REASON);
        return Ok(());
    }
    let axes: Vec<Axis> = check.machine_file.machine.axes.keys().copied().collect();
    for axis in axes.iter().copied().filter(|axis| *axis != Axis::S) {
        if let AxisOutcome::NoOperator = check_axis(check, axis).await? {
            check.report_unchecked(CheckPart::Axes, "no operator is present to permit and to observe the jogs");
            return Ok(());
        }
    }
    if axes.contains(&Axis::S) {
        let why = "S: the spindle is not jogged; check by eye that its orientation agrees with [axes.S]";
        check.report_unchecked(CheckPart::Axes, why);
    }
    Ok(())
}

/// Jogs one axis and moves it back; after an unclear observation the jog is repeated. A jog is not moved back if the
/// operator does not report the motion, or if the control stops the jog: the check ends.
async fn check_axis(check: &mut MachineCheck<'_>, axis: Axis) -> Result<AxisOutcome, CheckEnd> {
    if check.axes_beyond_limits.contains(&axis) {
        let why = format!("{axis}: the limits differ from the limits of the control; correct them first");
        check.report_unchecked(CheckPart::Axes, why);
        return Ok(AxisOutcome::Reported);
    }
    let Some(jog) = plan_jog(check, axis) else { return Ok(AxisOutcome::Reported) };
    loop {
        let timer = PartTimer::start(CheckPart::Axes);
        // The operator is prompted only for a jog that is proven to be free of collision.
        if let Err(error) = jog::prove_planned_jog(check, &jog) {
            return report_failed_jog(check, &jog, timer, &error).await;
        }
        let stands = check.position.clone().unwrap_or_default();
        let expected = visible_motion(&check.machine_file.machine, &stands, &jog).unwrap_or_default();
        let may = OperatorQuestion::AllowJog { jog, visible_motion: expected.clone() };
        match check.prompt_operator(may).await? {
            OperatorAnswer::Yes => {}
            OperatorAnswer::NoOperator => return Ok(AxisOutcome::NoOperator),
            _ => {
                check.report_unchecked(CheckPart::Axes, format!("{axis}: the operator did not permit the jog"));
                return Ok(AxisOutcome::Reported);
            }
        }
        if let Err(error) = jog::run_jog(check, &jog).await {
            return report_failed_jog(check, &jog, timer, &error).await;
        }
        let OperatorAnswer::Motion(seen) =
            check.prompt_operator(OperatorQuestion::ObservedJog { jog, visible_motion: expected.clone() }).await?
        else {
            report_axis_not_returned(check, &jog, timer);
            return Err(CheckEnd::Unsafe);
        };
        if let Err(error) = jog::run_jog(check, &jog::reversed_jog(&jog)).await {
            return report_failed_jog(check, &jog, timer, &error).await;
        }
        if seen != ObservedMotion::Unclear {
            judge_observed_motion(check, &jog, seen, timer, &expected);
            return Ok(AxisOutcome::Reported);
        }
    }
}

/// Reports that the operator did not answer after the jog, and that the axis was not moved back.
fn report_axis_not_returned(check: &mut MachineCheck<'_>, jog: &Jog, timer: PartTimer) {
    let axis = jog.axis;
    let what = format!(
        "{axis} {}: the operator did not report the observed motion, so the axis was not moved back",
        format_signed_amount(jog)
    );
    let remedy = format!("check the machine; move {axis} back at the control, then repeat the check");
    check.report_failed(timer, what, remedy);
}

/// The jog of an axis away from its nearer limit; `None`, with a finding, if the axis cannot be jogged from its
/// position. `None` without a finding if the position is not known.
fn plan_jog(check: &mut MachineCheck<'_>, axis: Axis) -> Option<Jog> {
    let (timer, machine) = (PartTimer::start(CheckPart::Axes), &check.machine_file.machine);
    let spec = machine.axes.get(&axis)?;
    let stands = check.position.as_ref()?;
    let jog = jog::jog_away_from_limit(axis, JOG_LENGTH_MM_OR_DEG, spec, stands);
    if jog.is_none() {
        let here = axis.to_mm_or_deg(stands.get_or_zero(axis));
        let what = format!("{axis} is at {here:.3}, outside its travel from {} to {}", spec.min, spec.max);
        let remedy = format!(
            "home the machine; if it is homed already, correct min and max of [axes.{axis}] (machine coordinates)"
        );
        check.has_axis_fault = true;
        check.report_failed(timer, what, remedy);
    }
    jog
}

/// Reports a jog that was refused or that the control did not execute.
///
/// # Errors
/// `Unsafe` after every error except a failed proof, which moves nothing; or a stop was requested.
async fn report_failed_jog(
    check: &mut MachineCheck<'_>,
    jog: &Jog,
    timer: PartTimer,
    error: &JogError,
) -> Result<AxisOutcome, CheckEnd> {
    check.require_no_stop_request()?;
    check.has_axis_fault = true;
    let reported = if error.is_proof_failure() { None } else { describe_reported_motion(check, jog).await };
    let what = format!("{} {}: {error}{}", jog.axis, format_signed_amount(jog), reported.unwrap_or_default());
    check.report_failed(timer, what, error.remedy());
    if error.is_proof_failure() { Ok(AxisOutcome::Reported) } else { Err(CheckEnd::Unsafe) }
}

/// Reported motion since the jog, in words: the axis with the largest change. `None` if no position is known.
async fn describe_reported_motion(check: &MachineCheck<'_>, jog: &Jog) -> Option<String> {
    let (before, now) = (check.position.as_ref()?, check.controller().ok()?.read_snapshot().await.ok()?);
    let gone = |axis: Axis| -> Option<f64> { Some(axis.to_mm_or_deg(now.position.get(axis)? - before.get(axis)?)) };
    let moved = check.machine_file.machine.axes.keys().copied();
    let moved = moved.filter_map(|axis| Some((axis, gone(axis)?)));
    let (axis, by) = moved.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))?;
    if by.abs() < 1e-3 {
        return Some("; the control reports no motion".to_owned());
    }
    let of = if axis == jog.axis { "" } else { " instead" };
    Some(format!("; the control reports a motion of {axis} by {}{of}", format_amount(axis, format_args!("{by:+.3}"))))
}

/// Reports whether the observed motion agrees with the jog; otherwise `has_axis_fault` is set.
fn judge_observed_motion(
    check: &mut MachineCheck<'_>,
    jog: &Jog,
    observed: ObservedMotion,
    timer: PartTimer,
    expected: &str,
) {
    let (axis, by) = (jog.axis, format_signed_amount(jog));
    let observed = match observed {
        ObservedMotion::Distance(distance) if (distance - jog.by).abs() <= OBSERVATION_TOLERANCE_MM_OR_DEG => {
            ObservedMotion::AsAnnounced
        }
        ObservedMotion::Distance(distance) if (distance + jog.by).abs() <= OBSERVATION_TOLERANCE_MM_OR_DEG => {
            ObservedMotion::Opposite
        }
        ObservedMotion::Distance(0.0) => ObservedMotion::NoMotion,
        ObservedMotion::OtherAxis(other) if other == axis => ObservedMotion::AsAnnounced,
        other => other,
    };
    let (what, remedy) = match observed {
        ObservedMotion::AsAnnounced | ObservedMotion::Unclear => {
            return check.report_ok(timer, format!("{axis} {by}: {expected}, as expected"));
        }
        ObservedMotion::Opposite => (
            format!("{axis} {by}: the axis moved in the opposite direction: the sense of {axis} is wrong"),
            sense_remedy(axis, check.machine_file.machine.axes.get(&axis).map(|spec| spec.positive)),
        ),
        ObservedMotion::OtherAxis(other) => (
            format!("{axis} {by}: {other} moved instead: {axis} and {other} are swapped"),
            format!(
                "swap the motor cables of {axis} and {other}, or their order in the joint list of the \
                control; then repeat the check"
            ),
        ),
        ObservedMotion::NoMotion => (
            format!("{axis} {by}: the control reports the motion, but the operator saw no motion"),
            format!(
                "check that the drive of {axis} is enabled, its motor connected and its coupling tight, and \
                that its steps per {} are not far too low",
                axis_unit(axis)
            ),
        ),
        ObservedMotion::Distance(distance) => gain_fault_and_remedy(jog, distance),
    };
    check.has_axis_fault = true;
    check.report_failed(timer, what, remedy);
}

fn sense_remedy(axis: Axis, stated: Option<AxisSense>) -> String {
    if axis.is_linear() {
        return format!(
            "invert the direction of {axis} at the control ({}), or correct [machine] topology: an axis that \
            carries the table moves against the sign of its command, an axis that carries the spindle moves with it",
            control_hints(|control| control.axis_direction_hint)
        );
    }
    let other = if stated == Some(AxisSense::Reversed) { "iso" } else { "reversed" };
    format!("write positive = \"{other}\" in [axes.{axis}], or invert the direction of {axis} at the control")
}

/// Description and remedy of a wrong number of steps per unit. `observed_distance`: mm or degrees; the gain is this
/// distance divided by that of the jog.
fn gain_fault_and_remedy(jog: &Jog, observed_distance: f64) -> (String, String) {
    let (axis, unit, gain) = (jog.axis, axis_unit(jog.axis), (observed_distance / jog.by).abs());
    let is_inches = axis.is_linear() && (gain - 25.4).abs() < 1.5;
    let inches_hint = if is_inches { ": is the control set to inches?" } else { "" };
    // Rounded to a hundredth, the resolution of the eye.
    let rounded = (observed_distance * 100.0).round() / 100.0;
    let opposite_note = if rounded * jog.by < 0.0 { ", in the opposite direction" } else { "" };
    let what = format!(
        "{axis} was commanded by {} and moved by {}{opposite_note}: the gain of {axis} is {gain:.3}{inches_hint}",
        format_signed_amount(jog),
        format_amount(axis, format_args!("{rounded:+}"))
    );
    let remedy = format!(
        "divide the steps per {unit} of {axis} at the control by {gain:.3} ({}); for a more accurate value, \
        measure over a longer distance",
        control_hints(|control| control.steps_per_unit_hint)
    );
    (what, remedy)
}
