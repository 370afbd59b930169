//! Resampling of sines with known values.

use std::f64::consts::TAU;

use super::{
    AngleRange, AngleSample, ChannelAtMounting, ChannelRevolutions, DeclaredSensor, HarmonicBasis, HarmonicData,
    KERNEL_HALF_WIDTH_OUTPUT_STEPS, ResampleFilter, ResampledChannel, Resampler, calibrate_sensors,
    common_and_rejected_revolutions, saturation::saturated_ranges,
};
use crate::monte_carlo::{DrawDistribution, DrawStream};

const STEPS_PER_REVOLUTION: usize = 360;

/// Angles of a table whose speed varies by 40 %, with `samples_per_revolution` samples per revolution on average.
fn uneven_angles(samples_per_revolution: f64, revolutions: f64, is_backward: bool) -> Vec<f64> {
    let run_in = TAU * KERNEL_HALF_WIDTH_OUTPUT_STEPS as f64 / STEPS_PER_REVOLUTION as f64 + 1e-3;
    let count = ((revolutions * TAU + 2.0 * run_in) / TAU * samples_per_revolution).ceil() as usize + 200;
    let forward = (0..count).map(|i| {
        let t = i as f64 * TAU / samples_per_revolution;
        t + 0.4 / 3.0 * (3.0 * t).sin() - run_in - 0.2
    });
    let mut angles: Vec<f64> = forward.collect();
    if is_backward {
        angles.iter_mut().for_each(|angle| *angle = -*angle);
    }
    angles
}

fn resample_function(
    filter: &ResampleFilter,
    angles: &[f64],
    value: impl Fn(f64) -> f64,
    is_valid: impl Fn(f64) -> bool,
) -> ResampledChannel {
    let mut resampler = Resampler::new(filter, angles[0], angles[angles.len() - 1]);
    for angle in angles {
        let sample = AngleSample { angle_rad: *angle, value: value(*angle), is_valid: is_valid(*angle) };
        resampler.push(sample);
    }
    resampler.finish()
}

#[test]
fn unevenly_sampled_sines_are_resampled_correctly() {
    let filter = ResampleFilter::new(STEPS_PER_REVOLUTION);
    assert_eq!(
        (filter.max_passed_harmonic(), filter.cutoff_harmonic(), filter.min_suppressed_harmonic()),
        (83, 180, 277)
    );
    for is_backward in [false, true] {
        // Uneven samples, 1000 per revolution on average, 714 where the table is fastest.
        let angles = uneven_angles(1000.0, 3.0, is_backward);
        for order in [1.0, 5.0, 20.0, 40.0] {
            let of = |angle: f64| (order * angle + 0.3).sin();
            let channel = resample_function(&filter, &angles, of, |_| true);
            assert!(channel.gaps.is_empty());
            let (rows, rejected) = common_and_rejected_revolutions(0, &[channel]);
            assert!(rejected.is_empty() && rows[0].revolutions.len() == 3);
            let mut worst: f64 = 0.0;
            for (i, value) in rows[0].revolutions.iter().flat_map(|r| r.iter().enumerate()) {
                let exact = (order * i as f64 * TAU / STEPS_PER_REVOLUTION as f64 + 0.3).sin();
                worst = worst.max((value - exact).abs());
            }
            println!("order {order} backward {is_backward}: {worst:.2e}");
            assert!(worst < 3e-5, "{order}: {worst}");
        }
    }
}

/// Order 345 on 360 angles aliases to order 15. Without the filter its amplitude would be unchanged.
#[test]
fn suppressed_harmonics_do_not_alias() {
    let filter = ResampleFilter::new(STEPS_PER_REVOLUTION);
    let angles: Vec<f64> = (0..3200).map(|i| f64::from(i) * TAU / 1000.0).collect();
    for high in [345.0, 375.0, 460.0] {
        let channel = resample_function(&filter, &angles, |angle| (high * angle).cos(), |_| true);
        let (rows, _) = common_and_rejected_revolutions(0, &[channel]);
        let basis = HarmonicBasis::new(STEPS_PER_REVOLUTION, 100);
        let folded = (high - 360.0_f64).abs() as usize;
        let alias = basis.harmonics(&rows[0].revolutions[0])[folded - 1].norm();
        let decimated: Vec<f64> =
            (0..STEPS_PER_REVOLUTION).map(|i| (high * i as f64 * TAU / STEPS_PER_REVOLUTION as f64).cos()).collect();
        let unfiltered = basis.harmonics(&decimated)[folded - 1].norm();
        println!("order {high}: alias {alias:.2e}, without filter {unfiltered:.3}");
        assert!(alias < 3e-5 && unfiltered > 0.99, "{high}: {alias} {unfiltered}");
    }
}

