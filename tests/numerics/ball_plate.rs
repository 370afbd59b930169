//! Coverage of the ball plate's curves (METHODS section 6) through the simulated machine: the printed plan is
//! played on worlds that differ in their seed. The error motions are those of the machine file; the world turns
//! them into poses by its own chain.

use std::ops::RangeInclusive;

use machine::record::estimate::Estimate;
use machine::record::reading::{Flag, Reading};
use rand::RngExt;
use rayon::prelude::*;
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::support::plan_player;
use estimation::random::stream;
use testing::population::{is_full, population};

/// In the middle of the played plan, which takes 3430 s.
const LOOSE_FROM_S: f64 = 1700.0;
/// Key of the stream that chooses the missing visits.
const MISSING: u64 = 0x6d69_7373;

/// The built-in machine with other values; `path`: keys with dots between.
fn machine(seed: u64, changes: &[(&str, Value)]) -> MachineFile {
    let mut table: Table = include_str!("../../config/ball-plate.toml").parse().unwrap();
    let fixed = [
        ("simulated.seed", Value::Integer(seed as i64)),
        // The plan is played without a search.
        ("simulated.centre_offset_mm", vec![0.024, -0.018].into()),
        ("method.ball-plate.monte_carlo_trials", Value::Integer(100)),
        ("method.ball-plate.references", Value::Boolean(false)),
    ];
    for (path, value) in fixed.iter().chain(changes) {
        let (tables, key) = path.rsplit_once('.').unwrap();
        let inner = tables.split('.').fold(&mut table, |table, key| {
            table.entry(key).or_insert_with(|| Table::new().into()).as_table_mut().unwrap()
        });
        inner.insert(key.to_owned(), value.clone());
    }
    MachineFile::parse("world.toml", toml::to_string(&table).unwrap()).unwrap()
}

/// Error motion of the machine file at an angle, in the unit of the estimate.
fn truth(file: &MachineFile, symbol: &str, degrees: f64) -> f64 {
    let table: Table = file.text().parse().unwrap();
    let terms = table["simulated"]["error_motion"].as_array().unwrap();
    let of_symbol = terms.iter().filter(|term| term["symbol"].as_str() == Some(symbol));
    let value = |term: &Value, keys: [&str; 2]| {
        keys.iter().filter_map(|key| term.get(*key)?.as_float()).sum::<f64>()
    };
    of_symbol
        .map(|term| {
            let harmonic = term["harmonic"].as_integer().unwrap() as f64;
            let (sin, cos) = (harmonic * degrees.to_radians()).sin_cos();
            value(term, ["cos_um", "cos_urad"]) * cos + value(term, ["sin_um", "sin_urad"]) * sin
        })
        .sum()
}

/// `missing`: share of the visits whose touches are flagged.
fn estimate(file: &MachineFile, seed: u64, missing: f64) -> Estimate {
    let (method, header) = setup::header(file, "ball-plate", None).unwrap();
    let (plan, _) = methods::nominal(method.as_ref(), header).unwrap();
    let mut world = setup::world(file).unwrap();
    let mut random = stream(seed, &[MISSING]);
    let (mut visit, mut is_missing) = (String::new(), false);
    let mut readings: Vec<Reading> = Vec::new();
    for step in plan.steps.iter().filter(|step| step.label.starts_with("slow/")) {
        let of_step = step.label.rsplit_once('/').unwrap().0;
        if of_step != visit {
            (visit, is_missing) = (of_step.to_owned(), random.random::<f64>() < missing);
        }
        let mut reading = plan_player::play(&mut world, step, 0);
        if is_missing {
            reading.flag = Flag::Excluded;
        }
        readings.push(reading);
    }
    method.identify(&plan, &readings, &[]).unwrap()
}

/// Share of the points of all six curves whose U holds the truth.
fn covered(file: &MachineFile, estimate: &Estimate) -> f64 {
    let names = ["EXC", "EYC", "EZC", "EAC", "EBC", "ECC"];
    let curves = estimate.functions.iter().filter(|f| names.contains(&f.symbol.as_str()));
    let (mut held, mut count) = (0.0, 0.0);
    for curve in curves {
        for ((x, y), u) in curve.x.iter().zip(&curve.y).zip(&curve.u) {
            held += f64::from(u8::from((y - truth(file, &curve.symbol, *x)).abs() <= 2.0 * u));
            count += 1.0;
        }
    }
    assert!(count >= 6.0 * 72.0, "{count} points");
    held / count
}

fn covers(name: &str, changes: &[(&str, Value)], missing: f64) {
    // A world takes seconds.
    let seeds = population(100);
    let shares: RangeInclusive<f64> = if is_full() { 0.93..=0.975 } else { 0.91..=0.985 };
    let one = |seed: u64| {
        let file = machine(seed, changes);
        let estimate = estimate(&file, seed, missing);
        (covered(&file, &estimate), estimate.chi2_per_dof)
    };
    let all: Vec<(f64, f64)> = (0..seeds).into_par_iter().map(one).collect();
    let mean = |of: fn(&(f64, f64)) -> f64| all.iter().map(of).sum::<f64>() / seeds as f64;
    let (share, chi2) = (mean(|(share, _)| *share), mean(|(_, chi2)| *chi2));
    println!(
        "{name}: {share:.4} of the points within U, χ² {chi2:.3} of what is expected, {seeds} seeds"
    );
    assert!(shares.contains(&share), "{name}: {share}");
}

