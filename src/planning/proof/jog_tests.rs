//! Proofs of a jog: its text, and bodies whose distances are computed by hand.

use super::jog::check_single_move;
use super::tests::{cylinder_touch_plan, position_beside_part};
use super::{RefusalReason, SingleMoveKind, SingleMoveProofRequest};
use crate::gcode::Dialect;
use machine::record::plan::Plan;
use machine::record::stage_proof::Clearance;
use machine::{Axis, Position};

type MinClearanceResult = Result<Option<Clearance>, RefusalReason>;

fn prove_jog_lines(plan: &Plan, lines: &str, target: (Axis, f64), position: &Position) -> MinClearanceResult {
    check_lines(plan, lines, target, position, SingleMoveKind::Jog)
}

fn prove_retract_lines(plan: &Plan, lines: &str, target: (Axis, f64), position: &Position) -> MinClearanceResult {
    check_lines(plan, lines, target, position, SingleMoveKind::Retract)
}

/// Checks `lines` after lines that set the modes and zero the offset of the slot G59. `to`: mm or degrees.
fn check_lines(
    plan: &Plan,
    lines: &str,
    (axis, to): (Axis, f64),
    position: &Position,
    kind: SingleMoveKind,
) -> MinClearanceResult {
    let dialect = Dialect::from_name("grbl").unwrap();
    let text = format!("G21 G90 G94 G61 G49 G92.1\nG10 L2 P6 X0 Y0 Z0 B0 C0\nG59\n{lines}\n");
    let to = axis.to_mm_or_rad(to);
    let request = SingleMoveProofRequest {
        kind,
        plan,
        start_position: position,
        axis,
        target_mm_or_rad: to,
        max_feed_mm_or_deg_per_min: 60.0,
        dialect: &dialect,
    };
    check_single_move(&request, &[text]).map_err(|refusal| refusal.reason)
}

#[test]
fn a_jog_moves_its_axis_alone_slowly_and_guarded() {
    let plan = cylinder_touch_plan(|_| {});
    let x = |lines: &str| prove_jog_lines(&plan, lines, (Axis::X, 101.0), &position_beside_part());
    assert!(x("N1 G38.3 X101 F60").is_ok());
    assert_eq!(x("N1 G38.3 X101 Y1 F60"), Err(RefusalReason::MovesUnrequestedAxis(Axis::Y)));
    assert_eq!(x("N1 G38.3 Y1 F60"), Err(RefusalReason::MovesUnrequestedAxis(Axis::Y)));
    assert!(matches!(x("N1 G38.3 X102 F60"), Err(RefusalReason::WrongTarget(_))));
    assert!(matches!(x("N1 G38.3 X101 F600"), Err(RefusalReason::WrongFeed { .. })));
    assert_eq!(x("N1 G53 G0 X101"), Err(RefusalReason::UnguardedJog));
    assert_eq!(x("N1 G53 G1 X101 F60"), Err(RefusalReason::UnguardedJog));
    assert_eq!(x(""), Err(RefusalReason::MotionCountIsNotOne(0)));
    assert_eq!(x("N1 G38.3 X101 F60\nN1 G38.3 X100 F60"), Err(RefusalReason::MotionCountIsNotOne(2)));
    assert!(matches!(x("G54\nN1 G38.3 X101 F60"), Err(RefusalReason::MotionInWorkFrame(_))));

    let far = prove_jog_lines(&plan, "N1 G38.3 X140 F60", (Axis::X, 140.0), &position_beside_part());
    assert_eq!(far, Err(RefusalReason::MoveTooLong { length: 40.0, limit: 10.0 }));
    let beyond = prove_jog_lines(&plan, "N1 G38.3 X301 F60", (Axis::X, 301.0), &position_beside_part());
    assert!(matches!(beyond, Err(RefusalReason::OutsideLimits { .. })));
    let turn = |lines: &str| prove_jog_lines(&plan, lines, (Axis::C, 1.0), &position_beside_part());
    assert!(turn("N1 G53 G1 C1 F60").is_ok());
    assert_eq!(turn("N1 G53 G0 C1"), Err(RefusalReason::UnguardedJog), "C has no clamp");
}

