//! Choice of the next stage. The visits are divided into requests (find, reference, rest check, slow); each request is
//! one stage.

use super::found_balls::{FoundBalls, group_readings_by_measurement};
use super::rest_check::needs_rest_check_round;
use super::setup::{BallVisit, MeasurementSetup, SearchMode, describe_rotary_axes_in_degrees};
use super::stage_review::review_stage;
use super::touch_label::{MeasurementPurpose, TouchLabel, touch_steps_with_labels};
use crate::{MethodRefusal, NextStage, ObjectPositionSource};
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Plan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use planning::plan_blocks_and_time_s_by_stage;

/// A stage to be planned: a pass over balls at one indexation.
#[derive(Debug, Clone, PartialEq)]
struct StageRequest {
    purpose: MeasurementPurpose,
    /// Zero-based index in the labels: of the visit, or of the round of a reference or a rest check.
    label_index: usize,
    /// Index of the visit that gives the indexation.
    visit_index: usize,
    /// In measuring order.
    ball_indices: Vec<usize>,
}

/// The next stage of a run that measures the `visits`: a repeat of measurements that were outside the limits, or the
/// next request.
///
/// # Errors
/// A ball cannot be touched, was outside the limits twice, or is too far from its expected position; or the rest
/// check does not confirm rest.
pub fn next_stage(
    setup: &MeasurementSetup<'_>,
    visits: &[BallVisit],
    done: &[Stage],
    source: ObjectPositionSource<'_>,
) -> Result<NextStage, MethodRefusal> {
    let id = done.last().map_or(0, |stage| stage.id + 1);
    let (known, one_more) = match source {
        ObjectPositionSource::Nominal => (FoundBalls::from_stated_positions(setup), false),
        ObjectPositionSource::Measured(readings) => {
            if let Some(stage) = build_repeat_stage(setup, done, readings, id)? {
                return Ok(NextStage::Stage { stage, new_steps: Vec::new() });
            }
            let measurements = group_readings_by_measurement(setup, readings);
            (FoundBalls::from_measurements(setup, &measurements), needs_rest_check_round(setup, readings)?)
        }
    };
    let requests = list_stage_requests(setup, visits, planned_rest_check_round_count(setup) + usize::from(one_more));
    let passed = done.iter().filter(|stage| stage.repeat == 0).count();
    let Some(request) = requests.get(passed) else { return Ok(NextStage::NoFurtherStage) };
    let (stage, new_steps) = build_stage(setup, visits, request, &known, id)?;
    Ok(NextStage::Stage { stage, new_steps })
}

/// The stage that repeats the measurements of the last stage that were outside the limits.
fn build_repeat_stage(
    setup: &MeasurementSetup<'_>,
    done: &[Stage],
    readings: &[Reading],
    id: u32,
) -> Result<Option<Stage>, MethodRefusal> {
    let Some(last) = done.last() else { return Ok(None) };
    let Some((steps, repeat)) = review_stage(setup, last, readings)? else { return Ok(None) };
    let name = format!("{}, once more", last.name.trim_end_matches(", once more"));
    Ok(Some(Stage { id, name, repeat, steps, found: last.found.clone() }))
}

/// Number of rounds of the rest check that the plan has so far.
fn planned_rest_check_round_count(setup: &MeasurementSetup<'_>) -> usize {
    let rest_check_steps =
        touch_steps_with_labels(setup.plan).filter(|(_, label)| label.purpose == MeasurementPurpose::RestCheck);
    rest_check_steps.map(|(_, label)| label.indexation_number()).max().unwrap_or(0) as usize
}

