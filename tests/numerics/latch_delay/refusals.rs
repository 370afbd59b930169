//! Tests the refusals of `latch-delay` before any motion, and after the part was found.

use machine::record::plan::{Plan, Stage};
use methods::{MethodRefusal, NextStage, ObjectPositionSource};

use super::latch_delay_world::LatchDelayWorld;

/// The whole plan from nominal positions.
fn nominal_plan_and_stages(world: &LatchDelayWorld) -> Result<(Plan, Vec<Stage>), MethodRefusal> {
    let (method, plan) = world.method_and_plan_without_steps();
    methods::plan_nominal_stages(method.as_ref(), plan)
}

fn assert_refused(world: &LatchDelayWorld, words: &str) {
    let refused = nominal_plan_and_stages(world).unwrap_err();
    assert!(refused.reason.contains(words), "{}", refused.reason);
    assert!(!refused.remedy.is_empty());
}

fn world_with_key(key: &str, value: impl Into<toml::Value>) -> LatchDelayWorld {
    LatchDelayWorld::with_a_round_part().with_key(key, value)
}

#[test]
fn unusable_settings_are_refused_before_motion() {
    assert_refused(&world_with_key("method.latch-delay.touches", 2), "touches = 2 at each feed");
    assert_refused(&world_with_key("method.latch-delay.direction_deg", 400.0), "direction_deg is outside");
    assert_refused(&world_with_key("method.latch-delay.fast_feed_mm_min", 45.0), "at least 2 times the measuring feed");
    assert_refused(&world_with_key("method.latch-delay.fast_feed_mm_min", -1.0), "at least 2 times the measuring feed");
    assert_refused(&world_with_key("method.latch-delay.fast_feed_mm_min", 1e9), "rapid rate of the axes, 20000 mm/min");
    assert_refused(&world_with_key("probe.search_feed_mm_min", 40.0), "at least 2 times the measuring feed");
    assert_refused(&world_with_key("artefact.axis", vec![1.0, 0.0, 0.0]), "upright");
    assert_refused(&world_with_key("artefact.centre_mm", vec![900.0, 0.0, 0.0]), "does not reach");
}

/// The acceleration distance of a fast touch is part of the touch, which is not longer than the overtravel: a
/// stated fast feed that needs more is refused, a default one is lowered.
#[test]
fn touch_too_short_for_its_feed_is_refused_or_slowed() {
    let weak = || world_with_key("axes.Y.acceleration_per_s2", 20.0);
    assert_refused(&weak().with_key("method.latch-delay.fast_feed_mm_min", 300.0), "overtravel");
    let (plan, _) = nominal_plan_and_stages(&weak()).unwrap();
    let fast = plan.steps.iter().map(|step| step.feed_mm_min).skip(1).fold(0.0, f64::max);
    assert!((60.0..300.0).contains(&fast), "{fast}");
    // With 20 mm/s² and the part 2 mm nearer than stated, the feed is reached before contact.
    let run_up = (fast / 60.0_f64).powi(2) / 40.0;
    let step = &plan.steps[2];
    let out = step.from.get_or_zero(machine::Axis::X) - (45.0 + 3.0) - 2.0;
    assert!(out > run_up, "{out} {run_up}");
}

#[test]
fn feeds_alternate_at_one_position() {
    let (plan, stages) = nominal_plan_and_stages(&LatchDelayWorld::with_a_round_part()).unwrap();
    assert_eq!(stages.iter().map(|stage| stage.steps.len()).collect::<Vec<_>>(), [1, 24]);
    assert!(plan.steps.iter().all(|step| step.from == plan.steps[0].from && step.to == plan.steps[0].to));
    let feeds: Vec<f64> = plan.steps.iter().map(|step| step.feed_mm_min).collect();
    assert_eq!(feeds[..6], [300.0, 30.0, 300.0, 300.0, 30.0, 30.0]);
}

/// The part is nearer than the start of its touches.
#[test]
fn displaced_part_is_refused_when_located() {
    let (method, mut plan) = LatchDelayWorld::with_a_round_part().method_and_plan_without_steps();
    let NextStage::Stage { stage, new_steps } = method.next_stage(&plan, &[], ObjectPositionSource::Nominal).unwrap()
    else {
        panic!("a search")
    };
    plan.steps.extend(new_steps);
    let reading = |x_mm: f64| {
        let from = &plan.steps[0].from;
        machine::record::reading::Reading {
            step: 0,
            repeat: 0,
            position: from.clone().with(machine::Axis::X, from.get_or_zero(machine::Axis::X) - x_mm),
            value_mm: None,
            sensor: "probe".to_owned(),
            t_s: 1.0,
            flag: Default::default(),
            temperatures_c: Default::default(),
        }
    };
    let next =
        |x_mm| method.next_stage(&plan, std::slice::from_ref(&stage), ObjectPositionSource::Measured(&[reading(x_mm)]));
    assert!(next(2.0).is_ok());
    for x_mm in [0.001, 5.3, f64::NAN] {
        assert!(next(x_mm).unwrap_err().reason.contains("the first contact was after"), "{x_mm}");
    }
}
