//! `[controller]`: the kind of the control, and its active compensations. All other keys belong to the
//! control's own configuration.

use std::sync::Arc;

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;
use super::located_value::LocatedValue;
use devices::controllers;

use crate::setup::controls;
use crate::setup::simulated::SimulatedControlConfig;

/// Value of `kind` that selects a simulated control.
const SIMULATED_CONTROL_KIND: &str = "simulated";

/// `[controller]` of the machine file.
#[derive(Debug, Clone)]
pub struct ControllerTable {
    pub control: ControlConfig,
    /// Compensations that are active in the control, in the maker's terms. They are part of the record: results
    /// are the errors that remain with them.
    pub compensations_active: Vec<String>,
}

#[derive(Debug, Clone)]
pub enum ControlConfig {
    /// Simulated firmware that moves the simulated machine of `[simulated]`.
    Simulated(SimulatedControlConfig),
    Real(Arc<dyn controllers::ControllerConfig>),
}

impl ControlConfig {
    /// Name of the control's dialect.
    pub fn dialect(&self) -> &str {
        match self {
            Self::Simulated(control) => control.dialect(),
            Self::Real(control) => control.dialect(),
        }
    }
}

/// Keys of every control.
#[derive(Deserialize)]
struct CommonControllerKeys {
    kind: String,
    #[serde(default)]
    compensations_active: Vec<String>,
}

pub fn read_controller(document: &TomlDocument) -> Result<ControllerTable, MachineFileError> {
    let CommonControllerKeys { kind, compensations_active } = document.deserialize_required_section(&["controller"])?;
    let known = [vec![SIMULATED_CONTROL_KIND], controls::control_kinds()].concat();
    if !known.contains(&kind.as_str()) {
        let why = format!("is `{kind}`; known: {}", known.join(", "));
        return Err(document.value_error(&["controller", "kind"], why));
    }
    let own = |keys: LocatedValue<'_>| {
        let keys = keys.without_key("kind").without_key("compensations_active");
        match kind.as_str() {
            SIMULATED_CONTROL_KIND => SimulatedControlConfig::deserialize(keys).map(ControlConfig::Simulated),
            real => controls::configure_control(real, keys).map(ControlConfig::Real),
        }
    };
    let control = document.read_required_section(&["controller"], own)?;
    Ok(ControllerTable { control, compensations_active })
}
