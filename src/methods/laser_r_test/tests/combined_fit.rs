//! The two fits combined in one observation model.

use faer::Mat;

use super::simulated_machine::{simulate_run, table_5_machine};
use super::{ideal_plan, settings_with_few_trials};
use crate::identification::{NonlinearFit, ObservationModel};
use crate::laser_r_test::combined_fit::{CombinedFit, observation_sensitivities};
use crate::laser_r_test::identify::identify_scans;
use crate::laser_r_test::setup::LaserSetup;

/// A change of at most 0.1 µm with alternating size and sign over the dwell points: the first-order response equals
/// the change of the solution, including its sign.
#[test]
fn linear_response_equals_the_change_of_the_solution() {
    let (plan, _, readings) =
        simulate_run(ideal_plan(0.5), &settings_with_few_trials(), &table_5_machine(0.5, 1), 9).unwrap();
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let result = identify_scans(&setup, &readings).unwrap();
    let centres = NonlinearFit { equation: &result.grouped.centre_equations, minimum: &result.centre_fit };
    let model = CombinedFit {
        centre_gain_matrix: &observation_sensitivities(&centres),
        centre_fit: centres,
        machine_fit: NonlinearFit { equation: &result.machine_equations, minimum: &result.machine_fit },
        groups: &result.grouped.groups,
        latency_unknown_count: 2,
    };
    let count = model.observation_count();
    let change: Vec<f64> = (0..count).map(|i| 1e-4 * (0.7 * i as f64).sin()).collect();
    let response = model.linear_response(&change);
    assert_eq!(response.residual_changes.len(), result.machine_fit.residuals.len());
    let changes = Mat::from_fn(2, count, |trial, i| trial as f64 * change[i]);
    let x = model.unknowns_for_each_perturbation(changes.as_ref());
    let mut largest = 0.0_f64;
    for (j, first_order) in response.unknown_changes.iter().enumerate() {
        let moved = x[(1, j)] - x[(0, j)];
        let u = result.identification.parameter_uncertainty(j).map_or(f64::EPSILON, |of| of.u);
        println!("{j}: {moved:e}, first order {first_order:e}, u {u:e}");
        assert!((moved - first_order).abs() <= 1e-3 * u, "{j}: {moved} {first_order}");
        largest = largest.max(first_order.abs() / u);
    }
    assert!(largest > 0.01, "{largest}");
}
