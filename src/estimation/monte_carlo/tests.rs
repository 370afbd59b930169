use std::convert::Infallible;

use faer::Mat;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::*;

fn two_outputs(rng: &mut ChaCha8Rng, out: &mut [f64]) -> Result<(), Infallible> {
    let (a, b): (f64, f64) = (StandardNormal.sample(rng), rng.random());
    out[0] = 3.0 + 0.5 * a;
    out[1] = 2.0 * a + b;
    Ok(())
}

/// Normal: mean 3, sd ½, interval 3 ± 1. Sum 2a + b with b uniform on [0, 1): variance 4 + 1/12.
#[test]
fn regress_known_distributions() {
    let found = propagate(Trials::Fixed(200_000), 11, 2, two_outputs).unwrap();
    assert_eq!((found.trials, found.stable), (200_000, true));
    let close = |found: f64, wanted: f64, sd: f64| {
        assert!((found - wanted).abs() < 4.0 * sd / 200_000_f64.sqrt(), "{found} {wanted}");
    };
    close(found.mean[0], 3.0, 0.5);
    close(found.mean[1], 0.5, 2.02);
    close(found.standard_deviation[0], 0.5, 0.5 / 2_f64.sqrt());
    close(found.covariance[(1, 1)], 4.0 + 1.0 / 12.0, 4.09 * 2_f64.sqrt());
    close(found.covariance[(0, 1)], 1.0, 2_f64.sqrt() * 1.02);
    close(found.interval[0][0], 2.0, 0.5 * 2.8);
    close(found.interval[0][1], 4.0, 0.5 * 2.8);
}

/// A rectangular distribution: the interval of 95.45 % is ±0.9545 half-widths, not ±2 u.
#[test]
fn regress_interval_of_a_rectangle() {
    let found = propagate(Trials::Fixed(100_000), 3, 1, |rng, out| {
        out[0] = rng.random_range(-1.0..1.0);
        Ok::<(), Infallible>(())
    })
    .unwrap();
    assert!((found.interval[0][0] + 0.9545).abs() < 0.005, "{:?}", found.interval);
    assert!((found.interval[0][1] - 0.9545).abs() < 0.005);
    // The scatter of 100 000 trials is 0.9 % at four standard deviations; a unit is 0.87 %.
    let u = 1.0 / 3_f64.sqrt();
    assert!(!found.contradicts(0, u) && !found.contradicts(0, 1.006 * u));
    assert!(found.contradicts(0, 1.03 * u) && found.contradicts(0, 0.97 * u));
}

#[test]
fn regress_threads_do_not_change_a_bit() {
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| propagate(Trials::Fixed(23_456), 5, 2, two_outputs).unwrap())
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert_eq!(one.mean, three.mean);
    assert_eq!(one.interval, three.interval);
    assert_eq!(one.covariance, three.covariance);
    let other = propagate(Trials::Fixed(23_456), 6, 2, two_outputs).unwrap();
    assert_ne!(one.mean, other.mean);
}

#[test]
fn regress_adaptive_stops_when_stable_or_says_not() {
    let rule = Trials::Adaptive { digits: 1, max: 1_000_000 };
    let found = propagate(rule, 1, 2, two_outputs).unwrap();
    assert!(found.stable && found.trials < 1_000_000, "{}", found.trials);
    let rule = Trials::Adaptive { digits: 3, max: 40_000 };
    let found = propagate(rule, 1, 2, two_outputs).unwrap();
    assert!(!found.stable && found.trials == 40_000);
}

/// JCGM 101, 7.9.2, its examples: u = 0.000 35 g to two digits gives 0.000 005 g, u = 2 K to one
/// digit 0.5 K.
#[test]
fn paper_jcgm_101_numerical_tolerance() {
    assert!((numerical_tolerance(0.000_35, 2) - 0.000_005).abs() < 1e-15);
    assert!((numerical_tolerance(2.0, 1) - 0.5).abs() < 1e-12);
    assert_eq!(numerical_tolerance(0.0, 2), 0.0);
}

