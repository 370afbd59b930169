//! Scans of each stage.

use super::bench::{LaserSetup, RotaryAxisPositions};
use super::cross::{Place, ScanMotion, ScanRequest, step};
use super::label::Pass;
use super::model::{Model, Observation, Problem, placed};
use super::parameters;
use super::settings::SamplingMode;
use super::touches;
use crate::Refused;
use estimation::null_names::name_null_space;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Stage, Step, StepKind};
use machine::{Axis, Position};

/// Heights relative to the middle of the range, in units of half the range.
const HEIGHTS: [f64; 3] = [-0.7, 0.0, 0.7];

/// Scans of one stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    pub name: &'static str,
    pub pass: Pass,
    pub scans: Vec<ScanRequest>,
}

/// Lists all stages: search, latency (continuous scans only), beam direction, zero position from the circles of the
/// axes, all other poses.
///
/// # Errors
/// A position is outside the axis limits, or the poses do not separate the errors.
pub fn tasks(bench: &LaserSetup<'_>) -> Result<Vec<Task>, Refused> {
    let middle = middle(bench);
    let continuous = bench.settings.sampling == SamplingMode::Continuous;
    let usual = if continuous { ScanMotion::Slow } else { ScanMotion::Rests };
    let pose = |pass: Pass, detail: &str, rotary: Position, height_mm| {
        let label = pass.label(detail, &rotary);
        ScanRequest { rotary, height_mm, label, reference: false, walk: usual }
    };
    let poses = |all: Vec<Position>| {
        all.into_iter().map(|at| pose(Pass::Pose, "", at, middle)).collect::<Vec<_>>()
    };
    let (tilted, turned, others) = positions(bench)?;
    let zero = bench.at_zero();
    check_rank(bench, &[std::slice::from_ref(&zero), &tilted, &turned, &others].concat())?;
    // The touch probe has no beam.
    let heights = heights_mm(bench).into_iter().zip(1..).filter(|_| !bench.touches());
    let heights = heights
        .map(|(height, number)| pose(Pass::Height, &format!("{number}"), zero.clone(), height));
    let at_zero = |pass: Pass, which: &str, walk: ScanMotion| ScanRequest {
        walk,
        ..pose(pass, which, zero.clone(), middle)
    };
    let find = vec![at_zero(Pass::Find, "", ScanMotion::Rests)];
    // References use dwell points: the comparison after an interruption must not depend on a latency.
    let reference = |which: &str| {
        vec![ScanRequest { reference: true, ..at_zero(Pass::Pose, which, ScanMotion::Rests) }]
    };
    let feeds =
        [("1", ScanMotion::Slow), ("2", ScanMotion::Fast)].into_iter().filter(|_| continuous);
    let feeds = feeds.map(|(which, walk)| at_zero(Pass::Latency, which, walk)).collect();
    let mut tasks = vec![
        Task { name: "find the sphere", pass: Pass::Find, scans: find },
        Task { name: "latency", pass: Pass::Latency, scans: feeds },
        Task { name: "beam direction", pass: Pass::Height, scans: heights.collect() },
        Task { name: "reference", pass: Pass::Pose, scans: reference("first") },
        Task { name: "zero position: tilted", pass: Pass::Pose, scans: poses(tilted) },
        Task { name: "zero position: turned", pass: Pass::Pose, scans: poses(turned) },
        Task { name: "poses", pass: Pass::Pose, scans: poses(others) },
        Task { name: "reference, again", pass: Pass::Pose, scans: reference("last") },
    ];
    tasks.retain(|task| !task.scans.is_empty());
    Ok(tasks)
}

type Poses = Vec<Position>;

/// All positions except zero: the tilting axis alone, the turning axis alone, both. Consecutive positions are close
/// together.
fn positions(bench: &LaserSetup<'_>) -> Result<(Poses, Poses, Poses), Refused> {
    let [tilt, turn] = bench.positions()?;
    let zero = bench.at_zero();
    let at = |axis: Option<Axis>, degrees: f64, from: &Position| match axis {
        Some(axis) => from.clone().with(axis, axis.from_edge(degrees)),
        None => from.clone(),
    };
    let split = |of: Option<RotaryAxisPositions>| match of {
        Some((axis, mut all)) => {
            all.retain(|degrees| *degrees != 0.0);
            (Some(axis), all)
        }
        None => (None, Vec::new()),
    };
    let ((tilt, tilts), (turn, turns)) = (split(tilt), split(turn));
    let tilted = tilts.iter().map(|b| at(tilt, *b, &zero)).collect();
    let turned = turns.iter().map(|c| at(turn, *c, &zero)).collect();
    let mut others = Vec::new();
    for (row, b) in tilts.iter().enumerate() {
        let tilted = at(tilt, *b, &zero);
        let row_of: Vec<Position> = turns.iter().map(|c| at(turn, *c, &tilted)).collect();
        // Alternate the direction, so that the table does not return by a whole turn.
        if row % 2 == 0 { others.extend(row_of) } else { others.extend(row_of.into_iter().rev()) }
    }
    Ok((tilted, turned, others))
}

