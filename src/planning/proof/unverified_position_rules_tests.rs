//! Handwritten programs for a machine whose position is not verified. Clearances as in `tests`: the part is 45 mm
//! in radius and 100 mm high, at Z 220 the stylus ball touches its top; Z ends at 450.

use super::tests::{cylinder_touch_plan, position_beside_part, prove_lines_with_touched_directions};
use super::*;
use machine::Axis;

/// Path from Z 300 beside the part, 50 mm from the start of the touch.
const UNVERIFIED_POSITION_TOUCH_PROGRAM: &str = "N0 G38.3 Z450 F1500\nN0 G38.3 X50 F1500\nN0 G38.3 Z250 F1500\nN0 G38.3 Z170 F300\n\
                       N0 G38.3 X47 F30\nN0 G53 G1 X50 F300\nN0 G38.3 Z250 F300\n";

#[track_caller]
fn refusal_reason(lines: &str) -> RefusalReason {
    prove_lines_with_touched_directions(
        &cylinder_touch_plan(|_| {}),
        lines,
        Some(&position_beside_part()),
        TouchedDirections::default(),
    )
    .unwrap_err()
    .reason
}

#[test]
fn unverified_position_allows_only_slow_z_below_its_upper_end() {
    let plan = cylinder_touch_plan(|_| {});
    assert!(
        prove_lines_with_touched_directions(
            &plan,
            UNVERIFIED_POSITION_TOUCH_PROGRAM,
            Some(&position_beside_part()),
            TouchedDirections::default()
        )
        .is_ok()
    );
    let low = UNVERIFIED_POSITION_TOUCH_PROGRAM.replace("Z450", "Z440");
    assert!(matches!(refusal_reason(&low), RefusalReason::SidewaysMoveBelowTopZ(_)), "{}", refusal_reason(&low));
    assert!(matches!(
        refusal_reason(UNVERIFIED_POSITION_TOUCH_PROGRAM.split_once('\n').unwrap().1),
        RefusalReason::SidewaysMoveBelowTopZ(_)
    ));
    for rapid in ["N0 G38.3 Z450 F1500", "N0 G38.3 X50 F1500", "N0 G38.3 Z250 F1500"] {
        let words = rapid.split_whitespace().find(|word| word.starts_with(['X', 'Z'])).unwrap();
        let lines = UNVERIFIED_POSITION_TOUCH_PROGRAM.replacen(rapid, &format!("N0 G53 G0 {words}"), 1);
        assert_eq!(refusal_reason(&lines), RefusalReason::RapidBeforePositionVerified);
    }
    // 1.5 mm beside the part, a guarded move must not be faster than a search.
    let fast = UNVERIFIED_POSITION_TOUCH_PROGRAM.replacen("Z170 F300", "Z170 F1500", 1);
    assert!(
        matches!(refusal_reason(&fast), RefusalReason::ClearanceTooSmall { min_clearance_mm, .. } if min_clearance_mm >= MIN_UNGUARDED_CLEARANCE_MM)
    );
}

