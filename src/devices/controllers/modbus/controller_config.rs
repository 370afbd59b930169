//! Opens and diagnoses the control that a `[controller]` table of kind `modbus` describes.

use std::sync::Arc;

use super::{CONTROL_KIND, ModbusConfig, ModbusDriver};
use crate::controllers::{
    ConnectionDiagnosisRequest, ControlDescription, Controller, ControllerConfig, DiagnosisFuture, OpenFuture,
};
use link::Clock;
use machine::record::machine::Machine;
use planning::proof::ProvenModeText;

impl ModbusConfig {
    pub const DESCRIPTION: ControlDescription = ControlDescription {
        kind: CONTROL_KIND,
        hold_command_hint: "Modbus: hold in [controller.registers.command] (docs/line-window.md)",
        axis_direction_hint: None,
        steps_per_unit_hint: None,
    };
}

impl ControllerConfig for ModbusConfig {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn describe_address(&self) -> String {
        self.device.describe()
    }

    fn open<'a>(&'a self, machine: &'a Machine, modes: ProvenModeText, _clock: Arc<dyn Clock>) -> OpenFuture<'a> {
        Box::pin(async move {
            let (driver, halt) = ModbusDriver::open(self, machine, modes).await?;
            Ok(Controller::spawn(driver, halt))
        })
    }

    fn diagnose_connection<'a>(&'a self, request: ConnectionDiagnosisRequest<'a>) -> DiagnosisFuture<'a> {
        Box::pin(self.find_possible_causes(request))
    }
}
