//! The map of the probe in worlds whose pre-travel is computed from its definition, and its effect on later runs.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use rayon::prelude::*;
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use estimation::random::seeded_stream;
use machine::Axis;
use machine::record::estimate::{Estimate, Parameter, Verdict};
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use testing::population::{is_full_test_run, population_size};

use crate::machine_text::{parse_machine_file, set_key};
use crate::support::plan_player;
use crate::touch_without_path::touch_without_path;

const QUALIFICATION_MACHINE: &str = include_str!("../../config/probe-qualification.toml");
const SELF_CALIBRATION_MACHINE: &str = include_str!("../../config/simulated.toml");

const ZERO_RESOLUTION_KEYS: [(&str, Value); 3] = [
    ("axes.X.resolution_um", Value::Float(0.0)),
    ("axes.Y.resolution_um", Value::Float(0.0)),
    ("axes.Z.resolution_um", Value::Float(0.0)),
];

/// Deviation of the displayed position, mm, in the frame of the spindle, for the outward normal in the frame of the
/// spindle, and in that of the machine.
type ContactDeviation<'a> = &'a (dyn Fn(Vector3<f64>, Vector3<f64>) -> Vector3<f64> + Sync);

fn machine_file(text: &str, spindle_turns: bool, changes: &[(&str, Value)]) -> MachineFile {
    let mut table: Table = text.parse().unwrap();
    if !spindle_turns {
        table["axes"].as_table_mut().unwrap().remove("S");
    }
    changes.iter().for_each(|(path, value)| set_key(&mut table, path, value.clone()));
    parse_machine_file(&table)
}

/// A world without lobes and without rounding: [`measure_with_deviation`] adds them.
fn world_machine_file(text: &str, spindle_turns: bool, changes: &[(&str, Value)]) -> MachineFile {
    let none = ["probe.lobing_um", "axes.X.resolution_um", "axes.Y.resolution_um", "axes.Z.resolution_um"];
    let none = none.map(|key| (key, Value::Float(0.0)));
    machine_file(text, spindle_turns, &[changes, &none].concat())
}

/// Played in the world of `world`, with the deviation added to the displayed position.
fn measure_with_deviation(
    method: &str,
    file: &MachineFile,
    world: &MachineFile,
    deviation: ContactDeviation<'_>,
) -> (Plan, Vec<Reading>) {
    let (method, header) = setup::configure_method_and_plan_without_steps(file, method, None).unwrap();
    let mut world = setup::build_world(world).unwrap();
    let played = plan_player::try_measure_all_stages(&mut world, method.as_ref(), header, touch_without_path);
    let (plan, mut readings) = played.unwrap();
    for reading in &mut readings {
        let step = plan.steps.iter().find(|step| step.id == reading.step).unwrap();
        let normal = Vector3::from(step.normal);
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), step.from.get_or_zero(Axis::S));
        let displayed = reading.position.xyz_or_zero() + turn * deviation(turn.inverse() * normal, normal);
        for (axis, value) in Axis::LINEAR.into_iter().zip(displayed.iter()) {
            let step = file.machine.axes[&axis].resolution_um * 1e-3;
            let rounded = if step > 0.0 { (value / step).round() * step } else { *value };
            reading.position.set(axis, rounded);
        }
    }
    (plan, readings)
}

fn identify_readings(file: &MachineFile, plan: &Plan, readings: &[Reading]) -> Estimate {
    let (method, _) = setup::configure_method_and_plan_without_steps(file, &plan.method, None).unwrap();
    method.check_priors(plan).unwrap();
    method.identify(plan, readings).unwrap()
}

fn find_parameter<'e>(estimate: &'e Estimate, symbol: &str) -> &'e Parameter {
    estimate.parameters.iter().find(|own| own.symbol == symbol).unwrap()
}

