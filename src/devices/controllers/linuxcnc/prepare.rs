//! What must hold before a LinuxCNC may measure. Nothing here moves the machine.

use crate::controllers::ControllerError;

/// Looks at the state. Slot G59.3 (#5381 to #5386, rotation #5390) and tool length offset (#5401 to
/// #5403) as in LinuxCNC's table of numbered parameters.
pub(super) fn program(log: &str) -> String {
    format!(
        "%\n(trued looks at the state; nothing moves)\n(LOGOPEN,{log})\n\
         (LOG,state #<_vmajor> #<_spindle_on> #5381 #5382 #5383 #5384 #5385 #5386 #5390 \
         #5401 #5402 #5403)\n(LOG,END)\n(LOGCLOSE)\n%\n"
    )
}

/// Judge the numbers of the line `state`; the version.
pub(super) fn judge(state: &[f64]) -> Result<f64, ControllerError> {
    let [version, spindle, rest @ ..] = state else {
        return Err(ControllerError::Garbled { text: format!("state {state:?}") });
    };
    if rest.len() != 10 {
        return Err(ControllerError::Garbled { text: format!("state {state:?}") });
    }
    let (slot, tool) = rest.split_at(7);
    if *spindle != 0.0 {
        return Err(not_ready("the spindle is on", "stop the spindle: a stylus must not turn"));
    }
    if slot.iter().any(|offset| *offset != 0.0) {
        return Err(not_ready(
            "the work offset slot G59.3 is not zero",
            "trued works in G59.3 and writes nothing to it: move your offset to another slot, then \
             enter G10 L2 P9 X0 Y0 Z0 A0 B0 C0 R0",
        ));
    }
    if tool.iter().any(|offset| *offset != 0.0) {
        return Err(not_ready(
            "a tool length offset is active",
            "enter G49; the length of the stylus stands in the machine file (tool_mm)",
        ));
    }
    Ok(*version)
}

/// Judge what linuxcncrsh says of stop, power and homing; at least `joints` must be homed.
pub(super) fn judge_switches(
    estop: &str,
    machine: &str,
    homed: &str,
    joints: usize,
) -> Result<(), ControllerError> {
    if estop != "OFF" {
        return Err(not_ready("the emergency stop is pressed", "release it at the machine"));
    }
    if machine != "ON" {
        return Err(not_ready("the machine is off", "switch it on at the control"));
    }
    if homed.split_whitespace().take_while(|joint| *joint == "YES").count() < joints {
        return Err(not_ready("it is not homed", "home all axes at the control"));
    }
    Ok(())
}

pub(super) fn not_ready(state: &str, remedy: &str) -> ControllerError {
    ControllerError::NotReady { state: state.to_owned(), remedy: remedy.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_thing_that_is_not_as_it_must_be_is_named() {
        let clean = [2.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(judge(&clean).unwrap(), 2.9);
        for (at, named) in [(1, "spindle"), (2, "G59.3"), (8, "G59.3"), (9, "tool"), (11, "tool")] {
            let mut state = clean;
            state[at] = 1.0;
            let error = judge(&state).unwrap_err().to_string();
            assert!(error.contains(named), "{at}: {error}");
        }
        assert!(judge(&clean[..11]).is_err());
    }

    #[test]
    fn a_joint_that_is_not_homed_is_seen() {
        assert!(judge_switches("OFF", "ON", "YES YES YES YES YES NO", 5).is_ok());
        assert!(judge_switches("OFF", "ON", "YES YES NO YES YES NO", 5).is_err());
        assert!(judge_switches("ON", "ON", "YES", 1).is_err());
        assert!(judge_switches("OFF", "OFF", "YES", 1).is_err());
    }
}
