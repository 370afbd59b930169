//! The resident program of the simulated control: executes the rows of a table one after the other, each in at
//! least one scan, and shows a result until it is acknowledged. Register addresses come from
//! `docs/resident-program.md` alone.

use std::time::Duration;

use super::chunk::{ERROR_BAD_LENGTH, ERROR_BAD_ROW};
use super::layout::REGISTER_AXES;
use super::{ControlEvent, FaultKind, Firmware};
use crate::interpreter::Job;
use machine::{Axis, Position};

const RESIDENT_PROGRAM_NUMBER: u16 = 1;
/// Number of the tool in the spindle. The client sends 0 if it does not check the tool.
const TOOL_NUMBER: u16 = 1;
/// The table is for a program that the control does not have.
const ERROR_NO_SUCH_PROGRAM: u16 = 7;
/// The table requires a tool that is not in the spindle.
const ERROR_OTHER_TOOL: u16 = 8;

/// Size of a row, registers.
const REGISTERS_PER_ROW: usize = 16;
/// Positions in the table count in 0.0001 mm or degree, other values in 0.001.
const POSITION_STEPS_PER_UNIT: f64 = 10_000.0;
/// Feeds, dwell times and spindle angles in the table count in 0.001 mm/min, s or degree.
const FEED_TIME_ANGLE_STEPS_PER_UNIT: f64 = 1000.0;
/// Scan period of the control's program.
pub(super) const SCAN_PERIOD: Duration = Duration::from_millis(1);

/// Kind of a row of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
enum RowKind {
    Rapid,
    /// Move at a feed; a probe that is closed at its end raises an alarm.
    Feed,
    /// Probing move that should find no contact; a contact is published and ends the program.
    Guarded,
    /// Probing move that should find a contact; its result is published, and no contact ends the program.
    Touch,
    Dwell,
    /// Orientation of the spindle.
    Orient,
}

/// One row of the table.
#[derive(Debug, Clone)]
struct TableRow {
    kind: RowKind,
    /// Target of the axes that move, machine coordinates, mm or rad; empty for a dwell or an orientation.
    target: Position,
    /// Feed, mm/min, of a move; duration, s, of a dwell; spindle angle, degrees, of an orientation; unused for a
    /// rapid.
    feed_seconds_or_degrees: f64,
}

/// A result that the client can read, and must acknowledge before the next touch.
#[derive(Debug, Clone, Default)]
pub(super) struct ResultSlot {
    /// Number of the result, from 1 on, without 0 after the largest value; 0: no result yet.
    pub result_number: u16,
    /// Sequence number of the chunk whose program gave the result.
    pub chunk_sequence: u16,
    /// Row of the table, from 1.
    pub row_number: u16,
    pub has_contact: bool,
    /// Whether the result is not yet acknowledged.
    pub is_pending: bool,
    /// Last latched position; of an earlier contact if `has_contact` is false.
    pub latched_position: Position,
    /// Time of that latch, s.
    pub latch_time_s: f64,
}

/// The resident program: the table that it executes, its last results, and the faults that are due.
#[derive(Debug, Default)]
pub(super) struct SimulatedResidentProgram {
    rows: Vec<TableRow>,
    /// Number of the plan step that the table states; the key of the touch scatter.
    plan_step_number: u32,
    /// Current row, from 1; 0: none.
    pub current_row_number: usize,
    pub result_slot: ResultSlot,
    /// Result before the present one; `None`: there were fewer than two.
    pub previous_result_slot: Option<ResultSlot>,
    /// Fault: the next acknowledgement of a result is ignored.
    pub ignores_next_result_acknowledge: bool,
    /// Fault: the next result number is counted but never shown.
    pub skips_next_result: bool,
    /// Fault: the program starts once more where it should end.
    pub restarts_at_end: bool,
}

impl SimulatedResidentProgram {
    /// Whether there is a current row, even if it waits for the acknowledgement of a result.
    pub(super) fn is_running(&self) -> bool {
        self.current_row_number > 0
    }