/// Σ (c cos kα + s sin kα), falling to zero towards the pole.
fn lobing_along(terms: &[(f64, [f64; 2])], n: Vector3<f64>) -> f64 {
    let azimuth = n.y.atan2(n.x);
    let term = |(k, [c, s]): &(f64, [f64; 2])| c * (k * azimuth).cos() + s * (k * azimuth).sin();
    n.xy().norm() * terms.iter().map(term).sum::<f64>()
}

/// Standard normal deviates of a world (Box and Muller).
fn normal_draws(seed: u64) -> impl FnMut() -> f64 {
    let mut random = seeded_stream(seed, &[0x7175_616c]);
    move || {
        let (radius, angle): (f64, f64) = (random.random(), random.random());
        (-2.0 * (1.0 - radius).ln()).sqrt() * (TAU * angle).cos()
    }
}

/// Lobes of 1 um in each order from 2 to 6; a stylus offset of 5 um; a ball with 0.1 um of form. Everything else as
/// declared. Returns the estimate and the true values by symbol.
fn qualification_and_truth(seed: u64, spindle_turns: bool) -> (Estimate, Vec<(String, f64)>) {
    let changes = [
        ("simulated.seed", Value::Integer(seed as i64)),
        ("simulated.ball_form_um", 0.0.into()),
        ("probe.stylus_offset_um", 0.0.into()),
    ];
    let world = world_machine_file(QUALIFICATION_MACHINE, spindle_turns, &changes);
    let file = machine_file(QUALIFICATION_MACHINE, spindle_turns, &[]);
    let mut normal = normal_draws(seed);
    let mut terms = |size: f64| -> Vec<(f64, [f64; 2])> {
        (2..=6).map(|k| (f64::from(k), [(); 2].map(|()| size * normal()))).collect()
    };
    let (map, form) = (terms(1e-3), terms(0.1e-3 / 8f64.sqrt()));
    let offset = Vector3::new(normal(), normal(), 0.0) * 5e-3;
    let deviation = |in_spindle: Vector3<f64>, in_machine: Vector3<f64>| {
        in_spindle * (lobing_along(&map, in_spindle) + lobing_along(&form, in_machine)) - offset
    };
    let (plan, readings) = measure_with_deviation("probe-qualification", &file, &world, &deviation);
    let truth =
        map.iter().flat_map(|(k, [c, s])| [(format!("E_probe_c{k}"), c * 1e3), (format!("E_probe_s{k}"), s * 1e3)]);
    let mut truth: Vec<(String, f64)> = truth.collect();
    truth.push(("s_touch".to_owned(), 0.3));
    match spindle_turns {
        true => truth.extend([("x_stylus".to_owned(), offset.x * 1e3), ("y_stylus".to_owned(), offset.y * 1e3)]),
        // The second order is not corrected.
        false => drop(truth.drain(..2)),
    }
    (identify_readings(&file, &plan, &readings), truth)
}

/// Coverage standard of METHODS, section 6.
#[test]
fn probe_map_uncertainty_has_its_coverage() {
    const FULL_POPULATION: u64 = 1000;
    for turns in [true, false] {
        let worlds = population_size(FULL_POPULATION);
        let all: Vec<_> = (0..worlds).into_par_iter().map(|seed| qualification_and_truth(8000 + seed, turns)).collect();
        let is_flagged = |e: &Estimate| e.verdict != Verdict::None || !e.warnings.is_empty();
        let flagged = all.iter().filter(|(e, _)| is_flagged(e)).count();
        println!("turned {turns}: {flagged} of {worlds} flagged");
        assert!(flagged as u64 * 50 <= worlds.max(100), "{flagged} of {worlds} flagged");
        let (mut hits, mut count) = (0, 0);
        for (k, (symbol, _)) in all[0].1.iter().enumerate() {
            let deviation = |(estimate, truth): &(Estimate, Vec<(String, f64)>)| {
                let found = find_parameter(estimate, symbol);
                ((found.value - truth[k].1).abs(), found.expanded)
            };
            let within = all.iter().map(deviation).filter(|(off, u)| off <= u).count();
            let part = within as f64 / worlds as f64;
            println!("{symbol}: {:.1} %, U {:.3}", part * 100.0, find_parameter(&all[0].0, symbol).expanded);
            if is_full_test_run() {
                assert!((0.93..=0.985).contains(&part), "{symbol}: {part}");
            }
            (hits, count) = (hits + within, count + worlds as usize);
        }
        let part = hits as f64 / count as f64;
        println!("turned {turns}: {:.1} % of {count}", part * 100.0);
        assert!((0.93..=0.985).contains(&part), "{part}");
    }
}

