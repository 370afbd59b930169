//! Refusals with their messages, and counts of excluded samples.

use super::simulated_machine::{simulate_run, table_5_machine};
use super::{ideal_plan, settings_with_few_trials};
use crate::laser_r_test::identify::identify;
use crate::laser_r_test::setup::LaserSetup;
use crate::laser_r_test::{LaserRTest, LaserRTestSettings};
use crate::{IdentifyError, Method, ObjectPositionSource, RegisteredMethod};
use machine::record::artefact::{Artefact, Balls};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};

fn refusal_reason_and_remedy(plan: &Plan, settings: LaserRTestSettings) -> (String, String) {
    let refused = LaserRTest::new(settings).next_stage(plan, &[], ObjectPositionSource::Nominal).unwrap_err();
    (refused.reason, refused.remedy)
}

fn balls_mut(plan: &mut Plan) -> &mut Balls {
    match &mut plan.artefact {
        Artefact::Balls(balls) => balls,
        _ => panic!("balls"),
    }
}

#[track_caller]
fn assert_refused(plan: &Plan, settings: LaserRTestSettings, why: &str, instead: &str) {
    let (found, remedy) = refusal_reason_and_remedy(plan, settings);
    println!("{found}\n  -> {remedy}");
    assert!(found.contains(why), "{found}");
    assert!(remedy.contains(instead), "{remedy}");
}

#[test]
fn unmeasurable_plans_are_refused() {
    let plan = ideal_plan(0.5);
    let mut blind = plan.clone();
    blind.sensors.clear();
    assert_refused(&blind, settings_with_few_trials(), "no displacement sensor", "[[sensor]]");
    let other = LaserRTestSettings { sensor: "other".into(), ..settings_with_few_trials() };
    assert_refused(&plan, other, "no sensor `other`; its sensors are laser", "[[sensor]]");
    let two = LaserRTestSettings { heights_mm: vec![-5.0, 5.0, 5.1], ..settings_with_few_trials() };
    assert_refused(&plan, two, "2 different heights", "three or more heights");
    let far = LaserRTestSettings { tilt_deg: vec![0.0, 130.0], ..settings_with_few_trials() };
    assert_refused(&plan, far, "tilt_deg contains B 130°", "tilt_deg");
    let endless = LaserRTestSettings { samples: 2_000_000_000, ..settings_with_few_trials() };
    assert_refused(&plan, endless, "more than 10000", "samples = 20");
    let asleep = LaserRTestSettings { dwell_s: 1e9, ..settings_with_few_trials() };
    assert_refused(&plan, asleep, "dwell_s must be 0 to 60", "0.1");
    let twice = LaserRTestSettings { harmonics: vec![2, 3, 2], ..settings_with_few_trials() };
    assert_refused(&plan, twice, "order 2 twice", "once");
    let fast = LaserRTestSettings { harmonics: vec![4_000_000_000], ..settings_with_few_trials() };
    assert_refused(&plan, fast, "order 4000000000", "harmonics = [2]");
    let few = LaserRTestSettings { tilt_deg: vec![0.0], turn_deg: vec![90.0], ..settings_with_few_trials() };
    assert_refused(&plan, few, "2 poses", "add positions");
    let mut unsure = plan.clone();
    balls_mut(&mut unsure).uncertainty_mm = 4.5;
    assert_refused(&unsure, settings_with_few_trials(), "incidence angle", "uncertainty_mm");
    let high = LaserRTestSettings { heights_mm: vec![-5.0, 0.0, 9.5], ..settings_with_few_trials() };
    let (_, _, readings) =
        simulate_run(plan.clone(), &settings_with_few_trials(), &table_5_machine(0.0, 1), 1).unwrap();
    assert!(!readings.is_empty());
    let late = simulate_run(plan.clone(), &high, &table_5_machine(0.0, 1), 9).unwrap_err();
    assert!(late.reason.contains("out of the sensor's range"), "{}", late.reason);
    let mut wide = plan.clone();
    balls_mut(&mut wide).balls[0].centre_mm[0] = 205.0;
    let mut world = table_5_machine(0.0, 1);
    world.ball_centre.x = 205.0;
    let beyond = simulate_run(wide, &settings_with_few_trials(), &world, 9).unwrap_err();
    assert!(beyond.reason.contains("the scan needs"), "{}", beyond.reason);
    let mut over = plan.clone();
    over.machine.axes.get_mut(&machine::Axis::B).unwrap().max = 180.0;
    let above = LaserRTestSettings { tilt_deg: vec![0.0, 60.0, 150.0], ..settings_with_few_trials() };
    let stem = simulate_run(over, &above, &table_5_machine(0.0, 1), 9).unwrap_err();
    assert!(stem.reason.contains("stem"), "{}", stem.reason);
}

