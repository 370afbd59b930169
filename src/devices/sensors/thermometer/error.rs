//! Errors of a thermometer, and what the operator should do next.

use super::SENSIBLE_C;
use link::modbus::ModbusError;
use link::modbus::value::ValueError;

#[derive(Debug, thiserror::Error)]
pub enum ThermometerError {
    #[error(transparent)]
    Modbus(#[from] ModbusError),
    #[error(transparent)]
    Number(#[from] ValueError),
    #[error("it says {celsius:.1} °C, which no place of a machine has")]
    Nonsense { celsius: f64 },
    #[error("it is simulated, and there is nothing to feel: the control is a real one")]
    NothingToFeel,
}

impl ThermometerError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            // The link's own message concerns the machine, whose state is not in doubt here.
            Self::Modbus(ModbusError::Lost { .. } | ModbusError::Ended { .. }) => {
                "see to the thermometer's power and cable".to_owned()
            }
            Self::Modbus(error) => {
                format!("{}; of the thermometer it stands in [thermometer.modbus]", error.remedy())
            }
            Self::Number(_) => "compare `value` of [thermometer.modbus] with its manual".to_owned(),
            Self::Nonsense { .. } => format!(
                "it should lie between {} and {} °C: compare `register`, `type`, `order`, `scale_c` and \
                 `offset_c` with its manual; a broken wire shows as the end of its range",
                SENSIBLE_C.start(),
                SENSIBLE_C.end()
            ),
            Self::NothingToFeel => {
                "say in [thermometer.modbus] how the real one is reached, or take it out".to_owned()
            }
        }
    }
}
