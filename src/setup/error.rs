//! What can go wrong before anything is opened or moved.

use super::machine_file::MachineFileError;
use crate::controllers::ControllerError;
use crate::gcode::DialectError;
use crate::link::LinkError;
use crate::methods;
use crate::world::WorldError;

#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error(transparent)]
    MachineFile(#[from] MachineFileError),
    #[error("there is no method `{name}`; there are {}", methods::NAMES.join(", "))]
    NoSuchMethod { name: String },
    #[error("`{name}` measures no cycle that could be repeated")]
    NoRepeats { name: String },
    #[error("settings of the method: {why}")]
    Settings { why: String },
    #[error(transparent)]
    Dialect(#[from] DialectError),
    #[error("the head of the program cannot be written: {0}")]
    Render(#[from] crate::gcode::RenderError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error("the simulated machine: {0}")]
    World(#[from] WorldError),
    #[error("`{tcp}` is no host:port")]
    Address { tcp: String },
    #[error("{folder}: {source}")]
    ProgramFolder { folder: String, source: std::io::Error },
}

impl SetupError {
    /// What to do next, where the message does not say it already.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Link(error) => Some(error.remedy()),
            Self::Controller(error) => Some(error.remedy()),
            Self::Address { .. } => {
                Some("write tcp = \"192.0.2.1:5007\" in [controller]".to_owned())
            }
            Self::Dialect(error) => Some(error.remedy().to_owned()),
            Self::NoRepeats { name } => Some(format!(
                "leave --repeat out; a larger budget in [method.{name}] (balls, indexations) measures more"
            )),
            Self::ProgramFolder { .. } => Some(
                "give this user the right to write there, or change [controller] program_dir"
                    .to_owned(),
            ),
            Self::MachineFile(_)
            | Self::NoSuchMethod { .. }
            | Self::Settings { .. }
            | Self::Render(_)
            | Self::World(_) => None,
        }
    }
}
