//! `[controller]` of kind `modbus`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;

use super::program::{self, Program};
use super::{Map, ModbusControl, map};
use crate::base::Clock;
use crate::controllers::{Controller, ControllerError, Diagnosing, Leave, Named, Opening};
use crate::gcode::Dialect;
use crate::link::modbus::{Framing, Line, Parity};
use crate::link::{self, HostPort};
use crate::record::machine::Machine;

/// Baud rate and parity as the Modbus serial line specification has them by default.
const USUAL_BAUD: u32 = 19_200;
/// Where nobody forwards, a TCP device answers this one.
const USUAL_TCP_UNIT: u8 = 255;
const USUAL_RTU_UNIT: u8 = 1;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    #[serde(default = "timeout_s")]
    timeout_s: f64,
    #[serde(default = "dialect")]
    dialect: String,
    registers: Option<map::keys::Keys>,
    program: Option<program::Keys>,
}

fn timeout_s() -> f64 {
    0.5
}

fn dialect() -> String {
    "grbl-m19".to_owned()
}

#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) line: Line,
    pub(super) unit: u8,
    pub(super) timeout: Duration,
    pub(super) map: Map,
    /// A resident program behind the window, instead of lines.
    pub(super) program: Option<Arc<Program>>,
    dialect: String,
}

impl Config {
    /// The published window at `at`, which somebody serves on this computer; `resident`: before the
    /// resident program.
    ///
    /// # Errors
    /// Never: tests see what is published pass its own check.
    pub(in crate::controllers) fn local(at: link::Named, resident: bool) -> Result<Self, String> {
        let program = resident.then(program::Keys::default);
        let (map, program) = window(map::keys::Keys::default(), program)?;
        let timeout = Duration::from_secs_f64(timeout_s());
        let (line, unit, dialect) = (Line::usual(at), USUAL_RTU_UNIT, dialect());
        Ok(Self { line, unit, timeout, map, program, dialect })
    }
}

type Behind = (Map, Option<Arc<Program>>);

/// The window, and what is behind it.
fn window(registers: map::keys::Keys, program: Option<program::Keys>) -> Result<Behind, String> {
    let Some(keys) = program else { return Ok((registers.try_into()?, None)) };
    let map = registers.of_program()?;
    let program = Program::of(keys, &map)?;
    Ok((map, Some(Arc::new(program))))
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys {
            serial,
            serial_id,
            baud,
            parity,
            tcp,
            framing,
            unit,
            timeout_s,
            dialect,
            registers,
            program,
        } = keys;
        let at = link::Named::of((serial, serial_id, tcp), baud, USUAL_BAUD)?;
        let line = Line::spoken(at, framing, parity)?;
        let framing = line.framing;
        let usual_unit = if framing == Framing::Tcp { USUAL_TCP_UNIT } else { USUAL_RTU_UNIT };
        let unit = unit.unwrap_or(usual_unit);
        if framing == Framing::Rtu && !(1..=247).contains(&unit) {
            return Err(format!("`unit` is {unit}; on RTU a device has a number from 1 to 247"));
        }
        let timeout = Some(timeout_s).filter(|seconds| (0.01..=30.0).contains(seconds));
        let timeout = timeout.ok_or("`timeout_s` is a time from 0.01 to 30")?;
        let (map, program) = window(registers.unwrap_or_default(), program)?;
        Ok(Self { line, unit, timeout: Duration::from_secs_f64(timeout), map, program, dialect })
    }
}

impl Named for Config {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn at(&self) -> String {
        format!("{}, unit {}", self.line.at.in_full(), self.unit)
    }

    fn open<'a>(
        &'a self,
        machine: &'a Machine,
        dialect: Dialect,
        _clock: Arc<dyn Clock>,
    ) -> Opening<'a> {
        Box::pin(async move {
            let (driver, halt) = ModbusControl::open(self, machine, dialect).await?;
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
