//! Errors before any device is opened or moved.

use super::machine_file::MachineFileError;
use devices::controllers::ControllerError;
use devices::sensors::SensorError;
use link::LinkError;
use methods::MethodRefusal;
use planning::gcode::DialectError;
use planning::proof::StageProofError;
use simulator::SimulatedWorldError;

#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error(transparent)]
    MachineFile(#[from] MachineFileError),
    #[error("the method `{name}` is not known; known are {}", methods::method_names().join(", "))]
    NoSuchMethod { name: String },
    #[error("the method `{name}` does not support repetitions")]
    NoRepeats { name: String },
    #[error("settings of the method: {why}")]
    Settings { why: String },
    #[error(transparent)]
    Dialect(#[from] DialectError),
    #[error("the block that sets the modes of the control is refused: {0}")]
    Modes(#[from] StageProofError),
    #[error("the machine file cannot be written: {why}")]
    Draft { why: String },
    #[error("the header of the program cannot be written: {0}")]
    Render(#[from] planning::gcode::RenderError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Sensor(#[from] SensorError),
    #[error(transparent)]
    Refused(#[from] MethodRefusal),
    #[error("the simulated machine cannot be built: {0}")]
    World(#[from] SimulatedWorldError),
}

impl SetupError {
    /// What to do next, where the message does not contain it.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Link(error) => Some(error.remedy()),
            Self::Controller(error) => Some(error.remedy()),
            Self::Sensor(error) => Some(error.remedy()),
            Self::Refused(refused) => Some(refused.remedy.clone()),
            Self::Dialect(error) => Some(error.remedy().to_owned()),
            Self::Modes(error) => Some(error.remedy()),
            Self::NoRepeats { name } => Some(format!(
                "omit --repeat; for more readings, increase the numbers in [method.{name}] (balls, \
                indexations)"
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
