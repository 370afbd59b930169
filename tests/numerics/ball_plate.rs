//! Coverage of the ball plate's curves (METHODS section 6) through the simulated machine: the printed plan is
//! played on worlds that differ in their seed. The error motions are those of the machine file; the world computes
//! poses from them by its own chain.

use std::f64::consts::TAU;

use machine::Axis;
use machine::record::estimate::{Estimate, EstimatedFunction};
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use methods::Method;
use rand::RngExt;
use rayon::prelude::*;
use simulator::SimulatedWorld;
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

use crate::machine_text::changed_machine_file;
use crate::support::plan_player;
use crate::touch_without_path::touch_without_path;
use estimation::random::seeded_stream;
use testing::population::{coverage_seeds_and_share_limits, is_full_test_run};

/// Time at which a ball comes loose: the middle of the played plan, which takes 3430 s.
const BALL_COMES_LOOSE_AT_S: f64 = 1700.0;
/// Key of the random stream that selects the missing visits.
const MISSING_VISITS_STREAM_KEY: u64 = 0x6d69_7373;
const ERROR_MOTION_SYMBOLS: [&str; 6] = ["EXC", "EYC", "EZC", "EAC", "EBC", "ECC"];

type MachineFileChanges = Vec<(&'static str, Value)>;

/// The built-in machine with other values; path: keys joined by dots.
pub fn machine_of_seed(seed: u64, changes: &[(&'static str, Value)]) -> MachineFile {
    let fixed = [
        ("simulated.seed", Value::Integer(seed as i64)),
        // The plan is played without a search.
        ("simulated.centre_offset_mm", vec![0.024, -0.018].into()),
        ("method.ball-plate.monte_carlo_trials", Value::Integer(100)),
        ("method.ball-plate.references", Value::Boolean(false)),
    ];
    changed_machine_file(include_str!("../../config/ball-plate.toml"), fixed.iter().chain(changes))
}

/// Balls at steps of 360°/`positions`, and a world without error motions above `harmonics`.
fn machine_file_changes_for_layout(steps: &[usize], positions: usize, harmonics: usize) -> MachineFileChanges {
    let table: Table = include_str!("../../config/ball-plate.toml").parse().unwrap();
    let like = table["artefact"]["balls"][0].as_table().unwrap();
    let ball = |(number, step): (usize, &usize)| {
        let (sin, cos) = (TAU * *step as f64 / positions as f64).sin_cos();
        let mut ball = like.clone();
        ball.insert("id".to_owned(), (number + 1).to_string().into());
        ball.insert("centre_mm".to_owned(), vec![100.0 * cos, 100.0 * sin, 60.0].into());
        Value::Table(ball)
    };
    let balls: Vec<Value> = steps.iter().enumerate().map(ball).collect();
    let mut motions = table["simulated"]["error_motion"].as_array().unwrap().clone();
    motions.retain(|motion| motion["harmonic"].as_integer().unwrap() <= harmonics as i64);
    vec![
        ("artefact.balls", balls.into()),
        ("simulated.error_motion", motions.into()),
        ("method.ball-plate.positions", Value::Integer(positions as i64)),
        ("method.ball-plate.harmonics", Value::Integer(harmonics as i64)),
    ]
}

/// Machine-file changes for a layout with an eighth of the touches: in a short test many seeds are better
/// evidence than many stops.
pub fn machine_file_changes_for_small_layout() -> MachineFileChanges {
    machine_file_changes_for_layout(&[0, 4, 6, 9], 12, 5)
}

/// Machine-file changes for two revolutions in one direction.
fn machine_file_changes_for_two_revolutions() -> MachineFileChanges {
    vec![
        ("axes.C.max", Value::Float(720.0)),
        ("method.ball-plate.revolutions", Value::Integer(2)),
        ("method.ball-plate.both_directions", Value::Boolean(false)),
    ]
}

/// A harmonic of an error motion, as the machine file declares it, in the unit of the estimate.
struct HarmonicTerm {
    symbol: String,
    harmonic_order: f64,
    cos_amplitude: f64,
    sin_amplitude: f64,
}

/// A machine and its plan, which are the same in every world.
struct BallPlateRun {
    machine_file_changes: MachineFileChanges,
    method: Box<dyn Method>,
    plan: Plan,
    planned_machine_time_s: f64,
    true_harmonic_terms: Vec<HarmonicTerm>,
}

impl BallPlateRun {
    fn new(changes: MachineFileChanges) -> Self {
        let file = machine_of_seed(1, &changes);
        let (method, header) = setup::configure_method_and_plan_without_steps(&file, "ball-plate", None).unwrap();
        let (plan, stages) = methods::plan_nominal_stages(method.as_ref(), header).unwrap();
        let (_, machine_s) = planning::plan_blocks_and_time_s_by_stage(&plan, &stages).unwrap();
        let table: Table = file.text().parse().unwrap();
        let term = |term: &Value| {
            let value = |keys: [&str; 2]| -> f64 { keys.iter().filter_map(|key| term.get(*key)?.as_float()).sum() };
            HarmonicTerm {
                symbol: term["symbol"].as_str().unwrap().to_owned(),
                harmonic_order: term["harmonic"].as_integer().unwrap() as f64,
                cos_amplitude: value(["cos_um", "cos_urad"]),
                sin_amplitude: value(["sin_um", "sin_urad"]),
            }
        };
        let motions = table["simulated"]["error_motion"].as_array().unwrap().iter().map(term);
        Self {
            true_harmonic_terms: motions.collect(),
            machine_file_changes: changes,
            method,
            plan,
            planned_machine_time_s: machine_s,
        }
    }

    fn world(&self, seed: u64) -> SimulatedWorld {
        setup::build_world(&machine_of_seed(seed, &self.machine_file_changes)).unwrap()
    }

    /// True error motion at an angle, in the unit of the estimate.
    fn true_error_motion(&self, symbol: &str, degrees: f64) -> f64 {
        let of_symbol = self.true_harmonic_terms.iter().filter(|term| term.symbol == symbol);
        let value = |term: &HarmonicTerm| {
            let (sin, cos) = (term.harmonic_order * degrees.to_radians()).sin_cos();
            term.cos_amplitude * cos + term.sin_amplitude * sin
        };
        of_symbol.map(value).sum()
    }

    /// `missing_share`: share of the visits whose touches are flagged.
    fn estimate(&self, seed: u64, missing_share: f64) -> Estimate {
        self.estimate_with_player(seed, missing_share, touch_without_path)
    }

    /// `play`: makes a touch, with or without the paths between touches.
    fn estimate_with_player(
        &self,
        seed: u64,
        missing_share: f64,
        play: fn(&mut SimulatedWorld, &Step, u32) -> Reading,
    ) -> Estimate {
        let mut world = self.world(seed);
        let mut random = seeded_stream(seed, &[MISSING_VISITS_STREAM_KEY]);
        let (mut visit, mut is_missing) = (String::new(), false);
        let mut readings: Vec<Reading> = Vec::new();
        for step in self.plan.steps.iter().filter(|step| step.label.starts_with("slow/")) {
            let of_step = step.label.rsplit_once('/').unwrap().0;
            if of_step != visit {
                (visit, is_missing) = (of_step.to_owned(), random.random::<f64>() < missing_share);
            }
            let flag = if is_missing { ReadingFlag::Excluded } else { ReadingFlag::None };
            readings.push(Reading { flag, ..play(&mut world, step, 0) });
        }
        self.method.identify(&self.plan, &readings).unwrap()
    }

    /// For each error motion: share of the points of its curve whose U contains the true value.
    fn covered_shares(&self, estimate: &Estimate) -> [f64; 6] {
        ERROR_MOTION_SYMBOLS.map(|symbol| {
            let curve = estimated_function(estimate, symbol);
            let points = curve.x.iter().zip(&curve.y).zip(&curve.u);
            let is_held =
                |((x, y), u): &((&f64, &f64), &f64)| (*y - self.true_error_motion(symbol, **x)).abs() <= 2.0 * **u;
            let count = points.len();
            assert!(count >= self.plan.settings["positions"].as_u64().unwrap() as usize);
            points.filter(is_held).count() as f64 / count as f64
        })
    }
}

fn estimated_function<'e>(estimate: &'e Estimate, symbol: &str) -> &'e EstimatedFunction {
    estimate.functions.iter().find(|function| function.symbol == symbol).unwrap()
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Checks the coverage over the points of the curve of each error motion, over all seeds.
fn check_coverage(name: &str, changes: MachineFileChanges, missing_share: f64) {
    let (seeds, shares) = coverage_seeds_and_share_limits();
    let rig = BallPlateRun::new(if is_full_test_run() {
        changes
    } else {
        [machine_file_changes_for_small_layout(), changes].concat()
    });
    let one = |seed: u64| {
        let estimate = rig.estimate(seed, missing_share);
        (rig.covered_shares(&estimate), estimate.chi2_per_dof)
    };
    let all: Vec<([f64; 6], f64)> = (0..seeds).into_par_iter().map(one).collect();
    let of_motion = |k: usize| mean(all.iter().map(|(covered, _)| covered[k]));
    let covered: [f64; 6] = std::array::from_fn(of_motion);
    let chi2 = mean(all.iter().map(|(_, chi2)| *chi2));
    println!(
        "{name}: {covered:.4?} of the points of {ERROR_MOTION_SYMBOLS:?} within U, χ² {chi2:.3} of what is expected"
    );
    assert!(covered.iter().all(|share| shares.contains(share)), "{name}: {covered:?}");
}

#[test]
fn coverage_on_the_built_in_machine() {
    check_coverage("as shipped", Vec::new(), 0.0);
}

#[test]
fn coverage_on_a_poor_machine_with_5_percent_of_the_visits_missing() {
    let changes = vec![("probe.repeatability_um", Value::Float(1.0)), ("machine.drift_um_per_h", Value::Float(20.0))];
    check_coverage("poor, 5 % missing", changes, 0.05);
}

/// One value for each stop instead of harmonics.
#[test]
fn coverage_of_values_at_the_stops() {
    let values = ("method.ball-plate.values", Value::Boolean(true));
    let rig = BallPlateRun::new([machine_file_changes_for_small_layout(), vec![values]].concat());
    let share = mean(rig.covered_shares(&rig.estimate(1, 0.0)).into_iter());
    println!("{share:.3} of the values within U");
    assert!(share > 0.9, "{share}");
}

#[test]
fn curves_with_subharmonics_span_both_revolutions() {
    let sub_harmonics = ("method.ball-plate.sub_harmonics", Value::Integer(2));
    let rig = BallPlateRun::new(
        [machine_file_changes_for_small_layout(), machine_file_changes_for_two_revolutions(), vec![sub_harmonics]]
            .concat(),
    );
    let estimate = rig.estimate(1, 0.0);
    assert_eq!(estimated_function(&estimate, "EXC").x.last(), Some(&720.0));
    let half = estimate.parameters.iter().find(|parameter| parameter.symbol == "EXC_c1/2").unwrap();
    assert!(half.value.abs() < 1.5 * half.expanded, "{half:?}");
    assert!(mean(rig.covered_shares(&estimate).into_iter()) > 0.9);
}

/// Compares the largest forecast U of each curve with that of a run. In the second world most of it is drift.
#[test]
fn forecast_u_agrees_with_the_u_of_a_run() {
    let drift =
        vec![("machine.drift_um_per_h", Value::Float(40.0)), ("method.ball-plate.drift_order", Value::Integer(0))];
    for (name, changes) in
        [("as shipped", Vec::new()), ("drift", [machine_file_changes_for_small_layout(), drift].concat())]
    {
        let rig = BallPlateRun::new(changes);
        let lines = rig.method.forecast(&rig.plan, rig.planned_machine_time_s).unwrap();
        println!("{name}: {}", lines.join("\n"));
        let estimate = rig.estimate_with_player(1, 0.0, plan_player::play_step);
        for symbol in ERROR_MOTION_SYMBOLS {
            let words: Vec<&str> = lines[0].split([' ', ':']).collect();
            let at = words.iter().position(|word| *word == symbol).unwrap();
            let foretold: f64 = words[at + 1].parse().unwrap();
            let stated = 2.0 * estimated_function(&estimate, symbol).u.iter().copied().fold(0.0, f64::max);
            assert!((foretold / stated - 1.0).abs() < 0.2, "{symbol}: {foretold} {stated}");
        }
        assert!(lines.iter().any(|line| line.starts_with("not identifiable: location of C")));
    }
}

/// The four steps of paper 5 need balls at equal angles and complete visits.
#[test]
fn least_squares_is_compared_with_the_four_steps() {
    let line = |rig: &BallPlateRun, missing: f64| {
        let estimate = rig.estimate(1, missing);
        assert!(!estimate.warnings.iter().any(|line| line.contains("four-step evaluation")));
        estimate.gauge.into_iter().find(|line| line.contains("four-step evaluation")).unwrap()
    };
    let even = BallPlateRun::new(machine_file_changes_for_layout(&[0, 2, 4, 6, 8, 10], 12, 5));
    let compared = line(&even, 0.0);
    println!("{compared}");
    let (_, figures) = compared.split_once("largest difference ").unwrap();
    let by: f64 = figures.split(' ').next().unwrap().parse().unwrap();
    assert!(by < 0.05, "{compared}");
    assert!(line(&even, 0.05).ends_with("each ball must be measured once at each stop"));
    assert!(
        line(&BallPlateRun::new(machine_file_changes_for_small_layout()), 0.0)
            .contains("balls at equal angles are required")
    );
}

/// A motion with a period of two revolutions changes its sign between them. Drift terms would absorb most of it.
#[test]
fn single_revolutions_show_the_asynchronous_motion() {
    let motion: Table = "axis = 'C'\nlinear_um = 5.0\nsub_harmonics = 2".parse().unwrap();
    let changes = vec![
        ("simulated.rotary_motion", Value::Array(vec![motion.into()])),
        ("machine.drift_um_per_h", Value::Float(0.0)),
        ("method.ball-plate.drift_order", Value::Integer(0)),
    ];
    let rig = BallPlateRun::new(
        [machine_file_changes_for_small_layout(), machine_file_changes_for_two_revolutions(), changes].concat(),
    );
    let (estimate, world) = (rig.estimate(1, 0.0), rig.world(1));
    for (symbol, along) in [("EXC_stops", Axis::X), ("EYC_stops", Axis::Y), ("EZC_stops", Axis::Z)] {
        let stops = estimated_function(&estimate, symbol);
        assert_eq!((stops.x.len(), stops.x[23].round()), (24, 690.0));
        let at = |degrees: f64| 1e3 * world.true_rotary_error_motion(Axis::C, along, degrees.to_radians());
        let errors = (0..12).map(|i| {
            let found = stops.y[i + 12] - stops.y[i];
            found - (at(stops.x[i + 12]) - at(stops.x[i]))
        });
        let rms = mean(errors.map(|error| error * error)).sqrt();
        let size = mean((0..12).map(|i| (2.0 * at(stops.x[i])).powi(2))).sqrt();
        println!("{symbol}: {size:.2} um from revolution to revolution, found to {rms:.2} um");
        assert!(size > 5.0 && rms < 0.8, "{symbol}: {size} {rms}");
    }
    let places = estimated_function(&estimate, "DX_revolutions");
    assert_eq!((places.x.len(), places.x[11].round(), places.x[12]), (24, 330.0, 0.0));
}

/// The ball moves by 20 µm between the first revolution and the second.
#[test]
fn a_ball_that_comes_loose_is_named() {
    let mut moved: Table = Table::new();
    moved.insert("ball".to_owned(), "4".into());
    moved.insert("at_s".to_owned(), Value::Float(BALL_COMES_LOOSE_AT_S));
    moved.insert("by_mm".to_owned(), vec![0.0, 0.02, 0.0].into());
    let changes = vec![("simulated.ball_moves", Value::Array(vec![moved.into()]))];
    let estimate = BallPlateRun::new(changes).estimate_with_player(1, 0.0, plan_player::play_step);
    let named = |ball: &str| {
        let begins = format!("ball {ball} is displaced ");
        estimate.warnings.iter().filter(|line| line.starts_with(&begins)).count()
    };
    assert_eq!(["1", "2", "3", "4", "5", "6"].map(named), [0, 0, 0, 1, 0, 0], "{:?}", estimate.warnings);
    assert!(estimate.warnings.iter().any(|line| line.contains("does not explain")));
}

fn refusal_text(changes: &[(&'static str, Value)]) -> String {
    let file = machine_of_seed(1, changes);
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "ball-plate", None).unwrap();
    let refused = methods::plan_nominal_stages(method.as_ref(), header).unwrap_err();
    format!("{}; {}", refused.reason, refused.remedy)
}

#[test]
fn balls_at_equal_angles_are_refused_with_a_better_layout() {
    let refused = refusal_text(&machine_file_changes_for_layout(&[0, 6, 12, 18, 24, 30], 36, 8));
    assert!(refused.contains("the harmonics 6 of the error motions are not determined"), "{refused}");
    assert!(refused.contains("degrees from the first ball"), "{refused}");
}

#[test]
fn unmeasurable_layouts_are_refused_before_motion() {
    let integer = |path, value| (path, Value::Integer(value));
    let cases = [
        (vec![integer("method.ball-plate.sub_harmonics", 3)], "choose revolutions = 3"),
        (vec![integer("method.ball-plate.harmonics", 20)], "more than twice as many"),
        (
            vec![integer("method.ball-plate.revolutions", 3)],
            "exceed the limits of the axis, -360° to 360°; choose revolutions = 2",
        ),
        (vec![integer("method.ball-plate.positions", 24)], "multiples of 360°/24"),
    ];
    for (changes, expected) in cases {
        let refused = refusal_text(&changes);
        assert!(refused.contains(expected), "{refused}");
    }
}

#[test]
fn plan_above_four_hours_needs_the_long_option() {
    let changes = [
        ("axes.C.max", Value::Float(720.0)),
        ("method.ball-plate.revolutions", Value::Integer(2)),
        ("method.ball-plate.touches", Value::Integer(15)),
    ];
    let refused = refusal_text(&changes);
    assert!(refused.contains("h of machine time") && refused.contains("long = true"), "{refused}");
}
