//! One erroneous measurement, and none, on the built-in machines (METHODS section 6).

use nalgebra::{Unit, Vector3};
use rayon::prelude::*;
use toml::Value;
use trued::setup::{self, MachineFile};

use estimation::random::seeded_stream;
use machine::Axis;
use machine::record::estimate::{Estimate, Verdict};
use machine::record::measurement_check::Outlier;
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;
use methods::{Method, NextStage, ObjectPositionSource};
use rand::RngExt;
use simulator::SimulatedWorld;
use testing::population::{event_count_limit, is_full_test_run, population_size};

use crate::ball_plate;
use crate::machine_text::changed_machine_file;
use crate::support::plan_player;
use crate::touch_without_path::touch_without_path;

/// A method on its built-in machine.
struct OutlierCase {
    method: &'static str,
    machine_file_for_seed: fn(u64) -> MachineFile,
}

const OUTLIER_CASES: [OutlierCase; 4] = [
    OutlierCase {
        method: "samba",
        machine_file_for_seed: |seed| built_in_machine("samba", include_str!("../../config/samba.toml"), seed),
    },
    OutlierCase {
        method: "ball-plate",
        machine_file_for_seed: |seed| {
            ball_plate::machine_of_seed(seed, &ball_plate::machine_file_changes_for_small_layout())
        },
    },
    OutlierCase {
        method: "laser-r-test",
        machine_file_for_seed: |seed| built_in_machine("laser-r-test", include_str!("../../config/laser.toml"), seed),
    },
    OutlierCase {
        method: "r-test",
        machine_file_for_seed: |seed| built_in_machine("r-test", include_str!("../../config/r-test.toml"), seed),
    },
];

fn built_in_machine(method: &str, text: &str, seed: u64) -> MachineFile {
    let trials = format!("method.{method}.monte_carlo_trials");
    let fixed = [("simulated.seed", Value::Integer(seed as i64)), (trials.as_str(), Value::Integer(100))];
    changed_machine_file(text, &fixed)
}

pub struct MeasuredRun {
    method: Box<dyn Method>,
    plan: Plan,
    pub readings: Vec<Reading>,
}

/// Measurement with a method on its built-in machine, in the world of this seed.
pub fn measure_on_built_in_machine(method: &str, seed: u64) -> MeasuredRun {
    OUTLIER_CASES.iter().find(|case| case.method == method).unwrap().measure_in_world(seed)
}

impl OutlierCase {
    fn measure_in_world(&self, seed: u64) -> MeasuredRun {
        let file = (self.machine_file_for_seed)(seed);
        let (method, header) = setup::configure_method_and_plan_without_steps(&file, self.method, None).unwrap();
        let mut world = setup::build_world(&file).unwrap();
        let played = plan_player::try_measure_all_stages(&mut world, method.as_ref(), header, touch_without_path);
        let (plan, readings) = played.unwrap();
        MeasuredRun { method, plan, readings }
    }
}

impl MeasuredRun {
    pub fn estimate(&self) -> Estimate {
        self.method.identify(&self.plan, &self.readings).unwrap()
    }

    /// Displaces the measurement with this label: a position by the vector; in the r-test the mean of a sensor at a
    /// point of a path, by the vector's length.
    fn displace_measurement(&mut self, label: &str, by: Vector3<f64>) {
        let steps = &self.plan.steps;
        let step_of = |reading: &Reading| steps.iter().find(|step| step.id == reading.step).unwrap();
        let of_place = |step: &str| step == label || step.starts_with(&format!("{label}/"));
        for reading in self.readings.iter_mut().filter(|reading| reading.repeat == 0) {
            let step = step_of(reading);
            if of_place(&step.label) {
                let moved = reading.position.xyz_or_zero() + by;
                for (axis, value) in Axis::LINEAR.into_iter().zip(moved.iter()) {
                    reading.position.set(axis, *value);
                }
            }
            let Some(scan) = &step.scan else { continue };
            let distance = |at: &machine::Position| -> f64 {
                at.iter().map(|(axis, at)| (reading.position.get_or_zero(axis) - at).powi(2)).sum()
            };
            let nearest =
                (0..scan.path.len()).min_by(|a, b| distance(&scan.path[*a]).total_cmp(&distance(&scan.path[*b])));
            let own = format!("{}/{}/{}", step.label, nearest.unwrap() + 1, reading.sensor);
            if own == label {
                reading.value_mm = reading.value_mm.map(|mm| mm + by.norm());
            }
        }
    }
}

