//! Sequence of stages: the prompt and the calibration of the sensors, then the turns.

use super::fit;
use super::label::{BACKWARD, CALIBRATION, FORWARD, PROMPT, REFERENCE};
use super::nest::Nest;
use super::observe::observed;
use super::settings::Settings;
use crate::turns::Turns;
use crate::{Next, Refused, Source};
use machine::record::plan::{Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::record::watch::WatchedSensor;
use machine::{Axis, Position};

/// The stage that follows the `done` ones.
///
/// # Errors
/// A turn exceeds the axis limits, or a sensor has another direction or gain than declared.
pub fn next(nest: &Nest<'_>, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
    let (name, steps) = match done.len() {
        0 => {
            turn_deg(nest)?;
            ("calibration of the sensors", vec![prompt(nest), calibration(nest)])
        }
        1 => {
            if let Source::Measured(readings) = source {
                check_sensors(nest, readings)?;
            }
            ("turns", turns(nest)?)
        }
        _ => return Ok(Next::Done),
    };
    Ok(Next::new_steps(nest.plan, done, name, steps))
}

/// Checks the sensors before the table turns.
fn check_sensors(nest: &Nest<'_>, readings: &[Reading]) -> Result<(), Refused> {
    let failed = |why: String| {
        Refused::new(why, "check that each sensor measures the sphere, then start a new run")
    };
    let observed = observed(nest, readings).map_err(|error| failed(error.to_string()))?;
    let equation = fit::weighted(nest, &observed);
    let minimum = fit::solve(&equation).map_err(|error| failed(error.to_string()))?;
    equation.check_sensors(&minimum.x)
}

fn prompt(nest: &Nest<'_>) -> Step {
    let names: Vec<&str> = nest.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let text = format!(
        "Clamp the sphere in the spindle and the sensor nest ({}) in the centre of the table, within 5 mm of where the \
         machine file states it, so that no sensor leaves its range when the table turns. The sphere will move into the \
         nest from above",
        names.join(", ")
    );
    let watch = names.into_iter().map(WatchedSensor::new).collect();
    Step { watch, ..Step::prompt(PROMPT.to_owned(), text) }
}

/// Calibration moves around the origin, in both directions along each axis.
fn calibration(nest: &Nest<'_>) -> Step {
    let by = nest.settings.calibration_mm;
    let mut path = vec![nest.origin.clone()];
    for axis in [Axis::X, Axis::Y, Axis::Z] {
        for by in [by, -by] {
            let at = nest.origin.at(axis) + by;
            path.push(nest.origin.clone().with(axis, at));
        }
        path.push(nest.origin.clone());
    }
    scan(nest, CALIBRATION, StepKind::Scan, path, nest.settings.feed_mm_min)
}

fn turns(nest: &Nest<'_>) -> Result<Vec<Step>, Refused> {
    let forward = turn_deg(nest)?;
    let backward: Vec<f64> = forward.iter().rev().copied().collect();
    // The reference has two stops, so that the scan is a turn.
    let reference = forward[..2].to_vec();
    let turn = |label, kind, angles: Vec<f64>| {
        let at = |deg: &f64| nest.origin.clone().with(nest.axis, nest.axis.from_edge(*deg));
        scan(nest, label, kind, angles.iter().map(at).collect(), nest.settings.feed_deg_min)
    };
    Ok(vec![
        turn(REFERENCE, StepKind::Reference, reference),
        turn(FORWARD, StepKind::Scan, forward),
        turn(BACKWARD, StepKind::Scan, backward),
    ])
}

/// Angles of one revolution.
///
/// # Errors
/// The axis limits do not allow a revolution.
fn turn_deg(nest: &Nest<'_>) -> Result<Vec<f64>, Refused> {
    let positions = nest.settings.positions;
    let steps = Turns { positions, revolutions: 1, lead: 0 }.within(nest.plan, nest.axis)?;
    Ok(steps.map(|number| number as f64 * 360.0 / positions as f64).collect())
}

fn scan(
    nest: &Nest<'_>,
    label: &str,
    kind: StepKind,
    path: Vec<Position>,
    feed_mm_min: f64,
) -> Step {
    let Settings { dwell_s, samples, .. } = *nest.settings;
    let scan = Scan { path, sampling: Sampling::Dwell { dwell_s, samples } };
    Step {
        kind,
        feed_mm_min,
        sensors: nest.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
        normal: [0.0, 0.0, 1.0],
        ..Step::scan(label.to_owned(), scan)
    }
}
