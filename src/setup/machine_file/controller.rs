//! `[controller]`: the kind of the control, and its active compensations. All other keys belong to the
//! control's own configuration.

use std::sync::Arc;

use serde::Deserialize;

use super::document::{Document, value_problem};
use super::error::{MachineFileError, Problem};
use super::value::Value;
use devices::controllers::Named;

use crate::setup::controls;
use crate::setup::simulated::SimulatedControl;

const SIMULATED: &str = "simulated";

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
    Real(Arc<dyn Named>),
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
struct Common {
    kind: String,
    #[serde(default)]
    compensations_active: Vec<String>,
}

const SECTION: [&str; 1] = ["controller"];

pub fn read(document: &Document) -> Result<ControllerConfig, MachineFileError> {
    let Common { kind, compensations_active } = document.required(&SECTION)?;
    let known = [&[SIMULATED][..], &controls::KINDS].concat();
    if !known.contains(&kind.as_str()) {
        let key = ["controller", "kind"];
        let why = format!("is `{kind}`; known: {}", known.join(", "));
        return Err(document.error_at(&key, value_problem(&key, why)));
    }
    let own = |keys: Value<'_>| {
        let keys = keys.without("kind").without("compensations_active");
        match kind.as_str() {
            SIMULATED => SimulatedControl::deserialize(keys).map(Control::Simulated),
            real => controls::configure(real, keys).map(Control::Real),
        }
    };
    let missing = || Problem::MissingSection { section: SECTION.join(".") };
    let control = document.section(&SECTION, own)?;
    let control = control.ok_or_else(|| document.error_at(&SECTION, missing()))?;
    Ok(ControllerConfig { control, compensations_active })
}
