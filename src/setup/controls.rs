//! Registry of the controls.

use std::sync::Arc;

use devices::controllers::{Named, grbl, linuxcnc, modbus};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

/// The kinds of all controls.
pub const KINDS: [&str; 3] = [grbl::KIND, linuxcnc::KIND, modbus::KIND];

/// Configuration of a control of `kind` from the keys of its table. This is the registry: a new control is one
/// line here.
///
/// # Errors
/// An unknown kind, or a table with unknown keys or wrong types.
pub fn configure<'de, D: Deserializer<'de>>(
    kind: &str,
    keys: D,
) -> Result<Arc<dyn Named>, D::Error> {
    match kind {
        grbl::KIND => Ok(Arc::new(grbl::Config::deserialize(keys)?)),
        linuxcnc::KIND => Ok(Arc::new(linuxcnc::Config::deserialize(keys)?)),
        modbus::KIND => Ok(Arc::new(modbus::Config::deserialize(keys)?)),
        unknown => Err(D::Error::custom(format!(
            "there is no control `{unknown}`; there are {}",
            KINDS.join(", ")
        ))),
    }
}
