//! Proofs for artefacts of several balls, in cases whose clearances are computed by hand.

use serde_json::{Value, json};

use super::tests::{plan_from_json, position_beside_part, prove_lines_from};
use super::*;

/// Stylus ball of 3 mm radius on a stem of 1 mm radius; the probe body, 20 mm in radius, is 100 mm above it. Ball
/// 1, of 10 mm radius, is 60 mm above the origin, ball 2 is beside it; each on a stem of 4 mm radius, with an
/// uncertainty of 0.5 mm. The step touches ball 1 from +X, where the stylus ball meets it at 13 mm.
fn two_ball_plan_json() -> Value {
    let linear = json!({"min": -300.0, "max": 300.0, "acceleration_per_s2": 1000.0});
    let rotary = json!({"min": -360.0, "max": 360.0});
    let at = |x: f64| json!({"X": x, "Y": 0.0, "Z": 180.0, "B": 0.0, "C": 0.0});
    json!({
        "trued_plan": 1, "method": "test", "settings": {},
        "machine": {"name": "test", "topology": "w-C-B-F-Y-X-Z-t", "tool_mm": [0.0, 0.0, -120.0],
            "axes": {"X": linear, "Y": linear, "Z": linear, "B": rotary, "C": rotary}},
        "probe": {"ball_radius_mm": 3.0, "overtravel_mm": 4.0, "search_feed_mm_min": 300.0,
            "guarded_feed_mm_min": 1500.0, "stem_radius_mm": 1.0, "stem_length_mm": 100.0,
            "body_radius_mm": 20.0, "body_length_mm": 20.0},
        "artefact": {"kind": "balls", "uncertainty_mm": 0.5,
            "balls": [ball_json("1", [0.0, 0.0, 60.0]), ball_json("2", [60.0, 0.0, 60.0])]},
        "steps": [{"id": 0, "stage": 0, "kind": "touch", "label": "t", "from": at(15.0),
            "to": at(11.0), "feed_mm_min": 30.0, "sensor": "probe", "normal": [1.0, 0.0, 0.0]}],
    })
}

fn two_ball_plan(change: impl FnOnce(&mut Value)) -> Plan {
    plan_from_json(two_ball_plan_json(), change)
}

fn ball_json(id: &str, centre: [f64; 3]) -> Value {
    json!({"id": id, "centre_mm": centre, "radius_mm": 10.0, "stem_radius_mm": 4.0,
        "stem_length_mm": 60.0})
}

/// Plan with a third ball, 100 mm beside ball 1 in Y, which `change` modifies.
fn plan_with_third_ball(change: impl FnOnce(&mut Value)) -> Plan {
    two_ball_plan(|plan| {
        let mut third = ball_json("3", [0.0, 100.0, 60.0]);
        change(&mut third);
        plan["artefact"]["balls"].as_array_mut().unwrap().push(third);
    })
}

/// Plan with the touch from one X to another, and its program.
fn touch_plan_and_program(from: f64, to: f64) -> (Plan, String) {
    let lines = format!(
        "N0 G53 G0 X{from}\nN0 G38.3 Z180 F1500\nN0 G38.3 X{to} F30\nN0 G53 G1 X{from} F300\n\
         N0 G38.3 Z300 F1500\n"
    );
    let plan = two_ball_plan(|plan| {
        plan["steps"][0]["from"]["X"] = from.into();
        plan["steps"][0]["to"]["X"] = to.into();
    });
    (plan, lines)
}

/// Proves the standard touch, from X 15 to X 11, with this plan.
fn prove_plan(plan: &Plan) -> Result<StageProof, ProofRefusal> {
    prove_lines_from(plan, &touch_plan_and_program(15.0, 11.0).1, Some(&position_beside_part()))
}

#[track_caller]
fn assert_refused_as_too_near(plan: &Plan, line: usize, pair: [&str; 2]) -> String {
    let refusal = prove_plan(plan).unwrap_err();
    match &refusal.reason {
        RefusalReason::ClearanceTooSmall { between, .. } => assert_eq!(between, &pair, "{refusal}"),
        _ => panic!("{refusal}"),
    }
    assert_eq!(refusal.line, line, "{refusal}");
    refusal.to_string()
}

