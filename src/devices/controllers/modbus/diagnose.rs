//! Finds out why no control answers behind the window, or why its answers make no sense. Only reads, at
//! first under the configured unit number; other units, baud rates and protocols are tried only if the operator
//! permits it.

use std::time::Duration;

use tokio::time::sleep;

use super::map::Map;
use super::status::{PROGRAM_VERSION, VERSION};
use super::{Config, KIND, otherwise};
use crate::controllers::{ControllerError, Diagnosis, Leave, port, port_scan};
use link::modbus::{Allowed, Framing, Line, Modbus, ModbusError, Parity, Range, Settings, Space};
use link::{Address, Named};
use machine::record::machine::Machine;

/// Unit numbers that are tried on a serial line. Each takes a quarter of a second without an answer.
const UNITS: std::ops::RangeInclusive<u8> = 1..=16;
const TCP_UNITS: [u8; 4] = [255, 1, 0, 2];
/// Time within which a heartbeat of one beat a second must change.
const BEAT: Duration = Duration::from_millis(1200);

impl Config {
    pub(super) async fn suspects(
        &self,
        machine: &Machine,
        failed: &ControllerError,
        leave: Leave,
    ) -> Vec<Diagnosis> {
        use ControllerError as E;
        let closed = port::suspects(&self.device.line.at, failed);
        match failed {
            E::Modbus(ModbusError::Refused { .. })
            | E::UnexpectedDevice { .. }
            | E::WrongPosition { .. }
            | E::Garbled { .. } => self.read_otherwise(machine, leave).await,
            E::Frozen => self.heart().await,
            E::Modbus(
                ModbusError::Late { .. }
                | ModbusError::Misfit { .. }
                | ModbusError::Unclear { .. }
                | ModbusError::Lost { .. },
            )
            | E::NoAnswer { .. } => match leave {
                Leave::Listen => vec![self.unasked(failed)],
                Leave::Ask => self.elsewhere(failed).await,
            },
            _ => closed,
        }
    }

    /// Opens a connection that may only read, at any address.
    async fn look(&self) -> Result<Modbus, ModbusError> {
        let all = |space| Range { space, first: 0, last: u16::MAX };
        let read = vec![all(Space::Input), all(Space::Holding)];
        let allowed = Allowed { read, write: Vec::new() };
        let settings = Settings { unit: self.device.unit, timeout: self.device.timeout, allowed };
        Modbus::open(self.device.line.clone(), settings).await
    }

    async fn read_otherwise(&self, machine: &Machine, leave: Leave) -> Vec<Diagnosis> {
        let Ok(modbus) = self.look().await else { return Vec::new() };
        let block = status(&modbus, &self.map).await;
        if let Some(block) = block.filter(|block| otherwise::is_status(&self.map, block)) {
            let fits = otherwise::fits(&self.map, &block, machine);
            return if fits { Vec::new() } else { otherwise::suspects(&self.map, &block, machine) };
        }
        if let Some(other) = other_window(&modbus, &self.map).await {
            return vec![other];
        }
        if leave == Leave::Listen {
            return vec![Diagnosis { vague: true, ..shifted() }];
        }
        for (by, other) in otherwise::STATUS_SHIFTS {
            let Some(map) = otherwise::moved(&self.map, by, other) else { continue };
            let Some(block) = status(&modbus, &map).await else { continue };
            if otherwise::is_status(&map, &block) {
                return vec![otherwise::elsewhere(&map, by, other)];
            }
        }
        vec![shifted()]
    }

    /// Finds the registers that change in a status whose heartbeat does not.
    async fn heart(&self) -> Vec<Diagnosis> {
        let Ok(modbus) = self.look().await else { return Vec::new() };
        let Some(before) = status(&modbus, &self.map).await else { return Vec::new() };
        sleep(BEAT).await;
        let Some(after) = status(&modbus, &self.map).await else { return Vec::new() };
        let places = &self.map.status;
        let (first, _) = places.block();
        let own = places.heartbeat.address;
        let frame = [places.sequence_head.address, places.sequence_tail.address];
        let changed = (first..).zip(before.iter().zip(&after)).filter(|(_, (old, new))| old != new);
        let changed: Vec<u16> =
            changed.map(|(at, _)| at).filter(|at| !frame.contains(at) && *at != own).collect();
        vec![match changed.as_slice() {
            [] => stopped(own),
            changed => other_heart(own, changed),
        }]
    }

    fn unasked(&self, failed: &ControllerError) -> Diagnosis {
        let (what, remedy) = match self.device.line.at {
            Named::Tcp(_) => (
                format!(
                    "wrong unit ({}), wrong port, or another kind of control",
                    self.device.unit
                ),
                "compare [controller] unit, tcp and kind with the control's manual, or let others be tried",
            ),
            _ => (
                format!(
                    "wrong unit ({}), speed, parity or port, or another kind of control",
                    self.device.unit
                ),
                "compare [controller] unit, baud, parity and serial with the control's manual, or let others \
                 be tried",
            ),
        };
        Diagnosis {
            seen: false,
            vague: true,
            what,
            because: failed.to_string(),
            remedy: remedy.to_owned(),
        }
    }

    /// Searches for other units, settings and protocols that answer.
    async fn elsewhere(&self, failed: &ControllerError) -> Vec<Diagnosis> {
        let found = match self.device.line.at.address() {
            Ok(Address::Serial { path, baud }) => self.on_the_line(&path, baud).await,
            Ok(Address::Tcp { .. }) => self.behind_the_socket().await,
            Err(_) => None,
        };
        let at = self.device.line.to_string();
        let because =
            || format!("{failed}; asked under other numbers and in other languages as well");
        vec![found.unwrap_or_else(|| port_scan::no_known_device(&at, &because()))]
    }

