//! Proofs in cases whose clearances are computed by hand, with the text of a run.

use serde_json::{Value, json};

use super::*;
use machine::Axis;

/// Ball of 3 mm radius, 120 mm below the spindle datum; a part of radius 45 mm and 100 mm height around the origin,
/// with an uncertainty of 1 mm. The only step touches it from +X at half its height.
fn cylinder_touch_plan_json() -> Value {
    let linear = json!({"min": -300.0, "max": 300.0, "acceleration_per_s2": 1000.0});
    let height = json!({"min": -50.0, "max": 450.0, "acceleration_per_s2": 1000.0});
    let rotary = json!({"min": -360.0, "max": 360.0});
    let at = |x: f64| json!({"X": x, "Y": 0.0, "Z": 170.0, "B": 0.0, "C": 0.0});
    json!({
        "trued_plan": 1, "method": "test", "settings": {},
        "machine": {"name": "test", "topology": "w-C-B-F-Y-X-Z-t", "tool_mm": [0.0, 0.0, -120.0],
            "axes": {"X": linear, "Y": linear, "Z": height, "B": rotary, "C": rotary}},
        "probe": {"ball_radius_mm": 3.0, "overtravel_mm": 4.0, "search_feed_mm_min": 300.0,
            "guarded_feed_mm_min": 1500.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0],
            "radius_mm": 45.0, "height_mm": 100.0, "uncertainty_mm": 1.0},
        "steps": [{"id": 0, "stage": 0, "kind": "touch", "label": "t", "from": at(50.0),
            "to": at(47.0), "feed_mm_min": 30.0, "sensor": "probe", "normal": [1.0, 0.0, 0.0]}],
    })
}

pub(super) fn cylinder_touch_plan(change: impl FnOnce(&mut Value)) -> Plan {
    plan_from_json(cylinder_touch_plan_json(), change)
}

/// This function is compiled once for each `change`. The JSON value, which takes long to compile, is built elsewhere.
pub(super) fn plan_from_json(mut plan: Value, change: impl FnOnce(&mut Value)) -> Plan {
    change(&mut plan);
    serde_json::from_value(plan).unwrap()
}

/// A high position at the right of the part, rotary axes at zero.
pub(super) fn position_beside_part() -> Position {
    let axes = [(Axis::X, 100.0), (Axis::Y, 0.0), (Axis::Z, 300.0), (Axis::B, 0.0), (Axis::C, 0.0)];
    axes.into_iter().collect()
}

pub(super) fn prove_lines_from(
    plan: &Plan,
    lines: &str,
    position: Option<&Position>,
) -> Result<StageProof, ProofRefusal> {
    prove_lines_with_touched_directions(plan, lines, position, TouchedDirections::all())
}

pub(super) fn prove_lines_with_touched_directions(
    plan: &Plan,
    lines: &str,
    position: Option<&Position>,
    confirmed: TouchedDirections,
) -> Result<StageProof, ProofRefusal> {
    let dialect = Dialect::from_name("grbl").unwrap();
    let text = format!("G21 G90 G94 G61 G49 G92.1\nG10 L2 P6 X0 Y0 Z0 B0 C0\nG59\n{lines}");
    let stages = [StageSteps { step_ids: &[0], found_artefact: None }];
    let request = ProofRequest {
        plan,
        stages: &stages,
        start_position: position,
        touched_directions: confirmed,
        dialect: &dialect,
    };
    prove_programs(&request, &[text])
}

/// Reason for which the first lines are refused; `None` if the only fault is the missing touch.
#[track_caller]
fn refusal_reason(plan: &Plan, lines: &str) -> Option<RefusalReason> {
    let refusal = prove_lines_from(plan, lines, Some(&position_beside_part())).unwrap_err();
    assert!(!refusal.remedy().is_empty());
    match refusal.reason {
        RefusalReason::StepIncomplete(_) => None,
        reason => Some(reason),
    }
}

#[track_caller]
fn assert_refused_as_too_near(plan: &Plan, lines: &str, pair: [&str; 2], expected: f64) {
    match refusal_reason(plan, lines) {
        Some(RefusalReason::ClearanceTooSmall { between, clearance, .. }) => {
            assert_eq!(between, pair);
            // The first position found that is too near, not necessarily the nearest.
            assert!(clearance <= expected + 0.01, "{clearance}, not {expected}");
        }
        other => panic!("{other:?}"),
    }
}

