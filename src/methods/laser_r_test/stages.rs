//! The stages of the method and the scans of each stage.

use super::parameter_selection;
use super::scan_purpose::ScanPurpose;
use super::scan_step::{ExpectedGeometry, ScanMotion, ScanRequest, plan_scan_step};
use super::settings::SamplingMode;
use super::setup::LaserSetup;
use super::sphere_model::{CentreObservation, MachineEquations, SphereModel, with_linear_axes};
use super::touches;
use crate::{MethodRefusal, NextStage};
use estimation::null_space_names::name_null_space;
use machine::Position;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Stage, Step, StepKind};
use nalgebra::Matrix3;

/// Default heights relative to the middle of the sensor's range, in units of half the range.
const HEIGHT_HALF_RANGE_FRACTIONS: [f64; 3] = [-0.7, 0.0, 0.7];

/// A stage to be planned: its name, purpose and scans.
#[derive(Debug, Clone, PartialEq)]
pub struct StageRequest {
    pub name: &'static str,
    pub purpose: ScanPurpose,
    pub scans: Vec<ScanRequest>,
}

/// Lists all stages: search, latency (continuous scans only), beam direction (sensor only), first reference, zero
/// position from the circles of the axes, all other poses, last reference.
///
/// # Errors
/// A position is outside the axis limits, or the poses do not separate the errors.
pub fn list_stage_requests(setup: &LaserSetup<'_>) -> Result<Vec<StageRequest>, MethodRefusal> {
    let middle = sensor_mid_range_mm(setup);
    let continuous = setup.settings.sampling == SamplingMode::Continuous;
    let default_motion = if continuous { ScanMotion::SlowContinuous } else { ScanMotion::Dwell };
    let request = |purpose: ScanPurpose, detail: &str, rotary: &Position, motion: ScanMotion| {
        let label = purpose.step_label(detail, rotary);
        ScanRequest { rotary: rotary.clone(), pole_reading_mm: middle, label, is_reference: false, motion }
    };
    let poses = |all: &[Position]| {
        all.iter().map(|at| request(ScanPurpose::CentreAtPose, "", at, default_motion)).collect::<Vec<ScanRequest>>()
    };
    let [tilted, turned, others] = tilted_turned_and_combined_positions(setup)?;
    let zero = setup.rotary_at_zero();
    check_pose_separability(setup, &[std::slice::from_ref(&zero), &tilted, &turned, &others].concat())?;
    // The touch probe has no beam.
    let heights = planned_pole_readings_mm(setup).into_iter().zip(1..).filter(|_| !setup.uses_touch_probe());
    let heights = heights.map(|(pole_reading_mm, n)| ScanRequest {
        pole_reading_mm,
        ..request(ScanPurpose::BeamDirection, &format!("{n}"), &zero, default_motion)
    });
    let find = vec![request(ScanPurpose::Search, "", &zero, ScanMotion::Dwell)];
    // References use dwell points: the comparison after an interruption must not depend on a latency.
    let reference = |detail: &str| {
        vec![ScanRequest { is_reference: true, ..request(ScanPurpose::CentreAtPose, detail, &zero, ScanMotion::Dwell) }]
    };
    let feeds = [("1", ScanMotion::SlowContinuous), ("2", ScanMotion::FastContinuous)];
    let feeds = feeds.into_iter().filter(|_| continuous);
    let feeds = feeds.map(|(detail, motion)| request(ScanPurpose::Latency, detail, &zero, motion)).collect();
    let mut stage_plans = vec![
        StageRequest { name: "find the sphere", purpose: ScanPurpose::Search, scans: find },
        StageRequest { name: "latency", purpose: ScanPurpose::Latency, scans: feeds },
        StageRequest { name: "beam direction", purpose: ScanPurpose::BeamDirection, scans: heights.collect() },
        StageRequest { name: "reference", purpose: ScanPurpose::CentreAtPose, scans: reference("first") },
        StageRequest { name: "zero position: tilted", purpose: ScanPurpose::CentreAtPose, scans: poses(&tilted) },
        StageRequest { name: "zero position: turned", purpose: ScanPurpose::CentreAtPose, scans: poses(&turned) },
        StageRequest { name: "poses", purpose: ScanPurpose::CentreAtPose, scans: poses(&others) },
        StageRequest { name: "reference, again", purpose: ScanPurpose::CentreAtPose, scans: reference("last") },
    ];
    stage_plans.retain(|stage| !stage.scans.is_empty());
    Ok(stage_plans)
}

/// All positions except zero, as three lists: the tilting axis alone, the turning axis alone, both. Consecutive
/// positions are close together.
fn tilted_turned_and_combined_positions(setup: &LaserSetup<'_>) -> Result<[Vec<Position>; 3], MethodRefusal> {
    let zero = setup.rotary_at_zero();
    let [tilts, turns] = setup.nonzero_tilt_and_turn_positions()?;
    let [tilted, turned] = [&tilts, &turns].map(|all| all.iter().map(|at| zero.updated_by(at)).collect::<Vec<_>>());
    let mut others = Vec::new();
    for (number, tilted) in tilted.iter().enumerate() {
        let row = turns.iter().map(|turn| tilted.updated_by(turn));
        // Alternate the direction, so that the table does not return by a whole turn.
        if number % 2 == 0 { others.extend(row) } else { others.extend(row.rev()) }
    }
    Ok([tilted, turned, others])
}

