//! Names of geometric errors in plain words, from their ISO 230-1 symbols.

use crate::Axis;

/// Text for the error `symbol`: a location error (`EX0C`), the scale of a linear axis (`EXX1`), an error motion
/// (`EXC`), or the difference of two of them (`EYY1-EXX1`). `None` for other symbols.
///
/// In the symbols of ISO 230-1 the first letter is the direction of the error, and the last is the axis that has it. An
/// angular location error of a linear axis is its squareness.
pub fn geometric_error_name(symbol: &str) -> Option<String> {
    if let Some((minuend, subtrahend)) = symbol.split_once('-') {
        return Some(format!("{} minus {}", geometric_error_name(minuend)?, geometric_error_name(subtrahend)?));
    }
    let letters: Vec<char> = symbol.strip_prefix('E')?.chars().collect();
    let axis = |letter: char| letter.to_string().parse::<Axis>().ok();
    match letters.as_slice() {
        [direction, '0', of] => Some(location_error_name(axis(*direction)?, axis(*of)?)),
        [direction, of, '1'] => Some(gain_name(axis(*direction)?, axis(*of)?)),
        [direction, of] => Some(error_motion_name(axis(*direction)?, axis(*of)?)),
        _ => None,
    }
}

fn location_error_name(direction: Axis, axis: Axis) -> String {
    if direction.is_linear() {
        return format!("position of {} in {direction}", axis_name(axis));
    }
    match (third_direction(direction, axis), axis.is_linear()) {
        (None, _) => format!("zero position of {}", axis_name(axis)),
        (Some(third), true) => format!("squareness of {axis} to {third}"),
        (Some(_), false) => format!("orientation of {} about {}", axis_name(axis), direction_name(direction)),
    }
}

fn gain_name(direction: Axis, axis: Axis) -> String {
    if direction == axis { format!("scale of {axis}") } else { format!("slope of {axis} in {direction}") }
}

fn error_motion_name(direction: Axis, axis: Axis) -> String {
    let moving = axis_name(axis);
    match (direction.is_linear(), third_direction(direction, axis)) {
        (true, _) if axis.is_linear() && direction == axis => format!("positioning error of {moving}"),
        (true, _) if axis.is_linear() => format!("straightness of {moving} in {direction}"),
        (true, _) => format!("error motion of {moving} in {direction}"),
        (false, None) if axis.is_linear() => format!("roll of {moving}"),
        (false, None) => format!("angular positioning error of {moving}"),
        (false, Some(_)) => format!("tilt of {moving} about {}", direction_name(direction)),
    }
}

/// The linear axis that is perpendicular to `direction` and to `axis`; `None` if these are parallel.
fn third_direction(direction: Axis, axis: Axis) -> Option<Axis> {
    let normal = direction.nominal_direction().cross(&axis.nominal_direction());
    Axis::LINEAR.into_iter().find(|linear| normal.dot(&linear.nominal_direction()).abs() > 0.5)
}

/// The linear axis about which `direction` rotates.
fn direction_name(direction: Axis) -> &'static str {
    let about = direction.nominal_direction();
    Axis::LINEAR.into_iter().find(|linear| about.dot(&linear.nominal_direction()) > 0.5).map_or("", Axis::name)
}

fn axis_name(axis: Axis) -> &'static str {
    if axis == Axis::S { "the spindle" } else { axis.name() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_are_named_by_direction_and_axis() {
        for (symbol, name) in [
            ("EX0C", "position of C in X"),
            ("EA0C", "orientation of C about X"),
            ("EC0C", "zero position of C"),
            ("EB0B", "zero position of B"),
            ("EC0Y", "squareness of Y to X"),
            ("EB0Z", "squareness of Z to X"),
            ("EA0Z", "squareness of Z to Y"),
            ("EA0Y", "squareness of Y to Z"),
            ("EX0S", "position of the spindle in X"),
            ("EXX1", "scale of X"),
            ("EYX1", "slope of X in Y"),
            ("EYY1-EXX1", "scale of Y minus scale of X"),
            ("EXC", "error motion of C in X"),
            ("EAC", "tilt of C about X"),
            ("ECC", "angular positioning error of C"),
            ("EXX", "positioning error of X"),
            ("EYX", "straightness of X in Y"),
            ("EAX", "roll of X"),
        ] {
            assert_eq!(geometric_error_name(symbol).as_deref(), Some(name), "{symbol}");
        }
        for symbol in ["", "E", "E_radial", "tool_x", "EXC_c1", "EQ0C", "EX0"] {
            assert_eq!(geometric_error_name(symbol), None, "{symbol}");
        }
    }
}
