//! Position of the machine at rest at a commanded point, for a control that rounds its reported positions.

use machine::{Axis, Position};

/// Step of the position display of a control that rounds, mm or degrees.
const CONTROL_DISPLAY_STEP_MM_OR_DEG: f64 = 1e-3;
/// Maximum distance of a displayed value from a multiple of the display step, in display steps: the error of binary
/// rounding. A value that is farther off has more decimals than the display, and is not a rounded command.
const ROUNDING_TOLERANCE_DISPLAY_STEPS: f64 = 1e-6;
/// Maximum difference of a displayed value from the commanded one, in display steps: half a step plus the rounding of
/// the written command.
const MAX_COMMAND_DIFFERENCE_DISPLAY_STEPS: f64 = 0.56;

/// The position `displayed` by the control. If the value of an axis is the rounded command, the command replaces it,
/// as it is more precise. Any other value is kept.
pub(super) fn undo_control_rounding(displayed: &Position, commanded: &Position) -> Position {
    let finer = |(axis, at): (Axis, f64)| {
        let steps = axis.to_mm_or_deg(at) / CONTROL_DISPLAY_STEP_MM_OR_DEG;
        let coarse = (steps - steps.round()).abs() < ROUNDING_TOLERANCE_DISPLAY_STEPS;
        let near = |meant: &f64| {
            coarse
                && (axis.to_mm_or_deg(*meant) / CONTROL_DISPLAY_STEP_MM_OR_DEG - steps).abs()
                    < MAX_COMMAND_DIFFERENCE_DISPLAY_STEPS
        };
        (axis, commanded.get(axis).filter(near).unwrap_or(at))
    };
    displayed.iter().map(finer).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn position(x: f64, y: f64, b_deg: f64) -> Position {
        let linear = Position::new().with(Axis::X, x).with(Axis::Y, y);
        linear.with(Axis::B, Axis::B.to_mm_or_rad(b_deg))
    }

    #[test]
    fn commanded_position_is_used_only_where_the_display_is_its_rounding() {
        let commanded = position(12.3456, -0.0004, 33.3333);
        assert_eq!(undo_control_rounding(&position(12.346, 0.0, 33.333), &commanded), commanded);
        // Rounded twice: first the command was written with four decimals.
        let twice = position(219.830_499_9, 0.0, 0.0);
        assert_eq!(undo_control_rounding(&position(219.831, 0.0, 0.0), &twice), twice);
        // A value one display step off is kept.
        let off = position(12.345, -0.001, 33.334);
        assert_eq!(undo_control_rounding(&off, &commanded), off);
        // A value with more decimals than the display step is kept.
        let fine = position(12.345_61, -0.000_41, 33.333_31);
        assert_eq!(undo_control_rounding(&fine, &commanded), fine);
        // An axis without a command keeps its value.
        let told = position(12.346, 0.0, 33.333).with(Axis::Z, 7.001);
        assert_eq!(undo_control_rounding(&told, &commanded).get_or_zero(Axis::Z), 7.001);
    }
}
