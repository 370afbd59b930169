//! Opens and diagnoses the control that a `[controller]` table of kind `modbus` describes.

use std::sync::Arc;

use super::{ModbusConfig, ModbusControl};
use crate::controllers::{Controller, ControllerConfig, ControllerError, DiagnosisFuture, DiagnosisMode, OpenFuture};
use link::Clock;
use machine::record::machine::Machine;
use planning::proof::ProvenModes;

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

    fn diagnose<'a>(
        &'a self,
        machine: &'a Machine,
        failure: &'a ControllerError,
        mode: DiagnosisMode,
    ) -> DiagnosisFuture<'a> {
        Box::pin(self.diagnose_failure(machine, failure, mode))
    }
}