/// Which touches are repeated does not depend on when a run was interrupted.
#[test]
fn repeated_touches_do_not_depend_on_an_interruption() {
    let text = include_str!("../../config/simulated.toml");
    let settings = "\n[method.self-calibration]\npositions = 6\nreferences = false\n";
    let file = built_in_machine("self-calibration", &format!("{text}{settings}"), 1);
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "self-calibration", None).unwrap();
    let (mut plan, stages) = methods::plan_nominal_stages(method.as_ref(), header).unwrap();
    for gap_s in [5.0, 20.0, 25.0] {
        plan.interruption_times_s = vec![gap_s];
        let next = method.next_stage(&plan, &stages[..2], ObjectPositionSource::Nominal);
        let Ok(NextStage::Stage { stage, .. }) = next else { panic!("{gap_s} s: {next:?}") };
        assert_eq!(stage.steps, stages[2].steps, "{gap_s} s");
    }
}

/// Self-calibration with six positions and without references has touches that no other touch checks.
#[test]
fn touch_without_redundancy_is_repeated_and_its_error_named() {
    let file = |seed: u64| {
        let text = include_str!("../../config/simulated.toml");
        let settings = "\n[method.self-calibration]\npositions = 6\nreferences = false\n";
        built_in_machine("self-calibration", &format!("{text}{settings}"), seed)
    };
    for seed in 3000..3003 {
        let mut measured =
            OutlierCase { method: "self-calibration", machine_file_for_seed: file }.measure_in_world(seed);
        let again: Vec<&str> = measured
            .readings
            .iter()
            .filter(|r| r.repeat == 1)
            .map(|r| {
                let step = measured.plan.steps.iter().find(|step| step.id == r.step);
                step.unwrap().label.as_str()
            })
            .collect();
        assert!(!again.is_empty());
        let label = again[seed as usize % again.len()].to_owned();
        assert!(measured.estimate().outliers.is_empty());
        measured.displace_measurement(&label, Vector3::new(0.02, 0.02, 0.0));
        let off = measured.estimate();
        let named = off.outliers.iter().flat_map(|outlier| &outlier.candidates);
        assert!(named.into_iter().any(|one| one.label == label), "{label}: {:?}", off.outliers);
    }
}

/// An error of the size that the estimate states for detection, in any direction, is named, and no verdict is based
/// on it.
#[test]
fn erroneous_measurement_is_named() {
    let worlds = population_size(100);
    for case in &OUTLIER_CASES {
        let is_named = |seed: u64| {
            let mut measured = case.measure_in_world(seed);
            let sound = measured.estimate();
            let random = &mut seeded_stream(seed, &[0x6f66_6600]);
            let checked: Vec<_> =
                sound.measurement_checks.iter().filter(|one| one.min_detectable_deviation_um.is_some()).collect();
            let one = checked[random.random_range(0..checked.len())];
            let mut component = || random.random_range(-1.0..1.0);
            let towards = Vector3::new(component(), component(), component());
            let by = Unit::new_normalize(towards).into_inner() * one.min_detectable_deviation_um.unwrap() * 1e-3;
            measured.displace_measurement(&one.label, by);
            let off = measured.estimate();
            let mut candidates = off.outliers.iter().flat_map(|outlier| &outlier.candidates);
            candidates.any(|candidate| candidate.label == one.label) && off.verdict == Verdict::UndecidedModel
        };
        let seeds = (3000..3000 + worlds).into_par_iter();
        let named = seeds.filter(|seed| is_named(*seed)).count() as u64;
        println!("{}: {named} of {worlds} named", case.method);
        assert!(named >= worlds - event_count_limit(worlds, 100, (0.05, 5)), "{named} of {worlds}");
    }
}

/// All alarms of a correct machine together: 1 %.
#[test]
fn a_sound_machine_is_not_flagged() {
    let worlds = if is_full_test_run() { 300 } else { 6 };
    for case in &OUTLIER_CASES {
        let is_flagged = |seed: u64| {
            let estimate = case.measure_in_world(seed).estimate();
            let flagged = estimate.verdict == Verdict::UndecidedModel;
            if flagged {
                println!("{} {seed}: {:?}", case.method, estimate.warnings);
            }
            flagged
        };
        let seeds = (4000..4000 + worlds).into_par_iter();
        let flagged = seeds.filter(|seed| is_flagged(*seed)).count() as u64;
        println!("{}: {flagged} of {worlds} flagged", case.method);
        assert!(flagged <= event_count_limit(worlds, 300, (0.01, 6)), "{}: {flagged}", case.method);
    }
}

/// A chip that is gone when the touch is repeated: 20 um, at one touch, or at all touches of one measurement of a
/// ball.
fn touch_with_chip_in_first_pass(world: &mut SimulatedWorld, step: &Step, repeat: u32) -> Reading {
    if repeat == 0 { touch_with_lasting_chip(world, step, repeat) } else { touch_without_path(world, step, repeat) }
}

