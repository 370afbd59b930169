//! Errors before any device is opened or moved.

use super::machine_file::MachineFileError;
use devices::controllers::ControllerError;
use devices::sensors::SensorError;
use link::LinkError;
use methods::Refused;
use planning::gcode::DialectError;
use planning::proof::Unproven;
use simulator::WorldError;

#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error(transparent)]
    MachineFile(#[from] MachineFileError),
    #[error("there is no method `{name}`; there are {}", methods::names().join(", "))]
    NoSuchMethod { name: String },
    #[error("`{name}` measures no cycle that could be repeated")]
    NoRepeats { name: String },
    #[error("settings of the method: {why}")]
    Settings { why: String },
    #[error(transparent)]
    Dialect(#[from] DialectError),
    #[error("the text that sets the control's modes: {0}")]
    Modes(#[from] Unproven),
    #[error("the machine file cannot be written: {why}")]
    Draft { why: String },
    #[error("the head of the program cannot be written: {0}")]
    Render(#[from] planning::gcode::RenderError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Sensor(#[from] SensorError),
    #[error(transparent)]
    Refused(#[from] Refused),
    #[error("the simulated machine: {0}")]
    World(#[from] WorldError),
}

impl SetupError {
    /// What to do next, where the message does not contain it.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Link(error) => Some(error.remedy()),
            Self::Controller(error) => Some(error.remedy()),
            Self::Sensor(error) => Some(error.remedy()),
            Self::Refused(refused) => Some(refused.instead.clone()),
            Self::Dialect(error) => Some(error.remedy().to_owned()),
            Self::Modes(error) => Some(error.remedy()),
            Self::NoRepeats { name } => Some(format!(
                "leave --repeat out; a larger budget in [method.{name}] (balls, indexations) measures more"
            )),
            Self::MachineFile(_)
            | Self::NoSuchMethod { .. }
            | Self::Settings { .. }
            | Self::Draft { .. }
            | Self::Render(_)
            | Self::World(_) => None,
        }
    }
}
