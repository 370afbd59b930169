//! Identification: from plan and readings to the estimate.

use super::fit::{solve, survey, weighted};
use super::model::Equation;
use super::nest::Nest;
use super::observe::{Observed, SensorMean, observed};
use super::settings::Settings;
use super::sources::sources;
use super::{NAME, outputs};
use crate::identification::{
    self, FitFigures, Identification, LeastSquares, Measurement, MisfitAdvice, Solution, TrialPlan,
    rms,
};
use crate::{IdentifyError, Refused};
use estimation::monte_carlo::Trials;
use estimation::nonlinear::Minimum;
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
    declared_by: "noise_um or linearity_um of [[sensor]]",
};

/// # Errors
/// Readings do not belong to the plan or do not separate the unknowns, or a sensor has another direction or gain
/// than declared.
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let nest = Nest::new(plan, settings)?;
    let observed = observed(&nest, readings)?;
    let equation = weighted(&nest, &observed);
    Refused::unless(
        equation.unknowns.stops > 0,
        "the table has not turned: there are readings of the calibration alone",
        "measure the turns as well",
    )?;
    let minimum = solve(&equation)?;
    equation.check_sensors(&minimum.x)?;
    let survey = survey(&equation, &minimum.x)
        .map_err(|error| IdentifyError::Numerical(error.to_string()))?;
    let model = LeastSquares { equation: &equation, minimum: &minimum };
    let unknowns = minimum.x.len();
    let weighted = minimum.residuals.iter().zip(&equation.sigma);
    let compared = measurements(&equation, &minimum);
    let solution = Solution {
        model: &model,
        residuals: &minimum.residuals,
        is_declared: nest.sensors.iter().all(|sensor| sensor.noise_um.is_some()),
        figures: FitFigures {
            rank: survey.rank,
            unknowns,
            condition: survey.condition,
            dof: minimum.residuals.len().saturating_sub(unknowns),
            residual_rms_mm: rms(&weighted.map(|(r, sigma)| r * sigma).collect::<Vec<f64>>()),
        },
        measurements: &compared,
    };
    let sources = sources(&equation, &minimum.x);
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let trials = TrialPlan { seed: MONTE_CARLO_SEED, trials };
    let outputs = outputs::outputs(&equation, &minimum.x);
    let identified = identification::identify(&solution, &sources, outputs, Some(trials))?;
    let axis = nest.axis;
    let at_mm = nest.sphere_position().into();
    Ok(Estimate {
        gauge: vec![format!(
            "the nest at 0° of {axis} is the origin: the error motion at 0° counts as a displacement of the nest, \
             which turns with the table; EZ{axis} is less its mean"
        )],
        not_identifiable: [
            format!(
                "EA{axis}, EB{axis}, EC{axis}: three sensors about one point; EX{axis} and EY{axis} hold at the height of \
             the sphere, Z = {:.1} mm",
                nest.sphere_position().z
            ),
            format!(
                "harmonics of EX{axis} and EY{axis} at multiples of {n} (the stops of a revolution): they stand in EX0{axis} \
                 and EY0{axis}; an order k is not told from {n} - k",
                n = settings.positions
            ),
        ]
        .into_iter()
        .chain(identified.checked.limits())
        .collect(),
        warnings: warnings(&equation, &observed, &identified),
        ..identified.estimate(NAME).displaced_at(at_mm)
    })
}

/// One measurement for the mean of each sensor at each point.
fn measurements(equation: &Equation<'_>, minimum: &Minimum) -> Vec<Measurement> {
    let rows = equation.means.iter().zip(&minimum.residuals).zip(&equation.sigma).enumerate();
    let measurement = |(i, ((mean, residual), sigma)): (usize, ((&SensorMean, &f64), &f64))| {
        let label = mean.label.clone();
        let in_words = format!("the mean {label}");
        Measurement { label, in_words, rows: i..i + 1, residual_mm: residual * sigma, u_mm: *sigma }
    };
    rows.map(measurement).collect()
}

fn warnings(
    equation: &Equation<'_>,
    observed: &Observed,
    identified: &Identification,
) -> Vec<String> {
    let mut lines = Vec::new();
    let missing = observed.missing;
    lines.extend(
        (missing > 0)
            .then(|| format!("{missing} points of a sensor have no distance: they are left out")),
    );
    let interruptions = equation.unknowns.interruptions;
    lines.extend((interruptions > 0).then(|| {
        "the measurement was interrupted: a shift meanwhile is attributed to the linear axes; a nest that has moved on \
         the table falsifies the result"
            .to_owned()
    }));
    lines.extend(identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identified.checked.warnings.iter().cloned());
    lines.extend(identified.trials_warning());
    lines
}
