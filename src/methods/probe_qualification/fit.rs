//! Scatter within a direction, and the weighted fit.

use faer::Mat;

use super::bench::QualificationSetup;
use super::layout::Layout;
use super::observe::Observed;
use super::outputs;
use super::sources::{Scatter, sources};
use crate::identification::{
    FitFigures, Identification, LinearFit, Measurement, Solution, identify,
};
use crate::{IdentifyError, Refused};
use estimation::linear::{self, LinearProblem, LinearSolution, RANK_THRESHOLD, Survey};

pub struct Fitted {
    pub identified: Identification,
    pub layout: Layout,
    pub scatter: Scatter,
    /// Deviation of each touch from the mean of its group, mm.
    pub within_mm: Vec<f64>,
}

/// # Errors
/// The touches do not separate the unknowns, or none is repeated.
pub fn fit(bench: &QualificationSetup<'_>, observed: &Observed) -> Result<Fitted, IdentifyError> {
    let layout = Layout::new(observed, bench.last_order());
    let rows: Vec<Vec<f64>> =
        observed.touches.iter().map(|touch| layout.row(observed, touch)).collect();
    let a = Mat::from_fn(rows.len(), layout.unknowns(), |i, j| rows[i][j]);
    let equal = solve(observed, &layout, &a, 1e-3)?;
    let within_mm = within_groups(observed, &equal.residuals);
    let scatter = scatter(bench, observed, &within_mm)?;
    let u_mm = scatter.u_mm();
    let solution = solve(observed, &layout, &a, u_mm)?;
    let sigma = vec![u_mm; observed.touches.len()];
    let weighted: Vec<f64> = solution.residuals.iter().map(|mm| mm / u_mm).collect();
    let measurements = measurements(observed, &solution.residuals, u_mm);
    let solved = Solution {
        model: &LinearFit { x: &solution.x, a: &a, sigma: &sigma, gain: &solution.gain },
        residuals: &weighted,
        is_declared: true,
        figures: FitFigures::of_linear(&solution),
        measurements: &measurements,
    };
    let sources = sources(bench, &layout, observed, scatter);
    let outputs = outputs::outputs(bench, &layout, &solution.x);
    let identified = identify(&solved, &sources, outputs, None)?;
    Ok(Fitted { identified, layout, scatter, within_mm })
}

fn solve(
    observed: &Observed,
    layout: &Layout,
    a: &Mat<f64>,
    sigma_mm: f64,
) -> Result<LinearSolution, IdentifyError> {
    let y: Vec<f64> = observed.touches.iter().map(|touch| touch.beyond_mm).collect();
    let problem = LinearProblem {
        a: a.as_ref(),
        y: &y,
        sigma: &vec![sigma_mm; y.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let lost = |survey: &Survey| {
        let seen = |unknown: &usize| {
            (0..survey.nullity).any(|k| survey.null_space[(*unknown, k)].abs() > 1e-6)
        };
        (0..layout.unknowns()).filter(seen).map(|unknown| layout.name(unknown)).collect()
    };
    linear::solve(&problem).map_err(|error| IdentifyError::unsolved(error, lost))
}

/// Each residual less the mean of its group. The result is free of systematic model errors of a direction.
fn within_groups(observed: &Observed, residuals: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); observed.groups()];
    for (touch, residual) in observed.touches.iter().zip(residuals) {
        let (sum, count) = &mut sums[touch.group];
        *sum += residual;
        *count += 1.0;
    }
    let mean = |group: usize| sums[group].0 / sums[group].1;
    let touches = observed.touches.iter().zip(residuals);
    touches.map(|(touch, residual)| residual - mean(touch.group)).collect()
}

/// Scatter, pooled over all directions.
fn scatter(
    bench: &QualificationSetup<'_>,
    observed: &Observed,
    within_mm: &[f64],
) -> Result<Scatter, IdentifyError> {
    let dof = within_mm.len() - observed.groups();
    let squares: f64 = within_mm.iter().map(|mm| mm * mm).sum();
    let axes = bench.plan.machine.axes.iter().filter(|(axis, _)| axis.is_linear());
    let step_um = axes.map(|(_, spec)| spec.resolution_um).fold(0.0, f64::max);
    let s_mm = (squares / dof.max(1) as f64).sqrt();
    let scatter = Scatter { s_mm, dof, step_mm: step_um * 1e-3 };
    if dof > 0 && scatter.u_mm() > 0.0 {
        return Ok(scatter);
    }
    Err(Refused::new(
        "the touches of a direction do not scatter at all, or none was repeated",
        "state resolution_um of the axes; if touches still read alike, the readings do not follow the machine",
    )
    .into())
}

fn measurements(observed: &Observed, residuals: &[f64], u_mm: f64) -> Vec<Measurement> {
    let touches = observed.touches.iter().zip(residuals).enumerate();
    let measurement = |(i, (touch, residual)): (usize, (&super::observe::Touch, &f64))| {
        let in_words = format!("the touch {}", touch.label);
        let (label, residual_mm) = (touch.label.clone(), *residual);
        Measurement { label, in_words, rows: i..i + 1, residual_mm, u_mm }
    };
    touches.map(measurement).collect()
}
