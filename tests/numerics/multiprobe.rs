//! Multiprobe and multistep (METHODS sections 3 and 6) through the simulated machine: the plan is played on worlds
//! that differ in their seed. The world computes distances from motions, form, tilt and eccentricity by its own
//! chain and its own surfaces.

use std::ops::RangeInclusive;

use machine::Axis;
use machine::record::estimate::{Estimate, Unit};
use machine::record::plan::Plan;
use machine::record::reading::{Reading, ReadingFlag};
use methods::IdentifyError;
use rand::RngExt;
use rayon::prelude::*;
use simulator::SimulatedWorld;
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::machine_text::set_key;
use crate::support::plan_player;
use estimation::monte_carlo::{DrawDistribution, DrawStream};
use estimation::random::seeded_stream;
use testing::population::{coverage_seeds_and_share_limits, is_full_test_run, population_size, sd_ratio_bounds};

/// Key of the random stream that selects the missing samples.
const MISSING_SAMPLES_STREAM_KEY: u64 = 0x6d70;
const SENSOR_COUNT: usize = 7;

/// The built-in machine with drawn motions, forms and errors; `path`: keys joined by dots.
fn machine_with_drawn_errors(seed: u64, changes: &[(&str, Value)]) -> MachineFile {
    let mut table: Table = include_str!("../../config/multiprobe.toml").parse().unwrap();
    let motion: Table = "axis = \"C\"\nlinear_um = 1.0\nangular_urad = 5.0\nmax_order = 20".parse().unwrap();
    let fixed = [
        ("simulated.seed", Value::Integer(seed as i64)),
        ("simulated.rotary_motion", Value::Array(vec![motion.into()])),
        ("simulated.error_motion", Value::Array(Vec::new())),
        ("simulated.datum_cylinder.form_um", Value::Float(1.0)),
        ("simulated.datum_cylinder.tilt_urad", vec![40.0, -25.0].into()),
        ("simulated.stage.index_error_urad", Value::Float(349.0)),
        ("simulated.stage.eccentricity_um", Value::Float(2.0)),
        ("simulated.stage.tilt_urad", Value::Float(10.0)),
        ("method.multiprobe.samples", Value::Integer(1)),
        ("method.multiprobe.revolutions", Value::Integer(1)),
        ("method.multiprobe.monte_carlo_trials", Value::Integer(100)),
    ];
    for (path, value) in fixed.iter().chain(changes) {
        set_key(&mut table, path, value.clone());
    }
    MachineFile::parse("world.toml", toml::to_string(&table).unwrap()).unwrap()
}

/// The same machine with its true errors: angles, gains and positions of its sensors deviate by the declared sizes.
fn machine_with_true_sensor_errors(file: &MachineFile, seed: u64) -> MachineFile {
    let mut table: Table = file.text().parse().unwrap();
    let mut random = DrawStream::from_key(seed, &[0x7365_6e73]);
    let drawn = random.unit_variance_draws(2 + 2 * SENSOR_COUNT, &[DrawDistribution::Normal]);
    let sensors = table["sensor"].as_array_mut().unwrap();
    let mut truths = Vec::new();
    for (sensor, drawn_of) in sensors.iter_mut().zip(drawn[2..].chunks(2)) {
        let name = sensor["name"].as_str().unwrap().to_owned();
        let [mut zero, mut direction] =
            ["zero_mm", "direction"].map(|key| -> Vec<f64> { sensor[key].clone().try_into().unwrap() });
        if name == "z1" {
            zero[0] += 0.1 * drawn[0];
        } else {
            let (sin, cos) = (0.1 * drawn_of[0]).to_radians().sin_cos();
            for vector in [&mut zero, &mut direction] {
                let [x, y] = [vector[0], vector[1]];
                (vector[0], vector[1]) = (x * cos - y * sin, x * sin + y * cos);
            }
            zero[2] += if name.ends_with('2') { 0.05 * drawn[1] } else { 0.0 };
        }
        let table = sensor.as_table_mut().unwrap();
        table.insert("zero_mm".to_owned(), zero.into());
        table.insert("direction".to_owned(), direction.into());
        let truth = [("name", name.into()), ("gain", (1.0 + 1e-3 * drawn_of[1]).into())];
        truths
            .push(Value::Table(truth.map(|(key, value): (&str, Value)| (key.to_owned(), value)).into_iter().collect()));
    }
    set_key(&mut table, "simulated.sensor", truths.into());
    MachineFile::parse("truth.toml", toml::to_string(&table).unwrap()).unwrap()
}

