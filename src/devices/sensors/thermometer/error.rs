//! Errors of a thermometer, and what the operator should do next.

use super::PLAUSIBLE_RANGE_C;
use link::modbus::ModbusError;
use link::modbus::number_format::RegisterValueError;

#[derive(Debug, thiserror::Error)]
pub enum ThermometerError {
    #[error(transparent)]
    Modbus(#[from] ModbusError),
    #[error(transparent)]
    InvalidNumber(#[from] RegisterValueError),
    #[error("the temperature {celsius:.1} °C is not plausible")]
    ImplausibleValue { celsius: f64 },
    /// There is no valid value and no later error: no request has ended yet, or the last value is too old.
    #[error("no reply from the thermometer yet")]
    NoCurrentValue,
    /// The thermometer is simulated, but there is no simulated machine, or this machine has no such thermometer.
    #[error("the thermometer is simulated, but the control is not")]
    NoSimulatedMachine,
}

impl ThermometerError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            // The remedy of a lost link concerns the machine; a lost thermometer leaves the machine's state known.
            Self::Modbus(ModbusError::ConnectionLost { .. } | ModbusError::LinkThreadEnded { .. })
            | Self::NoCurrentValue => "check the thermometer's power and cable".to_owned(),
            Self::Modbus(error) => format!("{}; for the thermometer: the keys of [thermometer.modbus]", error.remedy()),
            Self::InvalidNumber(_) => {
                "compare `value` of [thermometer.modbus] with the thermometer's manual".to_owned()
            }
            Self::ImplausibleValue { .. } => format!(
                "plausible are {} to {} °C: compare `register`, `type`, `order`, `scale_c` and \
                 `offset_c` with the thermometer's manual; with a broken wire a thermometer reports the end of \
                 its range",
                PLAUSIBLE_RANGE_C.start(),
                PLAUSIBLE_RANGE_C.end()
            ),
            Self::NoSimulatedMachine => {
                "write the connection of the real thermometer in [thermometer.modbus], or remove the thermometer"
                    .to_owned()
            }
        }
    }
}
