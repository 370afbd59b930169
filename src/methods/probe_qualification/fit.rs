//! Scatter within a direction, and the weighted fit.

use faer::Mat;

use super::observe::{MeasuredTouch, ObservedTouches};
use super::outputs;
use super::setup::QualificationSetup;
use super::sources::{PooledScatter, uncertainty_sources};
use super::unknowns_layout::UnknownsLayout;
use crate::identification::{FitQuality, Identification, MeasurementToCheck, SolvedLinearFit, SolvedModel, identify};
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::{self, LinearProblem, LinearSolution, RANK_THRESHOLD, RankAnalysis};

pub struct QualificationFit {
    pub identification: Identification,
    pub layout: UnknownsLayout,
    pub scatter: PooledScatter,
    /// Residual of each touch minus the mean residual of its group, from the fit with equal weights, mm.
    pub deviations_from_group_mean_mm: Vec<f64>,
}

/// # Errors
/// The touches do not separate the unknowns, no touch is repeated, or repeated touches do not scatter and no resolution
/// is declared.
pub fn fit_touches(
    setup: &QualificationSetup<'_>,
    observed: &ObservedTouches,
) -> Result<QualificationFit, IdentifyError> {
    let layout = UnknownsLayout::new(observed, setup.highest_order());
    let rows: Vec<Vec<f64>> = observed.touches.iter().map(|touch| layout.design_row(observed, touch)).collect();
    let a = Mat::from_fn(rows.len(), layout.unknown_count(), |i, j| rows[i][j]);
    let equal = solve_unknowns(observed, &layout, &a, 1e-3)?;
    let group_deviations_mm = subtract_group_means(observed, &equal.residuals);
    let scatter = pooled_scatter(setup, observed, &group_deviations_mm)?;
    let u_mm = scatter.touch_std_u_mm();
    let solution = solve_unknowns(observed, &layout, &a, u_mm)?;
    let sigma = vec![u_mm; observed.touches.len()];
    let weighted: Vec<f64> = solution.residuals.iter().map(|mm| mm / u_mm).collect();
    let measurements = touch_measurements(observed, &solution.residuals, u_mm);
    let solved = SolvedModel {
        model: &SolvedLinearFit { x: &solution.x, design_matrix: &a, sigma: &sigma, gain: &solution.gain },
        weighted_residuals: &weighted,
        has_declared_source_sizes: true,
        fit_quality: FitQuality::from_linear(&solution),
        measurements: &measurements,
    };
    let sources = uncertainty_sources(setup, &layout, observed, scatter);
    let outputs = outputs::build_outputs(setup, &layout, &solution.x);
    let identification = identify(&solved, &sources, outputs, None)?;
    Ok(QualificationFit { identification, layout, scatter, deviations_from_group_mean_mm: group_deviations_mm })
}

fn solve_unknowns(
    observed: &ObservedTouches,
    layout: &UnknownsLayout,
    a: &Mat<f64>,
    sigma_mm: f64,
) -> Result<LinearSolution, IdentifyError> {
    let y: Vec<f64> = observed.touches.iter().map(|touch| touch.radial_deviation_mm).collect();
    let problem = LinearProblem {
        a: a.as_ref(),
        y: &y,
        sigma: &vec![sigma_mm; y.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let lost = |survey: &RankAnalysis| {
        let seen = |unknown: &usize| (0..survey.nullity).any(|k| survey.null_space[(*unknown, k)].abs() > 1e-6);
        (0..layout.unknown_count()).filter(seen).map(|unknown| layout.unknown_description(unknown)).collect()
    };
    linear_least_squares::solve_least_squares(&problem).map_err(|error| IdentifyError::from_solver_error(error, lost))
}

/// Each residual less the mean of its group. The result is free of systematic model errors of a direction.
fn subtract_group_means(observed: &ObservedTouches, residuals: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); observed.group_count()];
    for (touch, residual) in observed.touches.iter().zip(residuals) {
        let (sum, count) = &mut sums[touch.group_index];
        *sum += residual;
        *count += 1.0;
    }
    let mean = |group: usize| sums[group].0 / sums[group].1;
    let touches = observed.touches.iter().zip(residuals);
    touches.map(|(touch, residual)| residual - mean(touch.group_index)).collect()
}

/// Scatter within the groups, pooled over all groups. Error: no touch is repeated, or the touches do not scatter and no
/// resolution is declared.
fn pooled_scatter(
    setup: &QualificationSetup<'_>,
    observed: &ObservedTouches,
    group_deviations_mm: &[f64],
) -> Result<PooledScatter, IdentifyError> {
    let dof = group_deviations_mm.len() - observed.group_count();
    let squares: f64 = group_deviations_mm.iter().map(|mm| mm * mm).sum();
    let axes = setup.plan.machine.axes.iter().filter(|(axis, _)| axis.is_linear());
    let step_um = axes.map(|(_, spec)| spec.resolution_um).fold(0.0, f64::max);
    let s_mm = (squares / dof.max(1) as f64).sqrt();
    let scatter = PooledScatter { std_dev_mm: s_mm, dof, control_resolution_mm: step_um * 1e-3 };
    MethodRefusal::require(
        dof > 0 && scatter.touch_std_u_mm() > 0.0,
        "the repeated touches of a direction do not scatter, or no touch was repeated",
        "set resolution_um of the axes; if all touches still have equal readings, check that the readings \
        come from the machine",
    )?;
    Ok(scatter)
}

fn touch_measurements(observed: &ObservedTouches, residuals: &[f64], u_mm: f64) -> Vec<MeasurementToCheck> {
    let measurement = |(i, touch): (usize, &MeasuredTouch)| MeasurementToCheck {
        label: touch.label.clone(),
        description: format!("touch {}", touch.label),
        residual_rows: i..i + 1,
        residual_mm: residuals[i],
        u_mm,
        mean_time_s: touch.time_in_run_s,
    };
    observed.touches.iter().enumerate().map(measurement).collect()
}
