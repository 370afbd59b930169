//! The fit in the identification core: misfit, first order, trials.

use std::f64::consts::TAU;

use faer::Mat;
use rand_distr::{Distribution, StandardNormal};

use super::super::fit::{Fit, LinearisedFit};
use super::super::model::{Layout, Observation};
use super::super::outputs::{axis_position, dot, outputs};
use super::RoundPart;
use crate::identification::{
    Effect, Identification, InResiduals, Solution, TrialPlan, UncertaintySource, identify, multiply,
};
use crate::self_calibration::design::Design;
use estimation::coverage::{chi_square_bounds, effective_dof};
use estimation::monte_carlo::Trials;
use estimation::random::stream;
use machine::Axis;

const SIGMA_MM: f64 = 1e-3;
const STYLUS_OFFSET_MM: f64 = 2e-3;

/// The fit of an eccentric part, touched with noise of the standard deviation `noise_mm`.
fn noisy_fit(noise_mm: f64, second_order: bool) -> Fit {
    let design = Design { n: 8, probes: vec![0, 1, 2] };
    let part = RoundPart { reach: 48.0, centre: [1.5, -0.8], axis: [0.05, -0.03] };
    let mut noise = StandardNormal.sample_iter(stream(2, &[8]));
    let observations = design.cycle(true).into_iter().map(|touch| {
        let (c, phi) = (touch.c, touch.phi);
        let deviation: f64 = noise.next().unwrap();
        let radius = part.radius(design.angle(c), design.angle(phi)) + noise_mm * deviation;
        Observation { step: 0, height: 0, c, phi, radius, lateral: 0.0, time: 0.0 }
    });
    let observations: Vec<Observation> = observations.collect();
    let sigma = vec![SIGMA_MM; observations.len()];
    let layout = Layout { design, heights: 1, drift_order: 0, gaps: Vec::new() };
    Fit::new(layout, observations, sigma, second_order).unwrap()
}

/// A touch of [`SIGMA_MM`] and a stylus offset in X that does not contribute to the residuals.
fn sources(fit: &Fit) -> [UncertaintySource; 2] {
    let along_x = |seen: &Observation| {
        STYLUS_OFFSET_MM * (TAU * seen.phi as f64 / fit.layout.design.n as f64).cos()
    };
    let offset = Effect::Joint(vec![fit.observations.iter().map(along_x).collect()]);
    [
        UncertaintySource::new("touch", Effect::Each(fit.sigma.clone())),
        UncertaintySource {
            in_residuals: InResiduals::Absent,
            is_in_weights: false,
            ..UncertaintySource::new("stylus offset", offset)
        },
    ]
}

fn identified(fit: &Fit, is_declared: bool, trials: Option<TrialPlan>) -> Identification {
    let residuals = fit.residuals();
    let weighted: Vec<f64> = residuals.iter().map(|residual| residual / SIGMA_MM).collect();
    let (model, figures) = (&LinearisedFit::new(fit), fit.figures(&residuals));
    let solution =
        Solution { model, residuals: &weighted, is_declared, figures, measurements: &[] };
    identify(&solution, &sources(fit), outputs(&fit.layout, Axis::C, &[0.0], &fit.x), trials)
        .unwrap()
}

/// If the uncertainty is contradicted or undeclared, χ² per degree of freedom scales the touches' share of u, the
/// only one with limited degrees of freedom. If it is declared and plausible, nothing is scaled.
#[test]
fn regress_the_residuals_scale_the_touches_alone() {
    for (noise_mm, is_declared) in [(3e-3, true), (3e-3, false), (0.5e-3, false), (1e-3, true)] {
        let fit = noisy_fit(noise_mm, false);
        let identification = identified(&fit, is_declared, None);
        let estimate = identification.estimate("self-calibration");
        let dof = fit.solution.dof as f64;
        let per_dof = fit.solution.chi2 / dof;
        assert!((estimate.chi2_per_dof / per_dof - 1.0).abs() < 1e-10, "{}", estimate.chi2_per_dof);
        let (lower, upper) = chi_square_bounds(dof, 0.998).unwrap();
        let misfit = &identification.propagation.misfit;
        let is_above = is_declared && fit.solution.chi2 > upper;
        assert_eq!((misfit.above, is_above), (is_above, noise_mm > 2e-3 && is_declared));
        assert!(!misfit.below && (fit.solution.chi2 > lower || !is_declared));
        let factor = if is_above || !is_declared { per_dof.sqrt() } else { 1.0 };
        let (c, _) = axis_position(&fit.layout, 0);
        let touch = factor.powi(2) * dot(&c, &multiply(&fit.solution.covariance, &c));
        let [_, stylus] = sources(&fit);
        let offset = dot(&c, &multiply(&fit.solution.gain, stylus.run(0).1)).powi(2);
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
fn regress_a_block_gives_the_unknowns_of_each_trial() {
    let fit = noisy_fit(1e-3, true);
    let mut random = stream(3, &[1]);
    let changes = Mat::from_fn(40, fit.a.nrows(), |trial, _| {
        let deviation: f64 = StandardNormal.sample(&mut random);
        1e-3 * trial as f64 * deviation
    });
    let block = fit.solve_near(changes.as_ref());
    for trial in 0..changes.nrows() {
        let alone = fit.solve_near(changes.subrows(trial, 1));
        assert_eq!(alone.row(0), block.row(trial), "trial {trial}");
    }
    let trials = Some(TrialPlan { seed: 1, trials: Trials::Fixed(2_500) });
    let run = || identified(&fit, true, trials).trials.unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (several, single) = (run(), pool.install(run));
    assert_eq!(several.standard_deviation, single.standard_deviation);
    assert_eq!(several.interval, single.interval);
}