#[test]
fn a_jog_is_checked_for_every_axis_that_may_move() {
    let plan = cylinder_touch_plan(|_| {});
    // Ball of radius 3 beside a part of radius 45, with an uncertainty of 1 mm, at half its height.
    let at = |x: f64| position_beside_part().with(Axis::X, x).with(Axis::Z, 170.0);
    // 1 mm away from the part; but the motor may turn the other way: 54 - 1 - 45 - 3 - 1.
    let clear = prove_jog_lines(&plan, "N1 G38.3 X55 F60", (Axis::X, 55.0), &at(54.0)).unwrap().unwrap();
    assert!((clear.clearance_mm - 4.0).abs() < 0.05, "{clear:?}");
    let away = |x: f64| {
        let line = format!("N1 G38.3 X{} F60", x + 1.0);
        prove_jog_lines(&plan, &line, (Axis::X, x + 1.0), &at(x))
    };
    assert!(away(52.1).is_ok());
    assert!(matches!(away(51.9), Err(RefusalReason::ClearanceTooSmall { .. })));
    // A jog of Y, along the flank, may in fact move X.
    let y = |x: f64| prove_jog_lines(&plan, "N1 G38.3 Y1 F60", (Axis::Y, 1.0), &at(x));
    assert!(y(52.1).is_ok());
    assert!(matches!(y(51.9), Err(RefusalReason::ClearanceTooSmall { .. })));
    // If the position of an axis is unknown, nothing can be proven.
    let blind = at(54.0).filter_axes(|axis| axis != Axis::B);
    let unknown = prove_jog_lines(&plan, "N1 G38.3 X55 F60", (Axis::X, 55.0), &blind);
    assert_eq!(unknown, Err(RefusalReason::UnknownAxisPosition(Axis::B)));
}

#[test]
fn a_retract_is_one_short_slow_feed_move_of_one_linear_axis() {
    let plan = cylinder_touch_plan(|_| {});
    let z = |lines: &str, to: f64| prove_retract_lines(&plan, lines, (Axis::Z, to), &position_beside_part());
    assert!(z("N1 G53 G1 Z301 F60", 301.0).is_ok());
    assert!(z("N1 G53 G1 Z299 F60", 299.0).is_ok());
    assert_eq!(z("N1 G53 G1 X101 F60", 301.0), Err(RefusalReason::MovesUnrequestedAxis(Axis::X)));
    assert_eq!(z("N1 G53 G1 X101 Z301 F60", 301.0), Err(RefusalReason::MovesUnrequestedAxis(Axis::X)));
    assert!(
        matches!(z("N1 G53 G1 Z299 F60", 301.0), Err(RefusalReason::WrongTarget(_))),
        "a retract opposite to the requested direction is refused"
    );
    assert!(z("N1 G53 G1 Z302 F60", 302.0).is_ok());
    let long = z("N1 G53 G1 Z302.5 F60", 302.5);
    assert_eq!(long, Err(RefusalReason::MoveTooLong { length: 2.5, limit: 2.0 }));
    assert!(matches!(z("N1 G53 G1 Z301 F61", 301.0), Err(RefusalReason::WrongFeed { .. })));
    assert_eq!(z("N1 G53 G0 Z301", 301.0), Err(RefusalReason::InvalidRetract));
    assert_eq!(z("N1 G38.3 Z301 F60", 301.0), Err(RefusalReason::InvalidRetract));
    assert_eq!(z("", 301.0), Err(RefusalReason::MotionCountIsNotOne(0)));
    let twice = z("N1 G53 G1 Z301 F60\nN1 G53 G1 Z301 F60", 301.0);
    assert_eq!(twice, Err(RefusalReason::MotionCountIsNotOne(2)));
    assert!(z("N1 G1 Z301 F60\nG54", 301.0).is_ok(), "G59 holds zeros");
    assert!(matches!(z("G54\nN1 G1 Z301 F60", 301.0), Err(RefusalReason::MotionInWorkFrame(_))));

    let turn = prove_retract_lines(&plan, "N1 G53 G1 C1 F60", (Axis::C, 1.0), &position_beside_part());
    assert_eq!(turn, Err(RefusalReason::InvalidRetract));
    let top = position_beside_part().with(Axis::Z, 449.5);
    let beyond = prove_retract_lines(&plan, "N1 G53 G1 Z450.5 F60", (Axis::Z, 450.5), &top);
    assert!(matches!(beyond, Err(RefusalReason::OutsideLimits { .. })), "{beyond:?}");
    let slow_probe = super::tests::cylinder_touch_plan(|plan| plan["probe"]["search_feed_mm_min"] = 30.0.into());
    let fast = prove_retract_lines(&slow_probe, "N1 G53 G1 Z301 F60", (Axis::Z, 301.0), &position_beside_part());
    assert!(matches!(fast, Err(RefusalReason::WrongFeed { .. })), "{fast:?}");
}

