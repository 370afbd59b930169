//! Faulty readings, and how they are reported.

use nalgebra::Vector3;
use rand_distr::{Distribution, StandardNormal};

use super::built_in::d_optimal_measurements_with_turns;
use super::paper_errors;
use super::readings_to_estimate::{
    FAULTLESS_MEASUREMENT, SimulatedMeasurement, find_parameter, has_warning, settings_with_2000_trials,
};
use crate::IdentifyError;
use crate::samba::identify::identify;
use estimation::random::seeded_stream;
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::{Reading, ReadingFlag};

/// A file with a header only, a run stopped in its first search, and an incomplete measurement are refused
/// with a reason.
#[test]
fn readings_without_a_complete_measurement_are_refused() {
    let (mut plan, mut readings) = FAULTLESS_MEASUREMENT.measure();
    let why = |plan: &Plan, readings: &[Reading]| match identify(plan, &settings_with_2000_trials(), readings) {
        Err(IdentifyError::Refused(refused)) => refused.reason,
        other => panic!("{other:?}"),
    };
    assert!(why(&plan, &[]).contains("there are no readings"));
    let three = why(&plan, &readings[..3]);
    assert!(three.contains("indexation 1 was not used: 3 touches, at least 4 are required"), "{three}");
    for reading in readings.iter_mut().take(12) {
        reading.flag = ReadingFlag::Excluded;
    }
    let flagged = why(&plan, &readings[..12]);
    assert!(flagged.contains("all touches of the ball are excluded; likewise 2 more"), "{flagged}");
    for step in plan.steps.iter_mut().take(19) {
        step.label = step.label.replace("slow", "find");
    }
    assert!(why(&plan, &readings[..19]).contains("first search"));
}

/// Encoder readings flicker: the touches of one measurement differ by 1e-4°, but they are one measurement.
#[test]
fn noise_of_rotary_encoders_does_not_split_a_measurement() {
    let (plan, mut readings) = FAULTLESS_MEASUREMENT.measure();
    let sound = identify(&plan, &settings_with_2000_trials(), &readings).unwrap();
    let mut normal = StandardNormal.sample_iter(seeded_stream(5, &[]));
    for reading in &mut readings {
        for axis in [Axis::B, Axis::C, Axis::S] {
            let noise: f64 = normal.next().unwrap();
            let read = reading.position.get(axis).unwrap() + (noise * 1e-4_f64).to_radians();
            reading.position.set(axis, read);
        }
    }
    let estimate = identify(&plan, &settings_with_2000_trials(), &readings).unwrap();
    assert!(estimate.warnings.is_empty(), "{:?}", estimate.warnings);
    let [named, expected] = [&estimate, &sound].map(|estimate| {
        let groups = estimate.arrows[0].groups.iter();
        groups.map(|group| (group.name.clone(), group.arrows.len())).collect::<Vec<_>>()
    });
    assert_eq!((named.len(), &named), (32, &expected));
    // 1e-4° at 250 mm is 0.4 µm per touch, against 0.5 µm of the probe: the results change by less than this
    // ratio times u.
    for (name, _) in paper_errors() {
        let (with, without) = (find_parameter(&estimate, &name), find_parameter(&sound, &name));
        let off = (with.value - without.value) / without.u;
        println!("{name}: {off:+.3} u");
        assert!(off.abs() < 0.75, "{name}: {off}");
    }
    // An axis that moved between the touches is a different case.
    let moved = readings[2].position.get(Axis::B).unwrap() + 0.02_f64.to_radians();
    readings[2].position.set(Axis::B, moved);
    let estimate = identify(&plan, &settings_with_2000_trials(), &readings).unwrap();
    assert!(has_warning(&estimate, &["indexation 1 was not used", "the rotary axes moved between the touches"]));
}

/// Radial error motion of C of the fourth order, 5 µm along X.
const FOURTH_ORDER_MOTION: SimulatedMeasurement = SimulatedMeasurement {
    ball_shift: |_, _, [_, c, _]| Vector3::new(c.cos(), c.sin(), 0.0) * (0.005 * (4.0 * c).cos()),
    ..FAULTLESS_MEASUREMENT
};

