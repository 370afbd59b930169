//! Proofs of scans, in cases whose clearances are computed by hand, with the text of a run.

use serde_json::{Value, json};

use super::tests::{cylinder_touch_plan, position_beside_part, prove_lines_from, prove_lines_with_touched_directions};
use super::*;
use machine::Axis;

/// A sensor whose zero point is 150 mm below the spindle datum and 50 mm below its front, which is 30 mm in radius,
/// above a ball of 10 mm radius at the origin, with an uncertainty of 1 mm. The top of the ball is at Z = 10, so at
/// Z 160 the sensor reads zero. The scan rests at three points along X, 1 mm higher.
fn change_to_laser_scan(plan: &mut Value) {
    let at = |x: f64| json!({"X": x, "Y": 0.0, "Z": 161.0, "B": 0.0, "C": 0.0});
    plan["sensors"] = json!([{"name": "laser", "zero_mm": [0.0, 0.0, -150.0],
        "direction": [0.0, 0.0, -1.0], "range_mm": [-10.0, 10.0], "stand_off_mm": 50.0,
        "body_radius_mm": 30.0, "body_length_mm": 40.0}]);
    plan["artefact"] = json!({"kind": "balls", "uncertainty_mm": 1.0,
        "balls": [{"id": "1", "centre_mm": [0.0, 0.0, 0.0], "radius_mm": 10.0}]});
    plan["steps"] = json!([{"id": 0, "stage": 0, "kind": "scan", "label": "s", "from": at(-5.0),
        "to": at(5.0), "feed_mm_min": 60.0, "sensor": "laser", "normal": [0.0, 0.0, 1.0],
        "path": [at(-5.0), at(0.0), at(5.0)], "dwell_s": 0.5, "samples": 10}]);
}

fn laser_scan_plan(change: impl FnOnce(&mut Value)) -> Plan {
    cylinder_touch_plan(|plan| {
        change_to_laser_scan(plan);
        change(plan);
    })
}

/// Program for [`laser_scan_plan`]: an approach, then a rest of 0.5 s at each of the three points.
const DWELL_SCAN_PROGRAM: &str = "N0 G53 G0 X-5\nN0 G53 G0 Z171\nN0 G53 G1 Z161 F1500\nN0 G4 P0.5\n\
                     N0 G53 G1 X0 F60\nN0 G4 P0.5\nN0 G53 G1 X5 F60\nN0 G4 P0.5\n";

/// Refusal of the dwell scan's program after one replacement of `from` by `to`.
#[track_caller]
fn dwell_scan_refusal(plan: &Plan, from: &str, to: &str) -> RefusalReason {
    assert!(DWELL_SCAN_PROGRAM.contains(from), "{from}");
    let text = DWELL_SCAN_PROGRAM.replacen(from, to, 1);
    prove_lines_from(plan, &text, Some(&position_beside_part())).unwrap_err().reason
}

#[test]
fn whole_scan_is_proven_with_hand_computed_nearest_pair() {
    let proof = prove_lines_from(&laser_scan_plan(|_| {}), DWELL_SCAN_PROGRAM, Some(&position_beside_part())).unwrap();
    assert_eq!((proof.motion_count, proof.steps.len()), (8, 1));
    // The front is at 161 − 150 + 50, the top of the ball at 10, and the ball may be 1 mm higher.
    let nearest = proof.nearest.unwrap();
    assert_eq!(nearest.between, ["laser", "ball 1"]);
    assert!((nearest.clearance_mm - 50.0).abs() < 0.02, "{nearest:?}");
    assert_eq!(proof.unchecked_items, ["stem of ball 1", "spindle nose", "table"]);
}

