//! Tests `latch-delay` with readings that a run never or rarely writes.

use machine::record::plan::{Plan, StepKind};
use machine::record::reading::{Reading, ReadingFlag};
use methods::IdentifyError;

use super::latch_delay_world::{LatchDelayWorld, contains_text, identify, is_covered, parameter};

fn world_with_2_ms_delay() -> LatchDelayWorld {
    LatchDelayWorld::with_a_round_part().with_latch_delay(2.0, 0.0)
}

fn feed_of_step(plan: &Plan, reading: &Reading) -> f64 {
    plan.steps.iter().find(|step| step.id == reading.step).unwrap().feed_mm_min
}

fn refusal_text(plan: &Plan, readings: &[Reading]) -> String {
    let error = identify(plan, readings).unwrap_err();
    assert!(!error.remedy().is_empty());
    error.to_string()
}

/// The touches are along −X: a later contact has a smaller X.
fn shift_contact(reading: &mut Reading, further_um: f64) {
    let x = reading.position.get_or_zero(machine::Axis::X) - further_um * 1e-3;
    reading.position.set(machine::Axis::X, x);
}

#[test]
fn readings_of_another_plan_are_refused() {
    let (plan, readings) = world_with_2_ms_delay().play_plan(1);
    assert!(matches!(identify(&plan, &readings[..9]), Err(IdentifyError::MissingReading { .. })));
    let mut twice = readings.clone();
    twice.push(readings[4].clone());
    assert!(matches!(identify(&plan, &twice), Err(IdentifyError::DuplicateReading { .. })));
    let mut unknown = readings.clone();
    unknown[3].step = 99;
    assert!(matches!(identify(&plan, &unknown), Err(IdentifyError::UnknownStep { step: 99 })));
    // Only the search may be missing.
    assert_eq!(identify(&plan, &readings[1..]), identify(&plan, &readings));
}

#[test]
fn non_finite_numbers_are_refused() {
    let (plan, readings) = world_with_2_ms_delay().play_plan(1);
    for value in [f64::NAN, f64::INFINITY] {
        let mut spoilt = readings.clone();
        spoilt[5].position.set(machine::Axis::X, value);
        assert!(refusal_text(&plan, &spoilt).contains("is not a number"));
        let mut spoilt = readings.clone();
        spoilt[5].t_s = value;
        assert!(refusal_text(&plan, &spoilt).contains("is not a number"));
    }
}

#[test]
fn one_feed_or_two_touches_are_not_enough() {
    let (plan, readings) = world_with_2_ms_delay().play_plan(1);
    let left_out = |keep: &dyn Fn(usize, f64) -> bool| -> Vec<Reading> {
        let mut number = 0;
        let flagged = readings.iter().map(|reading| {
            let feed = feed_of_step(&plan, reading);
            number += 1;
            let flag = if keep(number, feed) { ReadingFlag::None } else { ReadingFlag::Excluded };
            Reading { flag, ..reading.clone() }
        });
        flagged.collect()
    };
    assert!(refusal_text(&plan, &left_out(&|_, feed| feed < 100.0)).contains("0 touches at 300 mm/min"));
    assert!(refusal_text(&plan, &left_out(&|_, feed| feed > 100.0)).contains("0 touches at 30 mm/min"));
    assert!(refusal_text(&plan, &left_out(&|n, _| n < 6)).contains("2 touches at 30 mm/min"));
    let mut one_feed = plan.clone();
    one_feed.steps.iter_mut().for_each(|step| step.feed_mm_min = 30.0);
    assert!(refusal_text(&one_feed, &readings).contains("the plan has 1 different feeds"));
}

/// Identical readings mean that there is no delay, within the display step; without a display step the limit is
/// unknown.
#[test]
fn identical_touches_give_no_delay_within_the_display_step() {
    let (mut plan, mut readings) = world_with_2_ms_delay().play_plan(1);
    let one = readings[1].position.clone();
    readings.iter_mut().for_each(|reading| reading.position = one.clone());
    let estimate = identify(&plan, &readings).unwrap();
    let delay = parameter(&estimate, "t_latch");
    assert!(delay.value.abs() < 1e-9 && !parameter(&estimate, "T_scan").identifiable);
    // Two means with steps of 1 µm, divided by 4.5 mm/s.
    let u = (2.0_f64 / 12.0).sqrt() / 4.5;
    assert!(delay.u > u && delay.u < 1.2 * u, "{} {u}", delay.u);
    plan.machine.axes.values_mut().for_each(|axis| axis.resolution_um = 0.0);
    assert!(refusal_text(&plan, &readings).contains("have identical positions"));
}