const TOUCH_PROGRAM: &str = "N0 G53 G0 X50\nN0 G38.3 Z170 F1500\nN0 G38.3 X47 F30\nN0 G53 G1 X50 F300\n\
                     N0 G38.3 Z300 F1500\n";

#[test]
fn whole_touch_is_proven_with_hand_computed_nearest_pair() {
    let with_stem = cylinder_touch_plan(|plan| {
        plan["probe"]["stem_radius_mm"] = 1.0.into();
        plan["probe"]["stem_length_mm"] = 100.0.into();
        plan["probe"]["body_radius_mm"] = 20.0.into();
        plan["probe"]["body_length_mm"] = 20.0.into();
    });
    let proof = prove_lines_from(&with_stem, TOUCH_PROGRAM, Some(&position_beside_part())).unwrap();
    assert_eq!((proof.motion_count, proof.steps.len()), (5, 1));
    // At contact, the distance of the stem is the ball's radius minus its own radius. The ball moves on by 0.1 mm
    // of pre-travel, and by the amount that a part 1 mm aside allows: 48 − √(48² − 1) = 0.01 mm.
    let nearest = proof.nearest.unwrap();
    assert_eq!(nearest.between, ["stylus stem", "artefact"]);
    assert!((nearest.clearance_mm - 1.89).abs() < 0.03, "{nearest:?}");
    assert_eq!(nearest.line, 6, "the line of the touch");
    assert_eq!(proof.unchecked_items, ["spindle nose", "table"]);
    // A probe body 20 mm in radius, 40 mm above the ball, is beside the part, 3 − 20 mm into it.
    let short = cylinder_touch_plan(|plan| {
        plan["probe"]["stem_length_mm"] = 40.0.into();
        plan["probe"]["body_radius_mm"] = 20.0.into();
        plan["probe"]["body_length_mm"] = 20.0.into();
    });
    let refusal = prove_lines_from(&short, TOUCH_PROGRAM, Some(&position_beside_part())).unwrap_err();
    assert_eq!(refusal.line, 5, "{refusal}");
    let said = refusal.to_string();
    assert!(said.starts_with("step 0 (t), line 5: probe body would come within"), "{said}");
}

#[test]
fn rapids_keep_the_margin_from_a_box_and_guarded_moves_do_not_touch_it() {
    let with_box = |x: f64, top: f64| {
        cylinder_touch_plan(|plan| {
            plan["keepout"] = json!([{"name": "clamp", "min_mm": [x - 20.0, -5.0, 0.0],
                "max_mm": [x, 5.0, top]}]);
        })
    };
    // The ball centre passes at 180 mm, and its radius is 3 mm.
    let over = "N0 G53 G0 X-100\n";
    assert_eq!(refusal_reason(&with_box(-60.0, 174.99), over), None);
    assert_refused_as_too_near(&with_box(-60.0, 175.01), over, ["stylus ball", "clamp"], 1.99);
    let guarded = "N0 G38.3 X-100 F1500\n";
    assert_eq!(refusal_reason(&with_box(-60.0, 176.49), guarded), None);
    assert_refused_as_too_near(&with_box(-60.0, 176.51), guarded, ["stylus ball", "clamp"], 0.49);
    // Down beside the box: 100 − 3 − 2.
    assert_eq!(refusal_reason(&with_box(94.99, 200.0), "N0 G53 G0 Z200\n"), None);
    assert_refused_as_too_near(&with_box(95.01, 200.0), "N0 G53 G0 Z200\n", ["stylus ball", "clamp"], 1.99);
}

