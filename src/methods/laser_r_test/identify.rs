//! Identification: from plan and readings to the estimate.

use nalgebra::{Matrix3, Vector3};

use super::bench::LaserSetup;
use super::group::{Group, Grouped, grouped};
use super::label::Pass;
use super::latency::Latency;
use super::model::{Model, Observation, Problem, placed};
use super::observe::{Observed, observe};
use super::outputs;
use super::parameters;
use super::parts::Parts;
use super::sources::sources;
use super::two_fits::{CentresThenMachine, centre_covariances, gain};
use crate::identification::{
    self, FitFigures, LeastSquares, Measurement, Solution, TrialPlan, mean_u_mm,
};
use crate::{IdentifyError, Refused};
use estimation::linear::{LinearError, Survey};
use estimation::monte_carlo::Trials;
use estimation::nonlinear::{Minimum, NonlinearError};
use estimation::null_names::name_null_space;
use estimation::whitening::whitening;
use machine::frame::unit_vector;
use machine::record::estimate::Estimate;
use machine::record::reading::Reading;

const MONTE_CARLO_SEED: u64 = 0x6c61_7365;
/// Maximum number of trials of the adaptive Monte Carlo propagation. It limits the run time to seconds.
const MAX_TRIALS: usize = 40_000;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;

pub fn identify(bench: &LaserSetup<'_>, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    Ok(outputs::estimate(&parts(bench, readings)?))
}

/// # Errors
/// The readings belong to another plan, are too few, or do not determine the unknowns.
pub fn parts<'a>(
    bench: &'a LaserSetup<'a>,
    readings: &[Reading],
) -> Result<Parts<'a>, IdentifyError> {
    let (observed, grouped, fitted) = spheres(bench, readings)?;
    let settings = bench.settings;
    let chosen = parameters::chosen(&bench.chain, &settings.parameters, &settings.harmonics)?;
    let names = parameters::names(&chosen.parameters, &bench.ball.id);
    let centres = LeastSquares { equation: &grouped.centres, minimum: &fitted };
    let gain = gain(&centres);
    let latency_index = names.len() + grouped.centres.common();
    let sources = sources(bench, &observed, &grouped, &fitted.x, latency_index);
    let covariances = centre_covariances(&grouped.centres, &gain, &sources);
    let sights = sights(&grouped, &fitted.x, covariances);
    let model = Model { chain: bench.chain.clone(), parameters: chosen.parameters.clone() };
    let problem = Problem { model, sights, hold: None };
    let (survey, minimum) = solve(bench, &problem, &names)?;
    let latency = observed.latency.as_ref().map_or_else(Vec::new, Latency::values);
    let x = [&minimum.x, &fitted.x[..grouped.centres.common()], &latency].concat();
    let machine = LeastSquares { equation: &problem, minimum: &minimum };
    let (groups, latency) = (&grouped.groups, latency.len());
    let misses = outputs::misses(&problem, groups, &minimum.x);
    let compared = measurements(&problem, groups, &misses);
    let solution = Solution {
        model: &CentresThenMachine { centres, gain: &gain, machine, groups, latency },
        residuals: &minimum.residuals,
        is_declared: bench.sensor.noise_um.is_some(),
        figures: FitFigures::of_places(&survey, &minimum, &misses),
        measurements: &compared,
    };
    let outputs = outputs::outputs(&problem, &names, observed.latency.as_ref(), &x);
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let plan = TrialPlan { seed: MONTE_CARLO_SEED, trials };
    let identified = identification::identify(&solution, &sources, outputs, Some(plan))?;
    Ok(Parts { bench, observed, grouped, fitted, chosen, problem, minimum, names, identified })
}

/// Fits the sphere's centres and the beam from the samples within the incidence limit.
fn spheres(
    bench: &LaserSetup<'_>,
    readings: &[Reading],
) -> Result<(Observed, Grouped, Minimum), IdentifyError> {
    let mut observed = observe(bench, readings)?;
    let mut grouped = grouped(bench, &mut observed)?;
    check_heights(bench, &observed, &grouped)?;
    let mut fitted = fit(&grouped)?;
    if !bench.touches() && leave_out_oblique(bench, &mut observed, &grouped, &fitted) {
        grouped = super::group::grouped(bench, &mut observed)?;
        check_heights(bench, &observed, &grouped)?;
        fitted = fit(&grouped)?;
    }
    Ok((observed, grouped, fitted))
}