#[test]
fn touches_that_do_not_reach_their_feed_are_refused() {
    let (mut plan, readings) = world_with_2_ms_delay().play_plan(1);
    for spec in plan.machine.axes.values_mut() {
        spec.acceleration_per_s2 = 5.0;
    }
    let words = refusal_text(&plan, &readings);
    assert!(words.contains("300 mm/min the axes need 2.5000 mm to accelerate"), "{words}");
    let (plan, mut readings) = world_with_2_ms_delay().play_plan(1);
    let begins = plan.steps[2].from.clone();
    readings[2].position = begins;
    assert!(refusal_text(&plan, &readings).contains("contact after 0.0000 mm"));
}

/// Scatter that increases with the feed, without the delay of a scan.
#[test]
fn vibration_is_not_reported_as_a_scan_time() {
    let (plan, mut readings) = LatchDelayWorld::with_a_round_part().play_plan(1);
    let fast = readings.iter_mut().filter(|reading| feed_of_step(&plan, reading) > 100.0);
    for (number, reading) in fast.skip(1).enumerate() {
        shift_contact(reading, if number % 2 == 0 { 20.0 } else { -20.0 });
    }
    let estimate = identify(&plan, &readings).unwrap();
    assert!(contains_text(&estimate.warnings, "the delay is too short for the scan"), "{:?}", estimate.warnings);
    assert!(!parameter(&estimate, "T_scan").identifiable);
}

#[test]
fn latch_before_contact_is_reported() {
    let (plan, mut readings) = LatchDelayWorld::with_a_round_part().play_plan(1);
    for reading in readings.iter_mut().filter(|reading| feed_of_step(&plan, reading) > 100.0) {
        shift_contact(reading, -10.0);
    }
    let estimate = identify(&plan, &readings).unwrap();
    assert!((parameter(&estimate, "t_latch").value + 10.0 / 4.5).abs() < 0.2);
    assert!(contains_text(&estimate.warnings, "ms early"));
}

#[test]
fn scatter_above_the_declared_is_reported() {
    let (mut plan, readings) = world_with_2_ms_delay().with_key("probe.repeatability_um", 4.0).play_plan(1);
    plan.probe.repeatability_um = Some(0.5);
    let estimate = identify(&plan, &readings).unwrap();
    assert!(contains_text(&estimate.warnings, "repeatability_um in [probe]"), "{:?}", estimate.warnings);
    plan.probe.repeatability_um = None;
    assert!(!contains_text(&identify(&plan, &readings).unwrap().warnings, "repeatability_um"));
}

/// The part was moved while the run was interrupted: the step is not a delay, and an additional reference is one
/// more touch.
#[test]
fn shift_during_an_interruption_is_not_a_delay() {
    let (mut plan, mut readings) = world_with_2_ms_delay().play_plan(3);
    let gap = readings[12].t_s;
    plan.interruption_times_s.push(gap);
    for reading in readings.iter_mut().filter(|reading| reading.t_s > gap) {
        reading.t_s += 3600.0;
        shift_contact(reading, 8.0);
    }
    let is_reference =
        |reading: &&Reading| plan.steps.iter().any(|step| step.id == reading.step && step.kind == StepKind::Reference);
    let last = readings.iter().rfind(is_reference).unwrap().clone();
    readings.push(Reading { repeat: 1000, t_s: last.t_s + 10.0, ..last });
    let estimate = identify(&plan, &readings).unwrap();
    assert!(is_covered(&estimate, "t_latch", 2.0), "{:?}", estimate.parameters[0]);
    assert_eq!(estimate.degrees_of_freedom, 25 - 4);
}

#[test]
fn readings_without_times_are_used_in_their_order() {
    let (plan, mut readings) = world_with_2_ms_delay().play_plan(3);
    readings.iter_mut().for_each(|reading| reading.t_s = 0.0);
    let estimate = identify(&plan, &readings).unwrap();
    assert!(is_covered(&estimate, "t_latch", 2.0) && contains_text(&estimate.warnings, "no times"));
}
