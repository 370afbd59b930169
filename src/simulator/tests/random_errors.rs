//! Errors drawn from the seed: their statistics, where they act, and that they are reproducible.

use std::f64::consts::{FRAC_PI_2, PI};

use super::super::linear_errors::LinearErrors;
use super::super::random_draws::{ProbeLobing, RandomSource, ThermalDrift, draw_normal, draw_stylus_offset};
use super::*;
use nalgebra::Vector3;

const SEED_COUNT: u64 = 4000;

/// Mean of `sample` over the seeds.
fn mean_over_seeds(sample: impl Fn(u64) -> f64) -> f64 {
    (0..SEED_COUNT).map(sample).sum::<f64>() / SEED_COUNT as f64
}

/// Scatter of one touch, in standard deviations.
fn draw_touch_scatter(seed: u64, n: u32, occurrence: u64) -> f64 {
    draw_normal(seed, RandomSource::TouchScatter, &[u64::from(n), occurrence])
}

/// The tolerance is 8 % of `scale`: 3.6 standard deviations of a variance over 4000 seeds (2.2 %).
fn assert_within_8_percent_of_scale(found: f64, expected: f64, scale: f64) {
    assert!((found - expected).abs() < 0.08 * scale, "{found} instead of {expected}");
}

#[test]
fn touch_scatter_is_standard_normal_over_steps_and_occurrences() {
    let draws: Vec<f64> =
        (0..400).flat_map(|n| (0..10).map(move |occurrence| draw_touch_scatter(5, n, occurrence))).collect();
    let count = draws.len() as f64;
    let moment = |power| draws.iter().map(|d| d.powi(power)).sum::<f64>() / count;
    assert!(moment(1).abs() < 0.05);
    assert_within_8_percent_of_scale(moment(2), 1.0, 1.0);
    assert!((moment(4) - 3.0).abs() < 0.5);
    let neighbours: f64 = draws.windows(2).map(|pair| pair[0] * pair[1]).sum();
    assert!((neighbours / count).abs() < 0.05);
}

#[test]
fn lobing_and_stylus_offset_have_the_declared_magnitude() {
    let at = |seed, phi: f64| ProbeLobing::draw(seed, 2.0, &[]).pre_travel_mm(Vector3::new(phi.cos(), phi.sin(), 0.0));
    for phi in [0.0, 1.0, 4.0] {
        assert_within_8_percent_of_scale(mean_over_seeds(|seed| at(seed, phi).powi(2)), 4.0, 4.0);
        assert_within_8_percent_of_scale(mean_over_seeds(|seed| at(seed, phi)), 0.0, 2.0);
        // Σ cos(kΔ)/5 over the harmonics 2..6, Δ = 1.
        let correlation = (2..=6).map(|k| f64::from(k).cos()).sum::<f64>() / 5.0;
        let found = mean_over_seeds(|seed| at(seed, phi) * at(seed, phi + 1.0));
        assert_within_8_percent_of_scale(found, 4.0 * correlation, 4.0);
    }
    assert_within_8_percent_of_scale(mean_over_seeds(|seed| draw_stylus_offset(seed, 3.0).x.powi(2)), 9.0, 9.0);
    assert_within_8_percent_of_scale(mean_over_seeds(|seed| draw_stylus_offset(seed, 3.0).y.powi(2)), 9.0, 9.0);
    assert_within_8_percent_of_scale(mean_over_seeds(|seed| draw_stylus_offset(seed, 3.0).x * at(seed, 0.0)), 0.0, 6.0);
}

