//! `[controller]`: the kind of the control, and its active compensations. All other keys belong to the
//! control's own configuration.

use std::sync::Arc;

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;
use super::value::LocatedValue;
use devices::controllers;

use crate::setup::controls;
use crate::setup::simulated::SimulatedControl;

const SIMULATED_KIND: &str = "simulated";

#[derive(Debug, Clone)]
pub struct ControllerConfig {
    pub control: Control,
    /// Compensations that are active in the control, in the maker's terms. They are part of the record: results
    /// are the errors that remain with them.
    pub compensations_active: Vec<String>,
}

#[derive(Debug, Clone)]
pub enum Control {
    /// Simulated firmware that moves the simulated machine of `[simulated]`.
    Simulated(SimulatedControl),
    Real(Arc<dyn controllers::ControllerConfig>),
}

impl Control {
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
struct CommonKeys {
    kind: String,
    #[serde(default)]
    compensations_active: Vec<String>,
}

pub fn read_controller(document: &TomlDocument) -> Result<ControllerConfig, MachineFileError> {
    let CommonKeys { kind, compensations_active } = document.read_required(&["controller"])?;
    let known = [vec![SIMULATED_KIND], controls::control_kinds()].concat();
    if !known.contains(&kind.as_str()) {
        let why = format!("is `{kind}`; known: {}", known.join(", "));
        return Err(document.value_error(&["controller", "kind"], why));
    }
    let own = |keys: LocatedValue<'_>| {
        let keys = keys.without_key("kind").without_key("compensations_active");
        match kind.as_str() {
            SIMULATED_KIND => SimulatedControl::deserialize(keys).map(Control::Simulated),
            real => controls::configure_control(real, keys).map(Control::Real),
        }
    };
    let control = document.read_required_section(&["controller"], own)?;
    Ok(ControllerConfig { control, compensations_active })
}
