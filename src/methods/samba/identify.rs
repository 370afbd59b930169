//! Plan + readings → estimate.

use nalgebra::{Matrix3, Vector3};

use super::fit::{Bar, Measured, Problem, Seen};
use super::model::{Model, length_mm, length_u_mm};
use super::observe::{Observed, balls, observe};
use super::outputs;
use super::parameters;
use super::parts::Parts;
use super::separable::{Way, directions};
use super::settings::Settings;
use super::sources::{UncertaintySource, sources, weighting};
use super::suspects::Solved;
use super::uncertainty::{self, Weights, by_covariance, by_trials};
use crate::{IdentifyError, Refused};
use estimation::linear::{LinearError, Survey};
use estimation::monte_carlo::Trials;
use estimation::nonlinear::{Minimum, NonlinearError};
use estimation::null_names::name_null_space;
use estimation::schur::factor;
use estimation::whitening::whitening;
use machine::kinematics::Chain;
use machine::record::artefact::{Balls, Length};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Operations of the adaptive Monte Carlo propagation at most, so that it stays a matter of seconds;
/// but for the trials of the first look at whether it is stable.
const MOST_WORK: usize = 8_000_000_000;
const LEAST_TRIALS: usize = 40_000;
/// Significant digits of u in which the trials shall be stable: JCGM 101, 7.9.2 has one or two. Two of
/// so many unknowns at once would want about a million trials.
const STABLE_DIGITS: u32 = 1;

/// The whole identification of one plan's readings.
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let Found { observed, balls, problem, sources, whitening, names, survey, measured, minimum } =
        found(plan, settings, readings)?;
    let lengths: Vec<&Length> = balls.lengths.iter().collect();
    let u_bars: Vec<f64> = lengths.iter().map(|length| length_u_mm(length)).collect();
    let declared = plan.probe.repeatability_um.is_some();
    let weights = Weights { problem: &problem, whitening: &whitening, u_bars: &u_bars };
    let misfit = uncertainty::misfit(&weights, &minimum, &sources, declared);
    let propagated = by_covariance(&weights, &minimum.factored, &sources, &misfit);
    let trials = trials(settings, &problem, &sources);
    let monte_carlo = by_trials(&problem, &minimum, &measured, &sources, misfit.factor, trials)
        .map_err(|why| IdentifyError::Numerical(why.to_string()))?;
    let solved =
        Solved { problem: &problem, minimum: &minimum, observed: &observed, balls: &balls };
    Ok(outputs::estimate(&Parts {
        plan,
        settings,
        solved,
        measured: &measured,
        names,
        survey,
        misfit,
        propagated,
        monte_carlo,
        lengths: &lengths,
        u_bars: &u_bars,
    }))
}

/// What the measurements say, before anything is said of its uncertainty.
pub struct Found {
    pub observed: Observed,
    balls: Balls,
    pub problem: Problem,
    pub sources: Vec<UncertaintySource>,
    whitening: Vec<Matrix3<f64>>,
    names: Vec<String>,
    survey: Survey,
    pub measured: Measured,
    pub minimum: Minimum,
}

