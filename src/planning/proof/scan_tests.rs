//! Proofs of scans, in cases whose clearances are computed by hand, with the text of a run.

use serde_json::{Value, json};

use super::tests::{beside, plan, proven_as, proven_from};
use super::*;
use machine::Axis;

/// A sensor whose zero point is 150 mm below the spindle datum and 50 mm below its front, which is 30 mm in radius,
/// above a ball of 10 mm radius at the origin, with an uncertainty of 1 mm. The top of the ball is at Z = 10, so at
/// Z 160 the sensor reads zero. The scan rests at three points along X, 1 mm higher.
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
fn refused(plan: &Plan, from: &str, to: &str) -> RefusalReason {
    assert!(WHOLE.contains(from), "{from}");
    let text = WHOLE.replacen(from, to, 1);
    proven_from(plan, &text, Some(&beside())).unwrap_err().reason
}

#[test]
fn a_whole_scan_is_proven_and_its_nearest_pair_is_known_by_hand() {
    let proof = proven_from(&looking(|_| {}), WHOLE, Some(&beside())).unwrap();
    assert_eq!((proof.motions, proof.steps.len()), (8, 1));
    // The front is at 161 − 150 + 50, the top of the ball at 10, and the ball may be 1 mm higher.
    let nearest = proof.nearest.unwrap();
    assert_eq!(nearest.between, ["laser", "ball 1"]);
    assert!((nearest.clearance_mm - 50.0).abs() < 0.02, "{nearest:?}");
    assert_eq!(proof.not_looked_at, ["stem of ball 1", "spindle nose", "table"]);
}

#[test]
fn a_scan_reaches_its_points_in_order_at_its_feed_and_dwells() {
    let plan = looking(|_| {});
    let place = |reason| matches!(reason, RefusalReason::WrongScanPoint(_));
    assert!(place(refused(&plan, "X0 F60", "X0.01 F60")));
    assert!(place(refused(&plan, "N0 G53 G1 X0 F60\n", "")));
    assert!(place(refused(&plan, "N0 G53 G1 X5 F60\n", "N0 G53 G1 X0 F60\n")));
    let feed = |reason| matches!(reason, RefusalReason::WrongFeed { .. });
    assert!(feed(refused(&plan, "X0 F60", "X0 F61")));
    assert!(feed(refused(&plan, "F1500", "F1501")));
    let unfinished = |reason| matches!(reason, RefusalReason::IncompleteStep(_));
    assert!(unfinished(refused(&plan, "N0 G4 P0.5\nN0 G53 G1 X5", "N0 G4 P0.4\nN0 G53 G1 X5")));
    assert!(unfinished(refused(&plan, "N0 G53 G1 X5 F60\nN0 G4 P0.5\n", "")));
    assert!(unfinished(refused(&plan, "X5 F60\nN0 G4 P0.5\n", "X5 F60\n")));
    let off = |reason| matches!(reason, RefusalReason::OffScanPath);
    assert!(off(refused(&plan, "N0 G53 G1 X0 F60", "N0 G53 G0 Z200\nN0 G53 G1 X0 F60")));
    assert!(off(refused(&plan, "X5 F60\nN0 G4 P0.5\n", "X5 F60\nN0 G4 P0.5\nN0 G53 G1 X0 F60\n")));
    let probes = |reason| matches!(reason, RefusalReason::ProbeInScan);
    assert!(probes(refused(&plan, "N0 G53 G1 Z161 F1500", "N0 G38.3 Z161 F1500")));
    let limit = |reason| matches!(reason, RefusalReason::OutsideLimits { axis: Axis::X, .. });
    assert!(limit(refused(&plan, "X0 F60", "X301 F60")));
}