struct PlayedRun {
    file: MachineFile,
    plan: Plan,
    method: Box<dyn methods::Method>,
    readings: Vec<Reading>,
}

fn play_run(file: MachineFile, seed: u64) -> PlayedRun {
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "multiprobe", None).unwrap();
    let mut world = setup::build_world(&machine_with_true_sensor_errors(&file, seed)).unwrap();
    let (plan, readings) = plan_player::measure_all_stages(&mut world, method.as_ref(), header);
    PlayedRun { file, plan, method, readings }
}

impl PlayedRun {
    fn estimate(&self) -> Result<Estimate, IdentifyError> {
        self.method.identify(&self.plan, &self.readings)
    }

    /// The true motion at [`POINTS_PER_TURN`] angles of a revolution in the unit of the estimate, without the
    /// co-rotating first order of (X, Y) and (A, B), and without the harmonics `lost`.
    fn true_curve(&self, world: &SimulatedWorld, symbol: &str, lost: &[f64]) -> Vec<f64> {
        let component: Axis = symbol[1..2].parse().unwrap();
        let motion =
            |of: Axis| turn_angles().map(|q| world.true_rotary_error_motion(Axis::C, of, q)).collect::<Vec<f64>>();
        let mut values = motion(component);
        let pair = match component {
            Axis::X | Axis::Y => Some((Axis::X, Axis::Y)),
            Axis::A | Axis::B => Some((Axis::A, Axis::B)),
            _ => None,
        };
        if let Some((first, second)) = pair {
            let turning = co_rotating_first_order(&motion(first), &motion(second));
            let turning = turning.into_iter().map(|(x, y)| if component == first { x } else { y });
            values.iter_mut().zip(turning).for_each(|(value, part)| *value -= part);
        }
        for order in lost {
            let part = |of: fn(f64) -> f64| {
                let products = turn_angles().zip(&values).map(|(q, value)| of(order * q) * value);
                2.0 / POINTS_PER_TURN as f64 * products.sum::<f64>()
            };
            let (c, s) = (part(f64::cos), part(f64::sin));
            for (q, value) in turn_angles().zip(&mut values) {
                *value -= c * (order * q).cos() + s * (order * q).sin();
            }
        }
        let factor = if component.is_linear() { 1e3 } else { 1e6 };
        values.iter().map(|value| value * factor).collect()
    }
}

/// Number of angles of a true curve in one revolution.
const POINTS_PER_TURN: usize = 720;

fn turn_angles() -> impl Iterator<Item = f64> {
    (0..POINTS_PER_TURN).map(|i| std::f64::consts::TAU * i as f64 / POINTS_PER_TURN as f64)
}

/// The part of the first order of (x, y) that turns with the table: clockwise seen from above for a rising command
/// of C (ISO 841).
fn co_rotating_first_order(x: &[f64], y: &[f64]) -> Vec<(f64, f64)> {
    let (mut along, mut across) = (0.0, 0.0);
    for ((q, x), y) in turn_angles().zip(x).zip(y) {
        // Rotated back by the table angle.
        along += (x * q.cos() - y * q.sin()) / POINTS_PER_TURN as f64;
        across += (x * q.sin() + y * q.cos()) / POINTS_PER_TURN as f64;
    }
    let turned = |q: f64| (along * q.cos() + across * q.sin(), across * q.cos() - along * q.sin());
    turn_angles().map(turned).collect()
}

const ERROR_MOTION_SYMBOLS: [&str; 5] = ["EXC", "EYC", "EZC", "EAC", "EBC"];

