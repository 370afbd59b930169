//! Self-calibration with error motions of C from an earlier estimate. The estimates are computed from the world's
//! own motions, without an estimator.

use std::f64::consts::TAU;

use machine::Axis;
use machine::record::estimate::{Estimate, EstimatedFunction, Parameter};
use machine::record::plan::Plan;
use rayon::prelude::*;
use serde_json::{Value as Json, json};
use simulator::SimulatedWorld;
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::machine_text::changed_machine_file;
use crate::support::plan_player;
use estimation::monte_carlo::{DrawDistribution, DrawStream};
use testing::population::{population_size, sd_ratio_bounds};

const ERROR_MOTION_COMPONENTS: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
const MAX_HARMONIC_ORDER: usize = 20;
/// Number of angles at which the motions of the world are evaluated.
const SAMPLES_PER_TURN: usize = 360;
/// Key of the random stream for the errors of an estimate.
const PRIOR_ERROR_STREAM_KEY: u64 = 0x7072_696f;

/// The built-in machine with other values; `path`: keys joined by dots.
fn machine_of_seed(seed: u64, changes: &[(&str, Value)]) -> MachineFile {
    let fixed = [
        ("simulated.seed", Value::Integer(seed as i64)),
        ("method.self-calibration.monte_carlo_trials", Value::Integer(100)),
    ];
    changed_machine_file(include_str!("../../config/simulated.toml"), fixed.iter().chain(changes))
}

/// Motions of C in all components to order 20, and no other disturbance.
fn machine_with_c_motions_only(changes: &[(&str, Value)]) -> MachineFile {
    let motion: Table = "axis = \"C\"\nlinear_um = 4.0\nangular_urad = 40.0\nmax_order = 20".parse().unwrap();
    let mut all = vec![
        ("simulated.rotary_motion", Value::Array(vec![motion.into()])),
        ("simulated.centre_offset_mm", vec![0.1, -0.05].into()),
        ("machine.drift_um_per_h", 0.0.into()),
        ("probe.repeatability_um", 0.001.into()),
        ("probe.lobing_um", 0.0.into()),
        ("probe.stylus_offset_um", 0.0.into()),
    ];
    for path in ["axes.X", "axes.Y", "axes.Z"] {
        all.push((leak_text(format!("{path}.error_motion_um")), 0.0.into()));
        all.push((leak_text(format!("{path}.resolution_um")), 0.0.into()));
    }
    all.extend_from_slice(changes);
    machine_of_seed(11, &all)
}

fn leak_text(text: String) -> &'static str {
    text.leak()
}

/// Options for an earlier estimate of the error motions of C, computed from the true motions of a world.
#[derive(Clone, Copy)]
struct KnownMotionOptions {
    components: &'static [Axis],
    /// Factor of the motions: 1 for the true motions.
    motion_factor: f64,
    has_coefficients: bool,
    /// Standard uncertainty of each coefficient; the errors of the coefficients are drawn with it from the seed.
    coefficient_std_u: f64,
    coefficient_error_seed: u64,
}

const EXACT_KNOWN_MOTIONS: KnownMotionOptions = KnownMotionOptions {
    components: &ERROR_MOTION_COMPONENTS,
    motion_factor: 1.0,
    has_coefficients: true,
    coefficient_std_u: 0.0,
    coefficient_error_seed: 0,
};

