//! What the control says of itself: one block of registers, read at once.

use std::collections::BTreeMap;

use super::map::{Map, Register, Results};
use crate::controllers::ControllerError;
use link::modbus::value::ValueError;
use machine::{Axis, Position};

/// Of this layout of the window: with lines, and with a resident program.
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
    /// The last sequence that the control has looked at, and why it refused it (0: taken).
    pub accepted: u16,
    pub error: u16,
    /// The last sequence that is done.
    pub executed: u16,
    pub probe_closed: bool,
    /// A bit an input: A is 0, B is 1.
    pub inputs: u32,
    /// Contacts so far; results of a resident program.
    pub latches: u16,
    pub heartbeat: u16,
    /// Now, where the control tells it.
    pub time_s: Option<f64>,
    pub latch_time_s: Option<f64>,
    pub latch: Position,
    pub position: Position,
    /// Of a resident program.
    pub result: Option<Shown>,
}

/// The result that a resident program hands over: the status' `latches` is its number, `latch` where
/// the axes were.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shown {
    /// The row that the program is at, from 1; 0: it is at none.
    pub under_way: u16,
    /// Call and row that the result is of.
    pub sequence: u16,
    pub row: u16,
    pub contact: bool,
    /// It was not acknowledged yet.
    pub valid: bool,
}

impl Status {
    /// From a block; `None` where it was written while it was read.
    ///
    /// # Errors
    /// Registers that hold something else than they should.
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
            // What is larger than its register's 32 bits is no set of inputs.
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

    /// 0: the control does not stamp.
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
    ControllerError::Strange {
        state,
        remedy: "compare [controller.registers] with the control's program: addresses, `type`, \
                 `order`, `scale`, `space` (docs/line-window.md, docs/resident-program.md)"
            .to_owned(),
    }
}