    /// Ends the program and removes its table; the results stay.
    pub(super) fn stop(&mut self) {
        self.rows.clear();
        self.current_row_number = 0;
    }

    /// Handles a write of the register that acknowledges a result; only the number of the present result has an
    /// effect.
    pub(super) fn on_result_acknowledge_written(&mut self, number: u16) {
        if number == self.result_slot.result_number && !std::mem::take(&mut self.ignores_next_result_acknowledge) {
            self.result_slot.is_pending = false;
        }
    }

    /// The current row.
    fn current_row(&self) -> Option<&TableRow> {
        self.current_row_number.checked_sub(1).and_then(|index| self.rows.get(index))
    }

    /// Advances to the next row; returns whether there is one.
    fn advance_to_next_row(&mut self) -> bool {
        self.current_row_number =
            if self.current_row_number < self.rows.len() { self.current_row_number + 1 } else { 0 };
        self.current_row_number > 0
    }
}

impl Firmware {
    /// Starts the program with a complete table; returns the text for the event log, or the error code.
    pub(super) fn start_program(&mut self, sequence: u16, words: &[u16]) -> Result<String, u16> {
        let [bound, number, tool, high, low, touches, count, _, table @ ..] = words else {
            return Err(ERROR_BAD_LENGTH);
        };
        if *number != RESIDENT_PROGRAM_NUMBER {
            return Err(ERROR_NO_SUCH_PROGRAM);
        }
        if ![0, TOOL_NUMBER].contains(tool) {
            return Err(ERROR_OTHER_TOOL);
        }
        if table.len() != REGISTERS_PER_ROW * usize::from(*count) || table.is_empty() {
            return Err(ERROR_BAD_LENGTH);
        }
        let rows: Option<Vec<TableRow>> = table.chunks(REGISTERS_PER_ROW).map(parse_row).collect();
        let rows = rows.filter(|rows| rows.iter().all(|row| self.is_executable(row))).ok_or(ERROR_BAD_ROW)?;
        let counted = rows.iter().filter(|row| row.kind == RowKind::Touch).count();
        if *bound != sequence || counted != usize::from(*touches) {
            return Err(ERROR_BAD_ROW);
        }
        let step = u32::from(*high) << 16 | u32::from(*low);
        let descriptions: Vec<String> = rows.iter().map(describe_row).collect();
        if let Some(resident) = &mut self.resident_program {
            (resident.rows, resident.plan_step_number, resident.current_row_number) = (rows, step, 1);
        }
        Ok(format!("step {step}: {}", descriptions.join("; ")))
    }

    /// Whether the row has a target exactly if it moves, the target is within the travel, and feed or duration is
    /// positive.
    fn is_executable(&self, row: &TableRow) -> bool {
        let moves = matches!(row.kind, RowKind::Rapid | RowKind::Feed | RowKind::Guarded | RowKind::Touch);
        let fed = matches!(row.kind, RowKind::Rapid | RowKind::Orient) || row.feed_seconds_or_degrees > 0.0;
        fed && row.target.is_empty() != moves && self.options.interpreter.is_within_limits(&row.target)
    }

    /// Starts the current row. `false`: there is none, or a touch waits for the acknowledgement of the last result.
    pub(super) fn start_current_row(&mut self) -> bool {
        let Some(resident) = &self.resident_program else { return false };
        let (Some(row), step) = (resident.current_row().cloned(), resident.plan_step_number) else { return false };
        if row.kind == RowKind::Touch && resident.result_slot.is_pending {
            // The slot holds a result that is not acknowledged.
            return false;
        }
        let (to, feed) = (row.target, row.feed_seconds_or_degrees);
        let job = match row.kind {
            RowKind::Rapid => Job::Travel { to, feed_mm_min: None },
            RowKind::Feed => Job::Travel { to, feed_mm_min: Some(feed) },
            RowKind::Guarded | RowKind::Touch => Job::Probe { to, feed_mm_min: feed, alarms_on_miss: false, n: step },
            RowKind::Dwell => Job::Dwell { seconds: feed },
            RowKind::Orient => Job::OrientSpindle { s: Axis::S.to_mm_or_rad(feed) },
        };
        self.start_job(job);
        if let Some(active) = &mut self.executor.active_job {
            active.end_time = active.end_time.max(self.time_since_start + SCAN_PERIOD);
        }
        true
    }