/// # Errors
/// As [`identify`].
pub fn found(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Found, IdentifyError> {
    let stated = balls(plan)?;
    let mut observed = observe(plan, readings)?;
    if observed.sights.is_empty() {
        return Err(nothing(&observed.left_out, readings).into());
    }
    let balls = seen_balls(stated, &mut observed);
    let stylus = Vector3::from(plan.machine.tool_mm);
    let lengths: Vec<&Length> = balls.lengths.iter().collect();
    let model = model(plan, settings, &balls)?;
    let sources = sources(plan, model.chain(), &observed, &lengths);
    let whitening: Vec<Matrix3<f64>> =
        weighting(&sources, observed.sights.len()).into_iter().map(whitening).collect();
    let problem = problem(stylus, model, &observed, &balls, &whitening);
    let names = outputs::names(&problem, &balls);
    let (survey, start) =
        start(&problem, &of_centres(&observed, &lengths)).map_err(|why| failed(why, &names))?;
    // The spheres of a nominal machine, then those of the machine as found.
    let ways = problem.ways(&start.x);
    observed.fit_again(&ways).map_err(|why| IdentifyError::Numerical(why.to_string()))?;
    let measured = of_centres(&observed, &lengths);
    let minimum = problem.solve(&measured, start.x).map_err(|why| failed(why, &names))?;
    Ok(Found { observed, balls, problem, sources, whitening, names, survey, measured, minimum })
}

pub fn of_centres(observed: &Observed, lengths: &[&Length]) -> Measured {
    Measured {
        xyz: observed.sights.iter().map(|sight| sight.xyz).collect(),
        lengths: lengths.iter().map(|length| length_mm(length)).collect(),
    }
}

/// What the measurements can tell, asked before they are believed, and a first solution.
fn start(problem: &Problem, measured: &Measured) -> Result<(Survey, Minimum), NonlinearError> {
    let start = problem.start(measured);
    let (ideal, _) = factor(problem.rows(&start, &problem.ideal(&start)));
    let survey = ideal.survey()?;
    if survey.nullity > 0 {
        return Err(LinearError::RankDeficient(Box::new(survey)).into());
    }
    Ok((survey, problem.solve(measured, start)?))
}

/// Why there is nothing to identify from.
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

/// The machine with the errors that are asked for.
fn model(plan: &Plan, settings: &Settings, balls: &Balls) -> Result<Model, IdentifyError> {
    let refused = |why: String| Refused { why, instead: "correct the machine file".to_owned() };
    let chain = Chain::new(&plan.machine).map_err(|why| refused(why.to_string()))?;
    let stands = parameters::standing(plan, settings, &chain);
    let lengths = directions(balls);
    let way = Way { chain: &chain, stands: &stands, lengths: &lengths };
    let parameters = parameters::chosen(&settings.parameters, way)?;
    Ok(Model::of(chain, parameters, stands, lengths))
}

/// The artefact without the balls that were not measured, and their lengths; said in `left_out`.
fn seen_balls(stated: &Balls, observed: &mut Observed) -> Balls {
    let seen = |ball: usize| observed.sights.iter().any(|sight| sight.ball == ball);
    let kept: Vec<usize> = (0..stated.balls.len()).filter(|ball| seen(*ball)).collect();
    let mut balls = stated.clone();
    balls.balls = kept.iter().map(|ball| stated.balls[*ball].clone()).collect();
    let known = |id: &str| balls.balls.iter().any(|ball| ball.id == id);
    balls.lengths.retain(|length| known(&length.from) && known(&length.to));
    for sight in &mut observed.sights {
        sight.ball = kept.partition_point(|ball| *ball < sight.ball);
    }
    let missing = (0..stated.balls.len()).filter(|ball| !kept.contains(ball));
    let ids: Vec<&str> = missing.map(|ball| stated.balls[ball].id.as_str()).collect();
    if !ids.is_empty() {
        observed.left_out.push(format!("not measured: ball {}", ids.join(", ball ")));
    }
    balls
}

fn problem(
    stylus: Vector3<f64>,
    model: Model,
    observed: &Observed,
    balls: &Balls,
    whitening: &[Matrix3<f64>],
) -> Problem {
    let at = |id: &str| balls.balls.iter().position(|ball| ball.id == id);
    let bars = balls.lengths.iter().filter_map(|length| {
        Some(Bar { from: at(&length.from)?, to: at(&length.to)?, u_mm: length_u_mm(length) })
    });
    let sights = observed.sights.iter().zip(whitening);
    let seen: Vec<Seen> =
        sights.map(|(s, w)| Seen { place: s.place, ball: s.ball, whitening: *w }).collect();
    let (places, count) = (observed.places.clone(), balls.balls.len());
    Problem::new(model, places, seen, bars.collect(), count, stylus)
}

fn failed(why: NonlinearError, names: &[String]) -> IdentifyError {
    match why {
        NonlinearError::Linear(LinearError::RankDeficient(survey)) => {
            IdentifyError::RankDeficient {
                rank: survey.rank,
                unknowns: survey.rank + survey.nullity,
                what: outputs::lost_in_words(name_null_space(survey.null_space.as_ref(), names)),
            }
        }
        other => IdentifyError::Numerical(other.to_string()),
    }
}

fn trials(settings: &Settings, problem: &Problem, sources: &[UncertaintySource]) -> Trials {
    let draws: usize = sources.iter().flat_map(|s| &s.draws).map(|draw| draw.values.len()).sum();
    let work = draws + 100 * problem.rows_count() + 1;
    let max = (MOST_WORK / work).clamp(LEAST_TRIALS, 200_000);
    Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, max)
}
