//! The solution in four steps of paper 5, section 2.3: means over the measuring positions and over the balls,
//! a rigid body at each stop, and a trigonometric polynomial through each error motion. For complete visits
//! of balls at equal angles the result equals least squares over all visits; with missing visits it does not
//! (METHODS section 5).

use std::collections::BTreeMap;

use faer::Mat;
use nalgebra::Vector3;

use super::equations::BallObservation;
use super::layout::{COMPONENTS, Layout, Stop};
use estimation::linear::{LinearProblem, RANK_THRESHOLD, solve};

/// Error motions and reversal in the order of the layout, from the `deviations` of the sightings without
/// drift, mm. `None`: the sightings of a stop, or the stops, do not determine them.
pub fn four_steps(
    layout: &Layout,
    stops: &[Stop],
    sightings: &[BallObservation],
    deviations: &[Vector3<f64>],
) -> Option<Vec<f64>> {
    // 1. The measuring positions: every ball visits each, and the mean of the error motions there is zero.
    let places = means(sightings, deviations, |sighting| sighting.place);
    let from_place =
        |(sighting, value): (&BallObservation, &Vector3<f64>)| value - places[&sighting.place];
    let corrected: Vec<Vector3<f64>> = sightings.iter().zip(deviations).map(from_place).collect();
    // 2. The plate: each ball over all stops, in the table frame.
    let to_table =
        |(sighting, value): (&BallObservation, &Vector3<f64>)| sighting.by_ball.transpose() * value;
    let on_table: Vec<Vector3<f64>> = sightings.iter().zip(&corrected).map(to_table).collect();
    let balls = means(sightings, &on_table, |sighting| sighting.ball);
    let from_ball = |(sighting, value): (&BallObservation, &Vector3<f64>)| {
        value - sighting.by_ball * balls[&sighting.ball]
    };
    let of_table: Vec<Vector3<f64>> = sightings.iter().zip(&corrected).map(from_ball).collect();
    // 3. The plate as a rigid body at each stop: its centre, its plane and its rotation.
    let bodies = rigid_bodies(sightings, &of_table);
    let bodies: Vec<[f64; 6]> =
        (0..stops.len()).map(|stop| bodies.get(&stop).copied()).collect::<Option<_>>()?;
    // 4. A trigonometric polynomial through each motion (Eq. (2)), and the difference between both directions.
    polynomials(layout, stops, &bodies)
}

fn means<K: Ord>(
    sightings: &[BallObservation],
    values: &[Vector3<f64>],
    key: impl Fn(&BallObservation) -> K,
) -> BTreeMap<K, Vector3<f64>> {
    let mut groups: BTreeMap<K, Vec<Vector3<f64>>> = BTreeMap::new();
    for (sighting, value) in sightings.iter().zip(values) {
        groups.entry(key(sighting)).or_default().push(*value);
    }
    let mean =
        |values: Vec<Vector3<f64>>| values.iter().sum::<Vector3<f64>>() / values.len() as f64;
    groups.into_iter().map(|(key, values)| (key, mean(values))).collect()
}

/// The six error motions at each stop from the `values` of the sightings, mm and rad. Stops whose balls do
/// not determine them are left out.
pub fn rigid_bodies(
    sightings: &[BallObservation],
    values: &[Vector3<f64>],
) -> BTreeMap<usize, [f64; COMPONENTS.len()]> {
    let mut of_stop: BTreeMap<usize, Vec<(&BallObservation, &Vector3<f64>)>> = BTreeMap::new();
    for (sighting, value) in sightings.iter().zip(values) {
        of_stop.entry(sighting.stop).or_default().push((sighting, value));
    }
    let body = |visits: Vec<(&BallObservation, &Vector3<f64>)>| {
        let a = Mat::from_fn(3 * visits.len(), COMPONENTS.len(), |i, k| {
            visits[i / 3].0.by_motion[k][i % 3]
        });
        let y: Vec<f64> = visits.iter().flat_map(|(_, value)| value.iter().copied()).collect();
        unweighted(&a, &y)?.try_into().ok()
    };
    of_stop.into_iter().filter_map(|(stop, visits)| Some((stop, body(visits)?))).collect()
}

fn polynomials(
    layout: &Layout,
    stops: &[Stop],
    bodies: &[[f64; COMPONENTS.len()]],
) -> Option<Vec<f64>> {
    let row = |(i, stop): (usize, &Stop)| {
        let mut row = layout.basis.values(stop.angle, i);
        row.extend(layout.has_reversal.then_some(0.5 * stop.direction));
        row
    };
    let rows: Vec<Vec<f64>> = stops.iter().enumerate().map(row).collect();
    let columns = rows.first().map_or(0, Vec::len);
    let a = Mat::from_fn(rows.len(), columns, |i, j| rows[i][j]);
    let mut x = vec![0.0; COMPONENTS.len() * columns];
    for k in 0..COMPONENTS.len() {
        let y: Vec<f64> = bodies.iter().map(|body| body[k]).collect();
        let mut found = unweighted(&a, &y)?.into_iter();
        (0..layout.basis.len())
            .zip(&mut found)
            .for_each(|(j, value)| x[layout.motion(k, j)] = value);
        found.for_each(|value| x[layout.reversal(k)] = value);
    }
    Some(x)
}

fn unweighted(a: &Mat<f64>, y: &[f64]) -> Option<Vec<f64>> {
    let problem = LinearProblem {
        a: a.as_ref(),
        y,
        sigma: &vec![1.0; y.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    Some(solve(&problem).ok()?.x)
}
