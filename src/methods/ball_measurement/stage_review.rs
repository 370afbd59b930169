//! Review of the readings of a stage: accept, measure again, or hold the run.

use nalgebra::Vector3;

use super::found_balls::{BallReadings, FoundBalls, group_readings_by_measurement};
use super::setup::{MeasurementSetup, describe_rotary_axes_in_degrees};
use super::touch_label::MeasurementPurpose;
use crate::MethodRefusal;
use machine::Axis;
use machine::record::plan::{Stage, StepKind};
use machine::record::reading::Reading;
use planning::{BallCheckError, BallLimits};

/// Checks the measurements of the `last` stage. Returns the steps of those that must be measured again, and the
/// number of that repeat (from 1); `None`: no repeat.
///
/// # Errors
/// A measurement has a fault in its repeat, or a found ball is too far from its expected position. If the run was
/// stopped and resumed since the measurement, it is measured again instead.
pub fn review_stage(
    setup: &MeasurementSetup<'_>,
    last: &Stage,
    readings: &[Reading],
) -> Result<Option<(Vec<u32>, u32)>, MethodRefusal> {
    let all = group_readings_by_measurement(setup, readings);
    let of_stage = |measurement: &&BallReadings<'_>| measurement.steps.iter().any(|step| last.steps.contains(&step.id));
    let mut again = Vec::new();
    for measurement in all.iter().filter(of_stage) {
        // After a stop the operator has checked the ball and may have cleaned it.
        let newest_s = measurement.readings.iter().map(|reading| reading.t_s).fold(f64::MIN, f64::max);
        let is_resumed_since = setup.plan.interruption_times_s.last().is_some_and(|gap_s| *gap_s >= newest_s);
        let doubt = match find_measurement_fault(setup, measurement) {
            Some(fault) if last.repeat > 0 => Some(repeated_fault_refusal(setup, &fault)),
            Some(_) => None,
            None => match check_ball_position(setup, &all, measurement) {
                Ok(()) => continue,
                Err(elsewhere) => Some(elsewhere),
            },
        };
        match doubt {
            Some(doubt) if !is_resumed_since => return Err(doubt),
            _ => again.extend(measurement.steps.iter().map(|step| step.id)),
        }
    }
    Ok((!again.is_empty()).then_some((again, last.repeat + 1)))
}

/// Fault of the sphere fit, or, for slow touches only, of form or diameter. Fast touches trigger late, and the first
/// ones are not along the normals: they need only lie on a sphere. `None` also if touches are missing.
fn find_measurement_fault(setup: &MeasurementSetup<'_>, measurement: &BallReadings<'_>) -> Option<BallCheckError> {
    let measured = match measurement.fit_ball(setup)? {
        Ok(measured) => measured,
        Err(doubt) => return Some(doubt),
    };
    let stated_mm = 2.0 * setup.balls.balls.get(measurement.ball_index)?.radius_mm;
    let limits = BallLimits {
        max_form_mm: setup.touch_settings.form_hold_limit_mm,
        max_diameter_deviation_mm: setup.touch_settings.diameter_deviation_hold_limit_mm,
    };
    let slow = measurement.label.purpose != MeasurementPurpose::Find;
    slow.then(|| measured.check_form_and_diameter(&measurement.label.ball, stated_mm, &limits).err()).flatten()
}

fn repeated_fault_refusal(setup: &MeasurementSetup<'_>, fault: &BallCheckError) -> MethodRefusal {
    MethodRefusal {
        reason: format!("the repeated measurement was rejected too: {fault}"),
        remedy: format!(
            "clean and tighten the ball and the stylus, and compare both radii with the machine file, {}. \
            The limits are form_limit_um and diameter_limit_um in [method.{}]",
            continuation_advice(setup),
            setup.method
        ),
    }
}

/// Advice how to continue. A run can be resumed only after its first reference measurement.
pub fn continuation_advice(setup: &MeasurementSetup<'_>) -> &'static str {
    match setup.plan.steps.iter().any(|step| step.kind == StepKind::Reference) {
        true => "then resume the run, which measures the ball again",
        false => "then start a new run",
    }
}

fn describe_measurement(setup: &MeasurementSetup<'_>, measurement: &BallReadings<'_>) -> String {
    let ball = setup.balls.balls.get(measurement.ball_index).map_or("", |ball| &ball.id);
    let at = measurement.steps.first().map(|step| step.from.filter_axes(|axis: Axis| !axis.is_linear()));
    format!("ball {ball} at {}", describe_rotary_axes_in_degrees(&at.unwrap_or_default()))
}

/// For a search (`Find`) only: checks that the ball is within the position uncertainty of its expected position.
/// Other measurements pass.
fn check_ball_position(
    setup: &MeasurementSetup<'_>,
    all: &[BallReadings<'_>],
    measurement: &BallReadings<'_>,
) -> Result<(), MethodRefusal> {
    let (Some(Ok(measured)), Some(ball)) = (measurement.fit_ball(setup), setup.balls.balls.get(measurement.ball_index))
    else {
        return Ok(());
    };
    if measurement.label.purpose != MeasurementPurpose::Find {
        return Ok(());
    }
    // When a stage is planned, its own results are not yet known.
    let stage = |of: &BallReadings<'_>| (of.label.purpose, of.label.indexation_index);
    let before = all.iter().take_while(|other| stage(other) != stage(measurement));
    let known = FoundBalls::from_measurements(setup, before);
    let stated = Vector3::from(ball.centre_mm);
    let expected = known.expected_centre(setup, measurement.ball_index, measurement.label.indexation_index as usize);
    let (away, limit) =
        (measured.centre_in_table_mm.metric_distance(&expected), known.expected_centre_tolerance_mm(setup));
    if away <= limit {
        return Ok(());
    }
    let place = describe_measurement(setup, measurement);
    if expected == stated {
        return Err(MethodRefusal {
            reason: format!(
                "{place} was found {away:.3} mm from the position in [artefact], more than uncertainty_mm = \
                {limit}"
            ),
            remedy: format!(
                "check centre_mm of the ball and the position of the artefact on the table, {}",
                continuation_advice(setup)
            ),
        });
    }
    Err(MethodRefusal {
        reason: format!(
            "{place} was found {away:.3} mm from the position expected from earlier indexations, more than \
            {limit} mm: the ball has moved, or point_mm of a rotary axis is wrong by this distance"
        ),
        remedy: format!(
            "clean the ball, and put the ball back if it has moved, {}. After a change of point_mm, \
            standoff_mm or uncertainty_mm start a new run",
            continuation_advice(setup)
        ),
    })
}
