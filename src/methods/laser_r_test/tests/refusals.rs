//! Refusals with their messages, and counts of excluded samples.

use super::played::{run, table_5_machine};
use super::{ideal, settings};
use crate::laser_r_test::identify::identify;
use crate::laser_r_test::setup::LaserSetup;
use crate::laser_r_test::{LaserRTest, LaserRTestSettings};
use crate::{IdentifyError, Method, PositionSource, RegisteredMethod};
use machine::record::artefact::{Artefact, Balls};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};

fn refusal_texts(plan: &Plan, settings: LaserRTestSettings) -> (String, String) {
    let refused = LaserRTest::new(settings).next_stage(plan, &[], PositionSource::Nominal).unwrap_err();
    (refused.reason, refused.remedy)
}

fn balls(plan: &mut Plan) -> &mut Balls {
    match &mut plan.artefact {
        Artefact::Balls(balls) => balls,
        _ => panic!("balls"),
    }
}

#[track_caller]
fn check(plan: &Plan, settings: LaserRTestSettings, why: &str, instead: &str) {
    let (found, remedy) = refusal_texts(plan, settings);
    println!("{found}\n  -> {remedy}");
    assert!(found.contains(why), "{found}");
    assert!(remedy.contains(instead), "{remedy}");
}

#[test]
fn unmeasurable_plans_are_refused_before_motion() {
    let plan = ideal(0.5);
    let mut blind = plan.clone();
    blind.sensors.clear();
    check(&blind, settings(), "no displacement sensor", "[[sensor]]");
    let other = LaserRTestSettings { sensor: "other".into(), ..settings() };
    check(&plan, other, "no sensor `other`; its sensors are laser", "[[sensor]]");
    let two = LaserRTestSettings { heights_mm: vec![-5.0, 5.0, 5.1], ..settings() };
    check(&plan, two, "2 different heights", "three or more heights");
    let far = LaserRTestSettings { tilt_deg: vec![0.0, 130.0], ..settings() };
    check(&plan, far, "tilt_deg contains B 130°", "tilt_deg");
    let endless = LaserRTestSettings { samples: 2_000_000_000, ..settings() };
    check(&plan, endless, "more than 10000", "about 20");
    let asleep = LaserRTestSettings { dwell_s: 1e9, ..settings() };
    check(&plan, asleep, "dwell_s must be 0 to 60", "0.1");
    let twice = LaserRTestSettings { harmonics: vec![2, 3, 2], ..settings() };
    check(&plan, twice, "order 2 twice", "once");
    let fast = LaserRTestSettings { harmonics: vec![4_000_000_000], ..settings() };
    check(&plan, fast, "order 4000000000", "harmonics = [2]");
    let few = LaserRTestSettings { tilt_deg: vec![0.0], turn_deg: vec![90.0], ..settings() };
    check(&plan, few, "2 poses", "add positions");
    let mut unsure = plan.clone();
    balls(&mut unsure).uncertainty_mm = 4.5;
    check(&unsure, settings(), "incidence angle", "uncertainty_mm");
    let high = LaserRTestSettings { heights_mm: vec![-5.0, 0.0, 9.5], ..settings() };
    let (_, _, readings) = run(plan.clone(), &settings(), &table_5_machine(0.0, 1), 1).unwrap();
    assert!(!readings.is_empty());
    let late = run(plan.clone(), &high, &table_5_machine(0.0, 1), 9).unwrap_err();
    assert!(late.reason.contains("out of the sensor's range"), "{}", late.reason);
    let mut wide = plan.clone();
    balls(&mut wide).balls[0].centre_mm[0] = 205.0;
    let mut world = table_5_machine(0.0, 1);
    world.ball.x = 205.0;
    let beyond = run(wide, &settings(), &world, 9).unwrap_err();
    assert!(beyond.reason.contains("the scan needs"), "{}", beyond.reason);
    let mut over = plan.clone();
    over.machine.axes.get_mut(&machine::Axis::B).unwrap().max = 180.0;
    let above = LaserRTestSettings { tilt_deg: vec![0.0, 60.0, 150.0], ..settings() };
    let stem = run(over, &above, &table_5_machine(0.0, 1), 9).unwrap_err();
    assert!(stem.reason.contains("stem"), "{}", stem.reason);
}

/// Identifies a run whose readings are modified by `change`.
fn identify_changed(change: impl Fn(&Step, usize, &mut Reading)) -> Result<Estimate, IdentifyError> {
    let (plan, _, mut readings) = run(ideal(0.5), &settings(), &table_5_machine(0.5, 1), 9).unwrap();
    let mut count = 0;
    let mut last = u32::MAX;
    for reading in &mut readings {
        count = if reading.step == last { count + 1 } else { 0 };
        last = reading.step;
        let step = plan.steps.iter().find(|step| step.id == reading.step).unwrap();
        change(step, count, reading);
    }
    let own = settings();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    identify(&setup, &readings)
}

fn assert_five_parameters(estimate: &Estimate) {
    let beta = estimate.parameters.iter().find(|p| p.symbol == "EB0B").unwrap();
    assert!((beta.value + 42.0).abs() < 4.0, "{}", beta.value);
}

#[test]
fn flagged_samples_are_excluded_and_counted() {
    let estimate = identify_changed(|step, count, reading| {
        if step.label == "pose/B30/C120" && count < 40 {
            reading.flag = ReadingFlag::Saturated;
            reading.value_mm = Some(99.0);
        }
    })
    .unwrap();
    assert_five_parameters(&estimate);
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("40 of 24440 samples were not used: saturated 40"), "{:?}", estimate.warnings);
}

#[test]
fn a_pose_that_is_missing_is_named() {
    let estimate = identify_changed(|step, _, reading| {
        if step.label == "pose/B30/C120" {
            reading.flag = ReadingFlag::Stale;
        }
    })
    .unwrap();
    assert_five_parameters(&estimate);
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("pose/B30/C120: no usable sample"), "{:?}", estimate.warnings);
}

#[test]
fn one_height_is_not_enough() {
    let error = identify_changed(|step, _, reading| {
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
    let error = identify_changed(|_, count, reading| {
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
fn samples_beyond_the_incidence_limit_are_left_out_and_counted() {
    let (mut plan, _, readings) = run(ideal(0.5), &settings(), &table_5_machine(0.5, 1), 9).unwrap();
    // The ends of a line have an incidence of 24.8°.
    plan.sensors[0].incidence_limit_deg = 23.0;
    let own = settings();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let estimate = identify(&setup, &readings).unwrap();
    assert_five_parameters(&estimate);
    let said = |words: &str| estimate.warnings.iter().any(|line| line.contains(words));
    assert!(said("beyond the incidence limit"), "{:?}", estimate.warnings);
}