/// A stationary function minus its value at zero: Cov = σ²(ρ(a−b) − ρ(a) − ρ(b) + 1).
#[test]
fn linear_error_motions_have_the_declared_covariance() {
    let (sigma, length) = (1.5, 60.0);
    let rho = |d: f64| (-d * d / (2.0 * length * length)).exp();
    let draw = |seed| LinearErrors::draw(seed, [[sigma, length], [0.5, 200.0], [2.0, 100.0]]);
    let on_x = |seed, x| draw(seed).deviation_at([x, 0.0, 0.0]);
    let variance = sigma * sigma;
    for (a, b) in [(40.0, 40.0), (-48.0, 48.0), (100.0, 130.0), (20.0, 300.0)] {
        let expected = variance * (rho(a - b) - rho(a) - rho(b) + 1.0);
        let found = mean_over_seeds(|seed| on_x(seed, a).x * on_x(seed, b).x);
        assert_within_8_percent_of_scale(found, expected, 2.0 * variance);
        for across in
            [mean_over_seeds(|s| on_x(s, a).y * on_x(s, b).y), mean_over_seeds(|s| on_x(s, a).z * on_x(s, b).z)]
        {
            assert_within_8_percent_of_scale(across, expected, 2.0 * variance);
        }
        assert_within_8_percent_of_scale(mean_over_seeds(|s| on_x(s, a).x * on_x(s, b).y), 0.0, 2.0 * variance);
        assert_within_8_percent_of_scale(mean_over_seeds(|s| on_x(s, a).x * on_x(s, b).z), 0.0, 2.0 * variance);
    }
    let y = mean_over_seeds(|seed| draw(seed).deviation_at([0.0, 500.0, 0.0]).y.powi(2));
    assert_within_8_percent_of_scale(y, 2.0 * 0.25 * (1.0 - (-500.0_f64.powi(2) / 8e4).exp()), 0.5);
    for direction in 0..3 {
        let z = mean_over_seeds(|seed| draw(seed).deviation_at([0.0, 0.0, 400.0])[direction].powi(2));
        assert_within_8_percent_of_scale(z, 2.0 * 4.0 * (1.0 - (-400.0_f64.powi(2) / 2e4).exp()), 8.0);
    }
    assert!(draw(1).deviation_at([0.0; 3]).norm() < 1e-15);
    // The table that the world uses agrees with the sum of cosines, inside and outside of its range.
    let table = draw(1).tabulated_within([250.0; 3]);
    for x in (-600..600).map(|i| 0.51 * f64::from(i)) {
        let off = (table.deviation_at([x, -x, x]) - draw(1).deviation_at([x, -x, x])).norm();
        assert!(off < 1e-5 * (sigma + 0.5 + 2.0), "{off} at {x}");
    }
}

#[test]
fn linear_error_motions_move_the_true_position() {
    let mut bench = TestBench::ideal();
    bench.truth.seed = 9;
    bench.stated_axis_mut(Axis::X).error_motion_um = 3.0;
    let drawn = LinearErrors::draw(9, [[3e-3, 200.0], [0.0, 1.0], [0.0, 1.0]]);
    let found = touch_radius_and_latch_time(&mut bench.build_world(), PI, 0.0, 1).0;
    // Displayed −x where x + E_XX(x) reaches the part; the lateral shift by E_YX changes it by far less than 1 nm.
    let expected = BALL_CENTRE_CIRCLE_RADIUS_MM + drawn.deviation_at([-BALL_CENTRE_CIRCLE_RADIUS_MM, 0.0, 0.0]).x;
    assert!((found - expected).abs() < 1e-6, "{found} instead of {expected}");
    assert!((found - BALL_CENTRE_CIRCLE_RADIUS_MM).abs() > 1e-4);
}