/// For each of the five curves: share of the points whose U contains the true value, and mean of (error/u)². With
/// one axial sensor the multiples of the indexes in EZC are lost: they are named, and not contained in its curve.
fn covered_share_and_squared_error_ratio(played: &PlayedRun, estimate: &Estimate) -> Vec<(f64, f64)> {
    let world = setup::build_world(&played.file).unwrap();
    let mut all = Vec::new();
    for curve in estimate.functions.iter().filter(|f| ERROR_MOTION_SYMBOLS.contains(&f.symbol.as_str())) {
        let is_angular = curve.symbol.starts_with("EA") || curve.symbol.starts_with("EB");
        assert_eq!(curve.unit, if is_angular { Unit::Urad } else { Unit::Um });
        let lost = |text: &String| {
            let order = text.strip_prefix(&format!("{} harmonic ", curve.symbol))?;
            order.parse::<f64>().ok()
        };
        let lost: Vec<f64> = estimate.not_identifiable.iter().filter_map(lost).collect();
        let expected = match curve.symbol.as_str() {
            "EZC" => harmonics_lost_in_ezc(&played.plan),
            _ => Vec::new(),
        };
        assert_eq!(lost, expected, "{}", curve.symbol);
        let truth = played.true_curve(&world, &curve.symbol, &lost);
        let (mut held, mut squares, count) = (0.0, 0.0, curve.x.len() as f64);
        for ((x, y), u) in curve.x.iter().zip(&curve.y).zip(&curve.u) {
            let off = y - truth[(x * POINTS_PER_TURN as f64 / 360.0).round() as usize % POINTS_PER_TURN];
            held += f64::from(u8::from(off.abs() <= 2.0 * u));
            squares += (off / u).powi(2);
        }
        all.push((held / count, squares / count));
    }
    assert_eq!(all.len(), ERROR_MOTION_SYMBOLS.len());
    all
}

/// Harmonics that are lost with one axial sensor: multiples of the number of indexes.
fn harmonics_lost_in_ezc(plan: &Plan) -> Vec<f64> {
    let of = |key: &str| plan.settings[key].as_f64().unwrap() as u32;
    (1..=of("harmonics")).filter(|k| k % of("indexes") == 0).map(f64::from).collect()
}

/// Checks each curve by the coverage standard of METHODS section 6, or by other `seeds` and bounds.
fn check_coverage(
    name: &str,
    changes: &[(&str, Value)],
    missing_share: f64,
    (seeds, shares): (u64, RangeInclusive<f64>),
) {
    // A small layout in the gate: many seeds are better evidence than many mountings.
    let changes = if is_full_test_run() {
        changes.to_vec()
    } else {
        [&machine_file_changes_for_small_layout()[..], changes].concat()
    };
    let one = |seed: u64| {
        let mut played = play_run(machine_with_drawn_errors(seed, &changes), seed);
        let mut random = seeded_stream(seed, &[MISSING_SAMPLES_STREAM_KEY]);
        for reading in &mut played.readings {
            if random.random::<f64>() < missing_share {
                (reading.value_mm, reading.flag) = (None, ReadingFlag::Range);
            }
        }
        let estimate = played.estimate().map_err(|error| format!("seed {seed}: {error}"))?;
        let is_named = estimate.warnings.iter().any(|line| line.contains("have no distance"));
        match is_named == (missing_share > 0.0) {
            true => Ok(covered_share_and_squared_error_ratio(&played, &estimate)),
            false => Err(format!("seed {seed}: {:#?}", estimate.warnings)),
        }
    };
    // Output of a pool thread is lost: the message must be passed to this thread.
    let all: Result<Vec<Vec<(f64, f64)>>, String> = (0..seeds).into_par_iter().map(one).collect();
    let all = all.unwrap();
    let mean = |curve: usize, of: fn(&(f64, f64)) -> f64| {
        all.iter().map(|curves| of(&curves[curve])).sum::<f64>() / seeds as f64
    };
    let curves = 0..ERROR_MOTION_SYMBOLS.len();
    let each: Vec<String> = curves
        .clone()
        .map(|i| format!("{} {:.3} ({:.2})", ERROR_MOTION_SYMBOLS[i], mean(i, |c| c.0), mean(i, |c| c.1)))
        .collect();
    println!("{name}, {seeds} seeds: share of the points within U (mean of (error/u)²): {}", each.join(", "));
    for curve in curves {
        let share = mean(curve, |of| of.0);
        assert!(shares.contains(&share), "{name}: {} {share}", ERROR_MOTION_SYMBOLS[curve]);
    }
}

