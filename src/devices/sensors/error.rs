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
    #[error("no data from the sensor within {seconds} s")]
    Silent { seconds: f64 },
    /// Samples arrive, but their counter never changes.
    #[error("the counter of the received samples never changes")]
    CounterFrozen,
    /// The data do not match the machine file, or a capture is unusable.
    #[error("the data of the sensor do not match the machine file: {text}")]
    InvalidData { text: String, remedy: String },
    #[error("the machine has no sensor `{name}`")]
    UnknownSensor { name: String },
    /// The sensor `name` is simulated, but the control is not.
    #[error("the sensor `{name}` is simulated, but the control is not")]
    NoSimulatedMachine { name: String },
    #[error("the sensor's task has ended")]
    TaskEnded,
}

impl SensorError {
    /// Whether the communication failed: any error of the link, of Modbus or of CAN, or silence; not the content of
    /// the data.
    pub fn is_link_error(&self) -> bool {
        matches!(self, Self::Link(_) | Self::Modbus(_) | Self::Can(_) | Self::Silent { .. })
    }

    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            // The remedy of a lost link concerns the machine; a sensor that is lost leaves the machine's state known.
            Self::Link(LinkError::Lost { .. })
            | Self::Modbus(ModbusError::ConnectionLost { .. } | ModbusError::LinkThreadEnded { .. }) => {
                "check the sensor's power and cable; use serial_id for a port whose device name changes".to_owned()
            }
            Self::Link(error) | Self::Modbus(ModbusError::OpenFailed(error)) => {
                format!("{}; for the sensor: the keys of its table in [[sensor]]", error.remedy())
            }
            Self::Modbus(ModbusError::Timeout { .. }) => {
                "check that the sensor is on, then compare `unit`, baud rate and parity of [sensor.modbus] \
                 with its manual; set a longer `timeout_s` for a slow sensor"
                    .to_owned()
            }
            Self::Modbus(error) => format!("{}; for the sensor: the keys of [sensor.modbus]", error.remedy()),
            Self::Can(error) => error.remedy(),
            Self::Silent { .. } => {
                "check the sensor's power and cable, and that the sensor is set to send data".to_owned()
            }
            Self::CounterFrozen => "check that the sensor measures (trigger, hold input); then compare `counter` of \
                             its table in [[sensor]] with its manual: position, width, order"
                .to_owned(),
            Self::InvalidData { remedy, .. } => remedy.clone(),
            Self::UnknownSensor { .. } => "add the sensor as [[sensor]] to the machine file".to_owned(),
            Self::NoSimulatedMachine { .. } => {
                "write the connection of the real sensor in [[sensor]], or set `kind = \"simulated\"` in \
                 [controller]"
                    .to_owned()
            }
            Self::TaskEnded => "start the program again; if the error returns, report it".to_owned(),
        }
    }
}
