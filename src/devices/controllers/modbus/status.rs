//! Status of the control: one block of registers, read in one request.

use std::collections::BTreeMap;

use super::map::{Register, ResultRegisters, WindowRegisterMap};
use crate::controllers::ControllerError;
use link::modbus::value::RegisterValueError;
use machine::{Axis, Position};

/// Version of the window's layout with lines; `PROGRAM_WINDOW_VERSION`: with a resident program.
pub(super) const LINE_WINDOW_VERSION: u16 = 1;
pub(super) const PROGRAM_WINDOW_VERSION: u16 = 101;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WindowState {
    NotReady,
    Idle,
    Running,
    Held,
    Alarm,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct WindowStatus {
    pub state: WindowState,
    pub alarm_code: u16,
    /// Last sequence number that the control has checked; `refusal_code` is why it refused it (0: accepted).
    pub accepted_sequence: u16,
    pub refusal_code: u16,
    /// Last sequence number whose execution is complete.
    pub executed_sequence: u16,
    pub is_probe_closed: bool,
    /// One bit for each input: A is bit 0, B is bit 1.
    pub input_bits: u32,
    /// Number of contacts so far; with a resident program, number of results.
    pub latch_count: u16,
    pub heartbeat: u16,
    /// Present time of the control's clock, s, if it is reported.
    pub time_s: Option<f64>,
    pub latch_time_s: Option<f64>,
    pub latched_position: Position,
    pub position: Position,
    /// Result of a resident program.
    pub result: Option<ReportedResult>,
}

/// Result that a resident program hands over: the status' `latch_count` is its number, `latched_position` the position
/// of the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ReportedResult {
    /// Row that the program executes, from 1; 0: none.
    pub active_row: u16,
    /// Sequence number of the call to which the result belongs; `row` is its row.
    pub call_sequence: u16,
    pub row: u16,
    pub has_contact: bool,
    /// Whether the result is not acknowledged yet.
    pub is_pending: bool,
}

impl WindowStatus {
    /// Parses a block; `None` if it was written during the read.
    ///
    /// # Errors
    /// A register has an invalid value.
    pub(super) fn parse(map: &WindowRegisterMap, block: &[u16]) -> Result<Option<Self>, ControllerError> {
        let (first, _) = map.status.block_range();
        let block = StatusBlock { block, first };
        let status = &map.status;
        if block.read_count("sequence_head", &status.sequence_head)?
            != block.read_count("sequence_tail", &status.sequence_tail)?
        {
            return Ok(None);
        }
        let version = block.read_count("version", &status.version)?;
        let expected = if status.result.is_some() { PROGRAM_WINDOW_VERSION } else { LINE_WINDOW_VERSION };
        if version != expected {
            return Err(window_error(format!("the window has version {version}, not {expected}")));
        }
        Ok(Some(Self {
            state: parse_state(block.read_count("state", &status.state)?)?,
            alarm_code: block.read_count("alarm", &status.alarm)?,
            accepted_sequence: block.read_count("accepted", &status.accepted)?,
            refusal_code: block.read_count("error", &status.error)?,
            executed_sequence: block.read_count("executed", &status.executed)?,
            is_probe_closed: block.read_count("probe", &status.probe)? != 0,
            // The conversion saturates: a value beyond the register's 32 bits is no set of inputs.
            input_bits: block.read_number("inputs", &status.inputs)? as u32,
            latch_count: block.read_count("latches", &status.latches)?,
            heartbeat: block.read_count("heartbeat", &status.heartbeat)?,
            time_s: block.read_timestamp("time_s", &status.time_s)?,
            latch_time_s: block.read_timestamp("latch_time_s", &status.latch_time_s)?,
            latched_position: block.read_axes("latch", &status.latch)?,
            position: block.read_axes("position", &status.position)?,
            result: status.result.as_ref().map(|result| block.read_result(result)).transpose()?,
        }))
    }
}

fn parse_state(code: u16) -> Result<WindowState, ControllerError> {
    Ok(match code {
        0 => WindowState::NotReady,
        1 => WindowState::Idle,
        2 => WindowState::Running,
        3 => WindowState::Held,
        4 => WindowState::Alarm,
        other => return Err(window_error(format!("the state {other} is unknown"))),
    })
}

struct StatusBlock<'a> {
    block: &'a [u16],
    first: u16,
}

impl StatusBlock<'_> {
    fn read_number(&self, name: &str, register: &Register) -> Result<f64, ControllerError> {
        let value_error = |error: RegisterValueError| window_error(format!("`status.{name}`: {error}"));
        register.read(self.block, self.first).map_err(value_error)
    }

    fn read_count(&self, name: &str, register: &Register) -> Result<u16, ControllerError> {
        let value = self.read_number(name, register)?;
        if value.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&value) {
            return Ok(value as u16);
        }
        Err(window_error(format!("`status.{name}` is {value}, not a whole number from 0 to 65535")))
    }

    fn read_result(&self, result: &ResultRegisters) -> Result<ReportedResult, ControllerError> {
        Ok(ReportedResult {
            active_row: self.read_count("result.under_way", &result.under_way)?,
            call_sequence: self.read_count("result.sequence", &result.sequence)?,
            row: self.read_count("result.row", &result.row)?,
            has_contact: self.read_count("result.contact", &result.contact)? != 0,
            is_pending: self.read_count("result.valid", &result.valid)? != 0,
        })
    }

    /// Reads a timestamp, s; 0: the control has none.
    fn read_timestamp(&self, name: &str, register: &Register) -> Result<Option<f64>, ControllerError> {
        self.read_number(name, register).map(|seconds| (seconds != 0.0).then_some(seconds))
    }

    fn read_axes(&self, name: &str, registers: &BTreeMap<Axis, Register>) -> Result<Position, ControllerError> {
        let value = |(axis, register): (&Axis, &Register)| {
            let edge = self.read_number(&format!("{name}.{axis}"), register)?;
            Ok((*axis, axis.to_mm_or_rad(edge)))
        };
        registers.iter().map(value).collect()
    }
}

fn window_error(state: String) -> ControllerError {
    ControllerError::UnexpectedDevice {
        state,
        remedy: "compare [controller.registers] with the control's program: addresses, `type`, \
                 `order`, `scale`, `space` (docs/line-window.md, docs/resident-program.md)"
            .to_owned(),
    }
}