/// Identifies a run whose readings are modified by `change`.
fn identify_changed_readings(change: impl Fn(&Step, usize, &mut Reading)) -> Result<Estimate, IdentifyError> {
    let (plan, _, mut readings) =
        simulate_run(ideal_plan(0.5), &settings_with_few_trials(), &table_5_machine(0.5, 1), 9).unwrap();
    let mut count = 0;
    let mut last = u32::MAX;
    for reading in &mut readings {
        count = if reading.step == last { count + 1 } else { 0 };
        last = reading.step;
        let step = plan.steps.iter().find(|step| step.id == reading.step).unwrap();
        change(step, count, reading);
    }
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    identify(&setup, &readings)
}

fn assert_eb0b_is_near_its_true_value(estimate: &Estimate) {
    let beta = estimate.parameters.iter().find(|p| p.symbol == "EB0B").unwrap();
    assert!((beta.value + 42.0).abs() < 4.0, "{}", beta.value);
}

#[test]
fn flagged_samples_are_excluded_and_counted() {
    let estimate = identify_changed_readings(|step, count, reading| {
        if step.label == "pose/B30/C120" && count < 40 {
            reading.flag = ReadingFlag::Saturated;
            reading.value_mm = Some(99.0);
        }
    })
    .unwrap();
    assert_eb0b_is_near_its_true_value(&estimate);
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("40 of 24440 samples were not used: saturated 40"), "{:?}", estimate.warnings);
}

#[test]
fn pose_without_usable_sample_is_named_in_a_warning() {
    let estimate = identify_changed_readings(|step, _, reading| {
        if step.label == "pose/B30/C120" {
            reading.flag = ReadingFlag::Stale;
        }
    })
    .unwrap();
    assert_eb0b_is_near_its_true_value(&estimate);
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("pose/B30/C120: no usable sample"), "{:?}", estimate.warnings);
}

#[test]
fn one_height_is_refused_for_the_beam_direction() {
    let error = identify_changed_readings(|step, _, reading| {
        if step.label.starts_with("height/1") || step.label.starts_with("height/2") {
            reading.flag = ReadingFlag::Range;
        }
    })
    .unwrap_err();
    println!("{error}\n  -> {}", error.remedy());
    assert!(error.to_string().contains("three heights, the readings have 1"), "{error}");
    assert!(error.remedy().contains("beam direction"));
}

#[test]
fn samples_on_one_great_circle_do_not_determine_the_centre() {
    // Only the first line of every cross.
    let first_line = |count: usize| count < 13 * 20;
    let error = identify_changed_readings(|_, count, reading| {
        if !first_line(count) {
            reading.flag = ReadingFlag::Gap;
        }
    })
    .unwrap_err();
    println!("{error}\n  -> {}", error.remedy());
    assert!(error.to_string().contains("great circle"), "{error}");
    assert!(error.remedy().contains("two lines that cross"));
}

#[test]
fn samples_beyond_the_incidence_limit_are_named_in_a_warning() {
    let (mut plan, _, readings) =
        simulate_run(ideal_plan(0.5), &settings_with_few_trials(), &table_5_machine(0.5, 1), 9).unwrap();
    // The ends of a line have an incidence of 24.8°.
    plan.sensors[0].incidence_limit_deg = 23.0;
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let estimate = identify(&setup, &readings).unwrap();
    assert_eb0b_is_near_its_true_value(&estimate);
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("beyond the incidence limit"), "{:?}", estimate.warnings);
}
