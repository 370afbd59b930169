//! The solved equations of a run, without uncertainty.

use nalgebra::Vector3;

use super::confounding::COORDINATE_NAMES;
use super::fit::{GeometryProblem, LengthConstraint, ObservedValues, PlannedBallMeasurement, vector_at};
use super::geometry_model::{GeometryModel, length_at_its_temperature_mm, length_u_mm};
use super::settings::SambaSettings;
use super::sources::uncertainty_sources;
use crate::ball_measurement::{ObservedBalls, artefact_balls, ball_index, observe_balls, whitening_matrices};
use crate::identification::UncertaintySource;
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::{LinearError, RankAnalysis};
use estimation::nonlinear_least_squares::{NonlinearError, NonlinearSolution};
use estimation::null_space_names::name_null_space;
use estimation::schur::factorise_and_project_right_side;
use machine::kinematics::KinematicChain;
use machine::record::artefact::{Balls, CertifiedLength};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// The solved equations of a run, without the uncertainty of the solution.
pub struct GeometrySolution<'a> {
    pub plan: &'a Plan,
    pub settings: &'a SambaSettings,
    /// Measured ball centres; their ball indices refer to `balls`. The spheres are fitted on the identified machine.
    pub observed: ObservedBalls,
    /// The balls that were measured, and the certified lengths between them.
    pub balls: Balls,
    pub problem: GeometryProblem,
    pub sources: Vec<UncertaintySource>,
    /// Names of all unknowns, in the order of the unknowns.
    pub unknown_names: Vec<String>,
    /// Rank analysis of the equations at the initial values, for measurements without noise.
    pub rank_analysis: RankAnalysis,
    /// Observed values of the final fit, from the spheres fitted on the identified machine.
    pub measured: ObservedValues,
    /// Solution of the final fit; its residuals are weighted.
    pub minimum: NonlinearSolution,
}

/// # Errors
/// The readings do not belong to the plan, contain no complete measurement of a ball, or do not separate the unknowns;
/// the kinematics of the machine cannot be built.
pub fn solve_geometry<'a>(
    plan: &'a Plan,
    settings: &'a SambaSettings,
    readings: &[Reading],
) -> Result<GeometrySolution<'a>, IdentifyError> {
    let stated = artefact_balls(plan)?;
    let mut observed = observe_balls(plan, readings)?;
    if observed.centres.is_empty() {
        return Err(refuse_no_measurement(&observed.skipped_measurements, readings).into());
    }
    let balls = remove_unmeasured_balls(stated, &mut observed);
    let model = build_model(plan, settings, &balls)?;
    let sources = uncertainty_sources(plan, model.chain(), &observed, &balls.lengths);
    let problem = build_problem(plan, model, &observed, &balls, &sources);
    let names = unknown_names(&problem, &balls);
    let (survey, start) = solve_from_initial_values(&problem, &observed_values(&observed, &balls.lengths))
        .map_err(|why| unsolved_error(why, &names))?;
    // First the spheres are fitted on the nominal machine, then on the identified one.
    let matrices = problem.commanded_to_actual_motion_matrices(&start.x);
    observed.refit_spheres(&matrices).map_err(|why| IdentifyError::IdentificationFailed(why.to_string()))?;
    let measured = observed_values(&observed, &balls.lengths);
    let minimum = problem.solve(&measured, start.x).map_err(|why| unsolved_error(why, &names))?;
    Ok(GeometrySolution {
        plan,
        settings,
        observed,
        balls,
        problem,
        sources,
        unknown_names: names,
        rank_analysis: survey,
        measured,
        minimum,
    })
}

impl GeometrySolution<'_> {
    /// Degrees of freedom: rows minus unknowns.
    pub fn dof(&self) -> usize {
        self.minimum.residuals.len().saturating_sub(self.problem.unknown_count())
    }

    /// Residual of each ball measurement: measured position by the identified machine, minus the fitted position of the
    /// ball; table frame, mm.
    pub fn position_residuals(&self) -> Vec<Vector3<f64>> {
        let Self { problem, minimum, .. } = self;
        let tips = problem.centres_from_measured_axes(&minimum.x, &self.measured);
        let ball = |ball| vector_at(&minimum.x, problem.ball_unknown_index(ball));
        self.observed.centres.iter().zip(tips).map(|(centre, tip)| tip - ball(centre.ball_index)).collect()
    }
}

/// Ball centres as axis positions, and the certified lengths at their temperature, mm.
pub fn observed_values(observed: &ObservedBalls, lengths: &[CertifiedLength]) -> ObservedValues {
    ObservedValues {
        centre_axes_mm: observed.centres.iter().map(|centre| centre.centre_axis_positions_mm).collect(),
        lengths_mm: lengths.iter().map(length_at_its_temperature_mm).collect(),
    }
}

/// Checks the rank of the measurements, and returns the rank analysis and a first solution.
fn solve_from_initial_values(
    problem: &GeometryProblem,
    measured: &ObservedValues,
) -> Result<(RankAnalysis, NonlinearSolution), NonlinearError> {
    let start = problem.initial_values(measured);
    let (ideal, _) =
        factorise_and_project_right_side(problem.row_blocks(&start, &problem.noise_free_observations(&start)));
    let survey = ideal.analyse_rank()?;
    if survey.nullity > 0 {
        return Err(LinearError::RankDeficient(Box::new(survey)).into());
    }
    Ok((survey, problem.solve(measured, start)?))
}

