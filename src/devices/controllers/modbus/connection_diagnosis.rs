//! Finds out why no control answers behind the window, or why its answers make no sense. Only reads, at
//! first under the configured unit number; other units, baud rates and protocols are tried only if the operator
//! permits it.

use std::time::Duration;

use tokio::time::sleep;

use super::map::WindowRegisterMap;
use super::status::{LINE_WINDOW_VERSION, PROGRAM_WINDOW_VERSION};
use super::{CONTROL_KIND, ModbusConfig, format_diagnosis};
use crate::controllers::{
    ConnectionDiagnosisRequest, ControllerError, DiagnosisMode, PossibleCause, port_diagnosis, port_scan,
};
use link::modbus::{
    AccessList, Framing, ModbusClient, ModbusError, ModbusLineConfig, Parity, RegisterRange, RegisterSpace,
};
use link::{LinkAddress, LinkConfig};
use machine::record::machine::Machine;

/// Unit numbers that are tried on a serial line. Each takes a quarter of a second without an answer.
const RTU_UNIT_CANDIDATES: std::ops::RangeInclusive<u8> = 1..=16;
/// Unit identifiers that are tried over TCP, in this order.
const TCP_UNIT_CANDIDATES: [u8; 4] = [255, 1, 0, 2];
/// Time within which a heartbeat of one beat a second must change.
const HEARTBEAT_CHECK_TIME: Duration = Duration::from_millis(1200);

impl ModbusConfig {
    /// Possible causes of the failure in `request`. Other units, settings and protocols are tried only in the mode
    /// `OtherSettings`, and only if the control does not answer.
    pub(super) async fn find_possible_causes(&self, request: ConnectionDiagnosisRequest<'_>) -> Vec<PossibleCause> {
        let ConnectionDiagnosisRequest { machine, failure, mode } = request;
        use ControllerError as E;
        let link_findings = port_diagnosis::diagnose_open_failure(&self.device.line.link, failure);
        match failure {
            E::Modbus(ModbusError::ExceptionReply { .. })
            | E::UnexpectedDevice { .. }
            | E::WrongPosition { .. }
            | E::UnreadableReply { .. } => self.diagnose_register_map(machine, mode).await,
            E::ControlFrozen => self.diagnose_heartbeat().await,
            E::Modbus(
                ModbusError::Timeout { .. }
                | ModbusError::UnexpectedReply { .. }
                | ModbusError::LineNotCleared { .. }
                | ModbusError::ConnectionLost { .. },
            )
            | E::NoAnswer { .. } => match mode {
                DiagnosisMode::ConfiguredSettings => vec![self.passive_diagnosis(failure)],
                DiagnosisMode::OtherSettings => self.search_answering_settings(failure).await,
            },
            _ => link_findings,
        }
    }

    /// Opens a connection that may only read, at any address.
    async fn open_read_only(&self) -> Result<ModbusClient, ModbusError> {
        let all = |space| RegisterRange { space, first: 0, last: u16::MAX };
        let read = vec![all(RegisterSpace::Input), all(RegisterSpace::Holding)];
        ModbusClient::open(self.device.line.clone(), self.device.settings(AccessList::read_only(read))).await
    }

    /// Finds out why the control answers but its status is refused: format, addresses or kind of the window. Empty if
    /// the status is valid and its positions are plausible.
    async fn diagnose_register_map(&self, machine: &Machine, mode: DiagnosisMode) -> Vec<PossibleCause> {
        let Ok(modbus) = self.open_read_only().await else { return Vec::new() };
        let block = read_status_block(&modbus, &self.map).await;
        if let Some(block) = block.filter(|block| format_diagnosis::is_valid_status(&self.map, block)) {
            if format_diagnosis::are_positions_plausible(&self.map, &block, machine) {
                return Vec::new();
            }
            return format_diagnosis::diagnose_position_format(&self.map, &block, machine);
        }
        if let Some(other) = diagnose_window_kind(&modbus, &self.map).await {
            return vec![other];
        }
        if mode == DiagnosisMode::ConfiguredSettings {
            return vec![wrong_address_diagnosis().before_search()];
        }
        for (shift, in_other_space) in format_diagnosis::STATUS_SHIFT_CANDIDATES {
            let shifted = format_diagnosis::shifted_status_range(&self.map.status, shift, in_other_space);
            let Some(shifted) = shifted else { continue };
            let Ok(block) = modbus.read(shifted.space, shifted.first, shifted.count).await else { continue };
            if format_diagnosis::is_valid_status(&self.map, &block) {
                return vec![format_diagnosis::shifted_status_diagnosis(&shifted, shift, in_other_space)];
            }
        }
        vec![wrong_address_diagnosis()]
    }

