//! Registry of the controls.

use std::sync::Arc;

use devices::controllers::{ControlDescription, ControllerConfig, grbl, linuxcnc, modbus};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

macro_rules! registry {
    ($($config:ty,)*) => {
        const CONTROL_DESCRIPTIONS: &[ControlDescription] = &[$(<$config>::DESCRIPTION),*];

        /// Configuration of a control of `kind` from the keys of its table.
        ///
        /// # Errors
        /// An unknown kind, or a table with unknown keys or wrong types.
        pub fn configure_control<'de, D: Deserializer<'de>>(
            kind: &str,
            keys: D,
        ) -> Result<Arc<dyn ControllerConfig>, D::Error> {
            $(if kind == <$config>::DESCRIPTION.kind {
                return Ok(Arc::new(<$config>::deserialize(keys)?));
            })*
            let known = control_kinds().join(", ");
            Err(D::Error::custom(format!("the kind of control `{kind}` is not known; known are {known}")))
        }
    };
}

registry! {
    modbus::ModbusConfig,
    grbl::GrblConfig,
    linuxcnc::LinuxCncConfig,
}

/// The kinds of all real controls, in alphabetical order; `simulated` is not one of them.
pub fn control_kinds() -> Vec<&'static str> {
    let mut kinds: Vec<_> = CONTROL_DESCRIPTIONS.iter().map(|control| control.kind).collect();
    kinds.sort_unstable();
    kinds
}

/// The texts that `hint` selects from the descriptions of all controls, separated by `; `; controls without this text
/// are left out.
pub fn control_hints(hint: fn(&ControlDescription) -> Option<&'static str>) -> String {
    CONTROL_DESCRIPTIONS.iter().filter_map(hint).collect::<Vec<_>>().join("; ")
}
