//! Executes one block by the resident program: writes its table, starts it once, collects its results.

use std::time::Duration;

use tokio::time::Instant;

use super::ResidentProgram;
use super::layout::ProgramCall;
use super::rows::{self, ProgramRow, RowAction};
use crate::controllers::ControllerError;
use crate::controllers::modbus::driver::ModbusDriver;
use crate::controllers::modbus::fault::{ALARM_PROBE_CLOSED, ALARM_PROBE_STILL_CLOSED};
use crate::controllers::modbus::status::{ProgramRowResult, WindowStatus};
use crate::controllers::modbus::window::{RunningChunk, WindowConnection, sequence_after};
use crate::controllers::motion_lines::{MAX_ORIENT_TIME, duration_or_zero};
use machine::record::motion::{Motion, MotionBlockOutcome};
use machine::{Axis, Position};
use planning::proof::ProvenBlock;

/// Result of a row that searches for a contact.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ContactRowResult {
    /// Index of the row, from 0.
    pub row_index: usize,
    pub has_contact: bool,
    /// Latched position of the axes.
    pub latched_position: Position,
    /// Time of the latch on the control's clock, s, if it is reported.
    pub latch_time_s: Option<f64>,
}

/// Whether the result in a status is a new one of the present call.
enum ResultFreshness {
    /// A result of another call, or an older status.
    Stale,
    /// A result that was read already: the control has not received the acknowledgement yet.
    AlreadyRead,
    /// The next result of the present call.
    New,
}

impl ModbusDriver {
    /// Discards an old result before the first call: a result that was not read in an earlier run belongs to no call of
    /// this run.
    pub(in crate::controllers::modbus) async fn clear_results(
        &mut self,
        status: &WindowStatus,
    ) -> Result<(), ControllerError> {
        self.window.last_result_number = Some(status.latch_count);
        match status.result {
            Some(ProgramRowResult { is_unacknowledged: true, .. }) => {
                self.window.acknowledge_result(status.latch_count).await
            }
            _ => Ok(()),
        }
    }

    /// Executes `block` by one call of `program`. The outcome has the position and the time of the last touch, or,
    /// without a touch, the time of the last status.
    pub(in crate::controllers::modbus) async fn call_program(
        &mut self,
        program: &ResidentProgram,
        block: &ProvenBlock,
    ) -> Result<MotionBlockOutcome, ControllerError> {
        let rows = rows::rows_from_block(block)?;
        let (results, status) = self.execute_rows(program, &rows, block).await?;
        let touch = self.find_last_touch(&rows, &results, block.step())?;
        let latch_s = touch.and_then(|result| result.latch_time_s);
        let mut outcome = MotionBlockOutcome {
            trigger_time_s: self.contact_or_status_time_s(latch_s, &status)?,
            ..MotionBlockOutcome::default()
        };
        if let Some(result) = touch {
            let orientation = block.motions().take(result.row_index).filter_map(spindle_orientation_rad).last();
            let spindle = orientation.or(self.monitor.spindle_rad).map(|s| (Axis::S, s));
            let contact = self.monitor.machine_axes_only(&result.latched_position);
            outcome.trigger_position = Some(contact.iter().chain(spindle).collect());
        }
        self.monitor.spindle_rad =
            block.motions().filter_map(spindle_orientation_rad).last().or(self.monitor.spindle_rad);
        let end = rows::end_position(&rows, &self.monitor.standstill_position);
        let status = self.store_and_check_standstill(status, &end)?;
        if rows.last().is_some_and(|row| row.action != RowAction::Touch) {
            self.wait_probe_open(block.step(), status).await?;
        }
        Ok(outcome)
    }

    /// Executes `rows` once; returns every result, in order, and the status at the end.
    pub(super) async fn execute_rows(
        &mut self,
        program: &ResidentProgram,
        rows: &[ProgramRow],
        block: &ProvenBlock,
    ) -> Result<(Vec<ContactRowResult>, WindowStatus), ControllerError> {
        let step = block.step();
        let call = ProgramCall { sequence: self.window.next_sequence(), program, step, rows };
        let chunk = program.layout.encode_chunk(&call);
        let chunk = chunk.map_err(|reason| ControllerError::RenderFailed { step, reason })?;
        self.check_block_start(block).await?;
        let name = format!("program {}, step {step}", program.program_number);
        let mut running = self.window.start_chunk(&chunk, &name, planned_standstill_time(rows)).await?;
        let collected = self.collect_results(&mut running, rows, step).await;
        collected.map_err(|error| match error {
            ControllerError::Alarm { code, .. }
                if [ALARM_PROBE_CLOSED, ALARM_PROBE_STILL_CLOSED].map(u32::from).contains(&code) =>
            {
                ControllerError::ProbeStillClosed { step }
            }
            other => other,
        })
    }

