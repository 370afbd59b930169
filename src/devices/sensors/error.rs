//! Errors of a sensor, and what the operator should do next.

use link::LinkError;
use link::can::CanError;
use link::modbus::ModbusError;

#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Modbus(#[from] ModbusError),
    #[error(transparent)]
    Can(#[from] CanError),
    #[error("nothing came from the sensor within {seconds} s")]
    Silent { seconds: f64 },
    #[error("samples come, but their counter always says the same")]
    Stands,
    #[error("what the sensor says cannot be understood: {text}")]
    UnexpectedDevice { text: String, remedy: String },
    #[error("the machine has no sensor `{name}`")]
    Unknown { name: String },
    #[error("the simulated sensor `{name}` has nothing to look at: the control is a real one")]
    NothingToSee { name: String },
    #[error("the sensor's task has ended")]
    Gone,
}

impl SensorError {
    pub fn is_of_link(&self) -> bool {
        matches!(self, Self::Link(_) | Self::Modbus(_) | Self::Can(_) | Self::Silent { .. })
    }

    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            // The link's own message concerns the machine, whose state is not in doubt here.
            Self::Link(LinkError::Lost { .. })
            | Self::Modbus(ModbusError::Lost { .. } | ModbusError::Ended { .. }) => {
                "see to the sensor's power and cable; a port that comes back under another name is found \
                 by serial_id"
                    .to_owned()
            }
            Self::Link(error) | Self::Modbus(ModbusError::Link(error)) => {
                format!("{}; of the sensor it stands in its table in [[sensor]]", error.remedy())
            }
            Self::Modbus(ModbusError::Late { .. }) => {
                "see that the sensor is on, then compare `unit`, baud rate and parity of [sensor.modbus] \
                 with its manual; a slow sensor needs a longer `timeout_s`"
                    .to_owned()
            }
            Self::Modbus(error) => {
                format!("{}; of the sensor it stands in [sensor.modbus]", error.remedy())
            }
            Self::Can(error) => error.remedy(),
            Self::Silent { .. } => {
                "see that the sensor has power, that its cable is plugged in, and that it is set to send"
                    .to_owned()
            }
            Self::Stands => "see that the sensor measures (trigger, hold input); if it does, compare `counter` \
                             of its table in [[sensor]] with its manual: place, width, order"
                .to_owned(),
            Self::UnexpectedDevice { remedy, .. } => remedy.clone(),
            Self::Unknown { .. } => "describe it as a [[sensor]] of the machine file".to_owned(),
            Self::NothingToSee { .. } => {
                "say in [[sensor]] how the real one is reached, or take `kind = \"simulated\"` in \
                 [controller]"
                    .to_owned()
            }
            Self::Gone => "start again; if it happens again, report it".to_owned(),
        }
    }
}
