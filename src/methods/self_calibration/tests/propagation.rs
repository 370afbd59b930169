//! The fit in the identification core: misfit, first order, trials.

use std::f64::consts::TAU;

use faer::Mat;
use rand_distr::{Distribution, StandardNormal};

use super::super::fit::{FitWithSensitivity, SelfCalibrationFit};
use super::super::model::{RadiusObservation, UnknownsLayout};
use super::super::outputs::{axis_position_coefficients, build_outputs};
use super::RoundPart;
use crate::identification::{
    Identification, ObservationEffect, ResidualTreatment, SolvedModel, TrialSettings, UncertaintySource, dot_product,
    identify, multiply_vector,
};
use crate::self_calibration::design::AngleGridDesign;
use estimation::coverage::{chi_square_bounds, effective_dof};
use estimation::monte_carlo::TrialCount;
use estimation::random::seeded_stream;
use machine::Axis;

const TOUCH_SIGMA_MM: f64 = 1e-3;
const STYLUS_OFFSET_STD_U_MM: f64 = 2e-3;

/// The fit of an eccentric part, touched with noise of the standard deviation `noise_mm`.
fn noisy_fit(noise_mm: f64, with_second_order: bool) -> SelfCalibrationFit {
    let design = AngleGridDesign { angle_count: 8, probe_angle_indices: vec![0, 1, 2] };
    let part = RoundPart { contact_radius_mm: 48.0, centre: [1.5, -0.8], axis: [0.05, -0.03] };
    let mut noise = StandardNormal.sample_iter(seeded_stream(2, &[8]));
    let observations = design.cycle_touches(true).into_iter().map(|touch| {
        let (c, phi) = (touch.c_index, touch.phi_index);
        let deviation: f64 = noise.next().unwrap();
        let radius =
            part.measured_radius_mm(design.grid_angle_rad(c), design.grid_angle_rad(phi)) + noise_mm * deviation;
        RadiusObservation {
            step_id: 0,
            height_index: 0,
            c_index: c,
            phi_index: phi,
            along_ray_mm: radius,
            across_ray_mm: 0.0,
            time_s: 0.0,
            relative_time: 0.0,
        }
    });
    let observations: Vec<RadiusObservation> = observations.collect();
    let sigma = vec![TOUCH_SIGMA_MM; observations.len()];
    let layout = UnknownsLayout { design, height_count: 1, drift_order: 0, interruption_times: Vec::new() };
    SelfCalibrationFit::new(layout, observations, sigma, with_second_order).unwrap()
}

/// A touch of [`TOUCH_SIGMA_MM`] and a stylus offset in X that does not contribute to the residuals.
fn touch_and_stylus_sources(fit: &SelfCalibrationFit) -> [UncertaintySource; 2] {
    let along_x = |seen: &RadiusObservation| {
        STYLUS_OFFSET_STD_U_MM * (TAU * seen.phi_index as f64 / fit.layout.design.angle_count as f64).cos()
    };
    let offset = ObservationEffect::Joint(vec![fit.observations.iter().map(along_x).collect()]);
    [
        UncertaintySource::new("touch", ObservationEffect::Independent(fit.sigma.clone())),
        UncertaintySource {
            residual_treatment: ResidualTreatment::ExcludedFromChi2,
            is_in_weights: false,
            ..UncertaintySource::new("stylus offset", offset)
        },
    ]
}

fn identify_fit(fit: &SelfCalibrationFit, has_declared_sizes: bool, trials: Option<TrialSettings>) -> Identification {
    let residuals = fit.residuals();
    let weighted: Vec<f64> = residuals.iter().map(|residual| residual / TOUCH_SIGMA_MM).collect();
    let (model, figures) = (&FitWithSensitivity::new(fit), fit.quality_of_fit(&residuals));
    let solution = SolvedModel {
        model,
        weighted_residuals: &weighted,
        has_declared_source_sizes: has_declared_sizes,
        fit_quality: figures,
        measurements: &[],
    };
    identify(&solution, &touch_and_stylus_sources(fit), build_outputs(&fit.layout, Axis::C, &[0.0], &fit.x), trials)
        .unwrap()
}

/// If the uncertainty is contradicted or undeclared, χ² per degree of freedom scales the touches' share of u, the
/// only one with limited degrees of freedom. If it is declared and plausible, nothing is scaled.
#[test]
fn residuals_scale_only_the_uncertainty_of_the_touches() {
    for (noise_mm, has_declared_sizes) in [(3e-3, true), (3e-3, false), (0.5e-3, false), (1e-3, true)] {
        let fit = noisy_fit(noise_mm, false);
        let identification = identify_fit(&fit, has_declared_sizes, None);
        let estimate = identification.estimate("self-calibration");
        let dof = fit.solution.dof as f64;
        let per_dof = fit.solution.chi2 / dof;
        assert!((estimate.chi2_per_dof / per_dof - 1.0).abs() < 1e-10, "{}", estimate.chi2_per_dof);
        let (lower, upper) = chi_square_bounds(dof, 0.998).unwrap();
        let misfit = &identification.propagation.misfit;
        let is_above = has_declared_sizes && fit.solution.chi2 > upper;
        assert_eq!((misfit.is_above_bound, is_above), (is_above, noise_mm > 2e-3 && has_declared_sizes));
        assert!(!misfit.is_below_bound && (fit.solution.chi2 > lower || !has_declared_sizes));
        let factor = if is_above || !has_declared_sizes { per_dof.sqrt() } else { 1.0 };
        let (c, _) = axis_position_coefficients(&fit.layout, 0);
        let touch = factor.powi(2) * dot_product(&c, &multiply_vector(&fit.solution.covariance, &c));
        let [_, stylus] = touch_and_stylus_sources(&fit);
        let offset = dot_product(&c, &multiply_vector(&fit.solution.gain, stylus.draw_span(0).1)).powi(2);
        let found = &estimate.parameters[0];
        assert!((found.u / (1e3 * (touch + offset).sqrt()) - 1.0).abs() < 1e-10, "{}", found.u);
        assert!((found.budget[0].u / (1e3 * touch.sqrt()) - 1.0).abs() < 1e-10);
        let expected = effective_dof(&[(touch, dof), (offset, f64::INFINITY)]);
        match found.dof {
            Some(found) => assert!((found / expected - 1.0).abs() < 1e-10, "{found}"),
            None => assert_eq!(factor, 1.0),
        }
    }
}

/// A trial depends neither on the other trials of its block nor on the number of threads.
#[test]
fn trials_depend_neither_on_their_block_nor_on_the_threads() {
    let fit = noisy_fit(1e-3, true);
    let mut random = seeded_stream(3, &[1]);
    let changes = Mat::from_fn(40, fit.design_matrix.nrows(), |trial, _| {
        let deviation: f64 = StandardNormal.sample(&mut random);
        1e-3 * trial as f64 * deviation
    });
    let block = fit.unknowns_for_each_perturbation(changes.as_ref());
    for trial in 0..changes.nrows() {
        let alone = fit.unknowns_for_each_perturbation(changes.subrows(trial, 1));
        assert_eq!(alone.row(0), block.row(trial), "trial {trial}");
    }
    let trials = Some(TrialSettings { seed: 1, trial_count: TrialCount::Fixed(2_500) });
    let run = || identify_fit(&fit, true, trials).trial_statistics.unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (several, single) = (run(), pool.install(run));
    assert_eq!(several.standard_deviation, single.standard_deviation);
    assert_eq!(several.symmetric_interval, single.symmetric_interval);
}