    /// Reads and acknowledges results until the program has ended; returns them in order, and the last status. After a
    /// contact during a positioning move the driver holds the machine and returns an error.
    async fn collect_results(
        &mut self,
        running: &mut RunningChunk,
        rows: &[ProgramRow],
        step: u32,
    ) -> Result<(Vec<ContactRowResult>, WindowStatus), ControllerError> {
        let (mut results, mut ended_at) = (Vec::new(), None);
        loop {
            let (status, done) = self.window.poll_chunk(running).await?;
            let slot = status.result.ok_or_else(|| result_mismatch_error("no result", rows.len()))?;
            let active_row = usize::from(slot.active_row_number).checked_sub(1);
            let row = active_row.and_then(|row| rows.get(row));
            if status.is_probe_closed && row.is_some_and(|row| row.is_positioning_move) {
                // The machine may still be moving, and does not stop by itself.
                self.window.send_hold();
                return Err(ControllerError::UnexpectedContact { step });
            }
            if !slot.is_unacknowledged {
                if done {
                    return Ok((results, status));
                }
                continue;
            }
            match result_freshness(&self.window, &status, &slot, running.sequence)? {
                ResultFreshness::Stale => {}
                ResultFreshness::AlreadyRead => self.window.acknowledge_result(status.latch_count).await?,
                ResultFreshness::New => {
                    results.push(ContactRowResult {
                        row_index: usize::from(slot.row_number).wrapping_sub(1),
                        has_contact: slot.has_contact,
                        latched_position: status.latched_position.clone(),
                        latch_time_s: status.latch_time_s,
                    });
                    self.window.last_result_number = Some(status.latch_count);
                    self.window.acknowledge_result(status.latch_count).await?;
                }
            }
            // The program has ended, but still reports a result that was acknowledged.
            let since = ended_at.filter(|_| done).unwrap_or_else(Instant::now);
            ended_at = done.then_some(since);
            if since.elapsed() > self.window.timeouts.reply_timeout {
                return Err(result_mismatch_error("an acknowledged result", results.len()));
            }
        }
    }

    /// Returns the last touch among the results; `None` if `rows` has no touch. Each touch row must have one result,
    /// in the order of the rows, with a contact on its path; a contact of a guarded row is an error.
    fn find_last_touch<'a>(
        &self,
        rows: &[ProgramRow],
        results: &'a [ContactRowResult],
        step: u32,
    ) -> Result<Option<&'a ContactRowResult>, ControllerError> {
        let mut touches = (0..).zip(rows).filter(|(_, row)| row.action == RowAction::Touch);
        for result in results {
            match rows.get(result.row_index).map(|row| row.action) {
                Some(RowAction::Guarded) if result.has_contact => {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                Some(RowAction::Touch) if !result.has_contact => return Err(ControllerError::NoContact { step }),
                _ => {}
            }
            match touches.next() {
                Some((index, row)) if index == result.row_index => {
                    self.check_contact_on_path(rows.get(..index).unwrap_or(rows), row, result)?;
                }
                _ => return Err(result_mismatch_error(&format!("a result of row {}", result.row_index + 1), 0)),
            }
        }
        match touches.count() {
            0 => Ok(results.last()),
            missing => Err(result_mismatch_error("no result", missing)),
        }
    }

    /// Checks that the contact of `row` is on the path from the end of `earlier_rows` to the row's target.
    fn check_contact_on_path(
        &self,
        earlier_rows: &[ProgramRow],
        row: &ProgramRow,
        result: &ContactRowResult,
    ) -> Result<(), ControllerError> {
        let from = rows::end_position(earlier_rows, &self.monitor.standstill_position);
        let to = from.updated_by(&row.target);
        let contact = self.monitor.machine_axes_only(&result.latched_position);
        self.monitor.check_contact_on_path(&from, &to, &contact.filter_axes(|axis| from.get(axis).is_some()))
    }
}

/// Compares the number and the call of a result with those expected; an error if results were skipped.
fn result_freshness(
    window: &WindowConnection,
    status: &WindowStatus,
    slot: &ProgramRowResult,
    sequence: u16,
) -> Result<ResultFreshness, ControllerError> {
    let last_number = window.last_result_number.unwrap_or_default();
    if status.latch_count == last_number {
        return Ok(ResultFreshness::AlreadyRead);
    }
    if status.checked_sequence != sequence || slot.call_sequence != sequence {
        return Ok(ResultFreshness::Stale);
    }
    if status.latch_count == sequence_after(last_number) {
        return Ok(ResultFreshness::New);
    }
    // Numbers wrap around: a number in the farther half is an older one.
    if status.latch_count.wrapping_sub(last_number) > u16::MAX / 2 {
        return Ok(ResultFreshness::Stale);
    }
    let reply = format!("result {} received, result {} expected", status.latch_count, sequence_after(last_number));
    Err(ControllerError::UnexpectedReply { reply })
}

/// Error of a call with wrong results: `slot` describes what was received, `expected` is a number of results.
fn result_mismatch_error(slot: &str, expected: usize) -> ControllerError {
    ControllerError::UnexpectedReply { reply: format!("{slot} received, {expected} results expected") }
}

fn spindle_orientation_rad(motion: &Motion) -> Option<f64> {
    match motion {
        Motion::OrientSpindle { s } => Some(*s),
        _ => None,
    }
}

/// Maximum time for which the machine may be at rest within a call: the sum over all rows.
fn planned_standstill_time(rows: &[ProgramRow]) -> Duration {
    let rest_times = rows.iter().map(|row| match row.action {
        RowAction::Dwell => duration_or_zero(row.feed_dwell_or_angle),
        RowAction::OrientSpindle => MAX_ORIENT_TIME,
        _ => Duration::ZERO,
    });
    rest_times.sum()
}
