//! Checks whether the kinematics are in identity mode. While all rotary axes are at zero, compensating kinematics also
//! put each axis at the position of its joint: the positions then do not show the mode.
//!
//! LinuxCNC (2.9) reports the mode on HAL pin `motion.switchkins-type`. The meaning of its numbers depends
//! on the module, which `[KINS]KINEMATICS` of the INI file names.

use super::ini::IniFile;
use crate::controllers::ControllerError;
use machine::{Axis, Position};

/// Modules based on LinuxCNC's `switchkins.c`: type 1 is identity, with `sparm=identityfirst` type 0.
const SWITCHKINS_MODULES: [&str; 3] = ["xyzac-trt-kins", "xyzbc-trt-kins", "5axiskins"];
/// Modules whose type 0 is identity (`xyzab_tdr_kins.comp` of 2.9; the others are of 2.10).
const IDENTITY_FIRST_MODULES: [&str; 3] = ["xyzab_tdr_kins", "xyzacb_trsrn", "xyzbca_trsrn"];
/// Smallest angle of a rotary axis that shows a compensation, rad; about 1°.
const MIN_ANGLE_SHOWING_COMPENSATION_RAD: f64 = 0.017;
/// Smallest distance of a linear axis from zero that shows a compensation, mm.
const MIN_OFFSET_SHOWING_COMPENSATION_MM: f64 = 1.0;

/// Mode of the kinematics, as the control's HAL pins report it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum KinematicsMode {
    /// The mode is unknown: programs cannot read HAL pins (`HAL_PIN_VARS = 0`).
    NotReadable,
    /// The kinematics have no modes.
    NotSwitchable,
    /// Value of HAL pin `motion.switchkins-type`.
    SwitchkinsType(f64),
}

/// Refuses kinematics that compensate the rotary axes, and kinematics whose mode is not known. `position`: present
/// position, at which each axis is at the position of its joint; an unknown mode is accepted if a compensation would
/// be visible there.
pub(super) fn check_identity_mode(
    ini: Option<&IniFile>,
    mode: KinematicsMode,
    position: &Position,
) -> Result<(), ControllerError> {
    let identity = ini.and_then(identity_switchkins_type);
    match (mode, identity) {
        _ if ini.and_then(IniFile::kinematics_module) == Some("trivkins") => Ok(()),
        (KinematicsMode::SwitchkinsType(now), Some(identity)) if now == identity => Ok(()),
        (KinematicsMode::SwitchkinsType(now), Some(identity)) => Err(ControllerError::not_ready(
            format!(
                "the kinematics compensate the rotary axes: motion.switchkins-type is {now}, identity is \
                 {identity}"
            ),
            "switch the kinematics to identity (in LinuxCNC's five-axis samples: M429), then start again",
        )),
        _ if is_compensation_visible(position) => Ok(()),
        _ => Err(unknown_mode_error(ini, mode)),
    }
}

/// Value of `motion.switchkins-type` in identity mode; `None` for a module that `trued` does not know.
pub(crate) fn identity_switchkins_type(ini: &IniFile) -> Option<f64> {
    let module = ini.kinematics_module()?;
    let is_first = ini.kinematics()?.contains("identityfirst");
    match module {
        _ if IDENTITY_FIRST_MODULES.contains(&module) => Some(0.0),
        _ if SWITCHKINS_MODULES.contains(&module) => Some(if is_first { 0.0 } else { 1.0 }),
        _ => None,
    }
}

/// Whether compensating kinematics would move an axis away from its joint at `position`. With the pivot at zero, they
/// do not while both linear axes perpendicular to the rotary axis are at zero.
fn is_compensation_visible(position: &Position) -> bool {
    let is_away = |axis| position.get(axis).is_some_and(|at: f64| at.abs() > MIN_OFFSET_SHOWING_COMPENSATION_MM);
    let is_off_centre = |axis| match axis {
        Axis::A => is_away(Axis::Y) || is_away(Axis::Z),
        Axis::B => is_away(Axis::X) || is_away(Axis::Z),
        _ => is_away(Axis::X) || is_away(Axis::Y),
    };
    let is_turned = |at: f64| (at / 2.0).sin().abs() > MIN_ANGLE_SHOWING_COMPENSATION_RAD / 2.0;
    let rotary = [Axis::A, Axis::B, Axis::C].into_iter();
    rotary.filter_map(|axis| Some((axis, position.get(axis)?))).any(|(axis, at)| is_turned(at) && is_off_centre(axis))
}

