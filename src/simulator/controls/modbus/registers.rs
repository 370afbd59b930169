//! Reads and writes of registers.

use tokio_modbus::{ExceptionCode, Request, Response};

use super::fault::WRONG_STAMP_S;
use super::layout::{
    ACKNOWLEDGE_REGISTER, HEARTBEAT_REGISTER, HOLD_REGISTER, SEQUENCE_REGISTER, position_steps, register_words,
};
use super::resident_program::ResultSlot;
use super::{ControlEvent, Firmware, OperatingState};
use machine::Position;

/// Version of the register layout that the status reports, for a control that executes lines.
const LINE_WINDOW_VERSION: u16 = 1;
/// Version of the register layout that the status reports, for a control with a resident program.
const PROGRAM_WINDOW_VERSION: u16 = 101;
/// Rate of the control's own heartbeat counter, 1/s.
const HEARTBEATS_PER_S: f64 = 20.0;

fn position_words(position: &Position) -> Vec<u16> {
    position_steps(position).iter().flat_map(|steps| register_words(&steps.to_be_bytes())).collect()
}

impl Firmware {
    /// Composes input registers 0 to 44, or 0 to 49 with a resident program. Each call counts as a new block and as a
    /// report of the probe, except after the program has stopped: the block is frozen then.
    pub(super) fn status_block(&mut self) -> Vec<u16> {
        if let Some(frozen) = &self.frozen_status_block {
            return frozen.clone();
        }
        let (state, alarm) = match self.operating_state {
            OperatingState::NotReady => (0, 0),
            OperatingState::Ready if self.is_running() => (2, 0),
            OperatingState::Ready => (1, 0),
            OperatingState::Held(reason) => (3, reason),
            OperatingState::AlarmWithCode(code) => (4, code),
        };
        let position = self.executor.displayed_position_at(self.time_since_start);
        self.status_block_count = self.status_block_count.wrapping_add(1);
        let probe = u16::from(self.executor.is_probe_closed());
        self.executor.on_probe_state_reported();
        let beat = self.heartbeat_count();
        let slot = self.reported_slot();
        let version = if slot.is_some() { PROGRAM_WINDOW_VERSION } else { LINE_WINDOW_VERSION };
        let (number, t_s, latch) = match &slot {
            Some(slot) => (slot.result_number, slot.latch_time_s, &slot.latched_position),
            None => (self.latch_count, self.latch_time_s, &self.latched_position),
        };
        let t_s = if self.has_wrong_stamp && t_s > 0.0 { WRONG_STAMP_S } else { t_s };
        let mut block =
            vec![self.status_block_count, version, state, alarm, self.checked_sequence, self.executed_sequence];
        block.extend([self.error_code, probe, 0, 0, number, beat]);
        block.extend(register_words(&self.executor.with_world(|world| world.time_s()).to_be_bytes()));
        block.extend(register_words(&t_s.to_be_bytes()));
        block.extend(position_words(latch));
        block.extend(position_words(&position));
        if let (Some(slot), Some(resident)) = (slot, &self.resident_program) {
            let at = u16::try_from(resident.current_row_number).unwrap_or(u16::MAX);
            block.extend([at, slot.chunk_sequence, slot.row_number]);
            block.extend([slot.has_contact, slot.is_pending].map(u16::from));
        }
        block.push(self.status_block_count);
        self.previous_status_block.clone_from(&block);
        block
    }

    /// The control's own heartbeat counter; wraps.
    pub(super) fn heartbeat_count(&self) -> u16 {
        let beat = (self.time_since_start.as_secs_f64() * HEARTBEATS_PER_S) as u64 as u16;
        self.frozen_heartbeat_value.unwrap_or(beat)
    }

    /// Result shown by the resident program, the previous one for [`FaultKind::StaleResult`]; `None`: no program.
    fn reported_slot(&mut self) -> Option<ResultSlot> {
        let resident = self.resident_program.as_ref()?;
        match self.shows_previous_result.then(|| resident.previous_result_slot.clone()).flatten() {
            Some(before) => Some(ResultSlot { is_pending: true, ..before }),
            None => Some(resident.result_slot.clone()),
        }
    }

    /// Executes `request`.
    pub(super) fn execute_request(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let read_block = |block: &[u16], first: u16, count: u16| {
            let first = usize::from(first);
            let words = block.get(first..first + usize::from(count));
            words.map(<[u16]>::to_vec).ok_or(ExceptionCode::IllegalDataAddress)
        };
        match request {
            Request::ReadInputRegisters(first, count) => {
                read_block(&self.status_block(), *first, *count).map(Response::ReadInputRegisters)
            }
            Request::ReadHoldingRegisters(first, count) => {
                read_block(&self.holding_registers, *first, *count).map(Response::ReadHoldingRegisters)
            }
            Request::WriteSingleRegister(at, word) => {
                self.write_registers(*at, &[*word])?;
                Ok(Response::WriteSingleRegister(*at, *word))
            }
            Request::WriteMultipleRegisters(at, words) => {
                self.write_registers(*at, words)?;
                let count = u16::try_from(words.len()).map_err(|_| ExceptionCode::IllegalDataValue)?;
                Ok(Response::WriteMultipleRegisters(*at, count))
            }
            _ => Err(ExceptionCode::IllegalFunction),
        }
    }

    /// Writes holding registers; writes of the heartbeat, acknowledge, sequence and hold registers take effect at
    /// once.
    pub(super) fn write_registers(&mut self, first_address: u16, words: &[u16]) -> Result<(), ExceptionCode> {
        let first = usize::from(first_address);
        let range = first..first + words.len();
        let before = [HOLD_REGISTER, HEARTBEAT_REGISTER].map(|registers| self.holding_registers[registers]);
        let registers = self.holding_registers.get_mut(range.clone()).ok_or(ExceptionCode::IllegalDataAddress)?;
        registers.copy_from_slice(words);
        if self.holding_registers[HEARTBEAT_REGISTER] != before[1] {
            self.last_heartbeat_change_time = Some(self.time_since_start);
        }
        if let Some(resident) = self.resident_program.as_mut().filter(|_| range.contains(&ACKNOWLEDGE_REGISTER)) {
            resident.on_result_acknowledge_written(self.holding_registers[ACKNOWLEDGE_REGISTER]);
        }
        if range.contains(&SEQUENCE_REGISTER) {
            self.on_sequence_written();
        }
        if self.holding_registers[HOLD_REGISTER] != 0 && range.contains(&HOLD_REGISTER) {
            self.record_event(ControlEvent::HoldRegisterWritten);
            self.stop_and_hold(0);
        }
        Ok(())
    }
}
