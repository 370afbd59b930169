//! Sequence of stages: centring of the artefact, then one stage per mounting with the prompt, a reference, and
//! turns forward and backward.

use super::centring::{CENTRING_STOP_COUNT, CentringResult};
use super::layout_checks::describe_weak_points;
use super::settings::{MultiprobeSettings, TurnSampling};
use super::setup::MultiprobeSetup;
use super::step_label::StepLabel;
use crate::revolution_grid::RevolutionGrid;
use crate::{MethodRefusal, NextStage, ObjectPositionSource};
use estimation::revolutions::KERNEL_HALF_WIDTH_OUTPUT_STEPS;
use machine::Position;
use machine::record::plan::{ArtefactMount, Sampling, Scan, Stage, Step, StepKind};
use machine::record::watched_sensors::WatchedSensor;

/// Maximum number of centring rounds. If the artefact is still off centre, the run is refused.
const MAX_CENTRING_ROUNDS: usize = 20;

/// The stage that follows the `done` ones.
///
/// # Errors
/// A turn exceeds the axis limits, or the artefact is still not centred.
pub fn next_stage(
    setup: &MultiprobeSetup<'_>,
    done: &[Stage],
    source: ObjectPositionSource<'_>,
) -> Result<NextStage, MethodRefusal> {
    let labels: Vec<StepLabel> = setup.plan.steps.iter().filter_map(|s| s.label.parse().ok()).collect();
    let count = |is: fn(&StepLabel) -> bool| labels.iter().filter(|label| is(label)).count();
    let rounds = count(|label| matches!(label, StepLabel::CentringRound(_)));
    let mounted = count(|label| matches!(label, StepLabel::MountPrompt(_)));
    let measured = match source {
        ObjectPositionSource::Nominal => None,
        ObjectPositionSource::Measured(readings) => CentringResult::from_readings(setup, readings),
    };
    let off_centre = measured.filter(|centring| !centring.is_within_limit(setup));
    let turn = forward_turn_angles_deg(setup)?;
    let (name, steps) = match (rounds, mounted, &off_centre) {
        (0, _, _) => {
            let steps = vec![first_mount_prompt(setup)?, centring_turn(setup, &turn, 1)];
            ("centring".to_owned(), steps)
        }
        (rounds, 0, Some(off_centre)) if rounds < MAX_CENTRING_ROUNDS => {
            let prompt = Step::prompt(format!("centre/{}", rounds + 1), off_centre.prompt_text(setup));
            let prompt = Step { watch: off_centre.watched_sensors(setup), ..prompt };
            let steps = vec![prompt, centring_turn(setup, &turn, rounds + 1)];
            ("centring, once more".to_owned(), steps)
        }
        (_, 0, Some(_)) => {
            return Err(MethodRefusal::new(
                format!("the artefact is not centred after {rounds} rounds"),
                "use a finer centring stage, or raise eccentricity_limit_um",
            ));
        }
        (_, mounted, _) if mounted < setup.settings.indexes => {
            let count = setup.settings.indexes;
            (format!("mounting {} of {count}", mounted + 1), mounting_steps(setup, &turn, mounted + 1)?)
        }
        _ => return Ok(NextStage::NoFurtherStage),
    };
    Ok(NextStage::from_new_steps(setup.plan, done, name, steps))
}

fn first_mount_prompt(setup: &MultiprobeSetup<'_>) -> Result<Step, MethodRefusal> {
    let names: Vec<&str> = setup.plan.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let text = format!(
        "Mount the datum cylinder at 0° of its indexing stage and centre it by hand. Set the \
         sensors ({}) to the middle of their ranges. All axes will move to the positions of `at` \
         (rotary axes without a position to 0°), then the table will turn once.{}",
        names.join(", "),
        describe_weak_points(&setup.layout, setup.settings.harmonics, &setup.settings.obstructed_ranges())?
    );
    let watch = setup.plan.sensors.iter().map(WatchedSensor::with_mid_range_target).collect();
    Ok(Step { watch, ..Step::prompt("centre/1".to_owned(), text) })
}

/// One revolution with few stops, from the first angle of `turn_deg` on.
fn centring_turn(setup: &MultiprobeSetup<'_>, turn_deg: &[f64], round: usize) -> Step {
    let step_deg = 360.0 / CENTRING_STOP_COUNT as f64;
    let angles = (0..=CENTRING_STOP_COUNT).map(|k| turn_deg[0] + k as f64 * step_deg);
    turn_scan(setup, StepLabel::CentringRound(round), StepKind::Scan, angles.collect(), dwell_sampling(setup))
}