/// Gains and angles of the radial sensors, as drawn for the true machine, are within their U; their differences
/// within a section are determined more accurately than declared.
#[test]
fn gains_and_angles_are_found_from_the_turns() {
    let (mut squares, mut differences, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..8 {
        let played = play_run(machine_with_drawn_errors(seed, &machine_file_changes_for_small_layout()), seed);
        let estimate = played.estimate().unwrap();
        let drawn = DrawStream::from_key(seed, &[0x7365_6e73])
            .unit_variance_draws(2 + 2 * SENSOR_COUNT, &[DrawDistribution::Normal]);
        for (quantity, place, declared) in [("gain", 1, 1e3), ("angle", 0, 0.1_f64.to_radians() * 1e6)] {
            for section in [["x1", "y1", "r1"], ["x2", "y2", "r2"]] {
                let error = |name: &str| {
                    let symbol = format!("{quantity}_{name}");
                    let found = estimate.parameters.iter().find(|p| p.symbol == symbol).unwrap();
                    let number = ["x1", "y1", "r1", "x2", "y2", "r2"].iter().position(|n| *n == name);
                    let truth = declared * drawn[2 + 2 * number.unwrap() + place];
                    (found.value - truth, found.u)
                };
                let errors = section.map(error);
                squares += errors.iter().map(|(error, u)| (error / u).powi(2)).sum::<f64>();
                let mean = errors.iter().map(|(error, _)| error).sum::<f64>() / 3.0;
                let spread = errors.iter().map(|(error, _)| ((error - mean) / declared).powi(2));
                differences += spread.sum::<f64>() / 2.0;
                count += 1.0;
            }
        }
    }
    let (squares, spread) = (squares / count / 3.0, (differences / count).sqrt());
    println!("mean of (error/u)² {squares:.2}; differences {spread:.3} of those declared");
    // The mean of three keeps its declared uncertainty: most of the sum is from 32 independent draws.
    assert!((0.5..1.7).contains(&squares) && spread < 0.5, "{squares} {spread}");
}

#[test]
fn coverage_on_the_built_in_machine() {
    check_coverage("dwell points", &[], 0.0, coverage_seeds_and_share_limits());
}

#[test]
fn coverage_with_missing_samples() {
    let changes = [("method.multiprobe.revolutions", Value::Integer(2))];
    let population = if is_full_test_run() { coverage_seeds_and_share_limits() } else { (30, 0.83..=1.0) };
    check_coverage("5 % missing", &changes, 0.05, population);
}

/// Machine-file changes for continuous turns: 18°/s, a sample every 0.18°.
fn machine_file_changes_for_continuous_turns() -> Vec<(&'static str, Value)> {
    let motion = parse_toml_table("axis = \"C\"\nlinear_um = 1.0\nangular_urad = 5.0\nmax_order = 8");
    vec![
        ("simulated.rotary_motion", Value::Array(vec![motion])),
        ("method.multiprobe.sampling", "continuous".into()),
        ("method.multiprobe.feed_deg_min", Value::Float(1080.0)),
        ("method.multiprobe.rate_hz", Value::Float(100.0)),
        ("method.multiprobe.indexes", Value::Integer(3)),
        ("method.multiprobe.harmonics", Value::Integer(8)),
        ("method.multiprobe.revolutions", Value::Integer(2)),
        ("axes.C.min", Value::Float(-60.0)),
        ("axes.C.max", Value::Float(900.0)),
    ]
}

#[test]
#[ignore = "a turn has thousands of samples: 200 worlds take ten minutes"]
fn coverage_of_continuous_turns() {
    check_coverage("continuous turns", &machine_file_changes_for_continuous_turns(), 0.0, (200, 0.93..=0.98));
}

/// Estimate of a small layout whose machine file has these changes; `Err`: why there is no estimate.
fn identify_with_faults(changes: &[(&str, Value)]) -> Result<Estimate, IdentifyError> {
    play_run(machine_with_drawn_errors(1, &[&machine_file_changes_for_small_layout()[..], changes].concat()), 1)
        .estimate()
}

/// Machine-file changes for a small layout: fewer mountings, stops and harmonics.
fn machine_file_changes_for_small_layout() -> Vec<(&'static str, Value)> {
    let motion = parse_toml_table("axis = \"C\"\nlinear_um = 1.0\nangular_urad = 5.0\nmax_order = 6");
    vec![
        ("simulated.rotary_motion", Value::Array(vec![motion])),
        ("method.multiprobe.indexes", Value::Integer(5)),
        ("method.multiprobe.positions", Value::Integer(45)),
        ("method.multiprobe.harmonics", Value::Integer(6)),
    ]
}

/// The reason why there is no estimate.
fn refusal_text(played: &PlayedRun) -> String {
    match played.estimate() {
        Ok(estimate) => panic!("{:#?}", estimate.warnings),
        Err(error) => error.to_string(),
    }
}

fn parse_toml_table(toml: &str) -> Value {
    Value::Table(toml.parse().unwrap())
}

#[test]
fn wrong_mounting_angle_is_named_and_omitted() {
    let fault = parse_toml_table("mounting = 3\noff_deg = 12.0");
    let found = identify_with_faults(&[("simulated.stage.faults", Value::Array(vec![fault]))]).unwrap();
    let named =
        |line: &String| line.contains("not used: the artefact was mounted 1") && line.contains("at mounting 4;");
    assert!(found.warnings.iter().any(named), "{:#?}", found.warnings);
    let right = identify_with_faults(&[]).unwrap();
    assert!(!right.warnings.iter().any(|line| line.contains("not used: the artefact")), "{:#?}", right.warnings);
}

/// Clockwise seen from the tip, by 72° each time: from the planned angle by −144°, −288° and so on.
#[test]
fn reversed_direction_of_the_mountings_is_refused() {
    let fault = |n: u32| parse_toml_table(&format!("mounting = {}\noff_deg = {}.0", n, -144 * i64::from(n)));
    let faults = Value::Array((1..5).map(fault).collect());
    let changes = [("simulated.stage.faults", faults)];
    let why = refusal_text(&play_run(
        machine_with_drawn_errors(1, &[&machine_file_changes_for_small_layout()[..], &changes].concat()),
        1,
    ));
    assert!(why.contains("turned in the opposite direction"), "{why}");
}

#[test]
fn two_wrong_mountings_are_reported_as_contradicting() {
    let faults = [parse_toml_table("mounting = 2\noff_deg = 9.0"), parse_toml_table("mounting = 4\noff_deg = -17.0")];
    let found = identify_with_faults(&[("simulated.stage.faults", Value::Array(faults.to_vec()))]).unwrap();
    let named = |line: &String| line.contains("contradict each other");
    assert!(found.warnings.iter().any(named), "{:#?}", found.warnings);
}

/// A channel without values in the first 50° loses revolutions of its own: the other channels are used without it.
#[test]
fn gap_at_a_turn_end_costs_revolutions_of_its_own_channel_only() {
    let estimate = |revolutions: i64| {
        let more = [("method.multiprobe.revolutions", Value::Integer(revolutions))];
        let mut played =
            play_run(machine_with_drawn_errors(1, &[&machine_file_changes_for_small_layout()[..], &more].concat()), 1);
        let turns = played.plan.steps.iter().filter(|step| step.label.starts_with("index/"));
        let turns: Vec<u32> = turns.map(|step| step.id).collect();
        for reading in &mut played.readings {
            let is_at_end = reading.position.get_or_zero(Axis::C).to_degrees() < 50.0;
            if turns.contains(&reading.step) && reading.sensor == "x1" && is_at_end {
                (reading.value_mm, reading.flag) = (None, ReadingFlag::Range);
            }
        }
        let estimate = played.estimate().unwrap();
        let named = format!("x1: 1 of {revolutions} revolutions have missing samples");
        let said = estimate.warnings.iter().any(|line| line.contains(&named));
        assert!(said, "{:#?}", estimate.warnings);
        (played, estimate)
    };
    let (_, without_x1) = estimate(1);
    assert!(without_x1.parameters.iter().any(|parameter| parameter.symbol == "EXC_c2"));
    let (played, estimate) = estimate(2);
    for (share, squares) in covered_share_and_squared_error_ratio(&played, &estimate) {
        assert!(share > 0.7 && squares < 4.0, "{share} {squares}");
    }
}

#[test]
fn mountings_of_a_round_artefact_are_not_verifiable() {
    let round = [("simulated.datum_cylinder.form_um", Value::Float(0.0))];
    let found = identify_with_faults(&round).unwrap();
    assert!(found.warnings.iter().any(|l| l.contains("not verifiable")), "{:#?}", found.warnings);
}

#[test]
fn saturated_channel_is_named_with_its_angles() {
    // Clips near the largest distance of a cylinder with an eccentricity of 9 µm.
    let clipped = parse_toml_table("name = \"x1\"\nclips_mm = [-0.0085, 0.3]");
    let mut played = play_run(machine_with_drawn_errors(1, &machine_file_changes_for_continuous_turns()), 1);
    let mut truth: Table = machine_with_true_sensor_errors(&played.file, 1).text().parse().unwrap();
    set_key(&mut truth, "simulated.sensor", Value::Array(vec![clipped]));
    let truth = MachineFile::parse("truth.toml", toml::to_string(&truth).unwrap()).unwrap();
    let mut world = setup::build_world(&truth).unwrap();
    let (_, header) = setup::configure_method_and_plan_without_steps(&played.file, "multiprobe", None).unwrap();
    let (plan, readings) = plan_player::measure_all_stages(&mut world, played.method.as_ref(), header);
    (played.plan, played.readings) = (plan, readings);
    let flat = |reading: &&Reading| reading.sensor == "x1" && reading.value_mm == Some(-0.0085);
    assert!(played.readings.iter().filter(flat).count() > 100);
    let warnings = played.estimate().unwrap().warnings;
    assert!(warnings.iter().any(|l| l.contains("x1") && l.contains("° to ")), "{warnings:#?}");
}

#[test]
fn swapped_channels_are_named() {
    let mut played = play_run(machine_with_drawn_errors(1, &machine_file_changes_for_small_layout()), 1);
    for reading in &mut played.readings {
        reading.sensor = match reading.sensor.as_str() {
            "y1" => "r1".to_owned(),
            "r1" => "y1".to_owned(),
            other => other.to_owned(),
        };
    }
    let refused = refusal_text(&played);
    assert!(refused.contains("y1") && refused.contains("r1 are swapped"), "{refused}");
}

/// A second of the clock of channel y2 is 1 % shorter than a true second.
#[test]
fn channel_with_a_fast_clock_is_named() {
    let mut played = play_run(machine_with_drawn_errors(1, &machine_file_changes_for_continuous_turns()), 1);
    // The run assigns a sample to a position by its time stamp.
    let step_of = |reading: &Reading| (reading.step, reading.sensor.clone());
    let starts: std::collections::BTreeMap<(u32, String), f64> =
        played.readings.iter().rev().map(|r| (step_of(r), r.t_s)).collect();
    let of_y2: Vec<Reading> = played.readings.iter().filter(|reading| reading.sensor == "y2").cloned().collect();
    for reading in played.readings.iter_mut().filter(|reading| reading.sensor == "y2") {
        let start = starts[&step_of(reading)];
        let at = start + (reading.t_s - start) * 1.01;
        let of_step = of_y2.chunk_by(|a, b| a.step == b.step).find(|samples| samples[0].step == reading.step).unwrap();
        // The samples of a step are in the order of their times.
        let after = of_step.partition_point(|sample| sample.t_s < at).min(of_step.len() - 1);
        reading.position = of_step[after].position.clone();
    }
    let refused = refusal_text(&played);
    assert!(refused.contains("y2") && refused.contains("clock"), "{refused}");
}

#[test]
fn unsuitable_layout_is_refused_with_a_better_one() {
    let refusal = |changes: &[(&str, Value)]| {
        let (method, header) =
            setup::configure_method_and_plan_without_steps(&machine_with_drawn_errors(1, changes), "multiprobe", None)
                .unwrap();
        let refused = methods::plan_nominal_stages(method.as_ref(), header).unwrap_err();
        format!("{} -> {}", refused.reason, refused.remedy)
    };
    let only = |names: &[&str]| -> Value { names.to_vec().into() };
    let of = |key: &'static str, value: Value| [(key, value)];
    let cases: Vec<(Vec<(&str, Value)>, &str)> = vec![
        (of("method.multiprobe.sensors", only(&["x1", "y1"])).to_vec(), "index the artefact in"),
        (of("method.multiprobe.indexes", Value::Integer(0)).to_vec(), "outside their limits"),
        (of("method.multiprobe.revolutions", Value::Integer(3)).to_vec(), "choose revolutions = 2"),
        (of("method.multiprobe.positions", Value::Integer(36)).to_vec(), "choose positions = 90"),
        (of("method.multiprobe.at", Value::Table(Table::new())).to_vec(), "does not contain X"),
        (of("method.multiprobe.sensors", only(&["x1", "y1", "z1"])).to_vec(), "two sections"),
    ];
    for (changes, expected) in cases {
        let refused = refusal(&changes);
        assert!(refused.contains(expected), "{expected}: {refused}");
    }
    // Opposite: the second sensor at 180°.
    let mut file: Table = machine_with_drawn_errors(1, &[]).text().parse().unwrap();
    let second = file["sensor"].as_array_mut().unwrap()[1].as_table_mut().unwrap();
    second.insert("zero_mm".to_owned(), vec![-30.0, 0.0, 60.0].into());
    second.insert("direction".to_owned(), vec![1.0, 0.0, 0.0].into());
    let file = MachineFile::parse("opposed.toml", toml::to_string(&file).unwrap()).unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "multiprobe", None).unwrap();
    let refused = methods::plan_nominal_stages(method.as_ref(), header).unwrap_err();
    assert!(refused.reason.contains("opposed") && refused.remedy.contains("move y1"), "{refused:?}");
}