#[test]
fn the_sensor_body_keeps_the_margin_on_its_whole_path() {
    // A post beside the ball, 30 + 2 mm from the end of the sensor axis' path at X = 5.
    let with_post = |x: f64| {
        looking(|plan| {
            plan["solids"] = json!([{"name": "post", "on": "table", "from_mm": [x, -5.0, -50.0],
                "to_mm": [x + 10.0, 5.0, 70.0]}]);
        })
    };
    let from_left = beside().with(Axis::X, -100.0);
    proven_from(&with_post(37.01), WHOLE, Some(&from_left)).unwrap();
    let refusal = proven_from(&with_post(36.9), WHOLE, Some(&from_left)).unwrap_err();
    assert!(matches!(refusal.reason, RefusalReason::ClearanceTooSmall { .. }), "{refusal}");
    assert_eq!(refusal.line, 10, "the line to the last point: {refusal}");
    // Without a declared body, it is not checked, and the proof reports this.
    let bare = looking(|plan| plan["sensors"][0]["body_radius_mm"] = 0.0.into());
    let proof = proven_from(&bare, WHOLE, Some(&beside())).unwrap();
    assert!(proof.not_looked_at.contains(&"body of laser".to_owned()), "{proof:?}");
}

/// The same three points without a rest, then back to the middle.
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
    let rests = |reason| matches!(reason, RefusalReason::DwellInContinuousScan);
    assert!(rests(refused("N0 G53 G1 X5", "N0 G4 P0.5\nN0 G53 G1 X5")));
    assert!(rests(refused("N0 G53 G1 X0 F60", "N0 G4 P0.001\nN0 G53 G1 X0 F60")));
    let last = "X5 F60\nN0 G53 G1 X0 F60\n";
    assert!(rests(refused(last, "X5 F60\nN0 G53 G1 X0 F60\nN0 G4 P0.5\n")));
    let place = |reason| matches!(reason, RefusalReason::WrongScanPoint(_));
    assert!(place(refused("X0 F60", "X0.01 F60")));
    assert!(place(refused("N0 G53 G1 X0 F60\n", "")));
    assert!(place(refused("X0 F60", "X0 Y0.1 F60")));
    let feed = |reason| matches!(reason, RefusalReason::WrongFeed { .. });
    assert!(feed(refused("X5 F60", "X5 F59")));
    assert!(feed(refused("X5 F60", "X5 F180")));
    assert!(matches!(refused(last, "X5 F60\n"), RefusalReason::IncompleteStep(_)));
    let off = |reason| matches!(reason, RefusalReason::OffScanPath);
    assert!(off(refused("N0 G53 G1 X5", "N0 G53 G0 X1\nN0 G53 G1 X5")));
    assert!(off(refused(last, "X5 F60\nN0 G53 G1 X0 F60\nN0 G53 G1 X5 F60\n")));
    assert!(off(refused("N0 G53 G1 X5 F60", "N0 G38.3 X5 F60")));
}