fn three_lobe_deviation(phase: f64) -> impl Fn(Vector3<f64>, Vector3<f64>) -> Vector3<f64> + Sync {
    move |in_spindle, _| {
        let azimuth = in_spindle.y.atan2(in_spindle.x);
        in_spindle * (2e-3 * in_spindle.xy().norm() * (3.0 * azimuth + phase).cos())
    }
}

/// A probe with three lobes of 2 um in a spindle that cannot be turned, on a ball certified to 0.1 um.
#[test]
fn probe_map_removes_three_lobe_bias_of_self_calibration() {
    let worlds = population_size(100).max(10);
    let pair = |seed: u64| {
        let fixed = [
            ("simulated.seed", Value::Integer(seed as i64)),
            ("method.self-calibration.monte_carlo_trials", Value::Integer(100)),
            ("probe.lobing_um", 2.0.into()),
            ("probe.lobing_orders", Value::Array(Vec::new())),
        ];
        let lobes = three_lobe_deviation(normal_draws(seed)() * TAU);
        let ball = machine_file(QUALIFICATION_MACHINE, false, &fixed[..1]);
        let room = world_machine_file(QUALIFICATION_MACHINE, false, &fixed[..1]);
        let (plan, readings) = measure_with_deviation("probe-qualification", &ball, &room, &lobes);
        let map = identify_readings(&ball, &plan, &readings);
        // The rounding would differ between the worlds with and without lobes.
        let fixed = [&fixed[..], &ZERO_RESOLUTION_KEYS].concat();
        let part = machine_file(SELF_CALIBRATION_MACHINE, false, &fixed);
        let room = world_machine_file(SELF_CALIBRATION_MACHINE, false, &fixed);
        let (plan, round) = measure_with_deviation("self-calibration", &part, &room, &|_, _| Vector3::zeros());
        let reference = identify_readings(&part, &plan, &round);
        let (mut plan, readings) = measure_with_deviation("self-calibration", &part, &room, &lobes);
        let biased = identify_readings(&part, &plan, &readings);
        plan.priors = vec![map];
        let corrected = identify_readings(&part, &plan, &readings);
        assert!(corrected.gauge.iter().any(|line| line.contains("orders 3, 4, 5, 6; order 2")));
        let off = |estimate: &Estimate, symbol: &str| {
            find_parameter(estimate, symbol).value - find_parameter(&reference, symbol).value
        };
        let bias = |estimate: &Estimate| off(estimate, "EX0C").hypot(off(estimate, "EY0C"));
        let u = |estimate: &Estimate| find_parameter(estimate, "EX0C").u;
        ([bias(&biased), bias(&corrected)], [u(&biased), u(&corrected)])
    };
    let pairs: Vec<_> = (8500..8500 + worlds).into_par_iter().map(pair).collect();
    let [without, with] = [0, 1].map(|k| {
        let squares: f64 = pairs.iter().map(|(bias, _)| bias[k].powi(2)).sum();
        (squares / worlds as f64).sqrt()
    });
    println!("bias {without:.3} um, with the map {with:.3} um; u of EX0C {:?}", pairs[0].1);
    assert!(without > 1.5 && with <= 0.1 * without, "{without} {with}");
    assert!(pairs.iter().all(|(_, [without, with])| with < &(0.5 * without)));
}

fn no_deviation(_: Vector3<f64>, _: Vector3<f64>) -> Vector3<f64> {
    Vector3::zeros()
}

