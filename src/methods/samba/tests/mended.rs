//! What is not as it should be with the readings, and what must be said of it.

use rand_distr::{Distribution, StandardNormal};

use super::paper_errors;
use super::whole::{SOUND, parameter, says, settings};
use crate::base::Axis;
use crate::base::random::stream;
use crate::methods::IdentifyError;
use crate::methods::samba::identify::identify;
use crate::record::plan::Plan;
use crate::record::reading::{Flag, Reading};

/// A file with a header only, a run stopped in its first search, one measurement that is not complete:
/// refused, and said why.
#[test]
fn regress_readings_without_a_complete_measurement_are_refused() {
    let (mut plan, mut readings) = SOUND.measure();
    let why = |plan: &Plan, readings: &[Reading]| match identify(plan, &settings(), readings) {
        Err(IdentifyError::Refused(refused)) => refused.why,
        other => panic!("{other:?}"),
    };
    assert!(why(&plan, &[]).contains("no readings at all"));
    let three = why(&plan, &readings[..3]);
    assert!(three.contains("indexation 1 is left out: 3 touches, 4 are needed"), "{three}");
    for reading in readings.iter_mut().take(12) {
        reading.flag = Flag::Excluded;
    }
    let flagged = why(&plan, &readings[..12]);
    assert!(flagged.contains("all its touches are excluded; likewise 2 more"), "{flagged}");
    for step in plan.steps.iter_mut().take(19) {
        step.label = step.label.replace("slow", "find");
    }
    assert!(why(&plan, &readings[..19]).contains("first search"));
}

/// Encoders flicker: the touches of one measurement are read 1e-4° apart, and it is one measurement.
#[test]
fn regress_rotary_encoders_that_flicker() {
    let (plan, mut readings) = SOUND.measure();
    let sound = identify(&plan, &settings(), &readings).unwrap();
    let mut normal = StandardNormal.sample_iter(stream(5, &[]));
    for reading in &mut readings {
        for axis in [Axis::B, Axis::C, Axis::S] {
            let noise: f64 = normal.next().unwrap();
            let read = reading.position.get(axis).unwrap() + (noise * 1e-4_f64).to_radians();
            reading.position.set(axis, read);
        }
    }
    let estimate = identify(&plan, &settings(), &readings).unwrap();
    assert!(estimate.warnings.is_empty(), "{:?}", estimate.warnings);
    let [named, expected] = [&estimate, &sound].map(|estimate| {
        let groups = estimate.arrows[0].groups.iter();
        groups.map(|group| (group.name.clone(), group.arrows.len())).collect::<Vec<_>>()
    });
    assert_eq!((named.len(), &named), (32, &expected));
    // 1e-4° at 250 mm are 0.4 µm a touch, beside 0.5 µm of the probe: less than that of u.
    for (name, _) in paper_errors() {
        let (with, without) = (parameter(&estimate, &name), parameter(&sound, &name));
        let off = (with.value - without.value) / without.u;
        println!("{name}: {off:+.3} u");
        assert!(off.abs() < 0.75, "{name}: {off}");
    }
    // An axis that moved between the touches is something else.
    let moved = readings[2].position.get(Axis::B).unwrap() + 0.02_f64.to_radians();
    readings[2].position.set(Axis::B, moved);
    let estimate = identify(&plan, &settings(), &readings).unwrap();
    assert!(says(&estimate, &["indexation 1 is left out", "not made at one rotary position"]));
}
