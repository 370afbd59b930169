//! Registry of the controls.

use std::sync::Arc;

use devices::controllers::{ControllerConfig, grbl, linuxcnc, modbus};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

/// The kinds of all controls.
pub const CONTROL_KINDS: [&str; 3] = [grbl::CONTROL_KIND, linuxcnc::CONTROL_KIND, modbus::CONTROL_KIND];

/// Configuration of a control of `kind` from the keys of its table. This is the registry: a new control is one
/// line here.
///
/// # Errors
/// An unknown kind, or a table with unknown keys or wrong types.
pub fn configure_control<'de, D: Deserializer<'de>>(
    kind: &str,
    keys: D,
) -> Result<Arc<dyn ControllerConfig>, D::Error> {
    match kind {
        grbl::CONTROL_KIND => Ok(Arc::new(grbl::GrblConfig::deserialize(keys)?)),
        linuxcnc::CONTROL_KIND => Ok(Arc::new(linuxcnc::LinuxCncConfig::deserialize(keys)?)),
        modbus::CONTROL_KIND => Ok(Arc::new(modbus::ModbusConfig::deserialize(keys)?)),
        unknown => Err(D::Error::custom(format!(
            "the kind of control `{unknown}` is not known; known are {}",
            CONTROL_KINDS.join(", ")
        ))),
    }
}