    /// Handles the end of the current row. `contact`: whether its probing move found a contact; `None`: the row is no
    /// probing move.
    pub(super) fn finish_row(&mut self, contact: Option<bool>) {
        let Some(resident) = &self.resident_program else { return };
        let Some(row) = resident.current_row() else { return };
        let ends = matches!((row.kind, contact), (RowKind::Guarded, Some(true)) | (RowKind::Touch, Some(false)));
        if row.kind == RowKind::Feed && self.executor.is_probe_closed() {
            return self.raise_alarm(super::ALARM_PROBE_STILL_CLOSED);
        }
        if row.kind == RowKind::Touch || ends {
            self.publish_result(contact == Some(true));
        }
        let Some(resident) = &mut self.resident_program else { return };
        if ends {
            resident.stop();
        } else if !resident.advance_to_next_row() && std::mem::take(&mut resident.restarts_at_end) {
            resident.current_row_number = 1;
            self.record_event(ControlEvent::FaultOccurred(FaultKind::ProgramRestartedAtEnd));
        }
    }

    /// Replaces the result slot by a new pending result of the current row.
    fn publish_result(&mut self, has_contact: bool) {
        let (latch, t_s, sequence) = (self.latched_position.clone(), self.latch_time_s, self.checked_sequence);
        let Some(resident) = &mut self.resident_program else { return };
        let before = resident.result_slot.clone();
        let skipped = std::mem::take(&mut resident.skips_next_result);
        let count = 1 + u16::from(skipped);
        let number = (0..count).fold(before.result_number, |number, _| number.checked_add(1).unwrap_or(1));
        let row = u16::try_from(resident.current_row_number).unwrap_or(u16::MAX);
        resident.result_slot = ResultSlot {
            result_number: number,
            chunk_sequence: sequence,
            row_number: row,
            has_contact,
            is_pending: true,
            latched_position: latch,
            latch_time_s: t_s,
        };
        resident.previous_result_slot = (before.result_number > 0).then_some(before);
        if skipped {
            self.record_event(ControlEvent::FaultOccurred(FaultKind::SkippedResult));
        }
    }
}

/// Reads one row of the table; `None`: an unknown kind of row or an unknown axis.
fn parse_row(words: &[u16]) -> Option<TableRow> {
    let [kind, axes, high, low, positions @ ..] = words else { return None };
    let kind = match kind {
        1 => RowKind::Rapid,
        2 => RowKind::Feed,
        3 => RowKind::Guarded,
        4 => RowKind::Touch,
        5 => RowKind::Dwell,
        6 => RowKind::Orient,
        _ => return None,
    };
    let long = |pair: &[u16]| pair.iter().fold(0_u32, |long, word| long << 16 | u32::from(*word));
    let value = f64::from(long(&[*high, *low])) / FEED_TIME_ANGLE_STEPS_PER_UNIT;
    let axis_positions = REGISTER_AXES.into_iter().zip(positions.chunks(2)).zip(0..);
    let axis_positions = axis_positions.filter(|(_, bit)| axes >> bit & 1 == 1);
    let to = axis_positions.map(|((axis, pair), _)| {
        let steps = i32::from_be_bytes(long(pair).to_be_bytes());
        (axis, axis.to_mm_or_rad(f64::from(steps) / POSITION_STEPS_PER_UNIT))
    });
    (axes >> REGISTER_AXES.len() == 0).then(|| TableRow { kind, target: to.collect(), feed_seconds_or_degrees: value })
}

/// The row as text of the event log.
fn describe_row(row: &TableRow) -> String {
    let to = row.target.iter().map(|(axis, value)| format!(" {axis}{:.4}", axis.to_mm_or_deg(value)));
    format!("{:?}{} {}", row.kind, to.collect::<String>(), row.feed_seconds_or_degrees)
}