#[test]
fn a_retract_approaches_no_declared_body() {
    let x = |plan: &Plan, from: f64, to: f64| {
        let position = position_beside_part().with(Axis::X, from).with(Axis::Z, 170.0);
        prove_retract_lines(plan, &format!("N1 G53 G1 X{to} F60"), (Axis::X, to), &position)
    };
    // Ball of radius 3 beside a part of radius 45, with an uncertainty of 1 mm: 0.5 mm apart at the assumed
    // position.
    let part = cylinder_touch_plan(|_| {});
    assert!(x(&part, 48.5, 49.5).is_ok());
    assert!(matches!(x(&part, 48.5, 47.5), Err(RefusalReason::ClearanceTooSmall { .. })));
    assert!(matches!(x(&part, 48.5, 48.0), Err(RefusalReason::ClearanceTooSmall { .. })));
    let along = position_beside_part().with(Axis::X, 48.5).with(Axis::Z, 170.0);
    assert!(prove_retract_lines(&part, "N1 G53 G1 Y1 F60", (Axis::Y, 1.0), &along).is_ok());
    // In the model the ball is inside the part, that is, in contact: either sense is accepted.
    assert!(x(&part, 47.0, 48.0).is_ok());
    // The proof assumes that the machine is at the start position: the ball is 100 - 3 - 45 mm away from the part.
    assert!(x(&part, 100.0, 99.0).is_ok());

    // A box with a face at X = 110: 3 mm for the ball, 2 mm for the margin.
    let boxed = cylinder_touch_plan(|plan| {
        plan["keepout"] = serde_json::json!([{"name": "clamp", "min_mm": [110.0, -5.0, 0.0],
            "max_mm": [130.0, 5.0, 200.0]}]);
    });
    assert!(x(&boxed, 103.9, 104.9).is_ok());
    let near = x(&boxed, 104.1, 105.1);
    let between = ["stylus ball", "clamp"].map(str::to_owned);
    assert!(matches!(near, Err(RefusalReason::ClearanceTooSmall { between: found, .. }) if found == between));
    // Nearer than the margin, the ball may keep its distance, and may leave.
    assert!(x(&boxed, 106.5, 105.5).is_ok());
    assert!(matches!(x(&boxed, 106.5, 106.6), Err(RefusalReason::ClearanceTooSmall { .. })));
    let beside_it = position_beside_part().with(Axis::X, 106.5).with(Axis::Z, 170.0);
    assert!(prove_retract_lines(&boxed, "N1 G53 G1 Z171 F60", (Axis::Z, 171.0), &beside_it).is_ok());
    let blind = beside_it.filter_axes(|axis| axis != Axis::B);
    let unknown = prove_retract_lines(&boxed, "N1 G53 G1 Z171 F60", (Axis::Z, 171.0), &blind);
    assert_eq!(unknown, Err(RefusalReason::UnknownAxisPosition(Axis::B)));
}
