//! Sequence of stages: centring of the artefact, then one stage per mounting with the prompt, a reference, and
//! turns forward and backward.

use super::centring::{CENTRING_POINTS, Centring};
use super::checks::weak_points;
use super::label::Label;
use super::settings::{Settings, TurnSampling};
use super::setup::Setup;
use crate::turns::Turns;
use crate::{Next, Refused, Source};
use estimation::revolutions::KERNEL_HALF_STEPS;
use machine::Position;
use machine::record::plan::{ArtefactMount, Sampling, Scan, Stage, Step, StepKind};
use machine::record::watch::WatchedSensor;

/// Maximum number of centring rounds.
const MAX_CENTRING_ROUNDS: usize = 20;

/// The stage that follows the `done` ones.
///
/// # Errors
/// A turn exceeds the axis limits, or the artefact is still not centred.
pub fn next(setup: &Setup<'_>, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
    let labels: Vec<Label> = setup.plan.steps.iter().filter_map(|s| s.label.parse().ok()).collect();
    let count = |is: fn(&Label) -> bool| labels.iter().filter(|label| is(label)).count();
    let rounds = count(|label| matches!(label, Label::Centring(_)));
    let mounted = count(|label| matches!(label, Label::Mount(_)));
    let measured = match source {
        Source::Nominal => None,
        Source::Measured(readings) => Centring::of(setup, readings),
    };
    let off = measured.filter(|centring| !centring.is_within(setup));
    let turn = turn_deg(setup)?;
    let (name, steps) = match (rounds, mounted, &off) {
        (0, _, _) => {
            let steps = vec![first_prompt(setup)?, centring_turn(setup, &turn, 1)];
            ("centring".to_owned(), steps)
        }
        (rounds, 0, Some(off)) if rounds < MAX_CENTRING_ROUNDS => {
            let prompt = Step::prompt(format!("centre/{}", rounds + 1), off.text(setup));
            let prompt = Step { watch: off.watch(setup), ..prompt };
            let steps = vec![prompt, centring_turn(setup, &turn, rounds + 1)];
            ("centring, once more".to_owned(), steps)
        }
        (_, 0, Some(_)) => {
            return Err(Refused::new(
                format!("the artefact is not centred after {rounds} rounds"),
                "use a finer centring stage, or raise eccentricity_limit_um",
            ));
        }
        (_, mounted, _) if mounted < setup.settings.indexes => {
            let count = setup.settings.indexes;
            (format!("mounting {} of {count}", mounted + 1), mounting(setup, &turn, mounted + 1)?)
        }
        _ => return Ok(Next::Done),
    };
    Ok(Next::new_steps(setup.plan, done, name, steps))
}

fn first_prompt(setup: &Setup<'_>) -> Result<Step, Refused> {
    let names: Vec<&str> = setup.plan.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let text = format!(
        "Mount the datum cylinder at 0° of its indexing stage and centre it by hand. Set the sensors ({}) to the \
         middle of their ranges. All axes will go to where `at` states them (rotary axes to 0° where it does not), then \
         the table turns once.{}",
        names.join(", "),
        weak_points(&setup.layout, setup.settings.harmonics, &setup.settings.exclusions())?
    );
    let watch = setup.plan.sensors.iter().map(WatchedSensor::at_mid_range).collect();
    Ok(Step { watch, ..Step::prompt("centre/1".to_owned(), text) })
}

/// One revolution with few stops.
fn centring_turn(setup: &Setup<'_>, turn_deg: &[f64], round: usize) -> Step {
    let step_deg = 360.0 / CENTRING_POINTS as f64;
    let angles = (0..=CENTRING_POINTS).map(|k| turn_deg[0] + k as f64 * step_deg);
    scan(setup, Label::Centring(round), StepKind::Scan, angles.collect(), rests(setup))
}

/// Steps of one mounting, counted from 1.
fn mounting(setup: &Setup<'_>, turn_deg: &[f64], number: usize) -> Result<Vec<Step>, Refused> {
    let index_deg = setup.layout.index_angles_rad[number - 1].to_degrees();
    let text = match number {
        1 => format!(
            "The artefact is centred. Keep clear: at each mounting the table turns {}°{}",
            360 * setup.settings.revolutions,
            if setup.settings.both_directions { " and back" } else { "" }
        ),
        _ => format!(
            "Turn the artefact on its indexing stage to {index_deg:.3}° against its first mounting, counter-clockwise \
             seen from its tip, and clamp it. Do not touch sensors and table"
        ),
    };
    // The angles of all other mountings count from the first mounting.
    let mount = (number > 1).then_some(ArtefactMount { turn_deg: index_deg });
    let prompt = Step { mount, ..Step::prompt(Label::Mount(number).to_string(), text) };
    let forward = turn_deg.to_vec();
    let backward: Vec<f64> = forward.iter().rev().copied().collect();
    let start = turn_deg[0];
    let sampling = match setup.settings.sampling {
        TurnSampling::Dwell => rests(setup),
        TurnSampling::Continuous => Sampling::Continuous {
            rate_hz: setup.settings.rate_hz,
            per_revolution: Some(setup.settings.positions),
        },
    };
    let turns = |label, angles| scan(setup, label, StepKind::Scan, angles, sampling);
    // After an interruption the reference of the same mounting is repeated. It has two stops, so that the scan is a
    // turn.
    let reference = vec![start, start + 90.0];
    let reference =
        scan(setup, Label::Reference(number), StepKind::Reference, reference, rests(setup));
    let mut steps = vec![prompt, reference, turns(Label::Forward(number), forward)];
    if setup.settings.both_directions {
        steps.push(turns(Label::Backward(number), backward));
    }
    Ok(steps)
}

fn rests(setup: &Setup<'_>) -> Sampling {
    Sampling::Dwell { dwell_s: setup.settings.dwell_s, samples: setup.settings.samples }
}

fn scan(
    setup: &Setup<'_>,
    label: Label,
    kind: StepKind,
    angles_deg: Vec<f64>,
    sampling: Sampling,
) -> Step {
    let at = |deg: &f64| setup.at.clone().with(setup.axis, setup.axis.from_edge(*deg));
    let path: Vec<Position> = angles_deg.iter().map(at).collect();
    Step {
        kind,
        feed_mm_min: setup.settings.feed_deg_min,
        sensors: setup.plan.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
        normal: setup
            .plan
            .sensors
            .first()
            .map_or([0.0; 3], |sensor| sensor.direction.map(|part| -part)),
        ..Step::scan(label.to_string(), Scan { path, sampling })
    }
}

/// Angles of the forward turn, or the ends of a continuous one.
///
/// # Errors
/// The axis limits do not allow the number of revolutions.
fn turn_deg(setup: &Setup<'_>) -> Result<Vec<f64>, Refused> {
    let Settings { positions, revolutions, sampling, .. } = *setup.settings;
    // The filter needs samples before the first revolution and after the last one. The first and the last step are
    // incomplete, as the axis starts and stops there.
    let lead = match sampling {
        TurnSampling::Dwell => 0,
        TurnSampling::Continuous => KERNEL_HALF_STEPS + 1,
    };
    let steps = Turns { positions, revolutions, lead }.within(setup.plan, setup.axis)?;
    let numbers: Vec<i64> = match sampling {
        TurnSampling::Dwell => steps.collect(),
        TurnSampling::Continuous => vec![*steps.start(), *steps.end()],
    };
    Ok(numbers.into_iter().map(|number| number as f64 * 360.0 / positions as f64).collect())
}
