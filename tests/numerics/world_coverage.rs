//! Coverage of the stated uncertainty: worlds whose sources are declared by magnitude only.

use nalgebra::{Matrix4, Vector4};

use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Step, StepKind};
use methods::{NextStage, ObjectPositionSource};
use trued::setup::{self, MachineFile};

use crate::support::plan_player;
use testing::population::{population_size, sd_ratio_bounds};

const FULL_WORLD_COUNT: u64 = 200;

/// The built-in machine with other keys: each replaces the value of the named key wherever it is not 0.
fn machine_file_with_changes(changes: &[(&str, &str)]) -> MachineFile {
    let mut text = include_str!("../../config/simulated.toml").to_owned();
    for (key, value) in changes {
        let before = text.clone();
        let lines = text.lines().map(|line| match line.split_once('=') {
            Some((name, now)) if name.trim() == *key && now != " 0.0" => {
                format!("{key} = {value}\n")
            }
            _ => format!("{line}\n"),
        });
        text = lines.collect();
        assert_ne!(text, before, "{key} changes nothing");
    }
    text.push_str("\n[method.self-calibration]\nmonte_carlo_trials = 100\n");
    MachineFile::parse("world.toml", text).expect("a sound machine file")
}

/// Estimate and truth (um, um, um/m, urad) of one world.
fn estimate_and_truth(file: &MachineFile) -> (Estimate, [f64; 4]) {
    let (method, header) =
        setup::configure_method_and_plan_without_steps(file, "self-calibration", None).expect("settings");
    let mut world = setup::build_world(file).expect("a world");
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    let estimate = method.identify(&plan, &readings).expect("an estimate");
    let cycle: Vec<f64> = readings.iter().skip(5).map(|reading| reading.t_s).collect();
    let middle = (cycle[0] + cycle[cycle.len() - 1]) / 2.0;
    let [x, y] = world.true_rotary_axis_position_mm(Axis::C, 50.0, middle);
    (estimate, [x * 1e3, y * 1e3, 0.0, 0.0])
}

/// χ² of the four parameters against the true values, with the stated covariance.
fn chi2_of_four_parameters(estimate: &Estimate, truth: [f64; 4]) -> f64 {
    let symbols = ["EX0C", "EY0C", "EYY1-EXX1", "EC0Y"];
    assert_eq!(estimate.covariance.symbols, symbols);
    let off: Vec<f64> = estimate.parameters.iter().zip(truth).take(4).map(|(p, t)| p.value - t).collect();
    let rows = &estimate.covariance.rows;
    let matrix = Matrix4::from_fn(|i, j| rows[i][j]);
    let off = Vector4::from_column_slice(&off);
    off.dot(&(matrix.try_inverse().unwrap() * off))
}

/// Asserts that the mean over the worlds of χ²/4 is within the 99 % bounds of χ² with 4·worlds degrees of freedom.
fn assert_mean_chi2(changes: &[(&str, &str)]) {
    let worlds = population_size(FULL_WORLD_COUNT);
    let mut sum = 0.0;
    for seed in 0..worlds {
        let seed = (1000 + seed).to_string();
        let mut all = vec![("seed", seed.as_str())];
        all.extend_from_slice(changes);
        let (estimate, truth) = estimate_and_truth(&machine_file_with_changes(&all));
        sum += chi2_of_four_parameters(&estimate, truth) / 4.0;
    }
    assert_mean_chi2_within_bounds(sum / worlds as f64, worlds);
}

fn assert_mean_chi2_within_bounds(mean: f64, worlds: u64) {
    let dof = 4.0 * worlds as f64;
    let (low, high) = estimation::coverage::chi_square_bounds(dof, 0.99).expect("bounds");
    let (low, high) = (low / dof, high / dof);
    println!("mean normalised χ² {mean:.3}, within [{low:.3}, {high:.3}]");
    assert!((low..high).contains(&mean), "mean normalised χ² {mean} outside [{low}, {high}]");
}

#[test]
fn mean_chi2_is_within_bounds_with_all_sources() {
    assert_mean_chi2(&[]);
}