#[test]
fn scan_with_a_wrong_point_feed_or_dwell_is_refused() {
    let plan = laser_scan_plan(|_| {});
    let place = |reason| matches!(reason, RefusalReason::WrongScanPoint(_));
    assert!(place(dwell_scan_refusal(&plan, "X0 F60", "X0.01 F60")));
    assert!(place(dwell_scan_refusal(&plan, "N0 G53 G1 X0 F60\n", "")));
    assert!(place(dwell_scan_refusal(&plan, "N0 G53 G1 X5 F60\n", "N0 G53 G1 X0 F60\n")));
    let feed = |reason| matches!(reason, RefusalReason::WrongFeed { .. });
    assert!(feed(dwell_scan_refusal(&plan, "X0 F60", "X0 F61")));
    assert!(feed(dwell_scan_refusal(&plan, "F1500", "F1501")));
    let unfinished = |reason| matches!(reason, RefusalReason::StepIncomplete(_));
    assert!(unfinished(dwell_scan_refusal(&plan, "N0 G4 P0.5\nN0 G53 G1 X5", "N0 G4 P0.4\nN0 G53 G1 X5")));
    assert!(unfinished(dwell_scan_refusal(&plan, "N0 G53 G1 X5 F60\nN0 G4 P0.5\n", "")));
    assert!(unfinished(dwell_scan_refusal(&plan, "X5 F60\nN0 G4 P0.5\n", "X5 F60\n")));
    let off = |reason| matches!(reason, RefusalReason::OffScanPath);
    assert!(off(dwell_scan_refusal(&plan, "N0 G53 G1 X0 F60", "N0 G53 G0 Z200\nN0 G53 G1 X0 F60")));
    assert!(off(dwell_scan_refusal(&plan, "X5 F60\nN0 G4 P0.5\n", "X5 F60\nN0 G4 P0.5\nN0 G53 G1 X0 F60\n")));
    let probes = |reason| matches!(reason, RefusalReason::ProbingMoveInScan);
    assert!(probes(dwell_scan_refusal(&plan, "N0 G53 G1 Z161 F1500", "N0 G38.3 Z161 F1500")));
    let limit = |reason| matches!(reason, RefusalReason::OutsideLimits { axis: Axis::X, .. });
    assert!(limit(dwell_scan_refusal(&plan, "X0 F60", "X301 F60")));
}

#[test]
fn the_sensor_body_keeps_the_margin_on_its_whole_path() {
    // A post beside the ball, 30 + 2 mm from the end of the sensor axis' path at X = 5.
    let with_post = |x: f64| {
        laser_scan_plan(|plan| {
            plan["solids"] = json!([{"name": "post", "on": "table", "from_mm": [x, -5.0, -50.0],
                "to_mm": [x + 10.0, 5.0, 70.0]}]);
        })
    };
    let from_left = position_beside_part().with(Axis::X, -100.0);
    prove_lines_from(&with_post(37.01), DWELL_SCAN_PROGRAM, Some(&from_left)).unwrap();
    let refusal = prove_lines_from(&with_post(36.9), DWELL_SCAN_PROGRAM, Some(&from_left)).unwrap_err();
    assert!(matches!(refusal.reason, RefusalReason::ClearanceTooSmall { .. }), "{refusal}");
    assert_eq!(refusal.line, 10, "the line to the last point: {refusal}");
    // Without a declared body, it is not checked, and the proof reports this.
    let bare = laser_scan_plan(|plan| plan["sensors"][0]["body_radius_mm"] = 0.0.into());
    let proof = prove_lines_from(&bare, DWELL_SCAN_PROGRAM, Some(&position_beside_part())).unwrap();
    assert!(proof.unchecked_items.contains(&"body of laser".to_owned()), "{proof:?}");
}

