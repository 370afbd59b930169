//! The solution in four steps of paper 5, section 2.3: means over the measuring positions and over the balls,
//! a rigid body at each stop, and a trigonometric polynomial through each error motion. For complete visits
//! of balls at equal angles the result equals least squares over all visits; with missing visits it does not
//! (METHODS section 5).

use std::collections::BTreeMap;

use faer::Mat;
use nalgebra::Vector3;

use super::equations::BallObservation;
use super::unknowns_layout::{MOTION_COMPONENTS, TableStop, UnknownsLayout};
use estimation::linear_least_squares::{LinearProblem, RANK_THRESHOLD, solve_least_squares};

/// Error motions and reversal in the order of the layout, from the `deviations` of the observations without
/// drift, mm. `None`: the observations of a stop, or the stops, do not determine them.
pub fn solve_in_four_steps(
    layout: &UnknownsLayout,
    stops: &[TableStop],
    observations: &[BallObservation],
    deviations: &[Vector3<f64>],
) -> Option<Vec<f64>> {
    // 1. Measuring positions: every ball visits each, and the error motions at each have mean zero.
    let places = group_means(observations, deviations, |observation| observation.measuring_position_index);
    let from_place =
        |(observation, value): (&BallObservation, &Vector3<f64>)| value - places[&observation.measuring_position_index];
    let corrected: Vec<Vector3<f64>> = observations.iter().zip(deviations).map(from_place).collect();
    // 2. The plate: each ball over all stops, in the table frame.
    let to_table = |(observation, value): (&BallObservation, &Vector3<f64>)| {
        observation.derivative_by_ball_position.transpose() * value
    };
    let on_table: Vec<Vector3<f64>> = observations.iter().zip(&corrected).map(to_table).collect();
    let balls = group_means(observations, &on_table, |observation| observation.ball_index);
    let from_ball = |(observation, value): (&BallObservation, &Vector3<f64>)| {
        value - observation.derivative_by_ball_position * balls[&observation.ball_index]
    };
    let of_table: Vec<Vector3<f64>> = observations.iter().zip(&corrected).map(from_ball).collect();
    // 3. The plate as a rigid body at each stop: its centre, its plane and its rotation.
    let bodies = fit_rigid_bodies(observations, &of_table);
    let bodies: Vec<[f64; 6]> = (0..stops.len()).map(|stop| bodies.get(&stop).copied()).collect::<Option<_>>()?;
    // 4. A trigonometric polynomial through each motion (Eq. (2)), and the difference between both directions.
    fit_trigonometric_polynomials(layout, stops, &bodies)
}

fn group_means<K: Ord>(
    observations: &[BallObservation],
    values: &[Vector3<f64>],
    key: impl Fn(&BallObservation) -> K,
) -> BTreeMap<K, Vector3<f64>> {
    let mut groups: BTreeMap<K, Vec<Vector3<f64>>> = BTreeMap::new();
    for (observation, value) in observations.iter().zip(values) {
        groups.entry(key(observation)).or_default().push(*value);
    }
    let mean = |values: Vec<Vector3<f64>>| values.iter().sum::<Vector3<f64>>() / values.len() as f64;
    groups.into_iter().map(|(key, values)| (key, mean(values))).collect()
}

/// The six error motions at each stop (key: stop index), fitted without weights to the `values` of the observations;
/// mm and rad. Stops whose balls do not determine them are left out.
pub fn fit_rigid_bodies(
    observations: &[BallObservation],
    values: &[Vector3<f64>],
) -> BTreeMap<usize, [f64; MOTION_COMPONENTS.len()]> {
    let mut of_stop: BTreeMap<usize, Vec<(&BallObservation, &Vector3<f64>)>> = BTreeMap::new();
    for (observation, value) in observations.iter().zip(values) {
        of_stop.entry(observation.stop_index).or_default().push((observation, value));
    }
    let body = |visits: Vec<(&BallObservation, &Vector3<f64>)>| {
        let a = Mat::from_fn(3 * visits.len(), MOTION_COMPONENTS.len(), |i, k| {
            visits[i / 3].0.derivatives_by_error_motion[k][i % 3]
        });
        let y: Vec<f64> = visits.iter().flat_map(|(_, value)| value.iter().copied()).collect();
        solve_unweighted(&a, &y)?.try_into().ok()
    };
    of_stop.into_iter().filter_map(|(stop, visits)| Some((stop, body(visits)?))).collect()
}

/// Unweighted fit of the basis functions, and of the reversal, to each error motion; in the order of the layout.
/// `None`: the stops do not determine the coefficients.
fn fit_trigonometric_polynomials(
    layout: &UnknownsLayout,
    stops: &[TableStop],
    bodies: &[[f64; MOTION_COMPONENTS.len()]],
) -> Option<Vec<f64>> {
    let row = |(i, stop): (usize, &TableStop)| {
        let mut row = layout.angle_basis.function_values(stop.angle, i);
        row.extend(layout.has_reversal.then_some(0.5 * stop.approach_sign));
        row
    };
    let rows: Vec<Vec<f64>> = stops.iter().enumerate().map(row).collect();
    let columns = rows.first().map_or(0, Vec::len);
    let a = Mat::from_fn(rows.len(), columns, |i, j| rows[i][j]);
    let mut x = vec![0.0; MOTION_COMPONENTS.len() * columns];
    for k in 0..MOTION_COMPONENTS.len() {
        let y: Vec<f64> = bodies.iter().map(|body| body[k]).collect();
        let mut found = solve_unweighted(&a, &y)?.into_iter();
        (0..layout.angle_basis.function_count())
            .zip(&mut found)
            .for_each(|(j, value)| x[layout.motion_unknown_index(k, j)] = value);
        found.for_each(|value| x[layout.reversal_unknown_index(k)] = value);
    }
    Some(x)
}

fn solve_unweighted(a: &Mat<f64>, y: &[f64]) -> Option<Vec<f64>> {
    let problem = LinearProblem {
        a: a.as_ref(),
        y,
        sigma: &vec![1.0; y.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    Some(solve_least_squares(&problem).ok()?.x)
}
