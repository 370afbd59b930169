//! Which stage comes next: the tasks of a design, one stage each.

mod known;
mod review;

#[cfg(test)]
mod tests;

pub use self::known::Known;
pub use self::review::review;

use super::design::{Bench, Visit, in_words};
use super::label::{Label, Pass};
use super::settings::{Find, Settings};
use crate::Refused;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Plan, Stage, Step, StepKind};
use planning::{Approach, Unreachable, staged_blocks};

/// One stage: a pass over balls at one indexation.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    pub pass: Pass,
    /// Number of the visit in the labels; of a reference its round.
    pub number: usize,
    /// The visit whose indexation it is.
    pub visit: usize,
    pub balls: Vec<usize>,
}

/// All tasks in measuring order. First every ball is searched for, at the indexation that shows most
/// and, for those it does not show, at others; then follow the visits.
pub fn tasks(bench: &Bench<'_>, visits: &[Visit]) -> Vec<Task> {
    let searches = searches(visits);
    let task = |pass, number: usize, balls: &[usize]| Task {
        pass,
        number,
        visit: number,
        balls: balls.to_vec(),
    };
    let every = bench.settings.find == Find::Every;
    let mut tasks: Vec<Task> = searches
        .iter()
        .map(|(visit, new)| {
            let all =
                visits.get(*visit).map_or(new, |visit| if every { &visit.balls } else { new });
            task(Pass::Find, *visit, all)
        })
        .collect();
    let reference = |round: usize| {
        let (visit, balls) = searches.first().filter(|_| bench.settings.references)?;
        let ball = *balls.first()?;
        Some(Task { pass: Pass::Reference, number: round, visit: *visit, balls: vec![ball] })
    };
    tasks.extend(reference(0));
    for (number, visit) in visits.iter().enumerate() {
        if number > 0 && number == visits.len() / 2 {
            tasks.extend(reference(1));
        }
        let mut slow = task(Pass::Slow, number, &visit.balls);
        if every && !searches.iter().any(|(searched, _)| *searched == number) {
            tasks.push(task(Pass::Find, number, &visit.balls));
            // Back the way that the search has come.
            slow.balls.reverse();
        }
        tasks.push(slow);
    }
    tasks.extend(reference(2));
    tasks
}