#[test]
fn revolutions_with_gaps_are_rejected() {
    let filter = ResampleFilter::new(STEPS_PER_REVOLUTION);
    let angles: Vec<f64> = (0..4300).map(|i| f64::from(i) * TAU / 1000.0).collect();
    // Saturation over 10° in the second revolution.
    let is_valid = |angle: f64| !(490.0..500.0).contains(&angle.to_degrees());
    let gap = resample_function(&filter, &angles, f64::sin, is_valid);
    let whole = resample_function(&filter, &angles, f64::cos, |_| true);
    let (rows, rejected) = common_and_rejected_revolutions(4, &[whole.clone(), gap]);
    assert_eq!(rows.iter().map(|row| row.revolutions.len()).collect::<Vec<_>>(), [3, 3]);
    let text = rejected[0].to_string();
    println!("{text}");
    assert!(
        text.starts_with("1 of 4 revolutions") && rejected[0].channel_index == 1 && text.contains("490.0° to 500.0°")
    );
    // A channel that is saturated in every revolution does not affect the other channel.
    let always = |angle: f64| !(120.0..130.0).contains(&angle.to_degrees().rem_euclid(360.0));
    let lost = resample_function(&filter, &angles, f64::sin, always);
    let (rows, rejected) = common_and_rejected_revolutions(4, &[whole, lost]);
    assert!(rows.len() == 1 && rows[0].revolutions.len() == 4 && rejected[0].rejected_count == 4);
}

/// The table stops for 500 samples within a revolution, and the encoder jitters.
#[test]
fn table_stop_and_encoder_jitter_do_not_change_harmonics() {
    let filter = ResampleFilter::new(STEPS_PER_REVOLUTION);
    let mut angles = Vec::new();
    for i in 0..2600 {
        let angle = f64::from(i) * TAU / 1000.0;
        let repeats = if i == 1234 { 500 } else { 1 };
        angles.extend((0..repeats).map(|j| angle + 1e-4 * f64::from(j % 3)));
    }
    let channel = resample_function(&filter, &angles, |angle| (4.0 * angle).cos(), |_| true);
    let (rows, _) = common_and_rejected_revolutions(0, &[channel]);
    let basis = HarmonicBasis::new(STEPS_PER_REVOLUTION, 20);
    for revolution in &rows[0].revolutions {
        for (k, harmonic) in basis.harmonics(revolution).iter().enumerate() {
            let expected = if k + 1 == 4 { 1.0 } else { 0.0 };
            assert!((harmonic.re - expected).abs() < 3e-5 && harmonic.im.abs() < 3e-5);
        }
    }
}

#[test]
fn saturated_range_of_ten_degrees_is_found() {
    let scan = |limit: f64, noise_mm: f64, step_mm: f64| -> Vec<AngleSample> {
        let mut random = DrawStream::from_key(1, &[1]);
        let units = random.unit_variance_draws(3000, &[DrawDistribution::Normal]);
        let sample = |(i, unit): (usize, f64)| {
            let angle_rad = i as f64 * TAU / 1000.0;
            let value = (0.1 * angle_rad.cos() + noise_mm * unit).min(limit);
            let value = (value / step_mm).round() * step_mm;
            AngleSample { angle_rad, value, is_valid: true }
        };
        units.into_iter().enumerate().map(sample).collect()
    };
    for (noise_mm, step_mm) in [(0.0, 1e-6), (2e-5, 1e-6), (2e-5, 1e-5)] {
        let limit = 0.1 * 5f64.to_radians().cos();
        let found = saturated_ranges(&scan(limit, noise_mm, step_mm));
        println!("{noise_mm} {step_mm}: {found:?}");
        let is_near = |range: &AngleRange, middle: f64| {
            (range.from_deg - middle + 5.0).abs() < 1.5 && (range.to_deg - middle - 5.0).abs() < 1.5
        };
        assert!(found.iter().any(|range| is_near(range, 360.0)), "{found:?}");
        assert!(found.iter().any(|range| is_near(range, 720.0)), "{found:?}");
    }
    // A display step of 0.5 µm alone flattens the peak over 11°.
    for (noise_mm, step_mm) in [(0.0, 1e-6), (2e-5, 1e-5), (0.0, 5e-4)] {
        assert!(saturated_ranges(&scan(1.0, noise_mm, step_mm)).is_empty());
    }
}

