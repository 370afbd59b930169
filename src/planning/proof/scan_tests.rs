//! Scans whose clearances are known by hand, through the text as in a run.

use serde_json::{Value, json};

use super::tests::{beside, plan, proven_from};
use super::*;
use machine::Axis;

/// A sensor whose zero point is 150 mm below the spindle datum and 50 mm below its front, which is 30 mm
/// in radius, over a ball of 10 mm at the origin, known to 1 mm: its top at Z = 10, so at Z 160 the
/// sensor reads nothing. The scan rests at three points along X, 1 mm above that.
fn looking(change: impl FnOnce(&mut Value)) -> Plan {
    plan(|plan| {
        let at = |x: f64| json!({"X": x, "Y": 0.0, "Z": 161.0, "B": 0.0, "C": 0.0});
        plan["sensors"] = json!([{"name": "laser", "zero_mm": [0.0, 0.0, -150.0],
            "direction": [0.0, 0.0, -1.0], "range_mm": [-10.0, 10.0], "stand_off_mm": 50.0,
            "body_radius_mm": 30.0, "body_length_mm": 40.0}]);
        plan["artefact"] = json!({"kind": "balls", "uncertainty_mm": 1.0,
            "balls": [{"id": "1", "centre_mm": [0.0, 0.0, 0.0], "radius_mm": 10.0}]});
        plan["steps"] = json!([{"id": 0, "stage": 0, "kind": "scan", "label": "s", "from": at(-5.0),
            "to": at(5.0), "feed_mm_min": 60.0, "sensor": "laser", "normal": [0.0, 0.0, 1.0],
            "path": [at(-5.0), at(0.0), at(5.0)], "dwell_s": 0.5, "samples": 10}]);
        change(plan);
    })
}

const WHOLE: &str = "N0 G53 G0 X-5\nN0 G53 G0 Z171\nN0 G53 G1 Z161 F1500\nN0 G4 P0.5\n\
                     N0 G53 G1 X0 F60\nN0 G4 P0.5\nN0 G53 G1 X5 F60\nN0 G4 P0.5\n";

#[track_caller]
fn refused(plan: &Plan, from: &str, to: &str) -> Reason {
    assert!(WHOLE.contains(from), "{from}");
    let text = WHOLE.replacen(from, to, 1);
    proven_from(plan, &text, Some(&beside())).unwrap_err().reason
}

#[test]
fn a_whole_scan_is_proven_and_its_nearest_pair_is_known_by_hand() {
    let proof = proven_from(&looking(|_| {}), WHOLE, Some(&beside())).unwrap();
    assert_eq!((proof.motions, proof.steps.len()), (8, 1));
    // The front stands at 161 − 150 + 50, the top of the ball at 10, and the ball may be 1 mm higher.
    let nearest = proof.nearest.unwrap();
    assert_eq!(nearest.between, ["laser", "ball 1"]);
    assert!((nearest.clearance_mm - 50.0).abs() < 0.02, "{nearest:?}");
    assert_eq!(proof.not_looked_at, ["stem of ball 1", "spindle nose", "table"]);
}

#[test]
fn every_point_is_reached_in_its_turn_at_the_feed_and_rested_at() {
    let plan = looking(|_| {});
    let place = |reason| matches!(reason, Reason::NotAtPoint(_));
    assert!(place(refused(&plan, "X0 F60", "X0.01 F60")));
    assert!(place(refused(&plan, "N0 G53 G1 X0 F60\n", "")));
    assert!(place(refused(&plan, "N0 G53 G1 X5 F60\n", "N0 G53 G1 X0 F60\n")));
    let feed = |reason| matches!(reason, Reason::Feed { .. });
    assert!(feed(refused(&plan, "X0 F60", "X0 F61")));
    assert!(feed(refused(&plan, "F1500", "F1501")));
    let unfinished = |reason| matches!(reason, Reason::Unfinished(_));
    assert!(unfinished(refused(&plan, "N0 G4 P0.5\nN0 G53 G1 X5", "N0 G4 P0.4\nN0 G53 G1 X5")));
    assert!(unfinished(refused(&plan, "N0 G53 G1 X5 F60\nN0 G4 P0.5\n", "")));
    assert!(unfinished(refused(&plan, "X5 F60\nN0 G4 P0.5\n", "X5 F60\n")));
    let off = |reason| matches!(reason, Reason::OffPath);
    assert!(off(refused(&plan, "N0 G53 G1 X0 F60", "N0 G53 G0 Z200\nN0 G53 G1 X0 F60")));
    assert!(off(refused(&plan, "X5 F60\nN0 G4 P0.5\n", "X5 F60\nN0 G4 P0.5\nN0 G53 G1 X0 F60\n")));
    let probes = |reason| matches!(reason, Reason::ProbeInScan);
    assert!(probes(refused(&plan, "N0 G53 G1 Z161 F1500", "N0 G38.3 Z161 F1500")));
    let limit = |reason| matches!(reason, Reason::Limit { axis: Axis::X, .. });
    assert!(limit(refused(&plan, "X0 F60", "X301 F60")));
}

