//! Where the machine stands at a point, when the control shows it in coarse steps.

use machine::{Axis, Position};

/// Controls that show positions in steps show thousandths, mm and degrees.
const STEP: f64 = 1e-3;
/// Of a step: so near it, beside binary rounding, lies what is shown in steps.
const SAME: f64 = 1e-6;
/// Of a step: half of it, and what the written command was rounded by.
const NEAR: f64 = 0.56;

/// `told` by the control, but for the axes of which it says just what was commanded, rounded: there the
/// command knows more. An axis that is told to stand elsewhere stands elsewhere.
pub(super) fn unrounded(told: &Position, commanded: &Position) -> Position {
    let finer = |(axis, at): (Axis, f64)| {
        let steps = axis.to_edge(at) / STEP;
        let coarse = (steps - steps.round()).abs() < SAME;
        let near = |meant: &f64| coarse && (axis.to_edge(*meant) / STEP - steps).abs() < NEAR;
        (axis, commanded.get(axis).filter(near).unwrap_or(at))
    };
    told.iter().map(finer).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, b_deg: f64) -> Position {
        let linear = Position::new().with(Axis::X, x).with(Axis::Y, y);
        linear.with(Axis::B, Axis::B.from_edge(b_deg))
    }

    #[test]
    fn a_command_is_taken_where_the_control_shows_it_rounded_and_nowhere_else() {
        let commanded = at(12.3456, -0.0004, 33.3333);
        assert_eq!(unrounded(&at(12.346, 0.0, 33.333), &commanded), commanded);
        // Written with four decimals first.
        let twice = at(219.830_499_9, 0.0, 0.0);
        assert_eq!(unrounded(&at(219.831, 0.0, 0.0), &twice), twice);
        // One step of the display off: it stands there.
        let off = at(12.345, -0.001, 33.334);
        assert_eq!(unrounded(&off, &commanded), off);
        // A control that shows more is believed.
        let fine = at(12.345_61, -0.000_41, 33.333_31);
        assert_eq!(unrounded(&fine, &commanded), fine);
        // What was not commanded is as it is told.
        let told = at(12.346, 0.0, 33.333).with(Axis::Z, 7.001);
        assert_eq!(unrounded(&told, &commanded).at(Axis::Z), 7.001);
    }
}
