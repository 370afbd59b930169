use faer::Mat;

use super::*;

/// Outputs 3 + a/2 and 2a + b of a normal draw a and a rectangular draw b, both of unit variance.
fn compute_two_outputs(random: &mut DrawStream, trials: usize) -> Mat<f64> {
    let units = random.unit_variance_draws(trials, &[DrawDistribution::Normal, DrawDistribution::Rectangular]);
    let (a, b) = units.split_at(trials);
    Mat::from_fn(trials, 2, |i, j| [3.0 + 0.5 * a[i], 2.0 * a[i] + b[i]][j])
}

/// The normal output has mean 3, sd ½ and the interval 3 ± 1. The other one has mean 0 and variance 5.
#[test]
fn statistics_of_known_distributions() {
    let found = propagate_distributions(TrialCount::Fixed(200_000), 11, 2, compute_two_outputs).unwrap();
    assert_eq!((found.trial_count, found.is_stable), (200_000, true));
    let close = |found: f64, wanted: f64, sd: f64| {
        assert!((found - wanted).abs() < 4.0 * sd / 200_000_f64.sqrt(), "{found} {wanted}");
    };
    close(found.mean[0], 3.0, 0.5);
    close(found.mean[1], 0.0, 5_f64.sqrt());
    close(found.standard_deviation[0], 0.5, 0.5 / 2_f64.sqrt());
    close(found.covariance[(1, 1)], 5.0, 5.0 * 2_f64.sqrt());
    close(found.covariance[(0, 1)], 1.0, 2.25_f64.sqrt());
    close(found.symmetric_interval[0][0], 2.0, 0.5 * 2.8);
    close(found.symmetric_interval[0][1], 4.0, 0.5 * 2.8);
}

/// Rectangular distribution: the 95.45 % interval is ±0.9545 half-widths, not ±2 u.
#[test]
fn interval_of_a_rectangular_distribution() {
    let found = propagate_distributions(TrialCount::Fixed(100_000), 3, 1, |random, trials| {
        let units = random.unit_variance_draws(trials, &[DrawDistribution::Rectangular]);
        Mat::from_fn(trials, 1, |i, _| units[i] / 3_f64.sqrt())
    })
    .unwrap();
    assert!((found.symmetric_interval[0][0] + 0.9545).abs() < 0.005, "{:?}", found.symmetric_interval);
    assert!((found.symmetric_interval[0][1] - 0.9545).abs() < 0.005);
    // Four standard deviations of the trials' scatter are 0.9 % of u. Half a unit of the second digit is 0.87 %.
    let u = 1.0 / 3_f64.sqrt();
    assert!(!found.contradicts_uncertainty(0, u) && !found.contradicts_uncertainty(0, 1.006 * u));
    assert!(found.contradicts_uncertainty(0, 1.03 * u) && found.contradicts_uncertainty(0, 0.97 * u));
}

/// JCGM 101, 9.2.2 to 9.2.4: sums of four quantities; u and the half-width of the shortest interval of 95 %.
#[test]
fn paper_jcgm_101_additive_model_at_95_percent() {
    const TRIALS: usize = 400_000;
    for (shape, sizes, u, half) in [
        (DrawDistribution::Normal, [1.0; 4], 2.00, 3.92),
        (DrawDistribution::Rectangular, [1.0; 4], 2.00, 3.88),
        (DrawDistribution::Rectangular, [1.0, 1.0, 1.0, 10.0], 10.1, 17.0),
    ] {
        let units = DrawStream::from_key(7, &[]).unit_variance_draws(TRIALS, &[shape; 4]);
        let sum = |i: usize| (0..4).map(|k| sizes[k] * units[k * TRIALS + i]).sum();
        let mut sums: Vec<f64> = (0..TRIALS).map(sum).collect();
        sums.sort_unstable_by(f64::total_cmp);
        let variance = sums.iter().map(|s| s * s).sum::<f64>() / TRIALS as f64;
        let [low, high] = trial_block::shortest_interval(&sums, 0.95);
        let digit = if u < 10.0 { 0.01 } else { 0.1 };
        assert!((variance.sqrt() - u).abs() < digit, "{} for {u}", variance.sqrt());
        // The shortest of many intervals is slightly too short. Its position is not well defined and is not tested.
        assert!(((high - low) / 2.0 - half).abs() < 1.5 * digit, "{low} to {high} for {half}");
    }
}

#[test]
fn result_is_identical_with_one_and_three_threads() {
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| propagate_distributions(TrialCount::Fixed(23_457), 5, 2, compute_two_outputs).unwrap())
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert_eq!(one.mean, three.mean);
    assert_eq!(one.symmetric_interval, three.symmetric_interval);
    assert_eq!(one.covariance, three.covariance);
    let other = propagate_distributions(TrialCount::Fixed(23_457), 6, 2, compute_two_outputs).unwrap();
    assert_ne!(one.mean, other.mean);
}

#[test]
fn adaptive_trials_stop_when_stable_or_at_the_maximum() {
    let rule = TrialCount::Adaptive { digits: 1, max: 1_000_000 };
    let found = propagate_distributions(rule, 1, 2, compute_two_outputs).unwrap();
    assert!(found.is_stable && found.trial_count < 1_000_000, "{}", found.trial_count);
    let rule = TrialCount::Adaptive { digits: 3, max: 40_000 };
    let found = propagate_distributions(rule, 1, 2, compute_two_outputs).unwrap();
    assert!(!found.is_stable && found.trial_count == 40_000);
}

/// Examples of JCGM 101, 7.9.2: u = 0.000 35 g with two digits gives 0.000 005 g, u = 2 K with one digit gives 0.5
/// K.
#[test]
fn paper_jcgm_101_numerical_tolerance() {
    assert!((numerical_tolerance(0.000_35, 2) - 0.000_005).abs() < 1e-15);
    assert!((numerical_tolerance(2.0, 1) - 0.5).abs() < 1e-12);
    assert_eq!(numerical_tolerance(0.0, 2), 0.0);
}

#[test]
fn one_trial_is_refused_as_too_few() {
    let none = propagate_distributions(TrialCount::Fixed(1), 1, 2, compute_two_outputs).unwrap_err();
    assert_eq!(none, TooFewTrials(1));
}