#[test]
fn the_body_of_the_sensor_keeps_the_margin_on_all_of_its_way() {
    // A post beside the ball, 30 + 2 mm from where the sensor's axis ends its way at X = 5.
    let with_post = |x: f64| {
        looking(|plan| {
            plan["solids"] = json!([{"name": "post", "on": "table", "from_mm": [x, -5.0, -50.0],
                "to_mm": [x + 10.0, 5.0, 70.0]}]);
        })
    };
    let from_left = beside().with(Axis::X, -100.0);
    proven_from(&with_post(37.01), WHOLE, Some(&from_left)).unwrap();
    let refusal = proven_from(&with_post(36.9), WHOLE, Some(&from_left)).unwrap_err();
    assert!(matches!(refusal.reason, Reason::Near { .. }), "{refusal}");
    assert_eq!(refusal.line, 10, "the line to the last point: {refusal}");
    // Without a body nobody looks at it, and the proof says so.
    let bare = looking(|plan| plan["sensors"][0]["body_radius_mm"] = 0.0.into());
    let proof = proven_from(&bare, WHOLE, Some(&beside())).unwrap();
    assert!(proof.not_looked_at.contains(&"body of laser".to_owned()), "{proof:?}");
}

/// The same three points without a rest, and back to the middle.
fn on_the_way() -> Plan {
    looking(|plan| {
        let step = &mut plan["steps"][0];
        let back = step["path"][1].clone();
        step["path"].as_array_mut().unwrap().push(back.clone());
        step["to"] = back;
        let step = step.as_object_mut().unwrap();
        step.remove("dwell_s");
        step.remove("samples");
        step.insert("rate_hz".into(), 1000.0.into());
    })
}

const FLOWING: &str = "N0 G53 G0 X-5\nN0 G53 G0 Z171\nN0 G53 G1 Z161 F1500\nN0 G53 G1 X0 F60\n\
                       N0 G53 G1 X5 F60\nN0 G53 G1 X0 F60\n";

#[test]
fn a_continuous_scan_goes_on_from_point_to_point() {
    let plan = on_the_way();
    let proof = proven_from(&plan, FLOWING, Some(&beside())).unwrap();
    assert_eq!((proof.motions, proof.steps.len()), (6, 1));
    let refused = |from: &str, to: &str| {
        assert!(FLOWING.contains(from), "{from}");
        let text = FLOWING.replacen(from, to, 1);
        proven_from(&plan, &text, Some(&beside())).unwrap_err().reason
    };
    let rests = |reason| matches!(reason, Reason::RestInScan);
    assert!(rests(refused("N0 G53 G1 X5", "N0 G4 P0.5\nN0 G53 G1 X5")));
    assert!(rests(refused("N0 G53 G1 X0 F60", "N0 G4 P0.001\nN0 G53 G1 X0 F60")));
    let last = "X5 F60\nN0 G53 G1 X0 F60\n";
    assert!(rests(refused(last, "X5 F60\nN0 G53 G1 X0 F60\nN0 G4 P0.5\n")));
    let place = |reason| matches!(reason, Reason::NotAtPoint(_));
    assert!(place(refused("X0 F60", "X0.01 F60")));
    assert!(place(refused("N0 G53 G1 X0 F60\n", "")));
    assert!(place(refused("X0 F60", "X0 Y0.1 F60")));
    let feed = |reason| matches!(reason, Reason::Feed { .. });
    assert!(feed(refused("X5 F60", "X5 F59")));
    assert!(feed(refused("X5 F60", "X5 F180")));
    assert!(matches!(refused(last, "X5 F60\n"), Reason::Unfinished(_)));
    let off = |reason| matches!(reason, Reason::OffPath);
    assert!(off(refused("N0 G53 G1 X5", "N0 G53 G0 X1\nN0 G53 G1 X5")));
    assert!(off(refused(last, "X5 F60\nN0 G53 G1 X0 F60\nN0 G53 G1 X5 F60\n")));
    assert!(off(refused("N0 G53 G1 X5 F60", "N0 G38.3 X5 F60")));
}
