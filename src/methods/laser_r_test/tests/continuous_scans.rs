//! Continuous scans in an independent simulation: the axes accelerate, have lost motion at reversals, and the
//! sensor has a latency.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::gate_g2::{TABLE_5_SYMBOLS, TABLE_5_UNIT_FACTORS};
use super::simulated_machine::{
    PAPER_TABLE_5, SimulatedMachine, commanded_position_and_duration, simulate_run, table_5_machine,
};
use super::{ideal_plan, settings_with_few_trials};
use crate::IdentifyError;
use crate::laser_r_test::LaserRTestSettings;
use crate::laser_r_test::identify::identify;
use crate::laser_r_test::observe::observe_scans;
use crate::laser_r_test::position_history::PositionHistory;
use crate::laser_r_test::scan_cells::average_samples_by_cell;
use crate::laser_r_test::settings::{MeasuringDevice, SamplingMode};
use crate::laser_r_test::setup::LaserSetup;
use estimation::coverage::chi_square_bounds;
use machine::Position;
use machine::record::estimate::Estimate;
use machine::record::plan::{Sampling, Step};
use machine::record::reading::Reading;
use testing::population::{population_size, sd_ratio_bounds};

/// A lower sampling rate than usual keeps the tests fast.
fn continuous_settings() -> LaserRTestSettings {
    LaserRTestSettings { sampling: SamplingMode::Continuous, rate_hz: 250.0, ..settings_with_few_trials() }
}

fn machine_with_latency_and_lost_motion(noise_um: f64, seed: u64) -> SimulatedMachine {
    SimulatedMachine { latency_s: 3.3e-3, lost_motion_mm: 4e-3, ..table_5_machine(noise_um, seed) }
}

fn simulate_and_identify_run(world: &SimulatedMachine, own: &LaserRTestSettings) -> Estimate {
    let (plan, _, readings) = simulate_run(ideal_plan(0.5), own, world, 9).unwrap();
    let setup = LaserSetup::new(&plan, own).unwrap();
    identify(&setup, &readings).unwrap()
}

fn value_and_u(estimate: &Estimate, symbol: &str) -> (f64, f64) {
    let of = estimate.parameters.iter().find(|p| p.symbol == symbol);
    of.map(|p| (p.value, p.u)).unwrap_or_else(|| panic!("no {symbol}"))
}

#[test]
fn continuous_scans_run_both_ways_and_references_dwell() {
    let (plan, done, _) =
        simulate_run(ideal_plan(0.5), &continuous_settings(), &machine_with_latency_and_lost_motion(0.0, 1), 9)
            .unwrap();
    let names: Vec<&str> = done.iter().map(|stage| stage.name.as_str()).collect();
    assert_eq!(names[..4], ["find the sphere", "latency", "beam direction", "reference"]);
    let rests = |step: &&Step| matches!(step.scan.as_ref().unwrap().sampling, Sampling::Dwell { .. });
    let stands: Vec<&str> = plan.steps.iter().filter(rests).map(|s| s.label.as_str()).collect();
    assert_eq!(stands, ["find/B0/C0", "pose/first/B0/C0", "pose/last/B0/C0"]);
    let of_latency = plan.steps.iter().filter(|step| step.label.starts_with("latency"));
    let feeds: Vec<f64> = of_latency.map(|step| step.feed_mm_min).collect();
    assert_eq!(feeds, [600.0, 1800.0]);
    // Each section is traversed in both directions.
    let scan = plan.steps[1].scan.as_ref().unwrap();
    let xyz: Vec<Vector3<f64>> = scan.path.iter().map(Position::xyz_or_zero).collect();
    let ways: Vec<Vector3<f64>> = xyz.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert_eq!(ways.len(), 6);
    for way in [0, 1] {
        assert!(ways.iter().map(|by| by[way].max(0.0)).sum::<f64>() > 8.0);
        assert!(ways.iter().map(|by| by[way]).sum::<f64>().abs() < 1e-6);
    }
    assert!(ways.iter().all(|by| by.x.abs().min(by.y.abs()) < 1e-6 && by.z.abs() < 1e-6));
}

#[test]
fn noise_free_scans_give_the_true_latency_and_lost_motion() {
    let estimate = simulate_and_identify_run(&machine_with_latency_and_lost_motion(0.0, 1), &continuous_settings());
    let (latency, _) = value_and_u(&estimate, "latency");
    println!("latency {latency} ms, reversal {:?}", value_and_u(&estimate, "reversal_X"));
    assert!((latency - 3.3).abs() < 3e-3, "{latency}");
    for axis in ["reversal_X", "reversal_Y"] {
        assert!((value_and_u(&estimate, axis).0 - 4.0).abs() < 0.05, "{:?}", value_and_u(&estimate, axis));
    }
    let said = estimate.gauge.iter().find(|line| line.contains("continuous scans")).unwrap();
    println!("{said}");
    assert!(said.contains("3.300 ms"), "{said}");
}

