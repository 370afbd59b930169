//! Sequence of stages: the prompt and the calibration of the sensors, then the turns.

use super::identify::{solve_equations, weighted_equations};
use super::observe::{BACKWARD_STEP_LABEL, CALIBRATION_STEP_LABEL, FORWARD_STEP_LABEL, observe_means};
use super::sensor_nest::SensorNest;
use super::settings::RTestSettings;
use crate::revolution_grid::RevolutionGrid;
use crate::{MethodRefusal, NextStage, ObjectPositionSource};
use machine::record::plan::{Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::record::watched_sensors::WatchedSensor;
use machine::{Axis, Position};

const MOUNT_PROMPT_LABEL: &str = "mount nest";
/// Label of the scan of two stops that is repeated after an interruption. The identification does not use this scan.
const REFERENCE_TURN_STEP_LABEL: &str = "reference";

/// The stage that follows the `done` ones.
///
/// # Errors
/// A turn exceeds the axis limits, or a sensor has another direction or gain than declared.
pub fn next_stage(
    nest: &SensorNest<'_>,
    done: &[Stage],
    source: ObjectPositionSource<'_>,
) -> Result<NextStage, MethodRefusal> {
    let (name, steps) = match done.len() {
        0 => {
            revolution_angles_deg(nest)?;
            ("calibration of the sensors", vec![mount_prompt(nest), calibration_scan(nest)])
        }
        1 => {
            if let ObjectPositionSource::Measured(readings) = source {
                check_sensor_calibration(nest, readings)?;
            }
            ("turns", turn_scans(nest)?)
        }
        _ => return Ok(NextStage::NoFurtherStage),
    };
    Ok(NextStage::from_new_steps(nest.plan, done, name, steps))
}

/// Checks the sensors before the table turns.
fn check_sensor_calibration(nest: &SensorNest<'_>, readings: &[Reading]) -> Result<(), MethodRefusal> {
    let failed =
        |why: String| MethodRefusal::new(why, "check that each sensor measures the sphere, then start a new run");
    let observed = observe_means(nest, readings).map_err(|error| failed(error.to_string()))?;
    let equation = weighted_equations(nest, &observed);
    let minimum = solve_equations(&equation).map_err(|error| failed(error.to_string()))?;
    equation.check_sensor_directions_and_gains(&minimum.x)
}

fn mount_prompt(nest: &SensorNest<'_>) -> Step {
    let names: Vec<&str> = nest.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let text = format!(
        "Clamp the sphere in the spindle and the sensor nest ({}) in the centre of the table, \
         within 5 mm of its position in the machine file, so that no sensor leaves its range when \
         the table turns. The sphere will move into the nest from above",
        names.join(", ")
    );
    let watch = names.into_iter().map(WatchedSensor::new).collect();
    Step { watch, ..Step::prompt(MOUNT_PROMPT_LABEL.to_owned(), text) }
}

/// Calibration moves around the origin, in both directions along each axis.
fn calibration_scan(nest: &SensorNest<'_>) -> Step {
    let step_mm = nest.settings.calibration_mm;
    let mut path = vec![nest.origin.clone()];
    for axis in Axis::LINEAR {
        for by in [step_mm, -step_mm] {
            let at = nest.origin.get_or_zero(axis) + by;
            path.push(nest.origin.clone().with(axis, at));
        }
        path.push(nest.origin.clone());
    }
    dwell_scan(nest, CALIBRATION_STEP_LABEL, StepKind::Scan, path, nest.settings.feed_mm_min)
}

fn turn_scans(nest: &SensorNest<'_>) -> Result<Vec<Step>, MethodRefusal> {
    let forward = revolution_angles_deg(nest)?;
    let backward: Vec<f64> = forward.iter().rev().copied().collect();
    // The reference has two stops, so that the scan is a turn.
    let reference = forward[..2].to_vec();
    let turn = |label, kind, angles: Vec<f64>| {
        let position = |deg: &f64| nest.origin.clone().with(nest.measured_axis, nest.measured_axis.to_mm_or_rad(*deg));
        dwell_scan(nest, label, kind, angles.iter().map(position).collect(), nest.settings.feed_deg_min)
    };
    Ok(vec![
        turn(REFERENCE_TURN_STEP_LABEL, StepKind::Reference, reference),
        turn(FORWARD_STEP_LABEL, StepKind::Scan, forward),
        turn(BACKWARD_STEP_LABEL, StepKind::Scan, backward),
    ])
}

/// Angles of the stops of one revolution, with the start angle again at the end.
///
/// # Errors
/// The axis limits do not allow a revolution.
fn revolution_angles_deg(nest: &SensorNest<'_>) -> Result<Vec<f64>, MethodRefusal> {
    let positions = nest.settings.positions;
    let steps = RevolutionGrid { positions_per_revolution: positions, revolutions: 1, lead_positions_per_end: 0 }
        .position_index_range_within_limits(nest.plan, nest.measured_axis)?;
    Ok(steps.map(|number| number as f64 * 360.0 / positions as f64).collect())
}

/// Scan that takes samples at rest at each position of `path`. `feed`: mm/min, for turns degrees per minute.
fn dwell_scan(nest: &SensorNest<'_>, label: &str, kind: StepKind, path: Vec<Position>, feed: f64) -> Step {
    let RTestSettings { dwell_s, samples, .. } = *nest.settings;
    let scan = Scan { path, sampling: Sampling::Dwell { dwell_s, samples } };
    Step {
        kind,
        feed_mm_min: feed,
        sensors: nest.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
        normal: [0.0, 0.0, 1.0],
        ..Step::scan(label.to_owned(), scan)
    }
}
