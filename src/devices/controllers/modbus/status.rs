//! Status of the control: one block of registers, read in one request.

use std::collections::BTreeMap;

use super::map::{Register, ResultRegisters, WindowRegisterMap};
use crate::controllers::ControllerError;
use link::modbus::number_format::RegisterValueError;
use machine::{Axis, Position};

/// Version of the window layout for lines.
pub(super) const LINE_WINDOW_VERSION: u16 = 1;
/// Version of the window layout for a resident program.
pub(super) const PROGRAM_WINDOW_VERSION: u16 = 101;

/// State that the control reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WindowState {
    NotReady,
    Idle,
    Running,
    Held,
    Alarm,
}

/// Consistent status of the control, read in one request.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WindowStatus {
    pub state: WindowState,
    /// Code of the alarm; in the state `Held`, the reason of the hold.
    pub alarm_code: u16,
    /// Last sequence number that the control has checked, accepted or refused.
    pub checked_sequence: u16,
    /// Reason why `checked_sequence` was refused; 0: accepted.
    pub refusal_code: u16,
    /// Last sequence number whose execution is complete.
    pub executed_sequence: u16,
    pub is_probe_closed: bool,
    /// One bit for each input: A is bit 0, B is bit 1.
    pub input_bits: u32,
    /// Number of contacts so far; with a resident program, number of results.
    pub latch_count: u16,
    /// Heartbeat of the control's program.
    pub heartbeat: u16,
    /// Present time of the control's clock, s, if it is reported.
    pub control_time_s: Option<f64>,
    /// Time of the last contact on the control's clock, s, if it is reported.
    pub latch_time_s: Option<f64>,
    /// Position at the last contact, mm and rad.
    pub latched_position: Position,
    /// Present position, mm and rad.
    pub position: Position,
    /// Result of a resident program; `None` for a window for lines.
    pub result: Option<ProgramRowResult>,
}

/// Result of a row that a resident program reports; `latch_count` of the status is the number of the result,
/// `latched_position` the position of the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ProgramRowResult {
    /// Row that the program executes, from 1; 0: none.
    pub active_row_number: u16,
    /// Sequence number of the call to which the result belongs.
    pub call_sequence: u16,
    /// Row to which the result belongs, from 1.
    pub row_number: u16,
    pub has_contact: bool,
    /// Whether the result is not acknowledged yet.
    pub is_unacknowledged: bool,
}

impl WindowStatus {
    /// Parses a block of status registers; `None` if the control wrote the block during the read.
    ///
    /// # Errors
    /// The window has another version, the state is unknown, or a register has an invalid value.
    pub(super) fn parse(map: &WindowRegisterMap, block: &[u16]) -> Result<Option<Self>, ControllerError> {
        let (first, _) = map.status.block_first_and_count();
        let block = StatusRegisterBlock { words: block, first_address: first };
        let status = &map.status;
        if block.read_u16("sequence_head", &status.sequence_head)?
            != block.read_u16("sequence_tail", &status.sequence_tail)?
        {
            return Ok(None);
        }
        let version = block.read_u16("version", &status.window_version)?;
        let expected = if status.result.is_some() { PROGRAM_WINDOW_VERSION } else { LINE_WINDOW_VERSION };
        if version != expected {
            return Err(unexpected_window_error(format!("the window has version {version}, not {expected}")));
        }
        Ok(Some(Self {
            state: parse_window_state(block.read_u16("state", &status.state)?)?,
            alarm_code: block.read_u16("alarm", &status.alarm_code)?,
            checked_sequence: block.read_u16("accepted", &status.checked_sequence)?,
            refusal_code: block.read_u16("error", &status.refusal_code)?,
            executed_sequence: block.read_u16("executed", &status.executed_sequence)?,
            is_probe_closed: block.read_u16("probe", &status.probe_closed_flag)? != 0,
            // The conversion saturates: a value beyond the register's 32 bits is not a valid set of inputs.
            input_bits: block.read_number("inputs", &status.input_bits)? as u32,
            latch_count: block.read_u16("latches", &status.latch_count)?,
            heartbeat: block.read_u16("heartbeat", &status.heartbeat)?,
            control_time_s: block.read_timestamp("time_s", &status.control_time_s)?,
            latch_time_s: block.read_timestamp("latch_time_s", &status.latch_time_s)?,
            latched_position: block.read_axis_positions("latch", &status.latched_position)?,
            position: block.read_axis_positions("position", &status.position)?,
            result: status.result.as_ref().map(|result| block.read_result(result)).transpose()?,
        }))
    }
}

fn parse_window_state(code: u16) -> Result<WindowState, ControllerError> {
    Ok(match code {
        0 => WindowState::NotReady,
        1 => WindowState::Idle,
        2 => WindowState::Running,
        3 => WindowState::Held,
        4 => WindowState::Alarm,
        other => return Err(unexpected_window_error(format!("the state {other} is unknown"))),
    })
}

/// Registers of the status as they were read, and the address of the first.
struct StatusRegisterBlock<'a> {
    words: &'a [u16],
    first_address: u16,
}

impl StatusRegisterBlock<'_> {
    /// Reads the number of a register, with its scale applied; `name` is its key in errors.
    fn read_number(&self, name: &str, register: &Register) -> Result<f64, ControllerError> {
        let value_error = |error: RegisterValueError| unexpected_window_error(format!("`status.{name}`: {error}"));
        register.decode_from_block(self.words, self.first_address).map_err(value_error)
    }

    fn read_u16(&self, name: &str, register: &Register) -> Result<u16, ControllerError> {
        let value = self.read_number(name, register)?;
        if value.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&value) {
            return Ok(value as u16);
        }
        Err(unexpected_window_error(format!("`status.{name}` is {value}, not a whole number from 0 to 65535")))
    }

    fn read_result(&self, result: &ResultRegisters) -> Result<ProgramRowResult, ControllerError> {
        Ok(ProgramRowResult {
            active_row_number: self.read_u16("result.under_way", &result.active_row_number)?,
            call_sequence: self.read_u16("result.sequence", &result.call_sequence)?,
            row_number: self.read_u16("result.row", &result.row_number)?,
            has_contact: self.read_u16("result.contact", &result.contact_flag)? != 0,
            is_unacknowledged: self.read_u16("result.valid", &result.unacknowledged_flag)? != 0,
        })
    }

    /// Reads a timestamp, s; 0: the control has none.
    fn read_timestamp(&self, name: &str, register: &Register) -> Result<Option<f64>, ControllerError> {
        self.read_number(name, register).map(|seconds| (seconds != 0.0).then_some(seconds))
    }

    /// Reads the position of each axis; converts degrees to rad.
    fn read_axis_positions(
        &self,
        name: &str,
        registers: &BTreeMap<Axis, Register>,
    ) -> Result<Position, ControllerError> {
        let value = |(axis, register): (&Axis, &Register)| {
            let mm_or_deg = self.read_number(&format!("{name}.{axis}"), register)?;
            Ok((*axis, axis.to_mm_or_rad(mm_or_deg)))
        };
        registers.iter().map(value).collect()
    }
}

fn unexpected_window_error(state: String) -> ControllerError {
    ControllerError::UnexpectedDevice {
        state,
        remedy: "compare [controller.registers] with the control's program: addresses, `type`, \
                 `order`, `scale`, `space` (docs/line-window.md, docs/resident-program.md)"
            .to_owned(),
    }
}