    /// Finds out why the heartbeat does not change: the control's program has stopped, or, if other registers of the
    /// status change, the configured address is wrong.
    async fn diagnose_heartbeat(&self) -> Vec<PossibleCause> {
        let Ok(modbus) = self.open_read_only().await else { return Vec::new() };
        let Some(before) = read_status_block(&modbus, &self.map).await else { return Vec::new() };
        sleep(HEARTBEAT_CHECK_TIME).await;
        let Some(after) = read_status_block(&modbus, &self.map).await else { return Vec::new() };
        let registers = &self.map.status;
        let (first, _) = registers.block_first_and_count();
        let heartbeat_address = registers.heartbeat.address;
        let frame_addresses = [registers.sequence_head.address, registers.sequence_tail.address];
        let changed = (first..).zip(before.iter().zip(&after)).filter(|(_, (old, new))| old != new);
        let changed: Vec<u16> =
            changed.map(|(at, _)| at).filter(|at| !frame_addresses.contains(at) && *at != heartbeat_address).collect();
        vec![match changed.as_slice() {
            [] => stopped_program_diagnosis(heartbeat_address),
            changed => wrong_heartbeat_diagnosis(heartbeat_address, changed),
        }]
    }

    /// Suspected cause of a missing or wrong reply, while no search for other settings is permitted.
    fn passive_diagnosis(&self, failure: &ControllerError) -> PossibleCause {
        let (cause, remedy) = match self.device.line.link {
            LinkConfig::Tcp(_) => (
                format!("wrong unit ({}), wrong port, or another kind of control", self.device.unit),
                "compare [controller] unit, tcp and kind with the control's manual, or permit the search for other settings",
            ),
            _ => (
                format!("wrong unit ({}), baud rate, parity or port, or another kind of control", self.device.unit),
                "compare [controller] unit, baud, parity and serial with the control's manual, or permit the \
                 search for other settings",
            ),
        };
        PossibleCause::suspected(cause, failure.to_string(), remedy).before_search()
    }

    /// Searches for other units, settings and protocols that answer. If none answers, the cause is that no known
    /// control is at the address.
    async fn search_answering_settings(&self, failure: &ControllerError) -> Vec<PossibleCause> {
        let found = match self.device.line.link.resolve_address() {
            Ok(LinkAddress::Serial { path, baud }) => self.search_answering_serial_settings(&path, baud).await,
            Ok(LinkAddress::Tcp { .. }) => self.search_answering_tcp_settings().await,
            Err(_) => None,
        };
        let at = self.device.line.to_string();
        let evidence =
            || format!("{failure}; requests with other unit numbers and in other protocols also had no valid reply");
        vec![found.unwrap_or_else(|| port_scan::no_known_control_diagnosis(&at, &evidence()))]
    }

    /// Tries other units, then other parities, then other baud rates, then other kinds of control; returns the first
    /// that answers.
    async fn search_answering_serial_settings(&self, path: &str, baud: u32) -> Option<PossibleCause> {
        for unit in RTU_UNIT_CANDIDATES.filter(|unit| *unit != self.device.unit) {
            if port_scan::has_modbus_unit(&self.device.line, unit).await {
                return Some(wrong_unit_diagnosis(self.device.unit, unit));
            }
        }
        for parity in [Parity::Even, Parity::None, Parity::Odd] {
            let line = ModbusLineConfig { parity, ..self.device.line.clone() };
            if parity != self.device.line.parity && port_scan::has_modbus_unit(&line, self.device.unit).await {
                let key = format!("parity = \"{parity:?}\"").to_lowercase();
                return Some(wrong_line_settings_diagnosis("wrong parity", &key));
            }
        }
        for other in port_scan::BAUD_RATES.into_iter().filter(|rate| *rate != baud) {
            let at = LinkConfig::Serial { path: path.into(), baud: other };
            for parity in [self.device.line.parity, Parity::Even, Parity::None] {
                let line = ModbusLineConfig { link: at.clone(), parity, ..self.device.line.clone() };
                if port_scan::has_modbus_unit(&line, self.device.unit).await {
                    let parity = format!("{parity:?}").to_lowercase();
                    let keys = format!("baud = {other}, parity = \"{parity}\"");
                    let cause = format!("wrong baud rate: the device replies at {other} baud, not at {baud}");
                    return Some(wrong_line_settings_diagnosis(&cause, &keys));
                }
            }
        }
        port_scan::scan_serial(path, baud, CONTROL_KIND).await
    }