/// The machine with sensors whose curve is not straight, as declared; or is straight, with the same declaration.
fn estimate_with_sensor_linearity(seed: u64, is_curved: bool) -> Estimate {
    let mut table: Table =
        machine_with_drawn_errors(seed, &machine_file_changes_for_small_layout()).text().parse().unwrap();
    for sensor in table["sensor"].as_array_mut().unwrap() {
        sensor.as_table_mut().unwrap().insert("linearity_um".to_owned(), 0.3.into());
    }
    let file = MachineFile::parse("curved.toml", toml::to_string(&table).unwrap()).unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "multiprobe", None).unwrap();
    let mut truth: Table = machine_with_true_sensor_errors(&file, seed).text().parse().unwrap();
    if !is_curved {
        for sensor in truth["simulated"]["sensor"].as_array_mut().unwrap() {
            let straight = Value::Array(Vec::new());
            sensor.as_table_mut().unwrap().insert("linearity".to_owned(), straight);
        }
    }
    let truth = MachineFile::parse("truth.toml", toml::to_string(&truth).unwrap()).unwrap();
    let (plan, readings) =
        plan_player::measure_all_stages(&mut setup::build_world(&truth).unwrap(), method.as_ref(), header);
    method.identify(&plan, &readings).unwrap()
}

