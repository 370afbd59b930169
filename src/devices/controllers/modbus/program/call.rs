//! Executes one block by the resident program: writes its table, starts it once, collects its results.

use std::time::Duration;

use tokio::time::Instant;

use super::Program;
use super::layout::Call;
use super::rows::{self, Does, Row};
use crate::controllers::modbus::driver::{ModbusControl, ORIENT};
use crate::controllers::modbus::fault::{PROBE_CLOSED, STILL_CLOSED};
use crate::controllers::modbus::status::{Shown, Status};
use crate::controllers::modbus::window::{Pending, Window, next};
use crate::controllers::{ControllerError, arrival};
use machine::record::motion::{Motion, Outcome};
use machine::{Axis, Position};
use planning::proof::ProvenBlock;

/// Result of a row that searches for a contact.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    /// Index of the row, from 0.
    pub row: usize,
    pub contact: bool,
    /// Latched position of the axes; `t_s` is its time, s.
    pub latch: Position,
    pub t_s: Option<f64>,
}

/// Kind of a valid result in a status.
enum Seen {
    /// A result of another call, or an older status.
    Old,
    /// A result that was read already: the control has not received the acknowledgement yet.
    ResumableRun,
    New,
}

impl ModbusControl {
    /// Discards an old result before the first call: a result that an ended run has not read belongs to no
    /// call.
    pub(in crate::controllers::modbus) async fn clear_results(
        &mut self,
        status: &Status,
    ) -> Result<(), ControllerError> {
        self.window.taken = Some(status.latches);
        match status.result {
            Some(Shown { valid: true, .. }) => self.window.acknowledge(status.latches).await,
            _ => Ok(()),
        }
    }

    pub(in crate::controllers::modbus) async fn call(
        &mut self,
        program: &Program,
        block: &ProvenBlock,
    ) -> Result<Outcome, ControllerError> {
        let rows = rows::of(block)?;
        let (found, status) = self.results(program, &rows, block).await?;
        let touch = self.contacts(&rows, &found, block.step())?;
        let latch_s = touch.and_then(|found| found.t_s);
        let mut outcome = Outcome { t_s: self.time_s(latch_s, &status)?, ..Outcome::default() };
        if let Some(found) = touch {
            let spindle = block.motions().take(found.row).filter_map(orientation).last();
            let spindle = spindle.or(self.spindle);
            let spindle = spindle.map(|s| (Axis::S, s));
            outcome.touch = Some(self.of_machine(&found.latch).iter().chain(spindle).collect());
        }
        self.spindle = block.motions().filter_map(orientation).last().or(self.spindle);
        let end = rows::end(&rows, &self.stood);
        let status = self.arrive(status, &end)?;
        if rows.last().is_some_and(|row| row.does != Does::Touch) {
            self.open_probe(block.step(), status).await?;
        }
        Ok(outcome)
    }

    /// Executes `rows` once; returns every result, in order, and the status at the end.
    pub(super) async fn results(
        &mut self,
        program: &Program,
        rows: &[Row],
        block: &ProvenBlock,
    ) -> Result<(Vec<Found>, Status), ControllerError> {
        let step = block.step();
        let call = Call { sequence: self.window.coming(), program, step, rows };
        let chunk = program.layout.chunk(&call);
        let chunk = chunk.map_err(|why| ControllerError::Render { step, why })?;
        self.begin(block).await?;
        let name = format!("program {}, step {step}", program.number);
        let mut pending = self.window.begin(&chunk, &name, standstill(rows)).await?;
        let collected = self.collect(&mut pending, rows, step).await;
        collected.map_err(|error| match error {
            ControllerError::Alarm { code, .. }
                if [PROBE_CLOSED, STILL_CLOSED].map(u32::from).contains(&code) =>
            {
                ControllerError::StillTripped { step }
            }
            other => other,
        })
    }

