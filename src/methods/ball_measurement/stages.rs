//! Choice of the next stage: the tasks of a list of visits, one stage each.

use super::known::FoundBalls;
use super::label::{Label, Pass};
use super::review::review;
use super::setup::{Find, MeasurementSetup, TouchSettings, Visit, describe_position};
use super::watch;
use crate::{Next, Refused, Source};
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Plan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use planning::{Approach, Unreachable, staged_blocks};

/// One stage: a pass over balls at one indexation.
#[derive(Debug, Clone, PartialEq)]
struct Task {
    pass: Pass,
    /// Number of the visit in the labels; for a reference, number of its round.
    number: usize,
    /// Index of the visit that gives the indexation.
    visit: usize,
    balls: Vec<usize>,
}

/// The next stage of a run that measures the `visits`: a repeat of measurements that were outside the limits,
/// or the next task.
///
/// # Errors
/// A ball cannot be touched, or was outside the limits twice.
pub fn next(
    setup: &MeasurementSetup<'_>,
    visits: &[Visit],
    done: &[Stage],
    source: Source<'_>,
) -> Result<Next, Refused> {
    let id = done.last().map_or(0, |stage| stage.id + 1);
    let (known, one_more) = match source {
        Source::Nominal => (FoundBalls::nominal(setup), false),
        Source::Measured(readings) => {
            if let Some(stage) = once_more(setup, done, readings, id)? {
                return Ok(Next::Stage { stage, new_steps: Vec::new() });
            }
            (FoundBalls::of(setup, readings), watch::needs_a_round(setup, readings)?)
        }
    };
    let tasks = tasks(setup, visits, rounds_of_watch(setup) + usize::from(one_more));
    let passed = done.iter().filter(|stage| stage.repeat == 0).count();
    let Some(task) = tasks.get(passed) else { return Ok(Next::Done) };
    let (stage, new_steps) = stage(setup, visits, task, &known, id)?;
    Ok(Next::Stage { stage, new_steps })
}

/// The stage that repeats the measurements of the last stage that were outside the limits.
fn once_more(
    setup: &MeasurementSetup<'_>,
    done: &[Stage],
    readings: &[Reading],
    id: u32,
) -> Result<Option<Stage>, Refused> {
    let Some(last) = done.last() else { return Ok(None) };
    let Some((steps, repeat)) = review(setup, last, readings)? else { return Ok(None) };
    let name = format!("{}, once more", last.name.trim_end_matches(", once more"));
    Ok(Some(Stage { id, name, repeat, steps, found: last.found.clone() }))
}

/// Number of watch rounds in the plan so far.
fn rounds_of_watch(setup: &MeasurementSetup<'_>) -> usize {
    let labels = setup.plan.steps.iter().filter_map(|step| step.label.parse::<Label>().ok());
    let rounds = labels.filter(|label| label.pass == Pass::Watch).map(|label| label.number());
    rounds.max().unwrap_or(0) as usize
}

/// All tasks in measuring order. First every ball is searched for: at the indexation where most balls are
/// accessible, then at others for the remaining balls. Then one ball is watched, and the visits follow.
fn tasks(setup: &MeasurementSetup<'_>, visits: &[Visit], watched: usize) -> Vec<Task> {
    let searches = searches(visits);
    let task = |pass, number: usize, balls: &[usize]| Task {
        pass,
        number,
        visit: number,
        balls: balls.to_vec(),
    };
    let every = setup.touch.find == Find::Every;
    let mut tasks: Vec<Task> = searches
        .iter()
        .map(|(visit, new)| {
            let all =
                visits.get(*visit).map_or(new, |visit| if every { &visit.balls } else { new });
            task(Pass::Find, *visit, all)
        })
        .collect();
    let repeated = |pass: Pass, number: usize| {
        let (visit, balls) = searches.first()?;
        Some(Task { pass, number, visit: *visit, balls: vec![*balls.first()?] })
    };
    let reference = |round| repeated(Pass::Reference, round).filter(|_| setup.touch.has_references);
    tasks.extend(reference(0));
    tasks.extend((0..watched).filter_map(|round| repeated(Pass::Watch, round)));
    for (number, visit) in visits.iter().enumerate() {
        if number > 0 && number == visits.len() / 2 {
            tasks.extend(reference(1));
        }
        let mut slow = task(Pass::Slow, number, &visit.balls);
        if every && !searches.iter().any(|(searched, _)| *searched == number) {
            tasks.push(task(Pass::Find, number, &visit.balls));
            // The slow measurement takes the path of the search backwards.
            slow.balls.reverse();
        }
        tasks.push(slow);
    }
    tasks.extend(reference(2));
    tasks
}