#[test]
fn mean_chi2_is_within_bounds_with_poor_axes() {
    assert_mean_chi2(&[
        ("error_motion_um", "3.0"),
        ("error_wavelength_mm", "60.0"),
        ("drift_um_per_h", "60.0"),
        ("lobing_um", "1.5"),
        ("stylus_offset_um", "1.0"),
    ]);
}

/// The sources that can be declared, by their name in the budget and their key; a declared repeatability cannot be
/// zero.
const SOURCE_KEYS: [(&str, &str, &str, &str); 6] = [
    ("repeatability of a touch", "repeatability_um", "1.0", "0.001"),
    ("resolution", "resolution_um", "3.0", "0.0"),
    ("stylus offset", "stylus_offset_um", "1.0", "0.0"),
    ("probe lobing", "lobing_um", "1.0", "0.0"),
    ("error motions of X, Y and Z", "error_motion_um", "1.0", "0.0"),
    ("thermal drift", "drift_um_per_h", "60.0", "0.0"),
];

/// One source alone (METHODS section 6): its budget line equals the observed scatter.
#[test]
fn each_budget_line_equals_the_scatter_of_its_source() {
    const FULL_POPULATION: u64 = 100;
    let worlds = population_size(FULL_POPULATION);
    let (low, high) = sd_ratio_bounds(worlds, FULL_POPULATION, (0.8, 1.2));
    for (name, key, on, _) in SOURCE_KEYS {
        let (mut squares, mut stated, mut count) = (0.0, 0.0, 0.0);
        for world in 0..worlds as u32 {
            let seed = (5000 + world).to_string();
            // Rounding is random only if the part is at a different position each time.
            let offset = |step: f64| (f64::from(world) * step).fract() - 0.5;
            let place = format!("[{:.5}, {:.5}]", offset(0.618034), offset(0.754878));
            let mut changes = vec![("seed", seed.as_str()), ("centre_offset_mm", place.as_str())];
            // A short wavelength lets the error motions act within the part.
            changes.push(("error_wavelength_mm", "40.0"));
            for (_, other, _, off) in SOURCE_KEYS {
                changes.push((other, if other == key { on } else { off }));
            }
            // Drift that is not fitted must be in the budget.
            let order = i32::from(key != "drift_um_per_h");
            let text = format!("{}drift_order = {order}\n", machine_file_with_changes(&changes).text());
            let file = MachineFile::parse("alone.toml", text).expect("a sound machine file");
            let (estimate, truth) = estimate_and_truth(&file);
            for (parameter, truth) in estimate.parameters.iter().zip(truth).take(2) {
                squares += (parameter.value - truth).powi(2);
                let line = parameter.budget.iter().find(|line| line.source == name);
                stated += line.unwrap_or_else(|| panic!("no line for {name}")).u.powi(2);
                count += 1.0;
            }
        }
        let (seen, stated) = ((squares / count).sqrt(), (stated / count).sqrt());
        let ratio = seen / stated;
        println!("{name}: seen {ratio:.3} of stated, within [{low:.3}, {high:.3}]");
        assert!((low..=high).contains(&ratio), "{name}: seen {seen} um, stated {stated} um");
    }
}

/// With the spindle following the probe angle neither stylus offset nor lobing affects the axis position; with a
/// fixed spindle they do.
#[test]
fn spindle_orientation_along_the_normal_removes_stylus_offset_and_lobing() {
    let found = |spindle: &str| {
        let changes = [("seed", "77"), ("stylus_offset_um", "20.0"), ("lobing_um", "8.0")];
        let text = machine_file_with_changes(&changes)
            .text()
            .replace("[method.self-calibration]\n", &format!("[method.self-calibration]\nspindle = \"{spindle}\"\n"));
        let (estimate, truth) =
            estimate_and_truth(&MachineFile::parse("follow.toml", text).expect("a sound machine file"));
        let off = |i: usize| estimate.parameters[i].value - truth[i];
        (off(0).hypot(off(1)), estimate.parameters[0].u)
    };
    let (fixed, u_fixed) = found("fixed");
    let (following, u_following) = found("follow");
    assert!(fixed > 5.0 && u_fixed > 15.0, "fixed: {fixed} um, u {u_fixed} um");
    assert!(following < 2.0 && u_following < 0.6, "following: {following} um, u {u_following} um");
}