#[test]
fn regress_the_first_failure_is_named() {
    let failing = |_: &mut ChaCha8Rng, _: &mut [f64]| Err(std::fmt::Error);
    let error = propagate(Trials::Fixed(30_000), 1, 1, failing).unwrap_err();
    assert_eq!(error, MonteCarloError::Trial { block: 0, source: std::fmt::Error });
    let none = propagate(Trials::Fixed(1), 1, 2, two_outputs).unwrap_err();
    assert_eq!(none, MonteCarloError::TooFew(1));
}

/// Two unknowns from three rows; standard deviations by hand, and a function of them.
#[test]
fn regress_fast_path_against_propagation_by_hand() {
    let gain = Mat::from_fn(2, 3, |i, j| [[0.5, 0.5, 0.0], [1.0, 0.0, -2.0]][i][j]);
    let sigma = [1.0, 2.0, 0.5];
    let propagation = LinearPropagation::new(gain.as_ref(), &sigma, &[10.0, -3.0]).unwrap();
    assert!(LinearPropagation::new(gain.as_ref(), &sigma, &[10.0]).is_err());
    let difference = |x: &[f64], out: &mut [f64]| {
        for i in 0..BLOCK {
            out[i] = x[i] - x[BLOCK + i];
        }
    };
    let trials = 200_001;
    let found = propagation.run(trials, 4, 1, difference);
    let expected = [(10.0, 1.25), (-3.0, 2.0), (13.0, 0.25 + 1.0 + 1.0)];
    for (found, (mean, variance)) in found.iter().zip(expected) {
        let sd = f64::sqrt(variance);
        let root = (trials as f64).sqrt();
        assert_eq!(found.trials, trials);
        assert!((found.mean - mean).abs() < 4.0 * sd / root, "{found:?}");
        assert!((found.standard_deviation() / sd - 1.0).abs() < 4.0 / (2.0_f64.sqrt() * root));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| propagation.run(trials, 4, 1, difference)), found);
}

/// A normal and a rectangular draw, many trials at once.
fn two_outputs_in_blocks(random: &mut Random, trials: usize) -> Mat<f64> {
    let units = random.units(trials, &[Shape::Normal, Shape::Rectangular]);
    let (a, b) = units.split_at(trials);
    Mat::from_fn(trials, 2, |i, j| [3.0 + 0.5 * a[i], 2.0 * a[i] + b[i]][j])
}

/// The same trials, drawn one by one.
fn two_outputs_one_by_one(rng: &mut ChaCha8Rng, out: &mut [f64]) -> Result<(), Infallible> {
    let (a, b) = (Shape::Normal.draw(rng), Shape::Rectangular.draw(rng));
    out.copy_from_slice(&[3.0 + 0.5 * a, 2.0 * a + b]);
    Ok(())
}

/// Blocks of unequal sizes, chunks that are not whole, one and three threads: the same bits.
#[test]
fn regress_blocks_draw_as_single_trials_do() {
    let trials = Trials::Fixed(23_457);
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| propagate_blocks(trials, 5, 2, two_outputs_in_blocks).unwrap())
    };
    let single = propagate(trials, 5, 2, two_outputs_one_by_one).unwrap();
    for found in [with_threads(1), with_threads(3)] {
        assert_eq!((found.trials, found.stable), (23_457, true));
        assert_eq!(found.mean, single.mean);
        assert_eq!(found.interval, single.interval);
        assert_eq!(found.covariance, single.covariance);
    }
}

#[test]
fn regress_blocks_stop_when_stable_or_report_it() {
    let rule = |digits, max| Trials::Adaptive { digits, max };
    let found = propagate_blocks(rule(1, 1_000_000), 1, 2, two_outputs_in_blocks).unwrap();
    let single = propagate(rule(1, 1_000_000), 1, 2, two_outputs_one_by_one).unwrap();
    assert!(found.stable && found.trials == single.trials, "{}", found.trials);
    let found = propagate_blocks(rule(3, 40_000), 1, 2, two_outputs_in_blocks).unwrap();
    assert!(!found.stable && found.trials == 40_000);
    let error = propagate_blocks(Trials::Fixed(1), 1, 2, two_outputs_in_blocks).unwrap_err();
    assert_eq!(error, MonteCarloError::TooFew(1));
}
