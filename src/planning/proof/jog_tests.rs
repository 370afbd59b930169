//! A jog by its text, and with bodies whose distances are known by hand.

use super::jog::check_jog;
use super::tests::{beside, plan};
use super::{JogRequest, Reason};
use crate::gcode::Dialect;
use machine::record::plan::Plan;
use machine::record::proof::Clearance;
use machine::{Axis, Position};

fn proven(
    plan: &Plan,
    lines: &str,
    (axis, to): (Axis, f64),
    stands: &Position,
) -> Result<Option<Clearance>, Reason> {
    let dialect = Dialect::named("grbl").unwrap();
    let text = format!("G21 G90 G94 G61 G49 G92.1\nG10 L2 P6 X0 Y0 Z0 B0 C0\nG59\n{lines}\n");
    let to = axis.from_edge(to);
    let request = JogRequest { plan, stands, axis, to, feed_at_most: 60.0, dialect: &dialect };
    check_jog(&request, &[text]).map_err(|refusal| refusal.reason)
}

#[test]
fn a_jog_moves_its_axis_alone_slowly_and_guarded() {
    let plan = plan(|_| {});
    let x = |lines: &str| proven(&plan, lines, (Axis::X, 101.0), &beside());
    assert!(x("N1 G38.3 X101 F60").is_ok());
    assert_eq!(x("N1 G38.3 X101 Y1 F60"), Err(Reason::OtherAxis(Axis::Y)));
    assert_eq!(x("N1 G38.3 Y1 F60"), Err(Reason::OtherAxis(Axis::Y)));
    assert!(matches!(x("N1 G38.3 X102 F60"), Err(Reason::NotTo(_))));
    assert!(matches!(x("N1 G38.3 X101 F600"), Err(Reason::Feed { .. })));
    assert_eq!(x("N1 G53 G0 X101"), Err(Reason::NotGuarded));
    assert_eq!(x("N1 G53 G1 X101 F60"), Err(Reason::NotGuarded));
    assert_eq!(x(""), Err(Reason::NotOneMove(0)));
    assert_eq!(x("N1 G38.3 X101 F60\nN1 G38.3 X100 F60"), Err(Reason::NotOneMove(2)));
    assert!(matches!(x("G54\nN1 G38.3 X101 F60"), Err(Reason::Frame(_))));

    let far = proven(&plan, "N1 G38.3 X140 F60", (Axis::X, 140.0), &beside());
    assert_eq!(far, Err(Reason::LongJog { by: 40.0, most: 10.0 }));
    let beyond = proven(&plan, "N1 G38.3 X301 F60", (Axis::X, 301.0), &beside());
    assert!(matches!(beyond, Err(Reason::Limit { .. })));
    let turn = |lines: &str| proven(&plan, lines, (Axis::C, 1.0), &beside());
    assert!(turn("N1 G53 G1 C1 F60").is_ok());
    assert_eq!(turn("N1 G53 G0 C1"), Err(Reason::NotGuarded), "C has no clamp");
}

#[test]
fn nothing_may_be_near_whichever_axis_moves_in_truth() {
    let plan = plan(|_| {});
    // Ball of radius 3 beside a part of radius 45, known to 1 mm, at half its height.
    let at = |x: f64| beside().with(Axis::X, x).with(Axis::Z, 170.0);
    // 1 mm away from the part; but its motor may turn the other way: 54 - 1 - 45 - 3 - 1.
    let clear = proven(&plan, "N1 G38.3 X55 F60", (Axis::X, 55.0), &at(54.0)).unwrap().unwrap();
    assert!((clear.clearance_mm - 4.0).abs() < 0.05, "{clear:?}");
    let away = |x: f64| {
        let line = format!("N1 G38.3 X{} F60", x + 1.0);
        proven(&plan, &line, (Axis::X, x + 1.0), &at(x))
    };
    assert!(away(52.1).is_ok());
    assert!(matches!(away(51.9), Err(Reason::Near { .. })));
    // A jog of Y, along the flank, may be one of X.
    let y = |x: f64| proven(&plan, "N1 G38.3 Y1 F60", (Axis::Y, 1.0), &at(x));
    assert!(y(52.1).is_ok());
    assert!(matches!(y(51.9), Err(Reason::Near { .. })));
    // Where an axis stands that nobody knows, nothing can be shown.
    let blind = at(54.0).only(|axis| axis != Axis::B);
    let unknown = proven(&plan, "N1 G38.3 X55 F60", (Axis::X, 55.0), &blind);
    assert_eq!(unknown, Err(Reason::Unknown(Axis::B)));
}