/// Steps of the mounting number `mounting_number`, from 1.
fn mounting_steps(
    setup: &MultiprobeSetup<'_>,
    turn_deg: &[f64],
    mounting_number: usize,
) -> Result<Vec<Step>, MethodRefusal> {
    let index_deg = setup.layout.index_angles_rad[mounting_number - 1].to_degrees();
    let text = match mounting_number {
        1 => format!(
            "The artefact is centred. Keep clear: at each mounting the table will turn {}°{}",
            360 * setup.settings.revolutions,
            if setup.settings.both_directions { " and back" } else { "" }
        ),
        _ => format!(
            "Turn the artefact on its indexing stage to {index_deg:.3}° relative to its first \
             mounting, counter-clockwise seen from its tip, and clamp it. Do not touch the sensors \
             or the table"
        ),
    };
    // The angles of all other mountings count from the first mounting.
    let mount = (mounting_number > 1).then_some(ArtefactMount { turn_deg: index_deg });
    let prompt = Step { mount, ..Step::prompt(StepLabel::MountPrompt(mounting_number).to_string(), text) };
    let forward = turn_deg.to_vec();
    let backward: Vec<f64> = forward.iter().rev().copied().collect();
    let start = turn_deg[0];
    let sampling = match setup.settings.sampling {
        TurnSampling::Dwell => dwell_sampling(setup),
        TurnSampling::Continuous => {
            Sampling::Continuous { rate_hz: setup.settings.rate_hz, per_revolution: Some(setup.settings.positions) }
        }
    };
    let turns = |label, angles| turn_scan(setup, label, StepKind::Scan, angles, sampling);
    // After an interruption the reference of the same mounting is repeated. The reference has two stops, so that the
    // scan is a turn.
    let reference = vec![start, start + 90.0];
    let reference = turn_scan(
        setup,
        StepLabel::MountingReference(mounting_number),
        StepKind::Reference,
        reference,
        dwell_sampling(setup),
    );
    let mut steps = vec![prompt, reference, turns(StepLabel::ForwardTurn(mounting_number), forward)];
    if setup.settings.both_directions {
        steps.push(turns(StepLabel::BackwardTurn(mounting_number), backward));
    }
    Ok(steps)
}

fn dwell_sampling(setup: &MultiprobeSetup<'_>) -> Sampling {
    Sampling::Dwell { dwell_s: setup.settings.dwell_s, samples: setup.settings.samples }
}

fn turn_scan(
    setup: &MultiprobeSetup<'_>,
    label: StepLabel,
    kind: StepKind,
    angles_deg: Vec<f64>,
    sampling: Sampling,
) -> Step {
    let position = |deg: &f64| {
        setup.other_axis_positions.clone().with(setup.measured_axis, setup.measured_axis.to_mm_or_rad(*deg))
    };
    let path: Vec<Position> = angles_deg.iter().map(position).collect();
    Step {
        kind,
        feed_mm_min: setup.settings.feed_deg_min,
        sensors: setup.plan.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
        normal: setup.plan.sensors.first().map_or([0.0; 3], |sensor| sensor.direction.map(|part| -part)),
        ..Step::scan(label.to_string(), Scan { path, sampling })
    }
}

/// Angles of the stops of the forward turn; for a continuous turn its two ends, with the lead that the resampling
/// filter needs.
///
/// # Errors
/// The axis limits do not allow the number of revolutions.
fn forward_turn_angles_deg(setup: &MultiprobeSetup<'_>) -> Result<Vec<f64>, MethodRefusal> {
    let MultiprobeSettings { positions, revolutions, sampling, .. } = *setup.settings;
    // The filter needs samples before the first revolution and after the last one. The first and the last step are
    // incomplete, as the axis starts and stops there.
    let lead = match sampling {
        TurnSampling::Dwell => 0,
        TurnSampling::Continuous => KERNEL_HALF_WIDTH_OUTPUT_STEPS + 1,
    };
    let steps = RevolutionGrid { positions_per_revolution: positions, revolutions, lead_positions_per_end: lead }
        .position_index_range_within_limits(setup.plan, setup.measured_axis)?;
    let numbers: Vec<i64> = match sampling {
        TurnSampling::Dwell => steps.collect(),
        TurnSampling::Continuous => vec![*steps.start(), *steps.end()],
    };
    Ok(numbers.into_iter().map(|number| number as f64 * 360.0 / positions as f64).collect())
}