#[test]
fn u_is_true_on_the_built_in_machine() {
    covers("as shipped", &[], 0.0);
}

#[test]
fn u_is_true_on_a_poor_machine_with_a_twentieth_of_the_visits_missing() {
    let changes = [
        ("probe.repeatability_um", Value::Float(1.0)),
        ("machine.drift_um_per_h", Value::Float(20.0)),
    ];
    covers("poor, 5 % missing", &changes, 0.05);
}

/// A value for each stop, in place of harmonics.
#[test]
fn values_at_the_stops_hold_the_truth() {
    let changes = [("method.ball-plate.values", Value::Boolean(true))];
    let file = machine(1, &changes);
    let estimate = estimate(&file, 1, 0.0);
    let share = covered(&file, &estimate);
    println!("{share:.3} of the values within U");
    assert!(share > 0.9, "{share}");
}

#[test]
fn sub_harmonics_are_drawn_over_all_revolutions() {
    let changes = [
        ("axes.C.max", Value::Float(720.0)),
        ("method.ball-plate.revolutions", Value::Integer(2)),
        ("method.ball-plate.sub_harmonics", Value::Integer(2)),
        ("method.ball-plate.both_directions", Value::Boolean(false)),
    ];
    let file = machine(1, &changes);
    let estimate = estimate(&file, 1, 0.0);
    let curve = estimate.functions.iter().find(|function| function.symbol == "EXC").unwrap();
    assert_eq!(curve.x.last(), Some(&720.0));
    let half = estimate.parameters.iter().find(|parameter| parameter.symbol == "EXC_c1/2").unwrap();
    assert!(half.value.abs() < 1.5 * half.expanded, "{half:?}");
    assert!(covered(&file, &estimate) > 0.9);
}

/// 20 µm between the first revolution and the second.
#[test]
fn a_ball_that_comes_loose_is_named() {
    let mut moved: Table = Table::new();
    moved.insert("ball".to_owned(), "4".into());
    moved.insert("at_s".to_owned(), Value::Float(LOOSE_FROM_S));
    moved.insert("by_mm".to_owned(), vec![0.0, 0.02, 0.0].into());
    let changes = [("simulated.ball_moves", Value::Array(vec![moved.into()]))];
    let estimate = estimate(&machine(1, &changes), 1, 0.0);
    let named = |ball: &str| {
        let begins = format!("ball {ball} stands ");
        estimate.warnings.iter().filter(|line| line.starts_with(&begins)).count()
    };
    assert_eq!(
        ["1", "2", "3", "4", "5", "6"].map(named),
        [0, 0, 0, 1, 0, 0],
        "{:?}",
        estimate.warnings
    );
    assert!(estimate.warnings.iter().any(|line| line.contains("does not explain")));
}

#[test]
fn balls_at_equal_angles_are_refused_with_a_better_layout() {
    let mut table: Table = include_str!("../../config/ball-plate.toml").parse().unwrap();
    let balls = table["artefact"]["balls"].as_array_mut().unwrap();
    for (number, ball) in balls.iter_mut().enumerate() {
        let (sin, cos) = (60.0 * number as f64).to_radians().sin_cos();
        ball["centre_mm"] = vec![100.0 * cos, 100.0 * sin, 60.0].into();
    }
    let file = MachineFile::parse("even.toml", toml::to_string(&table).unwrap()).unwrap();
    let (method, header) = setup::header(&file, "ball-plate", None).unwrap();
    let refused = methods::nominal(method.as_ref(), header).unwrap_err();
    assert!(
        refused.why.contains("the harmonics 6 of the error motions are lost"),
        "{}",
        refused.why
    );
    assert!(refused.instead.contains("degrees from the first"), "{}", refused.instead);
}

fn refused(changes: &[(&str, Value)]) -> String {
    let file = machine(1, changes);
    let (method, header) = setup::header(&file, "ball-plate", None).unwrap();
    let refused = methods::nominal(method.as_ref(), header).unwrap_err();
    format!("{}; {}", refused.why, refused.instead)
}

#[test]
fn what_cannot_be_measured_is_refused_before_motion() {
    let integer = |path, value| (path, Value::Integer(value));
    let cases = [
        (vec![integer("method.ball-plate.sub_harmonics", 3)], "choose revolutions = 3"),
        (vec![integer("method.ball-plate.harmonics", 20)], "more than twice as many"),
        (
            vec![integer("method.ball-plate.revolutions", 3)],
            "do not fit its limits, -360° to 360°; choose revolutions = 2",
        ),
        (vec![integer("method.ball-plate.positions", 24)], "multiples of 360°/24"),
    ];
    for (changes, expected) in cases {
        let refused = refused(&changes);
        assert!(refused.contains(expected), "{refused}");
    }
}

#[test]
fn a_plan_of_more_than_four_hours_asks_for_long() {
    let changes = [
        ("axes.C.max", Value::Float(720.0)),
        ("method.ball-plate.revolutions", Value::Integer(2)),
        ("method.ball-plate.touches", Value::Integer(15)),
    ];
    let refused = refused(&changes);
    assert!(
        refused.contains("hours of machine time") && refused.contains("long = true"),
        "{refused}"
    );
}