fn touch_with_lasting_chip(world: &mut SimulatedWorld, step: &Step, repeat: u32) -> Reading {
    let mut reading = touch_without_path(world, step, repeat);
    let is_off = ["1c/C090", "slow/007/", "slow/sphere/S90/+45^0/2"];
    if is_off.iter().any(|label| step.label.starts_with(label)) {
        let off = reading.position.xyz_or_zero() + Vector3::new(0.0, 0.02, 0.0);
        for (axis, value) in Axis::LINEAR.into_iter().zip(off.iter()) {
            reading.position.set(axis, *value);
        }
    }
    reading
}

fn play_and_identify(
    method: &str,
    file: &MachineFile,
    play: fn(&mut SimulatedWorld, &Step, u32) -> Reading,
) -> (Estimate, Vec<Reading>, SimulatedWorld) {
    let (method, header) = setup::configure_method_and_plan_without_steps(file, method, None).unwrap();
    let mut world = setup::build_world(file).unwrap();
    let (plan, readings) = plan_player::try_measure_all_stages(&mut world, method.as_ref(), header, play).unwrap();
    (method.identify(&plan, &readings).unwrap(), readings, world)
}

const METHODS_AND_MACHINE_TOML: [(&str, &str); 3] = [
    ("self-calibration", include_str!("../../config/simulated.toml")),
    ("samba", include_str!("../../config/samba.toml")),
    ("probe-qualification", include_str!("../../config/probe-qualification.toml")),
];

#[test]
fn outlier_is_measured_again_and_listed() {
    for (method, text) in METHODS_AND_MACHINE_TOML {
        let file = match method {
            "probe-qualification" => changed_machine_file(text, &[("simulated.seed", Value::Integer(3))]),
            _ => built_in_machine(method, text, 3),
        };
        let (sound, all, _) = play_and_identify(method, &file, touch_without_path);
        assert!(sound.outliers.is_empty());
        let (estimate, readings, _) = play_and_identify(method, &file, touch_with_chip_in_first_pass);
        assert_eq!(estimate.verdict, Verdict::None, "{method}: {:?}", estimate.outliers);
        let resolved = |outlier: &Outlier| outlier.resolution.as_ref().unwrap().contains("counts");
        assert!(!estimate.outliers.is_empty() && estimate.outliers.iter().all(resolved));
        assert!(readings.len() > all.len() && readings.len() < all.len() + 30, "{method}");
        let told = estimate.warnings.iter().any(|line| line.contains("an outlier was found"));
        assert!(told, "{method}: {:?}", estimate.warnings);
        // At most two repetitions.
        let (estimate, readings, _) = play_and_identify(method, &file, touch_with_lasting_chip);
        assert_eq!(estimate.verdict, Verdict::UndecidedModel, "{method}");
        let still = |outlier: &Outlier| outlier.resolution.as_deref() == Some("measured again: still an outlier");
        assert!(estimate.outliers.iter().any(still), "{method}: {:?}", estimate.outliers);
        assert!(readings.iter().all(|reading| reading.repeat < 510), "{method}");
    }
}

#[test]
fn coverage_after_outliers_are_measured_again() {
    let worlds = population_size(200);
    let misses = |seed: u64| {
        let file = built_in_machine("self-calibration", include_str!("../../config/simulated.toml"), seed);
        let (estimate, _, world) = play_and_identify("self-calibration", &file, touch_with_chip_in_first_pass);
        let truth = world.true_rotary_axis_position_mm(Axis::C, 50.0, 0.0);
        let missed = ["EX0C", "EY0C"].iter().zip(truth).filter(|(symbol, mm)| {
            let found = estimate.parameters.iter().find(|own| own.symbol == **symbol).unwrap();
            (found.value - mm * 1e3).abs() > found.expanded
        });
        (missed.count() as u64, u64::from(estimate.verdict != Verdict::None))
    };
    let all: Vec<(u64, u64)> = (9000..9000 + worlds).into_par_iter().map(misses).collect();
    let missed: u64 = all.iter().map(|(missed, _)| missed).sum();
    let undecided: u64 = all.iter().map(|(_, undecided)| undecided).sum();
    println!("{missed} of {} missed, {undecided} of {worlds} undecided", 2 * worlds);
    // 36 of 400 are 9 %.
    assert!(missed <= event_count_limit(2 * worlds, 400, (0.0455, 36)), "{missed} missed");
    assert!(undecided <= event_count_limit(worlds, 200, (0.02, 10)), "{undecided} undecided");
}