/// Sensors around a part whose centre position is computed for each sample, each sensor with its own gain and
/// angle. The calibration finds the differences of gains and angles, keeps their declared mean, and its errors
/// match the stated uncertainty.
#[test]
fn sensor_calibration_finds_gain_and_angle_differences() {
    const ANGLE_COUNT: usize = 90;
    let nominal_deg: [f64; 3] = [0.0, 90.0, 230.0];
    let (u_gain, u_angle_rad, noise_mm) = (5e-3, 5e-3, 0.05e-3);
    for turn in [1.0, -1.0] {
        let (mut squares, mut of_differences) = (0.0, 0.0);
        let seeds = 100;
        for seed in 0..seeds {
            let units = DrawStream::from_key(seed, &[7])
                .unit_variance_draws(6 + 20 + 4 * 10 * 3 * ANGLE_COUNT, &[DrawDistribution::Normal]);
            let (truth, rest) = units.split_at(6);
            let (mountings, noise) = rest.split_at(20);
            let mut noise = noise.iter();
            let mut revolution = |sensor: usize, index: usize| -> Vec<f64> {
                let place = nominal_deg[sensor].to_radians() + u_angle_rad * truth[3 + sensor];
                let [ex, ey] = [0, 1].map(|k| 10e-3 * mountings[2 * index + k]);
                let angles = (0..ANGLE_COUNT).map(|i| i as f64 * TAU / ANGLE_COUNT as f64);
                let at = |q: f64| {
                    let (sin, cos) = (turn * q).sin_cos();
                    // The eccentricity turns with the part. A motion of 0.8 µm turns against it.
                    let x = ex * cos - ey * sin + 0.8e-3 * cos;
                    let y = ex * sin + ey * cos - 0.8e-3 * sin;
                    let seen = x * place.cos() + y * place.sin();
                    (1.0 + u_gain * truth[sensor]) * seen + noise_mm * noise.next().unwrap()
                };
                angles.map(at).collect()
            };
            let mut rows = Vec::new();
            for index in 0..10 {
                for channel in 0..3 {
                    let revolutions = vec![revolution(channel, index), revolution(channel, index)];
                    rows.push(ChannelRevolutions {
                        key: ChannelAtMounting { mounting_index: index, channel_index: channel },
                        revolutions,
                    });
                }
            }
            let data = HarmonicData::from_revolutions(&rows, 3).unwrap();
            let sensors = [0, 1, 2].map(|channel| {
                let angle_rad = nominal_deg[channel].to_radians();
                DeclaredSensor { radial_cross_section_index: Some(0), angle_rad, u_gain, u_angle_rad }
            });
            let found = calibrate_sensors(&data, &sensors, turn).unwrap();
            let error = |i: usize| found.gain_then_angle_deviations[i] - 5e-3 * truth[i];
            squares += (0..6).map(|i| error(i).powi(2) / found.covariance[(i, i)]).sum::<f64>();
            of_differences += [(0, 1), (1, 2), (3, 4), (4, 5)]
                .iter()
                .map(|(i, j)| {
                    let u = found.covariance[(*i, *i)] + found.covariance[(*j, *j)] - 2.0 * found.covariance[(*i, *j)];
                    assert!(u.sqrt() < 1e-3 && (error(*i) - error(*j)).abs() < 3e-3);
                    (error(*i) - error(*j)).powi(2) / u
                })
                .sum::<f64>();
        }
        let (all, differences) = (squares / (6 * seeds) as f64, of_differences / (4 * seeds) as f64);
        println!("turn {turn}: mean of (error/u)² {all:.2}, of differences {differences:.2}");
        assert!((0.8..1.25).contains(&all) && (0.75..1.3).contains(&differences));
    }
}

/// After the correction the scatter of the revolutions in both directions is that of their noise alone, and their
/// mean is unchanged.
#[test]
fn drift_correction_removes_drift_scatter_and_keeps_mean() {
    const ANGLE_COUNT: usize = 36;
    let noise = DrawStream::from_key(3, &[8]).unit_variance_draws(40 * 4 * ANGLE_COUNT, &[DrawDistribution::Normal]);
    let mut noise = noise.iter();
    let mut row = |index: usize| {
        let revolution = |r: usize, noise: &mut std::slice::Iter<'_, f64>| -> Vec<f64> {
            let value = |j: usize| {
                let passed = if r < 2 { r * ANGLE_COUNT + j } else { (r + 1) * ANGLE_COUNT - 1 - j };
                0.05 * passed as f64 + noise.next().unwrap()
            };
            (0..ANGLE_COUNT).map(value).collect()
        };
        let revolutions = (0..4).map(|r| revolution(r, &mut noise)).collect();
        ChannelRevolutions { key: ChannelAtMounting { mounting_index: index, channel_index: 0 }, revolutions }
    };
    let rows: Vec<ChannelRevolutions> = (0..40).map(&mut row).collect();
    let corrected: Vec<ChannelRevolutions> = rows.iter().map(|row| row.without_linear_drift(2)).collect();
    let [before, after] = [&rows, &corrected].map(|rows| HarmonicData::from_revolutions(rows, 5).unwrap());
    let difference = before.harmonic_means.iter().flatten().zip(after.harmonic_means.iter().flatten());
    assert!(difference.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max) < 1e-12);
    // Variance in one revolution: 2σ²/T.
    let [with, without] =
        [&before, &after].map(|data| data.harmonic_scatters[0].channel_covariance[(0, 0)] * ANGLE_COUNT as f64 / 2.0);
    println!("variance with drift {with:.3}, without {without:.3}");
    assert!(with > 1.3 && (0.8..1.2).contains(&without), "{with} {without}");
}
