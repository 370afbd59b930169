//! The two fits combined in one observation model.

use faer::Mat;

use super::played::{run, table_5};
use super::{ideal, settings};
use crate::identification::{LeastSquares, ObservationModel};
use crate::laser_r_test::bench::LaserSetup;
use crate::laser_r_test::identify::parts;
use crate::laser_r_test::two_fits::{CentresThenMachine, gain};

/// A change of at most 0.1 µm with alternating size and sign over the dwell points: the first-order response equals
/// the change of the solution, including its sign.
#[test]
fn regress_the_response_has_the_sign_of_the_near_solution() {
    let (plan, _, readings) = run(ideal(0.5), &settings(), &table_5(0.5, 1), 9).unwrap();
    let own = settings();
    let bench = LaserSetup::new(&plan, &own).unwrap();
    let parts = parts(&bench, &readings).unwrap();
    let centres = LeastSquares { equation: &parts.grouped.centres, minimum: &parts.fitted };
    let model = CentresThenMachine {
        gain: &gain(&centres),
        centres,
        machine: LeastSquares { equation: &parts.problem, minimum: &parts.minimum },
        groups: &parts.grouped.groups,
        latency: 2,
    };
    let count = model.observations();
    let change: Vec<f64> = (0..count).map(|i| 1e-4 * (0.7 * i as f64).sin()).collect();
    let response = model.respond(&change);
    assert_eq!(response.residuals.len(), parts.minimum.residuals.len());
    let changes = Mat::from_fn(2, count, |trial, i| trial as f64 * change[i]);
    let x = model.solve_near(changes.as_ref());
    let mut largest = 0.0_f64;
    for (j, first_order) in response.unknowns.iter().enumerate() {
        let moved = x[(1, j)] - x[(0, j)];
        let u = parts.identified.uncertainty(j).map_or(f64::EPSILON, |of| of.u);
        println!("{j}: {moved:e}, first order {first_order:e}, u {u:e}");
        assert!((moved - first_order).abs() <= 1e-3 * u, "{j}: {moved} {first_order}");
        largest = largest.max(first_order.abs() / u);
    }
    assert!(largest > 0.01, "{largest}");
}
