//! Opens and diagnoses the control that a `[controller]` table of kind `modbus` describes.

use std::sync::Arc;

use super::{Config, ModbusControl};
use crate::controllers::{Controller, ControllerError, Diagnosing, Leave, Named, Opening};
use link::Clock;
use machine::record::machine::Machine;
use planning::proof::ProvenModes;

impl Named for Config {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn at(&self) -> String {
        self.device.in_full()
    }

    fn open<'a>(
        &'a self,
        machine: &'a Machine,
        modes: ProvenModes,
        _clock: Arc<dyn Clock>,
    ) -> Opening<'a> {
        Box::pin(async move {
            let (driver, halt) = ModbusControl::open(self, machine, modes).await?;
            Ok(Controller::spawn(driver, halt))
        })
    }

    fn diagnose<'a>(
        &'a self,
        machine: &'a Machine,
        failed: &'a ControllerError,
        leave: Leave,
    ) -> Diagnosing<'a> {
        Box::pin(self.suspects(machine, failed, leave))
    }
}