/// The same three points without a rest, then back to the middle.
fn continuous_scan_plan() -> Plan {
    laser_scan_plan(|plan| {
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

/// Program for [`continuous_scan_plan`], without a rest.
const CONTINUOUS_SCAN_PROGRAM: &str = "N0 G53 G0 X-5\nN0 G53 G0 Z171\nN0 G53 G1 Z161 F1500\nN0 G53 G1 X0 F60\n\
                       N0 G53 G1 X5 F60\nN0 G53 G1 X0 F60\n";

#[test]
fn continuous_scan_with_a_dwell_or_another_path_is_refused() {
    let plan = continuous_scan_plan();
    let proof = prove_lines_from(&plan, CONTINUOUS_SCAN_PROGRAM, Some(&position_beside_part())).unwrap();
    assert_eq!((proof.motion_count, proof.steps.len()), (6, 1));
    let refusal = |from: &str, to: &str| {
        assert!(CONTINUOUS_SCAN_PROGRAM.contains(from), "{from}");
        let text = CONTINUOUS_SCAN_PROGRAM.replacen(from, to, 1);
        prove_lines_from(&plan, &text, Some(&position_beside_part())).unwrap_err().reason
    };
    let rests = |reason| matches!(reason, RefusalReason::DwellInContinuousScan);
    assert!(rests(refusal("N0 G53 G1 X5", "N0 G4 P0.5\nN0 G53 G1 X5")));
    assert!(rests(refusal("N0 G53 G1 X0 F60", "N0 G4 P0.001\nN0 G53 G1 X0 F60")));
    let last = "X5 F60\nN0 G53 G1 X0 F60\n";
    assert!(rests(refusal(last, "X5 F60\nN0 G53 G1 X0 F60\nN0 G4 P0.5\n")));
    let place = |reason| matches!(reason, RefusalReason::WrongScanPoint(_));
    assert!(place(refusal("X0 F60", "X0.01 F60")));
    assert!(place(refusal("N0 G53 G1 X0 F60\n", "")));
    assert!(place(refusal("X0 F60", "X0 Y0.1 F60")));
    let feed = |reason| matches!(reason, RefusalReason::WrongFeed { .. });
    assert!(feed(refusal("X5 F60", "X5 F59")));
    assert!(feed(refusal("X5 F60", "X5 F180")));
    assert!(matches!(refusal(last, "X5 F60\n"), RefusalReason::StepIncomplete(_)));
    let off = |reason| matches!(reason, RefusalReason::OffScanPath);
    assert!(off(refusal("N0 G53 G1 X5", "N0 G53 G0 X1\nN0 G53 G1 X5")));
    assert!(off(refusal(last, "X5 F60\nN0 G53 G1 X0 F60\nN0 G53 G1 X5 F60\n")));
    assert!(off(refusal("N0 G53 G1 X5 F60", "N0 G38.3 X5 F60")));
}

/// A nest of three sensors at 120°, 35.26° below its centre at X `at_x`, Y 0, Z 60, for a ball of 11 mm radius: their
/// bodies are 1.5 mm from the ball, and 0.5 mm at the near end of their range.
fn nest_scan_plan(at_x: f64, change: impl FnOnce(&mut Value)) -> Plan {
    cylinder_touch_plan(|plan| {
        let elevation = (1.0 / 3.0_f64.sqrt()).asin();
        let sensor = |number: u32| {
            let angle = f64::from(number) * std::f64::consts::TAU / 3.0;
            let [cos, sin] = [elevation.cos(), elevation.sin()];
            let along = [-cos * angle.cos(), -cos * angle.sin(), sin];
            let zero = [at_x - 11.0 * along[0], -11.0 * along[1], 60.0 - 11.0 * along[2]];
            json!({"name": format!("n{number}"), "mount": "table", "zero_mm": zero,
                "direction": along, "range_mm": [-1.0, 1.0], "stand_off_mm": 1.5,
                "body_radius_mm": 4.0, "body_length_mm": 30.0})
        };
        let point = |x: f64, z: f64, c: f64| json!({"X": x, "Y": 0.0, "Z": 180.0 + z, "B": 0.0, "C": c});
        let path = [
            point(0.0, 0.0, 0.0),
            point(0.1, 0.0, 0.0),
            point(0.0, -0.1, 0.0),
            point(0.0, 0.0, 0.0),
            point(0.0, 0.0, 120.0),
            point(0.0, 0.0, 240.0),
            point(0.0, 0.0, 360.0),
        ];
        plan["probe"]["ball_radius_mm"] = 11.0.into();
        plan["probe"]["stem_radius_mm"] = 4.0.into();
        plan["probe"]["stem_length_mm"] = 60.0.into();
        plan["probe"]["body_radius_mm"] = 30.0.into();
        plan["probe"]["body_length_mm"] = 50.0.into();
        plan["artefact"] = json!({"kind": "none"});
        plan["sensors"] = (0..3).map(sensor).collect();
        plan["steps"] = json!([{"id": 0, "stage": 0, "kind": "scan", "label": "s", "from": path[0],
            "to": path[6], "feed_mm_min": 60.0, "sensor": ["n0", "n1", "n2"], "normal": [0.0, 0.0, 1.0],
            "path": path, "dwell_s": 0.5, "samples": 10}]);
        change(plan);
    })
}

/// Program for [`nest_scan_plan`]: by way of the upper end of Z into the nest, then the seven points.
const NEST_SCAN_PROGRAM: &str = "N0 G53 G1 Z450 F60\nN0 G53 G1 X0 F60\nN0 G53 G1 Z190 F60\nN0 G53 G1 Z180 F60\n\
                       N0 G4 P0.5\nN0 G53 G1 X0.1 F60\nN0 G4 P0.5\nN0 G53 G1 X0 Z179.9 F60\nN0 G4 P0.5\n\
                       N0 G53 G1 Z180 F60\nN0 G4 P0.5\nN0 G53 G1 C120 F60\nN0 G4 P0.5\n\
                       N0 G53 G1 C240 F60\nN0 G4 P0.5\nN0 G53 G1 C360 F60\nN0 G4 P0.5\n";

/// Refusal of the nest scan's program after one replacement of `from` by `to`, at an unverified position.
#[track_caller]
fn nest_scan_refusal(plan: &Plan, from: &str, to: &str) -> ProofRefusal {
    assert!(NEST_SCAN_PROGRAM.contains(from), "{from}");
    let text = NEST_SCAN_PROGRAM.replacen(from, to, 1);
    prove_lines_with_touched_directions(plan, &text, Some(&position_beside_part()), TouchedDirections::default())
        .unwrap_err()
}

#[test]
fn moves_and_table_turns_of_a_ball_in_a_nest_are_proven() {
    let plan = nest_scan_plan(0.0, |_| {});
    for confirmed in [TouchedDirections::default(), TouchedDirections::all()] {
        let proof =
            prove_lines_with_touched_directions(&plan, NEST_SCAN_PROGRAM, Some(&position_beside_part()), confirmed)
                .unwrap();
        assert_eq!((proof.motion_count, proof.steps.len()), (17, 1));
        // The gap of 1.5 mm, minus the approach: the ball moves 0.1 mm along X towards the sensor, of which the cos
        // 35.26° part counts, or down, of which the sin 35.26° part counts.
        let nearest = proof.nearest.unwrap();
        assert_eq!(nearest.between, ["stylus ball", "n0"]);
        let expected = 1.5 - 0.1 * (2.0_f64 / 3.0).sqrt();
        assert!((nearest.clearance_mm - expected).abs() < 0.03, "{nearest:?}");
        assert_eq!(proof.unchecked_items, ["spindle nose", "table"]);
    }
}

#[test]
fn fast_move_of_the_ball_between_the_sensors_is_refused() {
    let plan = nest_scan_plan(0.0, |_| {});
    let near = |refusal: ProofRefusal| matches!(refusal.reason, RefusalReason::ClearanceTooSmall { .. });
    let feed = |refusal: ProofRefusal| matches!(refusal.reason, RefusalReason::WrongFeed { .. });
    // A hold must stop within 0.5 mm: at most 98 mm/min.
    assert!(feed(nest_scan_refusal(&plan, "Z180 F60", "Z180 F120")));
    let fast = nest_scan_plan(0.0, |plan| plan["steps"][0]["feed_mm_min"] = 120.0.into());
    assert!(feed(nest_scan_refusal(&fast, "X0.1 F60", "X0.1 F120")));
    assert!(near(nest_scan_refusal(&plan, "Z190 F60", "Z180.5 F1000")));
    // The ball leaves a nest slowly, not by a rapid.
    let in_nest = position_beside_part().with(Axis::X, 0.0).with(Axis::Z, 180.0);
    let from_nest = |feed: &str| {
        let text = NEST_SCAN_PROGRAM.replacen("Z450 F60", &format!("Z450 F{feed}"), 1);
        prove_lines_with_touched_directions(
            &plan,
            &text.replacen("N0 G53 G1 X0 F60\n", "", 1),
            Some(&in_nest),
            TouchedDirections::all(),
        )
    };
    from_nest("60").unwrap();
    assert!(near(from_nest("1000").unwrap_err()));
    let text = NEST_SCAN_PROGRAM.replacen("N0 G53 G1 Z450 F60", "N0 G53 G0 Z450", 1);
    assert!(near(prove_lines_from(&plan, &text, Some(&in_nest)).unwrap_err()));
}

#[test]
fn a_ball_beside_the_nest_and_a_solid_in_the_way_are_refused() {
    // 5 mm along X move the ball nearer to one sensor by 5 mm · cos 35.26°, more than its gap.
    for at_x in [-5.0, 5.0, -1.4] {
        let refusal = nest_scan_refusal(&nest_scan_plan(at_x, |_| {}), "N0 G53 G1 Z450", "N0 G53 G1 Z450");
        let RefusalReason::ClearanceTooSmall { between: [one, other], min_clearance_mm, .. } = &refusal.reason else {
            panic!("{refusal}")
        };
        assert_eq!((one.as_str(), *min_clearance_mm), ("stylus ball", 0.5), "{other}");
    }
    // Gap 1.5 mm − 1.1 mm · cos 35.26° = 0.6 mm, without the moves by 0.1 mm.
    let off = nest_scan_plan(-1.1, |plan| {
        let step = &mut plan["steps"][0];
        step["path"] = json!([step["from"]]);
        step["to"] = step["from"].clone();
    });
    let (way_down, _) = NEST_SCAN_PROGRAM.split_once("N0 G53 G1 X0.1").unwrap();
    prove_lines_with_touched_directions(&off, way_down, Some(&position_beside_part()), TouchedDirections::default())
        .unwrap();
    let post = |x: f64| {
        nest_scan_plan(0.0, |plan| {
            plan["solids"] = json!([{"name": "post", "on": "table", "from_mm": [x, -5.0, 0.0],
                "to_mm": [x + 10.0, 5.0, 150.0]}]);
        })
    };
    let prove_programs = |x: f64| {
        prove_lines_with_touched_directions(
            &post(x),
            NEST_SCAN_PROGRAM,
            Some(&position_beside_part()),
            TouchedDirections::default(),
        )
    };
    // The probe's body, 30 mm in radius, is 60 mm above the centre of the ball: it is beside the post from 120 mm
    // on.
    prove_programs(32.3).unwrap();
    let refusal = prove_programs(31.9).unwrap_err();
    assert!(
        matches!(&refusal.reason, RefusalReason::ClearanceTooSmall { between, .. } if between.contains(&"post".to_owned())),
        "{refusal}"
    );
}