/// Line of the guarded move down beside ball 1; three lines that set modes come before the program.
const DESCENT_LINE: usize = 5;
/// Line of the touch.
const TOUCH_LINE: usize = 6;

#[test]
fn a_touch_of_one_ball_among_others_is_proven() {
    let proof = prove_plan(&two_ball_plan(|_| {})).unwrap();
    // At contact, the distance of the stylus stem is the stylus ball's radius minus its own radius. The ball moves
    // on by 0.1 mm of pre-travel, and by the amount that a ball 0.5 mm aside allows: 13 − √(13² − 0.5²) = 0.01 mm.
    let nearest = proof.nearest.unwrap();
    assert_eq!(nearest.between, ["stylus stem", "ball 1"]);
    assert!((nearest.clearance_mm - 1.88).abs() < 0.04, "{nearest:?}");
    assert_eq!(nearest.line, TOUCH_LINE);
    assert_eq!(proof.unchecked_items, ["spindle nose", "table"]);
    let bare = two_ball_plan(|plan| plan["artefact"]["balls"][1]["stem_radius_mm"] = 0.0.into());
    let told = prove_plan(&bare).unwrap().unchecked_items;
    assert_eq!(told, ["stem of ball 2", "spindle nose", "table"]);
}

#[test]
fn touch_that_can_miss_or_meets_the_wrong_side_is_refused() {
    let result = |(plan, lines): (Plan, String)| prove_lines_from(&plan, &lines, Some(&position_beside_part()));
    // Limit of the end: contact at 13 mm minus the uncertainty of 0.5 mm.
    assert!(result(touch_plan_and_program(15.0, 12.49)).is_ok());
    let refusal = result(touch_plan_and_program(15.0, 12.51)).unwrap_err();
    let body = "ball 1".to_owned();
    assert_eq!(refusal.line, TOUCH_LINE);
    assert_eq!(refusal.reason, RefusalReason::TouchCanMiss { body: body.clone(), uncertainty: 0.5 });
    assert_eq!(result(touch_plan_and_program(17.0, 13.01)).unwrap_err().reason, RefusalReason::TouchWithoutContact);
    // Limit of the start: contact at 13 mm plus the uncertainty of 0.5 mm.
    assert!(result(touch_plan_and_program(13.51, 11.0)).is_ok());
    let refusal = result(touch_plan_and_program(13.49, 11.0)).unwrap_err();
    assert_eq!(refusal.line, DESCENT_LINE, "{refusal}");
    let normal = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        prove_plan(&two_ball_plan(|plan| plan["steps"][0]["normal"] = json!([cos, 0.0, sin])))
    };
    assert!(normal(24.0).is_ok());
    match normal(180.0).unwrap_err().reason {
        RefusalReason::WrongContactSide { body: found, off_deg: off } if found == body => {
            assert!((off - 180.0).abs() < 1e-6)
        }
        other => panic!("{other}"),
    }
    assert!(matches!(normal(26.0).unwrap_err().reason, RefusalReason::WrongContactSide { .. }));
    // A plan without a touch direction.
    let none = two_ball_plan(|plan| plan["steps"][0]["normal"] = json!([0.0, 0.0, 0.0]));
    assert!(matches!(prove_plan(&none).unwrap_err().reason, RefusalReason::WrongContactSide { .. }));
}