/// The dwell references between the continuous poses have unknown lost motion. If they were used for the errors,
/// EC0B would be wrong by 0.7 µrad.
#[test]
fn noise_free_continuous_scans_give_the_values_of_table_5() {
    let estimate = simulate_and_identify_run(&machine_with_latency_and_lost_motion(0.0, 1), &continuous_settings());
    for (i, name) in TABLE_5_SYMBOLS.into_iter().enumerate() {
        let (value, error) = (value_and_u(&estimate, name).0, 0.01);
        assert!((value - PAPER_TABLE_5[i] * TABLE_5_UNIT_FACTORS[i]).abs() < error, "{name}: {value}");
    }
}

/// Without noise, one error at a time: the latency has the right sign, and lost motion is not reported as latency.
#[test]
fn latency_with_its_sign_and_lost_motion_are_found_separately() {
    let of = |latency_s: f64, gap_mm: f64| {
        let estimate = simulate_and_identify_run(
            &SimulatedMachine { latency_s, lost_motion_mm: gap_mm, ..table_5_machine(0.0, 1) },
            &continuous_settings(),
        );
        (value_and_u(&estimate, "latency").0, value_and_u(&estimate, "reversal_X").0)
    };
    for (latency_ms, gap_um) in [(0.0, 0.0), (20.0, 0.0), (-5.0, 0.0), (3.3, 4.0)] {
        let (latency, lag) = of(latency_ms * 1e-3, gap_um * 1e-3);
        println!("{latency_ms} ms, {gap_um} um: {latency} ms, {lag} um");
        assert!((latency - latency_ms).abs() < 3e-3, "{latency}");
        assert!((lag - gap_um).abs() < 0.05, "{lag}");
    }
}

/// The lost motion exceeds the axis jitter: a sample just behind a turning point is not mistaken for the turning
/// point.
#[test]
fn lost_motion_without_latency_is_found() {
    let world = SimulatedMachine { lost_motion_mm: 6e-3, ..table_5_machine(0.0, 1) };
    let estimate = simulate_and_identify_run(&world, &continuous_settings());
    assert!((value_and_u(&estimate, "reversal_X").0 - 6.0).abs() < 0.05);
    assert!(value_and_u(&estimate, "latency").0.abs() < 3e-3);
}

#[test]
fn latency_and_errors_scatter_as_predicted() {
    const FULL_SEED_COUNT: u64 = 40;
    let seeds = population_size(FULL_SEED_COUNT);
    let names = [&TABLE_5_SYMBOLS[..], &["latency", "reversal_X", "reversal_Y"]].concat();
    let truth: Vec<f64> =
        PAPER_TABLE_5.iter().zip(TABLE_5_UNIT_FACTORS).map(|(t, edge)| t * edge).chain([3.3, 4.0, 4.0]).collect();
    let (mut squares, mut predicted) = (vec![0.0; 8], vec![0.0; 8]);
    for seed in 0..seeds {
        let estimate =
            simulate_and_identify_run(&machine_with_latency_and_lost_motion(0.5, seed), &continuous_settings());
        for (i, name) in names.iter().enumerate() {
            let (value, u) = value_and_u(&estimate, name);
            squares[i] += (value - truth[i]).powi(2) / seeds as f64;
            predicted[i] += u * u / seeds as f64;
        }
    }
    let ratio = |i: usize| squares[i] / predicted[i];
    for (i, name) in names.iter().enumerate() {
        let (observed, predicted) = (squares[i].sqrt(), predicted[i].sqrt());
        println!("{name}: observed {observed:.4}, predicted {predicted:.4}");
    }
    let mean = (0..5).map(ratio).sum::<f64>() / 5.0;
    let (low, high) = sd_ratio_bounds(5 * seeds, 5 * FULL_SEED_COUNT, (0.85, 1.15));
    assert!((low..=high).contains(&mean.sqrt()), "{}", mean.sqrt());
    let (low, high) = chi_square_bounds(seeds as f64, 0.99).unwrap();
    for (i, name) in names.iter().enumerate() {
        let chi2 = ratio(i) * seeds as f64;
        assert!((low..=high).contains(&chi2), "{name}: {chi2}");
    }
}