/// Estimate and truth of a run that is interrupted for ten minutes after `touches_before_stop` touches of the
/// cycle. Meanwhile a shift of 3 µm in X occurs: `part_share` of it moves the part on the table, the rest moves the
/// table axis. Then the references are measured again, and the remaining touches are made.
fn estimate_and_truth_of_interrupted_run(
    seed: u64,
    touches_before_stop: usize,
    part_share: f64,
) -> (Estimate, [f64; 4]) {
    const INTERRUPTION_STEP_UM: f64 = 3.0;
    const INTERRUPTION_S: f64 = 600.0;
    let seed = seed.to_string();
    let changes = [("seed", seed.as_str()), ("drift_um_per_h", "20.0")];
    let (before, after) = (machine_file_with_changes(&changes), {
        let mut moved = changes.to_vec();
        let table = format!("{}", 50.0 + INTERRUPTION_STEP_UM * (1.0 - part_share));
        let part = format!("[{}, -0.5]", 0.8 + 1e-3 * INTERRUPTION_STEP_UM * part_share);
        moved.extend([("EX0C_um", table.as_str()), ("centre_offset_mm", part.as_str())]);
        machine_file_with_changes(&moved)
    });
    let (method, mut plan) =
        setup::configure_method_and_plan_without_steps(&before, "self-calibration", None).expect("settings");
    let mut world = setup::build_world(&before).expect("a world");
    let mut readings = Vec::new();
    let mut done = Vec::new();
    for (pass, count) in [5, touches_before_stop].into_iter().enumerate() {
        let next = method.next_stage(&plan, &done, ObjectPositionSource::Measured(&readings)).expect("well-posed");
        let NextStage::Stage { stage, new_steps } = next else { panic!("pass {pass}") };
        let played = new_steps.iter().take(count);
        readings.extend(played.map(|step| plan_player::play_step(&mut world, step, 0)));
        plan.steps.extend(new_steps);
        done.push(stage);
    }
    let last = world.time_s();
    plan.interruption_times_s = vec![readings[readings.len() - 1].t_s];
    let mut later = setup::build_world(&after).expect("a world");
    later.advance(last + INTERRUPTION_S, readings.iter().map(|reading| reading.step));
    let cycle = plan.steps[5..].to_vec();
    let newest = |place: &str| -> &Step {
        let here = |step: &&Step| step.kind == StepKind::Reference && step.label.ends_with(place);
        cycle[..touches_before_stop].iter().rev().find(here).expect("a reference")
    };
    for place in ["P000", "P090", "P180"] {
        readings.push(plan_player::play_step(&mut later, newest(place), FIRST_REPEAT_NUMBER_AFTER_STOP));
    }
    readings.extend(cycle[touches_before_stop..].iter().map(|step| plan_player::play_step(&mut later, step, 0)));
    let estimate = method.identify(&plan, &readings).expect("an estimate");

    // The middle of the measuring time, without the interruption.
    let (first, end) = (readings[5].t_s, readings[readings.len() - 1].t_s);
    let begun = readings[5 + touches_before_stop].t_s;
    let middle = first + (end - first - (begun - plan.interruption_times_s[0])) / 2.0;
    let [x, y] = if middle <= plan.interruption_times_s[0] {
        world.true_rotary_axis_position_mm(Axis::C, 50.0, middle)
    } else {
        later.true_rotary_axis_position_mm(Axis::C, 50.0, middle + begun - plan.interruption_times_s[0])
    };
    (estimate, [x * 1e3, y * 1e3, 0.0, 0.0])
}

/// A machine that moved during an interruption: the step is fitted, and U remains valid wherever the cycle was
/// interrupted. Without the gap in the plan this fails by far.
#[test]
fn mean_chi2_is_within_bounds_across_an_interruption() {
    let (worlds, mut sum) = (population_size(120), 0.0);
    for world in 0..worlds {
        let kept = 8 + (world as usize * 7) % 52;
        let share = ((world + 1) as f64 * 0.618034).fract();
        let (estimate, truth) = estimate_and_truth_of_interrupted_run(9000 + world, kept, share);
        sum += chi2_of_four_parameters(&estimate, truth) / 4.0;
    }
    assert_mean_chi2_within_bounds(sum / worlds as f64, worlds);
}