/// Measures on the built-in machine without an S axis, with this deviation; returns machine file, plan, readings.
fn measure_qualification_without_spindle_turns(
    changes: &[(&str, Value)],
    deviation: ContactDeviation<'_>,
) -> (MachineFile, Plan, Vec<Reading>) {
    let file = machine_file(QUALIFICATION_MACHINE, false, changes);
    let room = world_machine_file(QUALIFICATION_MACHINE, false, changes);
    let (plan, readings) = measure_with_deviation("probe-qualification", &file, &room, deviation);
    (file, plan, readings)
}

#[test]
fn undeclared_lobes_contradict_the_map() {
    let nine = |n: Vector3<f64>, _: Vector3<f64>| n * lobing_along(&[(9.0, [1e-3, 0.0])], n);
    let (file, plan, readings) = measure_qualification_without_spindle_turns(&[], &nine);
    assert_eq!(identify_readings(&file, &plan, &readings).verdict, Verdict::UndecidedModel);
    let declared = [("probe.lobing_orders", Value::Array(vec![Value::Integer(9)]))];
    let (file, plan, readings) = measure_qualification_without_spindle_turns(&declared, &nine);
    let estimate = identify_readings(&file, &plan, &readings);
    let found = find_parameter(&estimate, "E_probe_c9");
    assert_eq!(estimate.verdict, Verdict::None);
    assert!((found.value - 1.0).abs() < 3.0 * found.u, "{found:?}");
    // A later run rejects an estimate with a misfit.
    let (method, mut plan) = setup::configure_method_and_plan_without_steps(&file, "samba", None).unwrap();
    let contradicted = Estimate { verdict: Verdict::UndecidedModel, ..estimate.clone() };
    plan.priors = vec![contradicted];
    assert!(method.check_priors(&plan).unwrap_err().reason.contains("contradict its model"));
    plan.priors = vec![estimate.clone(), estimate];
    assert!(method.check_priors(&plan).unwrap_err().reason.contains("two qualifications"));
}

#[test]
fn form_of_an_uncertified_ball_is_not_attributed_to_the_probe() {
    let mut table: Table = QUALIFICATION_MACHINE.parse().unwrap();
    table["axes"].as_table_mut().unwrap().remove("S");
    table["method"]["probe-qualification"].as_table_mut().unwrap().remove("form_um");
    let file = parse_machine_file(&table);
    let (plan, readings) = measure_with_deviation("probe-qualification", &file, &file, &no_deviation);
    let estimate = identify_readings(&file, &plan, &readings);
    assert!(estimate.parameters.iter().all(|own| !own.symbol.starts_with("E_probe")));
    let says = |text: &str| estimate.not_identifiable.iter().any(|line| line.contains(text));
    assert!(says("map at order 3, 4, 5, 6: inseparable from the form of the ball, because no"));
    let (method, mut plan) = setup::configure_method_and_plan_without_steps(&file, "samba", None).unwrap();
    plan.priors = vec![estimate];
    assert!(method.check_priors(&plan).unwrap_err().remedy.contains("form_um"));
}

/// A ball that has moved meanwhile has another centre, but the map of the probe is the same.
#[test]
fn probe_map_agrees_if_the_ball_moves_in_an_interruption() {
    let three = |n: Vector3<f64>, _: Vector3<f64>| n * lobing_along(&[(3.0, [2e-3, 0.0])], n);
    let (file, mut plan, mut readings) = measure_qualification_without_spindle_turns(&[], &three);
    let before = identify_readings(&file, &plan, &readings);
    let middle = readings[readings.len() / 2].t_s;
    plan.interruption_times_s = vec![middle];
    for reading in readings.iter_mut().filter(|reading| reading.t_s > middle) {
        let moved = reading.position.xyz_or_zero() + Vector3::new(0.04, -0.03, 0.02);
        for (axis, value) in Axis::LINEAR.into_iter().zip(moved.iter()) {
            reading.position.set(axis, *value);
        }
    }
    let after = identify_readings(&file, &plan, &readings);
    assert_eq!(after.verdict, Verdict::None, "{:?}", after.warnings);
    for symbol in ["E_probe_c3", "E_probe_s3", "E_probe_c5"] {
        let [before, after] = [&before, &after].map(|estimate| find_parameter(estimate, symbol));
        assert!((before.value - after.value).abs() < before.u, "{symbol}: {before:?} {after:?}");
    }
}

