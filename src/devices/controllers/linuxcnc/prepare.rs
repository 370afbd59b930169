//! Conditions that LinuxCNC must meet before a measurement. Nothing here moves the machine.

use super::kinematics::KinematicsMode;
use crate::controllers::ControllerError;
use machine::Axis;

/// Number of values of a work offset slot: X, Y, Z, A, B, C and the rotation.
const OFFSET_SLOT_VALUE_COUNT: usize = 7;
/// Parameters of the slot G59.3: the offsets and the rotation.
pub(super) const OFFSET_SLOT_PARAMETERS: &str = "#5381 #5382 #5383 #5384 #5385 #5386 #5390";

/// Returns the program that reads the state: slot G59.3, whether a tool
/// length offset is active (`#<_tool_offset>`; #5401 to #5409 hold the table's entry of the loaded tool
/// instead), whether programs can read HAL pins, and the mode of switchable kinematics.
pub(super) fn state_query_program(log: &str) -> String {
    format!(
        "%\n(trued reads the state; nothing moves)\n\
         #<pins> = EXISTS[#<_hal[motion.probe-input]>]\n#<kinematics> = -1\n\
         o<kinematics> if [EXISTS[#<_hal[motion.switchkins-type]>]]\n\
         #<kinematics> = #<_hal[motion.switchkins-type]>\no<kinematics> endif\n\
         (LOGOPEN,{log})\n\
         (LOG,state #<_vmajor> #<_spindle_on> {OFFSET_SLOT_PARAMETERS} #<_tool_offset> #<pins> #<kinematics>)\n(LOG,END)\n(LOGCLOSE)\n%\n"
    )
}

/// LinuxCNC's version and kinematics mode, from the log line `state`. The other values of the line are only checked.
#[derive(Debug, PartialEq)]
pub(super) struct VersionAndKinematics {
    pub version: f64,
    pub kinematics: KinematicsMode,
}

/// Checks the numbers of the log line `state` for a machine with `axes`; returns those that are used later.
pub(super) fn check_state_values(state: &[f64], axes: &[Axis]) -> Result<VersionAndKinematics, ControllerError> {
    let [version, spindle, slot @ .., tool_offset, pins, kinematics] = state else {
        return Err(ControllerError::UnreadableReply { text: format!("state {state:?}") });
    };
    if *spindle != 0.0 {
        return Err(ControllerError::not_ready("the spindle is on", "stop the spindle: the stylus must not rotate"));
    }
    check_offset_slot(slot, axes)?;
    if *tool_offset != 0.0 {
        return Err(ControllerError::not_ready(
            "a tool length offset is active",
            "enter G49; the length of the stylus is tool_mm in the machine file",
        ));
    }
    let kinematics = match (*pins != 0.0, *kinematics) {
        (false, _) => KinematicsMode::NotReadable,
        (true, number) if number < 0.0 => KinematicsMode::NotSwitchable,
        (true, number) => KinematicsMode::SwitchkinsType(number),
    };
    Ok(VersionAndKinematics { version: *version, kinematics })
}

/// Checks that the values of [`OFFSET_SLOT_PARAMETERS`] are zero.
pub(super) fn check_offset_slot(slot: &[f64], axes: &[Axis]) -> Result<(), ControllerError> {
    if slot.len() != OFFSET_SLOT_VALUE_COUNT {
        return Err(ControllerError::UnreadableReply { text: format!("offsets of G59.3 {slot:?}") });
    }
    if slot.iter().all(|offset| *offset == 0.0) {
        return Ok(());
    }
    Err(ControllerError::not_ready(
        "the work offset slot G59.3 is not zero",
        format!(
            "trued uses G59.3 and requires zero offsets there: move your offset to another slot, then enter {}",
            clear_offset_command(axes)
        ),
    ))
}

