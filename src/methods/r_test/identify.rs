//! Identification: from plan and readings to the estimate.

use super::model::SensorEquations;
use super::observe::{ObservedMeans, SensorMean, observe_means};
use super::sensor_nest::SensorNest;
use super::settings::RTestSettings;
use super::sources::{observation_standard_uncertainties, uncertainty_sources};
use super::{METHOD_NAME, outputs};
use crate::identification::{
    self, FitQuality, Identification, MeasurementToCheck, MisfitAdvice, NonlinearFit, ObservationEquation, SolvedModel,
    TrialSettings, rms,
};
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::{LinearError, RankAnalysis};
use estimation::nonlinear_least_squares::{NonlinearError, NonlinearSolution, minimise_squares};
use estimation::null_space_names::name_null_space;
use estimation::schur::factorise_and_project_right_side;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7274_6573;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_U_DIGITS: u32 = 1;
/// Maximum number of trials of the adaptive rule (`monte_carlo_trials` = 0).
const MAX_MONTE_CARLO_TRIALS: usize = 20_000;

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "a loose sensor or sphere, backlash of the table, a sensor that is not linear",
    declaring_settings: "noise_um or linearity_um of [[sensor]]",
};

/// # Errors
/// Readings do not belong to the plan or do not separate the unknowns, the turns are not measured, or a sensor has
/// another direction or gain than declared.
pub fn identify(plan: &Plan, settings: &RTestSettings, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let nest = SensorNest::new(plan, settings)?;
    let observed = observe_means(&nest, readings)?;
    let equation = weighted_equations(&nest, &observed);
    MethodRefusal::require(
        equation.unknowns.stop_count > 0,
        "the table has not turned: the readings contain only the calibration",
        "measure the stage `turns` as well",
    )?;
    let minimum = solve_equations(&equation)?;
    equation.check_sensor_directions_and_gains(&minimum.x)?;
    let survey =
        analyse_rank(&equation, &minimum.x).map_err(|error| IdentifyError::IdentificationFailed(error.to_string()))?;
    let unknowns = minimum.x.len();
    let weighted = minimum.residuals.iter().zip(&equation.observation_std_u_mm);
    let solution = SolvedModel {
        model: &NonlinearFit { equation: &equation, minimum: &minimum },
        weighted_residuals: &minimum.residuals,
        has_declared_source_sizes: nest.sensors.iter().all(|sensor| sensor.noise_um.is_some()),
        fit_quality: FitQuality {
            rank: survey.rank,
            unknown_count: unknowns,
            condition_number: survey.condition,
            dof: minimum.residuals.len().saturating_sub(unknowns),
            residual_rms_mm: rms(&weighted.map(|(r, sigma)| r * sigma).collect::<Vec<f64>>()),
        },
        measurements: &sensor_measurements(&equation, &minimum),
    };
    let sources = uncertainty_sources(&equation, &minimum.x);
    let trials =
        TrialSettings::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_U_DIGITS, MAX_MONTE_CARLO_TRIALS);
    let outputs = outputs::build_outputs(&equation, &minimum.x);
    let identified = identification::identify(&solution, &sources, outputs, Some(trials))?;
    let (axis, sphere) = (nest.measured_axis, nest.sphere_position());
    Ok(Estimate {
        gauge: vec![format!(
            "the nest at {axis} 0° is the origin: the error motion at 0° counts as a displacement \
             of the nest, which turns with the table; EZ{axis} is reported without its mean"
        )],
        not_identifiable: [
            format!(
                "EA{axis}, EB{axis}, EC{axis}: three sensors at one point do not measure \
                 rotations; EX{axis} and EY{axis} are valid at the height of the sphere, Z = {:.1} \
                 mm",
                sphere.z
            ),
            format!(
                "harmonics of EX{axis} and EY{axis} at multiples of {n} (the stops of a \
                 revolution): they are part of EX0{axis} and EY0{axis}; an order k is inseparable \
                 from {n} - k",
                n = settings.positions
            ),
        ]
        .into_iter()
        .chain(identified.outlier_check.describe_detection_limits())
        .collect(),
        warnings: estimate_warnings(&equation, &observed, &identified),
        ..identified.estimate(METHOD_NAME).with_displacement_point(sphere.into())
    })
}

/// The equation, weighted by the sources that are independent between observations.
pub fn weighted_equations<'a>(nest: &'a SensorNest<'a>, observed: &'a ObservedMeans) -> SensorEquations<'a> {
    let equation = SensorEquations::unweighted(nest, observed);
    let sigma = observation_standard_uncertainties(&equation);
    SensorEquations { observation_std_u_mm: sigma, ..equation }
}

/// # Errors
/// The means do not separate the unknowns, or the iteration does not converge.
pub fn solve_equations(equation: &SensorEquations<'_>) -> Result<NonlinearSolution, IdentifyError> {
    let sensors: Vec<&str> = equation.nest.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let names = equation.unknowns.unknown_names(&sensors);
    let unsolved = |why: NonlinearError| {
        let lost = |survey: &RankAnalysis| name_null_space(survey.null_space.as_ref(), &names);
        IdentifyError::from_solver_error(why, lost)
    };
    let survey = analyse_rank(equation, &equation.initial_values()).map_err(unsolved)?;
    if survey.nullity > 0 {
        return Err(unsolved(LinearError::RankDeficient(Box::new(survey)).into()));
    }
    let unchanged = vec![0.0; equation.observation_count()];
    let residuals = |x: &[f64]| equation.weighted_residuals(x, &unchanged);
    minimise_squares(equation.initial_values(), |x| equation.row_blocks(x), residuals).map_err(unsolved)
}

fn analyse_rank(equation: &SensorEquations<'_>, x: &[f64]) -> Result<RankAnalysis, NonlinearError> {
    Ok(factorise_and_project_right_side(equation.row_blocks(x)).0.analyse_rank()?)
}

/// One measurement for the mean of each sensor at each point.
fn sensor_measurements(equation: &SensorEquations<'_>, minimum: &NonlinearSolution) -> Vec<MeasurementToCheck> {
    let measurement = |(i, mean): (usize, &SensorMean)| MeasurementToCheck {
        label: mean.label.clone(),
        description: format!("the mean {}", mean.label),
        residual_rows: i..i + 1,
        residual_mm: minimum.residuals[i] * equation.observation_std_u_mm[i],
        u_mm: equation.observation_std_u_mm[i],
        mean_time_s: mean.mean_time_in_run_s,
    };
    equation.means.iter().enumerate().map(measurement).collect()
}

fn estimate_warnings(
    equation: &SensorEquations<'_>,
    observed: &ObservedMeans,
    identified: &Identification,
) -> Vec<String> {
    let mut lines = Vec::new();
    let missing = observed.missing_mean_count;
    lines.extend((missing > 0).then(|| format!("{missing} points of a sensor have no distance and are not used")));
    let interruptions = equation.unknowns.interruption_count;
    lines.extend((interruptions > 0).then(|| {
        "the measurement was interrupted: a shift during the interruption is attributed to the \
         linear axes; if the nest moved on the table, the result is wrong"
            .to_owned()
    }));
    lines.extend(identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identified.outlier_check.warnings.iter().cloned());
    lines.extend(identified.trial_contradiction_warning());
    lines
}