#[test]
fn rotary_motions_are_checked_between_their_ends() {
    // A post on the table, 10 mm square at X = −100, as high as the ball: a half turn of C moves it to the ball, a
    // quarter turn to ±Y.
    let post = |top: f64| {
        cylinder_touch_plan(|plan| {
            plan["solids"] = json!([{"name": "post", "on": "table", "from_mm": [-105.0, -5.0, 0.0],
                "to_mm": [-95.0, 5.0, top]}]);
        })
    };
    assert_eq!(refusal_reason(&post(200.0), "N0 G53 G0 C90\n"), None);
    assert_refused_as_too_near(&post(200.0), "N0 G53 G0 C180\n", ["stylus ball", "post"], 2.0);
    // Almost a full turn: the post passes the ball and is far away at the end.
    assert_refused_as_too_near(&post(200.0), "N0 G53 G0 C350\n", ["stylus ball", "post"], 2.0);
    // Limit of the height: 180 mm minus the ball's radius (3 mm) and the margin (2 mm).
    assert_eq!(refusal_reason(&post(174.9), "N0 G53 G0 C350\n"), None);
    // B turns the part about Y towards the ball at X = 100: its upper rim reaches √(100² + 45²) = 109.7 mm from the
    // axis. With a required 3 + 1 + 2 mm, this is 115.7 mm, at a height of 58.1 mm.
    let bare = cylinder_touch_plan(|_| {});
    assert_eq!(refusal_reason(&bare, "N0 G53 G0 Z178.5\nN0 G53 G0 B-90\n"), None);
    let low = "N0 G53 G0 Z177.5\nN0 G53 G0 B-90\n";
    assert_refused_as_too_near(&bare, low, ["stylus ball", "artefact"], 2.0);
    // Workpiece side against bed.
    let fenced = cylinder_touch_plan(|plan| {
        plan["solids"] = json!([
            {"name": "arm", "on": "B", "from_mm": [-200.0, -20.0, -20.0], "to_mm": [-150.0, 20.0, 0.0]},
            {"name": "column", "on": "bed", "from_mm": [-220.0, -20.0, -80.0],
             "to_mm": [-120.0, 20.0, -60.0]}]);
    });
    assert_eq!(refusal_reason(&fenced, "N0 G53 G0 B-5\n"), None);
    assert_refused_as_too_near(&fenced, "N0 G53 G0 B30\n", ["arm", "column"], 2.0);
}

#[test]
fn parts_above_the_stylus_ball_are_checked() {
    let nose = |lowest: f64| {
        cylinder_touch_plan(|plan| {
            plan["solids"] = json!([
                {"name": "nose", "on": "spindle", "from_mm": [0.0, 0.0, lowest],
                 "to_mm": [0.0, 0.0, 100.0], "radius_mm": 50.0},
                {"name": "pillar", "on": "bed", "from_mm": [140.0, -5.0, 0.0],
                 "to_mm": [150.0, 5.0, 290.0]}]);
        })
    };
    // The ball passes the pillar at 37 mm; the nose, 50 mm in radius, passes above it at 300 + lowest.
    assert_eq!(refusal_reason(&nose(-7.9), "N0 G53 G0 X99\n"), None);
    assert_refused_as_too_near(&nose(-8.1), "N0 G53 G0 X99\n", ["nose", "pillar"], 1.9);
}

#[test]
fn contact_must_occur_during_the_touch_and_not_at_its_start() {
    let far = TOUCH_PROGRAM.replace("X47", "X48.5").replace("X50", "X51");
    let reach = |from: f64, to: f64| {
        cylinder_touch_plan(|plan| {
            plan["steps"][0]["from"]["X"] = from.into();
            plan["steps"][0]["to"]["X"] = to.into();
        })
    };
    let refusal = prove_lines_from(&reach(51.0, 48.5), &far, Some(&position_beside_part())).unwrap_err();
    assert_eq!((refusal.line, refusal.reason), (6, RefusalReason::TouchWithoutContact));
    // The part may be 1 mm nearer: 48 + 1.
    let close = TOUCH_PROGRAM.replace("X50", "X48.9");
    let refusal = prove_lines_from(&reach(48.9, 47.0), &close, Some(&position_beside_part())).unwrap_err();
    assert_eq!(refusal.line, 5, "{refusal}");
    assert!(matches!(refusal.reason, RefusalReason::ClearanceTooSmall { .. }), "{refusal}");
    let close = TOUCH_PROGRAM.replace("X50", "X49.1");
    assert!(prove_lines_from(&reach(49.1, 47.0), &close, Some(&position_beside_part())).is_ok());
}

#[test]
fn moves_from_an_unknown_position_are_listed_as_unchecked() {
    let blind = "N0 G53 G0 Z300\nN0 G53 G0 B0 C0\nN0 G53 G0 X50 Y0\n";
    let text = TOUCH_PROGRAM.replacen("N0 G53 G0 X50\n", blind, 1);
    let proof = prove_lines_from(&cylinder_touch_plan(|_| {}), &text, None).unwrap();
    let told = "the path of lines 4 to 6, before the positions of all axes are known";
    assert_eq!(proof.unchecked_items.last().map(String::as_str), Some(told));
    // The same start, but known: inside the zone of the part. Nothing is skipped.
    let inside = position_beside_part().with(Axis::X, 48.0).with(Axis::Z, 150.0);
    let refusal = prove_lines_from(&cylinder_touch_plan(|_| {}), &text, Some(&inside)).unwrap_err();
    assert_eq!(refusal.line, 4);
    assert!(refusal.remedy().contains("by hand"), "{}", refusal.remedy());
    // A touch from an unknown position is refused.
    let refusal = prove_lines_from(&cylinder_touch_plan(|_| {}), "N0 G38.3 X47 Y0 Z170 F30\n", None).unwrap_err();
    assert_eq!((refusal.line, refusal.reason), (4, RefusalReason::UnknownAxisPosition(Axis::X)));
}

