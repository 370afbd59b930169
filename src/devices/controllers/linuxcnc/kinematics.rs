//! Checks whether the kinematics are in identity mode. While all rotary axes are at zero, compensating
//! kinematics too put each axis where its joint is: there positions alone do not show the mode.
//!
//! LinuxCNC (2.9) reports the mode on HAL pin `motion.switchkins-type`. The meaning of its numbers depends
//! on the module, which `[KINS]KINEMATICS` of the INI file names.

use super::ini::Ini;
use super::not_ready::not_ready;
use crate::controllers::ControllerError;
use machine::{Axis, Position};

/// Modules based on LinuxCNC's `switchkins.c`: type 1 is identity, with `sparm=identityfirst` type 0.
const SWITCHKINS: [&str; 3] = ["xyzac-trt-kins", "xyzbc-trt-kins", "5axiskins"];
/// Modules whose type 0 is identity (`xyzab_tdr_kins.comp` of 2.9; the others are of 2.10).
const IDENTITY_FIRST: [&str; 3] = ["xyzab_tdr_kins", "xyzacb_trsrn", "xyzbca_trsrn"];
/// Smallest angle of a rotary axis, rad, and smallest distance of a linear axis from zero, mm, that show a
/// compensation.
const SHOWS_RAD: f64 = 0.017;
const SHOWS_MM: f64 = 1.0;

/// Mode of the kinematics, as the control's HAL pins report it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SwitchPin {
    /// Programs cannot read HAL pins: `HAL_PIN_VARS = 0`.
    NotReadable,
    /// The kinematics have no modes.
    None,
    Type(f64),
}

/// Refuses kinematics that compensate the rotary axes, and kinematics whose mode is not known. At `stands`
/// each axis is where its joint is.
pub(super) fn judge(
    ini: Option<&Ini>,
    pin: SwitchPin,
    stands: &Position,
) -> Result<(), ControllerError> {
    let identity = ini.and_then(identity_type);
    match (pin, identity) {
        _ if ini.and_then(Ini::kinematics_module) == Some("trivkins") => Ok(()),
        (SwitchPin::Type(now), Some(identity)) if now == identity => Ok(()),
        (SwitchPin::Type(now), Some(identity)) => Err(not_ready(
            &format!(
                "its kinematics compensate the rotary axes: motion.switchkins-type is {now}, identity is \
                 {identity}"
            ),
            "switch the kinematics to identity (in LinuxCNC's five-axis samples: M429), then start again",
        )),
        _ if shows_mode(stands) => Ok(()),
        _ => Err(not_known(ini, pin)),
    }
}

/// Value of `motion.switchkins-type` in identity mode.
fn identity_type(ini: &Ini) -> Option<f64> {
    let module = ini.kinematics_module()?;
    let is_first = ini.kinematics()?.contains("identityfirst");
    match module {
        _ if IDENTITY_FIRST.contains(&module) => Some(0.0),
        _ if SWITCHKINS.contains(&module) => Some(if is_first { 0.0 } else { 1.0 }),
        _ => None,
    }
}

/// Whether compensating kinematics would move an axis away from its joint at `stands`. With the pivot at
/// zero they do not if both linear axes across the rotary axis are at zero.
fn shows_mode(stands: &Position) -> bool {
    let is_off = |axis| stands.get(axis).is_some_and(|at: f64| at.abs() > SHOWS_MM);
    let across = |axis| match axis {
        Axis::A => is_off(Axis::Y) || is_off(Axis::Z),
        Axis::B => is_off(Axis::X) || is_off(Axis::Z),
        _ => is_off(Axis::X) || is_off(Axis::Y),
    };
    let turned = |at: f64| (at / 2.0).sin().abs() > SHOWS_RAD / 2.0;
    let rotary = [Axis::A, Axis::B, Axis::C].into_iter();
    rotary
        .filter_map(|axis| Some((axis, stands.get(axis)?)))
        .any(|(axis, at)| turned(at) && across(axis))
}

fn not_known(ini: Option<&Ini>, pin: SwitchPin) -> ControllerError {
    let turn = "turn a rotary axis of the table by 10° at the GUI, with X, Y and Z away from zero and from \
                this axis: there the mode shows; then start again";
    let (why, other) = match (pin, ini) {
        (_, None) => (
            "no INI file names them",
            "name LinuxCNC's INI file in the machine file ([controller] ini); or ",
        ),
        (SwitchPin::NotReadable, _) => (
            "programs cannot read HAL pins",
            "write HAL_PIN_VARS = 1 into [RS274NGC] of the INI file and start LinuxCNC again; or ",
        ),
        _ => ("trued does not know the module", ""),
    };
    let state = format!(
        "whether its kinematics compensate the rotary axes is not known: {why}, and positions do not show \
         it here"
    );
    not_ready(&state, &format!("{other}{turn}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOME: [f64; 5] = [0.0, 0.0, 200.0, 0.0, 0.0];

    fn at([x, y, z, b_deg, c_deg]: [f64; 5]) -> Position {
        let linear = [(Axis::X, x), (Axis::Y, y), (Axis::Z, z)];
        let rotary = [(Axis::B, b_deg.to_radians()), (Axis::C, c_deg.to_radians())];
        linear.into_iter().chain(rotary).collect()
    }

    fn is_accepted(kinematics: &str, pin: SwitchPin, place: [f64; 5]) -> bool {
        let ini = Ini::of(&format!("[KINS]\nKINEMATICS = {kinematics}\n"));
        judge(Some(&ini), pin, &at(place)).is_ok()
    }

    #[test]
    fn the_number_of_identity_is_a_matter_of_the_module() {
        let accepted = |kinematics, now| is_accepted(kinematics, SwitchPin::Type(now), HOME);
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
        assert!(!is_accepted("xyzac-trt-kins", SwitchPin::Type(2.0), shows));
    }

    #[test]
    fn without_the_pin_only_a_turned_axis_shows_identity() {
        for pin in [SwitchPin::NotReadable, SwitchPin::None] {
            assert!(is_accepted("trivkins coordinates=XYZBC", pin, HOME));
            assert!(!is_accepted("maxkins", pin, HOME));
            assert!(is_accepted("maxkins", pin, [0.0, 0.0, 200.0, 10.0, 0.0]));
            assert!(is_accepted("maxkins", pin, [20.0, 0.0, 200.0, 0.0, 10.0]));
            // Position on the rotary axis, and position after a whole turn.
            assert!(!is_accepted("maxkins", pin, [0.0, 0.0, 200.0, 0.0, 10.0]));
            assert!(!is_accepted("maxkins", pin, [20.0, 20.0, 200.0, 0.0, 360.0]));
        }
        assert!(judge(None, SwitchPin::Type(0.0), &at(HOME)).is_err());
        assert!(judge(None, SwitchPin::Type(0.0), &at([20.0, 0.0, 0.0, 10.0, 0.0])).is_ok());
    }
}
