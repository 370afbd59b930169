//! The solved equations of a run, without uncertainty.

use nalgebra::{Matrix3, Vector3};

use super::fit::{Bar, Measured, Problem, Seen, vector};
use super::model::{Model, length_mm, length_u_mm};
use super::parameters;
use super::separable::{Way, directions};
use super::settings::Settings;
use super::sources::sources;
use crate::ball_measurement::{Observed, observe, stated_balls};
use crate::identification::{UncertaintySource, block_covariances};
use crate::{IdentifyError, Refused};
use estimation::linear::{LinearError, Survey};
use estimation::nonlinear::{Minimum, NonlinearError};
use estimation::null_names::name_null_space;
use estimation::schur::factor;
use estimation::whitening::whitening;
use machine::kinematics::Chain;
use machine::record::artefact::{Balls, Length};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Minimum standard uncertainty of a measurement in the weights, mm.
const MIN_U_MM: f64 = 1e-6;

pub struct GeometrySolution<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    pub observed: Observed,
    /// The balls that were measured.
    pub balls: Balls,
    pub problem: Problem,
    pub sources: Vec<UncertaintySource>,
    /// Names of all unknowns.
    pub names: Vec<String>,
    pub survey: Survey,
    pub measured: Measured,
    pub minimum: Minimum,
}

/// # Errors
/// The readings do not belong to the plan or do not separate the unknowns; the kinematics of the machine
/// cannot be built.
pub fn solve_geometry<'a>(
    plan: &'a Plan,
    settings: &'a Settings,
    readings: &[Reading],
) -> Result<GeometrySolution<'a>, IdentifyError> {
    let stated = stated_balls(plan)?;
    let mut observed = observe(plan, readings)?;
    if observed.centres.is_empty() {
        return Err(nothing(&observed.left_out, readings).into());
    }
    let balls = seen_balls(stated, &mut observed);
    let model = model(plan, settings, &balls)?;
    let sources = sources(plan, model.chain(), &observed, &balls.lengths);
    let problem = problem(plan, model, &observed, &balls, &sources);
    let names = unknown_names(&problem, &balls);
    let (survey, start) = start(&problem, &of_centres(&observed, &balls.lengths))
        .map_err(|why| failed(why, &names))?;
    // First the spheres are fitted on the nominal machine, then on the identified one.
    let ways = problem.ways(&start.x);
    observed.fit_again(&ways).map_err(|why| IdentifyError::Numerical(why.to_string()))?;
    let measured = of_centres(&observed, &balls.lengths);
    let minimum = problem.solve(&measured, start.x).map_err(|why| failed(why, &names))?;
    Ok(GeometrySolution {
        plan,
        settings,
        observed,
        balls,
        problem,
        sources,
        names,
        survey,
        measured,
        minimum,
    })
}

impl GeometrySolution<'_> {
    /// Degrees of freedom: rows minus unknowns.
    pub fn dof(&self) -> usize {
        self.minimum.residuals.len().saturating_sub(self.problem.unknowns())
    }

    /// Residual of each ball measurement: its position from the identified machine, minus that of the ball;
    /// table frame, mm.
    pub fn misses(&self) -> Vec<Vector3<f64>> {
        let Self { problem, minimum, .. } = self;
        let tips = problem.tips(&minimum.x, &self.measured);
        let ball = |ball| vector(&minimum.x, problem.ball_at(ball));
        self.observed.centres.iter().zip(tips).map(|(sight, tip)| tip - ball(sight.ball)).collect()
    }
}

pub fn of_centres(observed: &Observed, lengths: &[Length]) -> Measured {
    Measured {
        xyz: observed.centres.iter().map(|sight| sight.xyz).collect(),
        lengths: lengths.iter().map(length_mm).collect(),
    }
}

/// Checks the rank of the measurements before the solution, and returns the survey and a first solution.
fn start(problem: &Problem, measured: &Measured) -> Result<(Survey, Minimum), NonlinearError> {
    let start = problem.start(measured);
    let (ideal, _) = factor(problem.rows(&start, &problem.ideal(&start)));
    let survey = ideal.survey()?;
    if survey.nullity > 0 {
        return Err(LinearError::RankDeficient(Box::new(survey)).into());
    }
    Ok((survey, problem.solve(measured, start)?))
}