    /// Tries other units, then the other framing, then other kinds of control; returns the first that answers.
    async fn search_answering_tcp_settings(&self) -> Option<PossibleCause> {
        for unit in TCP_UNIT_CANDIDATES.into_iter().filter(|unit| *unit != self.device.unit) {
            if port_scan::has_modbus_unit(&self.device.line, unit).await {
                return Some(wrong_unit_diagnosis(self.device.unit, unit));
            }
        }
        let framing = if self.device.line.framing == Framing::Tcp { Framing::Rtu } else { Framing::Tcp };
        let line = ModbusLineConfig { framing, ..self.device.line.clone() };
        if port_scan::has_modbus_unit(&line, self.device.unit).await {
            let key = format!("framing = \"{framing:?}\"").to_lowercase();
            return Some(wrong_line_settings_diagnosis("wrong framing: the converter uses another framing", &key));
        }
        port_scan::scan_tcp(&self.device.line.link, CONTROL_KIND).await
    }
}

/// Reads the words of the status without checking them; `None` if the read fails.
async fn read_status_block(modbus: &ModbusClient, map: &WindowRegisterMap) -> Option<Vec<u16>> {
    let (first, count) = map.status.block_first_and_count();
    modbus.read(map.status.space, first, count).await.ok()
}

/// Suspected cause: lines are configured, but a resident program is behind the window; or the reverse.
async fn diagnose_window_kind(modbus: &ModbusClient, map: &WindowRegisterMap) -> Option<PossibleCause> {
    let at = &map.status.window_version;
    let block = modbus.read(map.status.space, at.address, at.register_count()).await.ok()?;
    let version = at.decode_from_block(&block, at.address).ok()?;
    let lines = map.status.result.is_none();
    let (cause, remedy) = if lines && version == f64::from(PROGRAM_WINDOW_VERSION) {
        (
            "the control runs a resident program, but [controller.program] is missing",
            "add [controller.program] to the machine file (docs/resident-program.md)",
        )
    } else if !lines && version == f64::from(LINE_WINDOW_VERSION) {
        (
            "the control accepts lines and runs no resident program, but [controller.program] is set",
            "remove [controller.program] from the machine file (docs/line-window.md)",
        )
    } else {
        return None;
    };
    let evidence = format!("the window reports version {version}");
    Some(PossibleCause::suspected(cause, evidence, remedy))
}

fn wrong_unit_diagnosis(configured: u8, actual: u8) -> PossibleCause {
    PossibleCause::observed(
        format!("wrong unit: a device replies as unit {actual}, no device as unit {configured}"),
        format!("unit {actual} replied to a read of one register"),
        format!("if that device is the control, set [controller] unit = {actual}"),
    )
}

fn wrong_line_settings_diagnosis(cause: &str, keys: &str) -> PossibleCause {
    PossibleCause::observed(
        cause.to_owned(),
        format!("with {keys} the device replies"),
        format!("in the machine file, set [controller] {keys}"),
    )
}

fn wrong_address_diagnosis() -> PossibleCause {
    PossibleCause::suspected(
        "wrong addresses, wrong space, or a program in the control that provides another window",
        "the registers contain no valid status: head and tail, version or state do not agree",
        "compare [controller.registers] with the control's program (docs/line-window.md); addresses \
         in the machine file count from 0",
    )
}

fn stopped_program_diagnosis(heartbeat_address: u16) -> PossibleCause {
    PossibleCause::observed(
        "the control's program is stopped: only its Modbus server replies",
        format!("the status does not change, and the heartbeat (register {heartbeat_address}) has stopped"),
        "start the program in the control or PLC (RUN), then try again",
    )
}

fn wrong_heartbeat_diagnosis(heartbeat_address: u16, changed: &[u16]) -> PossibleCause {
    let list: Vec<String> = changed.iter().map(u16::to_string).collect();
    let list = list.join(", ");
    PossibleCause::suspected(
        format!("wrong address of the heartbeat: register {heartbeat_address} does not change, but the control runs"),
        format!("register {list} changes without a command"),
        format!(
            "[controller.registers.status] heartbeat = {{ address = ... }}: one of {list}, as in the control's \
             program"
        ),
    )
}