/// With C at multiples of 90° the error motion is indistinguishable from EX0C, and the estimate reports this. With C
/// at multiples of 72° the same motion contradicts the model, and the estimate warns.
#[test]
fn harmonics_inseparable_at_the_positions_are_named() {
    let told = |estimate: &Estimate| -> Vec<String> {
        let lines = estimate.not_identifiable.iter();
        lines.filter(|line| line.contains("in steps of")).cloned().collect()
    };
    let hidden = FOURTH_ORDER_MOTION.identify().unwrap();
    let ex0c = find_parameter(&hidden, "EX0C");
    let truth = paper_errors().iter().find(|(name, _)| name == "EX0C").unwrap().1 * 1e3;
    println!("{:#?} EX0C off by {:+.2} µm ± {:.2}", told(&hidden), ex0c.value - truth, ex0c.u);
    assert!(((ex0c.value - truth).abs() - 5.0).abs() < 3.0 * ex0c.u);
    assert!(hidden.warnings.is_empty(), "{:?}", hidden.warnings);
    let [c, s] = told(&hidden).try_into().unwrap();
    assert!(c.starts_with("error motions of C at orders 4, 8, 12: inseparable from EX0C, EA0C, EB0C"));
    assert!(c.contains("in steps of 360°/4 only"));
    assert!(s.starts_with("error motions of S at orders 4, 8, 12: inseparable from EX0S, EY0S"));
    let seen = SimulatedMeasurement {
        design: || d_optimal_measurements_with_turns(&[0.0, 72.0, 144.0, 216.0, 288.0]),
        ..FOURTH_ORDER_MOTION
    };
    let seen = seen.identify().unwrap();
    println!("{:#?} {:#?}", told(&seen), seen.warnings);
    assert!(has_warning(&seen, &["the model does not explain the measurements"]));
    assert!(told(&seen)[0].contains("C at orders 5, 10: inseparable from EX0C"));
}

/// A machine that is displaced by 2 µm in X, Y and Z after a stop, which is the limit of its references.
#[test]
fn a_step_at_an_interruption_is_within_the_uncertainty() {
    let (plan, readings) = FAULTLESS_MEASUREMENT.measure();
    let sound = identify(&plan, &settings_with_2000_trials(), &readings).unwrap();
    for (stop, signs) in [(60, [1.0, 1.0, 1.0]), (30, [1.0, -1.0, 1.0]), (85, [-1.0, 1.0, 1.0])] {
        let stop = 5 * stop;
        let gap_s = readings[stop].t_s;
        let plan = Plan { interruption_times_s: vec![gap_s], ..plan.clone() };
        let mut stepped = readings.clone();
        for reading in &mut stepped[stop + 1..] {
            for (axis, sign) in Axis::LINEAR.into_iter().zip(signs) {
                let there = reading.position.get(axis).unwrap() + 2e-3 * sign;
                reading.position.set(axis, there);
            }
        }
        let estimate = identify(&plan, &settings_with_2000_trials(), &stepped).unwrap();
        println!("{:?}", estimate.warnings);
        assert!(estimate.warnings.is_empty());
        for (name, expected) in paper_errors() {
            let (found, before) = (find_parameter(&estimate, &name), find_parameter(&sound, &name));
            let off = found.value - found.unit.to_reported_value(expected);
            println!("{name}: {off:+.2}, U {:.2}, before {:.2}", found.expanded, before.expanded);
            assert!(off.abs() < 1.2 * found.expanded, "{name}");
            let moved = (found.value - before.value).abs();
            assert!(moved < found.expanded, "{name}: {moved} of {}", found.expanded);
        }
        let ex0c = find_parameter(&estimate, "EX0C");
        assert!(ex0c.budget.iter().any(|line| line.source == "steps at interruptions"));
    }
    // Nothing was measured after the interruption, so there is no step.
    let plan = Plan { interruption_times_s: vec![readings.last().unwrap().t_s], ..plan };
    assert_eq!(identify(&plan, &settings_with_2000_trials(), &readings).unwrap(), sound);
}