/// Requests for all stages in measuring order: searches at the visits of [`choose_search_visits`], the first
/// reference, the rest check, the slow visits (with [`SearchMode::Every`] each with its search before it), the second
/// reference in the middle of the visits and the third after them. Reference and rest check use one ball at the first
/// search visit.
fn list_stage_requests(
    setup: &MeasurementSetup<'_>,
    visits: &[BallVisit],
    rest_check_rounds: usize,
) -> Vec<StageRequest> {
    let searches = choose_search_visits(visits);
    let request = |purpose, label_index, visit_index, balls: &[usize]| StageRequest {
        purpose,
        label_index,
        visit_index,
        ball_indices: balls.to_vec(),
    };
    let every = setup.touch_settings.search_mode == SearchMode::Every;
    let search = |(visit, new): &(usize, Vec<usize>)| {
        let all = visits.get(*visit).map_or(new, |visit| if every { &visit.ball_indices } else { new });
        request(MeasurementPurpose::Find, *visit, *visit, all)
    };
    let mut requests: Vec<StageRequest> = searches.iter().map(search).collect();
    let repeated = |purpose: MeasurementPurpose, round: usize| {
        let (visit, balls) = searches.first()?;
        Some(request(purpose, round, *visit, balls.get(..1)?))
    };
    let reference =
        |round| repeated(MeasurementPurpose::Reference, round).filter(|_| setup.touch_settings.has_references);
    requests.extend(reference(0));
    requests.extend((0..rest_check_rounds).filter_map(|round| repeated(MeasurementPurpose::RestCheck, round)));
    for (number, visit) in visits.iter().enumerate() {
        if number > 0 && number == visits.len() / 2 {
            requests.extend(reference(1));
        }
        let mut slow = request(MeasurementPurpose::Slow, number, number, &visit.ball_indices);
        if every && !searches.iter().any(|(searched, _)| *searched == number) {
            requests.push(request(MeasurementPurpose::Find, number, number, &visit.ball_indices));
            // The slow measurement takes the path of the search backwards.
            slow.ball_indices.reverse();
        }
        requests.push(slow);
    }
    requests.extend(reference(2));
    requests
}

/// Indices of visits that together give access to every ball, with the balls not accessible at a visit chosen
/// earlier. Greedy: the visit with most new balls comes first.
fn choose_search_visits(visits: &[BallVisit]) -> Vec<(usize, Vec<usize>)> {
    let mut found: Vec<usize> = Vec::new();
    let mut searches = Vec::new();
    loop {
        let new = |visit: &BallVisit| -> Vec<usize> {
            visit.ball_indices.iter().copied().filter(|ball| !found.contains(ball)).collect()
        };
        // Of equally good visits, the first is chosen.
        let best = visits.iter().enumerate().rev().max_by_key(|(_, visit)| new(visit).len());
        let Some((number, balls)) = best.map(|(number, visit)| (number, new(visit))) else { break };
        if balls.is_empty() {
            break;
        }
        found.extend(&balls);
        searches.push((number, balls));
    }
    searches
}

/// Machine time of the visits with their searches and references, without a rest check, if every ball is found at its
/// stated position, s.
///
/// # Errors
/// A visit cannot be planned.
pub fn visits_machine_time_s(setup: &MeasurementSetup<'_>, visits: &[BallVisit]) -> Result<f64, MethodRefusal> {
    let mut plan = Plan { steps: Vec::new(), ..setup.plan.clone() };
    let mut stages = Vec::new();
    for (id, request) in (0..).zip(list_stage_requests(setup, visits, 0)) {
        let grown = MeasurementSetup { plan: &plan, ..*setup };
        let (planned, steps) = build_stage(&grown, visits, &request, &FoundBalls::from_stated_positions(&grown), id)?;
        plan.steps.extend(steps);
        stages.push(planned);
    }
    Ok(plan_blocks_and_time_s_by_stage(&plan, &stages)?.1)
}

/// The requested stage and its steps, numbered after those of the plan.
///
/// # Errors
/// A ball cannot be touched.
fn build_stage(
    setup: &MeasurementSetup<'_>,
    visits: &[BallVisit],
    request: &StageRequest,
    known: &FoundBalls,
    id: u32,
) -> Result<(Stage, Vec<Step>), MethodRefusal> {
    let steps = match request.purpose {
        MeasurementPurpose::Reference | MeasurementPurpose::RestCheck if request.label_index > 0 => {
            repeat_first_round_steps(setup, request)
        }
        _ => plan_touch_steps(setup, visits, request, known)?,
    };
    let steps = setup.plan.number_steps(id, steps);
    let stage = Stage {
        id,
        name: stage_name(setup, visits, request),
        repeat: 0,
        steps: steps.iter().map(|step| step.id).collect(),
        found: artefact_at_found_positions(setup, request, known),
    };
    Ok((stage, steps))
}

