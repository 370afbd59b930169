//! Second runs after a correction: as predicted, and after a correction of the wrong sign.

use super::travel::TableOfX;
use super::*;

/// Of four comparisons.
const RATIO: f64 = 1.265;

fn compare(
    machine: &Machine,
    [first, second]: [&Estimate; 2],
    control: &ControlModel,
    before_mm: &[f64],
) -> Result<Vec<RemainingDeviation>, crate::MethodRefusal> {
    let [first, second] =
        [first, second].map(|estimate| MeasuredAxisPositions::new(machine, STATED, estimate).unwrap());
    compare_remaining_deviations(first, second, control, before_mm, RATIO)
}

fn estimate_of_c(um: [f64; 2], at_mm: [f64; 3]) -> Estimate {
    let mut estimate = estimate_of("self-calibration", &[("EX0C", um[0]), ("EY0C", um[1])], &[]);
    estimate.location_at_mm = Some(at_mm);
    estimate
}

/// Both runs agree in each case: only the prediction shows the wrong sign.
#[test]
fn position_of_the_wrong_sign_is_refuted_by_the_prediction() {
    let machine = trunnion(Axis::B);
    let runs = [estimate_of_c([50.0, -30.0], [0.0; 3]), estimate_of_c([50.6, -29.7], [0.0; 3])];
    let before = nominal_control(Axis::B);
    for (sign, is_confirmed) in [(1.0, true), (-1.0, false)] {
        let mut after = before;
        (after.pins.x_rot_point, after.pins.y_rot_point) = (0.05 * sign, -0.03 * sign);
        // B stays where it was.
        after.pins.offset -= after.pins.x_rot_point;
        let all = compare(&machine, [&runs[0], &runs[1]], &after.model(), &before.model().present_mm()).unwrap();
        assert_eq!(all.len(), 2, "B is not determined and has not changed: {all:?}");
        assert_eq!(all.iter().all(RemainingDeviation::is_within_limits), is_confirmed, "{sign}: {all:?}");
        let remaining_um = (all[0].measured_mm - 0.0506 + 0.05 * sign) * 1e3;
        assert!(remaining_um.abs() < 1e-9, "{all:?}");
    }
}

#[test]
fn positions_at_different_points_are_not_compared() {
    let machine = trunnion(Axis::B);
    let runs = [estimate_of_c([50.0, -30.0], [0.0; 3]), estimate_of_c([50.0, -30.0], [0.0, 0.0, 40.0])];
    let control = nominal_control(Axis::B).model();
    let refusal = compare(&machine, [&runs[0], &runs[1]], &control, &control.present_mm()).unwrap_err();
    assert!(refusal.reason.contains("at different points"), "{refusal:?}");
}

/// A scale of 100 µm/m, and what a calibrated length shows after the table was written.
#[test]
fn second_run_verifies_a_scale_and_refutes_its_wrong_sign() {
    let machine = trunnion(Axis::B);
    let first = estimate_of("samba", &[("EXX1", 100.0)], &[]);
    for (sign, is_confirmed) in [(1.0, true), (-1.0, false)] {
        let trims_mm = [0.03, -0.005, -0.03].map(|mm| mm * sign);
        let table = TableOfX { nominal_mm: [-300.0, 50.0, 300.0], trims_mm };
        let tool = |commanded: f64| table.motor(commanded) * 1.0001;
        let residual_um_per_m = ((tool(120.0) - tool(-80.0)) / 200.0 - 1.0) * 1e6;
        let second = estimate_of("samba", &[("EXX1", residual_um_per_m)], &[]);
        let all = compare(&machine, [&first, &second], &table.model(1.0), &[0.0; 6]).unwrap();
        assert_eq!(all.iter().all(RemainingDeviation::is_within_limits), is_confirmed, "{sign}: {all:?}");
        // Over 600 mm: nothing, or twice the error.
        let expected_mm = if is_confirmed { 0.0 } else { 0.12 };
        assert!((all[0].measured_mm - expected_mm).abs() < 1e-4, "{all:?}");
    }
}