    async fn collect(
        &mut self,
        pending: &mut Pending,
        rows: &[Row],
        step: u32,
    ) -> Result<(Vec<Found>, Status), ControllerError> {
        let (mut found, mut over) = (Vec::new(), None);
        loop {
            let (status, done) = self.window.look(pending).await?;
            let Some(shown) = status.result else { return Err(results_differ("none", rows.len())) };
            let under_way = usize::from(shown.under_way).checked_sub(1);
            let row = under_way.and_then(|row| rows.get(row));
            if status.probe_closed && row.is_some_and(|row| row.is_free_move) {
                // The machine may still be moving, and does not stop by itself.
                self.window.hold();
                return Err(ControllerError::UnexpectedContact { step });
            }
            if !shown.valid {
                if done {
                    return Ok((found, status));
                }
                continue;
            }
            match seen(&self.window, &status, &shown, pending.sequence)? {
                Seen::Old => {}
                Seen::ResumableRun => self.window.acknowledge(status.latches).await?,
                Seen::New => {
                    found.push(taken(&status, &shown));
                    self.window.taken = Some(status.latches);
                    self.window.acknowledge(status.latches).await?;
                }
            }
            // The program has ended, but still reports a result that was acknowledged.
            let since = over.filter(|_| done).unwrap_or_else(Instant::now);
            over = done.then_some(since);
            if since.elapsed() > self.window.patience.answer {
                return Err(results_differ("one that was acknowledged", found.len()));
            }
        }
    }

    /// Returns the touch among the results, if the rows have one; each contact must be on the path of its
    /// row.
    fn contacts<'a>(
        &self,
        rows: &[Row],
        found: &'a [Found],
        step: u32,
    ) -> Result<Option<&'a Found>, ControllerError> {
        let mut touches = (0..).zip(rows).filter(|(_, row)| row.does == Does::Touch);
        for found in found {
            let row = rows.get(found.row).map(|row| row.does);
            match row {
                Some(Does::Guarded) if found.contact => {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                Some(Does::Touch) if !found.contact => {
                    return Err(ControllerError::NoContact { step });
                }
                _ => {}
            }
            match touches.next() {
                Some((place, row)) if place == found.row => {
                    self.on_the_way(rows.get(..place).unwrap_or(rows), row, found)?;
                }
                _ => return Err(results_differ(&format!("one of row {}", found.row + 1), 0)),
            }
        }
        match touches.count() {
            0 => Ok(found.last()),
            missing => Err(results_differ("none", missing)),
        }
    }

    fn on_the_way(&self, before: &[Row], row: &Row, found: &Found) -> Result<(), ControllerError> {
        let from = rows::end(before, &self.stood);
        let to = from.updated_by(&row.target);
        let contact = self.of_machine(&found.latch).only(|axis| from.get(axis).is_some());
        let astray = arrival::contact_off_path(&from, &to, &contact, |axis| self.tolerance(axis));
        astray.map_or(Ok(()), Err)
    }
}

fn seen(
    window: &Window,
    status: &Status,
    shown: &Shown,
    sequence: u16,
) -> Result<Seen, ControllerError> {
    let taken = window.taken.unwrap_or_default();
    if status.latches == taken {
        return Ok(Seen::ResumableRun);
    }
    if status.accepted != sequence || shown.sequence != sequence {
        return Ok(Seen::Old);
    }
    if status.latches == next(taken) {
        return Ok(Seen::New);
    }
    // Numbers wrap around: a number in the farther half is an older one.
    if status.latches.wrapping_sub(taken) > u16::MAX / 2 {
        return Ok(Seen::Old);
    }
    let heard = format!("result {} where {} was to come", status.latches, next(taken));
    Err(ControllerError::OutOfStep { heard })
}

fn taken(status: &Status, shown: &Shown) -> Found {
    Found {
        row: usize::from(shown.row).wrapping_sub(1),
        contact: shown.contact,
        latch: status.latch.clone(),
        t_s: status.latch_time_s,
    }
}

fn results_differ(shown: &str, wanted: usize) -> ControllerError {
    ControllerError::OutOfStep { heard: format!("{shown} where {wanted} results were to come") }
}

fn orientation(motion: &Motion) -> Option<f64> {
    match motion {
        Motion::Orient { s } => Some(*s),
        _ => None,
    }
}

/// Maximum time for which the machine may be at rest within a call.
fn standstill(rows: &[Row]) -> Duration {
    let stands = rows.iter().map(|row| match row.does {
        Does::Dwell => Duration::try_from_secs_f64(row.value).unwrap_or_default(),
        Does::Orient => ORIENT,
        _ => Duration::ZERO,
    });
    stands.sum()
}
