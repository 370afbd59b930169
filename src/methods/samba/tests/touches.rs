//! The Monte Carlo propagation draws ball centres. Drawing touches, fitting each sphere and solving
//! everything again gives the same results.

use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::readings_to_estimate::{FAULTLESS_MEASUREMENT, has_warning, settings_with_2000_trials};
use crate::identification::{NonlinearFit, ObservationEquation};
use crate::samba::fit::GeometryEquations;
use crate::samba::geometry_solution::{GeometrySolution, observed_values, solve_geometry};
use crate::samba::identify::identify;
use estimation::monte_carlo::numerical_tolerance;
use estimation::random::seeded_stream;
use machine::Axis;

/// Much larger than the scatter of any probe, so that the nonlinearity of a sphere fit becomes visible, mm.
const TOUCH_NOISE_STD_MM: f64 = 5e-3;

/// All unknowns with the deviations of one trial, from drawn centres and from drawn touches.
fn solve_trial_by_centres_and_by_touches(solved: &GeometrySolution<'_>, trial: u64) -> [Vec<f64>; 2] {
    let GeometrySolution { problem, measured, minimum, .. } = solved;
    let mut normal = StandardNormal.sample_iter(seeded_stream(7, &[trial]));
    let mut touched = solved.observed.clone();
    let equation = GeometryEquations { problem, measured };
    let mut change = vec![0.0; equation.observation_count()];
    for (i, sight) in touched.centres.iter_mut().enumerate() {
        for touch in &mut sight.touches {
            let deviation: f64 = normal.next().unwrap();
            let shift = touch.centre_gain * (deviation * TOUCH_NOISE_STD_MM);
            change[3 * i..].iter_mut().zip(&shift).for_each(|(change, shift)| *change += shift);
            touch.axis_positions_mm += touch.normal * (deviation * TOUCH_NOISE_STD_MM);
        }
    }
    touched.refit_spheres(&problem.commanded_to_actual_motion_matrices(&minimum.x)).unwrap();
    let touches = observed_values(&touched, &solved.balls.lengths);
    let whole = problem.solve(&touches, minimum.x.clone()).unwrap();
    [NonlinearFit { equation: &equation, minimum }.unknowns_for_changed_observations(&change), whole.x]
}

#[test]
fn touches_drawn_one_by_one_scatter_as_drawn_centres_do() {
    const TRIAL_COUNT: u64 = 1000;
    let (plan, readings) = FAULTLESS_MEASUREMENT.measure();
    let settings = settings_with_2000_trials();
    let solved = solve_geometry(&plan, &settings, &readings).unwrap();
    let trials: Vec<_> =
        (0..TRIAL_COUNT).into_par_iter().map(|trial| solve_trial_by_centres_and_by_touches(&solved, trial)).collect();
    for (i, x) in solved.minimum.x.iter().enumerate() {
        let mean =
            |which: usize| trials.iter().map(|solutions| solutions[which][i] - x).sum::<f64>() / TRIAL_COUNT as f64;
        let u = |which: usize| {
            let squares = trials.iter().map(|solutions| (solutions[which][i] - x).powi(2)).sum::<f64>();
            (squares / TRIAL_COUNT as f64).sqrt()
        };
        let [observed_values, of_touches] = [u(0), u(1)];
        println!(
            "{i}: u {observed_values:.4e} by centres, {:.5} of it by touches; means {:.4} u apart",
            of_touches / observed_values,
            (mean(0) - mean(1)).abs() / observed_values
        );
        // Tolerance: two significant digits of u, JCGM 101, 7.9.2.
        let tolerance = numerical_tolerance(observed_values, 2);
        assert!((observed_values - of_touches).abs() < tolerance, "{i}: {observed_values}, {of_touches}");
        assert!((mean(0) - mean(1)).abs() < tolerance, "{i}");
    }
    assert_ne!(trials[0][0], trials[0][1]);
}

/// The weighted change of a changed centre or length equals that of its residuals, including the sign, except
/// for the errors of the machine.
#[test]
fn weighted_change_equals_change_of_weighted_residuals() {
    let (plan, readings) = FAULTLESS_MEASUREMENT.measure();
    let settings = settings_with_2000_trials();
    let GeometrySolution { problem, measured, minimum, .. } = &solve_geometry(&plan, &settings, &readings).unwrap();
    let equation = GeometryEquations { problem, measured };
    let change: Vec<f64> = (0..equation.observation_count()).map(|i| 1e-3 * (i as f64).sin()).collect();
    let changed = equation.weighted_residuals(&minimum.x, &change);
    let weighted = equation.weighted_residual_change(&change);
    for ((changed, before), weighted) in changed.iter().zip(&minimum.residuals).zip(weighted) {
        assert!((changed - before - weighted).abs() < 1e-3, "{changed} {before} {weighted}");
    }
}

/// A ball that moves before its last measurement or after its first is indistinguishable from a single wrong
/// measurement. The warning states both possibilities, with the correct indexations.
#[test]
fn ball_moved_at_first_or_last_visit_is_named_with_alternative() {
    let visits = |labels: Vec<String>| -> Vec<u32> {
        let mut visits: Vec<u32> = labels.iter().map(|label| label[5..8].parse().unwrap()).collect();
        visits.dedup();
        visits
    };
    let (plan, readings) = FAULTLESS_MEASUREMENT.measure();
    let of_ball = |label: &String| label.contains("/4/");
    let visits = visits(plan.steps.iter().map(|s| s.label.clone()).filter(of_ball).collect());
    let count = visits.len();
    for (off, before, after, which) in [
        (visits[0], visits[0], visits[1], "its first measurement"),
        (visits[count - 1], visits[count - 2], visits[count - 1], "its last measurement"),
    ] {
        let mut moved = readings.clone();
        for reading in &mut moved {
            let label = &plan.steps[reading.step as usize].label;
            if label.starts_with(&format!("slow/{off:03}/4/")) {
                let x = reading.position.get(Axis::X).unwrap() + 0.02;
                reading.position.set(Axis::X, x);
            }
        }
        let estimate = identify(&plan, &settings_with_2000_trials(), &moved).unwrap();
        println!("{:#?}", estimate.warnings);
        let between = format!("indexations {before} and {after}, or {which}");
        assert!(has_warning(&estimate, &["ball 4 probably moved by ", &between]));
        let um = |words: &str| words.split_once("moved by ")?.1.split(' ').next()?.parse().ok();
        let step: f64 = estimate.warnings.iter().find_map(|words| um(words)).unwrap();
        assert!((step - 20.0).abs() < 1.0, "{step} µm");
    }
}
