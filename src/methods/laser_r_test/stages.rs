//! What is scanned, stage by stage, and where the sphere is known to be by then.

use glam::DVec3;

use super::bench::Bench;
use super::cross::{Place, Wanted, step};
use super::group::{Grouped, grouped};
use super::label::Pass;
use super::model::{Model, Problem, Sight, placed};
use super::observe::observe;
use super::parameters;
use crate::base::Position;
use crate::estimation::null_names::name_null_space;
use crate::methods::Refused;
use crate::record::artefact::{Artefact, Ball, Balls};
use crate::record::plan::{Stage, Step};
use crate::record::reading::Reading;

/// How far the zero point may be from where it is stated, while it is not known better, mm.
const ZERO_DOUBT_MM: f64 = 1.0;
/// Assumed standard uncertainty of a centre while the measurement goes on, mm.
const CENTRE_MM: f64 = 1e-3;
/// Heights beside the middle of the range, in parts of its half.
const HEIGHTS: [f64; 3] = [-0.7, 0.0, 0.7];

/// One stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    pub name: &'static str,
    pub pass: Pass,
    pub scans: Vec<Wanted>,
}

/// All stages: search, beam direction, zero position from the circles of the axes, all other poses.
///
/// # Errors
/// Positions outside the limits; poses that do not tell the errors apart.
pub fn tasks(bench: &Bench<'_>) -> Result<Vec<Task>, Refused> {
    let middle = middle(bench);
    let pose = |pass: Pass, detail: &str, rotary: Position, height_mm| {
        let label = pass.label(detail, &rotary);
        Wanted { rotary, height_mm, label }
    };
    let poses = |all: Vec<Position>| {
        all.into_iter().map(|at| pose(Pass::Pose, "", at, middle)).collect::<Vec<_>>()
    };
    let (tilted, turned, others) = positions(bench)?;
    let zero = bench.at_zero();
    let every = [vec![zero.clone()], tilted.clone(), turned.clone(), others.clone()].concat();
    check_rank(bench, &every)?;
    let heights = heights_mm(bench).into_iter().enumerate();
    let heights =
        heights.map(|(i, height)| pose(Pass::Height, &(i + 1).to_string(), zero.clone(), height));
    let find = vec![pose(Pass::Find, "", zero.clone(), middle)];
    let mut tasks = vec![
        Task { name: "find the sphere", pass: Pass::Find, scans: find },
        Task { name: "beam direction", pass: Pass::Height, scans: heights.collect() },
        Task { name: "zero position: tilted", pass: Pass::Pose, scans: poses(tilted) },
        Task { name: "zero position: turned", pass: Pass::Pose, scans: poses(turned) },
        Task { name: "poses", pass: Pass::Pose, scans: poses(others) },
    ];
    tasks.retain(|task| !task.scans.is_empty());
    Ok(tasks)
}

type Poses = Vec<Position>;

/// The tilting axis alone, the turning axis alone, both: all but zero. Neighbours are near each other.
fn positions(bench: &Bench<'_>) -> Result<(Poses, Poses, Poses), Refused> {
    let [tilt, turn] = bench.positions()?;
    let zero = bench.at_zero();
    let at = |axis: Option<crate::base::Axis>, degrees: f64, from: &Position| match axis {
        Some(axis) => from.clone().with(axis, axis.from_edge(degrees)),
        None => from.clone(),
    };
    let split = |of: Option<(crate::base::Axis, Vec<f64>)>| match of {
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
        // There and back: the table need not turn all the way again.
        if row % 2 == 0 { others.extend(row_of) } else { others.extend(row_of.into_iter().rev()) }
    }
    Ok((tilted, turned, others))
}

fn middle(bench: &Bench<'_>) -> f64 {
    let [least, most] = bench.sensor.range_mm;
    (least + most) / 2.0
}

fn heights_mm(bench: &Bench<'_>) -> Vec<f64> {
    if !bench.settings.heights_mm.is_empty() {
        return bench.settings.heights_mm.clone();
    }
    let [least, most] = bench.sensor.range_mm;
    HEIGHTS.map(|part| middle(bench) + part * (most - least) / 2.0).to_vec()
}