#[test]
fn linearity_error_scatters_as_its_budget_line() {
    let seeds = population_size(40);
    let (low, high) = sd_ratio_bounds(seeds, 40, (0.6, 1.2));
    let squares = |seed: u64| {
        let [curved, straight] = [true, false].map(|is| estimate_with_sensor_linearity(seed, is));
        let (mut sum, mut count) = (0.0, 0.0);
        for (on, off) in curved.parameters.iter().zip(&straight.parameters) {
            let line = on.budget.iter().find(|line| line.source == "linearity of the sensors");
            let u = line.map_or(0.0, |line| line.u);
            let is_coefficient = on.symbol.contains("_c") || on.symbol.contains("_s");
            if is_coefficient && u > 0.2 * on.u {
                sum += ((on.value - off.value) / u).powi(2);
                count += 1.0;
            }
        }
        (sum, count)
    };
    let all: Vec<(f64, f64)> = (0..seeds).into_par_iter().map(squares).collect();
    let sum = |of: fn(&(f64, f64)) -> f64| all.iter().map(of).sum::<f64>();
    let (ratio, count) = ((sum(|s| s.0) / sum(|s| s.1)).sqrt(), sum(|s| s.1));
    println!("{ratio:.3} of {count} coefficients, within [{low:.3}, {high:.3}]");
    assert!((low..high).contains(&ratio), "{ratio}");
}

/// Without backlash, noise and mounting errors, only drift changes the means: linearly in time, forward and
/// backward.
#[test]
fn stability_of_each_mounting_is_monotonic_under_drift() {
    let changes =
        [("method.multiprobe.revolutions", Value::Integer(2)), ("machine.drift_um_per_h", Value::Float(30.0))];
    let estimate =
        play_run(machine_with_drawn_errors(1, &[&machine_file_changes_for_small_layout()[..], &changes].concat()), 1)
            .estimate()
            .unwrap();
    let stability = estimate.functions.iter().find(|f| f.symbol == "stability_x1").unwrap();
    assert_eq!(stability.y.len(), 5 * 4);
    for mounting in stability.y.chunks(4) {
        let steps: Vec<f64> = mounting.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| step * steps[0] > 0.0), "{mounting:?}");
    }
}