/// The touch must avoid the other balls and stems: its full length stays half a millimetre, plus their uncertainty,
/// away from them.
#[test]
fn a_touch_stays_clear_of_other_balls_and_stems() {
    let at = |y: f64| plan_with_third_ball(|third| third["centre_mm"] = json!([13.0, y, 60.0]));
    // Limit: the radii (10 + 3 mm), the uncertainty (0.5 mm) and the clearance (0.5 mm).
    assert!(prove_plan(&at(14.01)).is_ok());
    let said = assert_refused_as_too_near(&at(13.99), TOUCH_LINE, ["stylus ball", "ball 3"]);
    assert!(said.contains("does not detect this contact: 0.50 mm"), "{said}");
    // The probe detects contact during the approach at X = 15, which keeps only the uncertainty:
    // √(2² + 13.3²) < 10 + 3 + 0.5.
    assert_refused_as_too_near(&at(13.3), DESCENT_LINE, ["stylus ball", "ball 3"]);
    // A horizontal stem that ends 3 + 0.5 + 0.5 mm before the line of the touch.
    let lying = |length: f64| {
        plan_with_third_ball(|third| {
            third["centre_mm"] = json!([13.0, 40.0, 60.0]);
            third["stem"] = json!([0.0, -1.0, 0.0]);
            third["stem_length_mm"] = length.into();
        })
    };
    assert!(prove_plan(&lying(35.99)).is_ok());
    assert_refused_as_too_near(&lying(36.01), TOUCH_LINE, ["stylus ball", "stem of ball 3"]);
}

/// The stem of the touched ball moves with the ball: contact stops the stylus ball before the stem.
#[test]
fn the_stem_of_the_touched_ball_is_checked_up_to_contact() {
    let thick = |radius: f64| two_ball_plan(|plan| plan["artefact"]["balls"][0]["stem_radius_mm"] = radius.into());
    // Limit of the stem's radius: 13 − 0.11 − 3 mm at contact, not 11 − 3 mm at the end of the touch.
    assert!(prove_plan(&thick(9.8)).is_ok());
    assert_refused_as_too_near(&thick(9.95), TOUCH_LINE, ["stylus ball", "stem of ball 1"]);
}

/// Parts whose contact the probe does not detect stay 0.5 mm away from balls, as from everything else.
#[test]
fn the_probe_body_keeps_its_clearance_from_balls() {
    let high = |y: f64| plan_with_third_ball(|third| third["centre_mm"] = json!([15.0, y, 170.0]));
    // Limit: the radii (20 + 10 mm), the uncertainty (0.5 mm) and the clearance (0.5 mm).
    assert!(prove_plan(&high(31.01)).is_ok());
    assert_refused_as_too_near(&high(30.99), DESCENT_LINE, ["probe body", "ball 3"]);
}

#[test]
fn guarded_paths_round_a_ball_are_free_and_through_one_are_not() {
    let go = |more: &str| {
        let lines = touch_plan_and_program(15.0, 11.0).1.replacen("N0 G38.3 Z300", &format!("{more}N0 G38.3 Z300"), 1);
        prove_lines_from(&two_ball_plan(|_| {}), &lines, Some(&position_beside_part()))
    };
    // Round the ball at the height of the touch, and over its top: 60 + 10 + 3 + 0.5 for the tip, plus 120 for Z.
    assert!(go("N0 G38.3 Y15 F1500\nN0 G38.3 X-15 F1500\nN0 G38.3 Y0 F1500\n").is_ok());
    assert!(go("N0 G38.3 Z193.51 F1500\nN0 G38.3 X-15 F1500\n").is_ok());
    let line = |more: &str| {
        let refusal = go(more).unwrap_err();
        assert!(matches!(refusal.reason, RefusalReason::ClearanceTooSmall { .. }), "{refusal}");
        refusal.line
    };
    assert_eq!(line("N0 G38.3 Z193.49 F1500\nN0 G38.3 X-15 F1500\n"), 9);
    assert_eq!(line("N0 G38.3 X-15 F1500\n"), 8);
    // The stem is under the ball.
    assert_eq!(line("N0 G38.3 X20 F1500\nN0 G38.3 Z150 F1500\nN0 G38.3 X-20 F1500\n"), 10);
    // Rapids and turns are allowed only with the margin.
    assert_eq!(line("N0 G53 G0 X20\n"), 8);
    assert_eq!(line("N0 G53 G0 C5\n"), 8);
    assert_eq!(line("N0 G38.3 B1 F100\n"), 8);
}