/// Visits that together show every ball, and which are new there.
fn searches(visits: &[Visit]) -> Vec<(usize, Vec<usize>)> {
    let mut found: Vec<usize> = Vec::new();
    let mut searches = Vec::new();
    loop {
        let new = |visit: &Visit| -> Vec<usize> {
            visit.balls.iter().copied().filter(|ball| !found.contains(ball)).collect()
        };
        // The first of equals.
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

/// Machine time of the visits, every ball found where it is stated, s.
///
/// # Errors
/// What cannot be planned.
pub fn machine_time_s(bench: &Bench<'_>, visits: &[Visit]) -> Result<f64, Refused> {
    let mut plan = Plan { steps: Vec::new(), ..bench.plan.clone() };
    let mut stages = Vec::new();
    for (id, task) in (0..).zip(tasks(bench, visits)) {
        let grown = bench.with(&plan);
        let (planned, steps) = stage(&grown, visits, &task, &Known::nominal(&grown), id)?;
        plan.steps.extend(steps);
        stages.push(planned);
    }
    Ok(staged_blocks(&plan, &stages)?.1)
}

/// The steps of a task, numbered on from the plan's, and its stage.
///
/// # Errors
/// What cannot be touched.
pub fn stage(
    bench: &Bench<'_>,
    visits: &[Visit],
    task: &Task,
    known: &Known,
    id: u32,
) -> Result<(Stage, Vec<Step>), Refused> {
    let mut steps = match task.pass {
        Pass::Reference if task.number > 0 => again(bench, task),
        _ => new_steps(bench, visits, task, known)?,
    };
    let first = bench.plan.steps.len();
    for (index, step) in steps.iter_mut().enumerate() {
        (step.id, step.stage) = ((first + index) as u32, id);
    }
    let stage = Stage {
        id,
        name: name(bench, visits, task),
        repeat: 0,
        steps: steps.iter().map(|step| step.id).collect(),
        found: found(bench, task, known),
    };
    Ok((stage, steps))
}

fn name(bench: &Bench<'_>, visits: &[Visit], task: &Task) -> String {
    let at = visits.get(task.visit).map_or(String::new(), |visit| in_words(&visit.at));
    match task.pass {
        Pass::Find => format!("find at {at} ({} of {})", task.number + 1, visits.len()),
        Pass::Slow => format!("measure at {at} ({} of {})", task.number + 1, visits.len()),
        Pass::Reference => {
            let ball = task.balls.first().and_then(|ball| bench.balls.balls.get(*ball));
            format!("reference: ball {}", ball.map_or("", |ball| &ball.id))
        }
    }
}

fn new_steps(
    bench: &Bench<'_>,
    visits: &[Visit],
    task: &Task,
    known: &Known,
) -> Result<Vec<Step>, Refused> {
    let Some(visit) = visits.get(task.visit) else { return Ok(Vec::new()) };
    let thought = found(bench, task, known);
    let access = bench.access(thought.as_ref().unwrap_or(&bench.plan.artefact))?;
    let Settings { standoff_mm, search_mm, .. } = *bench.settings;
    let mut steps: Vec<Step> = Vec::new();
    for index in &task.balls {
        let Some(ball) = bench.balls.balls.get(*index) else { continue };
        let centre_mm = known.centre(bench, *index, task.visit).into();
        let expected = Ball { centre_mm, ..ball.clone() };
        let approach = match task.pass {
            Pass::Find => bench.search(known.uncertainty_mm(bench)),
            Pass::Slow | Pass::Reference => Approach::Slow { standoff_mm, search_mm },
        };
        let kind = if task.pass == Pass::Reference { StepKind::Reference } else { StepKind::Touch };
        let label = |touch: &str| {
            let (pass, indexation, touch) = (task.pass, task.number as u32, touch.to_owned());
            Label { pass, indexation, ball: ball.id.clone(), touch }.to_string()
        };
        let wanted = bench.task(&expected, &visit.at, approach);
        let new = access.steps(&wanted, &bench.plan.probe, kind, (0, 0), label);
        steps.extend(new.map_err(|why| refused(bench, visit, ball, &why))?);
    }
    Ok(steps)
}

fn refused(bench: &Bench<'_>, visit: &Visit, ball: &Ball, why: &Unreachable) -> Refused {
    let instead = match why {
        Unreachable::TooLong { .. } => format!(
            "lower uncertainty_mm of [artefact] ({} mm): set the artefact up nearer to where the file \
             says, or take its place from a first probing by hand",
            bench.balls.uncertainty_mm
        ),
        _ => "take the position out of tilt_deg and turn_deg, or set the ball up elsewhere"
            .to_owned(),
    };
    Refused { why: format!("ball {} at {}: {why}", ball.id, in_words(&visit.at)), instead }
}

/// The first round of the references once more: the very same places.
fn again(bench: &Bench<'_>, task: &Task) -> Vec<Step> {
    let label = |step: &Step| step.label.parse::<Label>().ok();
    let of_first = |step: &&Step| {
        label(step).is_some_and(|label| label.pass == Pass::Reference && label.indexation == 0)
    };
    let renumbered = |step: &Step| {
        let label = Label { indexation: task.number as u32, ..label(step)? };
        Some(Step { label: label.to_string(), ..step.clone() })
    };
    bench.plan.steps.iter().filter(of_first).filter_map(renumbered).collect()
}

/// The balls where they were found. Slow touches set out from their standoff: half of it is granted to
/// what the balls still stray from there. Before all of them are found nothing better is known than
/// what is stated.
fn found(bench: &Bench<'_>, task: &Task, known: &Known) -> Option<Artefact> {
    if !known.all() {
        return None;
    }
    let settings = bench.settings;
    let uncertainty_mm = match task.pass {
        Pass::Find => known.uncertainty_mm(bench),
        _ => settings.standoff_mm.min(settings.search_mm) / 2.0,
    };
    let balls = bench.balls.balls.iter().enumerate().map(|(index, ball)| {
        let centre_mm = known.centre(bench, index, task.visit).into();
        Ball { centre_mm, ..ball.clone() }
    });
    let lengths = bench.balls.lengths.clone();
    Some(Artefact::Balls(Balls { balls: balls.collect(), lengths, uncertainty_mm }))
}
