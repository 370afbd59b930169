//! The discrete R-test through the simulated machine: coverage (METHODS section 6), and comparison with
//! self-calibration of the same table. The error motions are those of the machine file; the world computes poses
//! from them by its own chain.

use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::Method;
use methods::decision::function_difference::function_differences;
use methods::decision::parameter_difference::parameter_differences;
use nalgebra::{Matrix2, Vector2};
use simulator::SimulatedWorld;
use toml::{Table, Value};
use trued::setup;

use crate::machine_text::{parse_machine_file, set_key};
use crate::support::plan_player;
use testing::population::{is_full_test_run, population_size};

const R_TEST_MACHINE: &str = include_str!("../../config/r-test.toml");
const SELF_CALIBRATION_MACHINE: &str = include_str!("../../config/simulated.toml");
/// Height of the sphere above the table, mm.
const SPHERE_HEIGHT_MM: f64 = 60.0;

fn machine_toml_table(seed: u64) -> Table {
    let mut table: Table = R_TEST_MACHINE.parse().unwrap();
    set_key(&mut table, "simulated.seed", Value::Integer(seed as i64));
    set_key(&mut table, "method.r-test.monte_carlo_trials", Value::Integer(100));
    // The simulated machine is exactly at its commanded position, a multiple of the display step.
    for axis in ["X", "Y", "Z"] {
        set_key(&mut table, &format!("axes.{axis}.resolution_um"), Value::Float(0.0));
    }
    // The simulated sphere has no form error.
    set_key(&mut table, "method.r-test.u_sphere_form_um", Value::Float(0.0));
    table
}

struct PlayedRun {
    method: Box<dyn Method>,
    plan: Plan,
    readings: Vec<Reading>,
    world: SimulatedWorld,
}

fn play_run(table: &Table, method: &str) -> PlayedRun {
    let file = parse_machine_file(table);
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, method, None).unwrap();
    let mut world = setup::build_world(&file).unwrap();
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    PlayedRun { method, plan, readings, world }
}

/// The estimate, and the true position of the axis in the middle of the run relative to the stated one, mm.
fn estimate_and_true_axis_mm(table: &Table, method: &str) -> (Estimate, Vector2<f64>) {
    let PlayedRun { method, plan, readings, world } = play_run(table, method);
    let estimate = method.identify(&plan, &readings).unwrap();
    let times = readings.iter().map(|reading| reading.t_s);
    let middle = times.clone().sum::<f64>() / times.count() as f64;
    // Relative to the stated axis: errors of linear axes and stylus offset are errors of the result, and the table
    // drifts.
    let declared = |key: &str| table["simulated"]["errors"][key].as_float().unwrap() * 1e-3;
    let drift = world.true_table_drift_mm(middle);
    (estimate, Vector2::new(declared("EX0C_um") + drift[0], declared("EY0C_um") + drift[1]))
}

/// Error motion of the machine file, um.
fn declared_error_motion_um(table: &Table, symbol: &str, angle: f64) -> f64 {
    let terms = table["simulated"]["error_motion"].as_array().unwrap();
    let of_symbol = terms.iter().filter(|term| term["symbol"].as_str() == Some(symbol));
    let value = |term: &Value| {
        let part = |key: &str| term[key].as_float().unwrap();
        let (sin, cos) = (term["harmonic"].as_integer().unwrap() as f64 * angle).sin_cos();
        part("cos_um") * cos + part("sin_um") * sin
    };
    of_symbol.map(value).sum()
}

/// E_total = (I − R)c + e − R·e(0) of METHODS section 1, um; C turns the table against its command (ISO 841).
fn total_error_motion_um(table: &Table, axis_um: Vector2<f64>, degrees: f64) -> Vector2<f64> {
    let motion = |angle| ["EXC", "EYC"].map(|symbol| declared_error_motion_um(table, symbol, angle));
    let angle = degrees.to_radians();
    let (sin, cos) = (-angle).sin_cos();
    let turn = Matrix2::new(cos, -sin, sin, cos);
    axis_um - turn * axis_um + Vector2::from(motion(angle)) - turn * Vector2::from(motion(0.0))
}

#[test]
fn r_test_coverage_on_the_built_in_machine() {
    let worlds = population_size(200);
    let shares = if is_full_test_run() { 0.93..=0.98 } else { 0.88..=1.0 };
    let (mut held, mut count) = ([0.0; 3], [0.0; 3]);
    for seed in 0..worlds {
        let table = machine_toml_table(seed);
        let (estimate, axis) = estimate_and_true_axis_mm(&table, "r-test");
        let axis = axis * 1e3;
        for (parameter, truth) in estimate.parameters.iter().filter(|p| p.symbol.ends_with("0C")).zip(axis.iter()) {
            held[0] += f64::from(u8::from((parameter.value - truth).abs() <= parameter.expanded));
            count[0] += 1.0;
        }
        for curve in &estimate.functions {
            let k = usize::from(curve.symbol.starts_with("EY"));
            let kind = if curve.symbol.ends_with("_total") { 1 } else { 2 };
            for ((x, y), u) in curve.x.iter().zip(&curve.y).zip(&curve.u).skip(1) {
                let truth = match curve.symbol.as_str() {
                    "EZC" => declared_error_motion_um(&table, "EZC", x.to_radians()),
                    _ if kind == 1 => total_error_motion_um(&table, axis, *x)[k],
                    _ => total_error_motion_um(&table, Vector2::zeros(), *x)[k],
                };
                held[kind] += f64::from(u8::from((y - truth).abs() <= 2.0 * u));
                count[kind] += 1.0;
            }
        }
    }
    let share = [0, 1, 2].map(|kind| held[kind] / count[kind]);
    println!("axis position, total, motion: {share:.4?} within U, {worlds} worlds");
    assert!(share.iter().all(|share| shares.contains(share)), "{share:?}");
}