#[test]
fn erroneous_touch_is_named() {
    let (file, plan, mut readings) = measure_qualification_without_spindle_turns(&[], &no_deviation);
    let number = 60;
    let step = plan.steps.iter().find(|step| step.id == readings[number].step).unwrap();
    let off = readings[number].position.xyz_or_zero() + Vector3::from(step.normal) * 5e-3;
    for (axis, value) in Axis::LINEAR.into_iter().zip(off.iter()) {
        readings[number].position.set(axis, *value);
    }
    let estimate = identify_readings(&file, &plan, &readings);
    let named: Vec<&str> =
        estimate.outliers.iter().flat_map(|one| &one.candidates).map(|one| one.label.as_str()).collect();
    assert_eq!((named, estimate.verdict), (vec![step.label.as_str()], Verdict::UndecidedModel));
}

/// With a turned spindle: SAMBA gives the same machine and stylus as without lobes and offset.
#[test]
fn probe_map_with_turned_spindle_removes_bias_in_samba() {
    const SAMBA_MACHINE: &str = include_str!("../../config/samba.toml");
    let seed = [
        ("simulated.seed", Value::Integer(11)),
        ("probe.lobing_um", 3.0.into()),
        ("probe.lobing_orders", Value::Array(Vec::new())),
    ];
    let offset = Vector3::new(4e-3, -3e-3, 0.0);
    let off = |n: Vector3<f64>, _: Vector3<f64>| n * lobing_along(&[(3.0, [2e-3, 2e-3])], n) - offset;
    let ball = machine_file(QUALIFICATION_MACHINE, true, &seed);
    let still = [&seed[..], &[("probe.stylus_offset_um", 0.0.into())]].concat();
    let room = world_machine_file(QUALIFICATION_MACHINE, true, &still);
    let (plan, readings) = measure_with_deviation("probe-qualification", &ball, &room, &off);
    let map = identify_readings(&ball, &plan, &readings);

    let trials = [&seed[..], &[("method.samba.monte_carlo_trials", Value::Integer(100))]].concat();
    let trials = [&trials[..], &ZERO_RESOLUTION_KEYS].concat();
    let file = machine_file(SAMBA_MACHINE, true, &trials);
    let room = world_machine_file(SAMBA_MACHINE, true, &trials);
    let (plan, sound) = measure_with_deviation("samba", &file, &room, &no_deviation);
    let reference = identify_readings(&file, &plan, &sound);
    let (mut plan, readings) = measure_with_deviation("samba", &file, &room, &off);
    let biased = identify_readings(&file, &plan, &readings);
    plan.priors = vec![map];
    let corrected = identify_readings(&file, &plan, &readings);
    let shift = |estimate: &Estimate, symbol: &str| {
        (find_parameter(estimate, symbol).value - find_parameter(&reference, symbol).value).abs()
    };
    for symbol in ["tool_x", "tool_y", "EX0C", "EC0B", "EXX1"] {
        let [before, after] = [&biased, &corrected].map(|estimate| shift(estimate, symbol));
        let u = find_parameter(&corrected, symbol).u;
        println!("{symbol}: {before:.5} without the map, {after:.5} with it, u {u:.5}");
        assert!(after < 2.0 * u, "{symbol}");
    }
    // Limits in mm: up to the offset of the stylus.
    assert!(shift(&biased, "tool_x") > 3e-3 && shift(&corrected, "tool_x") < 3e-4);
}