/// Visits that together give access to every ball, and the balls that are new at each.
fn searches(visits: &[Visit]) -> Vec<(usize, Vec<usize>)> {
    let mut found: Vec<usize> = Vec::new();
    let mut searches = Vec::new();
    loop {
        let new = |visit: &Visit| -> Vec<usize> {
            visit.balls.iter().copied().filter(|ball| !found.contains(ball)).collect()
        };
        // The first of equal visits.
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

/// Machine time of the visits if every ball is found at its stated position, s.
///
/// # Errors
/// A visit cannot be planned.
pub fn machine_time_s(setup: &MeasurementSetup<'_>, visits: &[Visit]) -> Result<f64, Refused> {
    let mut plan = Plan { steps: Vec::new(), ..setup.plan.clone() };
    let mut stages = Vec::new();
    for (id, task) in (0..).zip(tasks(setup, visits, 0)) {
        let grown = setup.with(&plan);
        let (planned, steps) = stage(&grown, visits, &task, &FoundBalls::nominal(&grown), id)?;
        plan.steps.extend(steps);
        stages.push(planned);
    }
    Ok(staged_blocks(&plan, &stages)?.1)
}

/// The stage of a task and its steps, numbered after those of the plan.
///
/// # Errors
/// A ball cannot be touched.
fn stage(
    setup: &MeasurementSetup<'_>,
    visits: &[Visit],
    task: &Task,
    known: &FoundBalls,
    id: u32,
) -> Result<(Stage, Vec<Step>), Refused> {
    let steps = match task.pass {
        Pass::Reference | Pass::Watch if task.number > 0 => again(setup, task),
        _ => new_steps(setup, visits, task, known)?,
    };
    let steps = setup.plan.numbered(id, steps);
    let stage = Stage {
        id,
        name: name(setup, visits, task),
        repeat: 0,
        steps: steps.iter().map(|step| step.id).collect(),
        found: found(setup, task, known),
    };
    Ok((stage, steps))
}

fn name(setup: &MeasurementSetup<'_>, visits: &[Visit], task: &Task) -> String {
    let at = visits.get(task.visit).map_or(String::new(), |visit| describe_position(&visit.at));
    match task.pass {
        Pass::Find => format!("find at {at} ({} of {})", task.number + 1, visits.len()),
        Pass::Slow => format!("measure at {at} ({} of {})", task.number + 1, visits.len()),
        Pass::Watch | Pass::Reference => {
            let ball = task.balls.first().and_then(|ball| setup.balls.balls.get(*ball));
            let what =
                if task.pass == Pass::Watch { "is the machine at rest" } else { "reference" };
            format!("{what}: ball {}", ball.map_or("", |ball| &ball.id))
        }
    }
}

fn new_steps(
    setup: &MeasurementSetup<'_>,
    visits: &[Visit],
    task: &Task,
    known: &FoundBalls,
) -> Result<Vec<Step>, Refused> {
    let Some(visit) = visits.get(task.visit) else { return Ok(Vec::new()) };
    let thought = found(setup, task, known);
    let access = setup.access(thought.as_ref().unwrap_or(&setup.plan.artefact))?;
    let TouchSettings { standoff_mm, search_mm, .. } = setup.touch;
    let mut steps: Vec<Step> = Vec::new();
    for index in &task.balls {
        let Some(ball) = setup.balls.balls.get(*index) else { continue };
        let centre_mm = known.centre(setup, *index, task.visit).into();
        let expected = Ball { centre_mm, ..ball.clone() };
        let approach = match task.pass {
            Pass::Find => setup.search(known.uncertainty_mm(setup)),
            Pass::Slow | Pass::Watch | Pass::Reference => Approach::Slow { standoff_mm, search_mm },
        };
        let kind = if task.pass == Pass::Reference { StepKind::Reference } else { StepKind::Touch };
        let label = |touch: &str| {
            let (pass, indexation, touch) = (task.pass, task.number as u32, touch.to_owned());
            Label { pass, indexation, ball: ball.id.clone(), touch }.to_string()
        };
        let wanted = setup.task(&expected, &visit.at, approach);
        let new = access.steps(&wanted, &setup.plan.probe, kind, (0, 0), label);
        let new = new.map_err(|why| refused(setup, visit, ball, &why))?;
        let around = visit.around.get(index).filter(|_| task.pass == Pass::Slow);
        steps.extend(around.copied().unwrap_or_default().applied(new));
    }
    Ok(steps)
}

fn refused(setup: &MeasurementSetup<'_>, visit: &Visit, ball: &Ball, why: &Unreachable) -> Refused {
    let instead = match why {
        Unreachable::TooLong { .. } => format!(
            "lower uncertainty_mm of [artefact] ({} mm): set the artefact up nearer to where the file \
             says, or take its place from a first probing by hand",
            setup.balls.uncertainty_mm
        ),
        _ => "take the position out of tilt_deg and turn_deg, or set the ball up elsewhere"
            .to_owned(),
    };
    Refused { why: format!("ball {} at {}: {why}", ball.id, describe_position(&visit.at)), instead }
}

/// The first round of references or of the watch again, at exactly the same places.
fn again(setup: &MeasurementSetup<'_>, task: &Task) -> Vec<Step> {
    let label = |step: &Step| step.label.parse::<Label>().ok();
    let of_first = |step: &&Step| {
        label(step).is_some_and(|label| label.pass == task.pass && label.indexation == 0)
    };
    let renumbered = |step: &Step| {
        let label = Label { indexation: task.number as u32, ..label(step)? };
        Some(Step { label: label.to_string(), ..step.clone() })
    };
    setup.plan.steps.iter().filter(of_first).filter_map(renumbered).collect()
}

/// The artefact with the balls at their found positions. `None` until all balls are found, because only the
/// stated positions are known until then.
fn found(setup: &MeasurementSetup<'_>, task: &Task, known: &FoundBalls) -> Option<Artefact> {
    if !known.all() {
        return None;
    }
    let settings = setup.touch;
    let uncertainty_mm = match task.pass {
        Pass::Find => known.uncertainty_mm(setup),
        _ => settings.found_within_mm(),
    };
    let balls = setup.balls.balls.iter().enumerate().map(|(index, ball)| {
        let centre_mm = known.centre(setup, index, task.visit).into();
        Ball { centre_mm, ..ball.clone() }
    });
    Some(Artefact::Balls(Balls { balls: balls.collect(), uncertainty_mm, ..setup.balls.clone() }))
}