/// A nest of three sensors at 120°, 35.26° below its centre at Z = 60, for a ball of 11 mm radius: their bodies are
/// 1.5 mm from the ball, and 0.5 mm at the near end of their range.
fn nest(at_x: f64, change: impl FnOnce(&mut Value)) -> Plan {
    plan(|plan| {
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

const IN_NEST: &str = "N0 G53 G1 Z450 F60\nN0 G53 G1 X0 F60\nN0 G53 G1 Z190 F60\nN0 G53 G1 Z180 F60\n\
                       N0 G4 P0.5\nN0 G53 G1 X0.1 F60\nN0 G4 P0.5\nN0 G53 G1 X0 Z179.9 F60\nN0 G4 P0.5\n\
                       N0 G53 G1 Z180 F60\nN0 G4 P0.5\nN0 G53 G1 C120 F60\nN0 G4 P0.5\n\
                       N0 G53 G1 C240 F60\nN0 G4 P0.5\nN0 G53 G1 C360 F60\nN0 G4 P0.5\n";

#[track_caller]
fn nest_refused(plan: &Plan, from: &str, to: &str) -> ProofRefusal {
    assert!(IN_NEST.contains(from), "{from}");
    let text = IN_NEST.replacen(from, to, 1);
    proven_as(plan, &text, Some(&beside()), ConfirmedDirections::default()).unwrap_err()
}

#[test]
fn the_ball_in_a_nest_moves_and_the_table_turns_about_it() {
    let plan = nest(0.0, |_| {});
    for confirmed in [ConfirmedDirections::default(), ConfirmedDirections::all()] {
        let proof = proven_as(&plan, IN_NEST, Some(&beside()), confirmed).unwrap();
        assert_eq!((proof.motions, proof.steps.len()), (17, 1));
        // The gap of 1.5 mm, minus the approach: the ball moves 0.1 mm along X towards the sensor, of which the cos
        // 35.26° part counts, or down, of which the sin 35.26° part counts.
        let nearest = proof.nearest.unwrap();
        assert_eq!(nearest.between, ["stylus ball", "n0"]);
        let expected = 1.5 - 0.1 * (2.0_f64 / 3.0).sqrt();
        assert!((nearest.clearance_mm - expected).abs() < 0.03, "{nearest:?}");
        assert_eq!(proof.not_looked_at, ["spindle nose", "table"]);
    }
}

#[test]
fn between_the_sensors_the_ball_moves_slowly() {
    let plan = nest(0.0, |_| {});
    let near = |refusal: ProofRefusal| matches!(refusal.reason, RefusalReason::ClearanceTooSmall { .. });
    let feed = |refusal: ProofRefusal| matches!(refusal.reason, RefusalReason::WrongFeed { .. });
    // A hold must stop within 0.5 mm: at most 98 mm/min.
    assert!(feed(nest_refused(&plan, "Z180 F60", "Z180 F120")));
    let fast = nest(0.0, |plan| plan["steps"][0]["feed_mm_min"] = 120.0.into());
    assert!(feed(nest_refused(&fast, "X0.1 F60", "X0.1 F120")));
    assert!(near(nest_refused(&plan, "Z190 F60", "Z180.5 F1000")));
    // The ball leaves a nest slowly, not by a rapid.
    let in_nest = beside().with(Axis::X, 0.0).with(Axis::Z, 180.0);
    let from_nest = |feed: &str| {
        let text = IN_NEST.replacen("Z450 F60", &format!("Z450 F{feed}"), 1);
        proven_as(&plan, &text.replacen("N0 G53 G1 X0 F60\n", "", 1), Some(&in_nest), ConfirmedDirections::all())
    };
    from_nest("60").unwrap();
    assert!(near(from_nest("1000").unwrap_err()));
    let text = IN_NEST.replacen("N0 G53 G1 Z450 F60", "N0 G53 G0 Z450", 1);
    assert!(near(proven_from(&plan, &text, Some(&in_nest)).unwrap_err()));
}

#[test]
fn a_ball_beside_the_nest_and_a_solid_in_the_way_are_refused() {
    // 5 mm along X move the ball nearer to one sensor by 5 mm · cos 35.26°, more than its gap.
    for at_x in [-5.0, 5.0, -1.4] {
        let refusal = nest_refused(&nest(at_x, |_| {}), "N0 G53 G1 Z450", "N0 G53 G1 Z450");
        let RefusalReason::ClearanceTooSmall { between: [one, other], min_clearance_mm, .. } = &refusal.reason else {
            panic!("{refusal}")
        };
        assert_eq!((one.as_str(), *min_clearance_mm), ("stylus ball", 0.5), "{other}");
    }
    // Gap 1.5 mm − 1.1 mm · cos 35.26° = 0.6 mm, without the moves by 0.1 mm.
    let off = nest(-1.1, |plan| {
        let step = &mut plan["steps"][0];
        step["path"] = json!([step["from"]]);
        step["to"] = step["from"].clone();
    });
    let (way_down, _) = IN_NEST.split_once("N0 G53 G1 X0.1").unwrap();
    proven_as(&off, way_down, Some(&beside()), ConfirmedDirections::default()).unwrap();
    let post = |x: f64| {
        nest(0.0, |plan| {
            plan["solids"] = json!([{"name": "post", "on": "table", "from_mm": [x, -5.0, 0.0],
                "to_mm": [x + 10.0, 5.0, 150.0]}]);
        })
    };
    let prove_programs = |x: f64| proven_as(&post(x), IN_NEST, Some(&beside()), ConfirmedDirections::default());
    // The probe's body, 30 mm in radius, is 60 mm above the centre of the ball: it is beside the post from 120 mm
    // on.
    prove_programs(32.3).unwrap();
    let refusal = prove_programs(31.9).unwrap_err();
    assert!(
        matches!(&refusal.reason, RefusalReason::ClearanceTooSmall { between, .. } if between.contains(&"post".to_owned())),
        "{refusal}"
    );
}