#[test]
fn stylus_offset_and_lobing_turn_with_the_spindle() {
    let mut bench = TestBench::ideal();
    bench.truth.seed = 3;
    bench.probe.u_stylus_offset_um = 20.0;
    let mut world = bench.build_world();
    let offset = draw_stylus_offset(3, 0.020);
    // The ball is `offset` beyond the command; the lateral part acts in second order only.
    for (s, phi, beyond) in [
        (0.0, 0.0, offset.x),
        (0.0, FRAC_PI_2, offset.y),
        (FRAC_PI_2, 0.0, -offset.y),
        (FRAC_PI_2, FRAC_PI_2, offset.x),
        (PI, 0.0, -offset.x),
    ] {
        assert!(
            (touch_radius_and_latch_time(&mut world, phi, s, 1).0 - (BALL_CENTRE_CIRCLE_RADIUS_MM - beyond)).abs()
                < 2e-5
        );
    }
    bench.probe.u_stylus_offset_um = 0.0;
    bench.probe.lobing_um = 5.0;
    let mut world = bench.build_world();
    let plain = touch_radius_and_latch_time(&mut world, 0.3, 0.0, 2).0;
    // The same point of the ball has the same pre-travel. Positive pre-travel triggers late.
    assert!((touch_radius_and_latch_time(&mut world, 0.3 + 1.1, 1.1, 3).0 - plain).abs() < 1e-9);
    assert!((touch_radius_and_latch_time(&mut world, 0.3 + 1.1, 0.0, 4).0 - plain).abs() > 1e-4);
    let lobing = ProbeLobing::draw(3, 0.005, &[]).pre_travel_mm(Vector3::new(0.3_f64.cos(), 0.3_f64.sin(), 0.0));
    assert!((BALL_CENTRE_CIRCLE_RADIUS_MM - plain - lobing).abs() < 1e-9);
}

#[test]
fn drift_moves_the_table_and_grows_the_part() {
    let mut bench = TestBench::ideal();
    bench.truth.seed = 11;
    bench.machine.drift_um_per_h = 40.0;
    let mut world = bench.build_world();
    let drift = ThermalDrift::draw(11, 40.0);
    for hours in [0.0, 1.0, 3.0] {
        world.dwell(hours * 3600.0);
        for (number, phi) in [0.0, FRAC_PI_2, PI, -FRAC_PI_2].into_iter().enumerate() {
            let (found, t_s) = touch_radius_and_latch_time(&mut world, phi, 0.0, number as u32);
            let [x, y] = world.true_rotary_axis_position_mm(Axis::C, 50.0, t_s);
            let expected =
                BALL_CENTRE_CIRCLE_RADIUS_MM + x * phi.cos() + y * phi.sin() + drift.artefact_radius_growth_mm(t_s);
            // A centre 0.1 mm to the side shortens the chord by 0.1 µm.
            assert!((found - expected).abs() < 2e-4, "{found} instead of {expected}");
        }
    }
    // The time constant is 2 h: after it the rate is 1/e of the initial rate.
    let at = |hours: f64| world.true_rotary_axis_position_mm(Axis::C, 50.0, hours * 3600.0)[0];
    assert!((at(2.0) / at(4.0) - 1.0 / (1.0 + (-1.0_f64).exp())).abs() < 1e-9);
    assert!((at(1e-3) - drift.table_displacement_mm(3.6).x).abs() < 1e-12);
    assert_within_8_percent_of_scale(
        mean_over_seeds(|s| (ThermalDrift::draw(s, 40.0).table_displacement_mm(3.6).x / 40e-6).powi(2)),
        1.0,
        1.0,
    );
    assert_within_8_percent_of_scale(
        mean_over_seeds(|s| (ThermalDrift::draw(s, 40.0).artefact_radius_growth_mm(3.6) / 40e-6).powi(2)),
        1.0,
        1.0,
    );
}

#[test]
fn the_same_seed_gives_the_same_readings_in_any_order() {
    let mut bench = TestBench::ideal();
    bench.truth.seed = 77;
    bench.probe.repeatability_um = Some(1.0);
    let order = |steps: [u32; 4]| -> BTreeMap<u32, f64> {
        let mut world = bench.build_world();
        steps.map(|n| (n, touch_radius_and_latch_time(&mut world, f64::from(n), 0.0, n).0)).into()
    };
    let forward = order([1, 2, 3, 4]);
    assert_eq!(forward, order([1, 2, 3, 4]));
    for (n, radius) in order([3, 1, 4, 2]) {
        assert!((radius - forward[&n]).abs() < 1e-9);
        // Positive scatter triggers late, by the draw of (seed, n, 0).
        assert!((radius - (BALL_CENTRE_CIRCLE_RADIUS_MM - 1e-3 * draw_touch_scatter(77, n, 0))).abs() < 1e-9);
    }
    let mut world = bench.build_world();
    let twice = [0, 1].map(|_| touch_radius_and_latch_time(&mut world, 1.0, 0.0, 1).0);
    assert!((twice[0] - twice[1]).abs() > 1e-6);
    bench.truth.seed = 78;
    assert!((touch_radius_and_latch_time(&mut bench.build_world(), 1.0, 0.0, 1).0 - twice[0]).abs() > 1e-6);
}

