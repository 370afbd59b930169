//! Status of the control: one block of registers, read in one request.

use std::collections::BTreeMap;

use super::map::{Map, Register, Results};
use crate::controllers::ControllerError;
use link::modbus::value::ValueError;
use machine::{Axis, Position};

/// Version of the window's layout with lines; `PROGRAM_VERSION`: with a resident program.
pub(super) const VERSION: u16 = 1;
pub(super) const PROGRAM_VERSION: u16 = 101;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    NotReady,
    Idle,
    Running,
    Held,
    Alarm,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Status {
    pub state: State,
    pub alarm: u16,
    /// Last sequence number that the control has checked; `error` is why it refused it (0: accepted).
    pub accepted: u16,
    pub error: u16,
    /// Last sequence number whose execution is complete.
    pub executed: u16,
    pub probe_closed: bool,
    /// One bit for each input: A is bit 0, B is bit 1.
    pub inputs: u32,
    /// Number of contacts so far; with a resident program, number of results.
    pub latches: u16,
    pub heartbeat: u16,
    /// Present time of the control's clock, s, if it is reported.
    pub time_s: Option<f64>,
    pub latch_time_s: Option<f64>,
    pub latch: Position,
    pub position: Position,
    /// Result of a resident program.
    pub result: Option<Shown>,
}

/// Result that a resident program hands over: the status' `latches` is its number, `latch` the position of
/// the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shown {
    /// Row that the program executes, from 1; 0: none.
    pub under_way: u16,
    /// Sequence number of the call to which the result belongs; `row` is its row.
    pub sequence: u16,
    pub row: u16,
    pub contact: bool,
    /// Whether the result is not acknowledged yet.
    pub valid: bool,
}

impl Status {
    /// Parses a block; `None` if it was written during the read.
    ///
    /// # Errors
    /// A register has an invalid value.
    pub(super) fn read(map: &Map, block: &[u16]) -> Result<Option<Self>, ControllerError> {
        let (first, _) = map.status.block();
        let at = Block { block, first };
        let status = &map.status;
        if at.count("sequence_head", &status.sequence_head)?
            != at.count("sequence_tail", &status.sequence_tail)?
        {
            return Ok(None);
        }
        let version = at.count("version", &status.version)?;
        let meant = if status.result.is_some() { PROGRAM_VERSION } else { VERSION };
        if version != meant {
            return Err(wrong(format!("its window says version {version}, not {meant}")));
        }
        Ok(Some(Self {
            state: state(at.count("state", &status.state)?)?,
            alarm: at.count("alarm", &status.alarm)?,
            accepted: at.count("accepted", &status.accepted)?,
            error: at.count("error", &status.error)?,
            executed: at.count("executed", &status.executed)?,
            probe_closed: at.count("probe", &status.probe)? != 0,
            // The conversion saturates: a value beyond the register's 32 bits is no set of inputs.
            inputs: at.number("inputs", &status.inputs)? as u32,
            latches: at.count("latches", &status.latches)?,
            heartbeat: at.count("heartbeat", &status.heartbeat)?,
            time_s: at.stamp("time_s", &status.time_s)?,
            latch_time_s: at.stamp("latch_time_s", &status.latch_time_s)?,
            latch: at.axes("latch", &status.latch)?,
            position: at.axes("position", &status.position)?,
            result: status.result.as_ref().map(|result| at.shown(result)).transpose()?,
        }))
    }
}

fn state(code: u16) -> Result<State, ControllerError> {
    Ok(match code {
        0 => State::NotReady,
        1 => State::Idle,
        2 => State::Running,
        3 => State::Held,
        4 => State::Alarm,
        other => return Err(wrong(format!("its state is {other}, which means nothing"))),
    })
}

struct Block<'a> {
    block: &'a [u16],
    first: u16,
}

impl Block<'_> {
    fn number(&self, name: &str, register: &Register) -> Result<f64, ControllerError> {
        let told = |error: ValueError| wrong(format!("`status.{name}`: {error}"));
        register.read(self.block, self.first).map_err(told)
    }

    fn count(&self, name: &str, register: &Register) -> Result<u16, ControllerError> {
        let value = self.number(name, register)?;
        if value.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&value) {
            return Ok(value as u16);
        }
        Err(wrong(format!("`status.{name}` is {value}, which is no count")))
    }

    fn shown(&self, result: &Results) -> Result<Shown, ControllerError> {
        Ok(Shown {
            under_way: self.count("result.under_way", &result.under_way)?,
            sequence: self.count("result.sequence", &result.sequence)?,
            row: self.count("result.row", &result.row)?,
            contact: self.count("result.contact", &result.contact)? != 0,
            valid: self.count("result.valid", &result.valid)? != 0,
        })
    }

    /// Reads a timestamp, s; 0: the control has none.
    fn stamp(&self, name: &str, register: &Register) -> Result<Option<f64>, ControllerError> {
        self.number(name, register).map(|seconds| (seconds != 0.0).then_some(seconds))
    }

    fn axes(
        &self,
        name: &str,
        registers: &BTreeMap<Axis, Register>,
    ) -> Result<Position, ControllerError> {
        let value = |(axis, register): (&Axis, &Register)| {
            let edge = self.number(&format!("{name}.{axis}"), register)?;
            Ok((*axis, axis.from_edge(edge)))
        };
        registers.iter().map(value).collect()
    }
}

fn wrong(state: String) -> ControllerError {
    ControllerError::UnexpectedDevice {
        state,
        remedy: "compare [controller.registers] with the control's program: addresses, `type`, \
                 `order`, `scale`, `space` (docs/line-window.md, docs/resident-program.md)"
            .to_owned(),
    }
}
