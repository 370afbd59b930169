//! Identification: from plan and readings to the estimate.

use super::fit::{solve_equation, survey_rank, weighted_equation};
use super::model::SensorEquations;
use super::nest::SensorNest;
use super::observe::{ObservedMeans, SensorMean, observe_means};
use super::settings::RTestSettings;
use super::sources::uncertainty_sources;
use super::{METHOD_NAME, outputs};
use crate::identification::{
    self, FitQuality, Identification, LeastSquares, Measurement, MisfitAdvice, Solution, TrialPlan, rms,
};
use crate::{IdentifyError, MethodRefusal};
use estimation::nonlinear::NonlinearSolution;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7274_6573;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
const MAX_TRIALS: usize = 20_000;

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "a loose sensor or sphere, backlash of the table, a sensor that is not linear",
    declaring_settings: "noise_um or linearity_um of [[sensor]]",
};

/// # Errors
/// Readings do not belong to the plan or do not separate the unknowns, or a sensor has another direction or gain
/// than declared.
pub fn identify(plan: &Plan, settings: &RTestSettings, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let nest = SensorNest::new(plan, settings)?;
    let observed = observe_means(&nest, readings)?;
    let equation = weighted_equation(&nest, &observed);
    MethodRefusal::require(
        equation.unknowns.stop_count > 0,
        "the table has not turned: the readings contain only the calibration",
        "measure the stage `turns` as well",
    )?;
    let minimum = solve_equation(&equation)?;
    equation.check_sensors(&minimum.x)?;
    let survey =
        survey_rank(&equation, &minimum.x).map_err(|error| IdentifyError::IdentificationFailed(error.to_string()))?;
    let model = LeastSquares { equation: &equation, minimum: &minimum };
    let unknowns = minimum.x.len();
    let weighted = minimum.residuals.iter().zip(&equation.sigma_mm);
    let solution = Solution {
        model: &model,
        residuals: &minimum.residuals,
        has_declared_sizes: nest.sensors.iter().all(|sensor| sensor.noise_um.is_some()),
        figures: FitQuality {
            rank: survey.rank,
            unknowns,
            condition: survey.condition,
            dof: minimum.residuals.len().saturating_sub(unknowns),
            residual_rms_mm: rms(&weighted.map(|(r, sigma)| r * sigma).collect::<Vec<f64>>()),
        },
        measurements: &sensor_measurements(&equation, &minimum),
    };
    let sources = uncertainty_sources(&equation, &minimum.x);
    let trials = TrialPlan::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let outputs = outputs::build_outputs(&equation, &minimum.x);
    let identified = identification::identify(&solution, &sources, outputs, Some(trials))?;
    let axis = nest.axis;
    let at_mm = nest.sphere_position().into();
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
                nest.sphere_position().z
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
        ..identified.estimate(METHOD_NAME).with_displacement_point(at_mm)
    })
}

/// One measurement for the mean of each sensor at each point.
fn sensor_measurements(equation: &SensorEquations<'_>, minimum: &NonlinearSolution) -> Vec<Measurement> {
    let rows = equation.means.iter().zip(&minimum.residuals).zip(&equation.sigma_mm).enumerate();
    let measurement = |(i, ((mean, residual), sigma)): (usize, ((&SensorMean, &f64), &f64))| {
        let label = mean.label.clone();
        let in_words = format!("the mean {label}");
        Measurement { label, description: in_words, rows: i..i + 1, residual_mm: residual * sigma, u_mm: *sigma }
    };
    rows.map(measurement).collect()
}

fn estimate_warnings(
    equation: &SensorEquations<'_>,
    observed: &ObservedMeans,
    identified: &Identification,
) -> Vec<String> {
    let mut lines = Vec::new();
    let missing = observed.missing_points;
    lines.extend((missing > 0).then(|| format!("{missing} points of a sensor have no distance and are not used")));
    let interruptions = equation.unknowns.interruption_count;
    lines.extend((interruptions > 0).then(|| {
        "the measurement was interrupted: a shift during the interruption is attributed to the \
         linear axes; if the nest moved on the table, the result is wrong"
            .to_owned()
    }));
    lines.extend(identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identified.outlier_check.warnings.iter().cloned());
    lines.extend(identified.trials_warning());
    lines
}
