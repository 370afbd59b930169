//! The four steps of paper 5, section 2.3, as an independent solution: on complete visits of balls at equal
//! angles they are equal to least squares over all visits; with visits missing they are not (METHODS section 5).

use std::collections::BTreeMap;

use faer::Mat;
use nalgebra::Vector3;

use super::Setting;
use super::g5::{ORDER, Truth, errors, kept_visits, measured, scatter, setting};
use crate::ball_plate::basis::Basis;
use crate::ball_plate::equations::{Sighting, solve};
use crate::identification::multiply;
use estimation::linear::{LinearProblem, RANK_THRESHOLD, solve as least_squares};

fn mean(values: &[Vector3<f64>]) -> Vector3<f64> {
    values.iter().sum::<Vector3<f64>>() / values.len().max(1) as f64
}

fn means<K: Ord>(
    sightings: &[Sighting],
    values: &[Vector3<f64>],
    key: impl Fn(&Sighting) -> K,
) -> BTreeMap<K, Vector3<f64>> {
    let mut groups: BTreeMap<K, Vec<Vector3<f64>>> = BTreeMap::new();
    for (sighting, value) in sightings.iter().zip(values) {
        groups.entry(key(sighting)).or_default().push(*value);
    }
    groups.into_iter().map(|(key, values)| (key, mean(&values))).collect()
}

/// Coefficients of the six motions, component by component.
fn four_steps(setting: &Setting, sightings: &[Sighting], basis: &Basis) -> Vec<f64> {
    // 1. The measuring positions: every ball comes to each, and the table's motions have the mean zero there.
    let measured: Vec<Vector3<f64>> = sightings.iter().map(|s| s.deviation).collect();
    let places = means(sightings, &measured, |s| s.place);
    let corrected: Vec<Vector3<f64>> =
        sightings.iter().zip(&measured).map(|(s, value)| value - places[&s.place]).collect();
    // 2. The plate: each ball over all stops, in the frame of the table.
    let on_table: Vec<Vector3<f64>> =
        sightings.iter().zip(&corrected).map(|(s, value)| s.by_ball.transpose() * value).collect();
    let balls = means(sightings, &on_table, |s| s.ball);
    let by_motion: Vec<Vector3<f64>> =
        sightings.iter().zip(&corrected).map(|(s, v)| v - s.by_ball * balls[&s.ball]).collect();
    // 3. The plate as a rigid body at each stop: its centre, its plane and its turn.
    let stops = setting.stops();
    let bodies: Vec<[f64; 6]> =
        (0..stops.len()).map(|stop| rigid_body(sightings, &by_motion, stop)).collect();
    // 4. A trigonometric polynomial through each motion (Eq. (2)).
    let a = Mat::from_fn(stops.len(), basis.len(), |i, j| basis.values(stops[i].angle, i)[j]);
    let sigma = vec![1.0; stops.len()];
    let polynomial = |k: usize| {
        let y: Vec<f64> = bodies.iter().map(|body| body[k]).collect();
        fit(&a, &y, &sigma)
    };
    (0..6).flat_map(polynomial).collect()
}

fn rigid_body(sightings: &[Sighting], values: &[Vector3<f64>], stop: usize) -> [f64; 6] {
    let here: Vec<(&Sighting, &Vector3<f64>)> =
        sightings.iter().zip(values).filter(|(s, _)| s.stop == stop).collect();
    let a = Mat::from_fn(3 * here.len(), 6, |i, k| here[i / 3].0.by_motion[k][i % 3]);
    let y: Vec<f64> = here.iter().flat_map(|(_, value)| value.iter().copied()).collect();
    fit(&a, &y, &vec![1.0; y.len()]).try_into().unwrap()
}

fn fit(a: &Mat<f64>, y: &[f64], sigma: &[f64]) -> Vec<f64> {
    let problem = LinearProblem {
        a: a.as_ref(),
        y,
        sigma,
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    least_squares(&problem).unwrap().x
}

/// Largest error of a translation, µm, by the four steps and by least squares over all visits.
fn both(missing: f64) -> [f64; 2] {
    let setting = setting();
    let basis = Basis::Fourier { order: ORDER, sub_order: 0 };
    let truth = Truth::draw(3, &setting);
    let sightings = kept_visits(measured(&setting, &truth, scatter(3)), missing);
    let layout = setting.layout(basis.clone());
    let sigma = vec![1.0; 3 * sightings.len()];
    let (_, global) = solve(&layout, &setting.stops(), &sightings, &sigma).unwrap();
    let y: Vec<f64> = sightings.iter().flat_map(|s| s.deviation.iter().copied()).collect();
    let four = four_steps(&setting, &sightings, &basis);
    [four, multiply(&global.gain, &y)].map(|x| {
        let worst = errors(&setting, &truth, &basis, &x);
        worst[..3].iter().copied().fold(0.0, f64::max) * 1e3
    })
}

#[test]
fn four_steps_and_least_squares_are_equal_on_complete_visits() {
    let [four, global] = both(0.0);
    println!("complete: four steps {four:.6} um, least squares {global:.6} um");
    assert!((four - global).abs() < 1e-6, "{four} {global}");
}

#[test]
fn four_steps_do_not_bear_missing_visits() {
    let [four, global] = both(0.05);
    println!("5 % missing: four steps {four:.3} um, least squares {global:.4} um");
    assert!(global < 0.05 && four > 5.0 * global, "{four} {global}");
}
