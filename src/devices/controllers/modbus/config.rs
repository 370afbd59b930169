//! Keys of `[controller]` of kind `modbus`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::program::{self, ResidentProgram};
use super::{CONTROL_KIND, ModbusControl, RegisterMap, map};
use crate::controllers::{
    ControlDescription, Controller, ControllerConfig, DiagnosisFuture, DiagnosisRequest, OpenFuture,
};
use link::modbus::{Framing, ModbusDevice, ModbusDeviceKeys, Parity};
use link::{Clock, HostPort};
use machine::record::machine::Machine;
use planning::proof::ProvenModes;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModbusConfigKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    timeout_s: Option<f64>,
    #[serde(default = "default_dialect")]
    dialect: String,
    registers: Option<map::keys::RegisterMapKeys>,
    program: Option<program::ProgramKeys>,
}

fn default_dialect() -> String {
    "grbl-m19".to_owned()
}

#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ModbusConfigKeys")]
pub struct ModbusConfig {
    pub(super) device: ModbusDevice,
    pub(super) map: RegisterMap,
    /// Resident program behind the window, used instead of lines.
    pub(super) program: Option<Arc<ResidentProgram>>,
    pub(super) dialect: String,
}

impl TryFrom<ModbusConfigKeys> for ModbusConfig {
    type Error = String;

    fn try_from(keys: ModbusConfigKeys) -> Result<Self, String> {
        let device = ModbusDeviceKeys {
            serial: keys.serial,
            serial_id: keys.serial_id,
            baud: keys.baud,
            parity: keys.parity,
            tcp: keys.tcp,
            framing: keys.framing,
            unit: keys.unit,
            timeout_s: keys.timeout_s,
        };
        let registers = keys.registers.unwrap_or_default();
        let Some(program) = keys.program else {
            let (device, map) = (device.try_into()?, registers.try_into()?);
            return Ok(Self { device, map, program: None, dialect: keys.dialect });
        };
        let (device, map) = (device.try_into()?, registers.into_program_map()?);
        let program = Some(Arc::new(ResidentProgram::from_keys(program, &map)?));
        Ok(Self { device, map, program, dialect: keys.dialect })
    }
}

impl ModbusConfig {
    pub const DESCRIPTION: ControlDescription = ControlDescription {
        kind: CONTROL_KIND,
        hold_hint: "Modbus: hold in [controller.registers.command] (docs/line-window.md)",
        axis_direction_hint: None,
        axis_scale_hint: None,
    };
}

impl ControllerConfig for ModbusConfig {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn describe_address(&self) -> String {
        self.device.describe()
    }

    fn open<'a>(&'a self, machine: &'a Machine, modes: ProvenModes, _clock: Arc<dyn Clock>) -> OpenFuture<'a> {
        Box::pin(async move {
            let (driver, halt) = ModbusControl::open(self, machine, modes).await?;
            Ok(Controller::spawn(driver, halt))
        })
    }

    fn diagnose<'a>(&'a self, request: DiagnosisRequest<'a>) -> DiagnosisFuture<'a> {
        Box::pin(self.diagnose_failure(request))
    }
}
