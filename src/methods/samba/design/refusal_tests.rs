//! Measurements that are impossible are refused with a reason before the first motion.

use super::tests::rumba_plan;
use crate::samba::settings::{DesignKind, SambaSettings, SpindleOrientMode};
use crate::samba::tests::machine;
use crate::samba::{Method, NextStage, ObjectPositionSource, RegisteredMethod, Samba};
use machine::Axis;
use machine::record::artefact::{Artefact, Balls};
use machine::record::plan::Plan;

fn plan_with_changed_balls(change: impl FnOnce(&mut Balls)) -> Plan {
    let mut plan = rumba_plan(&SambaSettings::default());
    let Artefact::Balls(balls) = &mut plan.artefact else { panic!() };
    change(balls);
    plan
}

#[track_caller]
fn assert_refused(plan: &Plan, settings: SambaSettings, words: &[&str]) {
    let answer = Samba::new(settings).next_stage(plan, &[], ObjectPositionSource::Measured(&[]));
    let Err(refused) = answer else { panic!("not refused") };
    for word in words {
        assert!(refused.reason.contains(word), "`{word}` is not in: {}", refused.reason);
    }
    assert!(!refused.remedy.is_empty());
}

#[test]
fn unmeasurable_artefacts_are_refused() {
    let twice = plan_with_changed_balls(|set| set.balls[3].id = "2".into());
    assert_refused(&twice, SambaSettings::default(), &["ball 2: `id` is `2`, as for another ball"]);
    let touching = plan_with_changed_balls(|set| set.balls[1].centre_mm = [-140.0, 5.0, 45.0]);
    assert_refused(
        &touching,
        SambaSettings::default(),
        &["ball 2: `centre_mm` is", "from ball `1`; the two balls would touch"],
    );
    let in_stem = plan_with_changed_balls(|set| set.balls[1].centre_mm = [160.0, 155.0, 60.0]);
    assert_refused(&in_stem, SambaSettings::default(), &["puts ball `2` into the stem of ball `3`"]);
    let two = plan_with_changed_balls(|set| {
        set.balls.truncate(2);
    });
    assert_refused(&two, SambaSettings::default(), &["2 ball(s): samba requires three"]);
    let slash = plan_with_changed_balls(|set| set.balls[0].id = "1/2".into());
    assert_refused(&slash, SambaSettings::default(), &["`id` is `1/2`"]);
    let no_pair = plan_with_changed_balls(|set| set.lengths[0].to = "9".into());
    assert_refused(&no_pair, SambaSettings::default(), &["the length 1–9: `to` is `9`"]);
    let other_length = plan_with_changed_balls(|set| set.lengths[0].mm = 300.0);
    assert_refused(&other_length, SambaSettings::default(), &["`mm` is 300", "304.8"]);
    let mut cylinder = rumba_plan(&SambaSettings::default());
    cylinder.artefact =
        serde_json::from_str(r#"{"kind":"cylinder","centre_mm":[0,0,0],"axis":[0,0,1],"radius_mm":40}"#).unwrap();
    assert_refused(&cylinder, SambaSettings::default(), &["samba measures balls"]);
}

#[test]
fn ball_accessible_at_no_indexation_is_named() {
    let far = plan_with_changed_balls(|set| set.balls[4].centre_mm = [-5000.0, 0.0, 75.0]);
    assert_refused(&far, SambaSettings::default(), &["ball 5 is accessible at none of", "outside"]);
    let hanging = plan_with_changed_balls(|set| set.balls[4].stem = [0.0, 0.0, 1.0]);
    let upright = SambaSettings { tilt_deg: vec![-30.0, 0.0, 30.0], ..SambaSettings::default() };
    assert_refused(&hanging, upright, &["ball 5", "stem"]);
}

#[test]
fn indexations_outside_the_limits_are_refused() {
    let mut narrow = rumba_plan(&SambaSettings::default());
    let b = narrow.machine.axes.get_mut(&Axis::B).unwrap();
    (b.min, b.max) = (-45.0, 100.0);
    let asked = SambaSettings { tilt_deg: vec![-60.0, 0.0, 60.0], ..SambaSettings::default() };
    assert_refused(&narrow, asked, &["B at -60°", "[-45, 100]"]);
    let paper = SambaSettings { design: DesignKind::Paper, ..SambaSettings::default() };
    assert_refused(&narrow, paper, &["does not reach B-90"]);
    // The defaults are restricted to the limits of the axis.
    let answer = Samba::new(SambaSettings::default()).next_stage(&narrow, &[], ObjectPositionSource::Measured(&[]));
    assert!(matches!(answer, Ok(NextStage::Stage { .. })), "{answer:?}");
}

#[test]
fn orienting_the_spindle_without_axis_s_is_refused() {
    let mut fixed = rumba_plan(&SambaSettings::default());
    fixed.machine.axes.remove(&Axis::S);
    let orient = SambaSettings { spindle: SpindleOrientMode::Orient, ..SambaSettings::default() };
    assert_refused(&fixed, orient, &["spindle cannot be oriented", "no axis S"]);
    let asked = SambaSettings { parameters: vec!["EA0C".into(), "EX0S".into()], ..SambaSettings::default() };
    assert_refused(&fixed, asked, &["EX0S", "t_x are inseparable"]);
    // The offset is refused also after an angular error of the same axis, which is identifiable.
    let asked = SambaSettings { parameters: vec!["EA0S".into(), "EX0S".into()], ..SambaSettings::default() };
    assert_refused(&fixed, asked, &["EX0S", "t_x are inseparable"]);
    let answer = Samba::new(SambaSettings::default()).next_stage(&fixed, &[], ObjectPositionSource::Measured(&[]));
    assert!(matches!(answer, Ok(NextStage::Stage { .. })), "{answer:?}");
}

/// B is in the head and stays at 0, whatever `tilt_deg` states for A. The errors of B are refused if they
/// are selected.
#[test]
fn tilting_head_stays_upright_and_its_errors_are_refused() {
    let mut fork = rumba_plan(&SambaSettings::default());
    fork.machine = machine("wAFXYZBt");
    let answer = Samba::new(SambaSettings::default()).next_stage(&fork, &[], ObjectPositionSource::Measured(&[]));
    let Ok(NextStage::Stage { new_steps, .. }) = answer else { panic!("{answer:?}") };
    assert!(new_steps.iter().all(|step| step.from.get(Axis::B) == Some(0.0)));
    let parameters = vec!["EA0B".into(), "EC0A".into()];
    let asked = SambaSettings { parameters, ..SambaSettings::default() };
    let words = ["EA0B was requested", "the spindle must be upright", "B other than 0"];
    assert_refused(&fork, asked, &words);
    let b = fork.machine.axes.get_mut(&Axis::B).unwrap();
    (b.min, b.max) = (10.0, 50.0);
    assert_refused(&fork, SambaSettings::default(), &["must be upright", "[10, 50]"]);
}

#[test]
fn without_a_bar_the_common_scale_is_refused_and_relative_gains_are_not() {
    let no_bar = plan_with_changed_balls(|set| set.lengths.clear());
    let words = ["has no certified length", "EXX1", "EYY1", "EZZ1"];
    assert_refused(&no_bar, SambaSettings::default(), &words);
    let names = "EA0B EC0B EX0C EA0C EB0C EB0Z EA0Y EC0Y EY0S EX0S EYY1 EZZ1";
    let parameters = names.split(' ').map(str::to_owned).collect();
    let relative = SambaSettings { parameters, ..SambaSettings::default() };
    let answer = Samba::new(relative).next_stage(&no_bar, &[], ObjectPositionSource::Measured(&[]));
    assert!(matches!(answer, Ok(NextStage::Stage { .. })), "{answer:?}");
}

#[test]
fn senseless_settings_are_refused() {
    let plan = rumba_plan(&SambaSettings::default());
    let unknown = SambaSettings { parameters: vec!["EX0Q".into()], ..SambaSettings::default() };
    assert_refused(&plan, unknown, &["`EX0Q` is not an error parameter"]);
    let poor = SambaSettings { max_ball_measurements: 17, ..SambaSettings::default() };
    assert_refused(&plan, poor, &["budget of 17 ball", "18 measurements"]);
    let short = SambaSettings { minutes: 2.0, ..SambaSettings::default() };
    assert_refused(&plan, short, &["minutes = 2 is too short"]);
    let few = SambaSettings { indexations: 2, ..SambaSettings::default() };
    assert_refused(&plan, few, &["at 2 indexations"]);
    let still = SambaSettings { tilt_deg: vec![0.0], turn_deg: vec![0.0], ..SambaSettings::default() };
    assert_refused(&plan, still, &["not determined", "EX0C"]);
    let tilted = SambaSettings {
        tilt_deg: vec![0.0],
        parameters: ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C"].map(String::from).to_vec(),
        ..SambaSettings::default()
    };
    assert_refused(&plan, tilted, &["not determined", "EA0B"]);
    assert_refused(&plan, SambaSettings { touches: 3, ..SambaSettings::default() }, &["touches = 3"]);
}
