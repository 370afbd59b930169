//! Errors before any device is opened or moved.

use super::machine_file::MachineFileError;
use devices::controllers::ControllerError;
use devices::sensors::SensorError;
use link::LinkError;
use methods::MethodRefusal;
use planning::gcode::DialectError;
use planning::proof::StageProofError;
use simulator::SimulatedWorldError;

/// Why a machine file, its method or its devices cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error(transparent)]
    MachineFile(#[from] MachineFileError),
    #[error("the method `{name}` is not known; known are {}", methods::method_names().join(", "))]
    NoSuchMethod { name: String },
    #[error("the method `{name}` does not support repetitions")]
    RepeatsNotSupported { name: String },
    #[error("settings of the method: {why}")]
    MethodSettings { why: String },
    #[error(transparent)]
    Dialect(#[from] DialectError),
    #[error("the block that sets the modes of the control is refused: {0}")]
    ModeTextRefused(#[from] StageProofError),
    /// A draft of a machine file cannot be written.
    #[error("the machine file cannot be written: {why}")]
    MachineFileDraft { why: String },
    #[error("the header of the program cannot be written: {0}")]
    ProgramHeader(#[from] planning::gcode::RenderError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Sensor(#[from] SensorError),
    #[error(transparent)]
    MethodRefused(#[from] MethodRefusal),
    #[error("the simulated machine cannot be built: {0}")]
    SimulatedWorld(#[from] SimulatedWorldError),
}

impl SetupError {
    /// Remedy, where the message does not contain one.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Link(error) => Some(error.remedy()),
            Self::Controller(error) => Some(error.remedy()),
            Self::Sensor(error) => Some(error.remedy()),
            SetupError::MethodRefused(refused) => Some(refused.remedy.clone()),
            Self::Dialect(error) => Some(error.remedy().to_owned()),
            SetupError::ModeTextRefused(error) => Some(error.remedy()),
            SetupError::RepeatsNotSupported { name } => Some(format!(
                "omit --repeat; for more readings, increase the numbers in [method.{name}] (balls, indexations)"
            )),
            Self::MachineFile(_)
            | Self::NoSuchMethod { .. }
            | SetupError::MethodSettings { .. }
            | SetupError::MachineFileDraft { .. }
            | SetupError::ProgramHeader(_)
            | SetupError::SimulatedWorld(_) => None,
        }
    }
}