/// Error for readings from which nothing can be identified, with the reason.
fn refuse_no_measurement(skipped_measurements: &[String], readings: &[Reading]) -> MethodRefusal {
    let reason = match skipped_measurements {
        _ if readings.is_empty() => "there are no readings".to_owned(),
        [] => "all readings are of the first search, which only locates the balls".to_owned(),
        [reason] => reason.clone(),
        [first, others @ ..] => format!("{first}; likewise {} more", others.len()),
    };
    MethodRefusal::new(
        format!("the readings contain no complete measurement of a ball: {reason}"),
        "measure at least the slow touches of one stage, or continue the run",
    )
}

/// The model of the machine with the selected errors.
fn build_model(plan: &Plan, settings: &SambaSettings, balls: &Balls) -> Result<GeometryModel, IdentifyError> {
    let chain = KinematicChain::new(&plan.machine)
        .map_err(|why| MethodRefusal::new(why.to_string(), "correct the machine file"))?;
    Ok(GeometryModel::for_plan(chain, plan, settings, balls)?)
}

/// The artefact without the balls that were not measured and their lengths; these balls are added to
/// `skipped_measurements`. The ball indices of `observed` are renumbered.
fn remove_unmeasured_balls(stated: &Balls, observed: &mut ObservedBalls) -> Balls {
    let is_measured = |ball: usize| observed.centres.iter().any(|centre| centre.ball_index == ball);
    let kept: Vec<usize> = (0..stated.balls.len()).filter(|ball| is_measured(*ball)).collect();
    let mut balls = stated.clone();
    balls.balls = kept.iter().map(|ball| stated.balls[*ball].clone()).collect();
    let is_kept = |id: &str| balls.balls.iter().any(|ball| ball.id == id);
    balls.lengths.retain(|length| is_kept(&length.from) && is_kept(&length.to));
    for centre in &mut observed.centres {
        centre.ball_index = kept.partition_point(|ball| *ball < centre.ball_index);
    }
    let missing = (0..stated.balls.len()).filter(|ball| !kept.contains(ball));
    let ids: Vec<&str> = missing.map(|ball| stated.balls[ball].id.as_str()).collect();
    if !ids.is_empty() {
        observed.skipped_measurements.push(format!("not measured: ball {}", ids.join(", ball ")));
    }
    balls
}

/// Sets up the problem. The weights ignore the correlation between measurements that share a source of uncertainty.
fn build_problem(
    plan: &Plan,
    model: GeometryModel,
    observed: &ObservedBalls,
    balls: &Balls,
    sources: &[UncertaintySource],
) -> GeometryProblem {
    let bars = balls.lengths.iter().filter_map(|length| {
        Some(LengthConstraint {
            from_ball: ball_index(balls, &length.from)?,
            to_ball: ball_index(balls, &length.to)?,
            u_mm: length_u_mm(length),
        })
    });
    let whitening = whitening_matrices(sources, observed.centres.len());
    let measurements = observed.centres.iter().zip(whitening).map(|(centre, whitening)| PlannedBallMeasurement {
        rotary_position_index: centre.measured_rotary_position_index,
        ball_index: centre.ball_index,
        whitening,
    });
    let (positions, stylus) = (observed.measured_rotary_positions.clone(), Vector3::from(plan.machine.tool_mm));
    GeometryProblem::new(model, positions, measurements.collect(), bars.collect(), balls.balls.len(), stylus)
}

fn unsolved_error(why: NonlinearError, names: &[String]) -> IdentifyError {
    IdentifyError::from_solver_error(why, |survey| describe_undetermined(survey, names))
}

/// Names of all unknowns in their order: machine errors by their ISO names, stylus, balls.
pub fn unknown_names(problem: &GeometryProblem, balls: &Balls) -> Vec<String> {
    let mut names: Vec<String> = problem.model().parameters().iter().map(ToString::to_string).collect();
    let stylus = problem.model().free_stylus_coordinates().iter();
    names.extend(stylus.map(|k| format!("tool_{}", COORDINATE_NAMES[*k])));
    names.resize(problem.unknown_count(), String::new());
    for (ball, named) in balls.balls.iter().enumerate() {
        for (k, axis) in COORDINATE_NAMES.into_iter().enumerate() {
            names[problem.ball_unknown_index(ball) + k] = format!("ball_{}_{axis}", named.id);
        }
    }
    names
}

/// Undetermined directions in words; the uniform scale has its own name.
pub fn describe_undetermined(survey: &RankAnalysis, names: &[String]) -> Vec<String> {
    let lines =
        name_null_space(survey.null_space.as_ref(), names).into_iter().map(|line| match is_uniform_scale(&line) {
            true => format!("the uniform scale (declare a certified length): {line}"),
            false => line,
        });
    lines.collect()
}

/// Whether an undetermined direction is the uniform scale: its text contains more than one gain.
pub fn is_uniform_scale(direction: &str) -> bool {
    ["EXX1", "EYY1", "EZZ1"].iter().filter(|gain| direction.contains(**gain)).count() > 1
}