fn middle(bench: &LaserSetup<'_>) -> f64 {
    let [least, most] = bench.sensor.range_mm;
    (least + most) / 2.0
}

fn heights_mm(bench: &LaserSetup<'_>) -> Vec<f64> {
    if !bench.settings.heights_mm.is_empty() {
        return bench.settings.heights_mm.clone();
    }
    let [least, most] = bench.sensor.range_mm;
    HEIGHTS.map(|part| middle(bench) + part * (most - least) / 2.0).to_vec()
}

/// # Errors
/// The poses do not determine all errors.
fn check_rank(bench: &LaserSetup<'_>, poses: &[Position]) -> Result<(), Refused> {
    let settings = bench.settings;
    let chosen = parameters::chosen(&bench.chain, &settings.parameters, &settings.harmonics)?;
    let names = parameters::names(&chosen.parameters, &bench.ball.id);
    let count = chosen.parameters.len();
    let model = Model { chain: bench.chain.clone(), parameters: chosen.parameters };
    let (zero, ball) = (bench.zero(), bench.centre());
    let sights: Vec<Observation> = poses
        .iter()
        .map(|rotary| {
            let xyz = parameters::expected(&bench.chain, rotary, zero, ball)?;
            Ok(Observation { at: placed(rotary, xyz), weight: nalgebra::Matrix3::identity() })
        })
        .collect::<Result<_, Refused>>()?;
    let mut x = vec![0.0; count];
    x.extend(&zero);
    x.extend(&ball);
    let survey = Problem { model, sights, hold: None }.survey(&x);
    let survey = survey.map_err(|why| refused_rank(why.to_string()))?;
    if survey.nullity == 0 {
        return Ok(());
    }
    let lost = name_null_space(survey.null_space.as_ref(), &names).join("; ");
    Err(refused_rank(format!(
        "{} poses with the sphere at {:?} mm do not tell all unknowns apart (rank {} of {}): {lost}",
        poses.len(),
        bench.ball.centre_mm,
        survey.rank,
        survey.rank + survey.nullity
    )))
}

fn refused_rank(why: String) -> Refused {
    Refused {
        why,
        instead: "name more positions in tilt_deg and turn_deg, set the sphere up away from the axes, or \
                  take what cannot be told out of parameters and harmonics"
            .to_owned(),
    }
}

/// Creates the stage of a task, with step numbers from `id`.
///
/// # Errors
/// The errors of [`step`].
pub fn stage(
    bench: &LaserSetup<'_>,
    task: &Task,
    place: &Place,
    id: u32,
) -> Result<(Stage, Vec<Step>), Refused> {
    let position_uncertainty_mm = match task.pass {
        Pass::Find => bench.balls.uncertainty_mm,
        _ => bench.settings.margin_mm,
    };
    let place = Place { position_uncertainty_mm, ..*place };
    let mut steps: Vec<Step> = Vec::new();
    for wanted in &task.scans {
        match again(bench, wanted) {
            steps_again if !steps_again.is_empty() => steps.extend(steps_again),
            _ if bench.touches() => steps.extend(touches::steps(bench, &place, task.pass, wanted)?),
            _ => steps.push(step(bench, &place, wanted)?),
        }
    }
    let steps = bench.plan.numbered(id, steps);
    let found = (task.pass != Pass::Find).then(|| found(bench, &place));
    let ids = steps.iter().map(|step| step.id).collect();
    Ok((Stage { id, name: task.name.to_owned(), repeat: 0, steps: ids, found }, steps))
}

/// Repeats the first reference at exactly the same positions.
fn again(bench: &LaserSetup<'_>, wanted: &ScanRequest) -> Vec<Step> {
    let steps = bench.plan.steps.iter();
    let first = steps.filter(|step| wanted.reference && step.kind == StepKind::Reference);
    let relabelled = |step: &Step| {
        let touch = match step.scan {
            Some(_) => String::new(),
            None => step.label.rsplit_once('/').map_or_else(String::new, |(_, t)| format!("/{t}")),
        };
        Step { label: format!("{}{touch}", wanted.label), ..step.clone() }
    };
    first.map(relabelled).collect()
}

fn found(bench: &LaserSetup<'_>, place: &Place) -> Artefact {
    let moved = |ball: &Ball| match ball.id == bench.ball.id {
        true => Ball { centre_mm: place.ball.into(), ..ball.clone() },
        false => ball.clone(),
    };
    let balls = bench.balls.balls.iter().map(moved).collect();
    let uncertainty_mm = match bench.balls.balls.len() {
        1 => place.position_uncertainty_mm.min(bench.balls.uncertainty_mm),
        _ => bench.balls.uncertainty_mm,
    };
    Artefact::Balls(Balls { balls, uncertainty_mm, ..bench.balls.clone() })
}
