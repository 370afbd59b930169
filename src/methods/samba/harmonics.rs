//! Error motions that the positions of a rotary axis cannot tell from its location errors.

use super::model::Model;
use crate::ball_measurement::tilts_table;
use machine::kinematics::Shape;
use machine::{Axis, Position};

/// Angles are compared in so many steps a degree.
const STEPS: i64 = 1000;
const TURN: i64 = 360 * STEPS;
/// Error motions of higher orders are small, and nobody asks for them.
const HIGHEST: i64 = 12;

/// An axis that only ever stands at steps of 360°/n shows its harmonics of the orders n, 2n, … always
/// at the same phase: they are constant, as its location errors are. `commanded`: rotary positions.
pub fn in_words(model: &Model, commanded: &[Position]) -> Vec<String> {
    let axes = model.chain().topology().axes().filter(|axis| !axis.is_linear());
    axes.filter_map(|axis| of_axis(model, commanded, axis)).collect()
}

fn of_axis(model: &Model, commanded: &[Position], axis: Axis) -> Option<String> {
    let own = model.parameters().iter();
    let own = own.filter(|error| error.axis() == axis && error.shape() == Shape::Location);
    let names: Vec<String> = own.map(ToString::to_string).collect();
    let step = step(commanded.iter().map(|position| axis.to_edge(position.at(axis))));
    let order = TURN / step;
    if names.is_empty() || !(2..=HIGHEST).contains(&order) {
        return None;
    }
    let key = match axis {
        Axis::S => "spindle_deg",
        _ if tilts_table(model.chain(), axis) => "tilt_deg",
        _ => "turn_deg",
    };
    Some(format!(
        "{axis} was measured in steps of {}° only: its error motions of the orders {order}, {}, … are \
         part of {} and cannot be told from them; other positions in {key} would",
        step as f64 / STEPS as f64,
        2 * order,
        names.join(", ")
    ))
}

/// The largest step, in parts of a degree, by which all angles lie apart on the circle.
fn step(degrees: impl Iterator<Item = f64>) -> i64 {
    let mut angles = degrees.map(|degrees| (degrees * STEPS as f64).round() as i64);
    let Some(first) = angles.next() else { return TURN };
    angles.fold(TURN, |step, angle| common_divisor(step, angle.abs_diff(first)))
}

fn common_divisor(a: i64, b: u64) -> i64 {
    let (mut a, mut b) = (a, i64::try_from(b).unwrap_or(0));
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_on_the_circle() {
        let of = |degrees: &[f64]| step(degrees.iter().copied()) as f64 / STEPS as f64;
        assert_eq!(of(&[0.0, 90.0, -90.0, 270.0, 360.0]), 90.0);
        assert_eq!(of(&[10.0, 100.0, 280.0]), 90.0);
        assert_eq!(of(&[0.0, 72.0, 144.0]), 72.0);
        assert_eq!(of(&[0.0, 180.0, 180.0]), 180.0);
        assert_eq!(of(&[-90.0, -60.0, -10.0, 0.0]), 10.0);
        assert_eq!((of(&[]), of(&[33.0])), (360.0, 360.0));
        assert_eq!(of(&[0.0, 90.000_000_1]), 90.0);
    }
}