/// # Errors
/// Poses that leave errors untold.
fn check_rank(bench: &Bench<'_>, poses: &[Position]) -> Result<(), Refused> {
    let settings = bench.settings;
    let chosen = parameters::chosen(&bench.chain, &settings.parameters, &settings.harmonics)?;
    let names = parameters::names(&chosen.parameters, &bench.ball.id);
    let count = chosen.parameters.len();
    let model = Model { chain: bench.chain.clone(), parameters: chosen.parameters };
    let (zero, ball) = (bench.zero(), bench.centre());
    let sights: Vec<Sight> = poses
        .iter()
        .map(|rotary| {
            let xyz = parameters::expected(&bench.chain, rotary, zero, ball)?;
            Ok(Sight { at: placed(rotary, xyz), weight: glam::DMat3::IDENTITY })
        })
        .collect::<Result<_, Refused>>()?;
    let mut x = vec![0.0; count];
    x.extend(zero.to_array());
    x.extend(ball.to_array());
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

/// The stage of a task, its steps numbered on from the plan's last.
///
/// # Errors
/// As [`step`].
pub fn stage(
    bench: &Bench<'_>,
    task: &Task,
    place: &Place,
    id: u32,
) -> Result<(Stage, Vec<Step>), Refused> {
    let first = bench.plan.steps.iter().map(|step| step.id + 1).max().unwrap_or(0);
    let doubt_mm = match task.pass {
        Pass::Find => bench.balls.uncertainty_mm,
        _ => bench.settings.margin_mm,
    };
    let place = Place { doubt_mm, ..*place };
    let numbered = (first..).zip(&task.scans);
    let steps = numbered.map(|(number, wanted)| {
        step(bench, &place, wanted).map(|step| Step { id: number, stage: id, ..step })
    });
    let steps: Vec<Step> = steps.collect::<Result<_, _>>()?;
    let found = (task.pass != Pass::Find).then(|| found(bench, &place));
    let ids = steps.iter().map(|step| step.id).collect();
    Ok((Stage { id, name: task.name.to_owned(), repeat: 0, steps: ids, found }, steps))
}

fn found(bench: &Bench<'_>, place: &Place) -> Artefact {
    let moved = |ball: &Ball| match ball.id == bench.ball.id {
        true => Ball { centre_mm: place.ball.to_array(), ..ball.clone() },
        false => ball.clone(),
    };
    let balls = bench.balls.balls.iter().map(moved).collect();
    let uncertainty_mm = match bench.balls.balls.len() {
        1 => place.doubt_mm.min(bench.balls.uncertainty_mm),
        _ => bench.balls.uncertainty_mm,
    };
    Artefact::Balls(Balls { balls, lengths: bench.balls.lengths.clone(), uncertainty_mm })
}

/// As stated.
pub fn nominal(bench: &Bench<'_>) -> Place {
    let (zero, beam, ball) = (bench.zero(), bench.beam(), bench.centre());
    Place { zero, beam, ball, doubt_mm: 0.0 }
}

/// From what was measured so far, by the nominal machine: sphere, zero point and beam, each as far as
/// the readings tell it.
///
/// # Errors
/// Readings in which the sphere is not seen.
pub fn known(bench: &Bench<'_>, readings: &[Reading]) -> Result<Place, Refused> {
    let nominal = nominal(bench);
    if readings.is_empty() {
        return Ok(nominal);
    }
    let refused = |why: String| Refused {
        why,
        instead: "check the sphere and the sensor, and start a new run".to_owned(),
    };
    let mut observed = observe(bench, readings).map_err(|why| refused(why.to_string()))?;
    let Grouped { groups, centres, .. } = grouped(bench, &mut observed)?;
    let fitted = centres.solve().map_err(|why| refused(why.to_string()))?;
    let sights = groups.iter().enumerate().map(|(i, group)| {
        let at = placed(&group.rotary, group.axes(centres.centre(&fitted.x, i)));
        Sight { at, weight: glam::DMat3::IDENTITY / CENTRE_MM }
    });
    let problem = Problem {
        model: Model { chain: bench.chain.clone(), parameters: Vec::new() },
        sights: sights.collect(),
        hold: Some((nominal.zero, ZERO_DOUBT_MM)),
    };
    let start = [nominal.zero.to_array(), nominal.ball.to_array()].concat();
    let solved = problem.solve(start).map_err(|why| refused(why.to_string()))?;
    let place = Place {
        zero: problem.model.zero(&solved.x),
        beam: centres.beam(&fitted.x),
        ball: problem.model.ball(&solved.x),
        doubt_mm: 0.0,
    };
    check_place(bench, &place)?;
    Ok(place)
}

/// The sphere may be no further from where it is stated than is stated.
fn check_place(bench: &Bench<'_>, place: &Place) -> Result<(), Refused> {
    let away = (place.ball - bench.centre()).length() + (place.zero - bench.zero()).length();
    let limit = 2.0 * bench.balls.uncertainty_mm + ZERO_DOUBT_MM;
    if away <= limit && DVec3::is_finite(place.ball) {
        return Ok(());
    }
    Err(Refused {
        why: format!(
            "the sphere seems to stand {away:.2} mm from its stated place, beyond {limit} mm: \
             uncertainty_mm of [artefact] and what zero_mm may be off"
        ),
        instead: "check centre_mm of the sphere and zero_mm of the sensor".to_owned(),
    })
}
