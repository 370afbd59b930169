//! Program that reads the tool centre as LinuxCNC computes it: switchable kinematics apply their values while the
//! program runs. It moves nothing.

use serde::Deserialize;

use super::prepare;
use crate::controllers::ControllerError;
use planning::gcode::rs274::check_kinematics_command;

/// Commands that switch the kinematics, from `[controller] tool_centre`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "ToolCentreKeys")]
pub struct ToolCentreCommands {
    /// Switches tool centre point control on.
    on: KinematicsCommand,
    /// Switches tool centre point control off: identity kinematics.
    off: KinematicsCommand,
}

/// Keys of `[controller] tool_centre`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ToolCentreKeys {
    /// Switches tool centre point control on, such as M428.
    on: KinematicsCommand,
    /// Switches it off (identity), such as M429.
    off: KinematicsCommand,
}

impl TryFrom<ToolCentreKeys> for ToolCentreCommands {
    type Error = String;

    fn try_from(ToolCentreKeys { on, off }: ToolCentreKeys) -> Result<Self, String> {
        match on == off {
            true => Err("`on` and `off` are the same command".to_owned()),
            false => Ok(Self { on, off }),
        }
    }
}

/// One M word, with P, Q or E parameters if needed, that has no fixed meaning in the G-code dialect.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
struct KinematicsCommand(String);

impl TryFrom<String> for KinematicsCommand {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        check_kinematics_command(&text).map_err(|reason| format!("`{text}`: {reason}"))?;
        Ok(Self(text))
    }
}

/// How this machine reads its tool centre.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolCentreSettings {
    pub commands: ToolCentreCommands,
    /// Tool length that the program sets with `G43.1`, mm: the length of the machine file's stylus along Z.
    pub stylus_length_mm: f64,
}

impl ToolCentreSettings {
    /// Text of the program; `log` is the path of its result log. `M66` waits until the kinematics are switched, and
    /// reads the position of the axes again. A program that cannot read the pin of the kinematics ends with an error.
    pub(super) fn program(&self, log: &str) -> String {
        const LOG_KINEMATICS: &str = "(LOG,kinematics #<_hal[motion.switchkins-type]>)";
        let Self { commands: ToolCentreCommands { on, off }, stylus_length_mm } = self;
        format!(
            "%\n(trued reads the tool centre; nothing moves)\nM70\nG21 G90 G49\nG92.2\nG59.3\n(LOGOPEN,{log})\n\
             {LOG_KINEMATICS}\n(LOG,axes #5420 #5421 #5422 #5423 #5424 #5425)\nG43.1 Z{stylus_length_mm:.6}\n\
             {}\nM66 E0 L0\n{LOG_KINEMATICS}\n(LOG,tool_centre #5420 #5421 #5422 #5220 {})\n\
             {}\nM66 E0 L0\n{LOG_KINEMATICS}\nG49\n(LOG,END)\n(LOGCLOSE)\nM72\n%\n",
            on.0,
            prepare::OFFSET_SLOT_PARAMETERS,
            off.0,
        )
    }
}

/// Adds to a `NotReady` error that the tool centre was not read, and how to restore the modes: a program that ended
/// early, or wrong commands, have left other modes. Other errors are returned unchanged.
pub(super) fn tool_centre_error(error: ControllerError) -> ControllerError {
    match error {
        ControllerError::NotReady { state, remedy } => ControllerError::NotReady {
            state: format!("the tool centre was not read: {state}"),
            remedy: format!(
                "before the machine moves, switch the kinematics to identity and enter G49: tool centre point control and \
                 a tool length may be active; then {remedy}"
            ),
        },
        other => other,
    }
}
