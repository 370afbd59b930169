//! The two fits combined in one observation model.

use faer::Mat;

use super::played::{run, table_5_machine};
use super::{ideal, settings};
use crate::identification::{LeastSquares, ObservationModel};
use crate::laser_r_test::combined_fit::{CentresThenMachine, observation_sensitivities};
use crate::laser_r_test::identify::identify_scans;
use crate::laser_r_test::setup::LaserSetup;

/// A change of at most 0.1 µm with alternating size and sign over the dwell points: the first-order response equals
/// the change of the solution, including its sign.
#[test]
fn regress_the_response_has_the_sign_of_the_near_solution() {
    let (plan, _, readings) = run(ideal(0.5), &settings(), &table_5_machine(0.5, 1), 9).unwrap();
    let own = settings();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let result = identify_scans(&setup, &readings).unwrap();
    let centres = LeastSquares { equation: &result.grouped.centres, minimum: &result.centre_fit };
    let model = CentresThenMachine {
        centre_gain: &observation_sensitivities(&centres),
        centres,
        machine: LeastSquares { equation: &result.machine_equations, minimum: &result.machine_fit },
        groups: &result.grouped.groups,
        latency_unknown_count: 2,
    };
    let count = model.observation_count();
    let change: Vec<f64> = (0..count).map(|i| 1e-4 * (0.7 * i as f64).sin()).collect();
    let response = model.linear_response(&change);
    assert_eq!(response.residuals.len(), result.machine_fit.residuals.len());
    let changes = Mat::from_fn(2, count, |trial, i| trial as f64 * change[i]);
    let x = model.solve_each_perturbation(changes.as_ref());
    let mut largest = 0.0_f64;
    for (j, first_order) in response.unknowns.iter().enumerate() {
        let moved = x[(1, j)] - x[(0, j)];
        let u = result.identification.uncertainty(j).map_or(f64::EPSILON, |of| of.u);
        println!("{j}: {moved:e}, first order {first_order:e}, u {u:e}");
        assert!((moved - first_order).abs() <= 1e-3 * u, "{j}: {moved} {first_order}");
        largest = largest.max(first_order.abs() / u);
    }
    assert!(largest > 0.01, "{largest}");
}
