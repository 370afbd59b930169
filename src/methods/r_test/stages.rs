//! Which stage comes next: the prompt and the calibration of the sensors, then the turns.

use super::fit;
use super::label::{BACKWARD, CALIBRATION, FORWARD, PROMPT, REFERENCE};
use super::nest::Nest;
use super::observe::observed;
use super::settings::Settings;
use crate::{Next, Refused, Source};
use machine::record::plan::{Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::{Axis, Position};

/// The next stage after the `done` ones.
///
/// # Errors
/// A turn that does not fit the axis limits; sensors that show another direction or gain than declared.
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
    let id = done.last().map_or(0, |stage| stage.id + 1);
    let new_steps = nest.plan.numbered(id, steps);
    let steps = new_steps.iter().map(|step| step.id).collect();
    Ok(Next::Stage {
        stage: Stage { id, name: name.to_owned(), repeat: 0, steps, found: None },
        new_steps,
    })
}

/// Before the table turns.
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
    Step::prompt(PROMPT.to_owned(), text)
}

/// About the origin, along each axis both ways.
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
    // Two stops, so that the scan is a turn.
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

/// One revolution, from zero where the limits of the axis have room for it, otherwise from the lower limit on.
///
/// # Errors
/// The axis does not turn so far.
fn turn_deg(nest: &Nest<'_>) -> Result<Vec<f64>, Refused> {
    let positions = nest.settings.positions as i64;
    let step_deg = 360.0 / positions as f64;
    let axis = nest.axis;
    let spec = nest.plan.machine.axes.get(&axis).ok_or_else(Refused::no_table)?;
    let [lowest, highest] = spec.multiples_within(step_deg);
    let first = if lowest <= 0 && positions <= highest { 0 } else { lowest };
    Refused::unless(
        first + positions <= highest,
        format!("a revolution of {axis} does not fit its limits, {}° to {}°", spec.min, spec.max),
        format!("widen the limits in [axes.{axis}], if the axis turns farther"),
    )?;
    Ok((first..=first + positions).map(|number| number as f64 * step_deg).collect())
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