fn stage_name(setup: &MeasurementSetup<'_>, visits: &[BallVisit], request: &StageRequest) -> String {
    let of_visit = |action: &str| {
        let visit = visits.get(request.visit_index);
        let at = visit.map_or(String::new(), |visit| describe_rotary_axes_in_degrees(&visit.rotary_position));
        format!("{action} at {at} ({} of {})", request.label_index + 1, visits.len())
    };
    let of_ball = |action: &str| {
        let ball = request.ball_indices.first().and_then(|ball| setup.balls.balls.get(*ball));
        format!("{action}: ball {}", ball.map_or("", |ball| &ball.id))
    };
    match request.purpose {
        MeasurementPurpose::Find => of_visit("find"),
        MeasurementPurpose::Slow => of_visit("measure"),
        MeasurementPurpose::RestCheck => of_ball("rest check of the machine"),
        MeasurementPurpose::Reference => of_ball("reference"),
    }
}

/// Steps for the requested balls at their expected positions. The touch orders of the visit apply to slow
/// measurements only; the others use the default order.
fn plan_touch_steps(
    setup: &MeasurementSetup<'_>,
    visits: &[BallVisit],
    request: &StageRequest,
    known: &FoundBalls,
) -> Result<Vec<Step>, MethodRefusal> {
    let Some(visit) = visits.get(request.visit_index) else { return Ok(Vec::new()) };
    let assumed_artefact = artefact_at_found_positions(setup, request, known);
    let access = setup.touch_access(assumed_artefact.as_ref().unwrap_or(&setup.plan.artefact))?;
    let mut steps: Vec<Step> = Vec::new();
    for index in &request.ball_indices {
        let Some(ball) = setup.balls.balls.get(*index) else { continue };
        let centre_mm = known.expected_centre(setup, *index, request.visit_index).into();
        let expected = Ball { centre_mm, ..ball.clone() };
        let mode = match request.purpose {
            MeasurementPurpose::Find => setup.search_touch_mode(known.expected_centre_tolerance_mm(setup)),
            MeasurementPurpose::Slow | MeasurementPurpose::RestCheck | MeasurementPurpose::Reference => {
                setup.slow_touch_mode()
            }
        };
        let kind = if request.purpose == MeasurementPurpose::Reference { StepKind::Reference } else { StepKind::Touch };
        let label = |touch: &str| {
            let (pass, indexation, touch) = (request.purpose, request.label_index as u32, touch.to_owned());
            TouchLabel { purpose: pass, indexation_index: indexation, ball: ball.id.clone(), touch }.to_string()
        };
        let new = setup.ball_steps(
            &access,
            &setup.ball_measurement_request(&expected, &visit.rotary_position, mode),
            kind,
            label,
        )?;
        let touch_order =
            visit.slow_touch_orders_by_ball_index.get(index).filter(|_| request.purpose == MeasurementPurpose::Slow);
        steps.extend(touch_order.copied().unwrap_or_default().apply(new));
    }
    Ok(steps)
}

/// Steps of the first round of references or of the rest check again, at exactly the same positions.
fn repeat_first_round_steps(setup: &MeasurementSetup<'_>, request: &StageRequest) -> Vec<Step> {
    let of_first = |(_, label): &(&Step, TouchLabel)| label.purpose == request.purpose && label.indexation_index == 0;
    let renumbered = |(step, label): (&Step, TouchLabel)| {
        let label = TouchLabel { indexation_index: request.label_index as u32, ..label };
        Step { label: label.to_string(), ..step.clone() }
    };
    touch_steps_with_labels(setup.plan).filter(of_first).map(renumbered).collect()
}

/// The artefact with the balls at their found positions. `None` until all balls are found, because only the
/// stated positions are known until then.
fn artefact_at_found_positions(
    setup: &MeasurementSetup<'_>,
    request: &StageRequest,
    known: &FoundBalls,
) -> Option<Artefact> {
    if !known.has_all_balls() {
        return None;
    }
    let uncertainty_mm = match request.purpose {
        MeasurementPurpose::Find => known.expected_centre_tolerance_mm(setup),
        _ => setup.touch_settings.found_position_tolerance_mm(),
    };
    let balls = setup.balls.balls.iter().enumerate().map(|(index, ball)| {
        let centre_mm = known.expected_centre(setup, index, request.visit_index).into();
        Ball { centre_mm, ..ball.clone() }
    });
    Some(Artefact::Balls(Balls { balls: balls.collect(), uncertainty_mm, ..setup.balls.clone() }))
}