    async fn on_the_line(&self, path: &str, baud: u32) -> Option<Diagnosis> {
        for unit in UNITS.filter(|unit| *unit != self.device.unit) {
            if port_scan::answers_modbus(&self.device.line, unit).await {
                return Some(wrong_unit(self.device.unit, unit));
            }
        }
        for parity in [Parity::Even, Parity::None, Parity::Odd] {
            let line = Line { parity, ..self.device.line.clone() };
            if parity != self.device.line.parity
                && port_scan::answers_modbus(&line, self.device.unit).await
            {
                return Some(wrong_line(
                    "wrong parity",
                    &format!("parity = \"{parity:?}\"").to_lowercase(),
                ));
            }
        }
        for other in port_scan::SPEEDS.into_iter().filter(|speed| *speed != baud) {
            let at = Named::Serial { path: path.into(), baud: other };
            for parity in [self.device.line.parity, Parity::Even, Parity::None] {
                let line = Line { at: at.clone(), parity, ..self.device.line.clone() };
                if port_scan::answers_modbus(&line, self.device.unit).await {
                    let parity = format!("{parity:?}").to_lowercase();
                    let keys = format!("baud = {other}, parity = \"{parity}\"");
                    let what =
                        format!("wrong baud rate: it answers at {other} baud, not at {baud}");
                    return Some(wrong_line(&what, &keys));
                }
            }
        }
        port_scan::on_serial(path, baud, KIND).await
    }

    async fn behind_the_socket(&self) -> Option<Diagnosis> {
        for unit in TCP_UNITS.into_iter().filter(|unit| *unit != self.device.unit) {
            if port_scan::answers_modbus(&self.device.line, unit).await {
                return Some(wrong_unit(self.device.unit, unit));
            }
        }
        let framing =
            if self.device.line.framing == Framing::Tcp { Framing::Rtu } else { Framing::Tcp };
        let line = Line { framing, ..self.device.line.clone() };
        if port_scan::answers_modbus(&line, self.device.unit).await {
            let key = format!("framing = \"{framing:?}\"").to_lowercase();
            return Some(wrong_line("wrong framing: the converter passes other frames on", &key));
        }
        port_scan::on_tcp(&self.device.line.at, KIND).await
    }
}

async fn status(modbus: &Modbus, map: &Map) -> Option<Vec<u16>> {
    let (first, count) = map.status.block();
    modbus.read(map.status.space, first, count).await.ok()
}

/// Suspected cause: lines are configured, but a resident program is behind the window; or the reverse.
async fn other_window(modbus: &Modbus, map: &Map) -> Option<Diagnosis> {
    let at = &map.status.version;
    let block = modbus.read(map.status.space, at.address, at.count()).await.ok()?;
    let version = at.read(&block, at.address).ok()?;
    let lines = map.status.result.is_none();
    let (what, remedy) = if lines && version == f64::from(PROGRAM_VERSION) {
        (
            "a resident program is behind the window, and [controller] tells of none",
            "add [controller.program] to the machine file (docs/resident-program.md)",
        )
    } else if !lines && version == f64::from(VERSION) {
        (
            "lines are taken behind the window, no resident program",
            "take [controller.program] out of the machine file (docs/line-window.md)",
        )
    } else {
        return None;
    };
    let because = format!("it says that it is a window of version {version}");
    let (what, remedy) = (what.to_owned(), remedy.to_owned());
    Some(Diagnosis { seen: false, vague: false, what, because, remedy })
}

fn wrong_unit(wrong: u8, right: u8) -> Diagnosis {
    Diagnosis {
        seen: true,
        vague: false,
        what: format!("wrong unit: a device answers as unit {right}, none as {wrong}"),
        because: format!("a read of one register as unit {right} was answered"),
        remedy: format!("if that device is the control: [controller] unit = {right}"),
    }
}

fn wrong_line(what: &str, keys: &str) -> Diagnosis {
    Diagnosis {
        seen: true,
        vague: false,
        what: what.to_owned(),
        because: format!("with {keys} it answers"),
        remedy: format!("in the machine file: [controller] {keys}"),
    }
}

fn shifted() -> Diagnosis {
    Diagnosis {
        seen: false,
        vague: false,
        what: "wrong addresses, wrong space, or a program in the control that serves another window".to_owned(),
        because: "what is read there is no status: head and tail, version or state do not agree".to_owned(),
        remedy: "compare [controller.registers] with the control's program (docs/line-window.md); addresses \
                 count from 0 here"
            .to_owned(),
    }
}

fn stopped(own: u16) -> Diagnosis {
    Diagnosis {
        seen: true,
        vague: false,
        what: "the control's program is stopped: what answers is only its Modbus server".to_owned(),
        because: format!(
            "nothing in its status changes, and its heartbeat (register {own}) stands"
        ),
        remedy: "start the program in the control or PLC (RUN), then try again".to_owned(),
    }
}

fn other_heart(own: u16, changed: &[u16]) -> Diagnosis {
    let list: Vec<String> = changed.iter().map(u16::to_string).collect();
    let list = list.join(", ");
    Diagnosis {
        seen: false,
        vague: false,
        what: format!("wrong address of the heartbeat: register {own} stands, the control lives"),
        because: format!("register {list} changes by itself"),
        remedy: format!(
            "[controller.registers.status] heartbeat = {{ address = ... }}: one of {list}, by the control's \
             program"
        ),
    }
}