/// Measures the same table by both methods, each with its own probe and sensors.
#[test]
fn r_test_agrees_with_self_calibration() {
    let r_test = machine_toml_table(3);
    let (first, _) = estimate_and_true_axis_mm(&r_test, "r-test");
    let mut other: Table = SELF_CALIBRATION_MACHINE.parse().unwrap();
    set_key(&mut other, "simulated.seed", Value::Integer(4));
    set_key(&mut other, "method.self-calibration.heights_mm", vec![SPHERE_HEIGHT_MM].into());
    for key in ["errors", "error_motion"] {
        set_key(&mut other, &format!("simulated.{key}"), r_test["simulated"][key].clone());
    }
    let (second, _) = estimate_and_true_axis_mm(&other, "self-calibration");
    let parameters = parameter_differences(&first, &second, &[]);
    let functions = function_differences(&first, &second, 2.0);
    let symbols: Vec<&str> = functions.iter().map(|function| function.symbol.as_str()).collect();
    assert_eq!(symbols, ["EXC_total", "EYC_total", "EXC", "EYC"]);
    let of_parameters = parameters.iter().map(|difference| difference.normalized_error);
    let of_points = functions.iter().flat_map(|function| function.normalized_errors.iter().copied());
    let all: Vec<f64> = of_parameters.chain(of_points).collect();
    println!("E_n: {all:.2?}");
    let agreeing = all.iter().filter(|e_n| **e_n <= 1.0).count();
    assert!(agreeing as f64 >= 0.9 * all.len() as f64, "{all:.2?}");
}

#[test]
fn swapped_sensors_are_refused_before_the_table_turns() {
    let mut table = machine_toml_table(1);
    let truth = parse_machine_file(&table);
    let sensors = table["sensor"].as_array_mut().unwrap();
    let [a, b] = [0, 1].map(|i| sensors[i]["direction"].clone());
    let [zero_a, zero_b] = [0, 1].map(|i| sensors[i]["zero_mm"].clone());
    let declare = |sensor: &mut Value, zero: Value, direction: Value| {
        let sensor = sensor.as_table_mut().unwrap();
        sensor.insert("zero_mm".to_owned(), zero);
        sensor.insert("direction".to_owned(), direction);
    };
    declare(&mut sensors[0], zero_b, b);
    declare(&mut sensors[1], zero_a, a);
    let (method, header) =
        setup::configure_method_and_plan_without_steps(&parse_machine_file(&table), "r-test", None).unwrap();
    let mut world = setup::build_world(&truth).unwrap();
    let refused =
        plan_player::try_measure_all_stages(&mut world, method.as_ref(), header, plan_player::play_step).unwrap_err();
    assert!(refused.reason.contains("along the direction of b"), "{refused:?}");
}

#[test]
fn two_interruptions_without_readings_between_add_one_step() {
    let PlayedRun { method, mut plan, readings, .. } = play_run(&machine_toml_table(1), "r-test");
    let plain = method.identify(&plan, &readings).unwrap();
    let turns = plan.steps.iter().find(|step| step.label == "turn/forward").unwrap().id;
    let begins_s = readings.iter().find(|reading| reading.step == turns).unwrap().t_s;
    // Both gaps are before the last measured turn.
    plan.interruption_times_s = vec![begins_s - 0.2, begins_s - 0.1];
    let stopped = method.identify(&plan, &readings).unwrap();
    assert_eq!(stopped.unknowns, plain.unknowns + 3);
    assert!(stopped.warnings.iter().any(|line| line.contains("interrupted")));
    for (one, other) in plain.parameters.iter().zip(&stopped.parameters) {
        assert!((one.value - other.value).abs() <= one.expanded + other.expanded, "{}", one.symbol);
    }
}

#[test]
fn readings_without_table_turns_are_refused() {
    let PlayedRun { method, mut plan, mut readings, .. } = play_run(&machine_toml_table(1), "r-test");
    plan.steps.retain(|step| !step.label.starts_with("turn/"));
    readings.retain(|reading| plan.steps.iter().any(|step| step.id == reading.step));
    let refused = method.identify(&plan, &readings).unwrap_err();
    assert!(refused.to_string().contains("the table has not turned"), "{refused}");
}