impl KnownMotionOptions {
    fn prior_estimate(self, world: &SimulatedWorld) -> Estimate {
        let mut parameters: Vec<Json> = Vec::new();
        let mut functions: Vec<Json> = Vec::new();
        for component in self.components {
            let symbol = format!("E{component}C");
            let (unit, scale) = if component.is_linear() { ("um", 1e3) } else { ("urad", 1e6) };
            let coefficients = self.harmonic_coefficients(world, *component, scale);
            let at = |deg: f64| -> f64 {
                let term = |(i, [cos, sin]): (usize, &[f64; 2])| {
                    let angle = (i + 1) as f64 * deg.to_radians();
                    cos * angle.cos() + sin * angle.sin()
                };
                coefficients.iter().enumerate().map(term).sum()
            };
            let degrees: Vec<f64> = (0..=72).map(|i| 5.0 * f64::from(i)).collect();
            functions.push(json!({
                "symbol": symbol, "argument": "C", "argument_unit": "deg", "x": degrees, "unit": unit,
                "y": degrees.iter().map(|deg| at(*deg)).collect::<Vec<_>>(),
                "u": vec![self.coefficient_std_u; degrees.len()],
            }));
            for (i, pair) in coefficients.iter().enumerate().filter(|_| self.has_coefficients) {
                parameters.extend(["c", "s"].into_iter().zip(pair).map(|(part, value)| {
                    json!({"symbol": format!("{symbol}_{part}{}", i + 1), "value": value,
                        "unit": unit, "u": self.coefficient_std_u, "U": 2.0 * self.coefficient_std_u, "k": 2.0, "dof": null,
                        "identifiable": true})
                }));
            }
        }
        let symbols: Vec<&Json> = parameters.iter().map(|own| &own["symbol"]).collect();
        let mut rows = vec![vec![0.0; symbols.len()]; symbols.len()];
        rows.iter_mut().enumerate().for_each(|(i, row)| row[i] = self.coefficient_std_u.powi(2));
        serde_json::from_value(json!({
            "trued_estimate": 1, "method": "ball-plate", "parameters": parameters,
            "functions": functions, "covariance": {"symbols": symbols, "rows": rows}, "rank": 1,
            "unknowns": 1, "condition": 1.0, "gauge": [], "not_identifiable": [],
            "residual_rms_um": 0.0, "degrees_of_freedom": 0, "chi2_per_dof": 1.0,
            "verdict": "none", "warnings": [], "priors": [],
        }))
        .unwrap()
    }

    /// Cosine and sine parts of the orders from 1 on, in the unit of the estimate.
    fn harmonic_coefficients(self, world: &SimulatedWorld, component: Axis, scale: f64) -> Vec<[f64; 2]> {
        let angles: Vec<f64> = (0..SAMPLES_PER_TURN).map(|i| TAU * i as f64 / SAMPLES_PER_TURN as f64).collect();
        let values: Vec<f64> = angles.iter().map(|q| world.true_rotary_error_motion(Axis::C, component, *q)).collect();
        let key = [PRIOR_ERROR_STREAM_KEY, component as u64];
        let errors = DrawStream::from_key(self.coefficient_error_seed, &key)
            .unit_variance_draws(2 * MAX_HARMONIC_ORDER, &[DrawDistribution::Normal]);
        let part = |order: usize, of: fn(f64) -> f64, error: f64| {
            let sum: f64 = angles.iter().zip(&values).map(|(q, v)| v * of(order as f64 * q)).sum();
            self.motion_factor * scale * sum * 2.0 / SAMPLES_PER_TURN as f64 + self.coefficient_std_u * error
        };
        let orders = (1..=MAX_HARMONIC_ORDER).zip(errors.chunks(2));
        orders.map(|(n, e)| [part(n, f64::cos, e[0]), part(n, f64::sin, e[1])]).collect()
    }
}

/// Estimates in one world: without priors and with each of the priors; and the true axis, um.
fn estimates_with_priors_and_true_axis(file: &MachineFile, priors: &[KnownMotionOptions]) -> (Vec<Estimate>, [f64; 2]) {
    let (method, header) = setup::configure_method_and_plan_without_steps(file, "self-calibration", None).unwrap();
    let mut world = setup::build_world(file).unwrap();
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    let with = priors.iter().map(|prior| vec![prior.prior_estimate(&world)]);
    let identify = |priors| method.identify(&Plan { priors, ..plan.clone() }, &readings).unwrap();
    let estimates = std::iter::once(Vec::new()).chain(with).map(identify).collect();
    let middle = (readings[5].t_s + readings[readings.len() - 1].t_s) / 2.0;
    (estimates, world.true_rotary_axis_position_mm(Axis::C, 50.0, middle).map(|mm| mm * 1e3))
}