/// The same readings, each at the position stamped with it. The deviation shows the effect of the correction.
#[test]
fn latency_correction_reduces_the_scatter_within_cells() {
    let world = SimulatedMachine { latency_s: 20e-3, ..table_5_machine(0.0, 1) };
    let own = continuous_settings();
    let (plan, _, readings) = simulate_run(ideal_plan(0.5), &own, &world, 9).unwrap();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let observed = observe_scans(&setup, &readings).unwrap();
    let scan = observed.scans.iter().find(|scan| scan.label == "pose/B30/C60").unwrap();
    let step = plan.steps.iter().find(|step| step.label == scan.label).unwrap();
    let of_step: Vec<&Reading> = readings.iter().filter(|r| r.step == step.id).collect();
    let track = PositionHistory::new(&of_step);
    let scatter_um = |latency_s: f64| {
        let (_, (squares, dof)) = average_samples_by_cell(&setup, scan, &track.timed_samples(latency_s));
        (squares / dof as f64).sqrt() * 1e3
    };
    let (without, with) = (scatter_um(0.0), scatter_um(world.latency_s));
    println!("within cells: {without} um without, {with} um with the correction");
    assert!(with < 0.1 && without > 10.0, "{with} {without}");
}

/// Identifies a run from those readings that `keep` accepts, by the step and the time since the start of the step.
fn identify_selected_readings(keep: impl Fn(&Step, f64) -> bool) -> Result<Estimate, IdentifyError> {
    let own = continuous_settings();
    let (plan, _, mut readings) =
        simulate_run(ideal_plan(0.5), &own, &machine_with_latency_and_lost_motion(0.5, 1), 9).unwrap();
    let mut began: BTreeMap<u32, f64> = BTreeMap::new();
    readings.retain(|reading| {
        let begins = *began.entry(reading.step).or_insert(reading.t_s);
        let step = plan.steps.iter().find(|step| step.id == reading.step).unwrap();
        keep(step, reading.t_s - begins)
    });
    let setup = LaserSetup::new(&plan, &own).unwrap();
    identify(&setup, &readings)
}

/// Arrival times at the points of a step's path.
fn arrival_times(step: &Step) -> Vec<f64> {
    let path = &step.scan.as_ref().unwrap().path;
    (1..=path.len()).map(|n| commanded_position_and_duration(&path[..n], step.feed_mm_min, 0.0).1).collect()
}

/// Whether the time `t` is in the section `number` of the path, counted from 1.
fn is_in_path_section(step: &Step, number: usize, t: f64) -> bool {
    let at = arrival_times(step);
    (at[number - 1]..at[number]).contains(&t)
}

fn is_latency_step(step: &Step) -> bool {
    step.label.starts_with("latency")
}

#[test]
fn one_feed_or_one_direction_does_not_separate_latency_from_reversal() {
    let check = |error: IdentifyError| {
        println!("{error}\n  -> {}", error.remedy());
        assert!(error.to_string().contains("rank"), "{error}");
        assert!(error.to_string().contains("do not separate"), "{error}");
        assert!(error.remedy().contains("two feeds") || error.remedy().contains("fast_feed_mm_min"));
    };
    check(identify_selected_readings(|step, _| !step.label.starts_with("latency/2")).map(|_| ()).unwrap_err());
    // Forward motion alone: of the six sections the second and the fifth go backward.
    let forward = |step: &Step, t: f64| {
        !is_latency_step(step) || !(is_in_path_section(step, 2, t) || is_in_path_section(step, 5, t))
    };
    check(identify_selected_readings(forward).map(|_| ()).unwrap_err());
    let none = identify_selected_readings(|step, _| !is_latency_step(step)).map(|_| ()).unwrap_err();
    assert!(none.to_string().contains("too few for the latency of the sensor"), "{none}");
}

#[test]
fn missing_path_section_is_named_in_a_warning() {
    let estimate =
        identify_selected_readings(|step, t| step.label != "pose/B30/C120" || !is_in_path_section(step, 2, t)).unwrap();
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("pose/B30/C120: only 0 samples along "), "{:?}", estimate.warnings);
    let (value, u) = value_and_u(&estimate, "EB0B");
    assert!((value + 42.0).abs() < 4.0 * u, "{value} {u}");
}

#[test]
fn impossible_continuous_settings_are_refused_before_motion() {
    let check = |own: LaserRTestSettings, why: &str, instead: &str| {
        let refused = own.check().unwrap_err();
        println!("{}\n  -> {}", refused.reason, refused.remedy);
        assert!(refused.reason.contains(why) && refused.remedy.contains(instead), "{refused:?}");
    };
    let one = LaserRTestSettings { fast_feed_mm_min: 700.0, ..continuous_settings() };
    check(one, "do not separate", "three times");
    check(LaserRTestSettings { rate_hz: 0.0, ..continuous_settings() }, "rate_hz", "1000");
    check(LaserRTestSettings { by: MeasuringDevice::Probe, ..continuous_settings() }, "touch probe", "laser");
    let dwells = LaserRTestSettings { sampling: SamplingMode::Dwell, fast_feed_mm_min: 1.0, ..continuous_settings() };
    dwells.check().unwrap();
}
