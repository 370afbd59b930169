//! State of the machine, as linuxcncrsh reports it at a standstill.

use super::not_ready::not_ready;
use super::rsh::Rsh;
use crate::controllers::ControllerError;
use machine::{Axis, Position};

/// Order of the positions in the answers of linuxcncrsh, whatever axes the machine has.
const REPORTED: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Largest difference between an axis and its joint that counts as equal: the last printed decimal may
/// differ.
const SAME: f64 = 0.000_002;

/// Reads the positions of `axes`.
pub(super) async fn stands(rsh: &mut Rsh, axes: &[Axis]) -> Result<Position, ControllerError> {
    let mm = unit_mm(rsh).await?;
    match rsh.get("user_angular_units").await?.as_str() {
        "DEG" => {}
        other => return Err(strange_units(other)),
    }
    let said = numbers(rsh, "abs_act_pos").await?;
    let scaled = REPORTED.into_iter().zip(said).map(|(axis, at)| {
        let at = if axis.is_linear() { at * mm } else { at };
        (axis, axis.from_edge(at))
    });
    Ok(scaled.filter(|(axis, _)| axes.contains(axis)).collect())
}

/// Unit of length of the control, mm.
pub(super) async fn unit_mm(rsh: &mut Rsh) -> Result<f64, ControllerError> {
    match rsh.get("user_linear_units").await?.as_str() {
        "MM" => Ok(1.0),
        "CM" => Ok(10.0),
        "INCH" => Ok(25.4),
        other => Err(strange_units(other)),
    }
}

fn strange_units(unit: &str) -> ControllerError {
    let state = format!("its configuration counts in `{unit}`");
    not_ready(&state, "use mm or inch and degrees: LINEAR_UNITS and ANGULAR_UNITS of the INI file")
}

/// Checks that each axis is where its joint is, as switchable kinematics must be in identity mode. A
/// deviation shows only while rotary axes are away from zero, so the check is repeated.
pub(super) async fn axes_are_joints(rsh: &mut Rsh, axes: &[Axis]) -> Result<(), ControllerError> {
    let said = numbers(rsh, "abs_act_pos").await?;
    let joints = numbers(rsh, "joint_pos").await?;
    let axes = REPORTED.iter().zip(said).filter(|(axis, _)| axes.contains(axis));
    if each_follows(axes.map(|(_, at)| at), &joints) {
        return Ok(());
    }
    Err(not_ready(
        "the axes do not stand where their joints stand: its kinematics compensate the rotary axes",
        "switch the kinematics to identity (in LinuxCNC's five-axis samples: M429), then start again",
    ))
}

/// Whether `axes` are found among `joints` in their order; a gantry has more joints in between.
fn each_follows(axes: impl Iterator<Item = f64>, joints: &[f64]) -> bool {
    let mut joints = joints.iter();
    axes.into_iter().all(|axis| joints.any(|joint| (axis - joint).abs() < SAME))
}

/// Checks that the feed override is 100 %: the touching speed determines how late a contact is detected.
pub(super) async fn full_speed(rsh: &mut Rsh) -> Result<(), ControllerError> {
    let percent = rsh.get("feed_override").await?;
    if percent == "100" {
        return Ok(());
    }
    let state = format!("the feed override stands at {percent} %");
    Err(not_ready(&state, "set it to 100 %: a contact is seen later at another speed"))
}

/// Checks that a run will execute this program, and not one that another client has opened meanwhile.
pub(super) async fn opened(rsh: &mut Rsh, program: &str) -> Result<(), ControllerError> {
    let open = rsh.get("program").await?;
    if open == program {
        return Ok(());
    }
    let state = format!("another program is open at the control: {open}");
    Err(not_ready(&state, "leave the control to trued while it measures, then start again"))
}

pub(super) async fn numbers(rsh: &mut Rsh, key: &str) -> Result<Vec<f64>, ControllerError> {
    reported(&rsh.get(key).await?)
}

/// Parses the numbers of an answer, one for each axis that may be reported.
pub(super) fn reported(said: &str) -> Result<Vec<f64>, ControllerError> {
    let numbers: Result<Vec<f64>, _> = said.split_whitespace().map(str::parse).collect();
    let are_whole = |numbers: &Vec<f64>| {
        numbers.len() >= REPORTED.len() && numbers.iter().all(|number| number.is_finite())
    };
    let numbers = numbers.ok().filter(are_whole);
    numbers.ok_or_else(|| ControllerError::Garbled { text: said.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_found_among_the_joints_in_their_order() {
        let axes = [1.0, 2.0, 3.0];
        assert!(each_follows(axes.into_iter(), &[1.0, 2.0, 3.0, 0.0]));
        assert!(each_follows(axes.into_iter(), &[1.0, 2.0, 2.0, 3.0]));
        assert!(!each_follows(axes.into_iter(), &[1.0, 3.0, 2.0, 0.0]));
        assert!(!each_follows(axes.into_iter(), &[1.0, 2.0, 3.000_01]));
    }
}