fn parameter<'a>(estimate: &'a Estimate, symbol: &str) -> &'a Parameter {
    estimate.parameters.iter().find(|parameter| parameter.symbol == symbol).unwrap()
}

/// Distance of the axis position from the truth, um.
fn axis_deviation_um(estimate: &Estimate, truth: [f64; 2]) -> f64 {
    let off = |i: usize| estimate.parameters[i].value - truth[i];
    off(0).hypot(off(1))
}

/// Largest |value| of the error motions that self-calibration reports, um.
fn largest_error_motion_um(estimate: &Estimate) -> f64 {
    let is_motion = |f: &&EstimatedFunction| f.symbol.starts_with("EXC@") || f.symbol.starts_with("EYC@");
    let own = estimate.functions.iter().filter(is_motion).flat_map(|f| &f.y);
    own.map(|value| value.abs()).fold(0.0, f64::max)
}

/// Tilt of the axis, urad.
fn axis_tilt_urad(estimate: &Estimate) -> f64 {
    parameter(estimate, "EA0C").value.hypot(parameter(estimate, "EB0C").value)
}

/// Two heights, so that tilts and levers count. The remaining error is that of a machine without error motions;
/// with the wrong sign it is twice that of the machine.
fn assert_known_motions_subtracted(changes: &[(&str, Value)]) {
    let mut all = vec![("method.self-calibration.heights_mm", Value::from(vec![30.0, 70.0]))];
    all.extend_from_slice(changes);
    let wrong = KnownMotionOptions { motion_factor: -1.0, ..EXACT_KNOWN_MOTIONS };
    let points = KnownMotionOptions { has_coefficients: false, ..EXACT_KNOWN_MOTIONS };
    let (found, truth) =
        estimates_with_priors_and_true_axis(&machine_with_c_motions_only(&all), &[EXACT_KNOWN_MOTIONS, points, wrong]);
    let [without, exact, points, wrong] = found.as_slice() else { panic!("four estimates") };
    let offs = found.iter().map(|one| axis_deviation_um(one, truth)).collect::<Vec<_>>();
    let motions = found.iter().map(largest_error_motion_um).collect::<Vec<_>>();
    println!("axis {offs:.3?} um, motions {motions:.3?} um");
    assert!(offs[0] > 0.5 && motions[0] > 5.0, "the machine must need it");
    for (i, with) in [(1, exact), (2, points)] {
        assert!(offs[i] < 0.02 && motions[i] < 0.05, "{offs:?} {motions:?}");
        assert!(axis_tilt_urad(with) < 0.1, "{} urad", axis_tilt_urad(with));
    }
    assert!(axis_tilt_urad(without) > 1.0 && (axis_tilt_urad(wrong) - 2.0 * axis_tilt_urad(without)).abs() < 0.1);
    assert!((offs[3] - 2.0 * offs[0]).abs() < 0.02 && motions[3] > 1.9 * motions[0]);
}

#[test]
fn known_motions_are_subtracted() {
    assert_known_motions_subtracted(&[]);
}

/// Coefficients refer to the commanded angle, whatever the sense of rotation.
#[test]
fn known_motions_of_a_reversed_axis_are_subtracted() {
    assert_known_motions_subtracted(&[("axes.C.positive", "reversed".into())]);
}