#[test]
fn invalid_error_keys_and_vanishing_radius_are_refused() {
    let refused = |key: &str| {
        let mut bench = TestBench::ideal();
        bench.truth.errors.insert(key.to_owned(), 1.0);
        let error = SimulatedWorld::new(&bench.machine, &bench.probe, &bench.artefact, &bench.truth);
        error.unwrap_err().to_string()
    };
    assert!(refused("EX0C_urad").contains("EX0C_urad: the unit after the symbol must be _um"));
    assert!(refused("EX0C").contains("EX0C"));
    assert!(refused("EXQ7_um").contains("EXQ7"));
    assert!(refused("EX0A_um").contains("EX0A"));
    let unknown = toml::from_str::<MachineTruth>("centre_offset_um = [1, 2]").unwrap_err();
    assert!(unknown.to_string().contains("centre_offset_mm"));
    let mut bench = TestBench::ideal();
    bench.truth.radius_offset_mm = -PART_RADIUS_MM;
    let error = SimulatedWorld::new(&bench.machine, &bench.probe, &bench.artefact, &bench.truth);
    assert_eq!(error.unwrap_err(), SimulatedWorldError::InvalidCylinder);
}

/// T = begins + warms·(1 − e^(−t/2 h)), rounded to 0.01 K, with the declared scatter, and reproducible.
#[test]
fn thermometer_reading_follows_the_warm_up_with_the_declared_noise() {
    let mut bench = TestBench::ideal();
    let truth = "name = 'bed'\nbegins_c = 18.0\nwarms_k = 3.0\nnoise_k = 0.05";
    bench.truth.thermometer = vec![toml::from_str(truth).unwrap()];
    let mut world = bench.build_world().with_thermometers(&["bed", "spindle"]).unwrap();
    assert_eq!(world.temperature_c("nobody"), None);
    let said: Vec<f64> = (0..4000)
        .map(|_| {
            world.dwell(3.0);
            world.temperature_c("bed").unwrap()
        })
        .collect();
    let off = |(number, said): (usize, &f64)| {
        let t_s = 3.0 * (number + 1) as f64;
        said - (18.0 + 3.0 * (1.0 - (-t_s / 7200.0).exp()))
    };
    let off: Vec<f64> = said.iter().enumerate().map(off).collect();
    let moment = |power| off.iter().map(|off| off.powi(power)).sum::<f64>() / 4000.0;
    assert!(moment(1).abs() < 0.004, "{}", moment(1));
    assert_within_8_percent_of_scale(moment(2), 0.05 * 0.05, 0.05 * 0.05);
    assert!(said.iter().all(|celsius| (celsius * 100.0 - (celsius * 100.0).round()).abs() < 1e-6));
    // The value is the same for repeated calls, and in the same world created again.
    assert_eq!(world.temperature_c("bed"), world.temperature_c("bed"));
    let mut again = bench.build_world().with_thermometers(&["bed", "spindle"]).unwrap();
    again.dwell(3.0);
    assert_eq!(again.temperature_c("bed"), Some(said[0]));
    let stray = bench.build_world().with_thermometers(&["spindle"]).unwrap_err();
    assert!(matches!(stray, SimulatedWorldError::UnknownOrDuplicateThermometer { .. }), "{stray}");
    bench.truth.thermometer[0].noise_k = -1.0;
    let bad = bench.build_world().with_thermometers(&["bed"]).unwrap_err();
    assert!(matches!(bad, SimulatedWorldError::InvalidThermometer { .. }), "{bad}");
}
