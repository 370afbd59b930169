//! State of the machine, as linuxcncrsh reports it at a standstill.

use super::rsh::RshClient;
use crate::controllers::ControllerError;
use crate::finite_numbers::parse_finite_numbers;
use machine::{Axis, Position};

/// Order of the positions in the answers of linuxcncrsh, whatever axes the machine has.
const REPORTED_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Smallest difference between an axis and its joint, in the control's units, that counts as a deviation: the last
/// printed decimal may differ.
const POSITION_EQUALITY_TOLERANCE: f64 = 0.000_002;

/// Reads the actual positions of `axes` in machine coordinates; converts them to mm and rad. An angular unit other than
/// degrees is an error.
pub(super) async fn read_position(rsh: &mut RshClient, axes: &[Axis]) -> Result<Position, ControllerError> {
    let mm = read_length_unit_mm(rsh).await?;
    match rsh.get("user_angular_units").await?.as_str() {
        "DEG" => {}
        other => return Err(unsupported_units_error(other)),
    }
    let values = read_numbers(rsh, "abs_act_pos").await?;
    let scaled = REPORTED_AXES.into_iter().zip(values).map(|(axis, at)| {
        let at = if axis.is_linear() { at * mm } else { at };
        (axis, axis.to_mm_or_rad(at))
    });
    Ok(scaled.filter(|(axis, _)| axes.contains(axis)).collect())
}

/// Unit of length of the control in mm: 1, 10 or 25.4.
pub(super) async fn read_length_unit_mm(rsh: &mut RshClient) -> Result<f64, ControllerError> {
    match rsh.get("user_linear_units").await?.as_str() {
        "MM" => Ok(1.0),
        "CM" => Ok(10.0),
        "INCH" => Ok(25.4),
        other => Err(unsupported_units_error(other)),
    }
}

fn unsupported_units_error(unit: &str) -> ControllerError {
    let state = format!("the configuration of LinuxCNC uses the unit `{unit}`");
    ControllerError::not_ready(&state, "use mm or inch and degrees: LINEAR_UNITS and ANGULAR_UNITS of the INI file")
}

/// Checks that each axis is at the position of its joint: switchable kinematics must be in identity mode. A deviation
/// shows only while rotary axes are away from zero, so the check is repeated.
pub(super) async fn check_identity_kinematics(rsh: &mut RshClient, axes: &[Axis]) -> Result<(), ControllerError> {
    let values = read_numbers(rsh, "abs_act_pos").await?;
    let joints = read_numbers(rsh, "joint_pos").await?;
    let axes = REPORTED_AXES.iter().zip(values).filter(|(axis, _)| axes.contains(axis));
    if is_subsequence(axes.map(|(_, at)| at), &joints) {
        return Ok(());
    }
    Err(ControllerError::not_ready(
        "the positions of axes and joints differ: the kinematics compensate the rotary axes",
        "switch the kinematics to identity (in LinuxCNC's five-axis samples: M429), then start again",
    ))
}

/// Whether `axes` are found among `joints` in their order; a gantry has more joints in between.
fn is_subsequence(axes: impl Iterator<Item = f64>, joints: &[f64]) -> bool {
    let mut joints = joints.iter();
    axes.into_iter().all(|axis| joints.any(|joint| (axis - joint).abs() < POSITION_EQUALITY_TOLERANCE))
}

/// Checks that the feed override is 100 %: the touching speed determines how late a contact is detected.
pub(super) async fn check_feed_override(rsh: &mut RshClient) -> Result<(), ControllerError> {
    let percent = rsh.get("feed_override").await?;
    if percent == "100" {
        return Ok(());
    }
    let state = format!("the feed override is {percent} %");
    Err(ControllerError::not_ready(
        &state,
        "set the feed override to 100 %: another speed changes the detection delay of a contact",
    ))
}

/// Checks that the program status is `IDLE`; any other status is refused, a paused program too.
pub(super) async fn check_no_program_runs(rsh: &mut RshClient) -> Result<(), ControllerError> {
    match rsh.get("program_status").await?.as_str() {
        "IDLE" => Ok(()),
        _ => Err(ControllerError::not_ready(
            "a program is running",
            "wait until the program ends, or stop it, then start again",
        )),
    }
}

/// Checks that a run will execute this program, and not one that another client has opened meanwhile.
pub(super) async fn check_open_program(rsh: &mut RshClient, program: &str) -> Result<(), ControllerError> {
    let open = rsh.get("program").await?;
    if open == program {
        return Ok(());
    }
    let state = format!("another program is open at the control: {open}");
    Err(ControllerError::not_ready(&state, "do not use the control during a measurement; start again"))
}

/// Reads the numbers that linuxcncrsh returns for `key`, in the control's units; fewer numbers than `REPORTED_AXES`
/// has axes are an error.
pub(super) async fn read_numbers(rsh: &mut RshClient, key: &str) -> Result<Vec<f64>, ControllerError> {
    parse_numbers(&rsh.get(key).await?)
}

/// Parses the numbers of an answer; fewer numbers than [`REPORTED_AXES`] has axes are an error.
pub(super) fn parse_numbers(values: &str) -> Result<Vec<f64>, ControllerError> {
    let numbers = parse_finite_numbers(values.split_whitespace());
    let numbers = numbers.filter(|numbers| numbers.len() >= REPORTED_AXES.len());
    numbers.ok_or_else(|| ControllerError::UnreadableReply { text: values.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_positions_are_found_among_joint_positions_in_order() {
        let axes = [1.0, 2.0, 3.0];
        assert!(is_subsequence(axes.into_iter(), &[1.0, 2.0, 3.0, 0.0]));
        assert!(is_subsequence(axes.into_iter(), &[1.0, 2.0, 2.0, 3.0]));
        assert!(!is_subsequence(axes.into_iter(), &[1.0, 3.0, 2.0, 0.0]));
        assert!(!is_subsequence(axes.into_iter(), &[1.0, 2.0, 3.000_01]));
    }
}