/// With five positions order 5 is not separable from the location of the axis. Without known motions, the declared
/// magnitude is in the budget; known motions replace it.
#[test]
fn known_motions_reduce_u_and_keep_the_coverage() {
    const FULL_POPULATION: u64 = 1000;
    let worlds = population_size(FULL_POPULATION);
    let right = KnownMotionOptions { components: &[Axis::X, Axis::Y], coefficient_std_u: 0.3, ..EXACT_KNOWN_MOTIONS };
    let of_world = |world: u64| {
        let seed = 3000 + world;
        let file = machine_of_seed(
            seed,
            &[
                ("axes.C.error_motion_um", 4.0.into()),
                ("axes.C.error_motion_orders", [2, 3, 4, 5].map(Value::Integer).to_vec().into()),
                ("method.self-calibration.positions", Value::Integer(5)),
            ],
        );
        let right = KnownMotionOptions { coefficient_error_seed: seed, ..right };
        let (found, truth) =
            estimates_with_priors_and_true_axis(&file, &[right, KnownMotionOptions { motion_factor: -1.0, ..right }]);
        let squares = |estimate: &Estimate| {
            let square = |i: usize| {
                let own = &estimate.parameters[i];
                [(own.value - truth[i]).powi(2), own.u.powi(2)]
            };
            let [x, y] = [square(0), square(1)];
            [x[0] + y[0], x[1] + y[1]]
        };
        let expanded = |i: usize| found[i].parameters[0].expanded;
        assert!(expanded(1) < 0.7 * expanded(0), "U {} without, {} with", expanded(0), expanded(1));
        let lines =
            |i: usize| -> Vec<&str> { found[i].parameters[0].budget.iter().map(|line| line.source.as_str()).collect() };
        assert!(lines(0).contains(&"error motions of C") && !lines(1).contains(&"error motions of C"));
        assert!(lines(1).contains(&"estimate of ball-plate"));
        found.iter().map(squares).collect::<Vec<[f64; 2]>>()
    };
    let all: Vec<Vec<[f64; 2]>> = (0..worlds).into_par_iter().map(of_world).collect();
    let sum = |i: usize, k: usize| all.iter().map(|world| world[i][k]).sum::<f64>();
    let ratio = |i: usize| (sum(i, 0) / sum(i, 1)).sqrt();
    let (low, high) = sd_ratio_bounds(2 * worlds, 2 * FULL_POPULATION, (0.93, 1.07));
    println!(
        "seen of stated: without {:.3}, with {:.3}, with the wrong sign {:.3}; bounds [{low:.3}, {high:.3}]",
        ratio(0),
        ratio(1),
        ratio(2)
    );
    assert!((low..=high).contains(&ratio(0)) && (low..=high).contains(&ratio(1)));
    assert!(sum(1, 0) < 0.5 * sum(0, 0) && sum(2, 0) > 2.0 * sum(0, 0) && ratio(2) > high);
}

/// At Z = 50 mm above `point_mm` a motion EBC displaces the part by EBC·50 mm in X, EAC by −EAC·50 mm in Y. With 1
/// µm and 20 µrad, fully correlated, both cancel or add up.
#[test]
fn u_of_known_motions_keeps_their_correlation() {
    let file = machine_with_c_motions_only(&[]);
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "self-calibration", None).unwrap();
    let mut world = setup::build_world(&file).unwrap();
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    let prior = EXACT_KNOWN_MOTIONS.prior_estimate(&world);
    let u_of_prior = |location: &str, correlated: [(&str, f64); 2]| {
        let mut prior = prior.clone();
        let covariance = &mut prior.covariance;
        let index = |symbol: &str| covariance.symbols.iter().position(|own| own == symbol).unwrap();
        let places = correlated.map(|(symbol, u)| (index(symbol), u));
        for (i, u) in places {
            places.iter().for_each(|(j, other)| covariance.rows[i][*j] = u * other);
        }
        let plan = Plan { priors: vec![prior], ..plan.clone() };
        let estimate = method.identify(&plan, &readings).unwrap();
        let lines = &parameter(&estimate, location).budget;
        lines.iter().find(|line| line.source == "estimate of ball-plate").map_or(0.0, |line| line.u)
    };
    for (location, motion, angular, sign) in [("EX0C", "EXC_c8", "EBC_c8", 1.0), ("EY0C", "EYC_c8", "EAC_c8", -1.0)] {
        let added = u_of_prior(location, [(motion, 1.0), (angular, sign * 20.0)]);
        let cancelled = u_of_prior(location, [(motion, 1.0), (angular, -sign * 20.0)]);
        assert!((added - 2.0).abs() < 0.02 && cancelled < 0.02, "{location}: {added}, {cancelled}");
        let of_other_order = u_of_prior(location, [(motion, 0.0), ("EXC_s7", 1.0)]);
        assert!(of_other_order < 0.02, "{of_other_order}");
    }
}