/// Error for readings from which nothing can be identified, with the reason.
fn nothing(left_out: &[String], readings: &[Reading]) -> Refused {
    let reason = match left_out {
        _ if readings.is_empty() => "there are no readings at all".to_owned(),
        [] => "all of them are of the first search, which only finds the balls".to_owned(),
        [only] => only.clone(),
        [first, others @ ..] => format!("{first}; likewise {} more", others.len()),
    };
    let why = format!("there is no complete measurement of a ball among the readings: {reason}");
    let instead =
        "measure at least the slow touches of one stage, or go on with the run".to_owned();
    Refused { why, instead }
}

/// The model of the machine with the selected errors.
fn model(plan: &Plan, settings: &Settings, balls: &Balls) -> Result<Model, IdentifyError> {
    let refused = |why: String| Refused { why, instead: "correct the machine file".to_owned() };
    let chain = Chain::new(&plan.machine).map_err(|why| refused(why.to_string()))?;
    let stands = parameters::standing(plan, settings, &chain);
    let lengths = directions(balls);
    let way = Way { chain: &chain, stands: &stands, lengths: &lengths };
    let parameters = parameters::chosen(&settings.parameters, way)?;
    Ok(Model::of(chain, parameters, stands, lengths))
}

/// The artefact without the balls that were not measured and their lengths; they are reported in `left_out`.
fn seen_balls(stated: &Balls, observed: &mut Observed) -> Balls {
    let seen = |ball: usize| observed.centres.iter().any(|sight| sight.ball == ball);
    let kept: Vec<usize> = (0..stated.balls.len()).filter(|ball| seen(*ball)).collect();
    let mut balls = stated.clone();
    balls.balls = kept.iter().map(|ball| stated.balls[*ball].clone()).collect();
    let known = |id: &str| balls.balls.iter().any(|ball| ball.id == id);
    balls.lengths.retain(|length| known(&length.from) && known(&length.to));
    for sight in &mut observed.centres {
        sight.ball = kept.partition_point(|ball| *ball < sight.ball);
    }
    let missing = (0..stated.balls.len()).filter(|ball| !kept.contains(ball));
    let ids: Vec<&str> = missing.map(|ball| stated.balls[ball].id.as_str()).collect();
    if !ids.is_empty() {
        observed.left_out.push(format!("not measured: ball {}", ids.join(", ball ")));
    }
    balls
}

/// Sets up the problem. The weights ignore the correlation between measurements that a source changes
/// together.
fn problem(
    plan: &Plan,
    model: Model,
    observed: &Observed,
    balls: &Balls,
    sources: &[UncertaintySource],
) -> Problem {
    let at = |id: &str| balls.balls.iter().position(|ball| ball.id == id);
    let bars = balls.lengths.iter().filter_map(|length| {
        Some(Bar { from: at(&length.from)?, to: at(&length.to)?, u_mm: length_u_mm(length) })
    });
    let least = Matrix3::from_diagonal_element(MIN_U_MM.powi(2));
    let covariances = block_covariances::<3>(sources, observed.centres.len());
    let seen = observed.centres.iter().zip(covariances).map(|(sight, covariance)| Seen {
        place: sight.place,
        ball: sight.ball,
        whitening: whitening(least + covariance),
    });
    let (places, stylus) = (observed.places.clone(), Vector3::from(plan.machine.tool_mm));
    Problem::new(model, places, seen.collect(), bars.collect(), balls.balls.len(), stylus)
}

fn failed(why: NonlinearError, names: &[String]) -> IdentifyError {
    IdentifyError::unsolved(why, |survey| describe_lost(survey, names))
}

/// Names of all unknowns in their order: machine errors by their ISO names, stylus, balls.
pub fn unknown_names(problem: &Problem, balls: &Balls) -> Vec<String> {
    let mut names: Vec<String> =
        problem.model().parameters().iter().map(ToString::to_string).collect();
    let stylus = problem.model().stylus().iter();
    names.extend(stylus.map(|k| format!("tool_{}", ["x", "y", "z"][*k])));
    names.resize(problem.unknowns(), String::new());
    for (ball, named) in balls.balls.iter().enumerate() {
        for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
            names[problem.ball_at(ball) + k] = format!("ball_{}_{axis}", named.id);
        }
    }
    names
}

/// Undetermined directions in words; the uniform scale has its own name.
pub fn describe_lost(survey: &Survey, names: &[String]) -> Vec<String> {
    let lines = name_null_space(survey.null_space.as_ref(), names).into_iter().map(|line| {
        let gains = ["EXX1", "EYY1", "EZZ1"].iter().filter(|name| line.contains(**name)).count();
        if gains > 1 {
            format!("the uniform scale, which a certified length would give: {line}")
        } else {
            line
        }
    });
    lines.collect()
}