fn unknown_mode_error(ini: Option<&IniFile>, mode: KinematicsMode) -> ControllerError {
    let turn_remedy = "turn a rotary axis of the table by 10° at the GUI, with X, Y and Z away from zero and from \
                this axis, so that the positions show the mode; then start again";
    let (reason, first_remedy) = match (mode, ini) {
        (_, None) => {
            ("no INI file is configured", "set [controller] ini in the machine file to LinuxCNC's INI file; or ")
        }
        (KinematicsMode::NotReadable, _) => (
            "programs cannot read HAL pins",
            "set HAL_PIN_VARS = 1 in [RS274NGC] of the INI file and restart LinuxCNC; or ",
        ),
        _ => ("trued does not support the kinematics module", ""),
    };
    let state = format!(
        "the mode of the kinematics is unknown (with or without compensation of the rotary axes): {reason}, and the \
         present positions do not show the mode"
    );
    ControllerError::not_ready(&state, format!("{first_remedy}{turn_remedy}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// X, Y and Z in mm, B and C in degrees.
    const HOME_POSITION: [f64; 5] = [0.0, 0.0, 200.0, 0.0, 0.0];

    fn position_at([x, y, z, b_deg, c_deg]: [f64; 5]) -> Position {
        let linear = [(Axis::X, x), (Axis::Y, y), (Axis::Z, z)];
        let rotary = [(Axis::B, b_deg.to_radians()), (Axis::C, c_deg.to_radians())];
        linear.into_iter().chain(rotary).collect()
    }

    fn is_accepted(kinematics: &str, mode: KinematicsMode, mm_and_deg: [f64; 5]) -> bool {
        let ini = IniFile::parse(&format!("[KINS]\nKINEMATICS = {kinematics}\n"));
        check_identity_mode(Some(&ini), mode, &position_at(mm_and_deg)).is_ok()
    }

    #[test]
    fn identity_type_depends_on_the_kinematics_module() {
        let accepted = |kinematics, now| is_accepted(kinematics, KinematicsMode::SwitchkinsType(now), HOME_POSITION);
        assert!(accepted("xyzbc-trt-kins sparm=identityfirst", 0.0));
        assert!(!accepted("xyzbc-trt-kins sparm=identityfirst", 1.0));
        assert!(!accepted("xyzac-trt-kins", 0.0));
        assert!(accepted("xyzac-trt-kins", 1.0));
        assert!(accepted("xyzab_tdr_kins", 0.0));
        assert!(!accepted("xyzab_tdr_kins", 1.0));
        // A module written by the user.
        assert!(!accepted("millkins", 0.0));
        // Another mode is refused at every position.
        let shows = [20.0, 20.0, 200.0, 0.0, 30.0];
        assert!(!is_accepted("xyzac-trt-kins", KinematicsMode::SwitchkinsType(2.0), shows));
    }

    #[test]
    fn unknown_mode_is_accepted_only_with_a_turned_axis() {
        for mode in [KinematicsMode::NotReadable, KinematicsMode::NotSwitchable] {
            assert!(is_accepted("trivkins coordinates=XYZBC", mode, HOME_POSITION));
            assert!(!is_accepted("maxkins", mode, HOME_POSITION));
            assert!(is_accepted("maxkins", mode, [0.0, 0.0, 200.0, 10.0, 0.0]));
            assert!(is_accepted("maxkins", mode, [20.0, 0.0, 200.0, 0.0, 10.0]));
            // Position on the rotary axis, and position after a whole turn.
            assert!(!is_accepted("maxkins", mode, [0.0, 0.0, 200.0, 0.0, 10.0]));
            assert!(!is_accepted("maxkins", mode, [20.0, 20.0, 200.0, 0.0, 360.0]));
        }
        assert!(check_identity_mode(None, KinematicsMode::SwitchkinsType(0.0), &position_at(HOME_POSITION)).is_err());
        assert!(
            check_identity_mode(None, KinematicsMode::SwitchkinsType(0.0), &position_at([20.0, 0.0, 0.0, 10.0, 0.0]))
                .is_ok()
        );
    }
}