/// 45 mm from the axis, 360°/s² are 283 mm/s²: to stop within 4 mm after 0.3 s of delay, the speed is at most
/// v = 283·(√(0.3² + 2·4/283) − 0.3) = 12.6 mm/s, or 963°/min.
#[test]
fn unverified_position_allows_slow_single_turns_at_the_upper_end_of_z() {
    let turning = cylinder_touch_plan(|plan| plan["machine"]["axes"]["C"]["acceleration_per_s2"] = 360.0.into());
    let to_zero = |turn: &str| {
        let from = position_beside_part().with(Axis::C, std::f64::consts::PI);
        let lines = UNVERIFIED_POSITION_TOUCH_PROGRAM.replacen("F1500\n", &format!("F1500\n{turn}\n"), 1);
        prove_lines_with_touched_directions(&turning, &lines, Some(&from), TouchedDirections::default())
    };
    let most = 283.0_f64 * ((0.09_f64 + 8.0 / 283.0).sqrt() - 0.3) / 45.0 * 57.3 * 60.0;
    assert!((900.0..1000.0).contains(&most), "{most}");
    to_zero(&format!("N0 G53 G1 C0 F{:.0}", most * 0.99)).unwrap();
    let refused = |turn: &str| to_zero(turn).unwrap_err().reason;
    let too_fast = refused(&format!("N0 G53 G1 C0 F{:.0}", most * 1.01));
    assert!(matches!(too_fast, RefusalReason::WrongFeed { motion_name: "the turn", .. }), "{too_fast}");
    assert_eq!(refused("N0 G53 G0 C0"), RefusalReason::RapidBeforePositionVerified);
    assert_eq!(refused("N0 G38.3 C0 F100"), RefusalReason::TurnBeforePositionVerified);
    assert_eq!(refused("N0 G53 G1 B0 C0 F100"), RefusalReason::UnexpectedFeedMove);
    let low = "N0 G53 G1 C0 F100\n".to_owned() + UNVERIFIED_POSITION_TOUCH_PROGRAM;
    let from = position_beside_part().with(Axis::C, std::f64::consts::PI);
    let refusal =
        prove_lines_with_touched_directions(&turning, &low, Some(&from), TouchedDirections::default()).unwrap_err();
    assert!(matches!(refusal.reason, RefusalReason::SidewaysMoveBelowTopZ(_)), "{refusal}");
}

/// LinuxCNC refuses probing moves of less than 0.254 mm.
#[test]
fn feed_move_may_replace_a_too_short_probing_move() {
    let short = UNVERIFIED_POSITION_TOUCH_PROGRAM.replacen("X50 F1500", "X50.2 F1500\nN0 G53 G1 X50 F300", 1);
    let plan = cylinder_touch_plan(|_| {});
    assert!(
        prove_lines_with_touched_directions(&plan, &short, Some(&position_beside_part()), TouchedDirections::default())
            .is_ok()
    );
    // The machine is already at X50, within the last digit of the text.
    let stays = UNVERIFIED_POSITION_TOUCH_PROGRAM.replacen("X50 F1500", "X50 F1500\nN0 G53 G1 X50 F300", 1);
    assert!(
        prove_lines_with_touched_directions(&plan, &stays, Some(&position_beside_part()), TouchedDirections::default())
            .is_ok()
    );
    let long = short.replacen("X50.2", "X50.4", 1);
    assert_eq!(refusal_reason(&long), RefusalReason::UnexpectedFeedMove);
    let fast = short.replacen("G1 X50 F300", "G1 X50 F400", 1);
    assert!(matches!(refusal_reason(&fast), RefusalReason::WrongFeed { motion_name: "the short move", .. }));
}

/// Touches along X, Y and Z verify the position; touches along three normals of which two are opposite do not.
#[test]
fn touches_along_three_independent_normals_verify_the_position() {
    let plan = cylinder_touch_plan(|_| {});
    let after = |normals: &[[f64; 3]]| {
        let touched = |before: TouchedDirections, normal: &[f64; 3]| {
            let mut step = plan.steps[0].clone();
            step.normal = *normal;
            before.after_step(&step)
        };
        normals.iter().fold(TouchedDirections::default(), touched)
    };
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
    assert!(
        after(&[x, y, z]).has_three_independent_directions() && after(&[x, x, y, z]).has_three_independent_directions()
    );
    assert!(!after(&[x, y]).has_three_independent_directions());
    assert!(!after(&[x, y, [-1.0, 0.0, 0.0], [0.6, 0.8, 0.0]]).has_three_independent_directions());
    assert!(!after(&[x, y, [0.0, 0.995, 0.1]]).has_three_independent_directions(), "6 degrees");
    let at_an_elevation = [0.0, 0.8, 0.6];
    assert!(after(&[x, y, at_an_elevation]).has_three_independent_directions());
    let mut prompt = plan.steps[0].clone();
    prompt.kind = machine::record::plan::StepKind::Prompt;
    assert!(!after(&[x, y, z]).after_step(&prompt).has_three_independent_directions());
}