#[test]
fn feeds_must_let_the_machine_stop_within_the_overtravel() {
    // 90 mm/s against 1000 mm/s² is 4.05 mm.
    let fast = cylinder_touch_plan(|plan| plan["probe"]["guarded_feed_mm_min"] = 9000.0.into());
    match refusal_reason(&fast, "N0 G38.3 X120 F5400\n") {
        Some(RefusalReason::BrakingDistanceTooLong { distance_mm: way, .. }) => {
            assert!((way - 4.05).abs() < 1e-9)
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(refusal_reason(&fast, "N0 G38.3 X120 F5360\n"), None);
}

/// The ball was stopped 0.3 mm from a part with an uncertainty of 1 mm. A straight move up is allowed if it is
/// guarded and the first move; a move towards the part, an unguarded move, or a move from inside the part is
/// refused.
#[test]
fn a_machine_stopped_beside_the_part_may_rise() {
    let plan = cylinder_touch_plan(|_| {});
    let low = |x: f64| position_beside_part().updated_by(&[(Axis::X, x), (Axis::Z, 170.0)].into_iter().collect());
    let is_refused = |x: f64, lines: &str| {
        matches!(
            prove_lines_from(&plan, lines, Some(&low(x))).unwrap_err().reason,
            RefusalReason::ClearanceTooSmall { .. }
        )
    };
    assert!(!is_refused(48.3, "N0 G38.3 Z300 F1500\n"));
    assert!(is_refused(48.3, "N0 G53 G0 Z300\n"));
    assert!(is_refused(48.3, "N0 G38.3 X48.1 F1500\n"));
    assert!(is_refused(48.3, "N0 G38.3 Z171 F1500\nN0 G38.3 Z300 F1500\n"));
    assert!(is_refused(47.9, "N0 G38.3 Z300 F1500\n"));
}

/// B carries an arm at +X; above it, C carries the table with a clamp at −X.
#[test]
fn bodies_of_one_side_that_turn_relative_to_each_other_are_checked() {
    let carrying = |more: Value| {
        cylinder_touch_plan(|plan| {
            let mut solids = vec![
                json!({"name": "clamp", "on": "table", "from_mm": [-120.0, -5.0, 0.0],
                    "to_mm": [-100.0, 5.0, 40.0]}),
                json!({"name": "arm", "on": "B", "from_mm": [110.0, -10.0, 3.0],
                    "to_mm": [170.0, 10.0, 50.0]}),
            ];
            solids.extend(more.as_array().cloned().unwrap_or_default());
            plan["solids"] = solids.into();
        })
    };
    let bare = carrying(json!([]));
    assert_eq!(refusal_reason(&bare, "N0 G53 G0 C90\nN0 G53 G0 B20\n"), None);
    assert_refused_as_too_near(&bare, "N0 G53 G0 C180\n", ["clamp", "arm"], 2.0);
    assert_refused_as_too_near(&bare, "N0 G53 G0 B20 C350\n", ["clamp", "arm"], 2.0);
    // A table 1.9 mm above its cradle is built close, so it is reported; at 2.1 mm it is checked and passes.
    let on_cradle = |top: f64| {
        carrying(json!([
            {"name": "table", "on": "table", "from_mm": [0.0, 0.0, -40.0], "to_mm": [0.0, 0.0, 0.0],
             "radius_mm": 130.0},
            {"name": "cradle", "on": "B", "from_mm": [-150.0, -100.0, -90.0],
             "to_mm": [150.0, 100.0, top]}]))
    };
    let told = |top: f64| {
        let lines = format!("N0 G53 G0 C90\nN0 G53 G0 C0\n{TOUCH_PROGRAM}");
        let proof = prove_lines_from(&on_cradle(top), &lines, Some(&position_beside_part())).unwrap();
        proof.unchecked_items.into_iter().filter(|what| what.contains("against")).collect::<Vec<_>>()
    };
    let close = "table against cradle: nearer than 2 mm with all axes at zero";
    assert_eq!(told(-41.9), [close]);
    assert_eq!(told(-42.1), [""; 0]);
}

/// The spindle moves down past a rack on the X slide.
#[test]
fn bodies_of_the_tool_side_that_move_relative_to_each_other_are_checked() {
    let racked = cylinder_touch_plan(|plan| {
        plan["solids"] = json!([
            {"name": "nose", "on": "spindle", "from_mm": [0.0, 0.0, 0.0], "to_mm": [0.0, 0.0, 100.0],
             "radius_mm": 50.0},
            {"name": "rack", "on": "X", "from_mm": [20.0, -5.0, 110.0], "to_mm": [30.0, 5.0, 150.0]}]);
    });
    assert_eq!(refusal_reason(&racked, "N0 G53 G0 Z152.1\nN0 G53 G0 X110\n"), None);
    assert_refused_as_too_near(&racked, "N0 G53 G0 Z151.9\n", ["nose", "rack"], 2.0);
}

/// A ledge over the part: at the end of the touch, the stem would pass it at 46 mm minus its edge.
#[test]
fn a_touch_keeps_its_clearance_where_the_probe_detects_no_contact() {
    let ledge = |edge: f64| {
        cylinder_touch_plan(|plan| {
            plan["probe"]["stem_radius_mm"] = 1.0.into();
            plan["probe"]["stem_length_mm"] = 100.0.into();
            plan["keepout"] = json!([{"name": "ledge", "min_mm": [30.0, -5.0, 104.0],
                "max_mm": [edge, 5.0, 110.0]}]);
        })
    };
    assert!(prove_lines_from(&ledge(45.49), TOUCH_PROGRAM, Some(&position_beside_part())).is_ok());
    let refusal = prove_lines_from(&ledge(45.51), TOUCH_PROGRAM, Some(&position_beside_part())).unwrap_err();
    assert_eq!(refusal.line, 6, "{refusal}");
    assert!(refusal.to_string().contains("does not detect this contact: 0.50 mm"), "{refusal}");
}

/// Step 1 is a prompt; the touch comes after it.
#[test]
fn prompt_is_one_m0_and_makes_the_position_unknown() {
    let plan = cylinder_touch_plan(|plan| {
        let prompt = json!({"id": 1, "stage": 0, "kind": "prompt", "label": "ask/1", "from": {}, "to": {},
            "feed_mm_min": 0.0, "sensor": "", "normal": [0.0, 0.0, 0.0], "text": "clean it"});
        plan["steps"].as_array_mut().unwrap().push(prompt);
    });
    let dialect = Dialect::from_name("grbl").unwrap();
    let proven = |lines: &str| {
        let text = format!("G21 G90 G94 G61 G49 G92.1\nG10 L2 P6 X0 Y0 Z0 B0 C0\nG59\n{lines}");
        let start_position = position_beside_part();
        let request = ProofRequest {
            plan: &plan,
            stages: &[StageSteps { step_ids: &[1, 0], found_artefact: None }],
            start_position: Some(&start_position),
            touched_directions: TouchedDirections::all(),
            dialect: &dialect,
        };
        prove_programs(&request, &[text])
    };
    let slow = TOUCH_PROGRAM.split_once('\n').unwrap().1.replace("F1500", "F300");
    // After the stop, the position is unknown: the program must move all axes, with the careful rules.
    let up = "N0 G38.3 Z450 F1500\nN0 G53 G1 B0 F300\nN0 G53 G1 C0 F300\nN0 G38.3 X50 Y0 F1500\n";
    let proof = proven(&format!("N1 M0\n{up}{slow}")).unwrap();
    assert!(proof.unchecked_items.iter().any(|what| what.contains("all axes")), "{proof:?}");
    let reason = |lines: &str| proven(lines).unwrap_err().reason;
    assert!(matches!(reason(&format!("{up}{slow}")), RefusalReason::WrongStepOrder { expected: Some(1), .. }));
    assert_eq!(reason(&format!("N1 M0\n{TOUCH_PROGRAM}")), RefusalReason::RapidBeforePositionVerified);
    assert_eq!(reason(&format!("N1 M0\nN1 M0\n{up}{slow}")), RefusalReason::UnexpectedProgramStop);
    assert_eq!(reason(&format!("N1 M0\nN0 M0\n{up}{slow}")), RefusalReason::UnexpectedProgramStop);
    assert_eq!(reason(&format!("N1 G53 G0 Z300\nN1 M0\n{up}{slow}")), RefusalReason::MotionInPrompt);
}
