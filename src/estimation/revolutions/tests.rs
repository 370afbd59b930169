//! Resampling of sines with known values.

use std::f64::consts::TAU;

use super::{
    AngleRange, HarmonicBasis, KERNEL_HALF_STEPS, ResampleFilter, Resampled, Resampler, Sample,
    common_revolutions, saturation::saturated_ranges,
};
use crate::monte_carlo::{Random, Shape};

const STEPS: usize = 360;

/// Angles of a table that slows down and speeds up by 40 %, on average `rate` samples a revolution.
fn uneven_angles(rate: f64, revolutions: f64, is_backward: bool) -> Vec<f64> {
    let run_in = TAU * KERNEL_HALF_STEPS as f64 / STEPS as f64 + 1e-3;
    let count = ((revolutions * TAU + 2.0 * run_in) / TAU * rate).ceil() as usize + 200;
    let forward = (0..count).map(|i| {
        let t = i as f64 * TAU / rate;
        t + 0.4 / 3.0 * (3.0 * t).sin() - run_in - 0.2
    });
    let mut angles: Vec<f64> = forward.collect();
    if is_backward {
        angles.iter_mut().for_each(|angle| *angle = -*angle);
    }
    angles
}

fn resampled(
    filter: &ResampleFilter,
    angles: &[f64],
    value: impl Fn(f64) -> f64,
    is_valid: impl Fn(f64) -> bool,
) -> Resampled {
    let mut resampler = Resampler::new(filter, angles[0], angles[angles.len() - 1]);
    for angle in angles {
        let sample = Sample { angle_rad: *angle, value: value(*angle), is_valid: is_valid(*angle) };
        resampler.push(sample);
    }
    resampler.finish()
}

#[test]
fn regress_sines_come_back_exactly() {
    let filter = ResampleFilter::new(STEPS);
    assert_eq!((filter.pass_order(), filter.cutoff_order(), filter.stop_order()), (83, 180, 277));
    for is_backward in [false, true] {
        // Uneven samples, 1000 a revolution on average, 714 where the table is fastest.
        let angles = uneven_angles(1000.0, 3.0, is_backward);
        for order in [1.0, 5.0, 20.0, 40.0] {
            let of = |angle: f64| (order * angle + 0.3).sin();
            let channel = resampled(&filter, &angles, of, |_| true);
            assert!(channel.gaps.is_empty());
            let (rows, rejected) = common_revolutions(0, &[channel]);
            assert!(rejected.is_empty() && rows[0].revolutions.len() == 3);
            let mut worst: f64 = 0.0;
            for (i, value) in rows[0].revolutions.iter().flat_map(|r| r.iter().enumerate()) {
                let exact = (order * i as f64 * TAU / STEPS as f64 + 0.3).sin();
                worst = worst.max((value - exact).abs());
            }
            println!("order {order} backward {is_backward}: {worst:.2e}");
            assert!(worst < 3e-5, "{order}: {worst}");
        }
    }
}

/// Order 345 on 360 angles looks like order 15; without the filter its amplitude stays whole.
#[test]
fn regress_no_alias_of_high_orders() {
    let filter = ResampleFilter::new(STEPS);
    let angles: Vec<f64> = (0..3200).map(|i| f64::from(i) * TAU / 1000.0).collect();
    for high in [345.0, 375.0, 460.0] {
        let channel = resampled(&filter, &angles, |angle| (high * angle).cos(), |_| true);
        let (rows, _) = common_revolutions(0, &[channel]);
        let basis = HarmonicBasis::new(STEPS, 100);
        let folded = (high - 360.0_f64).abs() as usize;
        let alias = basis.harmonics(&rows[0].revolutions[0])[folded - 1].norm();
        let decimated: Vec<f64> =
            (0..STEPS).map(|i| (high * i as f64 * TAU / STEPS as f64).cos()).collect();
        let unfiltered = basis.harmonics(&decimated)[folded - 1].norm();
        println!("order {high}: alias {alias:.2e}, without filter {unfiltered:.3}");
        assert!(alias < 3e-5 && unfiltered > 0.99, "{high}: {alias} {unfiltered}");
    }
}

#[test]
fn regress_gaps_reject_their_revolution() {
    let filter = ResampleFilter::new(STEPS);
    let angles: Vec<f64> = (0..4300).map(|i| f64::from(i) * TAU / 1000.0).collect();
    // 10° in the second revolution, saturated.
    let is_valid = |angle: f64| !(490.0..500.0).contains(&angle.to_degrees());
    let gap = resampled(&filter, &angles, f64::sin, is_valid);
    let whole = resampled(&filter, &angles, f64::cos, |_| true);
    let (rows, rejected) = common_revolutions(4, &[whole.clone(), gap]);
    assert_eq!(rows.iter().map(|row| row.revolutions.len()).collect::<Vec<_>>(), [3, 3]);
    let text = rejected[0].to_string();
    println!("{text}");
    assert!(
        text.starts_with("1 of 4 revolutions")
            && rejected[0].channel == 1
            && text.contains("490.0° to 500.0°")
    );
    // A channel saturated in every revolution leaves the other one whole.
    let always = |angle: f64| !(120.0..130.0).contains(&angle.to_degrees().rem_euclid(360.0));
    let lost = resampled(&filter, &angles, f64::sin, always);
    let (rows, rejected) = common_revolutions(4, &[whole, lost]);
    assert!(rows.len() == 1 && rows[0].revolutions.len() == 4 && rejected[0].rejected == 4);
}

/// The table stops for 500 samples in mid-turn; the encoder trembles.
#[test]
fn regress_stops_and_tremble_change_nothing() {
    let filter = ResampleFilter::new(STEPS);
    let mut angles = Vec::new();
    for i in 0..2600 {
        let angle = f64::from(i) * TAU / 1000.0;
        let repeats = if i == 1234 { 500 } else { 1 };
        angles.extend((0..repeats).map(|j| angle + 1e-4 * f64::from(j % 3)));
    }
    let channel = resampled(&filter, &angles, |angle| (4.0 * angle).cos(), |_| true);
    let (rows, _) = common_revolutions(0, &[channel]);
    let basis = HarmonicBasis::new(STEPS, 20);
    for revolution in &rows[0].revolutions {
        for (k, harmonic) in basis.harmonics(revolution).iter().enumerate() {
            let expected = if k + 1 == 4 { 1.0 } else { 0.0 };
            assert!((harmonic.re - expected).abs() < 3e-5 && harmonic.im.abs() < 3e-5);
        }
    }
}

#[test]
fn regress_saturation_over_ten_degrees() {
    let scan = |limit: f64, noise_mm: f64, step_mm: f64| -> Vec<Sample> {
        let mut random = Random::of(1, &[1]);
        let units = random.units(3000, &[Shape::Normal]);
        let sample = |(i, unit): (usize, f64)| {
            let angle_rad = i as f64 * TAU / 1000.0;
            let value = (0.1 * angle_rad.cos() + noise_mm * unit).min(limit);
            let value = (value / step_mm).round() * step_mm;
            Sample { angle_rad, value, is_valid: true }
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
    // A display step of 0.5 µm flattens the peak over 11° by itself.
    for (noise_mm, step_mm) in [(0.0, 1e-6), (2e-5, 1e-5), (0.0, 5e-4)] {
        assert!(saturated_ranges(&scan(1.0, noise_mm, step_mm)).is_empty());
    }
}