fn fit(grouped: &Grouped) -> Result<Minimum, IdentifyError> {
    let failed = |why: NonlinearError| IdentifyError::Numerical(format!("the spheres: {why}"));
    grouped.centres.solve().map_err(failed)
}

fn check_heights(
    bench: &LaserSetup<'_>,
    observed: &Observed,
    grouped: &Grouped,
) -> Result<(), Refused> {
    let (free, count) = (grouped.centres.free, grouped.heights);
    let of_height: Vec<&str> = observed
        .left_out
        .iter()
        .filter(|line| Pass::of(line) == Some(Pass::Height))
        .map(String::as_str)
        .collect();
    if free || bench.touches() {
        return Ok(());
    }
    let missing = match of_height.as_slice() {
        [] => String::new(),
        lines => format!(" ({})", lines.join("; ")),
    };
    Err(Refused {
        why: format!(
            "the beam's direction needs scans at three heights, there are {count}{missing}; one height \
             leaves it unknown by hundreds of urad"
        ),
        instead: "measure the stage `beam direction` with three heights_mm well apart, at each along two \
                  lines that cross at the pole"
            .to_owned(),
    })
}

/// Removes and counts samples beyond the incidence limit. Returns whether there were any.
fn leave_out_oblique(
    bench: &LaserSetup<'_>,
    observed: &mut Observed,
    grouped: &Grouped,
    fitted: &Minimum,
) -> bool {
    let centres = &grouped.centres;
    let beam = unit_vector(centres.beam(&fitted.x)).unwrap_or_default();
    let mut beyond: Vec<(usize, usize)> = Vec::new();
    for (row, from) in centres.rows.iter().zip(&grouped.from) {
        let towards = -(row.spindle * beam);
        if centres.arm(&fitted.x, row).angle(&towards) > bench.limit() {
            beyond.push(*from);
        }
    }
    // Remove from the end, so that the remaining indices stay valid.
    beyond.sort_unstable_by(|a, b| b.cmp(a));
    for (scan, place) in &beyond {
        let spot = observed.scans[*scan].spots.remove(*place);
        *observed.excluded.entry("beyond the incidence limit").or_default() += spot.samples;
    }
    !beyond.is_empty()
}

/// Observations at the centres of the fit `x`, with their `covariances` in the machine frame.
fn sights(grouped: &Grouped, x: &[f64], covariances: Vec<Matrix3<f64>>) -> Vec<Observation> {
    let groups = grouped.groups.iter().enumerate().zip(covariances);
    let sights = groups.map(|((i, group), covariance)| Observation {
        at: placed(&group.rotary, group.axes(grouped.centres.centre(x, i))),
        weight: whitening(covariance) * group.table,
    });
    sights.collect()
}

/// One measurement for the sphere at each pose.
fn measurements(problem: &Problem, groups: &[Group], misses: &[Vector3<f64>]) -> Vec<Measurement> {
    let all = problem.sights.iter().zip(groups).zip(misses).enumerate();
    let measurement =
        |(i, ((sight, group), miss)): (usize, ((&Observation, &Group), &Vector3<f64>))| {
            Measurement {
                label: group.label.clone(),
                in_words: format!("the sphere at {}", group.label),
                rows: 3 * i..3 * i + 3,
                residual_mm: miss.norm(),
                u_mm: mean_u_mm(&sight.weight),
            }
        };
    all.map(measurement).collect()
}

fn solve(
    bench: &LaserSetup<'_>,
    problem: &Problem,
    names: &[String],
) -> Result<(Survey, Minimum), IdentifyError> {
    let mut start = vec![0.0; problem.model.parameters.len()];
    start.extend(&bench.zero());
    start.extend(&bench.centre());
    let unsolved = |why: NonlinearError| {
        IdentifyError::unsolved(why, |lost| name_null_space(lost.null_space.as_ref(), names))
    };
    let survey = problem.survey(&start).map_err(unsolved)?;
    if survey.nullity > 0 {
        return Err(unsolved(LinearError::RankDeficient(Box::new(survey)).into()));
    }
    let minimum = problem.solve(start).map_err(unsolved)?;
    Ok((survey, minimum))
}