fn sensor_mid_range_mm(setup: &LaserSetup<'_>) -> f64 {
    let [least, most] = setup.sensor.range_mm;
    (least + most) / 2.0
}

fn planned_pole_readings_mm(setup: &LaserSetup<'_>) -> Vec<f64> {
    if !setup.settings.heights_mm.is_empty() {
        return setup.settings.heights_mm.clone();
    }
    let [least, most] = setup.sensor.range_mm;
    HEIGHT_HALF_RANGE_FRACTIONS.map(|part| sensor_mid_range_mm(setup) + part * (most - least) / 2.0).to_vec()
}

/// # Errors
/// The poses do not determine all errors.
fn check_pose_separability(setup: &LaserSetup<'_>, poses: &[Position]) -> Result<(), MethodRefusal> {
    let settings = setup.settings;
    let selection = parameter_selection::select_parameters(&setup.chain, &settings.parameters, &settings.harmonics)?;
    let names = parameter_selection::unknown_names(&selection.parameters, &setup.ball.id);
    let count = selection.parameters.len();
    let model = SphereModel { chain: setup.chain.clone(), parameters: selection.parameters };
    let (zero, ball) = (setup.zero_point(), setup.ball_centre());
    let observation = |rotary: &Position| -> Result<CentreObservation, MethodRefusal> {
        let xyz = parameter_selection::nominal_xyz(&setup.chain, rotary, zero, ball)?;
        Ok(CentreObservation { axis_positions: with_linear_axes(rotary, xyz), whitening_matrix: Matrix3::identity() })
    };
    let centre_observations = poses.iter().map(observation).collect::<Result<_, _>>()?;
    let x = [&vec![0.0; count], zero.as_slice(), ball.as_slice()].concat();
    let survey = MachineEquations { model, centre_observations, zero_point_prior: None }.analyse_rank(&x);
    let survey = survey.map_err(|why| inseparable_errors_refusal(why.to_string()))?;
    if survey.nullity == 0 {
        return Ok(());
    }
    let lost = name_null_space(survey.null_space.as_ref(), &names).join("; ");
    Err(inseparable_errors_refusal(format!(
        "{} poses with the sphere at {:?} mm do not separate all unknowns (rank {} of {}): {lost}",
        poses.len(),
        setup.ball.centre_mm,
        survey.rank,
        survey.rank + survey.nullity
    )))
}

fn inseparable_errors_refusal(why: String) -> MethodRefusal {
    MethodRefusal::new(
        why,
        "add positions to tilt_deg and turn_deg, mount the sphere away from the axes, or remove the inseparable errors \
         from parameters and harmonics",
    )
}

/// Plans the requested stage, which follows the `done` ones.
///
/// # Errors
/// The errors of [`plan_scan_step`], or with a touch probe of `touches::ball_touch_steps`.
pub fn build_stage(
    setup: &LaserSetup<'_>,
    stage_request: &StageRequest,
    geometry: &ExpectedGeometry,
    done: &[Stage],
) -> Result<NextStage, MethodRefusal> {
    let position_uncertainty_mm = match stage_request.purpose {
        ScanPurpose::Search => setup.balls.uncertainty_mm,
        _ => setup.settings.max_position_error_mm,
    };
    let geometry = ExpectedGeometry { max_position_error_mm: position_uncertainty_mm, ..*geometry };
    let mut steps: Vec<Step> = Vec::new();
    for request in &stage_request.scans {
        match relabelled_first_reference(setup, request) {
            repeated if !repeated.is_empty() => steps.extend(repeated),
            _ if setup.uses_touch_probe() => {
                steps.extend(touches::ball_touch_steps(setup, &geometry, stage_request.purpose, request)?)
            }
            _ => steps.push(plan_scan_step(setup, &geometry, request)?),
        }
    }
    let mut next = NextStage::from_new_steps(setup.plan, done, stage_request.name, steps);
    if let NextStage::Stage { stage, .. } = &mut next
        && stage_request.purpose != ScanPurpose::Search
    {
        stage.found = Some(located_artefact(setup, &geometry));
    }
    Ok(next)
}

/// Steps of the first reference with the label of `request`. Empty if `request` is no reference or the first one.
fn relabelled_first_reference(setup: &LaserSetup<'_>, request: &ScanRequest) -> Vec<Step> {
    let steps = setup.plan.steps.iter();
    let first = steps.filter(|step| request.is_reference && step.kind == StepKind::Reference);
    let relabelled = |step: &Step| {
        let touch = match step.scan {
            Some(_) => String::new(),
            None => step.label.rsplit_once('/').map_or_else(String::new, |(_, t)| format!("/{t}")),
        };
        Step { label: format!("{}{touch}", request.label), ..step.clone() }
    };
    first.map(relabelled).collect()
}

/// The artefact with the sphere at its expected position. The uncertainty is reduced only if there is no other ball.
fn located_artefact(setup: &LaserSetup<'_>, geometry: &ExpectedGeometry) -> Artefact {
    let moved = |ball: &Ball| match ball.id == setup.ball.id {
        true => Ball { centre_mm: geometry.ball_centre.into(), ..ball.clone() },
        false => ball.clone(),
    };
    let balls = setup.balls.balls.iter().map(moved).collect();
    let uncertainty_mm = match setup.balls.balls.len() {
        1 => geometry.max_position_error_mm.min(setup.balls.uncertainty_mm),
        _ => setup.balls.uncertainty_mm,
    };
    Artefact::Balls(Balls { balls, uncertainty_mm, ..setup.balls.clone() })
}
