//! Which stage comes next: the prompt and the calibration of the sensors, then the turns.

use super::fit;
use super::label::{BACKWARD, CALIBRATION, FORWARD, PROMPT, REFERENCE};
use super::nest::Nest;
use super::observe::observed;
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
    let numbered = (nest.plan.steps.len() as u32..).zip(steps);
    let new_steps: Vec<Step> =
        numbered.map(|(number, step)| Step { id: number, stage: id, ..step }).collect();
    let steps = new_steps.iter().map(|step| step.id).collect();
    Ok(Next::Stage {
        stage: Stage { id, name: name.to_owned(), repeat: 0, steps, found: None },
        new_steps,
    })
}

/// Before the table turns.
fn check_sensors(nest: &Nest<'_>, readings: &[Reading]) -> Result<(), Refused> {
    let failed = |why: String| Refused {
        why,
        instead: "check that each sensor measures the sphere, then start a new run".to_owned(),
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
    Step { kind: StepKind::Prompt, label: PROMPT.to_owned(), text: Some(text), ..empty() }
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
    let spec = nest.plan.machine.axes.get(&nest.axis);
    let [low, high] = spec.map_or([0.0; 2], |spec| [spec.min, spec.max]);
    let lowest = (low / step_deg - 1e-9).ceil() as i64;
    let highest = (high / step_deg + 1e-9).floor() as i64;
    let first = if lowest <= 0 && positions <= highest { 0 } else { lowest };
    if first + positions > highest {
        return Err(Refused {
            why: format!(
                "a revolution of {} does not fit its limits, {low}° to {high}°",
                nest.axis
            ),
            instead: format!("widen the limits in [axes.{}], if the axis turns farther", nest.axis),
        });
    }
    Ok((first..=first + positions).map(|number| number as f64 * step_deg).collect())
}

fn scan(
    nest: &Nest<'_>,
    label: &str,
    kind: StepKind,
    path: Vec<Position>,
    feed_mm_min: f64,
) -> Step {
    let settings = nest.settings;
    let end = |point: Option<&Position>| point.cloned().unwrap_or_default();
    Step {
        kind,
        label: label.to_owned(),
        from: end(path.first()),
        to: end(path.last()),
        feed_mm_min,
        sensors: nest.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
        normal: [0.0, 0.0, 1.0],
        scan: Some(Scan {
            path,
            sampling: Sampling::Dwell { dwell_s: settings.dwell_s, samples: settings.samples },
        }),
        ..empty()
    }
}

fn empty() -> Step {
    Step {
        id: 0,
        stage: 0,
        kind: StepKind::Scan,
        label: String::new(),
        from: Position::new(),
        to: Position::new(),
        feed_mm_min: 0.0,
        sensors: Vec::new(),
        normal: [0.0; 3],
        scan: None,
        text: None,
        mount: None,
    }
}