/// Returns the line that sets G59.3 to zero. LinuxCNC refuses the whole line if it names an axis that the
/// machine does not have.
pub(super) fn clear_offset_command(axes: &[Axis]) -> String {
    let axes = axes.iter().filter(|axis| **axis != Axis::S);
    let words: String = axes.map(|axis| format!("{axis}0 ")).collect();
    format!("G10 L2 P9 {words}R0")
}

/// Checks emergency stop, power and homing, as linuxcncrsh reports them, of a machine with `axes`;
/// `joint_count` is the number of its joints, if known.
pub(super) fn check_estop_power_and_homing(
    estop: &str,
    machine: &str,
    homed: &str,
    axes: &[Axis],
    joint_count: Option<usize>,
) -> Result<(), ControllerError> {
    if estop != "OFF" {
        return Err(ControllerError::not_ready(
            "the emergency stop is pressed",
            "release the emergency stop at the machine",
        ));
    }
    if machine != "ON" {
        return Err(ControllerError::not_ready("the machine is off", "switch the machine on at the control"));
    }
    let homed: Vec<&str> = homed.split_whitespace().collect();
    let axes = axes.iter().filter(|axis| **axis != Axis::S).count();
    // linuxcncrsh (2.9) lists one joint too many.
    let joint_count = joint_count.unwrap_or(homed.len().saturating_sub(1)).max(axes);
    match (0..joint_count).find(|joint| homed.get(*joint) != Some(&"YES")) {
        None => Ok(()),
        Some(joint) => {
            Err(ControllerError::not_ready(format!("joint {joint} is not homed"), "home all joints at the control"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C];

    #[test]
    fn each_unmet_requirement_is_reported() {
        let clean = [2.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let reported = VersionAndKinematics { version: 2.9, kinematics: KinematicsMode::SwitchkinsType(0.0) };
        assert_eq!(check_state_values(&clean, &AXES).unwrap(), reported);
        for (at, named) in [(1, "spindle"), (2, "G59.3"), (8, "G59.3"), (9, "tool")] {
            let mut state = clean;
            state[at] = 1.0;
            let error = check_state_values(&state, &AXES).unwrap_err().to_string();
            assert!(error.contains(named), "{at}: {error}");
        }
        assert!(check_state_values(&clean[..11], &AXES).is_err());
    }

    #[test]
    fn unreadable_pins_are_distinguished_from_kinematics_without_modes() {
        for (pins, number, expected) in [
            (0.0, -1.0, KinematicsMode::NotReadable),
            (1.0, -1.0, KinematicsMode::NotSwitchable),
            (1.0, 1.0, KinematicsMode::SwitchkinsType(1.0)),
        ] {
            let state = [2.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, pins, number];
            assert_eq!(check_state_values(&state, &AXES).unwrap().kinematics, expected);
        }
    }

    #[test]
    fn offset_clearing_line_names_the_axes_of_the_machine() {
        let axes = [&AXES[..], &[Axis::S]].concat();
        assert_eq!(clear_offset_command(&axes), "G10 L2 P9 X0 Y0 Z0 B0 C0 R0");
    }

    #[test]
    fn unhomed_joint_is_reported() {
        let judge = |homed, joints| check_estop_power_and_homing("OFF", "ON", homed, &AXES, joints);
        assert!(judge("YES YES YES YES YES NO", None).is_ok());
        assert!(judge("YES YES YES YES YES NO", Some(5)).is_ok());
        let error = judge("YES YES NO YES YES NO", None).unwrap_err().to_string();
        assert!(error.contains("joint 2"), "{error}");
        // A gantry has more joints than axes.
        assert!(judge("YES YES YES YES YES NO NO", None).is_err());
        assert!(judge("YES YES YES YES YES NO", Some(6)).is_err());
        assert!(judge("YES YES", None).is_err());
        assert!(check_estop_power_and_homing("ON", "ON", "YES", &AXES[..1], None).is_err());
        assert!(check_estop_power_and_homing("OFF", "OFF", "YES", &AXES[..1], None).is_err());
    }
}
